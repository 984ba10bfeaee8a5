#include "scripted_run.h"

namespace soft_volume::core {

ScriptedRun::ScriptedRun(Session& session) : session_(session), device_(session.scene().device) {
  for (const ToolConfig& config : session_.scene().tools) {
    tools_.push_back(std::make_unique<Tool>(config));
    tools_.back()->setVolume(session_.volume());
  }
}

void ScriptedRun::move() {
  const double end_s = session_.simulationTime() + session_.timeStep();
  while (device_.time_s() + VirtualDevice::kStep_s <= end_s)
    moveOnce();
}

void ScriptedRun::moveOnce() {
  device_.step();
  const Buttons before = buttons_;
  buttons_ = device_.buttons();
  const std::uint32_t swap = session_.scene().swap_button;
  if (buttons_[swap] && !before[swap])
    swapTool();
  showGrid();
  ToolInput input;
  input.time_s = input.pose_time_s = device_.time_s();
  input.pose = device_.pose();
  input.velocity_m_s = device_.velocity_m_s();
  input.buttons = buttons_;
  output_ = tools_[in_hand_]->update(input);
  device_.setServoForce(output_.device_force_n);
  if (output_.force)
    judge(session_.apply(toCommand(tool().config().id, *output_.force)));
  if (output_.cut)
    judge(session_.apply(toCommand(tool().config().id, *output_.cut)));
}

void ScriptedRun::swapTool() {
  tools_[in_hand_]->reset();
  in_hand_ = (in_hand_ + 1) % tools_.size();
  tools_[in_hand_]->reset();
  next_patch_s_ = 0.0;
}

void ScriptedRun::showGrid() {
  if (session_.lattice().revision != shown_revision_) {
    shown_revision_ = session_.lattice().revision;
    const auto topology = std::make_shared<const Topology>(session_.topology());
    for (const auto& tool : tools_)
      tool->setTopology(topology);
    next_patch_s_ = 0.0;
  }
  if (device_.time_s() < next_patch_s_)
    return;
  next_patch_s_ = device_.time_s() + 1.0 / session_.scene().output.patch_rate_hz;
  const ToolConfig& config = tool().config();
  tools_[in_hand_]->setPatch(session_.patch(config.id, device_.pose().position_m, config.patch_radius_m));
}

void ScriptedRun::judge(const Verdict& verdict) {
  if (verdict.applied)
    return;
  ++refused_;
  refusal_ = verdict.reason;
}

}  // namespace soft_volume::core
