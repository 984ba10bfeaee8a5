#pragma once

#include <cstddef>
#include <memory>
#include <vector>

#include "soft_volume/session/session.h"
#include "soft_volume/tool/tool.h"
#include "soft_volume/tool/virtual_device.h"

namespace soft_volume::core {

/// A session with the scene's virtual device and the tool in its hand, as the nodes run them, but in one thread and
/// without delays: the device at 1 kHz of simulated time, patches at the scene's rate. Deterministic. Not thread-safe.
class ScriptedRun {
 public:
  /// Keeps a reference to `session`, which must outlive it.
  explicit ScriptedRun(Session& session);

  /// Moves the device up to the end of the session's next step and hands its commands to the session. To be called
  /// before every step of the session.
  void move();

  bool scriptEnded() const { return device_.scriptEnded(); }
  const Tool& tool() const { return *tools_[in_hand_]; }
  const VirtualDevice& device() const { return device_; }
  /// Of the newest pose.
  const ToolOutput& output() const { return output_; }
  /// Grows with every input that the session refused; the reason of the last one.
  std::size_t refused() const { return refused_; }
  const std::string& refusal() const { return refusal_; }

 private:
  void moveOnce();
  void swapTool();
  void showGrid();
  void judge(const Verdict& verdict);

  Session& session_;
  VirtualDevice device_;
  std::vector<std::unique_ptr<Tool>> tools_;
  std::size_t in_hand_ = 0;
  Buttons buttons_;
  ToolOutput output_;
  double next_patch_s_ = 0.0;
  std::uint32_t shown_revision_ = 0;
  std::size_t refused_ = 0;
  std::string refusal_;
};

}  // namespace soft_volume::core
