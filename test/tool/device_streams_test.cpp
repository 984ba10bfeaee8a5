#include "soft_volume/tool/device_streams.h"

#include <gtest/gtest.h>

#include <random>

namespace soft_volume::core {
namespace {

constexpr std::int64_t kMillisecond = 1000000;

Pose poseAt(std::int64_t n) {
  Pose pose;
  pose.position_m.x() = static_cast<double>(n);
  return pose;
}

Buttons only(std::size_t button) {
  return Buttons().set(button);
}

/// The messages of a device for 200 ms: a pose and a velocity every millisecond, buttons every third.
struct Messages {
  std::int64_t pose = 0;
  std::int64_t velocity = 0;
  std::int64_t buttons = 0;
  static constexpr std::int64_t kCount = 200;

  bool sendPose(DeviceStreams& streams) {
    if (pose < kCount)
      streams.addPose(pose * kMillisecond, poseAt(pose));
    return pose++ < kCount;
  }
  bool sendVelocity(DeviceStreams& streams) {
    if (velocity < kCount)
      streams.addVelocity(velocity * kMillisecond, Vector3(0, static_cast<double>(velocity), 0));
    return velocity++ < kCount;
  }
  bool sendButtons(DeviceStreams& streams) {
    if (buttons < kCount)
      streams.addButtons(0, buttons * kMillisecond, only(0), buttons % 2 == 0 ? only(0) : Buttons());
    return (buttons += 3) < kCount + 3;
  }
};

void take(DeviceStreams& streams, std::vector<DeviceSample>& samples) {
  while (const auto sample = streams.next())
    samples.push_back(*sample);
}

std::vector<DeviceSample> shuffled(unsigned seed) {
  std::mt19937 random(seed);
  DeviceStreams streams(true, 1);
  Messages messages;
  std::vector<DeviceSample> samples;
  for (int n = 0; n < 5000; ++n) {
    switch (random() % 3) {
      case 0:
        messages.sendPose(streams);
        break;
      case 1:
        messages.sendVelocity(streams);
        break;
      default:
        messages.sendButtons(streams);
    }
    take(streams, samples);
  }
  streams.end();
  take(streams, samples);
  EXPECT_EQ(streams.late(), 0U);
  EXPECT_EQ(streams.dropped(), 0U);
  return samples;
}

TEST(DeviceStreams, TheOrderAmongTopicsChangesNothing) {
  const std::vector<DeviceSample> expected = shuffled(0);
  ASSERT_EQ(expected.size(), std::size_t(Messages::kCount));
  for (std::size_t n = 0; n < expected.size(); ++n) {
    EXPECT_EQ(expected[n].stamp_ns, static_cast<std::int64_t>(n) * kMillisecond);
    EXPECT_EQ(expected[n].pose.position_m.x(), static_cast<double>(n));
    EXPECT_EQ(expected[n].velocity_m_s->y(), static_cast<double>(n));
    EXPECT_EQ(expected[n].buttons.test(0), (n / 3 * 3) % 2 == 0);
  }
  for (unsigned seed = 1; seed < 20; ++seed) {
    const std::vector<DeviceSample> samples = shuffled(seed);
    ASSERT_EQ(samples.size(), expected.size());
    for (std::size_t n = 0; n < samples.size(); ++n) {
      EXPECT_EQ(samples[n].stamp_ns, expected[n].stamp_ns);
      EXPECT_EQ(samples[n].velocity_m_s, expected[n].velocity_m_s);
      EXPECT_EQ(samples[n].buttons, expected[n].buttons);
    }
  }
}

TEST(DeviceStreams, APoseWaitsForEveryTopicUntilThatIsSparse) {
  DeviceStreams streams(false, 1);
  streams.addPose(0, poseAt(0));
  EXPECT_FALSE(streams.next());
  EXPECT_EQ(streams.declareSparse(), 1U);
  EXPECT_FALSE(streams.next());  // not before the window has passed
  streams.addPose(49 * kMillisecond, poseAt(1));
  EXPECT_FALSE(streams.next());
  streams.addButtons(0, -kMillisecond, only(2), only(2));
  streams.addPose(50 * kMillisecond, poseAt(2));
  const auto sample = streams.next();
  ASSERT_TRUE(sample);
  EXPECT_EQ(sample->stamp_ns, 0);
  EXPECT_TRUE(sample->buttons.test(2));
  EXPECT_FALSE(streams.next());
}

TEST(DeviceStreams, OldMessagesAreDroppedAndLateOnesCounted) {
  DeviceStreams streams(false, 1);
  streams.addPose(10, poseAt(0));
  streams.addPose(10, poseAt(1));
  streams.addPose(5, poseAt(2));
  EXPECT_EQ(streams.dropped(), 2U);
  streams.end();
  EXPECT_TRUE(streams.next());
  streams.addButtons(0, 7, only(1), only(1));
  EXPECT_EQ(streams.late(), 1U);
  streams.addPose(20, poseAt(3));
  EXPECT_TRUE(streams.next()->buttons.test(1));
}

TEST(DeviceStreams, TopicsWithoutPosesAreBoundedAndPosesStillComeThrough) {
  DeviceStreams streams(true, 1);
  std::size_t dropped = 0;
  for (std::int64_t n = 0; n < 1000; ++n) {
    streams.addVelocity(n * kMillisecond, Vector3(static_cast<double>(n), 0, 0));
    streams.addButtons(0, n * kMillisecond, only(0), n % 2 == 0 ? only(0) : Buttons());
    dropped += streams.keepNewestOfOthers(100);
  }
  EXPECT_EQ(dropped, 2U * 900U);
  EXPECT_EQ(streams.dropped(), dropped);
  streams.addPose(899 * kMillisecond, poseAt(0));  // what it would have had is gone
  streams.addPose(998 * kMillisecond, poseAt(1));
  EXPECT_FALSE(streams.next()->velocity_m_s);
  const auto sample = streams.next();
  EXPECT_EQ(sample->velocity_m_s->x(), 998.0);
  EXPECT_TRUE(sample->buttons.test(0));
}

TEST(DeviceStreams, AnOldVelocityIsNone) {
  DeviceStreams streams(true, 0);
  streams.addVelocity(0, Vector3(1, 0, 0));
  streams.addPose(19 * kMillisecond, poseAt(0));
  streams.addPose(20 * kMillisecond, poseAt(1));
  streams.end();
  EXPECT_TRUE(streams.next()->velocity_m_s);
  EXPECT_FALSE(streams.next()->velocity_m_s);
}

}  // namespace
}  // namespace soft_volume::core
