#include "soft_volume/tool/patch_contact.h"

#include <algorithm>
#include <cassert>
#include <numeric>
#include <string>
#include <utility>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

// Wide enough that rounding leaves no gap between two cells that share a face, narrow enough that nobody feels it.
constexpr double kFaceTolerance = 1e-6;  // in local coordinates
constexpr int kMaxBins = 24;             // per axis
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

}  // namespace

PatchContact::PatchContact(std::shared_ptr<const Volume> volume, double tissue_threshold)
    : volume_(std::move(volume)), tissue_threshold_(tissue_threshold) {
  assert(volume_ && !volume_->empty());
}

void PatchContact::clear() {
  cells_.clear();
  skipped_ = 0;
  bounds_.setEmpty();
  mean_edge_m_ = 0.0;
}

void PatchContact::check(const Topology& topology, const GridPatch& patch) {
  require(patch.session == topology.session && patch.revision == topology.revision,
          "made for revision " + std::to_string(patch.revision) + ", the grid is at " +
              std::to_string(topology.revision) + " (or the session differs)");
  require(patch.positions.size() == patch.vertex_ids.size() && patch.velocities.size() == patch.vertex_ids.size(),
          "positions and velocities do not match the vertices");
  require(allFinite(patch.positions) && allFinite(patch.velocities), "a position or velocity is not finite");
  fillSlots(patch.vertex_ids, topology.vertexCount(), vertex_slots_);
  fillSlots(patch.cell_ids, topology.cellCount(), cell_slots_);
  for (const std::uint32_t id : patch.cell_ids) {
    if (isHexahedral(topology.cell_types[id]))
      checkCorners(topology, id);
  }
}

void PatchContact::checkCorners(const Topology& topology, std::uint32_t id) const {
  const std::uint32_t begin = topology.cell_offsets[id];
  const auto missing = [&](std::uint32_t vertex) { return vertex_slots_[vertex] == kNoCell; };
  const auto corners = topology.connectivity.begin() + begin;
  if (std::any_of(corners, corners + 8, missing)) {
    require(false, "a vertex of cell " + std::to_string(id) + " is missing");
  }
}

// Bits of the faces behind which the grid has a cell that the patch lacks. An incision's face is a real surface.
std::uint8_t PatchContact::missingNeighbours(const Topology& topology, std::uint32_t id) const {
  if (!six_faces_each_)
    return 0;
  unsigned missing = 0;
  for (std::size_t face = 0; face < 6; ++face) {
    const std::size_t at = 6 * std::size_t(id) + face;
    const std::int32_t neighbour = topology.face_neighbours[at];
    const bool cut = at < topology.cut_faces.size() && topology.cut_faces[at] != 0;
    if (neighbour >= 0 && !cut && cell_slots_[std::size_t(neighbour)] == kNoCell)
      missing |= 1U << face;
  }
  return std::uint8_t(missing);
}

PatchContact::Cell PatchContact::makeCell(const Topology& topology, const GridPatch& patch, std::uint32_t id) const {
  Trilinear::Corners position;
  Trilinear::Corners place;
  Trilinear::Corners velocity;
  Cell cell;
  for (std::uint32_t i = 0; i < 8; ++i) {
    const std::uint32_t at = topology.cell_offsets[id] + cornerOrder(topology.cell_types[id])[i];
    const std::uint32_t vertex = topology.connectivity[at];
    const std::uint32_t slot = vertex_slots_[vertex];
    position[i] = patch.positions[slot].cast<double>();
    velocity[i] = patch.velocities[slot].cast<double>();
    place[i] = volume_->geometry().fromTexture(topology.texture_coordinates[vertex].cast<double>());
    cell.box.extend(position[i]);
  }
  // The image of a trilinear map lies in the hull of its corners; the margin keeps points within the face tolerance.
  const Vector3 margin = 10.0 * kFaceTolerance * cell.box.sizes() + Vector3::Constant(1e-9);
  cell.box = Box3(Vector3(cell.box.min() - margin), Vector3(cell.box.max() + margin));
  cell.position = Trilinear(position);
  cell.velocity = Trilinear(velocity);
  cell.place = Trilinear(place);
  cell.id = id;
  cell.missing_neighbours = missingNeighbours(topology, id);
  return cell;
}

