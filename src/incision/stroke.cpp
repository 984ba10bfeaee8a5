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
  return std::any_of(state_.edges.begin() + 1, state_.edges.end(), [&](const Edge& e) {
    return distanceFromLine(e.tip, state_.edges[0].tip, next.tip) > settings_.tolerance_m ||
           distanceFromLine(e.heel, state_.edges[0].heel, next.heel) > settings_.tolerance_m;
  });
}

void Stroke::emit(std::vector<SweptQuad>& quads) {
  const Edge first = state_.edges.front();
  const Edge last = state_.edges.back();
  quads.push_back({first.tip, first.heel, last.heel, last.tip});
  state_.edges = {last};
  state_.has_joint = true;
}

void Stroke::add(const SweptQuad& sweep, std::vector<SweptQuad>& quads) {
  const Edge from{sweep[0], sweep[1]};
  const Edge to{sweep[3], sweep[2]};
  if (state_.edges.empty() || !(state_.blade == from)) {
    end(quads);
    state_.edges = {from};
  }
  const auto moved = [&](const Edge& e) {
    return std::max((e.tip - state_.edges[0].tip).norm(), (e.heel - state_.edges[0].heel).norm());
  };
  if (state_.edges.size() > 1 && moved(state_.edges.back()) >= settings_.least_width_m && leaves(to))
    emit(quads);
  state_.edges.push_back(to);
  state_.blade = to;
  if (moved(to) >= settings_.stride_m)
    emit(quads);
}

void Stroke::end(std::vector<SweptQuad>& quads) {
  if (state_.edges.size() > 1 && !(state_.edges.back() == state_.edges.front()))
    emit(quads);
  state_.edges.clear();
  state_.has_joint = false;
}

std::optional<std::array<Vector3, 2>> Stroke::joint() const {
  if (!state_.has_joint)
    return std::nullopt;
  return std::array<Vector3, 2>{state_.edges.front().tip, state_.edges.front().heel};
}

void Stroke::moveJoint(const std::array<Vector3, 2>& edge_m) {
  assert(state_.has_joint && state_.lips.edge_m == *joint());
  state_.edges.front() = {edge_m[0], edge_m[1]};
  for (std::size_t end = 0; end < 2; ++end)
    state_.lips.start_m[end] += edge_m[end] - state_.lips.edge_m[end];
  state_.lips.edge_m = edge_m;
}

}  // namespace soft_volume::core
