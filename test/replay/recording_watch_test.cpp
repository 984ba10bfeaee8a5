#include "soft_volume/replay/recording_watch.h"

#include <gtest/gtest.h>
#include <soft_volume/SimulationCheckpoint.h>
#include <soft_volume/SimulationJournal.h>
#include <soft_volume/ToolForce.h>
#include <std_msgs/String.h>

#include "soft_volume/messages/journal.h"
#include "soft_volume/messages/topics.h"

namespace soft_volume {
namespace {

using Event = RecorderEvent;

boost::shared_ptr<ros::M_string> connectionOf(const std::string& node) {
  const auto header = boost::make_shared<ros::M_string>();
  (*header)["callerid"] = node;
  return header;
}

/// A watch and the clock that it is given.
class RecordingWatchTest : public testing::Test {
 protected:
  /// Sends `count` forces, one every 10 ms, numbered from `first` on.
  void sendForces(std::uint32_t first, std::uint32_t count) {
    for (std::uint32_t n = 0; n < count; ++n) {
      ToolForce force;
      force.header.seq = first + n;
      watch_.hear("/tool/force", *anyMessage(force), tool_, now_);
      now_ += ros::WallDuration(0.01);
    }
  }

  void sendJournal(std::uint64_t session, std::uint64_t first_step, std::uint64_t step,
                   const std::vector<JournalEntry>& entries = {}) {
    SimulationJournal journal;
    journal.session = session;
    journal.first_step = first_step;
    journal.step = journal.last_step = step;
    journal.entries = entries;
    watch_.hear("/simulation/journal", *anyMessage(journal), simulation_, now_);
  }

  std::vector<Event> look() {
    watch_.look(now_);
    return watch_.take();
  }

  /// The only event there is.
  Event onlyEvent() {
    const std::vector<Event> events = look();
    EXPECT_EQ(events.size(), 1U);
    return events.empty() ? Event() : events.front();
  }

  RecordingWatch watch_;
  boost::shared_ptr<ros::M_string> tool_ = connectionOf("/tool");
  boost::shared_ptr<ros::M_string> simulation_ = connectionOf("/simulation");
  ros::WallTime now_{1000.0};
};

TEST_F(RecordingWatchTest, ARunWithoutTroubleHasNoEvents) {
  sendForces(5, 200);
  EXPECT_TRUE(look().empty());
  EXPECT_EQ(watch_.lost(), 0U);
}

TEST_F(RecordingWatchTest, CountsMessagesThatNeverCame) {
  sendForces(5, 10);
  sendForces(18, 10);
  sendForces(30, 1);
  const Event event = onlyEvent();
  EXPECT_EQ(event.kind, Event::LOST);
  EXPECT_EQ(event.messages, 5U);
  EXPECT_EQ(event.node, "/tool");
  EXPECT_EQ(event.topics, std::vector<std::string>{"/tool/force"});
  EXPECT_EQ(watch_.lost(), 5U);
  EXPECT_TRUE(look().empty()) << "it was told twice";
}

TEST_F(RecordingWatchTest, NumbersThatGoBackAreNoLoss) {
  sendForces(50, 1);
  sendForces(3, 5);
  EXPECT_EQ(watch_.lost(), 0U);
}

TEST_F(RecordingWatchTest, NumbersThatStandStillAreNoLoss) {
  for (int n = 0; n < 50; ++n)
    sendForces(0, 1);
  EXPECT_TRUE(look().empty());
}

TEST_F(RecordingWatchTest, MessagesWithoutHeaderAreNotCounted) {
  for (int n = 0; n < 50; ++n) {
    std_msgs::String text;
    text.data = std::string(n % 7 * 10, 'x');  // its length is where a number would be
    watch_.hear("/text", *anyMessage(text), tool_, now_);
    now_ += ros::WallDuration(0.01);
  }
  EXPECT_TRUE(look().empty());
}

TEST_F(RecordingWatchTest, TellsOfSilenceAndReturn) {
  sendForces(1, 100);
  now_ += ros::WallDuration(0.9);
  EXPECT_TRUE(look().empty());
  now_ += ros::WallDuration(0.3);
  EXPECT_EQ(onlyEvent().kind, Event::SILENCE);
  now_ += ros::WallDuration(10.0);
  EXPECT_TRUE(look().empty()) << "it was told twice";
  sendForces(101, 1);
  const Event event = onlyEvent();
  EXPECT_EQ(event.kind, Event::RETURN);
  EXPECT_NEAR(event.duration, 11.2, 0.05);
}

TEST_F(RecordingWatchTest, ATopicThatComesNowAndThenIsNeverSilent) {
  for (int n = 0; n < 30; ++n) {
    sendForces(1 + n, 1);
    now_ += ros::WallDuration(3.0);
    EXPECT_TRUE(look().empty());
  }
}

TEST_F(RecordingWatchTest, ARestartedPublisherCountsAnew) {
  sendForces(500, 10);
  tool_ = connectionOf("/tool");
  sendForces(1000, 10);
  const Event event = onlyEvent();
  EXPECT_EQ(event.kind, Event::CONNECTION);
  EXPECT_EQ(watch_.lost(), 0U);
}

TEST_F(RecordingWatchTest, TellsWhereASessionBegan) {
  sendJournal(7, 0, 20);
  EXPECT_NE(onlyEvent().text.find("session 7 began from rest"), std::string::npos);
  SimulationCheckpoint checkpoint;
  checkpoint.session = 7;
  checkpoint.step = 20;
  JournalEntry entry;
  entry.topic = topics::kRestoreCheckpoint;
  entry.outcome = JournalEntry::APPLIED;
  entry.payload = journalPayload(checkpoint);
  simulation_ = connectionOf("/simulation");
  sendJournal(8, 20, 40, {entry});
  std::string text;
  for (const Event& event : look())
    text += event.text + "\n";
  EXPECT_NE(text.find("session 8 after a restart of the simulation began where session 7 was at step 20"),
            std::string::npos)
      << text;
  EXPECT_EQ(watch_.progress().session, 8U);
  EXPECT_EQ(watch_.progress().step, 40U);
}

TEST_F(RecordingWatchTest, TellsOfARunThatWasUnderWay) {
  sendJournal(7, 300, 320);
  EXPECT_NE(onlyEvent().text.find("was met at step 300"), std::string::npos);
}

TEST_F(RecordingWatchTest, TellsOfGapsInTheJournal) {
  sendJournal(7, 0, 20);
  look();
  sendJournal(7, 60, 80);
  const Event event = onlyEvent();
  EXPECT_EQ(event.kind, Event::LOST);
  EXPECT_NE(event.text.find("steps 20 to 60 never came"), std::string::npos) << event.text;
}

TEST_F(RecordingWatchTest, ToldOfAJournalThatCannotBeRead) {
  AnyMessage any;
  any.morph(ros::message_traits::md5sum<SimulationJournal>(), ros::message_traits::datatype<SimulationJournal>(), "",
            "");
  std::vector<std::uint8_t> bytes = {1, 2, 3};
  ros::serialization::IStream stream(bytes.data(), 3);
  any.read(stream);
  watch_.hear("/simulation/journal", any, simulation_, now_);
  EXPECT_EQ(onlyEvent().kind, Event::LOST);
}

}  // namespace
}  // namespace soft_volume
