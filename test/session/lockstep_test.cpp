#include "soft_volume/session/lockstep.h"

#include <gtest/gtest.h>

#include <functional>
#include <random>

#include "small_scene.h"
#include "soft_volume/session/session.h"

namespace soft_volume::core {
namespace {

constexpr std::int64_t kMillisecond = 1000000;
constexpr std::int64_t kStart_ns = 7 * kMillisecond + 300;
constexpr int kSamples = 500;
constexpr std::uint64_t kPatchEvery = 4;

struct WayPoint {
  int sample;
  double y_m;
  double z_m;
};
constexpr WayPoint kWay[] = {{0, 0.024, 0.036},   {150, 0.024, 0.026}, {250, 0.024, 0.040},
                             {300, 0.012, 0.040}, {380, 0.012, 0.022}, {kSamples, 0.036, 0.022}};

/// Presses with the probe, changes to the scalpel in the air, and cuts.
DeviceSample sampleAt(int n) {
  std::size_t after = 1;
  while (kWay[after].sample < n)
    ++after;
  const WayPoint& from = kWay[after - 1];
  const WayPoint& to = kWay[after];
  const double part = static_cast<double>(n - from.sample) / (to.sample - from.sample);
  DeviceSample sample;
  sample.stamp_ns = kStart_ns + n * kMillisecond + (n % 3) * 1000;
  sample.pose.position_m = {0.0235, from.y_m + part * (to.y_m - from.y_m), from.z_m + part * (to.z_m - from.z_m)};
  sample.buttons.set(1, n >= 260 && n < 270);
  sample.buttons.set(0, n >= 300);
  return sample;
}

/// Simulation and hand with a network between them that delivers each topic in order, and nothing else for certain.
class Graph {
 public:
  explicit Graph(unsigned seed)
      : random_(seed),
        session_(smallScene(), smallVolume(), nullptr, 5, 1),
        hand_("hand", session_.scene(), nullptr, 1000.0, session_.id(), session_.volume()) {
    sendTopology();
  }

  void run() {
    const std::function<bool()> actors[] = {[this] { return deliver(notices_); },
                                            [this] { return deliver(forces_); },
                                            [this] { return deliver(cuts_); },
                                            [this] { return deliver(patches_); },
                                            [this] { return deliver(topologies_); },
                                            [this] { return takeSample(); },
                                            [this] { return tick(); },
                                            [this] { return step(); }};
    int idle = 0;
    while (idle < 1000)
      idle = actors[random_() % std::size(actors)]() ? 0 : idle + 1;
  }

  std::vector<std::string> log;  ///< what was applied, and states
  int ticked = 0;
  int refused = 0;
  const Session& session() const { return session_; }

 private:
  using Queue = std::deque<std::function<void()>>;

  static bool deliver(Queue& queue) {
    if (queue.empty())
      return false;
    const auto message = queue.front();
    queue.pop_front();
    message();
    return true;
  }

  bool takeSample() {
    if (hand_.hasSample() || next_ == kSamples)
      return false;
    const ToolNotice notice = hand_.take(sampleAt(next_++));
    notices_.push_back([this, notice] { EXPECT_TRUE(gate_.hear(notice, session_.id())); });
    return true;
  }

  bool tick() {
    if (!hand_.hasSample() || !hand_.ready())
      return false;
    for (const HandTick& tick : hand_.tick())
      send(tick);
    ++ticked;
    return true;
  }

  void send(const HandTick& tick) {
    using Kind = LockstepInputs<std::function<Verdict()>>::Kind;
    const std::string id = hand_.config(tick.tool).id;
    const std::int64_t stamp_ns = tick.stamp_ns;
    if (tick.output.cut) {
      const ToolCutCommand cut = toCommand(id, *tick.output.cut);
      cuts_.push_back([this, cut, stamp_ns] {
        gate_.countCut(cut.header.tool_id, cut.header.sequence);
        inputs_.add(stamp_ns, cut.header.tool_id, Kind::kCut, cut.header.sequence,
                    [this, cut] { return session_.apply(cut); });
      });
    }
    if (tick.output.force) {
      const ToolForceCommand force = toCommand(id, *tick.output.force);
      forces_.push_back([this, force, stamp_ns] {
        gate_.countForce(force.header.tool_id, force.header.sequence);
        inputs_.add(stamp_ns, force.header.tool_id, Kind::kForce, force.header.sequence,
                    [this, force] { return session_.apply(force); });
      });
    }
  }