void PatchContact::update(const Topology& topology, const GridPatch& patch) {
  check(topology, patch);
  clear();
  six_faces_each_ = std::all_of(topology.cell_types.begin(), topology.cell_types.end(), isHexahedral);
  for (const std::uint32_t id : patch.cell_ids) {
    if (isHexahedral(topology.cell_types[id])) {
      cells_.push_back(makeCell(topology, patch, id));
    } else {
      ++skipped_;
    }
  }
  if (cells_.empty())
    return;
  measure();
  buildBins();
}

void PatchContact::measure() {
  double edges = 0.0;
  for (const Cell& cell : cells_) {
    bounds_.extend(cell.box);
    edges += cell.position.jacobian(Vector3::Constant(0.5)).colwise().norm().mean();
  }
  mean_edge_m_ = edges / double(cells_.size());
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

void PatchContact::buildBins() {
  const Vector3 sizes = bounds_.sizes();
  for (int a = 0; a < 3; ++a) {
    bins_[a] = int(std::clamp(std::ceil(sizes[a] / std::max(mean_edge_m_, 1e-12)), 1.0, double(kMaxBins)));
    bins_per_m_[a] = sizes[a] > 0.0 ? bins_[a] / sizes[a] : 0.0;
  }
  bin_offsets_.assign(std::size_t(bins_[0]) * bins_[1] * bins_[2] + 1, 0);
  for (const Cell& cell : cells_)
    forBinsOf(cell, [this](std::size_t bin) { ++bin_offsets_[bin + 1]; });
  std::partial_sum(bin_offsets_.begin(), bin_offsets_.end(), bin_offsets_.begin());
  bin_fill_.assign(bin_offsets_.begin(), bin_offsets_.end() - 1);
  bin_cells_.resize(bin_offsets_.back());
  for (std::uint32_t c = 0; c < cells_.size(); ++c) {
    forBinsOf(cells_[c], [this, c](std::size_t bin) { bin_cells_[bin_fill_[bin]++] = c; });
  }
}

PatchContact::CellPoint PatchContact::locate(const Vector3& point_m, std::uint32_t hint) const {
  if (cells_.empty() || !bounds_.contains(point_m))
    return {};
  if (hint < cells_.size() && cells_[hint].box.contains(point_m)) {
    if (const auto local = cells_[hint].position.invert(point_m, kFaceTolerance))
      return {hint, *local};
  }
  const auto bin = binOf(point_m);
  const std::size_t b = binIndex(bin[0], bin[1], bin[2]);
  for (std::uint32_t at = bin_offsets_[b]; at < bin_offsets_[b + 1]; ++at) {
    const std::uint32_t c = bin_cells_[at];
    if (c == hint || !cells_[c].box.contains(point_m))
      continue;
    if (const auto local = cells_[c].position.invert(point_m, kFaceTolerance))
      return {c, *local};
  }
  return {};
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
  const Vector3 by_local = cell.place.jacobian(at.local).transpose() * volume_->gradient(volumePoint(at));
  Matrix3 inverse;
  bool invertible = false;
  cell.position.jacobian(at.local).computeInverseWithCheck(inverse, invertible, 0.0);
  if (!invertible)
    return Vector3::Zero();
  return inverse.transpose() * by_local;
}

std::uint32_t PatchContact::cellOfId(std::uint32_t id) const {
  const auto it =
      std::lower_bound(cells_.begin(), cells_.end(), id, [](const Cell& cell, std::uint32_t v) { return cell.id < v; });
  return it != cells_.end() && it->id == id ? std::uint32_t(it - cells_.begin()) : kNoCell;
}

bool PatchContact::gridGoesOn(const CellPoint& at) const {
  return (cells_[at.cell].missing_neighbours >> nearestFace(at.local)) & 1U;
}

}  // namespace soft_volume::core
