#pragma once

#include <ros/serialization.h>

#include <cstdint>
#include <cstring>
#include <vector>

namespace soft_volume {

/// Reads a message like ros::serialization::IStream, but refuses an array that the rest of the message cannot hold
/// before it makes room for it: IStream allocates and clears whatever length a message claims, up to 4 billion
/// elements. What reading takes is so at most a small multiple of the message. Throws StreamOverrunException as IStream
/// does.
class CheckedStream : public ros::serialization::Stream {
 public:
  static const ros::serialization::StreamType stream_type = ros::serialization::stream_types::Input;

  CheckedStream(std::uint8_t* data, std::uint32_t size) : Stream(data, size) {}

  template <typename T>
  void next(T& value) {
    ros::serialization::deserialize(*this, value);
  }

  template <typename T, typename Allocator>
  void next(std::vector<T, Allocator>& values) {
    checkLength(ros::serialization::serializationLength(T()));
    ros::serialization::deserialize(*this, values);
  }

 private:
  /// `least_size` is what an element takes at least: its strings and arrays may be empty.
  void checkLength(std::uint64_t least_size) {
    std::uint32_t length = 0;
    if (getLength() < sizeof(length))
      ros::serialization::throwStreamOverrun();
    std::memcpy(&length, getData(), sizeof(length));
    if (length * least_size > getLength() - sizeof(length))
      ros::serialization::throwStreamOverrun();
  }
};

}  // namespace soft_volume
