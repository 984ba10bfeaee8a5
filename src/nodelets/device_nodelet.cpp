#include <nodelet/nodelet.h>
#include <pluginlib/class_list_macros.hpp>

#include <memory>

#include "soft_volume/ros/device_node.h"
#include "soft_volume/ros/master_watch.h"

namespace soft_volume {

/// The device node in a nodelet manager; topics and parameters are those of the node.
class DeviceNodelet : public nodelet::Nodelet {
  void onInit() override {
    watch_ = MasterWatch::shared();
    watch_->keepParameters(getPrivateNodeHandle().getNamespace());
    node_ = std::make_unique<DeviceNode>(getNodeHandle(), getPrivateNodeHandle());
  }
  std::shared_ptr<MasterWatch> watch_;
  std::unique_ptr<DeviceNode> node_;
};

}  // namespace soft_volume

PLUGINLIB_EXPORT_CLASS(soft_volume::DeviceNodelet, nodelet::Nodelet)
