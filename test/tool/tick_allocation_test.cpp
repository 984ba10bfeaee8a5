#include <gtest/gtest.h>

#include "common/count_allocations.h"
#include "tick_loop.h"

namespace soft_volume::core {
namespace {

struct Seen {
  std::size_t allocations = 0;
  int touching = 0;
  int cutting = 0;
  int gripping = 0;
};

/// From the first tick on: also what comes once must not take memory.
Seen watch(TickWork work, int ticks) {
  TickLoop loop(work);
  Seen seen;
  for (int n = 0; n < ticks; ++n) {
    loop.prepare();
    const std::size_t before = allocations;
    loop.tick();
    seen.allocations += allocations - before;
    loop.answer();
    seen.touching += loop.output().contact.touching ? 1 : 0;
    seen.cutting += loop.output().cutting ? 1 : 0;
    seen.gripping += loop.output().gripping ? 1 : 0;
  }
  EXPECT_EQ(loop.refused(), 0);
  EXPECT_GE(loop.patchCells(), 250U);
  return seen;
}

TEST(TickAllocation, IsCounted) {
  const std::size_t before = allocations;
  const std::vector<int> memory(100);
  EXPECT_EQ(allocations - before, 1U);
}

TEST(TickAllocation, FreeTicksTakeNoMemory) {
  const Seen seen = watch(TickWork::kFree, 50);
  EXPECT_EQ(seen.allocations, 0U);
  EXPECT_EQ(seen.touching, 0);
}

TEST(TickAllocation, PressingAndSlidingTakesNoMemory) {
  for (const TickWork work : {TickWork::kPress, TickWork::kSlide, TickWork::kSlideOverCut}) {
    const Seen seen = watch(work, 900);
    EXPECT_EQ(seen.allocations, 0U) << int(work);
    EXPECT_GT(seen.touching, 400) << int(work);
  }
}

TEST(TickAllocation, CuttingTakesNoMemory) {
  const Seen seen = watch(TickWork::kCut, 1000);
  EXPECT_EQ(seen.allocations, 0U);
  EXPECT_GT(seen.cutting, 500);
}

TEST(TickAllocation, GrippingTakesNoMemory) {
  const Seen seen = watch(TickWork::kGrip, 1000);
  EXPECT_EQ(seen.allocations, 0U);
  EXPECT_GT(seen.gripping, 300);
}

}  // namespace
}  // namespace soft_volume::core
