#include "soft_volume/tool/spsc_ring.h"

#include <gtest/gtest.h>

#include <memory>
#include <thread>

namespace soft_volume::core {
namespace {

TEST(SpscRingTest, IsAQueueOfItsCapacity) {
  SpscRing<int, 4> ring;
  int item = -1;
  EXPECT_FALSE(ring.pop(item));
  for (int round = 0; round < 5; ++round) {
    for (int n = 0; n < 4; ++n)
      EXPECT_TRUE(ring.push(10 * round + n));
    EXPECT_FALSE(ring.push(99));
    for (int n = 0; n < 4; ++n) {
      ASSERT_TRUE(ring.pop(item));
      EXPECT_EQ(item, 10 * round + n);
    }
    EXPECT_FALSE(ring.pop(item));
  }
}

TEST(SpscRingTest, WhatDoesNotFitStaysWithTheCaller) {
  SpscRing<std::unique_ptr<int>, 1> ring;
  EXPECT_TRUE(ring.push(std::make_unique<int>(1)));
  auto second = std::make_unique<int>(2);
  EXPECT_FALSE(ring.push(std::move(second)));
  ASSERT_TRUE(second != nullptr);
  EXPECT_EQ(*second, 2);
}

TEST(SpscRingTest, NothingIsLostOrReorderedBetweenTwoThreads) {
  constexpr int kItems = 200000;
  SpscRing<int, 64> ring;
  std::thread producer([&] {
    for (int n = 0; n < kItems;) {
      if (ring.push(n))
        ++n;
      else
        std::this_thread::yield();
    }
  });
  int wrong = 0;
  for (int expected = 0; expected < kItems;) {
    int item = -1;
    if (!ring.pop(item)) {
      std::this_thread::yield();
      continue;
    }
    wrong += item == expected ? 0 : 1;
    ++expected;
  }
  producer.join();
  EXPECT_EQ(wrong, 0);
}

}  // namespace
}  // namespace soft_volume::core
