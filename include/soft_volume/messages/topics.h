#pragma once

namespace soft_volume {
namespace topics {

// Relative names of everything that crosses a node boundary; remap them as usual. Camera topics lie in the namespace
// of the camera's name.
constexpr char kScene[] = "scene";
constexpr char kVolume[] = "volume";
constexpr char kTopology[] = "grid/topology";
constexpr char kState[] = "grid/state";
constexpr char kPatch[] = "grid/patch";
constexpr char kJournal[] = "simulation/journal";
constexpr char kCheckpoint[] = "simulation/checkpoint";
constexpr char kSimulationStats[] = "simulation/stats";
constexpr char kToolForce[] = "tool/force";
constexpr char kToolCut[] = "tool/cut";
constexpr char kToolGrip[] = "tool/grip";
constexpr char kToolState[] = "tool/state";
constexpr char kToolProgress[] = "tool/progress";
constexpr char kMeasuredPose[] = "measured_cp";
constexpr char kMeasuredVelocity[] = "measured_cv";
constexpr char kServoForce[] = "servo_cf";
constexpr char kButtons[] = "joy";
/// Of notes in the journal: that a session left the lockstep, and why.
constexpr char kLockstep[] = "lockstep";
constexpr char kRenderStats[] = "render/stats";
constexpr char kRecorderStatus[] = "recorder/status";
constexpr char kRecordingInfo[] = "recorder/info";

// Services of the simulation.
constexpr char kReset[] = "simulation/reset";
constexpr char kPause[] = "simulation/pause";
constexpr char kStep[] = "simulation/step";
constexpr char kSetIntegrator[] = "simulation/set_integrator";
constexpr char kSaveCheckpoint[] = "simulation/save_checkpoint";
constexpr char kRemovePart[] = "simulation/remove_part";
constexpr char kRestoreCheckpoint[] = "simulation/restore_checkpoint";
constexpr char kRequestKeyFrame[] = "simulation/request_key_frame";
// What the journal calls the start of a session that goes on where a killed simulation ended.
constexpr char kResume[] = "simulation/resume";
// Services of a tool and of the recorder.
constexpr char kToolReset[] = "tool/reset";

}  // namespace topics
}  // namespace soft_volume
