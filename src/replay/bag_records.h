#pragma once

#include <cstdint>
#include <string>

namespace soft_volume {

struct BagRecords {
  std::uint64_t file_bytes = 0;
  std::uint64_t largest_chunk_bytes = 0;  ///< uncompressed
};

/// Walks over the records of a bag (format 2.0, wiki.ros.org/Bags/Format/2.0), those within its chunks too, and believes
/// no length: rosbag's library reads beyond its buffers, crashes or takes all memory on some damaged bags. Throws
/// ReplayError when it is no bag, is not indexed, or a record does not fit.
BagRecords checkBagRecords(const std::string& path);

}  // namespace soft_volume
