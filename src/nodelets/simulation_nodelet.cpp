#include <nodelet/nodelet.h>
#include <pluginlib/class_list_macros.hpp>

#include <memory>

#include "soft_volume/ros/master_watch.h"
#include "soft_volume/ros/simulation_node.h"

namespace soft_volume {

/// The simulation node in a nodelet manager; topics and parameters are those of the node.
class SimulationNodelet : public nodelet::Nodelet {
  void onInit() override {
    watch_ = MasterWatch::shared();
    watch_->keepParameters(getPrivateNodeHandle().getNamespace());
    node_ = std::make_unique<SimulationNode>(getNodeHandle(), getPrivateNodeHandle());
  }
  std::shared_ptr<MasterWatch> watch_;
  std::unique_ptr<SimulationNode> node_;
};

}  // namespace soft_volume

PLUGINLIB_EXPORT_CLASS(soft_volume::SimulationNodelet, nodelet::Nodelet)
