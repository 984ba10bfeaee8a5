#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "native_canvas.h"
#include "native_kernel.h"

namespace soft_volume::core {

inline std::size_t samplePartsOf(SampleKind kind) {
  return kind == SampleKind::kScalar ? 1 : (kind == SampleKind::kTexture ? 3 : 4);
}

/// What a tile keeps from one run of planes to the next.
struct NativeCanvas::Tile {
  int x = 0, y = 0;
  bool opaque = false;
  bool blank = true;  ///< nothing was drawn into it yet: its arrays are still those of the last frame
  std::size_t segments = 0;
  std::array<std::uint8_t, kTileBlocks> blocks{};  ///< as PixelState::block
  std::vector<float> floats;                       ///< ten or eleven arrays of kTilePixels
  std::vector<std::uint16_t> labels;
  // Boundary faces in front of each pixel, as EventView.
  std::vector<float> event_z;
  std::array<std::vector<float>, kMaxSampleParts> event_sample;
  std::vector<std::uint8_t> event_entering;
  std::vector<int> event_next;
  int event_layers = 0;

  float* array(std::size_t n) { return floats.data() + n * kTilePixels; }
  PixelState state(bool depth) {
    PixelState s{};
    for (std::size_t n = 0; n < 3; ++n)
      s.colour[n] = array(n);
    s.opacity = array(3);
    for (std::size_t n = 0; n < kMaxSampleParts; ++n)
      s.sample[n] = array(4 + n);
    s.sample_z = array(8);
    s.sample_back = array(9);
    s.depth = depth ? array(10) : nullptr;
    s.label = labels.empty() ? nullptr : labels.data();
    s.block = blocks.data();
    return s;
  }
};

/// What a thread needs for the tile that it works on.
struct NativeCanvas::Scratch {
  std::vector<float> samples;  ///< [plane][attribute][kPlaneSamples], see sampleAt()
  std::vector<float> face;     ///< [attribute][kPlaneSamples] of one boundary face
  std::vector<Crossing> crossings;
  std::vector<FillCorner> corners;
  std::array<std::uint8_t, kRunPlanes> occupied{};  ///< per plane, 0 where the tile has no samples
  std::array<std::uint16_t, kTileBlocks> hits{};    ///< as CompositeJob::hits

  void reserveCorners(std::size_t size) {
    if (corners.size() < size)
      corners.resize(size);
    if (crossings.size() < size * kSampleRows)
      crossings.resize(size * kSampleRows);
  }

  float* sampleAt(std::size_t attribute, std::size_t plane) {
    return samples.data() + (attribute * kRunPlanes + plane) * kPlaneSamples;
  }
  const float* sampleAt(std::size_t attribute) const { return samples.data() + attribute * kRunPlanes * kPlaneSamples; }
};

}  // namespace soft_volume::core
