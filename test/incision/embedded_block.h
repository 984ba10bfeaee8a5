#pragma once

#include <map>
#include <utility>

#include "incision/cut_cases.h"
#include "soft_volume/incision/embedding.h"

namespace soft_volume::core {

/// A block whose lattice follows its cuts.
struct EmbeddedBlock : CutBlock {
  explicit EmbeddedBlock(const Vector3i& dims, double h = kH) : CutBlock(dims, h), embedding(mesh) {}

  EmbeddingChange cutAndFollow(const std::vector<SweptQuad>& quads) {
    cut(quads);
    return embedding.update(mesh, lattice);
  }

  Embedding embedding;
};

/// Cuts through the whole block, each along another plane near its middle.
inline void cutAtRandom(EmbeddedBlock& block, int cuts, std::mt19937& random) {
  std::uniform_real_distribution<double> part(0.0, 1.0);
  std::normal_distribution<double> normal;
  for (int n = 0; n < cuts; ++n) {
    const Vector3 at = block.size().cwiseProduct(Vector3(part(random), part(random), part(random)));
    const double half_m = (n % 2 == 0 ? 20.0 : 1.0 + part(random)) * kH;  // every other one ends inside
    block.cutAndFollow({squareQuad(at, Vector3(normal(random), normal(random), normal(random)), half_m)});
  }
}

}  // namespace soft_volume::core
