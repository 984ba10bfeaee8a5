#include "kernel.h"

#include <gtest/gtest.h>

#include <cstring>

#include "lattice_index.h"
#include "simulation_cases.h"
#include "soft_volume/simulation/oracle.h"
#include "solve_set.h"
#include "spring_model.h"

namespace soft_volume::core {
namespace {

constexpr double kMove = 0.15 * kH;
constexpr double kSpeed = 0.3;

struct Case {
  std::string name;
  Lattice lattice;
  std::vector<Material> materials;
  SpringRule rule = SpringRule::kIsotropic;
  std::vector<std::uint32_t> active = {};  ///< empty: all

  std::vector<std::uint32_t> activeCells() const {
    std::vector<std::uint32_t> cells = active;
    for (std::uint32_t cell = 0; active.empty() && cell < lattice.cellCount(); ++cell)
      cells.push_back(cell);
    return cells;
  }
};

/// Two materials in cells whose edges differ, one of them nearly incompressible.
Case mixed() {
  std::vector<Material> materials = oneMaterial(kModulus, 0.3, 0.25);
  materials.push_back(oneMaterial(4.0 * kModulus, 0.1, 0.45)[0]);
  Lattice lattice = standing(makeBlock({4, 3, 3}, {0.005, 0.006, 0.007}));
  for (std::size_t cell = 0; cell < lattice.cellCount(); cell += 3)
    lattice.materials[cell] = 1;
  return {"mixed", lattice, materials};
}

/// Vertex counts of 60, 27 and 105: multiples of four lanes, of neither, of neither. Incisions give vertices several
/// neighbours in a direction and shortened springs.
std::vector<Case> cases() {
  const std::vector<Material> plain = oneMaterial(kModulus, 0.3, 0.25);
  const std::vector<Material> wet = oneMaterial(kModulus, 0.3, 0.45);
  std::vector<Case> all;
  all.push_back({"block", makeBlock(4, 3, 2, kH), plain});
  all.push_back({"volume energy", makeBlock(2, 2, 2, kH), wet});
  all.push_back(mixed());
  all.push_back({"cut", cutAcross(makeBlock(6, 4, 2, kH), plain, 2.9 * kH, 0.9 * kH, 1.0, 0.75), plain});
  all.push_back({"cut, volume energy", cutAcross(makeBlock(6, 4, 3, kH), wet, 2.9 * kH, 0.9 * kH, 1.0, 0.75), wet});
  all.push_back({"dissertation", mixed().lattice, mixed().materials, SpringRule::kDissertation});
  all.push_back({"cut into pieces", cutIntoPieces(makeBlock(4, 3, 3, kH), plain), plain});
  all.push_back({"cut into pieces, volume energy", cutIntoPieces(makeBlock(4, 4, 3, kH), wet), wet});
  all.push_back({"cut into pieces, mixed", cutIntoPieces(mixed().lattice, mixed().materials), mixed().materials});
  all.push_back({"cut into pieces, dissertation", cutIntoPieces(mixed().lattice, mixed().materials), mixed().materials,
                 SpringRule::kDissertation});
  all.push_back({"part", standing(makeBlock(6, 6, 5, kH)), wet, SpringRule::kIsotropic, {64, 65, 70, 71, 100, 107}});
  return all;
}

/// Every vertex of the lattice gets the same random values, whatever part of it is packed.
template <typename Real>
struct Packed {
  Packed(const Case& c, bool with_frontier, unsigned seed)
      : lattice_vertices(c.lattice.vertexCount()),
        index(c.lattice),
        model(makeSpringModel(c.lattice, c.materials, c.rule, 50.0)),
        set(c.lattice, index) {
    set.build(model, c.activeCells(), with_frontier);
    Random random(seed);
    fill(set.view().displacement, random, kMove);
    fill(set.view().velocity, random, kSpeed);
    fill(set.view().external, random, 0.01);
    fill(set.view().move, random, kMove);
    KernelView<Real>& view = set.view();
    for (std::size_t v = 0; v < set.vertexCount(); ++v) {
      view.move_squared[v] =
          view.move[0][v] * view.move[0][v] + view.move[1][v] * view.move[1][v] + view.move[2][v] * view.move[2][v];
    }
    view.gravity[0] = Real(1.0);
    view.gravity[2] = Real(-9.81);
  }

