#pragma once

#include <memory>
#include <string>

namespace soft_volume {

/// Keeps a process in the graph when the master is restarted or the network was gone, which roscpp does not.
///
/// - The master is looked at every second. When it forgot this process, publishers and services are registered again at
///   once and subscribers a moment later, when the other nodes' publishers are known, so that live connections go on;
///   private parameters and /use_sim_time are set as they were, unless somebody set them anew. It takes less than 4 s.
/// - A host of publishers that was silent for some seconds and answers again: connections to it are made anew. TCP
/// would
///   wait as long again as the host was gone.
///
/// What happened is logged and told in diagnostics ("NODE: graph"). Works for what other libraries registered in this
/// process too. One thread; a call of it waits for about two seconds at most, and as long as a host's name takes to
/// resolve.
class MasterWatch {
 public:
  /// ROS must have been started.
  MasterWatch();
  ~MasterWatch();
  MasterWatch(const MasterWatch&) = delete;
  MasterWatch& operator=(const MasterWatch&) = delete;

  /// The one that nodelets of a process share; it ends with its last holder.
  static std::shared_ptr<MasterWatch> shared();

  /// Parameters below this name come back with the master, as those of the node's own name do. Thread-safe.
  void keepParameters(const std::string& name_space);

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace soft_volume
