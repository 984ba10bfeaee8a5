#include "soft_volume/tool/scalpel.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace soft_volume::core {
namespace {

constexpr double kLookDistance = 0.001;  // metres between two looks for tissue, along the edge and along the sweep
constexpr int kMaxLooks = 32;
constexpr double kLeaveDistance = 0.005;  // metres in air that end a stroke

int looks(double distance_m) {
  return int(std::clamp(std::ceil(distance_m / kLookDistance), 1.0, double(kMaxLooks)));
}

}  // namespace

bool Scalpel::edgeInTissue(const PatchContact& field, const Vector3& tip, const Vector3& heel) const {
  const int count = looks(blade_length_m_);
  for (int i = 0; i <= count; ++i) {
    if (field.sample(tip + double(i) / count * (heel - tip)).tissue)
      return true;
  }
  return false;
}

// A fast blade may jump over thin tissue from air to air.
bool Scalpel::sweptTissue(const PatchContact& field, const Edge& from, const Edge& to) const {
  const int count = looks(std::max((to.tip - from.tip).norm(), (to.heel - from.heel).norm()));
  for (int i = 1; i < count; ++i) {
    const double t = double(i) / count;
    if (edgeInTissue(field, from.tip + t * (to.tip - from.tip), from.heel + t * (to.heel - from.heel)))
      return true;
  }
  return false;
}

bool Scalpel::lift() {
  start_.reset();
  in_air_m_ = 0.0;
  return std::exchange(has_cut_, false);
}

Scalpel::Sweep Scalpel::cut(const PatchContact& field, const Pose& pose) {
  Edge now;
  now.tip = pose.position_m;
  now.heel = pose * Vector3(0.0, 0.0, blade_length_m_);
  now.in_tissue = edgeInTissue(field, now.tip, now.heel);
  if (!start_) {
    start_ = now;
    start_in_tissue_ = now.in_tissue;
    return {};
  }
  start_->in_tissue = now.in_tissue;
  const bool tissue = start_in_tissue_ || now.in_tissue || sweptTissue(field, *start_, now);
  const double moved = std::max((now.tip - start_->tip).norm(), (now.heel - start_->heel).norm());
  const double in_air_m = tissue ? 0.0 : in_air_m_ + moved;
  if (!tissue && (!has_cut_ || in_air_m >= kLeaveDistance)) {
    start_ = now;
    in_air_m_ = 0.0;
    return {std::nullopt, std::exchange(has_cut_, false)};
  }
  if (moved < min_move_m_)
    return {};
  const SweptQuad quad{start_->tip, start_->heel, now.heel, now.tip};
  start_ = now;
  start_in_tissue_ = now.in_tissue;
  has_cut_ = true;
  in_air_m_ = in_air_m;
  return {quad, false};
}

}  // namespace soft_volume::core
