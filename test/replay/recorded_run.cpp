#include "replay/recorded_run.h"

#include <rosbag/view.h>
#include <sensor_msgs/Image.h>
#include <soft_volume/RenderStats.h>
#include <soft_volume/SimulationJournal.h>
#include <sys/wait.h>

#include <array>
#include <cstdio>
#include <limits>
#include <memory>

#include "analytic_volumes.h"
#include "soft_volume/common/hash.h"
#include "soft_volume/messages/conversions.h"
#include "soft_volume/messages/journal.h"
#include "soft_volume/messages/topics.h"
#include "soft_volume/render/renderer.h"

namespace soft_volume {
namespace {

constexpr std::uint64_t kStateEvery = 20;
constexpr std::uint64_t kKeyFrameEvery = 100;
constexpr std::uint64_t kJournalEvery = 10;
constexpr std::uint64_t kForceEvery = 10;
constexpr std::uint64_t kNanStep = 150;
constexpr std::uint64_t kCutStep = 200;
constexpr std::uint64_t kGripStep = 250;
constexpr std::uint64_t kGripEnd = 340;
constexpr std::uint64_t kIntegratorStep = 260;
constexpr std::uint64_t kAutomaticStep = 350;

std::shared_ptr<const core::Volume> ball() {
  const core::Vector3 centre = core::Vector3::Constant(0.019);
  return std::make_shared<core::Volume>(core::makeVolume(core::Vector3i::Constant(20), 0.002, [&](const auto& p) {
    return 2000.0 - 100000.0 * (p - centre).norm();  // 1000 at 10 mm, 0 at 20 mm from the centre
  }));
}

core::Scene scene(const RunSettings& settings) {
  core::Scene scene;
  scene.name = "ball";
  scene.volume.file = "ball.mha";
  core::Material tissue;
  tissue.name = "tissue";
  tissue.intensity_min = 0.0;
  tissue.intensity_max = 3000.0;
  tissue.damping_ratio = 0.02;
  scene.materials = {tissue};
  scene.lattice.spacing_m = core::Vector3::Constant(0.008);
  scene.lattice.fixed_regions_m = {core::Box3(core::Vector3(-1, -1, -1), core::Vector3(1, 1, 0.004))};
  scene.rendering.transfer_function.points = {{0.0, core::Vector3f(0.2F, 0.1F, 0.1F), 0.0F},
                                              {2000.0, core::Vector3f(1.0F, 0.8F, 0.7F), 0.4F}};
  scene.rendering.options.slices = 20;
  core::CameraSettings camera;
  camera.name = "camera";
  camera.camera = core::Camera::lookAt({0.1, 0.02, 0.03}, {0.019, 0.019, 0.019}, {0, 0, 1}, 0.6, 48, 40);
  camera.camera.near_m = 0.01;
  camera.camera.far_m = 1.0;
  scene.rendering.cameras = {camera};
  core::ToolConfig probe;
  probe.id = "probe";
  scene.tools = {probe};
  core::WayPoint rest;
  scene.device.way_points = {rest};
  if (settings.change)
    settings.change(scene);
  // As a node gets it: from text.
  return core::parseScene(core::writeScene(scene), "test", ".");
}

/// The nodes' part in a run.
class Run {
 public:
  Run(BagRecorder& recorder, const RunSettings& settings)
      : recorder_(recorder),
        settings_(settings),
        session_(scene(settings), ball(), nullptr, settings.session, 1),
        journal_(session_),
        topologies_(settings.deltas ? 0 : TopologyEncoder::kDeltaFromBytes) {
    renderer_.setVolume(session_.volume());
    renderer_.setTransferFunction(session_.scene().rendering.transfer_function);
  }

  SimulationCheckpoint run() {
    if (settings_.restore)
      journal_.apply(*settings_.restore);
    journaled_step_ = session_.steps();
    publishLatched(topics::kScene, sceneMessage(session_));
    publishLatched(topics::kVolume, toMessage(session_));
    publishTopology();
    publishJournal();
    publishState(true);
    publishCheckpoint();
    const std::uint64_t end = session_.steps() + settings_.steps;
    while (session_.steps() < end) {
      applyInputs();
      session_.step();
      publishStep();
      if (settings_.recorded)
        settings_.recorded(session_.steps());
    }
    publishJournal();
    return checkpoint();
  }

