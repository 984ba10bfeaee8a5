#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "queued_message.h"

namespace soft_volume {

/// What a part of a recording begins with so that it replays alone: everything latched, the whole topology, the newest
/// checkpoint with the journal and the tools' inputs that followed it, and the states since the last key frame. All of
/// it came through the recorder before, so that a part can begin without asking the simulation for anything.
class PartStart {
 public:
  /// Most that is kept of states, journals and inputs. A simulation that sends no checkpoints for long must not fill
  /// the memory; beyond it a part waits for the next checkpoint and key frame.
  explicit PartStart(std::uint64_t most_kept_bytes = std::uint64_t(128) << 20) : most_kept_bytes_(most_kept_bytes) {}

  void hear(const QueuedMessage& message);

  /// Whether a part can begin now: everything is there, of one run that has lasted a while, and the journal is without
  /// gaps.
  bool ready() const;
  /// In an order in which they can be written, receipt times of latched ones moved to the others'.
  std::vector<QueuedMessage> messages() const;
  /// What no part can do without: latched messages and the topology [bytes].
  std::uint64_t latchedBytes() const;

 private:
  /// A message of ours with what it says of itself.
  struct Known {
    QueuedMessage message;
    std::uint64_t session = 0;
    std::uint64_t step = 0;
    std::uint64_t first_step = 0;
  };

  void hearKnown(const std::string& type, const QueuedMessage& message);
  void keep(std::vector<Known>& list, Known known);
  void hearCheckpoint(const Known& checkpoint);
  bool sameSession() const;
  bool journalIsWhole() const;
  void limit();

  std::uint64_t most_kept_bytes_;
  std::map<std::pair<std::string, std::string>, QueuedMessage> latched_;  ///< by topic and publisher
  std::map<std::string, Known> newest_;                                   ///< scene, volume and checkpoint, by type
  std::vector<Known> topologies_;                                         ///< a whole one and the changes to it
  std::vector<Known> states_;                                             ///< a key frame and those that follow
  std::vector<Known> journals_;                                           ///< after the checkpoint
  std::vector<Known> inputs_;                                             ///< likewise
  std::uint64_t kept_bytes_ = 0;                                          ///< of states, journals and inputs
  std::uint64_t session_ = 0;
  ros::Time session_since_;
  ros::Time now_;
};

}  // namespace soft_volume
