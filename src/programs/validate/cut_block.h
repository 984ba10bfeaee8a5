#pragma once

#include <cstdint>
#include <random>
#include <vector>

#include "blocks.h"
#include "soft_volume/incision/blade_cut.h"
#include "soft_volume/incision/embedding.h"
#include "soft_volume/incision/lip_contacts.h"
#include "soft_volume/incision/piece_shape.h"

namespace soft_volume::core::validate {

constexpr double kCutSpacingM = 0.005;

/// A block, the mesh of what it consists of, and the embedding through which the block follows its cuts.
struct CutBlock {
  explicit CutBlock(const Vector3i& cells, double spacing_m = kCutSpacingM, const Material& material = tissue());

  /// Cuts tissue whose mesh vertices are at `positions_m`; the lattice follows.
  BladeCutResult cut(const std::vector<SweptQuad>& quads, double reach_m, std::vector<Vector3>& positions_m);
  /// Cuts tissue at rest.
  BladeCutResult cut(const std::vector<SweptQuad>& quads);
  /// Cuts the tissue of a simulation of the block, which adopts it; lips press on each other or go through each other.
  BladeCutResult cut(const std::vector<SweptQuad>& quads, Simulation& simulation, bool lips_press);

  std::vector<LipContact> lips() const;
  /// Where the mesh's vertices are when the lattice's are at `positions_m`.
  std::vector<Vector3> places(const std::vector<Vector3>& positions_m) const;
  Vector3 size() const { return block.lattice.dims.cast<double>().cwiseProduct(block.lattice.spacing_m); }
  double h() const { return block.edge(); }

  Block block;
  CutMesh mesh;
  Embedding embedding;
};

/// A square of half-width `half_m` around `middle_m`; `turn_rad` turns it in its plane.
SweptQuad squareQuad(const Vector3& middle_m, const Vector3& normal, double half_m, double turn_rad = 0.0);

/// Sum over all pieces, m^3.
double totalVolume(const CutMesh& mesh);
/// The part of the lattice that every vertex belongs to, named by its lowest vertex: they hang together through cells.
std::vector<std::uint32_t> latticeParts(const Lattice& lattice);
/// At how many places of the lattice there are copies of a cell.
std::size_t cutPlaces(const Lattice& lattice);

/// Two oblique incisions through the whole block, which cross near its middle.
void cutCrosswise(CutBlock& tissue);

/// Strokes that are bad for a mesh, eight kinds in turn: planes along an axis and oblique ones, pieces of planes much
/// smaller and much larger than the block, curved paths of many quads, planes through vertices, edges and faces
/// exactly, and at 1 % and 99 % of edges. Sooner or later each crosses what was cut before. In tissue at rest.
class RandomStrokes {
 public:
  RandomStrokes(unsigned seed, int cells, double h) : random_(seed), cells_(cells), h_(h) {}
  std::vector<SweptQuad> next();

 private:
  double range(double low, double high) { return std::uniform_real_distribution<double>(low, high)(random_); }
  Vector3 anywhere();
  Vector3 atNode(double share);
  Vector3 anyNormal();
  Vector3 anyAxis();
  std::vector<SweptQuad> curve();

  std::mt19937 random_;
  int cells_;
  double h_;
  unsigned count_ = 0;
};

}  // namespace soft_volume::core::validate
