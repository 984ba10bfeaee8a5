// How tissue moves from one patch to the next.

#include <gtest/gtest.h>

#include <chrono>
#include <iostream>

#include "common/count_allocations.h"
#include "soft_volume/tool/patch_contact.h"
#include "tissue_fixture.h"
#include "tissue_in_pieces.h"

namespace soft_volume::core {
namespace {

constexpr double kInterval = 1.0 / 30.0;

Vector3 bend(const Vector3& p) {
  return p + Vector3(0.003 * std::sin(60.0 * p.z()), 0.002 * std::cos(50.0 * p.x()), -0.1 * p.z());
}

PatchContact contactOf(const Tissue& tissue) {
  PatchContact contact(tissue.volume, 0.0);
  contact.update(tissue.topology, tissue.patch);
  return contact;
}

Vector3 middleOf(const PatchContact& field, std::uint32_t id, const Vector3& local = Vector3(0.3, 0.6, 0.5)) {
  return field.position({field.cellOfId(id), local, 0});
}

class PatchMotionTest : public testing::Test {
 protected:
  Tissue tissue_ = makeFlatHalfSpace();
  PatchContact shown_ = contactOf(tissue_);

  PatchContact bent() {
    tissue_.deform(bend, [](const Vector3&) { return Vector3(9.0, 9.0, 9.0); });
    return contactOf(tissue_);
  }
};

TEST_F(PatchMotionTest, GoesStraightFromThereToHere) {
  const PatchContact newest = bent();
  PatchContact moving = newest;
  moving.beginFrom(shown_, kInterval);
  for (int n = 0; n <= 10; ++n) {
    const double share = n / 10.0;
    for (const std::uint32_t id : {0U, 100U, 447U}) {
      const Vector3 from = middleOf(shown_, id);
      const Vector3 to = middleOf(newest, id);
      const Vector3 wanted = from + share * (to - from);
      EXPECT_LT((middleOf(moving, id) - wanted).norm(), 1e-12) << n;
      const Vector3 velocity = moving.velocity({moving.cellOfId(id), Vector3(0.3, 0.6, 0.5), 0});
      EXPECT_LT((velocity - (n < 10 ? Vector3((to - from) / kInterval) : Vector3(0, 0, 0))).norm(), 1e-9) << n;
      const auto at = moving.locate(wanted);
      ASSERT_TRUE(at.found());
      EXPECT_EQ(moving.cellId(at.cell), id);
      EXPECT_LT((at.local - Vector3(0.3, 0.6, 0.5)).norm(), 1e-6);
    }
    moving.advance(n == 9 ? 0.1001 * kInterval : 0.1 * kInterval);
  }
  moving.advance(1.0);
  EXPECT_EQ(middleOf(moving, 100), middleOf(newest, 100));
}

TEST_F(PatchMotionTest, ANewPatchHalfwayDoesNotJump) {
  PatchContact moving = bent();
  moving.beginFrom(shown_, kInterval);
  moving.advance(0.4 * kInterval);
  tissue_.deform([](const Vector3& p) { return Vector3(p + Vector3(0.0, 0.002, 0.0)); });
  PatchContact next = contactOf(tissue_);
  next.beginFrom(moving, kInterval);
  for (std::uint32_t id = 0; id < 448; ++id)
    EXPECT_LT((middleOf(next, id) - middleOf(moving, id)).norm(), 1e-12);
}

TEST_F(PatchMotionTest, WhatOnlyTheNewPatchHasBeginsBesideItsNeighbours) {
  tissue_.keepCells([](const Vector3& centre) { return centre.x() < 0.035; });
  const auto all_vertices = tissue_.patch.vertex_ids;
  GridPatch& patch = tissue_.patch;
  const auto keepVertices = [&](double below_x) {
    std::vector<std::uint32_t> kept;
    for (const std::uint32_t v : all_vertices) {
      if (tissue_.topology.rest_positions[v].x() < below_x)
        kept.push_back(v);
    }
    patch.vertex_ids = kept;
    patch.positions.resize(kept.size());
    patch.velocities.resize(kept.size());
  };
  keepVertices(0.0395);
  tissue_.deform(identity);
  shown_.update(tissue_.topology, patch);
  const Vector3 shift(0.003, -0.002, 0.001);
  patch.cell_ids.clear();
  for (std::uint32_t c = 0; c < tissue_.topology.cellCount(); ++c)
    patch.cell_ids.push_back(c);
  tissue_.keepCells([](const Vector3& centre) { return centre.x() < 0.042; });
  keepVertices(0.0465);
  tissue_.deform([&](const Vector3& p) { return Vector3(p + shift); });
  PatchContact moving = contactOf(tissue_);
  moving.beginFrom(shown_, kInterval);
  for (const std::uint32_t id : patch.cell_ids)
    EXPECT_LT((middleOf(moving, id) + shift - middleOf(contactOf(tissue_), id)).norm(), 1e-7) << id;
}

TEST_F(PatchMotionTest, AnotherSessionIsShownAtOnce) {
  tissue_.topology.session = tissue_.patch.session = 8;
  const PatchContact newest = bent();
  PatchContact moving = newest;
  moving.beginFrom(shown_, kInterval);
  EXPECT_EQ(middleOf(moving, 100), middleOf(newest, 100));
  PatchContact empty(tissue_.volume, 0.0);
  moving.beginFrom(empty, kInterval);
  EXPECT_EQ(middleOf(moving, 100), middleOf(newest, 100));
}

// A cut between two patches: the tissue has new vertices and other cells, and is where it was.
TEST_F(PatchMotionTest, ACutDoesNotMoveTheTissue) {
  TissueInPieces tissue({6, 6, 6});
  const auto bendAll = [&](double amount) {
    for (std::uint32_t v = 0; v < tissue.block.mesh.vertexCount(); ++v) {
      const Vector3& rest = tissue.block.mesh.restPositions()[v];
      tissue.block.positions_m[v] = rest + amount * (warp(rest) - rest);
    }
    tissue.move();
  };
  tissue.cut({squareQuad(Vector3(2.3, 3.0, 3.0) * kH, Vector3(1.0, 0.2, 0.1), 20.0 * kH)});
  bendAll(0.2);
  PatchContact shown = tissue.contact();
  tissue.cut({squareQuad(Vector3(3.0, 3.2, 3.4) * kH, Vector3(0.1, 1.0, 0.3), 20.0 * kH)});
  bendAll(0.5);
  PatchContact moving = tissue.contact();
  moving.beginFrom(shown, kInterval);
  std::mt19937 random(3);
  std::uniform_real_distribution<double> number(0.5, 5.5);
  double worst = 0.0;
  for (int n = 0; n < 2000; ++n) {
    const Vector3 rest = kH * Vector3(number(random), number(random), number(random));
    const Vector3 there = rest + 0.2 * (warp(rest) - rest);
    const auto before = shown.locate(there);
    const auto now = moving.locate(there);
    if (before.found() && now.found())
      worst = std::max(worst, (moving.volumePoint(now) - shown.volumePoint(before)).norm());
  }
  EXPECT_GT(worst, 0.0);
  EXPECT_LT(worst, 0.02 * kH);  // a trilinear cell and its pieces differ inside
  moving.advance(kInterval);
  worst = 0.0;
  const PatchContact newest = tissue.contact();
  for (const std::uint32_t id : tissue.patch.cell_ids) {
    const std::uint32_t cell = moving.cellOfId(id);
    if (cell != PatchContact::kNoCell)
      worst = std::max(worst, (moving.position({cell, Vector3(0.6, 0.2, 0.1), 0}) -
                               newest.position({cell, Vector3(0.6, 0.2, 0.1), 0}))
                                  .norm());
  }
  EXPECT_EQ(worst, 0.0);
}

TEST_F(PatchMotionTest, TakesNoMemory) {
  TissueInPieces tissue({8, 8, 8});
  tissue.cut({squareQuad(Vector3(2.3, 3.0, 3.0) * kH, Vector3(1.0, 0.2, 0.1), 20.0 * kH)});
  PatchContact shown = tissue.contact();
  for (const double amount : {0.1, 1.0, 30.0}) {  // the last one tears cells over the whole block
    for (std::uint32_t v = 0; v < tissue.block.mesh.vertexCount(); ++v)
      tissue.block.positions_m[v] += amount * kH * Vector3(std::sin(7.0 * v), std::cos(5.0 * v), std::sin(3.0 * v));
    tissue.move();
    PatchContact moving = tissue.contact();
    const std::size_t before = allocations;
    const auto start = std::chrono::steady_clock::now();
    moving.beginFrom(shown, kInterval);
    const std::chrono::duration<double, std::micro> begun = std::chrono::steady_clock::now() - start;
    for (int n = 0; n < 20; ++n) {
      moving.advance(0.001);
      moving.sample(Vector3(2.5, 2.5, 2.5) * kH);
    }
    const std::chrono::duration<double, std::micro> spent = std::chrono::steady_clock::now() - start - begun;
    EXPECT_EQ(allocations, before) << amount;
    std::cout << "[ cost     ] " << moving.cellCount() << " cells: begin " << begun.count() << " us, advance "
              << spent.count() / 20 << " us\n";
  }
}

}  // namespace
}  // namespace soft_volume::core
