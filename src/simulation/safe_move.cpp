#include "safe_move.h"

#include <algorithm>
#include <cmath>

#include "soft_volume/common/parallel.h"
#include "soft_volume/grid/hexahedron.h"
#include "soft_volume/simulation/corner_width.h"

namespace soft_volume::core {
namespace {

/// Blocks that one thread takes at a time.
constexpr std::size_t kChunk = 64;
constexpr int kSweeps = 8;
/// Widths are pushed to a little above what is allowed, so that rounding does not undo it.
constexpr double kPushReserve = 1.01;
constexpr int kHalvings = 2;
/// Of the room above the least width that a vertex may use: less than half of it, by more than rounding.
constexpr double kRoomFraction = 0.499;

}  // namespace

template <typename Real>
void SafeMoveGuard<Real>::reset() {
  suspicious_.assign(set_->guardedBlocks(), 0);
  cell_touched_.assign(set_->guardedBlocks() * kLanes<Real>, 0);
  vertex_flagged_.assign(set_->vertexCount(), 0);
  vertex_changed_.assign(set_->vertexCount(), 0);
}

template <typename Real>
std::size_t SafeMoveGuard<Real>::bytes() const {
  return suspicious_.capacity() + cell_touched_.capacity() + vertex_flagged_.capacity() + vertex_changed_.capacity() +
         (cells_.capacity() + flagged_.capacity() + changed_.capacity() + pushed_.capacity() + failing_.capacity()) *
             sizeof(std::uint32_t);
}

template <typename Real>
double SafeMoveGuard<Real>::least() const {
  const Real* spacing = set_->view().spacing;
  return kLeastWidth * double(std::min({spacing[0], spacing[1], spacing[2]}));
}

template <typename Real>
void SafeMoveGuard<Real>::guard(double dt_s, bool correct, SimulationStats& stats) {
  const std::size_t blocks = set_->guardedBlocks();
  const Real threshold = static_cast<Real>(least());
  parallelFor(static_cast<std::ptrdiff_t>((blocks + kChunk - 1) / kChunk), threads_, [&](std::ptrdiff_t n) {
    const std::size_t begin = static_cast<std::size_t>(n) * kChunk;
    kernel_->checkWidths(set_->view(), threshold, begin, std::min(blocks, begin + kChunk), suspicious_.data());
  });
  cells_.clear();
  for (std::size_t block = 0; block < blocks; ++block) {
    if (!suspicious_[block])
      continue;
    for (std::size_t cell = block * kLanes<Real>; cell < (block + 1) * kLanes<Real>; ++cell) {
      if (cell < set_->guardedCells() && set_->view().width_bound[cell] < threshold)
        cells_.push_back(static_cast<std::uint32_t>(cell));
    }
  }
  if (!cells_.empty())
    repair(dt_s, correct, stats);
}

template <typename Real>
CellCorners SafeMoveGuard<Real>::corners(std::uint32_t cell, bool after) const {
  const KernelView<Real>& view = set_->view();
  CellCorners corners;
  for (int c = 0; c < 8; ++c) {
    const std::uint32_t v = set_->cornerVertex(cell, c);
    for (int d = 0; d < 3; ++d) {
      const Real u = view.displacement[d][v];
      corners[static_cast<std::size_t>(c)][d] =
          double(after ? Real(u + view.move[d][v]) : u) + kHexahedronCorners[c][d] * double(view.spacing[d]);
    }
  }
  return corners;
}

/// Flags the vertices of the tetrahedra that fail in these cells.
template <typename Real>
void SafeMoveGuard<Real>::findFailures(const std::vector<std::uint32_t>& cells) {
  flagged_.clear();
  for (const std::uint32_t cell : cells) {
    const CellCorners start = corners(cell, false);
    const CellCorners end = corners(cell, true);
    for (int t = 0; t < 8; ++t) {
      const double width = cornerWidth(cornerEdges(end, t));
      if (width >= least() || width >= cornerWidth(cornerEdges(start, t)))
        continue;
      for (const std::uint8_t c : kCornerTetrahedra[t]) {
        const std::uint32_t v = set_->cornerVertex(cell, c);
        if (!vertex_flagged_[v])
          flagged_.push_back(v);
        vertex_flagged_[v] = 1;
      }
    }
  }
}

template <typename Real>
void SafeMoveGuard<Real>::markChanged(std::uint32_t vertex) {
  KernelView<Real>& view = set_->view();
  view.move_squared[vertex] = Real(0);
  for (int d = 0; d < 3; ++d)
    view.move_squared[vertex] += view.move[d][vertex] * view.move[d][vertex];
  if (!vertex_changed_[vertex])
    changed_.push_back(vertex);
  vertex_changed_[vertex] = 1;
}

template <typename Real>
void SafeMoveGuard<Real>::scaleMove(std::uint32_t vertex, double factor) {
  for (int d = 0; d < 3; ++d)
    set_->view().move[d][vertex] *= static_cast<Real>(factor);
  markChanged(vertex);
}

/// Corrects the moves of the failing tetrahedra of a cell; false when none fails.
template <typename Real>
bool SafeMoveGuard<Real>::pushApart(std::uint32_t cell) {
  KernelView<Real>& view = set_->view();
  const CellCorners start = corners(cell, false);
  bool failed = false;
  for (int t = 0; t < 8; ++t) {
    const CornerWidth end = cornerWidthGradient(cornerEdges(corners(cell, true), t));
    const double start_width = cornerWidth(cornerEdges(start, t));
    if (end.width_m >= least() || end.width_m >= start_width)
      continue;
    failed = true;
    double share = 0.0;
    for (std::size_t n = 0; n < 4; ++n) {
      const std::uint32_t v = set_->cornerVertex(cell, kCornerTetrahedra[t][n]);
      share += double(view.inverse_mass[v]) * end.gradient[n].squaredNorm();
    }
    if (share <= 0.0)
      continue;
    const double factor = (kPushReserve * std::min(least(), start_width) - end.width_m) / share;
    for (std::size_t n = 0; n < 4; ++n) {
      const std::uint32_t v = set_->cornerVertex(cell, kCornerTetrahedra[t][n]);
      if (view.inverse_mass[v] <= Real(0))
        continue;
      for (int d = 0; d < 3; ++d)
        view.move[d][v] += static_cast<Real>(factor * double(view.inverse_mass[v]) * end.gradient[n][d]);
      markChanged(v);
      pushed_.push_back(v);
    }
  }
  return failed;
}

template <typename Real>
void SafeMoveGuard<Real>::pushApart() {
  for (int sweep = 0; sweep < kSweeps && !cells_.empty(); ++sweep) {
    pushed_.clear();
    failing_.clear();
    for (const std::uint32_t cell : cells_) {
      if (pushApart(cell))
        failing_.push_back(cell);
    }
    cells_.clear();
    for (const std::uint32_t cell : failing_) {
      cell_touched_[cell] = 1;
      cells_.push_back(cell);
    }
    for (const std::uint32_t v : pushed_)
      touchCells(v);
    for (const std::uint32_t cell : cells_)
      cell_touched_[cell] = 0;
  }
}

template <typename Real>
void SafeMoveGuard<Real>::limitMove(std::uint32_t vertex, double longest_m) {
  const double length = std::sqrt(double(set_->view().move_squared[vertex]));
  if (length > longest_m)
    scaleMove(vertex, longest_m / length);
}

/// Least width at the start of the step of the tetrahedra that the vertex belongs to, above the least allowed.
template <typename Real>
double SafeMoveGuard<Real>::startRoom(std::uint32_t vertex) const {
  double width = 1e30;
  set_->forEachCell(vertex, [&](std::uint32_t cell) {
    const CellCorners start = corners(cell, false);
    for (int t = 0; t < 8; ++t) {
      const auto& tetrahedron = kCornerTetrahedra[t];
      const bool of_vertex = std::any_of(std::begin(tetrahedron), std::end(tetrahedron),
                                         [&](std::uint8_t c) { return set_->cornerVertex(cell, c) == vertex; });
      if (of_vertex)
        width = std::min(width, cornerWidth(cornerEdges(start, t)));
    }
  });
  return std::max(0.0, width - least());
}

template <typename Real>
void SafeMoveGuard<Real>::touchCells(std::uint32_t vertex) {
  set_->forEachCell(vertex, [this](std::uint32_t cell) {
    if (!cell_touched_[cell])
      cells_.push_back(cell);
    cell_touched_[cell] = 1;
  });
}

template <typename Real>
void SafeMoveGuard<Real>::shortenFlagged(int round) {
  cells_.clear();
  for (const std::uint32_t v : flagged_) {
    vertex_flagged_[v] = 0;
    if (round < kHalvings)
      scaleMove(v, 0.5);
    else
      limitMove(v, kRoomFraction * startRoom(v));
    touchCells(v);
  }
  for (const std::uint32_t cell : cells_)
    cell_touched_[cell] = 0;
}

template <typename Real>
void SafeMoveGuard<Real>::capEverything() {
  for (const std::uint32_t v : flagged_)
    vertex_flagged_[v] = 0;
  for (const std::uint32_t v : set_->moving())
    limitMove(v, kRoomFraction * startRoom(v));
}

template <typename Real>
void SafeMoveGuard<Real>::repair(double dt_s, bool correct, SimulationStats& stats) {
  changed_.clear();
  if (correct)
    pushApart();
  findFailures(cells_);
  for (int round = 0; !flagged_.empty(); ++round) {
    if (round == kRounds) {
      capEverything();
      ++stats.guard_fallbacks;
      break;
    }
    shortenFlagged(round);
    findFailures(cells_);
  }
  finish(dt_s, stats);
}

/// Velocities of the shortened moves, and bounds of the widths that they lead to.
template <typename Real>
void SafeMoveGuard<Real>::finish(double dt_s, SimulationStats& stats) {
  KernelView<Real>& view = set_->view();
  const Real inverse_dt = static_cast<Real>(1.0 / dt_s);
  cells_.clear();
  for (const std::uint32_t v : changed_) {
    for (int d = 0; d < 3; ++d)
      view.velocity[d][v] = view.move[d][v] * inverse_dt;
    vertex_changed_[v] = 0;
    touchCells(v);
  }
  stats.limited_moves += changed_.size();
  for (const std::uint32_t cell : cells_) {
    cell_touched_[cell] = 0;
    view.width_bound[cell] = static_cast<Real>(cellMinWidth(corners(cell, true)));
  }
}

template class SafeMoveGuard<float>;
template class SafeMoveGuard<double>;

}  // namespace soft_volume::core
