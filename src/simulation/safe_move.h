#pragma once

#include <cstdint>
#include <vector>

#include "soft_volume/simulation/corner_width.h"
#include "soft_volume/simulation/simulation.h"
#include "solve_set.h"

namespace soft_volume::core {

/// Least width of a corner tetrahedron, the width below which altitude springs act, and the longest move, all in units
/// of the shortest cell edge; the longest move also as a fraction of the shortest cell edge at the vertex.
constexpr double kLeastWidth = 0.02;
constexpr double kAltitudeWidth = 0.3;
constexpr double kLongestMove = 0.5;
constexpr double kEdgeFraction = 0.4;

/// The width rule in its hybrid form: it shortens the proposed moves of a step so that no corner tetrahedron inverts.
///
/// Guarantee. Let w be the width of a corner tetrahedron (corner_width.h) and h the shortest cell edge. In every state
/// that a step leaves behind, each corner tetrahedron of a cell with a moving vertex has w >= 0.02 h, up to 1e-5 h of
/// rounding in float and 1e-12 h in double, or, if it was thinner before (a restored state), is not thinner than it
/// was. Starting from rest (w = h / sqrt(3) in a cube) none ever inverts, whatever the forces, grips and time step.
/// Eight positive corner determinants do not prove that the trilinear map inside a cell is one to one everywhere.
///
/// How. A tetrahedron fails when its end width is below 0.02 h and below its start width. First the moves are corrected
/// along the gradient of its width, by just what is missing and shared so that momentum stays, in a few sweeps over
/// what fails: that stops what presses and lets what slides go on. This is done in every fourth step only (some folds
/// open by sliding, others lock by it), and never while something is gripped, because it would push tissue out of the
/// way of a plate that has to wait. What still fails then is halved twice, then capped at 0.499 (w - 0.02 h), w the
/// least start width around the vertex; after each change everything that it touched is tested again. Once all four
/// vertices of a tetrahedron are capped it cannot fail, because w changes by at most twice the longest move, so this
/// ends; after kRounds rounds all vertices are capped at once. A lower bound of each cell's width is kept from step to
/// step and lowered by twice the longest move of its vertices: as long as it stays above 0.02 h the cell is not looked
/// at.
template <typename Real>
class SafeMoveGuard {
 public:
  static constexpr int kRounds = 16;

  SafeMoveGuard(SolveSet<Real>& set, const Kernel<Real>& kernel, int threads)
      : set_(&set), kernel_(&kernel), threads_(threads) {}

  /// After the set was built anew.
  void reset();
  /// Makes the moves in the set's view safe, and the velocities with them; by shortening alone unless `correct`.
  void guard(double dt_s, bool correct, SimulationStats& stats);
  std::size_t bytes() const;
  /// Corners of a cell before (or after) the move, relative to its corner 0 at rest, metres.
  CellCorners corners(std::uint32_t cell, bool after) const;

 private:
  double least() const;
  void findFailures(const std::vector<std::uint32_t>& cells);
  void pushApart();
  bool pushApart(std::uint32_t cell);
  void repair(double dt_s, bool correct, SimulationStats& stats);
  void shortenFlagged(int round);
  void capEverything();
  double startRoom(std::uint32_t vertex) const;
  void limitMove(std::uint32_t vertex, double longest_m);
  void markChanged(std::uint32_t vertex);
  void scaleMove(std::uint32_t vertex, double factor);
  void touchCells(std::uint32_t vertex);
  void finish(double dt_s, SimulationStats& stats);

  SolveSet<Real>* set_;
  const Kernel<Real>* kernel_;
  int threads_;
  std::vector<std::uint8_t> suspicious_;
  std::vector<std::uint8_t> cell_touched_, vertex_flagged_, vertex_changed_;
  std::vector<std::uint32_t> cells_, flagged_, changed_, pushed_, failing_;
};

}  // namespace soft_volume::core
