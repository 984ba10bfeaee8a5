#include "soft_volume/tool/patch_intake.h"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
void PatchIntake::setVolume(std::shared_ptr<const Volume> volume) {
  volume_ = std::move(volume);
  topology_.reset();
}

bool PatchIntake::setTopology(std::shared_ptr<const Topology> topology) {
  assert(topology);
  const bool new_session = !topology_ || topology_->session != topology->session;
  topology_ = std::move(topology);
  return new_session;
}

std::unique_ptr<ReadyPatch> PatchIntake::makeEmpty() const {
  if (!volume_)
    return nullptr;
  auto ready = std::make_unique<ReadyPatch>(volume_, tissue_threshold_);
  if (topology_) {
    ready->session = topology_->session;
    ready->revision = topology_->revision;
  }
  return ready;
}

void PatchIntake::fill(const GridPatch& patch, ReadyPatch* ready) const {
  if (!volume_ || !topology_)
    throw InputError("grid patch: it came before the volume and the grid; wait for them");
  if (patch.tool_id != tool_id_)
    throw InputError("grid patch: made for tool '" + patch.tool_id + "'");
  if (!(std::isfinite(patch.blade_resistance_n) && patch.blade_resistance_n >= 0.0))
    throw InputError("grid patch: the blade's resistance is not a number from 0 on; wait for the next patch");
  ready->field.update(*topology_, patch);
  ready->blade_resistance_n = patch.blade_resistance_n;
  ready->session = patch.session;
  ready->revision = patch.revision;
  ready->step = patch.step;
}

void PatchWatch::take(double time_s) {
  if (newest_s_ && time_s > *newest_s_ && !stopped(time_s))
    intervals_s_[count_++ % kKept] = time_s - *newest_s_;
  newest_s_ = time_s;
}

double PatchWatch::interval() const {
  const std::size_t known = std::min(count_, kKept);
  if (known == 0)
    return 0.0;
  std::array<double, kKept> sorted = intervals_s_;
  std::nth_element(sorted.begin(), sorted.begin() + known / 2, sorted.begin() + known);
  return sorted[known / 2];
}

double PatchWatch::limit() const {
  return count_ == 0 ? kUnknown_s : std::max(kLeast_s, kIntervals * interval());
}

}  // namespace soft_volume::core
