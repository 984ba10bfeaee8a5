#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <functional>
#include <vector>

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// A part of the stiffness that acts along one direction of several vertices: k g g^T. The volume energy of a cell and
/// an altitude spring at work are such.
struct RankOneStiffness {
  int count = 0;
  std::array<std::uint32_t, 8> vertices;
  std::array<Vector3, 8> gradient;
  double stiffness = 0.0;
};

/// Solves (D + K) x = b by conjugate gradients, preconditioned with the diagonal; three unknowns per vertex.
/// `stiffnessProduct(x, y)` sets y = K x. Returns the number of iterations. Writes the solution to `x`.
struct LinearProblem {
  std::function<void(const Eigen::VectorXd& x, Eigen::VectorXd& y)> stiffness_product;
  Eigen::VectorXd diagonal;        ///< D
  Eigen::VectorXd preconditioner;  ///< inverse of (an estimate of) the diagonal of D + K
};
std::uint64_t solveConjugateGradient(const LinearProblem& problem, const Eigen::VectorXd& b, double tolerance,
                                     Eigen::VectorXd& x);

}  // namespace soft_volume::core
