#pragma once

#include <geometry_msgs/Point.h>
#include <geometry_msgs/Pose.h>
#include <geometry_msgs/Vector3.h>
#include <soft_volume/GridPatch.h>
#include <soft_volume/GridState.h>
#include <soft_volume/GridTopology.h>
#include <soft_volume/IncisionState.h>
#include <soft_volume/PartRemoval.h>
#include <soft_volume/Scene.h>
#include <soft_volume/SimulationCheckpoint.h>
#include <soft_volume/SimulationControl.h>
#include <soft_volume/SimulationStats.h>
#include <soft_volume/ToolCut.h>
#include <soft_volume/ToolForce.h>
#include <soft_volume/ToolGrip.h>
#include <soft_volume/ToolProgress.h>
#include <soft_volume/ToolState.h>
#include <soft_volume/Volume.h>

#include <memory>

#include "soft_volume/grid/lattice.h"
#include "soft_volume/grid/patch.h"
#include "soft_volume/grid/state_stream.h"
#include "soft_volume/grid/topology.h"
#include "soft_volume/grid/topology_delta.h"
#include "soft_volume/scene/scene.h"
#include "soft_volume/session/lockstep.h"
#include "soft_volume/session/session.h"
#include "soft_volume/tool/tool.h"
#include "soft_volume/tool/tool_command.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume {

// Conversions between the core's types and messages. `toMessage` fills everything but the header, which belongs to the
// caller. `fromMessage` throws InputError when the message cannot be the core's type; whether its content can be used
// is for the core to judge. All are pure and safe from any thread.

geometry_msgs::Point toPoint(const core::Vector3& p);
geometry_msgs::Vector3 toVector(const core::Vector3& v);
geometry_msgs::Pose toPose(const core::Pose& pose);
core::Vector3 fromPoint(const geometry_msgs::Point& p);
core::Vector3 fromVector(const geometry_msgs::Vector3& v);
/// The quaternion is taken as it is; core::isUsable() judges it.
core::Pose fromPose(const geometry_msgs::Pose& pose);

/// Volume and labels of a session; labels may be null.
Volume toMessage(const core::Session& session);
struct VolumeAndLabels {
  std::shared_ptr<const core::Volume> volume;
  std::shared_ptr<const core::Volume> labels;  ///< null without labels
};
/// Checks sizes against dims and the hash against the content before it copies.
VolumeAndLabels fromMessage(const Volume& message);

/// The resolved scene of a session.
Scene sceneMessage(const core::Session& session);

/// A full topology, or a change, for the states from a step on.
GridTopology toMessage(const core::Topology& topology, std::uint64_t step);
GridTopology toMessage(const core::TopologyDelta& delta, std::uint64_t step);
/// That of the steps to come.
GridTopology topologyMessage(const core::Session& session);
/// Only full topologies; a delta throws InputError.
core::Topology fromMessage(const GridTopology& message);
/// Brings a receiver up to date, with a full topology or a delta. Throws InputError, and leaves the receiver as it was,
/// when the message does not hold together.
core::TopologyDecoder::Result takeMessage(const GridTopology& message, core::TopologyDecoder& decoder);

/// Chooses the form in which the topologies of a run are sent one after the other. Not thread-safe.
class TopologyEncoder {
 public:
  /// Full messages of fewer bytes are sent full always: they are no burden, and nobody has to wait for one.
  static constexpr std::size_t kDeltaFromBytes = std::size_t(256) << 10;

  explicit TopologyEncoder(std::size_t delta_from_bytes = kDeltaFromBytes) : delta_from_bytes_(delta_from_bytes) {}

  /// Full at first, for another session, when asked, where the last one is not the one before the last cut, and where
  /// the grid is small; else what the last cut changed.
  GridTopology encode(const core::Session& session, bool full);
  /// Who comes now needs a full one.
  bool lastWasDelta() const { return last_was_delta_; }

 private:
  std::size_t delta_from_bytes_;
  std::uint64_t session_ = 0;
  std::uint32_t revision_ = 0;
  bool last_was_delta_ = false;
};

GridState toMessage(const core::GridStateFrame& frame);
core::GridStateFrame fromMessage(const GridState& message);

GridPatch toMessage(const core::GridPatch& patch);
core::GridPatch fromMessage(const GridPatch& message);

ToolForce toMessage(const core::ToolForceCommand& command);
core::ToolForceCommand fromMessage(const ToolForce& message);

ToolCut toMessage(const core::ToolCutCommand& command);
core::ToolCutCommand fromMessage(const ToolCut& message);

/// What a tick says of itself. Which tool, its pose, buttons and number, and the proxy's orientation are for the
/// caller.
ToolState toMessage(const core::ToolOutput& output);
/// All but the number.
ToolState toMessage(const core::HandTick& tick, const core::ToolConfig& config);

/// The stamp is the header's.
ToolProgress toMessage(const core::ToolNotice& notice);
core::ToolNotice fromMessage(const ToolProgress& message);

ToolGrip toMessage(const core::ToolGripCommand& command);
core::ToolGripCommand fromMessage(const ToolGrip& message);

IncisionState toMessage(const core::IncisionState& state);
core::IncisionState fromMessage(const IncisionState& message);

core::RemovalCommand fromMessage(const PartRemoval& message);
core::IntegratorCommand fromMessage(const SimulationControl& message);

/// What the simulation itself knows; times, counts and extremes of the node stay 0.
SimulationStats statsMessage(const core::Session& session);

SimulationCheckpoint toMessage(const core::Session& session, const core::Checkpoint& checkpoint);
core::Checkpoint fromMessage(const SimulationCheckpoint& message);

}  // namespace soft_volume
