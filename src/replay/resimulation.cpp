#include "soft_volume/replay/resimulation.h"

#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/TwistStamped.h>
#include <rosbag/bag.h>
#include <sensor_msgs/JointState.h>
#include <sensor_msgs/Joy.h>

#include <algorithm>
#include <filesystem>
#include <map>
#include <memory>
#include <set>
#include <stdexcept>
#include <utility>

#include "bag_file.h"
#include "device_recording.h"
#include "lockstep_run.h"
#include "soft_volume/common/error.h"
#include "soft_volume/messages/topics.h"

namespace soft_volume {
namespace {

/// A bag that appears under its name when it is complete. No other recording is touched.
class BagWriter {
 public:
  /// Throws core::FileError when somebody else is writing this bag.
  explicit BagWriter(const std::string& path) : path_(path), active_(path) {
    attempt([&] {
      bag_->open(active_.path(), rosbag::bagmode::Write);
      bag_->setCompression(rosbag::compression::LZ4);
    });
  }
  ~BagWriter() {
    if (done_ || !bag_)
      return;
    try {
      attempt([&] { bag_->close(); });
    } catch (const ReplayError&) {
      return;
    }
    discard();
  }
  BagWriter(const BagWriter&) = delete;
  BagWriter& operator=(const BagWriter&) = delete;

  void write(const std::string& topic, const ros::Time& stamp, const boost::shared_ptr<const AnyMessage>& message,
             bool latched) {
    attempt([&] { bag_->write(topic, std::max(stamp, ros::TIME_MIN), *message, headerOf(topic, *message, latched)); });
  }
  void finish() {
    attempt([&] {
      bag_->close();
      std::filesystem::rename(active_.path(), path_);
    });
    done_ = true;
  }

 private:
  template <typename Action>
  void attempt(const Action& action) {
    try {
      action();
    } catch (const std::runtime_error& error) {
      // A bag that could not be written would try again in its destructor, and throw from there.
      static_cast<void>(bag_.release());
      discard();
      throw ReplayError(path_ + ": the bag cannot be written: " + error.what());
    }
  }

  void discard() const {
    std::error_code ignored;
    std::filesystem::remove(active_.path(), ignored);
  }

  const boost::shared_ptr<ros::M_string>& headerOf(const std::string& topic, const AnyMessage& message, bool latched) {
    boost::shared_ptr<ros::M_string>& header = headers_[topic];
    if (!header) {
      header = boost::make_shared<ros::M_string>();
      (*header)["topic"] = topic;
      (*header)["type"] = message.getDataType();
      (*header)["md5sum"] = message.getMD5Sum();
      (*header)["message_definition"] = message.getMessageDefinition();
      (*header)["latching"] = latched ? "1" : "0";
      (*header)["callerid"] = "/soft_volume_replay";
    }
    return header;
  }

  std::string path_;
  ActiveFile active_;
  std::unique_ptr<rosbag::Bag> bag_ = std::make_unique<rosbag::Bag>();
  std::map<std::string, boost::shared_ptr<ros::M_string>> headers_;
  bool done_ = false;
};

std::int64_t nanoseconds(const ros::Time& time) {
  return static_cast<std::int64_t>(time.toNSec());
}

std::string inSeconds(double seconds) {
  char text[32];
  std::snprintf(text, sizeof(text), "%.3g s", seconds);
  return text;
}

/// What a resimulation needs of a recorded run.
class Planner {
 public:
  Planner(const RecordedBag& bag, const ResimulationOptions& options, Resimulation& result)
      : run_(bag.longest()), options_(options), result_(result), recorded_scene_(run_.sceneMessage()) {
    if (bag.size() > 1)
      note("of the bag's " + std::to_string(bag.size()) + " sessions the longest is computed again");
  }

  LockstepPlan plan() {
    LockstepPlan plan;
    plan.scene = scene();
    plan.volume = run_.volume();
    plan.session = run_.session() + 1;
    plan.threads = options_.threads;
    plan.frame_id = recorded_scene_.header.frame_id;
    plan.device_frame_id = plan.frame_id;
    plan.prefix = prefix();
    if (!options_.device_file.empty())
      plan.profile = core::loadDeviceProfile(options_.device_file);
    plan.rate_hz = plan.profile ? plan.profile->rate_hz : plan.rate_hz;
    addDevice(plan);
    addEntries(plan);
    addStart(plan);
    for (const RecordedState& state : run_.states())
      plan.states_ns.push_back(nanoseconds(run_.stampAt(state.time_s)));
    plan.end_ns = end();
    shorten(plan);
    // Steps as they were: what a change of the time step within the run does to times need not be known.
    plan.entries_by_step = plan.samples.empty() && !changes("simulation.") && !changes("lattice.spacing_m") &&
                           options_.seconds == 0.0 && !started_late_;
    for (const SimulationJournal& journal : run_.journals())
      plan.end_step = std::max(plan.end_step, journal.last_step);
    if (plan.samples.empty() && plan.entries.empty())
      throw ReplayError(
          "the bag holds neither the motion of a device nor inputs: record measured_cp, measured_cv and "
          "joy, or the journal");
    return plan;
  }

