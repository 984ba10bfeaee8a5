#include "lip_set.h"

#include <algorithm>

#include "soft_volume/common/parallel.h"

namespace soft_volume::core {
namespace {

/// Fewer are done sooner by one thread than several have met.
constexpr std::size_t kParallel = 1024;
constexpr std::size_t kChunk = 64;
/// A gap that counts as none for Newton's method, in shortest cell edges.
constexpr double kAboutToMeet = 1e-3;

template <typename T>
std::size_t bytesOf(const std::vector<T>& values) {
  return values.capacity() * sizeof(T);
}

}  // namespace

template <typename Real>
void LipSet<Real>::build(const Lattice& lattice, const std::vector<LipContact>& contacts, const SolveSet<Real>& set) {
  shortest_edge_m_ = lattice.spacing_m.minCoeff();
  most_m_ = kLipDepth * shortest_edge_m_;
  reach_m_ = kLipReach[1] * shortest_edge_m_;
  contacts_.clear();
  corners_.clear();
  nodes_.clear();
  std::vector<std::uint32_t> vertices;
  for (const LipContact& contact : contacts) {
    const LipRow row = makeLipRow(lattice, contact);
    const auto local = [&](const LipRow::Corner& corner) { return set.localVertex(corner.vertex); };
    const bool present = std::all_of(row.corners.begin(), row.corners.end(), [&](const LipRow::Corner& corner) {
      return local(corner) != SolveSet<Real>::kAbsent;
    });
    const bool moves = present && std::any_of(row.corners.begin(), row.corners.end(),
                                              [&](const LipRow::Corner& corner) { return set.moves(local(corner)); });
    if (!moves)
      continue;
    contacts_.push_back({row.tangents, contact.area_m2, 1.0 / contact.stiffness_n_m, contact.opening_n,
                         static_cast<std::uint32_t>(corners_.size())});
    for (const LipRow::Corner& corner : row.corners) {
      corners_.push_back({local(corner),
                          static_cast<Real>(corner.weight),
                          {static_cast<Real>(corner.along[0]), static_cast<Real>(corner.along[1])}});
      vertices.push_back(local(corner));
    }
  }
  states_.assign(contacts_.size(), {});
  pulls_.assign(corners_.size(), 0.0);
  depths_m_.assign(contacts_.size(), 0.0);
  stiff_.assign(contacts_.size(), 0);
  forces_n_.assign(contacts_.size(), {});
  links_.resize(corners_.size());
  if (contacts_.empty())
    return;
  std::sort(vertices.begin(), vertices.end());
  vertices.erase(std::unique(vertices.begin(), vertices.end()), vertices.end());
  nodes_.resize(vertices.size() + 1);
  for (std::size_t n = 0; n < vertices.size(); ++n)
    nodes_[n].vertex = vertices[n];
  for (Corner& corner : corners_) {
    const auto place = std::lower_bound(vertices.begin(), vertices.end(), corner.node);
    corner.node = static_cast<std::uint32_t>(place - vertices.begin());
    ++nodes_[corner.node + 1].links_begin;
  }
  for (std::size_t n = 1; n < nodes_.size(); ++n)
    nodes_[n].links_begin += nodes_[n - 1].links_begin;
  std::vector<std::uint32_t> next;
  for (const Node& node : nodes_)
    next.push_back(node.links_begin);
  contacts_.emplace_back();
  contacts_.back().corners_begin = static_cast<std::uint32_t>(corners_.size());
  for (std::uint32_t n = 0; n + 1 < contacts_.size(); ++n) {
    for (std::uint32_t c = contacts_[n].corners_begin; c < contacts_[n + 1].corners_begin; ++c)
      links_[next[corners_[c].node]++] = {n, c};
  }
}

template <typename Real>
template <typename Pass>
void LipSet<Real>::overAll(std::size_t count, int threads, const Pass& pass) const {
  const std::size_t chunks = (count + kChunk - 1) / kChunk;
  parallelFor(static_cast<std::ptrdiff_t>(chunks), count < kParallel ? 1 : threads, [&](std::ptrdiff_t chunk) {
    const std::size_t begin = static_cast<std::size_t>(chunk) * kChunk;
    for (std::size_t n = begin; n < std::min(count, begin + kChunk); ++n)
      pass(n);
  });
}

/// Where the rule takes a vertex, as the kernel's advance() does; without a rule it stays.
template <typename Real>
void LipSet<Real>::readNode(const KernelView<Real>& view, const AdvanceRule<Real>* rule, Node& node) const {
  const std::uint32_t v = node.vertex;
  for (int d = 0; d < 3; ++d)
    node.displacement_m[d] = double(view.displacement[d][v]);
  node.ahead_m.setZero();
  node.yield_m_n = 0.0;
  if (rule == nullptr)
    return;
  const double dt = double(rule->dt);
  const double kept = rule->damped ? 1.0 / (1.0 + dt * double(view.damping_rate[v])) : 1.0;
  node.yield_m_n = (dt * dt * kept + double(rule->half_dt_squared)) * double(view.inverse_mass[v]);
  for (int d = 0; d < 3; ++d)
    node.ahead_m[d] = dt * kept * double(view.velocity[d][v]) + node.yield_m_n * double(view.force[d][v]);
}

/// How the gap of a contact follows a corner.
template <typename Real>
Vector3 LipSet<Real>::gradient(std::size_t contact, const Corner& corner) const {
  const LipState& state = states_[contact];
  return double(corner.weight) * state.normal + double(corner.along[0]) * state.tilt[0] +
         double(corner.along[1]) * state.tilt[1];
}

template <typename Real>
void LipSet<Real>::findDepth(std::size_t n, double most_m) {
  const Contact& contact = contacts_[n];
  const std::uint32_t end = contacts_[n + 1].corners_begin;
  std::array<Vector3, 2> tangents = contact.tangents;
  Vector3 apart = Vector3::Zero();
  for (std::uint32_t c = contact.corners_begin; c < end; ++c) {
    const Vector3& u = nodes_[corners_[c].node].displacement_m;
    apart += double(corners_[c].weight) * u;
    tangents[0] += double(corners_[c].along[0]) * u;
    tangents[1] += double(corners_[c].along[1]) * u;
  }
  states_[n] = lipState(apart, tangents, shortest_edge_m_);
  depths_m_[n] = 0.0;
  if (states_[n].hold <= 0.0)
    return;
  double gap_m = std::max(states_[n].gap_m, -most_m);
  for (std::uint32_t c = contact.corners_begin; c < end; ++c)
    gap_m += gradient(n, corners_[c]).dot(nodes_[corners_[c].node].ahead_m);
  depths_m_[n] = std::max(0.0, -gap_m);
  for (std::uint32_t c = contact.corners_begin; depths_m_[n] > 0.0 && c < end; ++c)
    pulls_[c] = gradient(n, corners_[c]).norm();
}

template <typename Real>
double LipSet<Real>::stepForce(std::size_t n) const {
  double yield = 0.0;
  for (std::uint32_t c = contacts_[n].corners_begin; c < contacts_[n + 1].corners_begin; ++c)
    yield += pulls_[c] * nodes_[corners_[c].node].pressed_m3_n;
  return depths_m_[n] / (contacts_[n].compliance_m_n / states_[n].hold + yield / contacts_[n].area_m2);
}

/// From the force along the gradient of the gap, which is more or less than that of the present depth.
template <typename Real>
void LipSet<Real>::setForce(std::size_t n, double pressed_n) {
  const LipState& state = states_[n];
  const double depth_m = std::max(0.0, -state.gap_m);
  const double energy_j = pressed_n > 0.0 ? pressed_n / state.hold * (depth_m - 0.5 * std::min(depth_m, most_m_)) : 0.0;
  forces_n_[n].by_weight = (pressed_n + contacts_[n].opening_n) * state.normal + energy_j * state.slide;
  for (std::size_t k = 0; k < 2; ++k)
    forces_n_[n].by_along[k] = pressed_n * state.tilt[k] + energy_j * state.shrink[k];
}

template <typename Real>
void LipSet<Real>::gatherForces(const KernelView<Real>& view, int threads) {
  overAll(nodes_.size() - 1, threads, [&](std::size_t n) {
    Vector3 sum = Vector3::Zero();
    for (std::uint32_t l = nodes_[n].links_begin; l < nodes_[n + 1].links_begin; ++l) {
      const std::uint32_t contact = links_[l].contact;
      if (depths_m_[contact] <= 0.0 && contacts_[contact].opening_n == 0.0)
        continue;
      const Force& force = forces_n_[contact];
      const Corner& corner = corners_[links_[l].corner];
      sum += double(corner.weight) * force.by_weight + double(corner.along[0]) * force.by_along[0] +
             double(corner.along[1]) * force.by_along[1];
    }
    for (int d = 0; d < 3; ++d)
      view.force[d][nodes_[n].vertex] += static_cast<Real>(sum[d]);
  });
}

template <typename Real>
void LipSet<Real>::addForces(const KernelView<Real>& view, const AdvanceRule<Real>& rule, int threads) {
  if (empty())
    return;
  const std::size_t count = contacts_.size() - 1;
  overAll(nodes_.size() - 1, threads, [&](std::size_t n) { readNode(view, &rule, nodes_[n]); });
  overAll(count, threads, [&](std::size_t n) { findDepth(n, most_m_); });
  overAll(nodes_.size() - 1, threads, [&](std::size_t n) {
    double area_m2 = 0.0;
    for (std::uint32_t l = nodes_[n].links_begin; l < nodes_[n + 1].links_begin; ++l) {
      if (depths_m_[links_[l].contact] > 0.0)
        area_m2 += pulls_[links_[l].corner] * contacts_[links_[l].contact].area_m2;
    }
    nodes_[n].pressed_m3_n = nodes_[n].yield_m_n * area_m2;
  });
  overAll(count, threads, [&](std::size_t n) { setForce(n, depths_m_[n] > 0.0 ? stepForce(n) : 0.0); });
  gatherForces(view, threads);
}

template <typename Real>
void LipSet<Real>::addPresentForces(const KernelView<Real>& view, int threads) {
  if (empty())
    return;
  const std::size_t count = contacts_.size() - 1;
  overAll(nodes_.size() - 1, threads, [&](std::size_t n) { readNode(view, nullptr, nodes_[n]); });
  overAll(count, threads, [&](std::size_t n) {
    findDepth(n, reach_m_);
    const LipState& state = states_[n];
    setForce(n, state.hold * depths_m_[n] / contacts_[n].compliance_m_n);
    // Lips that are about to meet are stiff, too: otherwise Newton's method would press them far into each other and
    // its step would be refused.
    stiff_[n] = state.hold > 0.0 && state.gap_m < kAboutToMeet * shortest_edge_m_ ? 1 : 0;
  });
  gatherForces(view, threads);
}

template <typename Real>
void LipSet<Real>::addProduct(const std::vector<Real> (&direction)[3], std::vector<Real> (&product)[3]) const {
  for (std::size_t n = 0; n + 1 < contacts_.size(); ++n) {
    if (!stiff_[n])
      continue;
    double along = 0.0;
    for (std::uint32_t c = contacts_[n].corners_begin; c < contacts_[n + 1].corners_begin; ++c) {
      const std::uint32_t v = nodes_[corners_[c].node].vertex;
      along += gradient(n, corners_[c]).dot(Vector3(direction[0][v], direction[1][v], direction[2][v]));
    }
    along *= states_[n].hold / contacts_[n].compliance_m_n;
    for (std::uint32_t c = contacts_[n].corners_begin; c < contacts_[n + 1].corners_begin; ++c) {
      const Vector3 by_corner = gradient(n, corners_[c]);
      for (int d = 0; d < 3; ++d)
        product[d][nodes_[corners_[c].node].vertex] += static_cast<Real>(along * by_corner[d]);
    }
  }
}

template <typename Real>
void LipSet<Real>::addDiagonal(std::vector<Real> (&diagonal)[3]) const {
  for (std::size_t n = 0; n + 1 < contacts_.size(); ++n) {
    if (!stiff_[n])
      continue;
    for (std::uint32_t c = contacts_[n].corners_begin; c < contacts_[n + 1].corners_begin; ++c) {
      const Vector3 entries = states_[n].hold / contacts_[n].compliance_m_n * gradient(n, corners_[c]).cwiseAbs2();
      for (int d = 0; d < 3; ++d)
        diagonal[d][nodes_[corners_[c].node].vertex] += static_cast<Real>(entries[d]);
    }
  }
}

template <typename Real>
std::size_t LipSet<Real>::bytes() const {
  return bytesOf(contacts_) + bytesOf(corners_) + bytesOf(nodes_) + bytesOf(links_) + bytesOf(pulls_) +
         bytesOf(states_) + bytesOf(depths_m_) + bytesOf(stiff_) + bytesOf(forces_n_);
}

template class LipSet<float>;
template class LipSet<double>;

}  // namespace soft_volume::core
