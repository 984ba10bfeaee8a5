#include "soft_volume/messages/resume_file.h"

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <boost/make_shared.hpp>
#include <fstream>
#include <functional>

#include "message_session.h"
#include "replay/test_folder.h"
#include "soft_volume/common/error.h"
#include "soft_volume/messages/journal.h"

namespace soft_volume {
namespace {

/// A run that is kept as the simulation node keeps it.
class KeptSession {
 public:
  explicit KeptSession(ResumeFile& file) : file_(&file), session_(makeSession()), journal_(*session_) {}

  core::Session& session() { return *session_; }
  Journal& journal() { return journal_; }

  void checkpoint(bool paused = false) {
    publishJournal();
    file_->begin(boost::make_shared<SimulationCheckpoint>(toMessage(*session_, session_->checkpoint())), paused);
  }
  void publishJournal() {
    SimulationJournal message;
    message.session = session_->id();
    message.first_step = reached_;
    message.step = message.last_step = reached_ = session_->steps();
    message.header.stamp.fromSec(session_->simulationTime());
    message.entries = journal_.take();
    message.state_hash = session_->simulation().stateHash();
    file_->append(message);
  }
  void step(int steps) {
    for (int n = 0; n < steps; ++n)
      session_->step();
    publishJournal();
  }

