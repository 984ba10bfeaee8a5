#include "soft_volume/simulation/simulation.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "soft_volume/common/error.h"
#include "soft_volume/common/hash.h"
#include "soft_volume/common/parallel.h"

namespace soft_volume::core {
namespace {

/// What the springs of one vertex say: the force they exert and the distance to the nearest vertex at their other ends.
struct Gathered {
  Vector3 force_n;
  double nearest_m;
};

Gathered gatherSprings(const SpringNetwork& springs, const std::vector<Vector3>& positions, std::uint32_t vertex) {
  const Vector3 p = positions[vertex];
  Vector3 force = Vector3::Zero();
  double nearest_squared = std::numeric_limits<double>::infinity();
  for (std::uint32_t s = springs.row_begin[vertex]; s < springs.row_begin[vertex + 1]; ++s) {
    const Vector3 d = positions[springs.neighbours[s]] - p;
    const double squared = d.squaredNorm();
    nearest_squared = std::min(nearest_squared, squared);
    const double length = std::sqrt(squared);
    // Two vertices at one place have no direction to push in; the other springs part them.
    if (length > 0.0)
      force += (springs.stiffness_n_m[s] * (length - springs.rest_length_m[s]) / length) * d;
  }
  return {force, std::sqrt(nearest_squared)};
}

double footprintWeight(double distance_m, double radius_m) {
  const double r = distance_m / radius_m;
  const double w = 1.0 - r * r;
  return w > 0.0 ? w * w : 0.0;
}

Box3 boxAround(const Vector3& point_m, double radius_m) {
  const Vector3 r = Vector3::Constant(radius_m);
  return {Vector3(point_m - r), Vector3(point_m + r)};
}

bool allFinite(const std::vector<Vector3>& values) {
  return std::all_of(values.begin(), values.end(), [](const Vector3& v) { return isFinite(v); });
}

}  // namespace

Simulation::Simulation(const Lattice& lattice, const std::vector<Material>& materials,
                       const SimulationSettings& settings, int threads)
    : lattice_(&lattice), materials_(&materials), settings_(settings), threads_(threads) {
  state_.positions_m = lattice.rest_positions;
  state_.velocities_m_s.assign(lattice.vertexCount(), Vector3::Zero());
  state_.lifetimes.assign(lattice.cellCount(), 0);
  adoptTopology();
}

void Simulation::indexNodes() {
  const std::size_t nodes = lattice_->latticeNode(lattice_->dims.x(), lattice_->dims.y(), lattice_->dims.z()) + 1;
  node_begin_.assign(nodes + 1, 0);
  for (const std::uint32_t node : lattice_->lattice_nodes)
    ++node_begin_[node + 1];
  for (std::size_t n = 0; n < nodes; ++n)
    node_begin_[n + 1] += node_begin_[n];
  node_vertices_.resize(lattice_->vertexCount());
  std::vector<std::uint32_t> next(node_begin_.begin(), node_begin_.end() - 1);
  for (std::uint32_t v = 0; v < lattice_->vertexCount(); ++v)
    node_vertices_[next[lattice_->lattice_nodes[v]]++] = v;
}

void Simulation::adoptTopology() {
  for (std::size_t v = state_.positions_m.size(); v < lattice_->vertexCount(); ++v) {
    const std::uint32_t origin = lattice_->origin_vertices[v];
    state_.positions_m.push_back(state_.positions_m[origin]);
    state_.velocities_m_s.push_back(state_.velocities_m_s[origin]);
  }
  external_n_.resize(lattice_->vertexCount(), Vector3::Zero());
  springs_ = buildSpringNetwork(*lattice_, *materials_);
  indexNodes();
  active_changed_ = true;
}

void Simulation::restore(SimulationState state) {
  const bool fits = state.positions_m.size() == lattice_->vertexCount() &&
                    state.velocities_m_s.size() == lattice_->vertexCount() &&
                    state.lifetimes.size() == lattice_->cellCount();
  if (!fits)
    throw InputError("the saved state belongs to another lattice: its vertex or cell count differs");
  if (!allFinite(state.positions_m) || !allFinite(state.velocities_m_s)) {
    throw InputError("the saved state holds a position or velocity that is not finite");
  }
  for (const auto& entry : state.forces) {
    const HeldForce& held = entry.second;
    const auto exists = [this](std::uint32_t v) { return v < lattice_->vertexCount(); };
    if (held.vertices.size() != held.weights.size() || !isFinite(held.force_n) ||
        !std::all_of(held.vertices.begin(), held.vertices.end(), exists)) {
      throw InputError("the saved state holds a force that does not fit the lattice");
    }
  }
  state_ = std::move(state);
  external_n_.assign(lattice_->vertexCount(), Vector3::Zero());
  loaded_.clear();
  reach_m_ = maxDisplacement();
  active_changed_ = true;
}

std::vector<std::uint32_t> Simulation::verticesNear(const Vector3& point_m, double radius_m) const {
  std::vector<std::uint32_t> found;
  const LatticeBox box = latticeBox(*lattice_, boxAround(point_m, radius_m + reach_m_));
  for (int k = box.begin.z(); k <= box.end.z(); ++k) {
    for (int j = box.begin.y(); j <= box.end.y(); ++j) {
      for (int i = box.begin.x(); i <= box.end.x(); ++i) {
        const std::size_t node = lattice_->latticeNode(i, j, k);
        for (std::uint32_t n = node_begin_[node]; n < node_begin_[node + 1]; ++n) {
          const std::uint32_t v = node_vertices_[n];
          if ((state_.positions_m[v] - point_m).squaredNorm() < radius_m * radius_m)
            found.push_back(v);
        }
      }
    }
  }
  std::sort(found.begin(), found.end());
  return found;
}

std::vector<std::uint32_t> Simulation::cellsNear(const Vector3& point_m, double radius_m) const {
  std::vector<std::uint32_t> found;
  forEachCell(*lattice_, latticeBox(*lattice_, boxAround(point_m, radius_m + reach_m_)), [&](std::uint32_t cell) {
    const auto near = [&](std::uint32_t v) {
      return (state_.positions_m[v] - point_m).squaredNorm() < radius_m * radius_m;
    };
    const auto& vertices = lattice_->cells[cell];
    if (std::any_of(vertices.begin(), vertices.end(), near))
      found.push_back(cell);
  });
  return found;
}

bool Simulation::holdForce(const std::string& tool_id, const Vector3& force_n, const Vector3& point_m, double radius_m,
                           std::uint64_t expires_at_step) {
  HeldForce held;
  held.vertices = verticesNear(point_m, radius_m);
  double total = 0.0;
  for (const std::uint32_t v : held.vertices) {
    held.weights.push_back(springs_.mass_kg[v] * footprintWeight((state_.positions_m[v] - point_m).norm(), radius_m));
    total += held.weights.back();
  }
  if (total <= 0.0)
    return false;
  Vector3 rest_centre = Vector3::Zero();
  for (std::size_t n = 0; n < held.vertices.size(); ++n) {
    held.weights[n] /= total;
    rest_centre += held.weights[n] * lattice_->rest_positions[held.vertices[n]];
  }
  held.force_n = force_n;
  held.point_m = point_m;
  held.expires_at_step = expires_at_step;
  state_.forces[tool_id] = std::move(held);
  wake(boxAround(rest_centre, 0.0));
  return true;
}

void Simulation::wake(const Box3& rest_box_m) {
  const Vector3 radius = Vector3::Constant(settings_.activation_radius_m);
  const Box3 grown(Vector3(rest_box_m.min() - radius), Vector3(rest_box_m.max() + radius));
  forEachCell(*lattice_, latticeBox(*lattice_, grown), [this](std::uint32_t cell) {
    active_changed_ = active_changed_ || state_.lifetimes[cell] == 0;
    state_.lifetimes[cell] = settings_.lifetime_steps;
  });
}

void Simulation::dropExpiredForces() {
  for (auto it = state_.forces.begin(); it != state_.forces.end();) {
    it = it->second.expires_at_step <= state_.step ? state_.forces.erase(it) : std::next(it);
  }
}

void Simulation::gatherExternalForces() {
  for (const std::uint32_t v : loaded_)
    external_n_[v].setZero();
  loaded_.clear();
  for (const auto& entry : state_.forces) {
    const HeldForce& held = entry.second;
    for (std::size_t n = 0; n < held.vertices.size(); ++n) {
      external_n_[held.vertices[n]] += held.weights[n] * held.force_n;
      loaded_.push_back(held.vertices[n]);
    }
  }
}

void Simulation::rebuildActiveSet() {
  active_cells_.clear();
  in_solve_.assign(lattice_->vertexCount(), 0);
  for (std::uint32_t cell = 0; cell < lattice_->cellCount(); ++cell) {
    if (state_.lifetimes[cell] == 0)
      continue;
    active_cells_.push_back(cell);
    for (const std::uint32_t v : lattice_->cells[cell])
      in_solve_[v] = 1;
  }
  for (const std::uint32_t v : active_vertices_) {
    if (!in_solve_[v])
      state_.velocities_m_s[v].setZero();
  }
  active_vertices_.clear();
  for (std::uint32_t v = 0; v < lattice_->vertexCount(); ++v) {
    if (in_solve_[v] && !lattice_->fixed[v])
      active_vertices_.push_back(v);
  }
  moves_.resize(active_vertices_.size());
  limited_.resize(active_vertices_.size());
  active_changed_ = false;
}

void Simulation::ageCells() {
  for (const std::uint32_t cell : active_cells_) {
    if (--state_.lifetimes[cell] == 0)
      active_changed_ = true;
  }
}

void Simulation::moveVertex(std::size_t active_index) {
  const std::uint32_t v = active_vertices_[active_index];
  const double dt = settings_.dt_s;
  const Gathered gathered = gatherSprings(springs_, state_.positions_m, v);
  const Vector3 acceleration = (gathered.force_n + external_n_[v]) / springs_.mass_kg[v];
  Vector3& velocity = state_.velocities_m_s[v];
  // Damping is taken implicitly: it can only take energy out, whatever its rate.
  velocity = (velocity + dt * acceleration) / (1.0 + dt * springs_.damping_kg_s[v] / springs_.mass_kg[v]);
  Vector3 move = dt * velocity;
  if (settings_.integrator == Integrator::kDissertation)
    move += 0.5 * dt * dt * acceleration;
  const double longest = settings_.safe_move_fraction * gathered.nearest_m;
  const double length = move.norm();
  limited_[active_index] = length > longest ? 1 : 0;
  if (length > longest) {
    move *= longest / length;
    velocity = move / dt;  // a velocity that the vertex did not have would wind up momentum
  }
  moves_[active_index] = move;
}

void Simulation::applyMoves() {
  for (std::size_t n = 0; n < active_vertices_.size(); ++n) {
    const std::uint32_t v = active_vertices_[n];
    state_.positions_m[v] += moves_[n];
    limited_moves_ += limited_[n];
    reach_m_ = std::max(reach_m_, (state_.positions_m[v] - lattice_->rest_positions[v]).norm());
  }
}

void Simulation::step() {
  dropExpiredForces();
  gatherExternalForces();
  if (active_changed_)
    rebuildActiveSet();
  parallelFor(static_cast<std::ptrdiff_t>(active_vertices_.size()), threads_,
              [this](std::ptrdiff_t n) { moveVertex(static_cast<std::size_t>(n)); });
  applyMoves();
  ageCells();
  // Now rather than with the next step: what leaves the solve comes to rest, and a state saved here must say so.
  if (active_changed_)
    rebuildActiveSet();
  ++state_.step;
}

double Simulation::maxDisplacement() const {
  double squared = 0.0;
  for (std::size_t v = 0; v < state_.positions_m.size(); ++v) {
    squared = std::max(squared, (state_.positions_m[v] - lattice_->rest_positions[v]).squaredNorm());
  }
  return std::sqrt(squared);
}

double Simulation::maxSpeed() const {
  double squared = 0.0;
  for (const Vector3& v : state_.velocities_m_s)
    squared = std::max(squared, v.squaredNorm());
  return std::sqrt(squared);
}

Vector3 Simulation::forceOn(std::uint32_t vertex) const {
  Vector3 force = gatherSprings(springs_, state_.positions_m, vertex).force_n;
  for (const auto& entry : state_.forces) {
    const HeldForce& held = entry.second;
    for (std::size_t n = 0; n < held.vertices.size(); ++n) {
      if (held.vertices[n] == vertex)
        force += held.weights[n] * held.force_n;
    }
  }
  return force;
}

std::uint64_t Simulation::stateHash() const {
  return hashVector(state_.velocities_m_s, hashVector(state_.positions_m));
}

}  // namespace soft_volume::core
