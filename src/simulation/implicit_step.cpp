#include "implicit_step.h"

#include <Eigen/IterativeLinearSolvers>
#include <Eigen/SparseCore>

namespace soft_volume::core {

class ShiftedStiffness;

}  // namespace soft_volume::core

namespace Eigen {
namespace internal {

/// Eigen's iterative solvers take any operator that says it is like a sparse matrix.
template <>
struct traits<soft_volume::core::ShiftedStiffness> : public traits<SparseMatrix<double>> {};

}  // namespace internal
}  // namespace Eigen

namespace soft_volume::core {

/// The operator D + K of a LinearProblem.
class ShiftedStiffness : public Eigen::EigenBase<ShiftedStiffness> {
 public:
  using Scalar = double;
  using RealScalar = double;
  using StorageIndex = int;
  enum {
    ColsAtCompileTime = Eigen::Dynamic,
    MaxColsAtCompileTime = Eigen::Dynamic,
    RowsAtCompileTime = Eigen::Dynamic,
    MaxRowsAtCompileTime = Eigen::Dynamic,
    IsRowMajor = 0
  };

  explicit ShiftedStiffness(const LinearProblem& problem) : problem_(&problem) {}
  Eigen::Index rows() const { return problem_->diagonal.size(); }
  Eigen::Index cols() const { return rows(); }
  const LinearProblem& problem() const { return *problem_; }

  template <typename Right>
  Eigen::Product<ShiftedStiffness, Right, Eigen::AliasFreeProduct> operator*(
      const Eigen::MatrixBase<Right>& right) const {
    return Eigen::Product<ShiftedStiffness, Right, Eigen::AliasFreeProduct>(*this, right.derived());
  }

 private:
  const LinearProblem* problem_;
};

/// Eigen's own diagonal preconditioner would read the entries of the matrix, of which there are none.
class GivenDiagonal {
 public:
  template <typename Matrix>
  GivenDiagonal& analyzePattern(const Matrix&) {
    return *this;
  }
  template <typename Matrix>
  GivenDiagonal& factorize(const Matrix& matrix) {
    inverse_ = &matrix.problem().preconditioner;
    return *this;
  }
  template <typename Matrix>
  GivenDiagonal& compute(const Matrix& matrix) {
    return factorize(matrix);
  }
  template <typename Right>
  Eigen::VectorXd solve(const Right& b) const {
    return inverse_->cwiseProduct(b);
  }
  Eigen::ComputationInfo info() const { return Eigen::Success; }

 private:
  const Eigen::VectorXd* inverse_ = nullptr;
};

}  // namespace soft_volume::core

namespace Eigen {
namespace internal {

template <typename Right>
struct generic_product_impl<soft_volume::core::ShiftedStiffness, Right, SparseShape, DenseShape, GemvProduct>
    : generic_product_impl_base<soft_volume::core::ShiftedStiffness, Right,
                                generic_product_impl<soft_volume::core::ShiftedStiffness, Right>> {
  template <typename Destination>
  static void scaleAndAddTo(Destination& to, const soft_volume::core::ShiftedStiffness& left, const Right& right,
                            double alpha) {
    const soft_volume::core::LinearProblem& problem = left.problem();
    const VectorXd x = right;
    VectorXd product(x.size());
    problem.stiffness_product(x, product);
    to.noalias() += alpha * (product + problem.diagonal.cwiseProduct(x));
  }
};

}  // namespace internal
}  // namespace Eigen

namespace soft_volume::core {

std::uint64_t solveConjugateGradient(const LinearProblem& problem, const Eigen::VectorXd& b, double tolerance,
                                     Eigen::VectorXd& x) {
  const ShiftedStiffness matrix(problem);
  Eigen::ConjugateGradient<ShiftedStiffness, Eigen::Lower | Eigen::Upper, GivenDiagonal> solver;
  solver.setTolerance(tolerance);
  solver.compute(matrix);
  x = solver.solve(b);
  return static_cast<std::uint64_t>(solver.iterations());
}

}  // namespace soft_volume::core