 private:
  ResumeFile* file_;
  std::unique_ptr<core::Session> session_;
  Journal journal_;
  std::uint64_t reached_ = 0;
};

/// Pushed, cut, gripped and with another integrator after the checkpoint of step 10; ends in step 45.
void play(KeptSession& run) {
  run.journal().apply(pushMessage(1));
  run.step(10);
  run.checkpoint();
  run.journal().apply(cutMessage(2));
  run.step(10);
  ToolGrip grip = gripMessage(3);
  grip.revision = run.session().lattice().revision;
  run.journal().apply(grip);
  run.journal().apply(pushMessage(1));  // refused
  run.step(10);
  SimulationControl control;
  control.session = kSession;
  control.integrator = "runge_kutta_4";
  control.dt = 0.0005;
  run.journal().apply(control);
  run.step(15);
}

core::SceneVolumes volumes() {
  return {core::smallVolume(), nullptr};
}

ResumedRun resumeFrom(const std::string& path) {
  return resume(*ResumeFile(path).read(), core::smallScene(), volumes(), 1);
}

std::string content(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

void write(const std::string& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary) << bytes;
}

/// Runs something in a process of its own that then dies as one does that is killed.
void runAndDie(const std::function<void()>& work) {
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    work();
    kill(getpid(), SIGKILL);
  }
  int status = 0;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  ASSERT_TRUE(WIFSIGNALED(status));
}

TEST(ResumeFile, WhatWasNotKeptIsNotThere) {
  const TestFolder folder;
  EXPECT_FALSE(ResumeFile(folder / "run").read().has_value());
}

TEST(ResumeFile, AKilledRunGoesOnBitForBit) {
  const TestFolder folder;
  const std::string path = folder / "run";
  runAndDie([&] {
    // As a killed process leaves them: nothing is destroyed.
    auto* file = new ResumeFile(path);
    auto* run = new KeptSession(*file);
    play(*run);
    while (!std::filesystem::exists(path))
      usleep(1000);
  });
  const TestFolder other;
  ResumeFile uninterrupted(other / "run");
  KeptSession run(uninterrupted);
  play(run);

  const ResumedRun resumed = resumeFrom(path);
  EXPECT_EQ(resumed.checkpoint.step, 45U);
  EXPECT_EQ(resumed.checkpoint.state_hash, run.session().simulation().stateHash());
  EXPECT_DOUBLE_EQ(resumed.simulation_time_s, run.session().simulationTime());
  EXPECT_EQ(resumed.checkpoint.header.stamp, ros::Time(run.session().simulationTime()));
  EXPECT_FALSE(resumed.paused);
  const auto session = makeSession(kSession + 1);
  ASSERT_TRUE(session->apply(fromMessage(resumed.checkpoint)).applied);
  for (int n = 0; n < 200; ++n) {
    session->step();
    run.session().step();
  }
  EXPECT_EQ(session->simulation().stateHash(), run.session().simulation().stateHash());
  EXPECT_GT(run.session().maxDisplacement(), 1e-4);
}

TEST(ResumeFile, TheNewestCheckpointCounts) {
  const TestFolder folder;
  const std::string path = folder / "run";
  {
    ResumeFile file(path);
    KeptSession run(file);
    play(run);
    run.checkpoint(true);
    run.step(5);
  }
  ResumeFile file(path);
  const auto kept = file.read();
  ASSERT_TRUE(kept.has_value());
  EXPECT_EQ(kept->checkpoint.step, 45U);
  EXPECT_TRUE(kept->paused);
  EXPECT_EQ(resume(*kept, core::smallScene(), volumes(), 1).steps_repeated, 5U);
  EXPECT_EQ(file.takeError(), "");
}

TEST(ResumeFile, APauseIsKept) {
  const TestFolder folder;
  const std::string path = folder / "run";
  {
    ResumeFile file(path);
    KeptSession run(file);
    run.checkpoint();
    file.setPaused(true);
  }
  EXPECT_TRUE(resumeFrom(path).paused);
}

TEST(ResumeFile, TheCheckpointOfAResetRunIsNotMixedWithTheOther) {
  const TestFolder folder;
  const std::string path = folder / "run";
  {
    ResumeFile file(path);
    KeptSession run(file);
    play(run);
    SimulationJournal other;
    other.session = kSession + 1;
    file.append(other);
  }
  EXPECT_EQ(resumeFrom(path).checkpoint.step, 45U);
}

/// The state after each journal message of play().
bool isJournaledStep(std::uint64_t step) {
  return step == 10 || step == 20 || step == 30 || step == 45;
}

TEST(ResumeFile, AnEndThatIsCutOffCostsWhatIsCutOff) {
  const TestFolder folder;
  const std::string path = folder / "run";
  std::uintmax_t begin = 0;
  {
    ResumeFile file(path);
    KeptSession run(file);
    run.checkpoint();
  }
  begin = std::filesystem::file_size(path);
  {
    ResumeFile file(path);
    KeptSession run(file);
    play(run);
  }
  const std::string whole = content(path);
  std::uint64_t reached = 0;
  for (std::size_t size = whole.size(); size > begin + 1000; size -= 37) {
    write(path, whole.substr(0, size));
    const auto kept = ResumeFile(path).read();
    ASSERT_TRUE(kept.has_value()) << size;
    EXPECT_EQ(kept->damage, "") << size;
    const std::uint64_t step = kept->journals.empty() ? 10 : kept->journals.back().last_step;
    EXPECT_TRUE(isJournaledStep(step)) << step;
    reached = std::max(reached, step);
    if (size % 5 == 0) {
      EXPECT_EQ(resume(*kept, core::smallScene(), volumes(), 1).checkpoint.step, step);
    }
  }
  EXPECT_EQ(reached, 45U);
}

TEST(ResumeFile, DamageIsFound) {
  const TestFolder folder;
  const std::string path = folder / "run";
  {
    ResumeFile file(path);
    KeptSession run(file);
    play(run);
  }
  const std::string whole = content(path);
  int refused = 0;
  int shortened = 0;
  for (std::size_t place = 0; place < whole.size(); place += 211) {
    std::string damaged = whole;
    damaged[place] = static_cast<char>(damaged[place] ^ 0x10);
    write(path, damaged);
    try {
      const auto kept = ResumeFile(path).read();
      ASSERT_TRUE(kept.has_value());
      EXPECT_NE(kept->damage, "") << place;
      EXPECT_LT(kept->journals.size(), 3U) << place;
      ++shortened;
    } catch (const core::FileError&) {
      ++refused;
    }
  }
  EXPECT_GT(refused, 20);
  EXPECT_GT(shortened, 1);
  write(path, "");
  EXPECT_THROW(ResumeFile(path).read(), core::FileError);
}

TEST(ResumeFile, AnotherSceneOrVolumeIsRefused) {
  const TestFolder folder;
  const std::string path = folder / "run";
  {
    ResumeFile file(path);
    KeptSession run(file);
    play(run);
  }
  const KeptRun kept = *ResumeFile(path).read();
  core::Scene softer = core::smallScene();
  softer.materials[0].youngs_modulus_pa *= 0.99;
  EXPECT_THROW(resume(kept, softer, volumes(), 1), core::InputError);
  const auto larger = std::make_shared<const core::Volume>(
      core::makeVolume({24, 24, 24}, 0.002, [](const core::Vector3& p) { return p.z() < 0.0331 ? 100.0 : 0.0; }));
  EXPECT_THROW(resume(kept, core::smallScene(), {larger, nullptr}, 1), core::InputError);
  KeptRun wrong = kept;
  wrong.journals.back().state_hash ^= 1;
  EXPECT_THROW(resume(wrong, core::smallScene(), volumes(), 1), core::InputError);
}

TEST(ResumeFile, WhatIsRefusedIsSetAside) {
  const TestFolder folder;
  const std::string path = folder / "run";
  write(path, "something else");
  const ResumeFile file(path);
  EXPECT_THROW(file.read(), core::FileError);
  const std::string aside = file.setAside();
  EXPECT_EQ(content(aside), "something else");
  EXPECT_FALSE(file.read().has_value());
}

TEST(ResumeFile, ARunThatEndedLeavesNothing) {
  const TestFolder folder;
  {
    ResumeFile file(folder / "run");
    KeptSession run(file);
    play(run);
    file.remove();
  }
  EXPECT_TRUE(std::filesystem::is_empty(folder / ""));
}

TEST(ResumeFile, TwoProcessesDoNotShareOne) {
  const TestFolder folder;
  const ResumeFile file(folder / "run");
  EXPECT_THROW(ResumeFile(folder / "run"), core::FileError);
  EXPECT_THROW(ResumeFile(folder / "no such folder/run"), core::FileError);
}

TEST(ResumeFile, AFullDiskIsToldAndEndsNothing) {
  const TestFolder folder;
  const std::string path = folder / "run";
  // What every write to a full disk gets.
  std::filesystem::create_symlink("/dev/full", path + ".next");
  ResumeFile file(path);
  KeptSession run(file);
  run.checkpoint();
  for (int n = 0; n < 100; ++n)
    run.step(1);
  std::string error;
  for (int n = 0; n < 500 && error.empty(); ++n) {
    usleep(10000);
    error = file.takeError();
  }
  EXPECT_NE(error.find("No space left"), std::string::npos) << error;
  EXPECT_FALSE(file.read().has_value());
}

}  // namespace
}  // namespace soft_volume
