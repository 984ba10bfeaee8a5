#include "soft_volume/messages/journal.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>

#include "message_session.h"
#include "soft_volume/messages/topics.h"

namespace soft_volume {
namespace {

TEST(Journal, AnAppliedInputIsKeptByValue) {
  const auto session = makeSession();
  Journal journal(*session);
  for (int n = 0; n < 3; ++n)
    session->step();
  const ToolForce message = pushMessage(8);
  const JournalEntry entry = journal.apply(message);
  EXPECT_EQ(entry.outcome, JournalEntry::APPLIED);
  EXPECT_EQ(entry.reason, "");
  EXPECT_EQ(entry.step, 3U);
  EXPECT_EQ(entry.order, 0U);
  EXPECT_EQ(entry.topic, "tool/force");
  EXPECT_EQ(entry.type, "soft_volume/ToolForce");
  EXPECT_EQ(entry.sequence, 8U);
  EXPECT_EQ(entry.hash, core::hashVector(entry.payload));
  EXPECT_EQ(fromPayload<ToolForce>(entry.payload), message);
  EXPECT_EQ(session->simulation().state().forces.size(), 1U);
}

TEST(Journal, ARefusedInputIsKeptWithItsReasonAndChangesNothing) {
  const auto session = makeSession();
  Journal journal(*session);
  const std::uint64_t before = session->simulation().stateHash();
  ToolForce force = pushMessage(1);
  force.force.x = std::numeric_limits<double>::quiet_NaN();
  ToolCut cut = cutMessage(1);
  cut.quads.pop_back();
  ToolGrip grip;
  grip.tool_id = "probe";
  for (const JournalEntry& entry : {journal.apply(force), journal.apply(cut), journal.apply(grip)}) {
    EXPECT_EQ(entry.outcome, JournalEntry::REFUSED) << entry.topic;
    EXPECT_NE(entry.reason, "") << entry.topic;
    EXPECT_FALSE(entry.payload.empty()) << entry.topic;
  }
  EXPECT_EQ(journal.applied(), 0U);
  EXPECT_EQ(journal.refused(), 3U);
  session->step();
  EXPECT_EQ(session->simulation().stateHash(), before);
}

TEST(Journal, EntriesAreInOrderWithoutGapsAndTakenOnce) {
  const auto session = makeSession();
  Journal journal(*session);
  journal.apply(pushMessage(1));
  journal.apply(pushMessage(1));  // refused: not newer
  session->step();
  journal.note("simulation/pause", "std_srvs/SetBool", {1});
  const std::vector<JournalEntry> first = journal.take();
  ASSERT_EQ(first.size(), 3U);
  EXPECT_EQ(first[0].outcome, JournalEntry::APPLIED);
  EXPECT_EQ(first[1].outcome, JournalEntry::REFUSED);
  EXPECT_EQ(first[2].outcome, JournalEntry::NOTED);
  EXPECT_EQ(first[2].step, 1U);
  EXPECT_TRUE(journal.take().empty());
  journal.apply(cutMessage(1));
  const std::vector<JournalEntry> second = journal.take();
  ASSERT_EQ(second.size(), 1U);
  for (std::uint64_t n = 0; n < 3; ++n)
    EXPECT_EQ(first[n].order, n);
  EXPECT_EQ(second[0].order, 3U);
  EXPECT_EQ(journal.applied(), 2U);
  EXPECT_EQ(journal.refused(), 1U);
}

TEST(Journal, TheTransportsNumberingIsNotPartOfAnInput) {
  ToolForce message = pushMessage(1);
  const std::vector<std::uint8_t> payload = journalPayload(message);
  message.header.seq = 12345;
  EXPECT_EQ(journalPayload(message), payload);
  EXPECT_EQ(message.header.seq, 12345U);
  message.header.stamp.nsec = 1;
  EXPECT_NE(journalPayload(message), payload);
}

TEST(Journal, EveryBitOfAnInputIsInItsHash) {
  const std::vector<std::uint8_t> payload = journalPayload(pushMessage(1));
  for (std::size_t byte = 4; byte < payload.size(); ++byte) {  // the first four are header.seq
    std::vector<std::uint8_t> changed = payload;
    changed[byte] ^= 1;
    EXPECT_NE(core::hashVector(changed), core::hashVector(payload)) << byte;
  }
}

TEST(Journal, PayloadsOfAnotherLengthAreRefused) {
  std::vector<std::uint8_t> payload = journalPayload(pushMessage(1));
  payload.push_back(0);
  EXPECT_THROW(fromPayload<ToolForce>(payload), core::InputError);
  payload.resize(payload.size() - 2);
  EXPECT_THROW(fromPayload<ToolForce>(payload), core::InputError);
  EXPECT_THROW(fromPayload<ToolForce>({}), core::InputError);
}

SimulationControl control(const std::string& integrator, double dt_s) {
  SimulationControl message;
  message.integrator = integrator;
  message.dt = dt_s;
  return message;
}

/// The recorded entries of a session with everything in it, and the state at its end.
struct Recorded {
  std::vector<JournalEntry> entries;
  std::uint64_t state_hash = 0;
};

Recorded record() {
  const auto session = makeSession();
  Journal journal(*session);
  Recorded recorded;
  for (std::uint64_t step = 0; step < 60; ++step) {
    if (step % 10 == 0)
      journal.apply(pushMessage(step + 1));
    if (step == 15)
      journal.apply(pushMessage(1));
    if (step == 20)
      journal.note(topics::kPause, "std_srvs/SetBool", {1});
    if (step == 30)
      journal.apply(cutMessage(1));
    if (step == 35)
      journal.apply(ToolGrip());
    if (step == 36) {
      ToolGrip grip = gripMessage(1);
      grip.revision = 2;
      journal.apply(grip);
    }
    if (step == 40 || step == 50)
      journal.apply(control(step == 40 ? "backward_euler" : "symplectic_euler", step == 40 ? 0.005 : 0.0));
    if (step == 45)
      journal.apply(control("magic", 0.0));
    session->step();
  }
  recorded.entries = journal.take();
  recorded.state_hash = session->simulation().stateHash();
  return recorded;
}

TEST(Journal, ReappliedItGivesTheSameStateAndTheSameEntries) {
  const Recorded recorded = record();
  EXPECT_EQ(std::count_if(recorded.entries.begin(), recorded.entries.end(),
                          [](const JournalEntry& e) { return e.outcome == JournalEntry::REFUSED; }),
            3);
  const auto session = makeSession();
  Journal journal(*session);
  std::size_t next = 0;
  for (std::uint64_t step = 0; step < 60; ++step) {
    while (next < recorded.entries.size() && recorded.entries[next].step == step) {
      const JournalEntry entry = journal.reapply(recorded.entries[next]);
      EXPECT_EQ(entry, recorded.entries[next]) << "entry " << next;
      ++next;
    }
    session->step();
  }
  EXPECT_EQ(next, recorded.entries.size());
  EXPECT_EQ(session->simulation().stateHash(), recorded.state_hash);
}

TEST(Journal, ARestoredCheckpointIsAnInputLikeAnyOther) {
  const auto used = makeUsedSession();
  const auto live = makeSession();
  Journal live_journal(*live);
  const JournalEntry entry = live_journal.apply(toMessage(*used, used->checkpoint()));
  EXPECT_EQ(entry.outcome, JournalEntry::APPLIED) << entry.reason;
  EXPECT_EQ(entry.topic, "simulation/restore_checkpoint");
  EXPECT_EQ(entry.step, 15U);
  const auto replayed = makeSession();
  Journal replay_journal(*replayed);
  EXPECT_EQ(replay_journal.reapply(entry), entry);
  EXPECT_EQ(replayed->simulation().stateHash(), used->simulation().stateHash());
}

TEST(Journal, AChangeOfTheIntegratorIsAnInputLikeAnyOther) {
  const auto session = makeSession();
  Journal journal(*session);
  const JournalEntry entry = journal.apply(control("quasi_static", 0.02));
  EXPECT_EQ(entry.outcome, JournalEntry::APPLIED) << entry.reason;
  EXPECT_EQ(entry.topic, "simulation/set_integrator");
  EXPECT_EQ(entry.type, "soft_volume/SimulationControl");
  EXPECT_EQ(session->simulation().settings().integrator, core::Integrator::kQuasiStatic);
  EXPECT_EQ(session->timeStep(), 0.02);
  const JournalEntry refused = journal.apply(control("magic", 0.02));
  EXPECT_EQ(refused.outcome, JournalEntry::REFUSED);
  EXPECT_NE(refused.reason.find("no integrator 'magic'"), std::string::npos) << refused.reason;
  EXPECT_EQ(session->simulation().settings().integrator, core::Integrator::kQuasiStatic);
}

TEST(Journal, TakingAPartAwayIsAnInputLikeAnyOther) {
  ToolCut through = cutMessage(1);
  through.quads.clear();
  const std::array<core::Vector3, 4> level = {core::Vector3(-0.01, -0.01, 0.0255), core::Vector3(-0.01, 0.06, 0.0255),
                                              core::Vector3(0.06, 0.06, 0.0255), core::Vector3(0.06, -0.01, 0.0255)};
  for (const core::Vector3& p : level)
    through.quads.push_back(toPoint(p));
  const auto live = makeSession();
  Journal journal(*live);
  ASSERT_EQ(journal.apply(through).outcome, JournalEntry::APPLIED);
  ASSERT_EQ(statsMessage(*live).parts, 2U);
  PartRemoval removal;
  removal.session = live->id();
  removal.cell = statsMessage(*live).part_cells[1];
  EXPECT_EQ(journal.apply(removal).outcome, JournalEntry::APPLIED);
  EXPECT_EQ(statsMessage(*live).parts, 1U);
  const JournalEntry refused = journal.apply(removal);
  EXPECT_EQ(refused.outcome, JournalEntry::REFUSED);
  EXPECT_NE(refused.reason.find("removed before"), std::string::npos) << refused.reason;
  const auto replayed = makeSession();
  Journal replay(*replayed);
  for (const JournalEntry& entry : journal.take())
    EXPECT_EQ(replay.reapply(entry), entry);
  EXPECT_EQ(topologyMessage(*replayed), topologyMessage(*live));
}

TEST(Journal, UnknownTopicsAndDamagedPayloadsCannotBeReapplied) {
  const auto session = makeSession();
  Journal journal(*session);
  JournalEntry entry = journal.apply(pushMessage(1));
  entry.topic = "tool/laser";
  EXPECT_THROW(journal.reapply(entry), core::InputError);
  entry.topic = topics::kToolForce;
  entry.payload.resize(10);
  EXPECT_THROW(journal.reapply(entry), core::InputError);
}

}  // namespace
}  // namespace soft_volume