  bool step() {
    if (!gate_.epoch())
      return false;
    const std::int64_t now_ns = stampOf(session_.steps());
    if (!gate_.complete(now_ns))
      return false;
    for (const auto& input : inputs_.take(now_ns)) {
      const Verdict verdict = input();
      refused += verdict.applied ? 0 : 1;
      log.push_back(std::to_string(session_.steps()) + " " + verdict.reason);
      if (session_.lattice().revision != revision_)
        sendTopology();
    }
    if (session_.steps() % kPatchEvery == 0)
      sendPatches(now_ns);
    session_.step();
    log.push_back(std::to_string(session_.simulation().stateHash()));
    return true;
  }

  std::int64_t stampOf(std::uint64_t step) const {
    return lockstepStamp(*gate_.epoch(), session_.simulationTimeAt(step));
  }

  void sendTopology() {
    revision_ = session_.lattice().revision;
    const auto topology = std::make_shared<Topology>(session_.topology());
    topologies_.push_back([this, topology] { hand_.addTopology(topology); });
  }

  void sendPatches(std::int64_t now_ns) {
    for (const ToolNotice& notice : gate_.noticesAt(now_ns)) {
      const GridPatch patch = session_.patch(notice.tool_id, notice.point_m, notice.patch_radius_m);
      const std::int64_t next_ns = stampOf(session_.steps() + kPatchEvery);
      patches_.push_back([this, patch, now_ns, next_ns] { hand_.addPatch(patch, now_ns, next_ns); });
    }
  }

  std::mt19937 random_;
  Session session_;
  LockstepHand hand_;
  LockstepGate gate_;
  LockstepInputs<std::function<Verdict()>> inputs_;
  std::uint32_t revision_ = 0;
  int next_ = 0;
  Queue notices_, forces_, cuts_, patches_, topologies_;
};

TEST(Lockstep, LateMessagesChangeNothingAndNothingStandsStill) {
  Graph first(0);
  first.run();
  EXPECT_EQ(first.ticked, kSamples);
  EXPECT_EQ(first.refused, 0);
  EXPECT_GT(first.session().lattice().revision, 1U);  // it has cut
  // All steps that begin before the last sample.
  EXPECT_EQ(first.session().steps(), std::uint64_t(kSamples));
  for (unsigned seed = 1; seed < 6; ++seed) {
    Graph other(seed);
    other.run();
    EXPECT_EQ(other.ticked, kSamples) << seed;
    EXPECT_EQ(other.log, first.log) << seed;
  }
}

ToolNotice noticeOf(const std::string& hand, std::int64_t until_ns, std::uint64_t force = 0) {
  ToolNotice notice;
  notice.hand = hand;
  notice.session = 5;
  notice.until_ns = until_ns;
  notice.tool_id = "probe";
  if (force > 0)
    notice.sent["probe"].force = force;
  return notice;
}

TEST(LockstepGate, WaitsForInputsThatWereToldOf) {
  LockstepGate gate;
  EXPECT_FALSE(gate.epoch());
  EXPECT_TRUE(gate.hear(noticeOf("a", 100), 5));
  EXPECT_EQ(gate.epoch(), 100);
  EXPECT_FALSE(gate.complete(100));
  EXPECT_EQ(gate.waitsFor(100), "a");
  EXPECT_TRUE(gate.hear(noticeOf("a", 200, 41), 5));
  EXPECT_FALSE(gate.complete(100));
  gate.countForce("probe", 40);
  EXPECT_FALSE(gate.complete(100));
  gate.countForce("probe", 41);
  EXPECT_TRUE(gate.complete(100));
  EXPECT_TRUE(gate.complete(199));
  EXPECT_FALSE(gate.complete(200));
}

TEST(LockstepGate, BeginsWithTheFirstSampleOfAllHands) {
  LockstepGate gate(2);
  EXPECT_TRUE(gate.hear(noticeOf("b", 300), 5));
  EXPECT_FALSE(gate.epoch());
  EXPECT_TRUE(gate.hear(noticeOf("a", 200), 5));
  EXPECT_EQ(gate.epoch(), 200);
  EXPECT_FALSE(gate.hear(noticeOf("c", 400), 5));  // it is late
  EXPECT_FALSE(gate.hear(noticeOf("a", 200), 5));  // nothing new
  EXPECT_FALSE(gate.hear(noticeOf("a", 500), 6));  // another session
}

}  // namespace
}  // namespace soft_volume::core
