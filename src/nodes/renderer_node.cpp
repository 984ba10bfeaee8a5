#include "soft_volume/ros/renderer_node.h"
#include "soft_volume/ros/run_node.h"

namespace {

constexpr char kHelp[] = R"(renderer_node

Draws the newest state of the grid for every camera of the scene that somebody looks at, without a display. Scene,
volume and grid come as topics; <camera>/view moves a camera.
)";

}  // namespace

int main(int argc, char** argv) {
  return soft_volume::runNode<soft_volume::RendererNode>(argc, argv, "renderer_node", kHelp);
}
