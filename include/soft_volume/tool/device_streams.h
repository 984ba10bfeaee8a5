#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

#include "soft_volume/common/geometry.h"
#include "soft_volume/tool/tool.h"

namespace soft_volume::core {

/// What a device said at one time.
struct DeviceSample {
  std::int64_t stamp_ns = 0;
  Pose pose;                            ///< as the driver sent it
  std::optional<Vector3> velocity_m_s;  ///< where the driver measures it
  Buttons buttons;
};

/// Puts the messages of a device, which come by several topics in any order between them, into the order of their
/// stamps: one sample per pose, with the velocity and the buttons of its time. What comes out depends on stamps alone,
/// not on when or in which order the topics' messages came.
///
/// For that a pose waits until every other topic has come as far, or has been declared sparse (a button that is only
/// sent when it changes); then it waits until the poses themselves are kWindow_s further. A message that comes later
/// than that counts from the next sample on, and as late. Not thread-safe.
class DeviceStreams {
 public:
  /// By so much poses are ahead of a sparse topic's messages at most.
  static constexpr double kWindow_s = 0.05;
  /// A velocity that is older than its pose by more is none.
  static constexpr double kVelocityLife_s = 0.02;

  DeviceStreams(bool has_velocity, std::size_t button_topics);

  // Each topic's stamps increase; a message with the stamp of the one before, or an older one, is dropped and counted.
  void addPose(std::int64_t stamp_ns, const Pose& pose);
  void addVelocity(std::int64_t stamp_ns, const Vector3& velocity_m_s);
  /// The buttons of `mask` are now as in `pressed`.
  void addButtons(std::size_t topic, std::int64_t stamp_ns, const Buttons& mask, const Buttons& pressed);

  /// The topics that the oldest pose waits for are sparse from now on; returns how many those are.
  std::size_t declareSparse();
  /// Of each other topic than the poses, only so many messages wait from now on: the newest ones, each of which says
  /// all that its topic has to say. For a device that sends no poses. Returns how many were dropped.
  std::size_t keepNewestOfOthers(std::size_t most);
  /// Nothing more will come.
  void end() { ended_ = true; }

  /// The next sample in order; nothing while it is not complete.
  std::optional<DeviceSample> next();

  /// Poses that wait.
  std::size_t waiting() const { return poses_.size(); }
  std::size_t late() const { return late_; }
  std::size_t dropped() const { return dropped_; }

 private:
  struct TimedPose {
    std::int64_t stamp_ns;
    Pose pose;
  };
  struct TimedVelocity {
    std::int64_t stamp_ns;
    Vector3 velocity_m_s;
  };
  struct TimedButtons {
    std::int64_t stamp_ns;
    Buttons mask;
    Buttons pressed;
  };
  /// How far a topic has come.
  struct Progress {
    std::int64_t newest_ns = INT64_MIN;
    bool sparse = false;
  };

  bool isNew(Progress& progress, std::int64_t stamp_ns);
  bool blocks(const Progress& progress, std::int64_t stamp_ns) const;
  std::optional<Vector3> velocityAt(std::int64_t stamp_ns);
  void pressUntil(std::int64_t stamp_ns);

  std::deque<TimedPose> poses_;
  std::deque<TimedVelocity> velocities_;
  std::vector<std::deque<TimedButtons>> presses_;
  Progress pose_progress_;
  std::vector<Progress> others_;  // the velocity's, where there is one, then the buttons'
  bool has_velocity_;
  bool ended_ = false;
  std::optional<TimedVelocity> velocity_;  // the newest one used
  Buttons buttons_;
  std::int64_t given_ns_ = INT64_MIN;  // stamp of the newest sample given out
  std::size_t late_ = 0;
  std::size_t dropped_ = 0;
};

}  // namespace soft_volume::core
