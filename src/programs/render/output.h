#pragma once

#include <string>
#include <vector>

#include "soft_volume/render/renderer.h"

namespace soft_volume::core::render_program {

/// Minutes of work should not end with a file that cannot be written. Throws FileError; makes no new files.
void checkWritable(const std::string& path);

/// Little-endian or as the machine has it: the bytes of the floats, one after the other. Throws FileError.
void writeFloats(const std::string& path, const std::vector<float>& values);

/// PNG, or floats, by the name's end.
void writeDepth(const std::string& path, const Frame& frame);

/// Nearest and farthest finite depth; both NaN where nothing was hit.
struct DepthRange {
  float nearest;
  float farthest;
};
DepthRange depthRange(const Frame& frame);

/// NAME_007.png for NAME.png.
std::string numbered(const std::string& path, int number);

bool isTransparent(const Frame& frame);

/// The times of several frames.
class StageTimes {
 public:
  void add(const Frame& frame);
  /// By the names of --json.
  struct Medians {
    double transform_ms;
    double bucket_ms;
    double slice_ms;
    double render_ms;
    double total_ms;
  };
  Medians medians() const;

 private:
  std::vector<Medians> frames_;
};

/// Of this process, so far.
std::size_t peakRssBytes();

}  // namespace soft_volume::core::render_program
