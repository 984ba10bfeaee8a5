#include "soft_volume/ros/renderer_node.h"
#include "soft_volume/ros/run_node.h"

int main(int argc, char** argv) {
  return soft_volume::runNode<soft_volume::RendererNode>(argc, argv, "renderer_node");
}