  const RecordedRun& run() const { return run_; }
  void note(const std::string& text) { result_.notes.push_back(text); }

 private:
  core::Scene scene() const {
    if (options_.changes.empty())
      return run_.scene();
    return core::parseScene(core::overrideScene(recorded_scene_.yaml, options_.changes),
                            "the bag's scene with the changes", "/");
  }

  /// What comes before a topic's name.
  std::string prefix() const {
    const std::string topic = run_.messages<Scene>().front().topic;
    const std::string name = topics::kScene;
    return topic.size() > name.size() ? topic.substr(0, topic.size() - name.size()) : "/";
  }

  void addDevice(LockstepPlan& plan) {
    DeviceRecording device = readDevice(run_, plan.profile ? &*plan.profile : nullptr, plan.frame_id);
    for (const std::string& text : device.notes)
      note(text);
    plan.samples = std::move(device.samples);
    if (!device.frame_id.empty())
      plan.device_frame_id = device.frame_id;
    if (plan.scene.tools.empty())
      plan.samples.clear();
    if (plan.samples.empty())
      note("the bag holds no motion of a device: the inputs of its journal are given again as they are");
  }

  /// Tools that the device moved: what they did follows from its motion. All that there are where no tool/state says.
  std::set<std::string> toolsInHand(const core::Scene& scene) const {
    std::set<std::string> tools;
    for (const auto& state : run_.messages<ToolState>())
      tools.insert(state.message.tool_id);
    if (tools.empty()) {
      for (const core::ToolConfig& tool : scene.tools)
        tools.insert(tool.id);
    }
    return tools;
  }

  static std::string toolOf(const JournalEntry& entry) {
    if (entry.topic == topics::kToolForce)
      return fromPayload<ToolForce>(entry.payload).tool_id;
    if (entry.topic == topics::kToolCut)
      return fromPayload<ToolCut>(entry.payload).tool_id;
    if (entry.topic == topics::kToolGrip)
      return fromPayload<ToolGrip>(entry.payload).tool_id;
    return "";
  }

  bool changes(const std::string& start) const {
    return std::any_of(options_.changes.begin(), options_.changes.end(),
                       [&](const core::SceneOverride& o) { return o.key.compare(0, start.size(), start) == 0; });
  }

  void addEntries(LockstepPlan& plan) {
    const std::set<std::string> in_hand = plan.samples.empty() ? std::set<std::string>() : toolsInHand(plan.scene);
    const bool keeps_integrator = !changes("simulation.");
    for (RecordedEntry& recorded : run_.entries()) {
      if (recorded.entry.topic == topics::kRestoreCheckpoint || in_hand.count(toolOf(recorded.entry)) > 0)
        continue;
      if (recorded.entry.topic == topics::kSetIntegrator && !keeps_integrator) {
        note("a change of the integrator in the recording is left out, because the method of the simulation is given");
        continue;
      }
      plan.entries.push_back({nanoseconds(run_.stampAt(recorded.time_s)), std::move(recorded.entry)});
    }
    plan.same_grid = !changes("lattice.") && !changes("materials.") && !changes("incision.");
    result_.inputs_given_again = plan.entries.size();
  }

  /// From the beginning, or from a checkpoint of the same scene, or from rest although the recording did not.
  void addStart(LockstepPlan& plan) {
    plan.epoch_ns = nanoseconds(run_.stampAt(0.0));
    const std::vector<SimulationJournal> journals = run_.journals();
    if (journals.empty())
      throw ReplayError("the bag holds no journal; record the topic simulation/journal too");
    const bool restored =
        !journals.front().entries.empty() && journals.front().entries.front().topic == topics::kRestoreCheckpoint;
    if (journals.front().first_step == 0 && !restored)
      return;
    const std::string how =
        restored
            ? "the recorded session continued another one"
            : "the recording began " + inSeconds(run_.timeOfStep(journals.front().first_step)) + " after the session";
    const std::vector<RecordedMessage<SimulationCheckpoint>> checkpoints = run_.messages<SimulationCheckpoint>();
    if (!options_.changes.empty() || checkpoints.empty()) {
      note(how + ": what was done before is missing, and the tissue begins at rest");
      started_late_ = true;
      if (plan.samples.empty())
        plan.epoch_ns = nanoseconds(run_.stampAt(run_.timeOfStep(journals.front().first_step)));
      return;
    }
    plan.start = checkpoints.front().message;
    const std::int64_t from_ns = nanoseconds(plan.start->header.stamp);
    note(how + ": it is computed again from its first checkpoint, with a tool that touches nothing yet");
    const auto before = [&](const auto& item) { return item.stamp_ns < from_ns; };
    plan.samples.erase(std::remove_if(plan.samples.begin(), plan.samples.end(), before), plan.samples.end());
    plan.entries.erase(std::remove_if(plan.entries.begin(), plan.entries.end(), before), plan.entries.end());
  }

