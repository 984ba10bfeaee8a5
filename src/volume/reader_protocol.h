#pragma once

#include <cstdint>
#include <type_traits>

namespace soft_volume::core {

/// What `soft_volume_read_file KIND MEMORY_BYTES PATH ...` writes to its standard output: either the answer of its kind
/// and exit code 0, or kErrorMagic followed by one line of text and exit code 1. Both ends run on one machine, so the
/// byte order is the machine's own.
constexpr char kErrorMagic[8] = {'S', 'V', 'E', 'R', 'R', 'O', 'R', ':'};
constexpr std::uint32_t kReaderProtocolVersion = 2;

/// volume MEMORY_BYTES PATH: a VolumeReply, then `byte_count` bytes of scalars (x fastest).
constexpr const char* kReadVolume = "volume";
constexpr char kVolumeMagic[8] = {'S', 'V', 'V', 'O', 'L', 'U', 'M', 'E'};

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

/// grid MEMORY_BYTES PATH SOLUTION_PATH ARRAY COMPONENT: a GridReply, then of an IrregularGrid the points (three floats
/// each), cell types, cell offsets (cells + 1), connectivity and the scalars (one for each point or cell); then
/// `arrays` times an ArrayReply with its name, and `notes` times the length of a note (32 bits) with its text.
constexpr const char* kReadGrid = "grid";
constexpr char kGridMagic[8] = {'S', 'V', 'G', 'R', 'I', 'D', ' ', ' '};

struct GridReply {
  char magic[8];
  std::uint32_t version;
  std::uint32_t place;  ///< a GridArray::Place, of the scalars
  std::uint32_t taken;  ///< index of the array that became the scalars
  std::uint32_t arrays;
  std::uint32_t notes;
  std::uint32_t unused;
  std::uint64_t points;
  std::uint64_t cells;
  std::uint64_t connectivity;  ///< entries
};
static_assert(std::is_trivially_copyable<GridReply>::value && sizeof(GridReply) == 56, "no hidden padding");

struct ArrayReply {
  double range[2];
  std::uint32_t place;  ///< a GridArray::Place
  std::uint32_t components;
  std::uint32_t name_bytes;
  std::uint32_t unused;
};
static_assert(std::is_trivially_copyable<ArrayReply>::value && sizeof(ArrayReply) == 32, "no hidden padding");

}  // namespace soft_volume::core
