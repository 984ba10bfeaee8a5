#pragma once

#include <vector>

#include <Eigen/Core>

#include "implicit_step.h"
#include "lattice_index.h"
#include "spring_model.h"

namespace soft_volume::core {

/// The lattice without its incisions. What is chosen by it does not depend on them, so that a run that continues from a
/// checkpoint chooses alike.
Lattice healed(const Lattice& lattice);

/// The linear equations of motion of a whole lattice around rest, M x'' + K x = f: what time steps and damping are
/// chosen by.
class RestSystem {
 public:
  RestSystem(const Lattice& lattice, SpringRule rule, const SpringModel& model);

  /// Largest angular frequency, by power iteration to about 1e-4; 0 when nothing moves. Rad/s.
  double largestFrequency() const;
  /// Lowest one, by Rayleigh's method: that of the shape in which the lattice hangs under a uniform body force, along
  /// the axis for which it is lowest. A free lattice has no such shape; 0 then. Rad/s.
  double lowestFrequency() const;
  /// K^-1 f, three entries per vertex, by conjugate gradients down to a residual of `tolerance` |f|. Forces that a
  /// free lattice cannot resist have to be none.
  Eigen::VectorXd answer(const Eigen::VectorXd& force, double tolerance) const;

 private:
  struct Entry {
    std::uint32_t neighbour;
    std::uint8_t direction;
    double stiffness_n_m;
    double tension;  ///< what a prestretched spring's tension makes stiff across it, in units of its stiffness
  };
  void product(const Eigen::VectorXd& x, Eigen::VectorXd& y) const;
  LinearProblem problem() const;

  std::vector<std::uint32_t> row_begin_;
  std::vector<Entry> entries_;
  std::vector<std::array<std::uint32_t, 8>> cells_;  ///< those with volume energy
  std::vector<double> cell_modulus_n_m_;
  std::array<Vector3, 8> volume_gradient_;
  std::array<Vector3, kDirections> unit_;
  std::array<double, kDirections> linear_;
  Eigen::VectorXd mass_kg_;  ///< three per vertex; 0 where it does not move
};

}  // namespace soft_volume::core
