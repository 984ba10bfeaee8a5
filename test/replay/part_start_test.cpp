#include "part_start.h"

#include <gtest/gtest.h>
#include <soft_volume/GridState.h>
#include <soft_volume/GridTopology.h>
#include <soft_volume/Scene.h>
#include <soft_volume/SimulationCheckpoint.h>
#include <soft_volume/SimulationJournal.h>
#include <soft_volume/Volume.h>

namespace soft_volume {
namespace {

constexpr std::uint64_t kSession = 7;

template <typename Message>
void hear(PartStart& start, Message message, std::uint64_t step) {
  message.session = kSession;
  message.step = step;
  QueuedMessage queued;
  queued.topic = ros::message_traits::DataType<Message>::value();
  queued.receipt = ros::Time(100.0 + 0.001 * static_cast<double>(step));
  queued.message = anyMessage(message);
  queued.header = boost::make_shared<ros::M_string>();
  start.hear(queued);
}

void hearState(PartStart& start, std::uint64_t step, bool key_frame) {
  GridState state;
  state.key_frame = static_cast<std::uint8_t>(key_frame);
  state.positions.resize(100);
  hear(start, state, step);
}

void hearJournal(PartStart& start, std::uint64_t first_step, std::uint64_t step) {
  SimulationJournal journal;
  journal.first_step = first_step;
  hear(start, journal, step);
}

/// A run that has settled, up to step 3000.
void hearRun(PartStart& start) {
  hear(start, Scene(), 0);
  hear(start, Volume(), 0);
  hear(start, GridTopology(), 0);
  hearState(start, 0, true);
  hear(start, SimulationCheckpoint(), 3000);
  hearJournal(start, 3000, 3000);
}

TEST(PartStart, IsReadyWithEverythingOfOneRun) {
  PartStart start;
  hearRun(start);
  EXPECT_TRUE(start.ready());
  hearState(start, 3010, false);
  EXPECT_TRUE(start.ready());
}

TEST(PartStart, BeyondItsLimitWaitsForACheckpointAndAKeyFrame) {
  PartStart start(10000);
  hearRun(start);
  std::uint64_t step = 3010;
  for (; start.ready() && step < 4000; step += 10)
    hearState(start, step, false);
  ASSERT_LT(step, 4000U) << "it keeps more than the limit";
  hearState(start, 4000, false);
  hear(start, SimulationCheckpoint(), 4010);
  hearJournal(start, 4010, 4020);
  hearState(start, 4020, false);
  EXPECT_FALSE(start.ready()) << "a change to a state that the part does not hold";
  hearState(start, 4030, true);
  hearState(start, 4040, false);
  EXPECT_TRUE(start.ready());
}

}  // namespace
}  // namespace soft_volume
