#include "soft_volume/incision/stroke.h"

#include <algorithm>
#include <cassert>

namespace soft_volume::core {
namespace {

/// Distance of p from the line through a and b; from a where they are one.
double distanceFromLine(const Vector3& p, const Vector3& a, const Vector3& b) {
  const Vector3 along = b - a;
  const double length = along.norm();
  return length > 0.0 ? along.cross(p - a).norm() / length : (p - a).norm();
}

}  // namespace

/// Whether an edge on the way lies beside the quad from the first edge to `next`: off the paths of its two ends.
bool Stroke::leaves(const Edge& next) const {
  return std::any_of(edges_.begin() + 1, edges_.end(), [&](const Edge& e) {
    return distanceFromLine(e.tip, edges_[0].tip, next.tip) > settings_.tolerance_m ||
           distanceFromLine(e.heel, edges_[0].heel, next.heel) > settings_.tolerance_m;
  });
}

void Stroke::emit(std::vector<SweptQuad>& quads) {
  const Edge first = edges_.front();
  const Edge last = edges_.back();
  quads.push_back({first.tip, first.heel, last.heel, last.tip});
  edges_ = {last};
  has_joint_ = true;
}

void Stroke::add(const SweptQuad& sweep, std::vector<SweptQuad>& quads) {
  const Edge from{sweep[0], sweep[1]};
  const Edge to{sweep[3], sweep[2]};
  if (edges_.empty() || !(blade_ == from)) {
    end(quads);
    edges_ = {from};
  }
  const auto moved = [&](const Edge& e) {
    return std::max((e.tip - edges_[0].tip).norm(), (e.heel - edges_[0].heel).norm());
  };
  if (edges_.size() > 1 && moved(edges_.back()) >= settings_.least_width_m && leaves(to))
    emit(quads);
  edges_.push_back(to);
  blade_ = to;
  if (moved(to) >= settings_.stride_m)
    emit(quads);
}

void Stroke::end(std::vector<SweptQuad>& quads) {
  if (edges_.size() > 1 && !(edges_.back() == edges_.front()))
    emit(quads);
  edges_.clear();
  has_joint_ = false;
}

std::optional<std::array<Vector3, 2>> Stroke::joint() const {
  if (!has_joint_)
    return std::nullopt;
  return std::array<Vector3, 2>{edges_.front().tip, edges_.front().heel};
}

void Stroke::moveJoint(const std::array<Vector3, 2>& edge_m) {
  assert(has_joint_ && lips_.edge_m == *joint());
  edges_.front() = {edge_m[0], edge_m[1]};
  lips_.edge_m = edge_m;
}

}  // namespace soft_volume::core
