#include <nodelet/nodelet.h>
#include <pluginlib/class_list_macros.hpp>

#include <memory>

#include "soft_volume/ros/master_watch.h"
#include "soft_volume/ros/tool_node.h"

namespace soft_volume {

/// The tool node in a nodelet manager; topics and parameters are those of the node.
class ToolNodelet : public nodelet::Nodelet {
  void onInit() override {
    watch_ = MasterWatch::shared();
    watch_->keepParameters(getPrivateNodeHandle().getNamespace());
    node_ = std::make_unique<ToolNode>(getNodeHandle(), getPrivateNodeHandle());
  }
  std::shared_ptr<MasterWatch> watch_;
  std::unique_ptr<ToolNode> node_;
};

}  // namespace soft_volume

PLUGINLIB_EXPORT_CLASS(soft_volume::ToolNodelet, nodelet::Nodelet)
