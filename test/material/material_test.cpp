#include "soft_volume/material/material.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <limits>
#include <random>

#include "lattice_blocks.h"
#include "soft_volume/common/error.h"
#include "soft_volume/simulation/oracle.h"

namespace soft_volume::core {
namespace {

using Matrix6 = Eigen::Matrix<double, 6, 6>;

constexpr double kModulus = 10000.0;

/// Cauchy stress of a block whose points X moved by gradient * X: what holds the vertices in place, as a virial.
Matrix3 stressOf(const Lattice& lattice, const OracleModel& model, const Matrix3& gradient) {
  std::vector<Vector3> displacements;
  for (const Vector3& p : lattice.rest_positions)
    displacements.push_back(gradient * p);
  std::vector<Vector3> forces(lattice.vertexCount(), Vector3::Zero());
  model.addForces(displacements, forces);
  Matrix3 virial = Matrix3::Zero();
  for (std::size_t v = 0; v < forces.size(); ++v)
    virial -= forces[v] * lattice.rest_positions[v].transpose();
  return virial / (lattice.spacing_m.prod() * double(lattice.cellCount()));
}

/// Strain number n of xx, yy, zz, yz, zx, xy; shear as engineering strain.
Matrix3 unitStrain(int n) {
  Matrix3 strain = Matrix3::Zero();
  if (n < 3) {
    strain(n, n) = 1.0;
  } else {
    const int a = (n + 1) % 3;
    const int b = (n + 2) % 3;
    strain(a, b) = strain(b, a) = 0.5;
  }
  return strain;
}

/// Stiffness from tiny strains of both signs, so that the second order cancels.
Matrix6 homogenised(const Vector3& spacing_m, double poisson_ratio) {
  const Lattice lattice = makeBlock({3, 2, 4}, spacing_m);
  const OracleModel model(lattice, oneMaterial(kModulus, 0.0, poisson_ratio), SpringRule::kIsotropic);
  constexpr double kStrain = 1e-5;
  Matrix6 stiffness;
  for (int n = 0; n < 6; ++n) {
    const Matrix3 stress =
        (stressOf(lattice, model, kStrain * unitStrain(n)) - stressOf(lattice, model, -kStrain * unitStrain(n))) /
        (2.0 * kStrain);
    stiffness.col(n) << stress(0, 0), stress(1, 1), stress(2, 2), stress(1, 2), stress(2, 0), stress(0, 1);
  }
  return stiffness;
}

const std::vector<Vector3>& spacings() {
  static const std::vector<Vector3> all = {{0.005, 0.005, 0.005}, {0.005, 0.006, 0.008}, {0.008, 0.005, 0.006},
                                           {0.005, 0.005, 0.008}, {0.008, 0.005, 0.008}, {0.01, 0.0173, 0.01},
                                           {0.0173, 0.01, 0.0173}};
  return all;
}

TEST(Material, PatchesHaveTheModuliOfTheMaterial) {
  for (const Vector3& spacing : spacings()) {
    for (const double nu : {0.25, 0.3, 0.4, 0.45, 0.49}) {
      const Matrix6 compliance = homogenised(spacing, nu).inverse();
      const double shear = kModulus / (2.0 * (1.0 + nu));
      for (int a = 0; a < 3; ++a) {
        const int b = (a + 1) % 3;
        EXPECT_NEAR(1.0 / compliance(a, a) / kModulus, 1.0, 1e-6) << spacing.transpose() << ", nu " << nu;
        EXPECT_NEAR(-compliance(b, a) / compliance(a, a) / nu, 1.0, 1e-6) << spacing.transpose() << ", nu " << nu;
        EXPECT_NEAR(1.0 / compliance(3 + a, 3 + a) / shear, 1.0, 1e-6) << spacing.transpose() << ", nu " << nu;
        for (int n = 0; n < 6; ++n) {
          if (n != 3 + a) {
            EXPECT_NEAR(compliance(n, 3 + a) * kModulus, 0.0, 1e-6) << "shear couples to " << n;
          }
        }
      }
    }
  }
}

TEST(Material, AStretchedBlockTransmitsItsForceThroughEverySection) {
  const Lattice lattice = makeBlock({4, 3, 3}, {0.005, 0.006, 0.007});
  const double nu = 0.4;
  const OracleModel model(lattice, oneMaterial(kModulus, 0.0, nu), SpringRule::kIsotropic);
  const double strain = 1e-7;
  std::vector<Vector3> displacements;
  for (const Vector3& p : lattice.rest_positions)
    displacements.push_back(strain * p.cwiseProduct(Vector3(1.0, -nu, -nu)));
  std::vector<Vector3> forces(lattice.vertexCount(), Vector3::Zero());
  model.addForces(displacements, forces);
  const double expected = -kModulus * strain * (3 * 0.006) * (3 * 0.007);
  for (int section = 0; section < 4; ++section) {
    Vector3 sum = Vector3::Zero();
    for (std::size_t v = 0; v < forces.size(); ++v) {
      if (lattice.rest_positions[v].x() > (section + 0.5) * 0.005)
        sum += forces[v];
    }
    EXPECT_NEAR(sum.x() / expected, 1.0, 1e-6);
    EXPECT_LT(sum.tail<2>().norm(), 1e-6 * std::abs(expected));
  }
}

TEST(Material, CubicCellsHaveTheKnownSprings) {
  const double h = 0.004;
  const CellSprings springs = isotropicSprings(elasticConstants(kModulus, 0.25), Vector3::Constant(h));
  for (int a = 0; a < 3; ++a) {
    EXPECT_NEAR(springs.edge_n_m[a], 0.14 * kModulus * h, 1e-12 * kModulus * h);
    EXPECT_NEAR(springs.face_n_m[a], 0.12 * kModulus * h, 1e-12 * kModulus * h);
  }
  EXPECT_NEAR(springs.body_n_m, 0.12 * kModulus * h, 1e-12 * kModulus * h);
  const ElasticConstants stiff = elasticConstants(kModulus, 0.45);
  const CellSprings of_stiff = isotropicSprings(stiff, Vector3::Constant(h));
  EXPECT_NEAR(of_stiff.edge_n_m[0], 0.35 * stiff.mu_pa * h, 1e-12 * kModulus * h);
  EXPECT_NEAR(of_stiff.body_n_m, 0.30 * stiff.mu_pa * h, 1e-12 * kModulus * h);
}

TEST(Material, PairsOfCornersFindTheirSpring) {
  const CellSprings springs{{1.0, 2.0, 3.0}, {4.0, 5.0, 6.0}, 7.0};
  const auto of = [&](int a, int b, int axes) {
    return springStiffness(
        springs, {static_cast<std::uint8_t>(a), static_cast<std::uint8_t>(b), static_cast<std::uint8_t>(axes)});
  };
  EXPECT_EQ(of(0, 1, 1), 1.0);
  EXPECT_EQ(of(1, 2, 1), 2.0);
  EXPECT_EQ(of(2, 6, 1), 3.0);
  EXPECT_EQ(of(0, 7, 2), 4.0);  // in the face normal to x
  EXPECT_EQ(of(1, 4, 2), 5.0);
  EXPECT_EQ(of(0, 2, 2), 6.0);
  EXPECT_EQ(of(0, 6, 3), 7.0);
  double sum = 0.0;
  for (const CornerPair& pair : kCornerPairs)
    sum += springStiffness(springs, pair);
  EXPECT_EQ(sum, 4 * (1 + 2 + 3) + 4 * (4 + 5 + 6) + 4 * 7);
}

double least(const CellSprings& springs) {
  double least = springs.body_n_m;
  for (int a = 0; a < 3; ++a)
    least = std::min({least, springs.edge_n_m[a], springs.face_n_m[a]});
  return least;
}

TEST(Material, SpringsArePositiveWithinTheAspectAndRefusedBeyond) {
  const ElasticConstants constants = elasticConstants(kModulus, 0.25);
  std::mt19937 random(1);
  std::uniform_real_distribution<double> ratio(1.0, kMaxSpacingAspect);
  for (int n = 0; n < 2000; ++n) {
    Vector3 spacing(0.01, 0.01 * ratio(random), 0.01 * kMaxSpacingAspect);
    std::shuffle(spacing.data(), spacing.data() + 3, random);
    EXPECT_GT(least(isotropicSprings(constants, spacing)), 0.0) << spacing.transpose();
    spacing[n % 3] = spacing.minCoeff() * kMaxSpacingAspect * 1.001;
    spacing[(n + 1) % 3] = spacing[n % 3] / kMaxSpacingAspect / 1.001;
    EXPECT_THROW(isotropicSprings(constants, spacing), SceneError) << spacing.transpose();
  }
  EXPECT_GT(least(isotropicSprings(constants, {0.01, 0.0173, 0.0173})), 0.0);
  EXPECT_THROW(isotropicSprings(constants, {0.01, 0.01, 0.0}), SceneError);
  EXPECT_THROW(isotropicSprings(constants, {0.01, 0.01, std::nan("")}), SceneError);
}

TEST(Material, NoFreeParameterMakesSpringsBeyondTheAspect) {
  // Edge along the longest axis at the largest beta that leaves the face diagonals positive, over mu V.
  const auto longest_edge = [](double middle, double longest) {
    const double beta = 1.0 / (middle * middle * longest * longest);
    return 3.0 / (longest * longest) - 1.0 - 1.0 / (middle * middle) + beta * longest * longest;
  };
  for (const double middle : {1.0, 1.2, 1.5, 1.7}) {
    EXPECT_GT(longest_edge(middle, kMaxSpacingAspect), 0.0);
    EXPECT_LT(longest_edge(middle, kMaxSpacingAspect + 0.003), 0.0);
  }
}

TEST(Material, AxesMayBeExchanged) {
  const ElasticConstants constants = elasticConstants(kModulus, 0.3);
  const Vector3 spacing(0.005, 0.006, 0.008);
  const CellSprings springs = isotropicSprings(constants, spacing);
  std::array<int, 3> order = {0, 1, 2};
  do {
    const CellSprings moved = isotropicSprings(constants, {spacing[order[0]], spacing[order[1]], spacing[order[2]]});
    for (int a = 0; a < 3; ++a) {
      EXPECT_NEAR(moved.edge_n_m[a], springs.edge_n_m[order[a]], 1e-9 * springs.edge_n_m[order[a]]);
      EXPECT_NEAR(moved.face_n_m[a], springs.face_n_m[order[a]], 1e-9 * springs.face_n_m[order[a]]);
    }
    EXPECT_NEAR(moved.body_n_m, springs.body_n_m, 1e-9 * springs.body_n_m);
  } while (std::next_permutation(order.begin(), order.end()));
}

TEST(Material, ElasticConstantsAreThoseOfTheTextbook) {
  const ElasticConstants c = elasticConstants(kModulus, 0.4);
  EXPECT_NEAR(c.lambda_pa, kModulus * 0.4 / (1.4 * 0.2), 1e-9 * kModulus);
  EXPECT_NEAR(c.mu_pa, kModulus / 2.8, 1e-9 * kModulus);
  EXPECT_NEAR(c.volume_pa, c.lambda_pa - c.mu_pa, 1e-9 * kModulus);
  EXPECT_EQ(elasticConstants(kModulus, 0.25).volume_pa, 0.0);
}

TEST(Material, ElasticConstantsRefuseWhatSpringsCannotBe) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (const double nu : {-0.1, 0.0, 0.2499, 0.4901, 0.5, nan})
    EXPECT_THROW(elasticConstants(kModulus, nu), SceneError) << nu;
  for (const double e : {0.0, -1.0, nan, std::numeric_limits<double>::infinity()})
    EXPECT_THROW(elasticConstants(e, 0.3), SceneError) << e;
}

TEST(Material, TheBulkLimitIsThatOfTheClosedForm) {
  Material material = oneMaterial(kModulus)[0];
  EXPECT_NEAR(bulkTimeStepLimit(material, Vector3::Constant(0.005)), 0.005 * std::sqrt(1000.0 / kModulus) * 0.9129,
              1e-6);
  material.poisson_ratio = 0.45;
  EXPECT_NEAR(bulkTimeStepLimit(material, {0.006, 0.005, 0.006}), 0.0008, 5e-5);
}

TEST(Material, TheDissertationsStrengthKeepsTheModulus) {
  Lattice lattice = makeBlock(4, 4, 4, 0.005);
  std::vector<Material> materials = oneMaterial(kModulus);
  materials.push_back(oneMaterial(3.0 * kModulus)[0]);
  materials.push_back(oneMaterial(1e9)[0]);
  materials[2].fixed = true;
  const double of_one = dissertationStrength(lattice, materials);
  EXPECT_NEAR(of_one * (13.0 / 3.0) / 0.005, 1.2 * kModulus, 1e-9 * kModulus);
  for (std::size_t cell = 0; cell < 32; ++cell)
    lattice.materials[cell] = 1;
  EXPECT_NEAR(dissertationStrength(lattice, materials), 2.0 * of_one, 1e-9 * of_one);
  for (std::size_t cell = 0; cell < 32; ++cell)
    lattice.materials[cell] = 2;
  EXPECT_NEAR(dissertationStrength(lattice, materials), of_one, 1e-9 * of_one);
  lattice.materials.assign(lattice.cellCount(), 2);
  EXPECT_THROW(dissertationStrength(lattice, materials), SceneError);
}

}  // namespace
}  // namespace soft_volume::core
