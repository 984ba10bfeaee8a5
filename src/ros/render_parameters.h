#pragma once

#include <ros/node_handle.h>
#include <soft_volume/RendererConfig.h>

#include <boost/thread/recursive_mutex.hpp>
#include <functional>
#include <map>
#include <memory>
#include <string>

#include "soft_volume/ros/incident_log.h"
#include "soft_volume/scene/scene.h"

namespace dynamic_reconfigure {
template <class Config>
class Server;
}

namespace soft_volume {

/// What replaces keys of the scene's `rendering`: private parameters of the same names at the start, and
/// dynamic_reconfigure while the node runs. A change that is refused leaves everything as it was. The node writes no
/// parameters: after a restart those of the launch file count again.
class RenderParameters {
 public:
  /// Puts the keys of `yaml` in place of the scene's, and returns what is in force then. Throws SceneError when they
  /// cannot be used; then nothing changes.
  using Apply = std::function<core::RenderSettings(const std::string& yaml)>;

  /// Reads the parameters. Throws InputError or SceneError when one cannot be used.
  RenderParameters(const ros::NodeHandle& private_node, IncidentLog& incidents, Apply apply);
  ~RenderParameters();

  /// The keys that are replaced, as a YAML mapping. Not for `apply`, which is given them.
  std::string yaml() const;
  /// Shows what is in force to those that watch, for example after another scene.
  void show(const core::RenderSettings& settings);

 private:
  /// Without the library's habits of clamping to the nearest value that is in range, and of writing every value to the
  /// parameter server, where it would look as if the user had set it.
  struct Config : RendererConfig {
    Config() = default;
    Config(const RendererConfig& config) : RendererConfig(config) {}
    void __clamp__() {}
    void __toServer__(const ros::NodeHandle&) const {}
    void __fromServer__(const ros::NodeHandle&) {}
  };
  using Overrides = std::map<std::string, std::string>;  ///< the value's text by key

  static Config shownOf(const core::RenderSettings& settings, const Overrides& overrides);
  void hear(Config& wanted);

  IncidentLog* incidents_;
  Apply apply_;
  mutable boost::recursive_mutex mutex_;  // the server's too; taken before any other
  Overrides overrides_;
  Config shown_;
  std::unique_ptr<dynamic_reconfigure::Server<Config>> server_;
};

}  // namespace soft_volume