 private:
  template <typename Message>
  void publish(const std::string& topic, Message message, bool latched = false) {
    if (session_.steps() < settings_.first_recorded_step && !latched)
      return;
    message.header.stamp = stamp();
    message.header.frame_id = "volume";
    // Receipt follows the stamp by less than a step; sessions follow each other.
    const ros::Time receipt = stamp() + ros::Duration(1e-6 * double(++published_)) +
                              ros::Duration(100.0 * static_cast<double>(settings_.session));
    recorder_.write("/" + topic, receipt, message, latched);
  }
  template <typename Message>
  void publishLatched(const std::string& topic, const Message& message) {
    publish(topic, message, true);
  }

  ros::Time stamp() const { return ros::Time(1000.0) + ros::Duration(session_.simulationTime()); }

  template <typename Input>
  void give(const std::string& topic, Input input) {
    input.session = session_.id();
    input.revision = session_.lattice().revision;
    input.step = session_.steps();
    input.tool_id = "probe";
    input.sequence = ++sequence_;
    input.header.stamp = stamp();
    input.header.frame_id = "volume";
    input.header.seq = 77;
    publish(topic, input);
    journal_.apply(input);
    if (session_.lattice().revision != published_revision_)
      publishTopology();
  }

  void applyInputs() {
    const std::uint64_t step = session_.steps();
    if (step % kForceEvery == 0)
      give(topics::kToolForce, force());
    if (step == kNanStep) {
      ToolForce bad = force();
      bad.force.x = std::numeric_limits<double>::quiet_NaN();
      give(topics::kToolForce, bad);
    }
    if (step == kCutStep && settings_.cuts)
      give(topics::kToolCut, cut());
    if (settings_.grips)
      applyGripsAndIntegrators(step);
  }

  void applyGripsAndIntegrators(std::uint64_t step) {
    if (step >= kGripStep && step <= kGripEnd && step % kForceEvery == 0)
      give(topics::kToolGrip, grip(step));
    SimulationControl control;
    control.integrator = step == kIntegratorStep ? "runge_kutta_4" : "symplectic_euler";
    control.dt = step == kIntegratorStep ? 0.0007 : 0.0;
    if (step == kIntegratorStep || step == kAutomaticStep)
      journal_.apply(control);
  }

  static ToolGrip grip(std::uint64_t step) {
    ToolGrip grip;
    grip.hold_steps = 15;
    grip.closed = static_cast<std::uint8_t>(step < kGripEnd);
    grip.point = toPoint({0.019, 0.019, 0.035});
    grip.radius = 0.01;
    grip.pose.position = toPoint({0.019, 0.019, 0.035 + 5e-5 * static_cast<double>(step - kGripStep)});
    grip.pose.orientation.w = 1.0;
    return grip;
  }

  ToolForce force() const {
    ToolForce force;
    force.hold_steps = 15;
    force.force.z = -0.05 - 0.0001 * static_cast<double>(session_.steps() % 97);
    force.point = toPoint({0.019, 0.019, 0.035});
    force.footprint_radius = 0.012;
    return force;
  }

  static ToolCut cut() {
    ToolCut cut;
    cut.quads = {toPoint({0.0201, -0.02, 0.06}), toPoint({0.0201, -0.02, 0.015}), toPoint({0.0201, 0.06, 0.015}),
                 toPoint({0.0201, 0.06, 0.06})};
    return cut;
  }

  void publishStep() {
    const std::uint64_t step = session_.steps();
    if (step % kJournalEvery == 0)
      publishJournal();
    if (step % kStateEvery == 0)
      publishState(step % kKeyFrameEvery == 0);
    if (step % 100 == 0) {
      publishCheckpoint();
      publish(topics::kSimulationStats, statsMessage(session_));
    }
    if (step % 100 == 60)
      publishFrame();
  }

  void publishTopology() {
    const GridTopology message = topologies_.encode(session_, false);
    published_revision_ = message.revision;
    publishLatched(topics::kTopology, message);
    renderer_.setTopology(session_.topology());
  }

  void publishState(bool key_frame) {
    core::GridStateFrame frame;
    frame.session = session_.id();
    frame.revision = session_.lattice().revision;
    frame.step = session_.steps();
    frame.simulation_time_s = session_.simulationTime();
    frame.state_hash = session_.simulation().stateHash();
    encoder_.encode(session_.drawnPositions(), key_frame, frame);
    publish(topics::kState, toMessage(frame));
  }

