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
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "soft_volume/grid/state_stream.h"
#include "soft_volume/render/slice_renderer.h"
#include "soft_volume/ros/incident_log.h"
#include "soft_volume/scene/scene.h"

namespace soft_volume {

/// Draws the newest state of the grid for every camera of the scene that somebody looks at. Needs topics only: scene,
/// volume, grid/topology, grid/state and <camera>/view. Publishes <camera>/image_raw with <camera>/camera_info,
/// <camera>/image_raw/compressed (JPEG), <camera>/depth (REP-118) and render/stats.
///
/// A frame shows one state as a whole: a state is drawn only with the topology revision that it names. States that come
/// faster than the renderer or the scene's rate are skipped and counted.
///
/// Threads: callbacks only store what came; one thread owns the GL context and draws.
class RendererNode {
 public:
  /// Private parameters: none; what is drawn comes with the scene. Throws Error when there is no GL context.
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
    ros::Subscriber view;
    std::atomic<bool> redraw{true};  ///< the view or the audience changed
    std::uint64_t drawn_state = 0;   ///< number of the state drawn last
    double next_due_s = 0.0;         ///< simulated time from which on the next frame is wanted
    std::uint64_t published = 0;
    std::uint64_t skipped = 0;
  };
  using Channels = std::vector<std::shared_ptr<CameraChannel>>;

  /// Everything that one frame needs, taken in one go so that nothing in it changes while it is drawn.
  struct Snapshot {
    std::uint64_t session = 0;
    std::uint32_t revision = 0;
    std::uint64_t step = 0;
    double simulation_time_s = 0.0;
    std::uint64_t number = 0;
    std_msgs::Header header;
    std::vector<core::Vector3f> positions;
    Channels channels;
  };

  // Callbacks.
  void hearScene(const Scene::ConstPtr& message);
  void hearVolume(const Volume::ConstPtr& message);
  void hearTopology(const GridTopology::ConstPtr& message);
  void hearState(const GridState::ConstPtr& message);
  void hearView(const std::shared_ptr<CameraChannel>& channel, const geometry_msgs::PoseStamped& message);
  std::shared_ptr<CameraChannel> openCamera(const core::CameraSettings& settings);
  bool isEarly(const GridState& state) const;
  void keepEarly(const GridState::ConstPtr& message);
  void applyState(const GridState& message);

  // Drawing thread.
  void run();
  bool takeSnapshot(Snapshot& snapshot);
  bool wantsFrame(CameraChannel& channel, const Snapshot& snapshot) const;
  void drawAll(const Snapshot& snapshot);
  void draw(CameraChannel& channel, const Snapshot& snapshot);
  void publishFrame(CameraChannel& channel, const Snapshot& snapshot, const core::Camera& camera,
                    const core::LegacyFrame& frame, RenderStats& stats);
  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);

  ros::NodeHandle node_;
  image_transport::ImageTransport transport_;
  ros::Publisher stats_publisher_;
  std::vector<ros::Subscriber> subscribers_;
  diagnostic_updater::Updater diagnostics_;
  ros::WallTimer diagnostics_timer_;
  IncidentLog incidents_;

  std::mutex mutex_;  // guards everything down to the next blank line
  std::condition_variable wake_;
  std::uint64_t session_ = 0;
  std::shared_ptr<const core::Scene> scene_;
  std::shared_ptr<const core::Volume> volume_;
  std::shared_ptr<const core::Topology> topology_;
  core::StateDecoder decoder_;
  std::uint64_t topology_step_ = 0;  ///< first step with the topology's revision
  GridState::ConstPtr early_state_;  ///< key frame that came before its topology
  ros::WallTime early_since_;
  std_msgs::Header state_header_;
  double state_time_s_ = 0.0;
  std::uint64_t state_number_ = 0;
  Channels channels_;

  std::shared_ptr<const core::Scene> drawn_scene_;
  std::shared_ptr<const core::Volume> drawn_volume_;
  std::shared_ptr<const core::Topology> drawn_topology_;
  std::unique_ptr<core::SliceRenderer> renderer_;

  std::mutex stats_mutex_;
  RenderStats last_stats_;
  std::atomic<bool> running_{true};
  std::thread thread_;
};

}  // namespace soft_volume
