#include <nodelet/nodelet.h>
#include <pluginlib/class_list_macros.hpp>

#include <memory>

#include "soft_volume/ros/tool_node.h"

namespace soft_volume {

/// The tool node in a nodelet manager; topics and parameters are those of the node.
class ToolNodelet : public nodelet::Nodelet {
  void onInit() override { node_ = std::make_unique<ToolNode>(getNodeHandle(), getPrivateNodeHandle()); }
  std::unique_ptr<ToolNode> node_;
};

}  // namespace soft_volume

PLUGINLIB_EXPORT_CLASS(soft_volume::ToolNodelet, nodelet::Nodelet)