  void publishJournal() {
    SimulationJournal message;
    message.session = session_.id();
    message.revision = session_.lattice().revision;
    message.step = message.last_step = session_.steps();
    message.first_step = journaled_step_;
    message.entries = journal_.take();
    message.state_hash = session_.simulation().stateHash();
    publish(topics::kJournal, message);
    journaled_step_ = message.last_step;
  }

  SimulationCheckpoint checkpoint() const { return toMessage(session_, session_.checkpoint()); }
  void publishCheckpoint() { publish(topics::kCheckpoint, checkpoint()); }

  void publishFrame() {
    const core::RenderSettings& settings = session_.scene().rendering;
    std::vector<core::Vector3f> positions;
    for (const core::Vector3& p : session_.drawnPositions())
      positions.push_back(p.cast<float>());
    const core::Camera& camera = settings.cameras[0].camera;
    const core::Image image = renderer_.render(camera, positions, settings.options).toRgb8(settings.background);

    sensor_msgs::Image message;
    message.encoding = "rgb8";
    message.width = static_cast<std::uint32_t>(image.width);
    message.height = static_cast<std::uint32_t>(image.height);
    message.step = 3 * message.width;
    message.data = image.rgb;
    publish("camera/image_raw", message);

    RenderStats stats;
    stats.session = session_.id();
    stats.revision = session_.lattice().revision;
    stats.step = session_.steps();
    stats.camera = "camera";
    stats.pose = toPose(camera.T_volume_camera);
    stats.coarseness = 1;
    stats.image_hash = core::hashVector(image.rgb);
    stats.renderer = renderer_.driver();
    publish(topics::kRenderStats, stats);
  }

  BagRecorder& recorder_;
  RunSettings settings_;
  core::Session session_;
  Journal journal_;
  TopologyEncoder topologies_;
  core::StateEncoder encoder_;
  core::Renderer renderer_{core::Backend::kNative};
  std::uint64_t sequence_ = 0;
  std::uint64_t published_ = 0;
  std::uint64_t journaled_step_ = 0;
  std::uint32_t published_revision_ = 0;
};

}  // namespace

SimulationCheckpoint recordRun(BagRecorder& recorder, const RunSettings& settings) {
  return Run(recorder, settings).run();
}

void recordBag(const std::string& file, const RunSettings& settings, bool compress) {
  BagRecorderSettings recording;
  recording.file = file;
  recording.compress = compress;
  recording.reserve_bytes = 1 << 20;
  BagRecorder recorder(recording);
  recordRun(recorder, settings);
}

void rewriteBag(const std::string& from, const std::string& to, const std::function<bool(RawMessage&)>& edit,
                bool compress) {
  rosbag::Bag in(from);
  rosbag::Bag out(to, rosbag::bagmode::Write);
  if (compress)
    out.setCompression(rosbag::compression::LZ4);
  out.setChunkThreshold(20000);
  rosbag::View view(in);
  for (const rosbag::MessageInstance& instance : view) {
    RawMessage raw{instance.getTopic(),
                   instance.getTime(),
                   instance.getConnectionHeader(),
                   instance.getDataType(),
                   instance.getMD5Sum(),
                   instance.getMessageDefinition(),
                   {}};
    raw.bytes.resize(instance.size());
    ros::serialization::OStream stream(raw.bytes.data(), instance.size());
    instance.write(stream);
    if (!edit(raw))
      continue;
    const auto header = boost::make_shared<ros::M_string>(*raw.header);
    (*header)["md5sum"] = raw.md5sum;
    (*header)["type"] = raw.type;
    AnyMessage message;
    message.morph(raw.md5sum, raw.type, raw.definition, "");
    ros::serialization::IStream bytes(raw.bytes.data(), static_cast<std::uint32_t>(raw.bytes.size()));
    message.read(bytes);
    out.write(raw.topic, raw.time, message, header);
  }
}

ProgramResult replay(const std::string& bag, const std::string& arguments) {
  const std::string command = "timeout 120 '" SOFT_VOLUME_BIN_DIR "/soft_volume_replay' '" + bag + "' " + arguments +
                              (arguments.find("--threads") == std::string::npos ? " --threads 1 2>&1" : " 2>&1");
  return runShell(command);
}

ProgramResult runShell(const std::string& command) {
  ProgramResult result;
  FILE* pipe = popen(command.c_str(), "r");
  std::array<char, 4096> buffer;
  for (std::size_t n; (n = fread(buffer.data(), 1, buffer.size(), pipe)) > 0;)
    result.output.append(buffer.data(), n);
  const int status = pclose(pipe);
  result.code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  return result;
}

}  // namespace soft_volume
