#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <utility>

namespace soft_volume::core {

/// A queue of a fixed size between one thread that pushes and one that pops: neither ever waits, locks or allocates
/// (beyond what moving a T does). Several threads may share one end if something else serialises them.
template <typename T, std::size_t kCapacity>
class SpscRing {
  static_assert(kCapacity > 0 && (kCapacity & (kCapacity - 1)) == 0, "a power of two");

 public:
  /// False, with `item` untouched, when the queue is full.
  bool push(T&& item) {
    const std::size_t end = end_.load(std::memory_order_relaxed);
    if (end - begin_.load(std::memory_order_acquire) == kCapacity)
      return false;
    items_[end % kCapacity] = std::move(item);
    end_.store(end + 1, std::memory_order_release);
    return true;
  }
  bool push(const T& item) { return push(T(item)); }

  /// False when there is none.
  bool pop(T& item) {
    const std::size_t begin = begin_.load(std::memory_order_relaxed);
    if (begin == end_.load(std::memory_order_acquire))
      return false;
    item = std::move(items_[begin % kCapacity]);
    begin_.store(begin + 1, std::memory_order_release);
    return true;
  }

 private:
  std::array<T, kCapacity> items_{};
  alignas(64) std::atomic<std::size_t> begin_{0};
  alignas(64) std::atomic<std::size_t> end_{0};
};

}  // namespace soft_volume::core