  /// To the seconds that are wanted.
  void shorten(LockstepPlan& plan) const {
    if (options_.seconds <= 0.0)
      return;
    const std::int64_t begin_ns = plan.samples.empty() ? plan.epoch_ns : plan.samples.front().stamp_ns;
    plan.end_ns = std::min(plan.end_ns, begin_ns + static_cast<std::int64_t>(1e9 * options_.seconds));
    const auto after = [&](const auto& item) { return item.stamp_ns > plan.end_ns; };
    plan.samples.erase(std::remove_if(plan.samples.begin(), plan.samples.end(), after), plan.samples.end());
    plan.entries.erase(std::remove_if(plan.entries.begin(), plan.entries.end(), after), plan.entries.end());
  }

  std::int64_t end() const {
    std::int64_t end_ns = nanoseconds(run_.stampAt(0.0));
    for (const SimulationJournal& journal : run_.journals())
      end_ns = std::max(end_ns, nanoseconds(journal.header.stamp));
    return end_ns;
  }

  const RecordedRun& run_;
  const ResimulationOptions& options_;
  Resimulation& result_;
  Scene recorded_scene_;
  bool started_late_ = false;
};

template <typename Message>
void copyMessages(const RecordedRun& run, BagWriter& writer) {
  for (const auto& recorded : run.messages<Message>())
    writer.write(recorded.topic, recorded.receipt, anyMessage(recorded.message), false);
}

/// So that the bag can be computed again in its turn.
void copyDevice(const RecordedRun& run, BagWriter& writer) {
  copyMessages<geometry_msgs::PoseStamped>(run, writer);
  copyMessages<geometry_msgs::TwistStamped>(run, writer);
  copyMessages<sensor_msgs::Joy>(run, writer);
  copyMessages<sensor_msgs::JointState>(run, writer);
}

/// The recorded time step may be beyond what is stable now.
std::unique_ptr<LockstepRun> makeRun(Planner& planner, const LockstepRun::Publish& publish) {
  LockstepPlan plan = planner.plan();
  try {
    return std::make_unique<LockstepRun>(plan, publish);
  } catch (const core::SceneError&) {
    if (plan.scene.simulation.dt_s == 0.0)
      throw;
    plan.scene.simulation.dt_s = 0.0;
    plan.entries_by_step = false;
    auto run = std::make_unique<LockstepRun>(plan, publish);
    planner.note("the recorded time step is not stable with these settings: it was found anew");
    return run;
  }
}

void report(const LockstepRun& run, Resimulation& result) {
  const LockstepCounts& counts = run.counts();
  result.steps = counts.steps;
  result.samples = counts.samples;
  result.inputs_applied = counts.inputs_applied;
  result.inputs_refused = counts.inputs_refused;
  result.simulated_s = counts.simulated_s;
  result.time_step_s = run.session().timeStep();
  result.cells = run.session().lattice().cellCount();
  result.step_ms_median = counts.step_ms_median;
  result.step_ms_max = counts.step_ms_max;
  result.stepping_s = counts.stepping_s;
  result.processor_s = counts.processor_s;
  if (counts.inputs_refused > 0) {
    result.notes.push_back(std::to_string(counts.inputs_refused) +
                           " inputs were refused, first: " + counts.first_refusal);
  }
}

}  // namespace

Resimulation resimulate(const RecordedBag& bag, const ResimulationOptions& options, const ReplayProgress& progress) {
  Resimulation result;
  for (const std::string& written : {options.output, options.output + ".active"}) {
    std::error_code absent;
    if (std::filesystem::equivalent(bag.path(), written, absent))
      throw ReplayError(written + ": this is the bag that is read; give another name to the new one");
  }
  Planner planner(bag, options, result);
  BagWriter writer(options.output);
  const auto publish = [&writer](const std::string& topic, const ros::Time& stamp,
                                 const boost::shared_ptr<const AnyMessage>& message,
                                 bool latched) { writer.write(topic, stamp, message, latched); };
  const auto run = makeRun(planner, publish);
  run->run(progress);
  copyDevice(planner.run(), writer);
  writer.finish();
  report(*run, result);
  return result;
}

}  // namespace soft_volume
