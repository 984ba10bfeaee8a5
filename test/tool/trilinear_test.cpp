#include "soft_volume/tool/trilinear.h"

#include <gtest/gtest.h>

#include <random>

namespace soft_volume::core {
namespace {

Trilinear::Corners unitCube() {
  return {Vector3(0, 0, 0), Vector3(1, 0, 0), Vector3(1, 1, 0), Vector3(0, 1, 0),
          Vector3(0, 0, 1), Vector3(1, 0, 1), Vector3(1, 1, 1), Vector3(0, 1, 1)};
}

Vector3 randomIn(std::mt19937& random, double low, double high) {
  std::uniform_real_distribution<double> number(low, high);
  return {number(random), number(random), number(random)};
}

Trilinear::Corners perturbedCube(std::mt19937& random, double amount) {
  Trilinear::Corners corners = unitCube();
  for (Vector3& corner : corners)
    corner += randomIn(random, -amount, amount);
  return corners;
}

TEST(TrilinearTest, TakesTheCornersValuesInVtkOrder) {
  std::mt19937 random(1);
  const Trilinear::Corners corners = perturbedCube(random, 0.3);
  const Trilinear cell(corners);
  const Trilinear::Corners locals = unitCube();
  for (int c = 0; c < 8; ++c)
    EXPECT_LT((cell.value(locals[c]) - corners[c]).norm(), 1e-14) << "corner " << c;
}

TEST(TrilinearTest, JacobianIsTheDerivative) {
  std::mt19937 random(2);
  const Trilinear cell(perturbedCube(random, 0.3));
  const Vector3 at(0.3, 0.6, 0.8);
  for (int axis = 0; axis < 3; ++axis) {
    const Vector3 step = 1e-6 * Vector3::Unit(axis);
    const Vector3 difference = (cell.value(at + step) - cell.value(at - step)) / 2e-6;
    EXPECT_LT((cell.jacobian(at).col(axis) - difference).norm(), 1e-8);
  }
}

// Corners moved by up to 0.24 of the edge: strongly warped, never inverted.
TEST(TrilinearTest, InvertsWarpedCells) {
  std::mt19937 random(3);
  for (int n = 0; n < 2000; ++n) {
    const Trilinear cell(perturbedCube(random, 0.24));
    const Vector3 local = randomIn(random, 0.0, 1.0);
    const auto found = cell.invert(cell.value(local), 1e-6);
    ASSERT_TRUE(found) << "cell " << n;
    EXPECT_LT((*found - local).norm(), 1e-8);
  }
}

TEST(TrilinearTest, RejectsPointsOutside) {
  std::mt19937 random(4);
  for (int n = 0; n < 2000; ++n) {
    const Trilinear cell(perturbedCube(random, 0.24));
    Vector3 local = randomIn(random, 0.0, 1.0);
    local[n % 3] = (n % 2 == 0) ? 1.02 : -0.02;
    EXPECT_FALSE(cell.invert(cell.value(local), 1e-6)) << "cell " << n;
  }
}

TEST(TrilinearTest, FlatCellHoldsNothing) {
  Trilinear::Corners corners = unitCube();
  for (Vector3& corner : corners)
    corner.z() = 0.0;
  EXPECT_FALSE(Trilinear(corners).invert({0.5, 0.5, 0.0}, 1e-6));
}

}  // namespace
}  // namespace soft_volume::core