  void fill(Real* const to[3], Random& random, double size) { fill(to, random.boxed(lattice_vertices, size)); }
  void fill(Real* const to[3], const std::vector<Vector3>& values) {
    for (std::uint32_t v = 0; v < set.vertexCount(); ++v) {
      for (int d = 0; d < 3; ++d)
        to[d][v] = static_cast<Real>(values[set.globalVertex(v)][d]);
    }
  }
  void forces(const Kernel<Real>& kernel) {
    if (set.view().corner_force != nullptr)
      kernel.volumeForces(set.view(), 0, set.cellBlocks());
    kernel.forces(set.view(), set.movingBlocks().data(), 0, set.movingBlocks().size());
    kernel.forces(set.view(), set.frontierBlocks().data(), 0, set.frontierBlocks().size());
  }
  Vector3 at(Real* const from[3], std::uint32_t local) const {
    return {double(from[0][local]), double(from[1][local]), double(from[2][local])};
  }

  std::size_t lattice_vertices;
  LatticeIndex index;
  SpringModel model;
  SolveSet<Real> set;
};

/// The bits of everything that kernels write.
template <typename Real>
std::vector<unsigned char> bits(const SolveSet<Real>& set) {
  std::vector<unsigned char> all;
  const auto add = [&](const Real* values, std::size_t count) {
    const auto* bytes = reinterpret_cast<const unsigned char*>(values);
    all.insert(all.end(), bytes, bytes + count * sizeof(Real));
  };
  const KernelView<Real>& view = set.view();
  for (const auto* arrays : {&view.displacement, &view.velocity, &view.force, &view.move}) {
    for (int d = 0; d < 3; ++d)
      add((*arrays)[d], set.paddedVertices());
  }
  add(view.nearest_squared, set.paddedVertices());
  add(view.move_squared, set.paddedVertices());
  add(view.width_bound, set.cellBlocks() * kLanes<Real>);
  if (view.corner_force != nullptr)
    add(view.corner_force, set.cellBlocks() * 24 * kLanes<Real>);
  return all;
}

template <typename Real>
const Kernel<Real>& portable();
template <>
const Kernel<float>& portable<float>() {
  return portableKernelFloat();
}
template <>
const Kernel<double>& portable<double>() {
  return portableKernelDouble();
}

template <typename Real>
class KernelTest : public testing::Test {};
using Precisions = testing::Types<float, double>;
TYPED_TEST_SUITE(KernelTest, Precisions);

template <typename Real>
AdvanceRule<Real> widthRule() {
  return {Real(1e-3), Real(0), Real(0.4), Real(0.1 * kH), Real(-1e15), true, true, true};
}
template <typename Real>
AdvanceRule<Real> dissertationRule() {
  return {Real(1e-3), Real(0.5e-6), Real(0.4), Real(1e30), Real(1e-3 * kH), false, true, false};
}
template <typename Real>
AdvanceRule<Real> freeRule() {
  return {Real(1e-3), Real(0), Real(0.4), Real(1e30), Real(0), true, false, false};
}

#if defined(__x86_64__)

template <typename Real>
const Kernel<Real>& avx2();
template <>
const Kernel<float>& avx2<float>() {
  return avx2KernelFloat();
}
template <>
const Kernel<double>& avx2<double>() {
  return avx2KernelDouble();
}

#define SKIP_WITHOUT_AVX2()            \
  if (!__builtin_cpu_supports("avx2")) \
  GTEST_SKIP() << "this processor lacks AVX2: there is only one kernel to run"

TYPED_TEST(KernelTest, BothKernelsGiveTheSameBitsInEveryPassOfAStep) {
  using Real = TypeParam;
  SKIP_WITHOUT_AVX2();
  for (const Case& c : cases()) {
    for (unsigned seed = 1; seed <= 5; ++seed) {
      SCOPED_TRACE(c.name + ", seed " + std::to_string(seed));
      Packed<Real> a(c, true, seed);
      Packed<Real> b(c, true, seed);
      const auto same = [&](const char* pass) { EXPECT_TRUE(bits(a.set) == bits(b.set)) << pass; };
      same("start");
      for (const bool all : {false, true}) {
        a.set.view().nearest_of_all = b.set.view().nearest_of_all = all;
        a.forces(portable<Real>());
        b.forces(avx2<Real>());
        same("forces");
      }
      for (const AdvanceRule<Real>& rule : {widthRule<Real>(), dissertationRule<Real>(), freeRule<Real>()}) {
        std::uint64_t limited_a = 0, limited_b = 0;
        const auto& blocks = a.set.movingBlocks();
        portable<Real>().advance(a.set.view(), rule, blocks.data(), 0, blocks.size(), &limited_a);
        avx2<Real>().advance(b.set.view(), rule, blocks.data(), 0, blocks.size(), &limited_b);
        same("advance");
        EXPECT_EQ(limited_a, limited_b);
        EXPECT_EQ(limited_a > 0, rule.limits);
      }
      const std::size_t guarded = a.set.guardedBlocks();
      portable<Real>().refreshWidths(a.set.view(), Real(0.3 * kH), 0, guarded);
      avx2<Real>().refreshWidths(b.set.view(), Real(0.3 * kH), 0, guarded);
      same("refreshWidths");
      std::vector<std::uint8_t> suspicious_a(guarded, 2), suspicious_b(guarded, 2);
      // So wide that all are computed after the move too, and some are suspicious.
      portable<Real>().checkWidths(a.set.view(), Real(0.4 * kH), 0, guarded, suspicious_a.data());
      avx2<Real>().checkWidths(b.set.view(), Real(0.4 * kH), 0, guarded, suspicious_b.data());
      same("checkWidths");
      EXPECT_EQ(suspicious_a, suspicious_b);
      portable<Real>().apply(a.set.view(), a.set.movingBlocks().data(), 0, a.set.movingBlocks().size());
      avx2<Real>().apply(b.set.view(), b.set.movingBlocks().data(), 0, b.set.movingBlocks().size());
      same("apply");
      portable<Real>().stiffnessProduct(a.set.view(), a.set.view().velocity, a.set.view().force,
                                        a.set.movingBlocks().data(), 0, a.set.movingBlocks().size());
      avx2<Real>().stiffnessProduct(b.set.view(), b.set.view().velocity, b.set.view().force,
                                    b.set.movingBlocks().data(), 0, b.set.movingBlocks().size());
      same("stiffnessProduct");
    }
  }
}

#endif

/// Both sum the same few dozen terms in another order. Double: some rounding errors of 1.1e-16 of terms that may be ten
/// times the sum. Float: 6e-8 each, and the difference of lengths keeps its digits because it comes from displacements.
template <typename Real>
constexpr double kForceTolerance = sizeof(Real) == 4 ? 3e-6 : 1e-14;

TYPED_TEST(KernelTest, ForcesAreThoseOfTheOracle) {
  using Real = TypeParam;
  for (const Case& c : cases()) {
    SCOPED_TRACE(c.name);
    const bool cut = c.name.find("cut") == 0;
    EXPECT_EQ(cut, c.lattice.vertexCount() > std::size_t((c.lattice.dims + Vector3i::Ones()).prod()));
    Packed<Real> packed(c, false, 7);
    // The oracle gets the displacements as the kernel has them.
    std::vector<Vector3> u = Random(7).boxed(c.lattice.vertexCount(), kMove);
    for (Vector3& v : u) {
      for (int d = 0; d < 3; ++d)
        v[d] = double(Real(v[d]));
    }
    const std::vector<Vector3> inner = oracleForces(c.lattice, c.materials, u, c.rule);
    const std::vector<double> masses = oracleMasses(c.lattice, c.materials, c.rule);
    packed.forces(bestKernel<Real>());
    const KernelView<Real>& view = packed.set.view();
    ASSERT_FALSE(packed.set.moving().empty());
    double worst = 0.0;
    for (const std::uint32_t v : packed.set.moving()) {
      const std::uint32_t global = packed.set.globalVertex(v);
      const Vector3 expected =
          inner[global] + packed.at(view.external, v) + masses[global] * Vector3(1.0, 0.0, double(Real(-9.81)));
      worst = std::max(worst, (packed.at(view.force, v) - expected).norm());
      EXPECT_NEAR(double(view.mass[v]), masses[global], 1e-7 * masses[global]);
    }
    EXPECT_LT(worst, kForceTolerance<Real> * largest(inner));
  }
}

/// Cells that are asleep around a vertex count by their places alone: packed or not, its force has the same bits.
TYPED_TEST(KernelTest, ForceOnAVertexDoesNotDependOnWhatElseIsPacked) {
  using Real = TypeParam;
  for (Case c : cases()) {
    SCOPED_TRACE(c.name);
    if (c.active.empty())
      c.active = {0, 1, static_cast<std::uint32_t>(c.lattice.cellCount() - 1)};
    Packed<Real> part(c, true, 9);
    c.active.clear();
    Packed<Real> whole(c, false, 9);
    part.forces(bestKernel<Real>());
    whole.forces(bestKernel<Real>());
    std::size_t compared = 0;
    for (const auto* list : {&part.set.moving(), &part.set.frontier()}) {
      for (const std::uint32_t v : *list) {
        const std::uint32_t there = whole.set.localVertex(part.set.globalVertex(v));
        EXPECT_EQ(part.at(part.set.view().force, v), whole.at(whole.set.view().force, there));
        EXPECT_EQ(part.set.view().mass[v], whole.set.view().mass[there]);
        ++compared;
      }
    }
    EXPECT_GT(compared, 7U);
    EXPECT_LE(part.set.vertexCount(), whole.set.vertexCount());
  }
}

/// Widths in units of h: some ten operations on edges of about h.
template <typename Real>
constexpr double kWidthTolerance = sizeof(Real) == 4 ? 1e-5 : 1e-12;

template <typename Real>
double widthByDefinition(const Case& c, const Packed<Real>& packed, std::uint32_t cell, bool after) {
  CellCorners corners;
  for (int n = 0; n < 8; ++n) {
    const std::uint32_t v = packed.set.cornerVertex(cell, n);
    corners[std::size_t(n)] =
        packed.at(packed.set.view().displacement, v) + c.lattice.rest_positions[packed.set.globalVertex(v)];
    if (after)
      corners[std::size_t(n)] += packed.at(packed.set.view().move, v);
  }
  return cellMinWidth(corners);
}

TYPED_TEST(KernelTest, WidthsAreThoseOfTheDefinitionAndBoundsAreBelowThem) {
  using Real = TypeParam;
  for (const Case& c : cases()) {
    for (const double least : {0.02, 0.4}) {
      SCOPED_TRACE(c.name + ", least width " + std::to_string(least));
      Packed<Real> packed(c, true, 11);
      const KernelView<Real>& view = packed.set.view();
      bestKernel<Real>().refreshWidths(view, Real(10.0 * kH), 0, packed.set.guardedBlocks());
      for (std::uint32_t cell = 0; cell < packed.set.guardedCells(); ++cell) {
        EXPECT_NEAR(double(view.width_bound[cell]), widthByDefinition(c, packed, cell, false),
                    kWidthTolerance<Real> * kH);
      }
      std::vector<std::uint8_t> suspicious(packed.set.guardedBlocks());
      bestKernel<Real>().checkWidths(view, Real(least * kH), 0, packed.set.guardedBlocks(), suspicious.data());
      for (std::uint32_t cell = 0; cell < packed.set.guardedCells(); ++cell) {
        const double width = widthByDefinition(c, packed, cell, true);
        EXPECT_LE(double(view.width_bound[cell]), width + kWidthTolerance<Real> * kH);
        if (width < (least - kWidthTolerance<Real>)*kH) {
          EXPECT_EQ(suspicious[cell / kLanes<Real>], 1);
        }
      }
    }
  }
}

/// Where all springs are stretched nothing is left out of the tangent, so it is the derivative of the force.
TEST(StiffnessProduct, IsTheDerivativeOfTheForce) {
  const Case c = {"block", makeBlock(4, 3, 2, kH), oneMaterial(kModulus)};
  Packed<double> packed(c, false, 1);
  SolveSet<double>& set = packed.set;
  const std::vector<Vector3> noise = Random(3).boxed(c.lattice.vertexCount(), 0.02 * kH);
  const std::vector<Vector3> direction = Random(4).boxed(c.lattice.vertexCount(), 1.0);
  const auto forcesAt = [&](double step_m) {
    std::vector<Vector3> u = noise;
    for (std::size_t v = 0; v < u.size(); ++v)
      u[v] += 0.2 * c.lattice.rest_positions[v] + step_m * direction[v];
    packed.fill(set.view().displacement, u);
    packed.forces(bestKernel<double>());
    std::vector<Vector3> forces;
    for (std::uint32_t v = 0; v < set.vertexCount(); ++v)
      forces.push_back(packed.at(set.view().force, v));
    return forces;
  };
  constexpr double kStep = 1e-7 * kH;
  const std::vector<Vector3> above = forcesAt(kStep);
  const std::vector<Vector3> below = forcesAt(-kStep);
  forcesAt(0.0);
  packed.fill(set.view().velocity, direction);
  bestKernel<double>().stiffnessProduct(set.view(), set.view().velocity, set.view().move, set.movingBlocks().data(), 0,
                                        set.movingBlocks().size());
  for (std::uint32_t v = 0; v < set.vertexCount(); ++v) {
    const Vector3 expected = (below[v] - above[v]) / (2.0 * kStep);
    // The difference quotient is exact to 1e-14 (second order) plus 1e-16 / 1e-7 of rounding.
    EXPECT_LT((packed.at(set.view().move, v) - expected).norm(), 1e-7 * kModulus * kH);
  }
}

}  // namespace
}  // namespace soft_volume::core
