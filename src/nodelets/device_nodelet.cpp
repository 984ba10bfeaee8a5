#include <nodelet/nodelet.h>
#include <pluginlib/class_list_macros.hpp>

#include <memory>

#include "soft_volume/ros/device_node.h"

namespace soft_volume {

/// The device node in a nodelet manager; topics and parameters are those of the node.
class DeviceNodelet : public nodelet::Nodelet {
  void onInit() override { node_ = std::make_unique<DeviceNode>(getNodeHandle(), getPrivateNodeHandle()); }
  std::unique_ptr<DeviceNode> node_;
};

}  // namespace soft_volume

PLUGINLIB_EXPORT_CLASS(soft_volume::DeviceNodelet, nodelet::Nodelet)
