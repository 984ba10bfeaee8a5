#pragma once

#include <diagnostic_updater/diagnostic_updater.h>
#include <geometry_msgs/PoseStamped.h>
#include <image_transport/image_transport.h>
#include <ros/node_handle.h>
#include <soft_volume/GridState.h>
#include <soft_volume/GridTopology.h>
#include <soft_volume/RenderStats.h>
#include <soft_volume/Scene.h>
#include <soft_volume/Volume.h>

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "soft_volume/grid/state_stream.h"
#include "soft_volume/grid/topology_delta.h"
#include "soft_volume/render/renderer.h"
#include "soft_volume/ros/incident_log.h"
#include "soft_volume/scene/scene.h"

namespace soft_volume {

class RenderParameters;

/// Draws the newest state of the grid for every camera of the scene that somebody looks at. Needs topics only: scene,
/// volume, grid/topology, grid/state and <camera>/view. Publishes <camera>/image_raw with <camera>/camera_info,
/// <camera>/image_raw/compressed (JPEG), <camera>/depth (REP-118), <camera>/labels (mono16, of scenes with labels) and
/// render/stats.
///
/// A frame shows one state as a whole: a state is drawn only with the topology revision that it names, and the state
/// before an incision until the first one after it has come. States that come
/// faster than the renderer or the scene's rate are skipped and counted. A frame that cannot be drawn is skipped too,
/// with its reason in diagnostics, until something changes. After a change of view a progressive node publishes coarse
/// frames until it comes to the full quality; while the grid moves, each of them shows the newest state.
///
/// Threads: callbacks only store what came; one thread owns the GL contexts and draws.
class RendererNode {
 public:
  /// Private parameters: `threads` of the native and exact back ends (0: all cores), and keys of the scene's
  /// `rendering` but transfer_function and cameras, which they replace; dynamic_reconfigure changes these. Throws
  /// InputError or SceneError when one cannot be used.
  RendererNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node);
  ~RendererNode();
  RendererNode(const RendererNode&) = delete;
  RendererNode& operator=(const RendererNode&) = delete;

 private:
  struct CameraChannel {
    std::string name;
    core::Camera camera;
    image_transport::CameraPublisher image;
    ros::Publisher compressed;
    ros::Publisher depth;
    ros::Publisher labels;
    ros::Subscriber view;
    std::atomic<bool> redraw{true};       ///< the view, the settings or the audience changed
    std::atomic<bool> view_moved{false};  ///< so that frames may be coarse at first
    bool isWatched() const;

    // Of the drawing thread.
    std::unique_ptr<core::Renderer> renderer;  ///< its last frame is what an incremental one starts from
    core::Backend backend{};
    std::shared_ptr<const core::RenderSettings> settings;  ///< the renderer's, as are these
    std::shared_ptr<const core::Volume> volume;
    std::shared_ptr<const core::Volume> labelled;
    std::shared_ptr<const core::Topology> topology;
    std::uint32_t coarseness = 1;   ///< of the last frame; 1 is the full quality
    std::uint64_t drawn_state = 0;  ///< number of the state drawn last
    double next_due_s = 0.0;        ///< simulated time from which on the next frame is wanted
    std::uint64_t published = 0;
    std::uint64_t skipped = 0;
  };
  using Channels = std::vector<std::shared_ptr<CameraChannel>>;

  /// A state together with its topology.
  struct ShownState {
    std::shared_ptr<const core::Topology> topology;
    std::vector<core::Vector3f> positions;
    std::uint64_t step = 0;
    double simulation_time_s = 0.0;
    std_msgs::Header header;
    std::uint64_t number = 0;  ///< grows with every state
  };

  /// Everything that one frame needs, taken in one go so that nothing in it changes while it is drawn.
  struct Snapshot {
    ShownState state;
    std::shared_ptr<const core::RenderSettings> settings;
    std::string settings_text;
    std::shared_ptr<const core::Volume> volume;
    std::shared_ptr<const core::Volume> labels;
    Channels channels;
  };

  // Callbacks.
  void hearScene(const Scene::ConstPtr& message);
  void hearVolume(const Volume::ConstPtr& message);
  void hearTopology(const GridTopology::ConstPtr& message);
  void hearState(const GridState::ConstPtr& message);
  void hearView(const std::shared_ptr<CameraChannel>& channel, const geometry_msgs::PoseStamped& message);
  std::shared_ptr<CameraChannel> openCamera(const core::CameraSettings& settings);
  core::RenderSettings applyParameters(const std::string& yaml);
  void adopt(const core::RenderSettings& settings, const std::string& overrides);
  void fitSettings();
  bool isEarly(const GridState& state) const;
  void keepEarly(const GridState::ConstPtr& message);
  void applyState(const GridState& message);

  // Drawing thread.
  void run();
  bool takeSnapshot(Snapshot& snapshot);
  bool wantsFrame(const CameraChannel& channel, const Snapshot& snapshot) const;
  void drawAll(const Snapshot& snapshot);
  void drawOrReport(CameraChannel& channel, const Snapshot& snapshot);
  void draw(CameraChannel& channel, const Snapshot& snapshot);
  void prepare(CameraChannel& channel, const Snapshot& snapshot);
  core::RenderOptions optionsOf(const CameraChannel& channel, const Snapshot& snapshot) const;
  void publishFrame(CameraChannel& channel, const Snapshot& snapshot, const core::Camera& camera,
                    const core::Frame& frame, RenderStats& stats);
  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);

  ros::NodeHandle node_;
  image_transport::ImageTransport transport_;
  ros::Publisher stats_publisher_;
  std::vector<ros::Subscriber> subscribers_;
  diagnostic_updater::Updater diagnostics_;
  ros::WallTimer diagnostics_timer_;
  IncidentLog incidents_;
  int threads_ = 0;
  std::unique_ptr<RenderParameters> parameters_;

  std::mutex mutex_;  // guards everything down to the next blank line
  std::condition_variable wake_;
  std::uint64_t session_ = 0;
  std::shared_ptr<const core::Scene> scene_;
  core::RenderSettings wanted_;                           ///< the scene's with the parameters in their place
  bool overridden_ = false;                               ///< whether there are any
  std::shared_ptr<const core::RenderSettings> settings_;  ///< the same, fitted to the volume
  std::string settings_text_;                             ///< for RenderStats
  std::shared_ptr<const core::Volume> volume_;
  std::shared_ptr<const core::Volume> labels_;
  core::TopologyDecoder topologies_;
  core::StateDecoder decoder_;
  std::uint64_t topology_step_ = 0;  ///< first step with the topology's revision
  GridState::ConstPtr early_state_;  ///< key frame that came before its topology
  ros::WallTime early_since_;
  ShownState shown_;
  Channels channels_;

  std::mutex stats_mutex_;
  RenderStats last_stats_;
  std::map<std::string, std::string> failures_;  ///< why a camera's newest frame could not be drawn
  std::atomic<bool> running_{true};
  std::thread thread_;
};

}  // namespace soft_volume
