#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "soft_volume/grid/lattice.h"
#include "soft_volume/grid/lip_contact.h"

namespace soft_volume::core {

/// Lips act on each other as long as they face each other (the shrinking of their mean plane's area, by strain or by
/// the angle between them, tells) and the points of a contact are not farther apart than this, in shortest cell edges.
constexpr double kLipFacing = 0.5;
constexpr double kLipReach = 1.0;
/// Deeper than this, in shortest cell edges, the force grows no more: lips that come back from where they slid past
/// each other are pushed apart, not blown.
constexpr double kLipDepth = 0.1;

/// A contact as the vertices of the lattice see it. With u their displacements,
///
///   x_1 - x_0 = sum of weight u       the way from lip 0 to lip 1, which is none at rest,
///   t_k' = t_k + sum of along[k] u    the mean of both lips' tangents; n' along t_0' x t_1' is the normal,
///   gap = n' . (x_1 - x_0)            negative where the lips are in each other.
///
/// Weights sum to 0, so forces weight F keep momentum.
struct LipRow {
  struct Corner {
    std::uint32_t vertex;
    double weight;
    std::array<double, 2> along;  ///< 1/m
  };
  std::vector<Corner> corners;      ///< by vertex; those without any weight are left out
  std::array<Vector3, 2> tangents;  ///< t_0 x t_1 is the normal at rest
};

/// Without corners where both lips hang on the same vertices with the same weights.
LipRow makeLipRow(const Lattice& lattice, const LipContact& contact);

/// What a contact is like at given places.
struct LipGap {
  Vector3 normal = Vector3::Zero();
  double gap_m = 0.0;
  bool facing = false;
};
/// `apart` is x_1 - x_0, `tangents` are t_0' and t_1'.
inline LipGap lipGap(const Vector3& apart, const std::array<Vector3, 2>& tangents, double reach_m) {
  const Vector3 area = tangents[0].cross(tangents[1]);
  const double size = area.norm();
  const bool facing = size >= kLipFacing && apart.squaredNorm() <= reach_m * reach_m;
  const Vector3 normal = facing ? Vector3(area / size) : Vector3::Zero();
  return {normal, normal.dot(apart), facing};
}
LipGap lipGap(const LipRow& row, const std::vector<Vector3>& displacements_m, double reach_m);

/// Force of the penalty, newton: stiffness times depth up to `most_m`, no more beyond.
inline double lipForce(double stiffness_n_m, double gap_m, double most_m) {
  const double depth = -gap_m < most_m ? -gap_m : most_m;
  return depth > 0.0 ? stiffness_n_m * depth : 0.0;
}
/// Its energy, joule.
double lipEnergy(double stiffness_n_m, double gap_m, double most_m);

}  // namespace soft_volume::core
