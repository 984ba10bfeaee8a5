#include "soft_volume/ros/tool_node.h"
#include "soft_volume/ros/run_node.h"

namespace {

constexpr char kHelp[] = R"(tool_node [_wall_timeout_s:=S]

Turns the poses and buttons of a haptic device (CRTK: measured_cp, measured_cv, joy) into forces and cuts on the tissue
and into servo_cf. The tools come with the scene. Service tool/reset ends a safety trip.

  _wall_timeout_s:=S        with use_sim_time: a pose older than this by the wall clock is stale (0.25)
)";

}  // namespace

int main(int argc, char** argv) {
  return soft_volume::runNode<soft_volume::ToolNode>(argc, argv, "tool_node", kHelp);
}
