#include "soft_volume/ros/simulation_node.h"
#include "soft_volume/ros/run_node.h"

namespace {

constexpr char kHelp[] = R"(simulation_node _scene:=FILE [_NAME:=VALUE ...]

Owns the lattice of a scene: applies what tools send, steps, and publishes deformed vertices.

  _scene:=FILE              scene file (YAML) to simulate; required
  _threads:=N               threads of the simulation (1); results do not depend on it
  _real_time_factor:=F      most simulated seconds per second (1); 0: as fast as possible
  _publish_clock:=true      be the source of /clock, with use_sim_time (false)
  _start_paused:=true       wait for the service simulation/pause (false)
  _stop_after_s:=S          shut down after so many simulated seconds (0: never)
  _frame_id:=NAME           name of the volume frame (volume)
  _resume_file:=FILE        keep the run there, and go on with what a killed simulation kept (none)
)";

}  // namespace

int main(int argc, char** argv) {
  return soft_volume::runNode<soft_volume::SimulationNode>(argc, argv, "simulation_node", kHelp);
}
