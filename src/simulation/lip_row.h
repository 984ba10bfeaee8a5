#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

#include "soft_volume/grid/lattice.h"
#include "soft_volume/grid/lip_contact.h"

namespace soft_volume::core {

/// Lips act on each other fully while the points of a contact are within the first of these distances of each other, in
/// shortest cell edges, and no more from the second on; likewise with the size of their mean plane's area element,
/// which the angle between them and strain shrink (0.6: 106 degrees, 0.3: 145 degrees).
constexpr double kLipReach[2] = {0.5, 1.0};
constexpr double kLipFacing[2] = {0.6, 0.3};
/// Deeper than this, in shortest cell edges, the force grows no more: lips that come back from where they slid past
/// each other are pushed apart, not blown.
constexpr double kLipDepth = 0.04;

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

/// A contact at given places. Its energy is hold e(gap), e being lipEnergy(), so with p = lipForce() the force on a
/// corner of a LipRow is
///
///   weight (hold p n' + e slide) + sum over k of along[k] (hold p tilt[k] + e shrink[k]).
///
/// That is all of its derivative: the forces keep both momenta and make no energy, however lips slide and turn.
struct LipState {
  Vector3 normal = Vector3::Zero();
  double gap_m = 0.0;
  double hold = 0.0;  ///< 0 to 1, how much of the contact is left
  std::array<Vector3, 2> tilt = {Vector3::Zero(), Vector3::Zero()};
  Vector3 slide = Vector3::Zero();
  std::array<Vector3, 2> shrink = {Vector3::Zero(), Vector3::Zero()};
};

/// Falls from 1 at `from` to 0 at `to`, with its derivative.
struct LipFade {
  double value;
  double slope;
  LipFade(double x, double from, double to) {
    const double y = std::min(1.0, std::max(0.0, (x - to) / (from - to)));
    value = y * y * (3.0 - 2.0 * y);
    slope = 6.0 * y * (1.0 - y) / (from - to);
  }
};

/// `apart` is x_1 - x_0, `t` are t_0' and t_1'.
inline LipState lipState(const Vector3& apart, const std::array<Vector3, 2>& t, double shortest_edge_m) {
  LipState state;
  const double squared_m2 = shortest_edge_m * shortest_edge_m;
  const LipFade near(apart.squaredNorm() / squared_m2, kLipReach[0] * kLipReach[0], kLipReach[1] * kLipReach[1]);
  const Vector3 area = t[0].cross(t[1]);
  const double size = area.norm();
  const LipFade facing(size, kLipFacing[0], kLipFacing[1]);
  state.hold = near.value * facing.value;
  if (state.hold <= 0.0)
    return state;
  state.normal = area / size;
  state.gap_m = state.normal.dot(apart);
  const Vector3 slid = (apart - state.gap_m * state.normal) / size;
  state.tilt = {t[1].cross(slid), slid.cross(t[0])};
  state.slide = -2.0 * facing.value * near.slope / squared_m2 * apart;
  const Vector3 shrink = -near.value * facing.slope * state.normal;
  state.shrink = {t[1].cross(shrink), shrink.cross(t[0])};
  return state;
}
LipState lipState(const LipRow& row, const std::vector<Vector3>& displacements_m, double shortest_edge_m);

/// Force of the penalty, newton: stiffness times depth up to `most_m`, no more beyond.
inline double lipForce(double stiffness_n_m, double gap_m, double most_m) {
  const double depth = -gap_m < most_m ? -gap_m : most_m;
  return depth > 0.0 ? stiffness_n_m * depth : 0.0;
}
/// Its energy, joule.
double lipEnergy(double stiffness_n_m, double gap_m, double most_m);

}  // namespace soft_volume::core
