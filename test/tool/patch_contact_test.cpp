#include "soft_volume/tool/patch_contact.h"

#include <gtest/gtest.h>

#include <chrono>
#include <iostream>
#include <limits>
#include <random>

#include "common/count_allocations.h"
#include "soft_volume/common/error.h"
#include "soft_volume/tool/proxy.h"
#include "tissue_fixture.h"
#include "tissue_in_pieces.h"

namespace soft_volume::core {
namespace {

PatchContact contactOf(const Tissue& tissue, double threshold = 0.0) {
  PatchContact contact(tissue.volume, threshold);
  contact.update(tissue.topology, tissue.patch);
  return contact;
}

/// A smooth, strongly non-linear deformation: bends and compresses by up to a third.
Vector3 bend(const Vector3& p) {
  return {p.x() + 0.004 * std::sin(80.0 * p.z()), p.y() + 0.3 * p.x() * std::cos(60.0 * p.y()) * 0.2,
          p.z() * 0.8 + 0.003 * std::sin(90.0 * p.x()) * std::cos(70.0 * p.y())};
}

Vector3 randomPoint(std::mt19937& random, const Vector3& low, const Vector3& high) {
  std::uniform_real_distribution<double> number(0.0, 1.0);
  return low + Vector3(number(random), number(random), number(random)).cwiseProduct(high - low);
}

TEST(PatchContactTest, FindsEveryPointOfEveryCell) {
  Tissue tissue = makeFlatHalfSpace();
  tissue.deform(bend);
  const PatchContact contact = contactOf(tissue);
  std::mt19937 random(11);
  for (std::uint32_t cell = 0; cell < contact.cellCount(); ++cell) {
    for (int n = 0; n < 10; ++n) {
      const PatchContact::CellPoint at{cell, randomPoint(random, Vector3::Zero(), Vector3::Ones())};
      const PatchContact::CellPoint found = contact.locate(contact.position(at));
      ASSERT_TRUE(found.found());
      EXPECT_LT((contact.position(found) - contact.position(at)).norm(), 1e-9);
      EXPECT_LT((contact.volumePoint(found) - contact.volumePoint(at)).norm(), 1e-7);
    }
  }
}

TEST(PatchContactTest, FacesAndEdgesHaveNoGaps) {
  Tissue tissue = makeFlatHalfSpace();
  tissue.deform(bend);
  const PatchContact contact = contactOf(tissue);
  std::mt19937 random(12);
  for (std::uint32_t cell = 0; cell < contact.cellCount(); ++cell) {
    Vector3 local = randomPoint(random, Vector3::Zero(), Vector3::Ones());
    for (int axis = 0; axis < 3; ++axis) {
      local[axis] = double((cell + axis) % 2);  // on a face, then an edge, then a corner
      EXPECT_TRUE(contact.locate(contact.position({cell, local})).found()) << "cell " << cell << " axis " << axis;
    }
  }
}

TEST(PatchContactTest, MapsBackToTheVolume) {
  Tissue tissue = makeFlatHalfSpace();
  Matrix3 a;
  a << 1.1, 0.4, 0.0, 0.0, 0.9, 0.2, 0.1, 0.0, 0.7;
  tissue.deform([&](const Vector3& p) { return Vector3(a * p + Vector3(0.01, -0.02, 0.03)); });
  const PatchContact contact = contactOf(tissue);
  std::mt19937 random(13);
  for (int n = 0; n < 200; ++n) {
    const Vector3 rest = randomPoint(random, Vector3(0.005, 0.005, 0.005), Vector3(0.059, 0.059, 0.052));
    const PatchContact::Sample sample = contact.sample(a * rest + Vector3(0.01, -0.02, 0.03));
    ASSERT_TRUE(sample.at.found());
    EXPECT_LT((contact.volumePoint(sample.at) - rest).norm(), 2e-8);  // positions are floats
    EXPECT_NEAR(sample.intensity, 1000.0 * (kSurfaceZ - rest.z()), 1e-4);
    EXPECT_EQ(sample.tissue, sample.intensity >= 0.0);
  }
}

TEST(PatchContactTest, GradientIsTheDerivativeInTheDeformedFrame) {
  const auto ramp =
      makeVolume({33, 33, 31}, 0.002, [](const Vector3& p) { return 1e3 * p.x() - 2e3 * p.y() + 3e3 * p.z(); });
  Tissue tissue = makeTissue(ramp, {8, 8, 7}, Vector3::Constant(0.004), 0.007);
  tissue.deform(bend);
  const PatchContact contact = contactOf(tissue);
  const PatchContact::CellPoint at{100, Vector3(0.3, 0.6, 0.45)};
  const Vector3 gradient = contact.gradient(at);
  for (int axis = 0; axis < 3; ++axis) {
    const Vector3 step = 1e-5 * Vector3::Unit(axis);
    const double up = contact.sample(contact.position(at) + step).intensity;
    const double down = contact.sample(contact.position(at) - step).intensity;
    EXPECT_NEAR(gradient[axis], (up - down) / 2e-5, 1e-3 * gradient.norm());
  }
}

TEST(PatchContactTest, OutsideIsAir) {
  const PatchContact contact = contactOf(makeFlatHalfSpace());
  EXPECT_FALSE(contact.sample({0.03, 0.03, 0.0539}).at.found());
  EXPECT_FALSE(contact.sample({0.0039, 0.03, 0.03}).tissue);
  EXPECT_FALSE(contact.locate({std::nan(""), 0.03, 0.03}).found());
  EXPECT_FALSE(PatchContact(makeFlatHalfSpace().volume, 0.0).sample({0.03, 0.03, 0.03}).tissue);
}

TEST(PatchContactTest, NotANumberIsAir) {
  const auto volume = makeVolume({33, 33, 31}, 0.002, [](const Vector3&) { return std::nan(""); });
  const PatchContact contact = contactOf(makeTissue(volume, {8, 8, 7}, Vector3::Constant(0.004), 0.007));
  const PatchContact::Sample sample = contact.sample({0.03, 0.03, 0.03});
  EXPECT_TRUE(sample.at.found());
  EXPECT_FALSE(sample.tissue);
}

TEST(PatchContactTest, VoxelsAreReadInTheirOwnOrder) {
  Tissue tissue = makeFlatHalfSpace();
  for (std::size_t c = 0; c < tissue.topology.cellCount(); ++c) {
    tissue.topology.cell_types[c] = CellType::kVoxel;
    std::swap(tissue.topology.connectivity[8 * c + 2], tissue.topology.connectivity[8 * c + 3]);
    std::swap(tissue.topology.connectivity[8 * c + 6], tissue.topology.connectivity[8 * c + 7]);
  }
  const PatchContact contact = contactOf(tissue);
  const Vector3 point(0.0333, 0.0217, 0.0288);
  ASSERT_TRUE(contact.locate(point).found());
  EXPECT_LT((contact.volumePoint(contact.locate(point)) - point).norm(), 1e-8);
}

TEST(PatchContactTest, KnowsWhereThePatchEndsBeforeTheGrid) {
  Tissue tissue = makeFlatHalfSpace();
  tissue.keepCells([](const Vector3& centre) { return centre.z() < 0.030; });
  tissue.topology.cut_faces[6 * tissue.cellAt(4, 4, 3) + 5] = 1;  // no tissue behind a cut, whatever is listed
  const PatchContact contact = contactOf(tissue);
  EXPECT_TRUE(contact.gridGoesOn({contact.cellOfId(tissue.cellAt(3, 3, 3)), {0.5, 0.5, 0.99}}));
  EXPECT_FALSE(contact.gridGoesOn({contact.cellOfId(tissue.cellAt(3, 3, 3)), {0.5, 0.5, 0.01}}));
  EXPECT_FALSE(contact.gridGoesOn({contact.cellOfId(tissue.cellAt(4, 4, 3)), {0.5, 0.5, 0.99}}));
  EXPECT_FALSE(contact.gridGoesOn({contact.cellOfId(tissue.cellAt(0, 3, 0)), {0.01, 0.5, 0.5}}));
}

TEST(PatchContactTest, RefusesPatchesThatDoNotFitAndKeepsTheOldOne) {
  const Tissue tissue = makeFlatHalfSpace();
  PatchContact contact = contactOf(tissue);
  const auto refuses = [&](const std::function<void(GridPatch&)>& damage) {
    GridPatch patch = tissue.patch;
    damage(patch);
    EXPECT_THROW(contact.update(tissue.topology, patch), InputError);
    EXPECT_EQ(contact.cellCount(), tissue.topology.cellCount());
    EXPECT_TRUE(contact.sample({0.03, 0.03, 0.03}).tissue);
  };
  refuses([](GridPatch& patch) { ++patch.revision; });
  refuses([](GridPatch& patch) { ++patch.session; });
  refuses([](GridPatch& patch) { patch.positions.pop_back(); });
  refuses([](GridPatch& patch) { patch.velocities.pop_back(); });
  refuses([](GridPatch& patch) { patch.stiffness_pa.pop_back(); });
  refuses([](GridPatch& patch) { patch.positions[17].y() = std::numeric_limits<float>::quiet_NaN(); });
  refuses([](GridPatch& patch) { patch.velocities[17].y() = std::numeric_limits<float>::infinity(); });
  refuses([](GridPatch& patch) { patch.cell_ids.back() = 100000; });
  refuses([](GridPatch& patch) { std::swap(patch.cell_ids[0], patch.cell_ids[1]); });
  refuses([](GridPatch& patch) { patch.vertex_ids.back() += 1; });
}

TEST(PatchContactTest, KnowsTheStiffnessAround) {
  Tissue tissue = makeFlatHalfSpace();
  for (std::uint32_t c = 0; c < tissue.patch.cell_ids.size(); ++c)
    tissue.patch.stiffness_pa[c] = c % 8 < 4 ? 4000.0F : 8000.0F;  // stiffer from x = 32 mm on
  const PatchContact contact = contactOf(tissue);
  EXPECT_DOUBLE_EQ(contact.youngsModulus({0.014, 0.030, 0.030}, 0.012), 4000.0);
  EXPECT_DOUBLE_EQ(contact.youngsModulus({0.050, 0.030, 0.030}, 0.012), 8000.0);
  EXPECT_DOUBLE_EQ(contact.youngsModulus({0.032, 0.030, 0.030}, 0.012), 6000.0);
  EXPECT_DOUBLE_EQ(contact.youngsModulus({0.0321, 0.0321, 0.0321}, 0.0001), 8000.0);
  EXPECT_DOUBLE_EQ(contact.youngsModulus({0.5, 0.5, 0.5}, 0.012), 0.0);
}

TEST(PatchContactTest, QueriesAllocateNothingAndAreQuick) {
  Tissue tissue = makeFlatHalfSpace();
  tissue.deform(bend);
  PatchContact contact = contactOf(tissue);
  Proxy tracker;
  const int count = 20000;
  double deepest = 0.0;
  const Vector3 top = bend({0.030, 0.030, kSurfaceZ});
  tracker.update(contact, top + Vector3(0, 0, 0.01), 0.004, 0.0);
  const std::size_t before = allocations;
  const auto start = std::chrono::steady_clock::now();
  for (int n = 0; n < count; ++n) {
    const double phase = 2.0 * M_PI * n / 2000.0;
    const Vector3 tip = top + Vector3(0.01 * std::sin(0.7 * phase), 0.01 * std::cos(phase), -0.01 * std::sin(phase));
    deepest = std::max(deepest, tracker.update(contact, tip, 0.004, 0.0).penetration_m);
  }
  const std::chrono::duration<double, std::micro> spent = std::chrono::steady_clock::now() - start;
  EXPECT_EQ(allocations, before);
  EXPECT_GT(deepest, 0.005);
  const auto update_start = std::chrono::steady_clock::now();
  for (int n = 0; n < 100; ++n)
    contact.update(tissue.topology, tissue.patch);
  const std::chrono::duration<double, std::micro> update = std::chrono::steady_clock::now() - update_start;
  std::cout << "[ cost     ] " << contact.cellCount() << " cells: contact query " << spent.count() / count
            << " us, patch update " << update.count() / 100 << " us\n";
}

TEST(PatchContactTest, QueriesBetweenLipsAllocateNothingAndAreQuick) {
  std::mt19937 random(14);
  TissueInPieces tissue({8, 8, 7});
  cutAtRandom(tissue, 3, random);
  const double x = 0.5 * tissue.block.size().x();
  tissue.part(x,
              [](const Vector3& p, int side) { return Vector3(0.2 * warp(p) + 0.1 * kH * side * Vector3::UnitX()); });
  PatchContact contact = tissue.contact();
  Proxy tracker;
  const int count = 4000;
  int touches = 0;
  const std::size_t before = allocations;
  const auto start = std::chrono::steady_clock::now();
  for (int n = 0; n < count; ++n) {
    const double phase = 2.0 * M_PI * n / 1000.0;
    const Vector3 wave(std::sin(0.7 * phase), std::cos(phase), std::sin(1.3 * phase));
    touches += tracker.update(contact, contact.bounds().center() + 0.4 * contact.bounds().sizes().cwiseProduct(wave),
                              0.004, 0.0)
                       .touching
                   ? 1
                   : 0;
  }
  const std::chrono::duration<double, std::micro> spent = std::chrono::steady_clock::now() - start;
  EXPECT_EQ(allocations, before);
  EXPECT_GT(touches, count / 4);
  const auto update_start = std::chrono::steady_clock::now();
  for (int n = 0; n < 100; ++n)
    contact.update(tissue.topology, tissue.patch);
  const std::chrono::duration<double, std::micro> update = std::chrono::steady_clock::now() - update_start;
  std::cout << "[ cost     ] " << contact.cellCount() << " cells, " << tissue.polyhedra()
            << " of them polyhedra: contact query " << spent.count() / count << " us, patch update "
            << update.count() / 100 << " us\n";
}

}  // namespace
}  // namespace soft_volume::core
