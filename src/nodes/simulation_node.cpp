#include "soft_volume/ros/simulation_node.h"
#include "soft_volume/ros/run_node.h"

int main(int argc, char** argv) {
  return soft_volume::runNode<soft_volume::SimulationNode>(argc, argv, "simulation_node");
}
