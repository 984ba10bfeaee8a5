#include "soft_volume/tool/patch_contact.h"

#include <algorithm>
#include <bitset>
#include <cassert>
#include <numeric>
#include <string>
#include <utility>

#include "soft_volume/common/error.h"
#include "soft_volume/grid/cell_shape.h"

namespace soft_volume::core {
namespace {

constexpr int kMaxBins = 24;  // per axis
constexpr std::size_t kBinsPerCell = 48;
constexpr double kRoom = 0.03;       // of a cell's edge that vertices may move before their cells' boxes are made anew
constexpr double kAtFace = 1e-6;     // metres
constexpr double kSamePlace = 1e-4;  // of a cell; vertices are in single precision
constexpr std::array<std::uint32_t, 8> kHexahedronOrder{0, 1, 2, 3, 4, 5, 6, 7};
constexpr std::array<std::uint32_t, 8> kVoxelOrder{0, 1, 3, 2, 4, 5, 7, 6};

bool isHexahedral(CellType type) {
  return type == CellType::kHexahedron || type == CellType::kVoxel;
}

const std::array<std::uint32_t, 8>& cornerOrder(CellType type) {
  return type == CellType::kVoxel ? kVoxelOrder : kHexahedronOrder;
}

template <typename T>
bool isIncreasing(const std::vector<T>& values) {
  return std::adjacent_find(values.begin(), values.end(), [](T a, T b) { return a >= b; }) == values.end();
}

void require(bool good, const std::string& what) {
  if (!good)
    throw InputError("grid patch: " + what + "; wait for the next patch of the current grid");
}

bool allFinite(const std::vector<Vector3f>& values) {
  return std::all_of(values.begin(), values.end(), [](const Vector3f& v) { return isFinite(v.cast<double>()); });
}

// Slot of every number in an increasing list, kNoCell for those that it lacks; throws when one is not below `size`.
void fillSlots(const std::vector<std::uint32_t>& increasing, std::size_t size, std::vector<std::uint32_t>& slots) {
  require(isIncreasing(increasing), "numbers do not increase");
  require(increasing.empty() || increasing.back() < size, "a cell or vertex is not in the grid");
  slots.assign(size, PatchContact::kNoCell);
  for (std::uint32_t slot = 0; slot < increasing.size(); ++slot)
    slots[increasing[slot]] = slot;
}

// VTK numbers the faces of a hexahedron -x, +x, -y, +y, -z, +z.
int nearestFace(const Vector3& local) {
  Eigen::Index axis = 0;
  (local - Vector3::Constant(0.5)).cwiseAbs().maxCoeff(&axis);
  return 2 * int(axis) + (local[axis] > 0.5 ? 1 : 0);
}

// Whether a place in a box, both in metres, is at one of these faces.
bool isAtFace(unsigned faces, const Vector3& place_m, const Vector3& lengths_m) {
  for (int face = 0; face < 6; ++face) {
    const double from_face = face % 2 == 0 ? place_m[face / 2] : lengths_m[face / 2] - place_m[face / 2];
    if ((faces >> face & 1U) != 0 && from_face < kAtFace)
      return true;
  }
  return false;
}

}  // namespace

PatchContact::PatchContact(std::shared_ptr<const Volume> volume, double tissue_threshold)
    : volume_(std::move(volume)), tissue_threshold_(tissue_threshold) {
  assert(volume_ && !volume_->empty());
}

void PatchContact::clear() {
  cells_.clear();
  hexahedra_.clear();
  cones_.clear();
  cell_corners_.clear();
  vertex_ids_.clear();
  duration_s_ = 0.0;
  has_cuts_ = false;
  bounds_.setEmpty();
  mean_edge_m_ = 0.0;
}

void PatchContact::check(const Topology& topology, const GridPatch& patch) {
  require(patch.session == topology.session && patch.revision == topology.revision,
          "made for revision " + std::to_string(patch.revision) + ", the grid is at " +
              std::to_string(topology.revision) + " (or the session differs)");
  require(patch.positions.size() == patch.vertex_ids.size() && patch.velocities.size() == patch.vertex_ids.size(),
          "positions and velocities do not match the vertices");
  require(patch.stiffness_pa.size() == patch.cell_ids.size(), "stiffnesses do not match the cells");
  require(allFinite(patch.positions) && allFinite(patch.velocities), "a position or velocity is not finite");
  fillSlots(patch.vertex_ids, topology.vertexCount(), vertex_slots_);
  fillSlots(patch.cell_ids, topology.cellCount(), cell_slots_);
  for (const std::uint32_t id : patch.cell_ids)
    checkCorners(topology, id);
}

void PatchContact::checkCorners(const Topology& topology, std::uint32_t id) const {
  const auto missing = [&](std::uint32_t vertex) { return vertex_slots_[vertex] == kNoCell; };
  const std::uint32_t* begin = topology.connectivity.data() + topology.cell_offsets[id];
  forEachFace(topology.cell_types[id], begin, [&](std::size_t, const std::uint32_t* loop, std::size_t size) {
    if (std::any_of(loop, loop + size, missing))
      require(false, "a vertex of cell " + std::to_string(id) + " is missing");
  });
}

void PatchContact::countFaces(const Topology& topology) {
  if (counted_session_ == topology.session && counted_revision_ == topology.revision &&
      face_begins_.size() == topology.cellCount())
    return;
  counted_session_ = topology.session;
  counted_revision_ = topology.revision;
  face_begins_.resize(topology.cellCount());
  std::size_t faces = 0;
  for (std::size_t id = 0; id < topology.cellCount(); ++id) {
    face_begins_[id] = std::uint32_t(faces);
    faces += faceCount(topology.cell_types[id], topology.connectivity.data() + topology.cell_offsets[id]);
  }
}

PatchContact::Behind PatchContact::behind(const Topology& topology, std::uint32_t id, std::size_t face) const {
  const std::size_t at = face_begins_[id] + face;
  return {topology.face_neighbours[at], topology.cut_faces[at] != 0};
}

// The grid has a cell behind the face that the patch lacks. An incision's face is a real surface.
bool PatchContact::isMissing(const Behind& behind) const {
  return behind.neighbour >= 0 && !behind.cut && cell_slots_[std::size_t(behind.neighbour)] == kNoCell;
}

void PatchContact::placePoints(const Topology& topology, const GridPatch& patch) {
  vertex_ids_ = patch.vertex_ids;
  positions_m_.clear();
  places_m_.clear();
  velocities_m_s_.clear();
  for (std::size_t slot = 0; slot < patch.vertex_ids.size(); ++slot) {
    const Vector3f& coordinates = topology.texture_coordinates[patch.vertex_ids[slot]];
    positions_m_.push_back(patch.positions[slot].cast<double>());
    places_m_.push_back(volume_->geometry().fromTexture(coordinates.cast<double>()));
    velocities_m_s_.push_back(patch.velocities[slot].cast<double>());
  }
}

void PatchContact::addCell(Cell cell) {
  has_cuts_ |= cell.cut;
  cells_.push_back(cell);
}

void PatchContact::addHexahedron(const Topology& topology, std::uint32_t id) {
  Hexahedron hexahedron;
  for (std::uint32_t i = 0; i < 8; ++i) {
    const std::uint32_t at = topology.cell_offsets[id] + cornerOrder(topology.cell_types[id])[i];
    hexahedron.corners[i] = vertex_slots_[topology.connectivity[at]];
  }
  unsigned missing = 0;
  unsigned cuts = 0;
  for (std::size_t face = 0; face < 6; ++face) {
    const Behind other = behind(topology, id, face);
    missing |= isMissing(other) ? 1U << face : 0U;
    cuts |= other.cut ? 1U << face : 0U;
  }
  hexahedron.missing_neighbours = std::uint8_t(missing);
  hexahedron.cuts = std::uint8_t(cuts);
  Cell cell;
  cell.id = id;
  cell.cut = cuts != 0;
  cell.first = std::uint32_t(hexahedra_.size());
  hexahedra_.push_back(hexahedron);
  addCell(cell);
}

template <typename Visit>
void PatchContact::forCornersOf(const Cell& cell, const Visit& visit) const {
  if (cell.corners == 0) {  // a hexahedron
    for (const std::uint32_t slot : hexahedra_[cell.first].corners)
      visit(slot);
  }
  for (std::uint32_t c = cell.first_corner; c < cell.first_corner + cell.corners; ++c)
    visit(cell_corners_[c]);
}

void PatchContact::addCones(const Topology& topology, std::uint32_t id) {
  const std::uint32_t* begin = topology.connectivity.data() + topology.cell_offsets[id];
  if (faceCount(topology.cell_types[id], begin) == 0)
    return;
  Cell cell;
  cell.id = id;
  cell.first = std::uint32_t(cones_.size());
  const auto centre = std::uint32_t(positions_m_.size());
  addCorners(topology, id, cell);
  Box3 box;
  forCornersOf(cell, [&](std::uint32_t slot) { box.extend(positions_m_[slot]); });
  const double tolerance_m = kFaceTolerance * box.sizes().maxCoeff();
  forEachFace(topology.cell_types[id], begin, [&](std::size_t face, const std::uint32_t* loop, std::size_t size) {
    const Behind other = behind(topology, id, face);
    addFace(topology, {loop, size}, other, centre, tolerance_m);
    cell.cut |= other.cut;
  });
  cell.cones = std::uint32_t(cones_.size()) - cell.first;
  for (std::vector<Vector3>* field : {&positions_m_, &places_m_, &velocities_m_s_})
    field->push_back(centreOf(*field, cell));
  addCell(cell);
}

void PatchContact::addCorners(const Topology& topology, std::uint32_t id, Cell& cell) {
  cell.first_corner = std::uint32_t(cell_corners_.size());
  const auto known = [&](std::uint32_t slot) {
    return std::find(cell_corners_.begin() + cell.first_corner, cell_corners_.end(), slot) != cell_corners_.end();
  };
  const std::uint32_t* begin = topology.connectivity.data() + topology.cell_offsets[id];
  forEachFace(topology.cell_types[id], begin, [&](std::size_t, const std::uint32_t* loop, std::size_t size) {
    for (std::size_t i = 0; i < size; ++i) {
      if (!known(vertex_slots_[loop[i]]))
        cell_corners_.push_back(vertex_slots_[loop[i]]);
    }
  });
  cell.corners = std::uint32_t(cell_corners_.size()) - cell.first_corner;
}

// A field in the middle of a cell's corners.
Vector3 PatchContact::centreOf(const std::vector<Vector3>& field, const Cell& cell) const {
  Vector3 sum = Vector3::Zero();
  forCornersOf(cell, [&](std::uint32_t slot) { sum += field[slot]; });
  return sum / double(cell.corners);
}

void PatchContact::addFace(const Topology& topology, const Loop& loop, const Behind& behind, std::uint32_t centre,
                           double tolerance_m) {
  const auto slot = [&](std::size_t corner) { return vertex_slots_[loop.vertices[corner % loop.size]]; };
  const auto add = [&](const SurfaceCone::Points& points) {
    cones_.push_back({points, tolerance_m, isMissing(behind), behind.cut});
  };
  const bool fits_hexahedron =
      behind.neighbour >= 0 && !behind.cut && isHexahedral(topology.cell_types[std::size_t(behind.neighbour)]);
  if (loop.size == 4 && fits_hexahedron) {
    add({centre, slot(0), slot(1), slot(2), slot(3)});
    return;
  }
  const auto lowest = std::size_t(std::min_element(loop.vertices, loop.vertices + loop.size) - loop.vertices);
  for (std::size_t i = 1; i + 1 < loop.size; ++i) {
    const std::uint32_t last = slot(lowest + i + 1);
    add({centre, slot(lowest), slot(lowest + i), last, last});
  }
}

void PatchContact::update(const Topology& topology, const GridPatch& patch) {
  check(topology, patch);
  clear();
  session_ = patch.session;
  revision_ = patch.revision;
  countFaces(topology);
  placePoints(topology, patch);
  for (const std::uint32_t id : patch.cell_ids) {
    if (isHexahedral(topology.cell_types[id]))
      addHexahedron(topology, id);
    else
      addCones(topology, id);
  }
  for (Cell& cell : cells_)
    cell.stiffness_pa = patch.stiffness_pa[cell_slots_[cell.id]];
  from_m_ = positions_m_;
  to_m_ = positions_m_;
  known_.assign(positions_m_.size(), 0);
  if (cells_.empty())
    return;
  boundCells(0.0);
  boundPlaces();
  measure();
  boundCells(kRoom * mean_edge_m_);
  reserveBins();
  buildBins();
}

// The image of a trilinear map and a cone lie in the hull of their corners, and that of a moving one in the hull of its
// ends; the boxes are wider by a margin and keep points within the face tolerance.
void PatchContact::boundCells(double margin_m) {
  margin_m_ = margin_m;
  bounds_.setEmpty();
  for (Cell& cell : cells_) {
    Box3 box;
    forCornersOf(cell, [&](std::uint32_t slot) {
      box.extend(from_m_[slot]);
      box.extend(to_m_[slot]);
    });
    const Vector3 margin = 10.0 * kFaceTolerance * box.sizes() + Vector3::Constant(margin_m + 1e-9);
    cell.box = Box3(Vector3(box.min() - margin), Vector3(box.max() + margin));
    bounds_.extend(cell.box);
  }
}

void PatchContact::measure() {
  double edges = 0.0;
  for (const Cell& cell : cells_)
    edges += hexahedra_.empty() ? cell.box.sizes().mean() : 0.0;
  for (const Hexahedron& hexahedron : hexahedra_)
    edges += trilinear(positions_m_, hexahedron).jacobian(Vector3::Constant(0.5)).colwise().norm().mean();
  mean_edge_m_ = edges / double(hexahedra_.empty() ? cells_.size() : hexahedra_.size());
  march_step_m_ = std::max(0.5 * volume_->geometry().spacing_m.minCoeff(), mean_edge_m_ / 16.0);
}

std::array<int, 3> PatchContact::binOf(const Vector3& point_m) const {
  std::array<int, 3> bin{};
  for (int a = 0; a < 3; ++a) {
    const double at = std::floor((point_m[a] - bounds_.min()[a]) * bins_per_m_[a]);
    bin[a] = int(std::clamp(at, 0.0, double(bins_[a] - 1)));
  }
  return bin;
}

template <typename Visit>
void PatchContact::forBinsOf(const Cell& cell, const Visit& visit) const {
  const auto low = binOf(cell.box.min());
  const auto high = binOf(cell.box.max());
  for (int k = low[2]; k <= high[2]; ++k) {
    for (int j = low[1]; j <= high[1]; ++j) {
      for (int i = low[0]; i <= high[0]; ++i)
        visit(binIndex(i, j, k));
    }
  }
}

void PatchContact::boundPlaces() {
  for (Cell& cell : cells_) {
    forCornersOf(cell, [&](std::uint32_t slot) { cell.place_box.extend(places_m_[slot]); });
    const Vector3 margin = 2.0 * kSamePlace * cell.place_box.sizes();
    cell.place_box = Box3(Vector3(cell.place_box.min() - margin), Vector3(cell.place_box.max() + margin));
  }
}

// Room for any later buildBins(): a moving cell's box may reach over more bins than that of a resting one.
void PatchContact::reserveBins() {
  bin_offsets_.reserve(std::size_t(kMaxBins) * kMaxBins * kMaxBins + 1);
  bin_fill_.reserve(bin_offsets_.capacity());
  bin_cells_.reserve(kBinsPerCell * cells_.size());
}

void PatchContact::buildBins() {
  const Vector3 sizes = bounds_.sizes();
  for (int a = 0; a < 3; ++a)
    bins_[a] = int(std::clamp(std::ceil(sizes[a] / std::max(mean_edge_m_, 1e-12)), 1.0, double(kMaxBins)));
  while (!countBins()) {
    for (int& bins : bins_)
      bins = (bins + 1) / 2;
  }
  bin_fill_.assign(bin_offsets_.begin(), bin_offsets_.end() - 1);
  bin_cells_.resize(bin_offsets_.back());
  for (std::uint32_t c = 0; c < cells_.size(); ++c) {
    forBinsOf(cells_[c], [this, c](std::size_t bin) { bin_cells_[bin_fill_[bin]++] = c; });
  }
}

// Where the bins' cells begin; false when there is no room for them.
bool PatchContact::countBins() {
  const Vector3 sizes = bounds_.sizes();
  for (int a = 0; a < 3; ++a)
    bins_per_m_[a] = sizes[a] > 0.0 ? bins_[a] / sizes[a] : 0.0;
  bin_offsets_.assign(std::size_t(bins_[0]) * bins_[1] * bins_[2] + 1, 0);
  for (const Cell& cell : cells_)
    forBinsOf(cell, [this](std::size_t bin) { ++bin_offsets_[bin + 1]; });
  std::partial_sum(bin_offsets_.begin(), bin_offsets_.end(), bin_offsets_.begin());
  return bin_offsets_.back() <= bin_cells_.capacity();
}

// Where the patch before shows the vertices that it has; the others stay at their places.
void PatchContact::takeShown(const PatchContact& shown) {
  std::size_t other = 0;
  for (std::size_t slot = 0; slot < vertex_ids_.size(); ++slot) {
    while (other < shown.vertex_ids_.size() && shown.vertex_ids_[other] < vertex_ids_[slot])
      ++other;
    const bool known = other < shown.vertex_ids_.size() && shown.vertex_ids_[other] == vertex_ids_[slot];
    known_[slot] = known ? 1 : 0;
    from_m_[slot] = known ? shown.positions_m_[other] : to_m_[slot];
  }
  std::fill(known_.begin() + std::ptrdiff_t(vertex_ids_.size()), known_.end(), 0U);
}

// Gives the points that the patch before lacks the mean way of the known ones in their cells. While it sums them up,
// known_ counts them from kNeighbours on.
void PatchContact::placeUnknown() {
  if (std::find(known_.begin(), known_.begin() + std::ptrdiff_t(vertex_ids_.size()), 0U) ==
      known_.begin() + std::ptrdiff_t(vertex_ids_.size()))
    return;
  constexpr std::uint32_t kNeighbours = 2;
  for (const Cell& cell : cells_) {
    Vector3 way = Vector3::Zero();
    std::uint32_t count = 0;
    forCornersOf(cell, [&](std::uint32_t slot) {
      if (known_[slot] == 1) {
        way += from_m_[slot] - to_m_[slot];
        ++count;
      }
    });
    if (count == 0)
      continue;
    forCornersOf(cell, [&](std::uint32_t slot) {
      if (known_[slot] != 1) {
        from_m_[slot] += way / double(count);
        known_[slot] = std::max(known_[slot], kNeighbours) + 1;
      }
    });
  }
  for (std::size_t slot = 0; slot < from_m_.size(); ++slot) {
    if (known_[slot] > kNeighbours)
      from_m_[slot] = to_m_[slot] + (from_m_[slot] - to_m_[slot]) / double(known_[slot] - kNeighbours);
  }
}

// Where a place of the volume is shown, in this one of the cells.
std::optional<Vector3> PatchContact::shownPlaceIn(const Cell& cell, const Vector3& place_m) const {
  if (cell.isHexahedron()) {
    const Hexahedron& hexahedron = hexahedra_[cell.first];
    const auto local = trilinear(places_m_, hexahedron).invert(place_m, kSamePlace);
    if (local)
      return trilinear(positions_m_, hexahedron).value(*local);
  }
  for (std::uint32_t c = cell.first; c < cell.first + cell.cones; ++c) {
    const auto local = SurfaceCone(places_m_, cones_[c].points, kSamePlace * mean_edge_m_).invert(place_m);
    if (local)
      return SurfaceCone::value(positions_m_, cones_[c].points, *local);
  }
  return std::nullopt;
}

// The same in all cells; between lips, which have their places in common, the one that is nearer to `near_m`.
std::optional<Vector3> PatchContact::shownPlace(const Vector3& place_m, const Vector3& near_m) const {
  std::optional<Vector3> nearest;
  for (const Cell& cell : cells_) {
    if (!cell.place_box.contains(place_m))
      continue;
    const auto there = shownPlaceIn(cell, place_m);
    if (there && (!nearest || (*there - near_m).squaredNorm() < (*nearest - near_m).squaredNorm()))
      nearest = there;
  }
  return nearest;
}

void PatchContact::placeCutVertices(const PatchContact& shown) {
  if (shown.revision_ == revision_)
    return;
  for (std::size_t slot = 0; slot < vertex_ids_.size(); ++slot) {
    if (known_[slot] != 1)
      from_m_[slot] = shown.shownPlace(places_m_[slot], from_m_[slot]).value_or(from_m_[slot]);
  }
}

// Farthest that a point is from its place in the newest patch, along any axis, at either end of its way.
double PatchContact::widestWay() const {
  Vector3 widest = Vector3::Zero();
  for (std::size_t slot = 0; slot < positions_m_.size(); ++slot) {
    widest = widest.cwiseMax((from_m_[slot] - positions_m_[slot]).cwiseAbs());
    widest = widest.cwiseMax((to_m_[slot] - positions_m_[slot]).cwiseAbs());
  }
  return widest.maxCoeff();
}

void PatchContact::beginFrom(const PatchContact& shown, double duration_s) {
  if (cells_.empty() || shown.empty() || shown.session_ != session_ || !(duration_s > 0.0))
    return;
  takeShown(shown);
  placeUnknown();
  placeCutVertices(shown);
  for (const Cell& cell : cells_) {
    if (!cell.isHexahedron())
      from_m_[cones_[cell.first].points[0]] = centreOf(from_m_, cell);
  }
  duration_s_ = duration_s;
  gone_s_ = 0.0;
  const bool leave_boxes = widestWay() > margin_m_;
  for (std::size_t slot = 0; slot < from_m_.size(); ++slot)
    velocities_m_s_[slot] = (to_m_[slot] - from_m_[slot]) / duration_s;
  positions_m_ = from_m_;
  if (!leave_boxes)
    return;
  boundCells(0.0);
  buildBins();
}

void PatchContact::advance(double dt_s) {
  if (duration_s_ == 0.0)
    return;
  gone_s_ += dt_s;
  if (gone_s_ < duration_s_) {
    const double share = gone_s_ / duration_s_;
    for (std::size_t slot = 0; slot < from_m_.size(); ++slot)
      positions_m_[slot] = from_m_[slot] + share * (to_m_[slot] - from_m_[slot]);
    return;
  }
  positions_m_ = to_m_;
  std::fill(velocities_m_s_.begin(), velocities_m_s_.end(), Vector3::Zero());
  duration_s_ = 0.0;
}

PatchContact::CellPoint PatchContact::locate(const Vector3& point_m, std::uint32_t hint) const {
  if (cells_.empty() || !bounds_.contains(point_m))
    return {};
  if (hint < cells_.size() && cells_[hint].box.contains(point_m)) {
    const CellPoint at = locateIn(hint, point_m);
    if (at.found())
      return at;
  }
  const auto bin = binOf(point_m);
  const std::size_t b = binIndex(bin[0], bin[1], bin[2]);
  for (std::uint32_t at = bin_offsets_[b]; at < bin_offsets_[b + 1]; ++at) {
    const std::uint32_t c = bin_cells_[at];
    if (c == hint || !cells_[c].box.contains(point_m))
      continue;
    const CellPoint found = locateIn(c, point_m);
    if (found.found())
      return found;
  }
  return {};
}

PatchContact::CellPoint PatchContact::locateIn(std::uint32_t cell, const Vector3& point_m) const {
  const Cell& in = cells_[cell];
  if (in.isHexahedron()) {
    const auto local = trilinear(positions_m_, hexahedra_[in.first]).invert(point_m, kFaceTolerance);
    return local ? CellPoint{cell, *local, 0} : CellPoint{};
  }
  for (std::uint32_t c = 0; c < in.cones; ++c) {
    const Cone& cone = cones_[in.first + c];
    if (!SurfaceCone::mayContain(positions_m_, cone.points, cone.tolerance_m, point_m))
      continue;
    if (const auto local = shapeOf(cone).invert(point_m))
      return {cell, *local, c};
  }
  return {};
}

Trilinear PatchContact::trilinear(const std::vector<Vector3>& field, const Hexahedron& hexahedron) {
  Trilinear::Corners corners;
  for (std::size_t i = 0; i < corners.size(); ++i)
    corners[i] = field[hexahedron.corners[i]];
  return Trilinear(corners);
}

Vector3 PatchContact::value(const std::vector<Vector3>& field, const CellPoint& at) const {
  const Cell& cell = cells_[at.cell];
  return cell.isHexahedron() ? trilinear(field, hexahedra_[cell.first]).value(at.local)
                             : SurfaceCone::value(field, cones_[cell.first + at.cone].points, at.local);
}

PatchContact::Sample PatchContact::sample(const Vector3& point_m, std::uint32_t hint) const {
  Sample sample;
  sample.at = locate(point_m, hint);
  if (!sample.at.found())
    return sample;
  sample.intensity = volume_->sample(volumePoint(sample.at));
  sample.tissue = sample.intensity >= tissue_threshold_;
  return sample;
}

Vector3 PatchContact::gradient(const CellPoint& at) const {
  const Cell& cell = cells_[at.cell];
  Matrix3 position;
  Matrix3 place;
  if (cell.isHexahedron()) {
    position = trilinear(positions_m_, hexahedra_[cell.first]).jacobian(at.local);
    place = trilinear(places_m_, hexahedra_[cell.first]).jacobian(at.local);
  } else {
    const SurfaceCone cone = shapeOf(cones_[cell.first + at.cone]);
    position = cone.jacobian(positions_m_, at.local);
    place = cone.jacobian(places_m_, at.local);
  }
  const Vector3 by_local = place.transpose() * volume_->gradient(volumePoint(at));
  Matrix3 inverse;
  bool invertible = false;
  position.computeInverseWithCheck(inverse, invertible, 0.0);
  if (!invertible)
    return Vector3::Zero();
  return inverse.transpose() * by_local;
}

std::uint32_t PatchContact::cellOfId(std::uint32_t id) const {
  const auto it =
      std::lower_bound(cells_.begin(), cells_.end(), id, [](const Cell& cell, std::uint32_t v) { return cell.id < v; });
  return it != cells_.end() && it->id == id ? std::uint32_t(it - cells_.begin()) : kNoCell;
}

double PatchContact::youngsModulus(const Vector3& point_m, double radius_m) const {
  double sum = 0.0;
  std::size_t count = 0;
  for (const Cell& cell : cells_) {
    if ((cell.box.center() - point_m).squaredNorm() <= radius_m * radius_m) {
      sum += cell.stiffness_pa;
      ++count;
    }
  }
  if (count > 0)
    return sum / double(count);
  const CellPoint at = locate(point_m);
  return at.found() ? cells_[at.cell].stiffness_pa : 0.0;
}

bool PatchContact::isAtCut(const CellPoint& at) const {
  const Cell& cell = cells_[at.cell];
  if (!cell.cut)
    return false;
  if (cell.isHexahedron()) {
    const Hexahedron& hexahedron = hexahedra_[cell.first];
    const Vector3 lengths = trilinear(positions_m_, hexahedron).jacobian(at.local).colwise().norm();
    return isAtFace(hexahedron.cuts, at.local.cwiseProduct(lengths), lengths);
  }
  const Vector3 point_m = position(at);
  return std::any_of(cones_.begin() + cell.first, cones_.begin() + cell.first + cell.cones,
                     [&](const Cone& cone) { return cone.cut && shapeOf(cone).isAtBase(point_m, kAtFace); });
}

std::uint32_t PatchContact::cutFaceCount(std::uint32_t cell) const {
  const Cell& of = cells_[cell];
  if (of.isHexahedron())
    return std::uint32_t(std::bitset<6>(hexahedra_[of.first].cuts).count());
  const auto first = cones_.begin() + of.first;
  return std::uint32_t(std::count_if(first, first + of.cones, [](const Cone& cone) { return cone.cut; }));
}

bool PatchContact::gridGoesOn(const CellPoint& at) const {
  const Cell& cell = cells_[at.cell];
  if (!cell.isHexahedron())
    return cones_[cell.first + at.cone].missing_neighbour;
  return (hexahedra_[cell.first].missing_neighbours >> nearestFace(at.local)) & 1U;
}

}  // namespace soft_volume::core
