#pragma once

#include <cstdint>
#include <type_traits>

namespace soft_volume::core {

/// What `soft_volume_read_volume MEMORY_BYTES PATH` writes to its standard output: either a VolumeReply followed by
/// `byte_count` bytes of scalars (x fastest) and exit code 0, or kErrorMagic followed by one line of text and exit code
/// 1. Both ends run on one machine, so the byte order is the machine's own.
constexpr char kVolumeMagic[8] = {'S', 'V', 'V', 'O', 'L', 'U', 'M', 'E'};
constexpr char kErrorMagic[8] = {'S', 'V', 'E', 'R', 'R', 'O', 'R', ':'};
constexpr std::uint32_t kReaderProtocolVersion = 1;

struct VolumeReply {
  char magic[8];
  std::uint32_t version;
  std::uint32_t scalar_type;  ///< a ScalarType
  std::int32_t dims[3];
  std::int32_t unused;
  double spacing_m[3];
  double origin_m[3];   ///< RAS, metres
  double direction[9];  ///< row-major, columns are the axes of the grid in RAS
  std::uint64_t byte_count;
};
static_assert(std::is_trivially_copyable<VolumeReply>::value && sizeof(VolumeReply) == 160, "no hidden padding");

}  // namespace soft_volume::core
