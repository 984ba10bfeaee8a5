#include "message_start.h"

#include <soft_volume/GridState.h>
#include <soft_volume/GridTopology.h>
#include <soft_volume/SimulationJournal.h>

#include "soft_volume/messages/checked_stream.h"

namespace soft_volume {
namespace {

template <typename Message>
bool is(const std::string& type) {
  return type == ros::message_traits::DataType<Message>::value();
}

}  // namespace

MessageStart readMessageStart(const std::string& type, std::vector<std::uint8_t>& bytes) {
  CheckedStream stream(bytes.data(), static_cast<std::uint32_t>(bytes.size()));
  MessageStart start;
  std::uint8_t flag = 0;
  stream.next(start.header);
  stream.next(start.session);
  stream.next(start.revision);
  stream.next(start.step);
  if (is<SimulationJournal>(type))
    stream.next(start.first_step);
  if (is<GridTopology>(type)) {
    stream.next(flag);
    start.delta = flag != 0;
  }
  if (is<GridState>(type)) {
    stream.next(start.time_s);
    stream.next(flag);
    stream.next(start.base_step);
    start.key_frame = flag != 0;
  }
  return start;
}

}  // namespace soft_volume
