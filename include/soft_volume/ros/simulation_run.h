#pragma once

#include <ros/time.h>

#include <cstdint>
#include <memory>
#include <string>

#include "soft_volume/messages/journal.h"
#include "soft_volume/session/lockstep.h"
#include "soft_volume/session/session.h"

namespace soft_volume {

/// What the simulation is running: a session with its journal, and where simulated time lies in ROS time. Only for the
/// simulation's thread.
struct SimulationRun {
  std::unique_ptr<core::Session> session;
  std::unique_ptr<Journal> journal;  ///< of that session
  std::string frame_id;              ///< of the volume
  ros::Time epoch;                   ///< of simulated time zero
  bool begun = false;                ///< the session has an epoch
  bool paused = false;

  ros::Time stampOf(std::uint64_t step) const {
    const auto epoch_ns = static_cast<std::int64_t>(epoch.toNSec());
    return ros::Time().fromNSec(
        static_cast<std::uint64_t>(core::lockstepStamp(epoch_ns, session->simulationTimeAt(step))));
  }
  ros::Time stampNow() const { return stampOf(session->steps()); }
  std::int64_t now_ns() const { return static_cast<std::int64_t>(stampNow().toNSec()); }

  /// Fills the header of a message about the state of now.
  template <typename Message>
  void stamp(Message& message) const {
    message.header.stamp = stampNow();
    message.header.frame_id = frame_id;
  }
};

}  // namespace soft_volume
