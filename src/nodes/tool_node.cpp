#include "soft_volume/ros/tool_node.h"
#include "soft_volume/ros/run_node.h"

namespace {

constexpr char kHelp[] = R"(tool_node [_device:=FILE] [_rate_hz:=HZ] [_priority:=N] [_wall_timeout_s:=S]

Turns the poses and buttons of a haptic device (CRTK: measured_cp, measured_cv, joy) into forces and cuts on the tissue
and into servo_cf. The tools come with the scene. Service tool/reset ends a safety trip.

  _device:=FILE             a device's file (config/devices): limits, topics, workspace; without one poses are in the
                            volume's frame and the scene says what the device may render
  _rate_hz:=HZ              of the haptic loop (the device's; 1000 without a file)
  _priority:=N              of the loop's thread, SCHED_FIFO, where that is permitted (50)
  _wall_timeout_s:=S        with use_sim_time: a pose older than this by the wall clock is stale (0.25)
)";

}  // namespace

int main(int argc, char** argv) {
  return soft_volume::runNode<soft_volume::ToolNode>(argc, argv, "tool_node", kHelp);
}
