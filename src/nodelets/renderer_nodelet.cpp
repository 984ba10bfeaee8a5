#include <nodelet/nodelet.h>
#include <pluginlib/class_list_macros.hpp>

#include <memory>

#include "soft_volume/ros/master_watch.h"
#include "soft_volume/ros/renderer_node.h"

namespace soft_volume {

/// The renderer node in a nodelet manager; topics and parameters are those of the node.
class RendererNodelet : public nodelet::Nodelet {
  void onInit() override {
    watch_ = MasterWatch::shared();
    watch_->keepParameters(getPrivateNodeHandle().getNamespace());
    node_ = std::make_unique<RendererNode>(getNodeHandle(), getPrivateNodeHandle());
  }
  std::shared_ptr<MasterWatch> watch_;
  std::unique_ptr<RendererNode> node_;
};

}  // namespace soft_volume

PLUGINLIB_EXPORT_CLASS(soft_volume::RendererNodelet, nodelet::Nodelet)
