#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "soft_volume/common/parallel.h"

namespace soft_volume::core {

/// Half-open range of planes, empty when both are equal.
struct PlaneRange {
  std::uint16_t first;
  std::uint16_t end;
};

/// Things (edges or cells) by the first plane that cuts them (dissertation, section 3.2), in O(n): a counting sort.
/// Every few planes it also keeps a list of what is active there, so that a walk over the planes can start anywhere
/// without looking at all that came before.
class PlaneBuckets {
 public:
  struct Item {
    std::uint32_t number;
    std::uint32_t end;  ///< one past the last plane that cuts it
  };

  /// `rangeOf(number)` of each of the ascending numbers is asked twice; what has an empty range is left out. The result
  /// does not depend on the number of threads.
  template <typename RangeOf>
  void build(const std::vector<std::uint32_t>& numbers, int planes, int threads, const RangeOf& rangeOf);

  /// What is cut by `plane` first, ascending by number.
  const Item* begin(int plane) const { return items_.data() + begin_[std::size_t(plane)]; }
  const Item* end(int plane) const { return items_.data() + begin_[std::size_t(plane) + 1]; }
  /// What is cut by `plane` and was cut before, ascending by first plane, then by number.
  void seed(int plane, std::vector<Item>& active) const;

 private:
  static constexpr int kPlanesPerCheckpoint = 8;

  template <typename Visit>
  void forEachCheckpoint(const Visit& visit) const;
  void makeCheckpoints(int planes);

  std::vector<std::size_t> begin_;  ///< per plane, of what no plane cuts, and the end
  std::vector<Item> items_;
  std::vector<std::size_t> checkpoint_begin_;  ///< per checkpoint, and the end
  std::vector<Item> checkpoint_items_;
};

template <typename RangeOf>
void PlaneBuckets::build(const std::vector<std::uint32_t>& numbers, int planes, int threads, const RangeOf& rangeOf) {
  const std::size_t count = numbers.size();
  // Each block of numbers counts on its own, so that blocks can be filled in beside each other.
  const auto blocks = std::size_t(std::max(1, threads));
  // What has no range goes into a bucket of its own at the end: half of all edges are of that kind, in no order that a
  // processor could foresee, so a branch would cost more.
  const auto none = std::size_t(planes);
  const std::size_t buckets = none + 1;
  const auto bucketOf = [none](PlaneRange range) { return range.first < range.end ? std::size_t(range.first) : none; };
  const auto blockBegin = [&](std::size_t block) { return count * block / blocks; };
  std::vector<std::size_t> next(blocks * buckets, 0);
  parallelFor(std::ptrdiff_t(blocks), threads, [&](std::ptrdiff_t b) {
    const auto block = std::size_t(b);
    for (std::size_t i = blockBegin(block); i < blockBegin(block + 1); ++i) {
      ++next[block * buckets + bucketOf(rangeOf(numbers[i]))];
    }
  });
  begin_.assign(buckets + 1, 0);
  std::size_t sum = 0;
  for (std::size_t plane = 0; plane < buckets; ++plane) {
    begin_[plane] = sum;
    for (std::size_t block = 0; block < blocks; ++block) {
      const std::size_t size = next[block * buckets + plane];
      next[block * buckets + plane] = sum;
      sum += size;
    }
  }
  begin_[buckets] = sum;
  items_.resize(count);
  parallelFor(std::ptrdiff_t(blocks), threads, [&](std::ptrdiff_t b) {
    const auto block = std::size_t(b);
    for (std::size_t i = blockBegin(block); i < blockBegin(block + 1); ++i) {
      const PlaneRange range = rangeOf(numbers[i]);
      items_[next[block * buckets + bucketOf(range)]++] = {numbers[i], range.end};
    }
  });
  makeCheckpoints(planes);
}

}  // namespace soft_volume::core
