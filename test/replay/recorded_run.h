#pragma once

#include <rosbag/bag.h>
#include <soft_volume/SimulationCheckpoint.h>

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "soft_volume/replay/bag_recorder.h"
#include "soft_volume/scene/scene.h"

namespace soft_volume {

/// What a recorded run consists of: a soft ball, 125 cells, one camera, a force every 10 steps, a NaN force at step
/// 150, a cut at step 200, a state every 20 steps.
struct RunSettings {
  std::uint64_t session = 1;
  std::uint64_t steps = 400;
  std::uint64_t first_recorded_step = 0;             ///< what was published before is not in the bag
  std::optional<SimulationCheckpoint> restore = {};  ///< the run continues from here
  bool grips = false;   ///< jaws hold and lift tissue from step 250 to 340, and the integrator changes at 260 and 350
  bool deltas = false;  ///< of the topology, although the grid is small
  std::function<void(std::uint64_t step)> recorded = {};  ///< called after each step
  bool cuts = true;
  std::function<void(core::Scene&)> change = {};  ///< of the scene
};

/// Runs a session and records it as the nodes do. Returns the checkpoint at its end.
SimulationCheckpoint recordRun(BagRecorder& recorder, const RunSettings& settings);
/// One run in a bag of its own.
void recordBag(const std::string& file, const RunSettings& settings, bool compress = true);

/// A serialised message in a bag.
struct RawMessage {
  std::string topic;
  ros::Time time;
  boost::shared_ptr<ros::M_string> header;
  std::string type;
  std::string md5sum;
  std::string definition;
  std::vector<std::uint8_t> bytes;
};

/// Copies a bag message by message, in small chunks. `edit` may change one; false leaves it out.
void rewriteBag(const std::string& from, const std::string& to, const std::function<bool(RawMessage&)>& edit,
                bool compress = true);

/// Calls `change` on the `number`-th message of this type, and copies the rest as it is.
template <typename Message>
void rewriteMessage(const std::string& from, const std::string& to, int number,
                    const std::function<void(Message&)>& change) {
  int seen = 0;
  rewriteBag(from, to, [&](RawMessage& raw) {
    if (raw.type != ros::message_traits::datatype<Message>() || seen++ != number)
      return true;
    Message message;
    ros::serialization::IStream in(raw.bytes.data(), static_cast<std::uint32_t>(raw.bytes.size()));
    ros::serialization::deserialize(in, message);
    change(message);
    raw.bytes.resize(ros::serialization::serializationLength(message));
    ros::serialization::OStream out(raw.bytes.data(), static_cast<std::uint32_t>(raw.bytes.size()));
    ros::serialization::serialize(out, message);
    return true;
  });
}

struct ProgramResult {
  int code = -1;
  std::string output;  ///< stdout and stderr
};
/// Runs soft_volume_replay on a bag, with one thread unless told otherwise.
ProgramResult replay(const std::string& bag, const std::string& arguments = "--check");
/// Runs a command that ends with `2>&1`.
ProgramResult runShell(const std::string& command);

}  // namespace soft_volume
