#include "plane_buckets.h"

#include <numeric>

namespace soft_volume::core {

/// Calls visit(checkpoint, item) for every item that is cut by the checkpoint's plane and by one before it.
template <typename Visit>
void PlaneBuckets::forEachCheckpoint(const Visit& visit) const {
  for (std::size_t plane = 0; plane + 2 < begin_.size(); ++plane) {
    const std::size_t following = plane / kPlanesPerCheckpoint + 1;
    for (std::size_t i = begin_[plane]; i < begin_[plane + 1]; ++i) {
      for (std::size_t c = following; c * kPlanesPerCheckpoint < items_[i].end; ++c)
        visit(c, items_[i]);
    }
  }
}

void PlaneBuckets::makeCheckpoints(int planes) {
  checkpoint_begin_.assign(std::size_t(planes / kPlanesPerCheckpoint) + 2, 0);
  forEachCheckpoint([&](std::size_t checkpoint, const Item&) { ++checkpoint_begin_[checkpoint + 1]; });
  std::partial_sum(checkpoint_begin_.begin(), checkpoint_begin_.end(), checkpoint_begin_.begin());
  checkpoint_items_.resize(checkpoint_begin_.back());
  std::vector<std::size_t> next = checkpoint_begin_;
  forEachCheckpoint([&](std::size_t checkpoint, const Item& item) { checkpoint_items_[next[checkpoint]++] = item; });
}

void PlaneBuckets::seed(int plane, std::vector<Item>& active) const {
  const auto checkpoint = std::size_t(plane / kPlanesPerCheckpoint);
  const auto isCut = [plane](const Item& item) { return int(item.end) > plane; };
  active.clear();
  const Item* listed = checkpoint_items_.data();
  std::copy_if(listed + checkpoint_begin_[checkpoint], listed + checkpoint_begin_[checkpoint + 1],
               std::back_inserter(active), isCut);
  std::copy_if(begin(int(checkpoint) * kPlanesPerCheckpoint), begin(plane), std::back_inserter(active), isCut);
}

}  // namespace soft_volume::core
