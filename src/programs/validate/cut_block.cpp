#include "cut_block.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <set>

#include "soft_volume/incision/stroke.h"

namespace soft_volume::core::validate {

CutBlock::CutBlock(const Vector3i& cells, double spacing_m, const Material& material)
    : block(cells, Vector3::Constant(spacing_m), material), mesh(block.lattice), embedding(mesh) {}

BladeCutResult CutBlock::cut(const std::vector<SweptQuad>& quads, double reach_m, std::vector<Vector3>& positions_m) {
  Lips lips;
  const BladeCutResult result =
      cutMesh(mesh, block.lattice, block.materials, CutResolution(), quads, reach_m, lips, positions_m);
  embedding.update(mesh, block.lattice);
  return result;
}

BladeCutResult CutBlock::cut(const std::vector<SweptQuad>& quads) {
  std::vector<Vector3> positions = mesh.restPositions();
  return cut(quads, 0.0, positions);
}

BladeCutResult CutBlock::cut(const std::vector<SweptQuad>& quads, Simulation& simulation, bool lips_press) {
  std::vector<Vector3> positions = places(simulation.positions());
  const BladeCutResult result = cut(quads, simulation.reach(), positions);
  simulation.adoptTopology();
  if (lips_press)
    simulation.setLips(lips());
  return result;
}

std::vector<LipContact> CutBlock::lips() const {
  return findLipContacts(mesh, embedding, block.lattice, block.materials, IncisionSettings());
}

std::vector<Vector3> CutBlock::places(const std::vector<Vector3>& positions_m) const {
  std::vector<Vector3> placed(mesh.vertexCount());
  for (std::uint32_t v = 0; v < placed.size(); ++v)
    placed[v] = embedding.place(mesh, block.lattice, positions_m, v);
  return placed;
}

SweptQuad squareQuad(const Vector3& middle_m, const Vector3& normal, double half_m, double turn_rad) {
  const Vector3 n = normal.normalized();
  const Vector3 u0 = n.unitOrthogonal();
  const Vector3 u = half_m * (std::cos(turn_rad) * u0 + std::sin(turn_rad) * n.cross(u0));
  const Vector3 v = n.cross(u);
  return {middle_m - u - v, middle_m + u - v, middle_m + u + v, middle_m - u + v};
}

double totalVolume(const CutMesh& mesh) {
  double sum = 0.0;
  for (std::uint32_t p = 0; p < mesh.pieces().size(); ++p)
    sum += volumeOf(solidOf(mesh, p));
  return sum;
}

std::vector<std::uint32_t> latticeParts(const Lattice& lattice) {
  std::vector<std::uint32_t> parents(lattice.vertexCount());
  std::iota(parents.begin(), parents.end(), 0U);
  const auto rootOf = [&](std::uint32_t v) {
    while (parents[v] != v)
      v = parents[v] = parents[parents[v]];
    return v;
  };
  for (const auto& cell : lattice.cells) {
    for (const std::uint32_t v : cell) {
      const std::uint32_t a = rootOf(cell[0]);
      const std::uint32_t b = rootOf(v);
      parents[std::max(a, b)] = std::min(a, b);
    }
  }
  for (std::uint32_t v = 0; v < parents.size(); ++v)
    parents[v] = rootOf(v);
  return parents;
}

std::size_t cutPlaces(const Lattice& lattice) {
  std::set<std::uint32_t> places;
  for (std::size_t cell = 0; cell < lattice.cellCount(); ++cell) {
    if (lattice.shares[cell] < 1.0)
      places.insert(lattice.parent_cells[cell]);
  }
  return places.size();
}

Vector3 RandomStrokes::anywhere() {
  const double x = range(0, cells_);
  const double y = range(0, cells_);
  return h_ * Vector3(x, y, range(0, cells_));
}

void cutCrosswise(CutBlock& tissue) {
  const double h = tissue.h();
  const Vector3 middle = 0.5 * tissue.size();
  tissue.cut({squareQuad(middle + h * Vector3(0.1, 0.23, 0.05), {0.1, 0.2, 1.0}, 20.0 * h)});
  tissue.cut({squareQuad(middle + h * Vector3(0.03, 0.0, 0.0), {1.0, 0.15, -0.2}, 20.0 * h)});
}

/// `share` of an edge beyond a node, along all axes.
Vector3 RandomStrokes::atNode(double share) {
  return h_ * ((anywhere() / h_).array().floor() + share).matrix();
}

Vector3 RandomStrokes::anyNormal() {
  const double x = range(-1, 1);
  const double y = range(-1, 1);
  return {x, y, range(-1, 1) + 0.01};
}

Vector3 RandomStrokes::anyAxis() {
  return Vector3::Unit(static_cast<int>(random_() % 3));
}

/// An upright edge led along a sine from before the block to behind it, or to somewhere inside, as a hand would.
std::vector<SweptQuad> RandomStrokes::curve() {
  const double end = range(0.4, 1.2) * cells_;
  const double waves = range(0.3, 1.2);
  const double low = range(-0.2, 0.5) * cells_;
  const double lean = range(-0.3, 0.3);
  const double middle = range(0.3, 0.7) * cells_;
  const auto tip = [&](double x) -> Vector3 {
    return h_ * Vector3(x, middle + 0.2 * cells_ * std::sin(waves * x), low);
  };
  const Vector3 up = 1.2 * cells_ * h_ * Vector3(0.0, lean, 1.0);
  Stroke stroke({0.5 * h_, 0.2 * h_, 0.03 * h_});
  std::vector<SweptQuad> quads;
  constexpr double kSweep = 0.1;
  for (double x = -1.0; x < end; x += kSweep)
    stroke.add({tip(x), tip(x) + up, tip(x + kSweep) + up, tip(x + kSweep)}, quads);
  stroke.end(quads);
  return quads;
}

std::vector<SweptQuad> RandomStrokes::next() {
  const unsigned kind = count_++ % 8;
  const bool longer = random_() % 3 == 0;
  const double half_m = h_ * (longer ? 2.5 * cells_ : range(0.3, 0.4 * cells_));
  const double turn = range(0.0, 3.0);
  switch (kind) {
    case 0:
      return {squareQuad(anywhere(), anyAxis(), 2.5 * cells_ * h_, turn)};
    case 1:
      return {squareQuad(anywhere(), anyNormal(), 2.5 * cells_ * h_, turn)};
    case 2:
      return {squareQuad(anywhere(), anyNormal(), range(0.3, 0.9) * h_, turn)};
    case 3:
      return curve();
    case 4:
      return {squareQuad(atNode(0.0), {1.0, 1.0, random_() % 2 == 0 ? 1.0 : -1.0}, half_m, turn)};
    case 5:
      return {squareQuad(atNode(0.0), {1.0, random_() % 2 == 0 ? 1.0 : -1.0, 0.0}, half_m, turn)};
    case 6:
      return {squareQuad(atNode(0.0), anyAxis(), half_m, turn)};
    default:
      return {squareQuad(atNode(random_() % 2 == 0 ? 0.01 : 0.99), anyAxis(), half_m, turn)};
  }
}

}  // namespace soft_volume::core::validate
