#pragma once

#include <cstddef>
#include <cstdint>

namespace soft_volume::core {

/// Pixels are worked on in blocks of this many neighbours of a row.
constexpr int kPixelLanes = 8;
/// Tiles lie on a fixed raster from pixel (0, 0), so that what a pixel gets never depends on the rectangle drawn.
constexpr int kTileWidth = 64;
constexpr int kTileHeight = 64;
constexpr int kTilePixels = kTileWidth * kTileHeight;
/// Samples reach this far beyond a tile, for the differences that normals are made of. Rows keep room for one block
/// more, as the last block of a span may overhang.
constexpr int kApron = 1;
constexpr int kSampleStride = kTileWidth + 2 * kPixelLanes;
constexpr int kSampleRows = kTileHeight + 2 * kApron;
constexpr int kPlaneSamples = kSampleStride * kSampleRows;
/// Planes that are sampled before they are composited.
constexpr int kRunPlanes = 16;
/// The same where a sample has several parts: what a tile has of them stays in a cache of 1 MiB.
constexpr int kRunPlanesOfParts = 10;
/// Of a sample, and of what is interpolated across a polygon: a boundary face has its depth as well.
constexpr int kMaxSampleParts = 4;
constexpr int kMaxAttributes = kMaxSampleParts + 1;
constexpr int kMaxKernelClips = 9;  ///< those of the options, and far
constexpr int kTileBlocks = kTilePixels / kPixelLanes;

/// What a plane's sample of a pixel consists of.
enum class SampleKind : std::uint8_t {
  kScalar,   ///< the scalar
  kTexture,  ///< place in the volume: voxel index along each axis
  kColour,   ///< red, green, blue and absorption
};

/// One corner of a polygon: pixels, and what is interpolated between the corners.
struct FillCorner {
  float x, y;
  float value[kMaxAttributes];
};

/// Where a polygon's samples go: kPlaneSamples floats for each attribute. The first pixel of a row is
/// kPixelLanes pixels left of the tile.
struct FillTarget {
  float* sample[kMaxAttributes];
  int first_x, first_y;  ///< pixel of the first sample of the first row
  std::uint16_t* hits;   ///< per block of the tile, gets the bits of `plane`; null when nobody asks
  std::uint16_t plane;   ///< one bit
  int begin_x, end_x;    ///< pixels that are wanted, within the rows
  int begin_y, end_y;
};

/// Fills a polygon by the even-odd rule. A pixel belongs to it when its centre does; centres on an edge that two
/// polygons share belong to exactly one of them, as both compute the same crossings. `crossings` has room for `size` of
/// each row. With `trilinear` the three attributes are places in a hexahedron and the sample is the trilinear
/// polynomial with these eight coefficients (1, u, v, w, uv, uw, vw, uvw).
struct Crossing {
  float x;
  float value[kMaxAttributes];
};
using FillPolygon = void (*)(const FillTarget& target, const FillCorner* corners, int size, int attributes,
                             const float* trilinear, Crossing* crossings);

/// The transfer function as TransferTable has it: red, green, blue, absorption.
struct TableView {
  const float* entries;
  const float* integrals;
  float first_value;
  float entries_per_value;
  int size;
};

/// Side of a brick, as a power of two. A brick is visible where something shows in it or in a margin around it, so the
/// way between two samples in invisible bricks shows nothing as long as it is no longer than two margins.
constexpr int kBrickShift = 2;
constexpr int kBrickTexels = 1 << kBrickShift;
constexpr int kBrickMargin = 3;  ///< texels; in what spreads from brick to brick it is a brick more

/// The volume's texels, or those of a coarser level of its mipmap; at least two along each axis and less than 2^32 in
/// all.
struct TexelView {
  const void* texels;
  int type;  ///< 0: int16, 1: uint16, 2: float32
  int dims[3];
  std::size_t row, slice;  ///< texels from one row to the next, from one slice to the next
  /// Per brick of kBrickTexels^3, x fastest: 0 where neither it nor its margin shows anything. Null: not known.
  const std::uint8_t* visible;
  int brick_row, brick_slice;
  float per_voxel[3], offset[3];             ///< of a coarser level: texel index = voxel index * per_voxel + offset
  const TexelView* coarser;                  ///< level 1 and on, each half of the one before along each axis
  int coarser_levels;                        ///< 0: no pixel is wider than a voxel
  float pixel_width, pixel_width_per_depth;  ///< a pixel's width at depth z: pixel_width + z * pixel_width_per_depth
};

/// What is known of a block of pixels.
constexpr std::uint8_t kBlockOutside = 0;  ///< no ray is inside the grid
constexpr std::uint8_t kBlockInside = 1;
constexpr std::uint8_t kBlockOpaque = 2;  ///< nothing more can be seen

/// Pixels of a tile between two runs of planes; arrays of kTilePixels.
struct PixelState {
  float* colour[3];  ///< premultiplied
  float* opacity;
  float* sample[kMaxSampleParts];  ///< of the last plane that hit, [0] NaN where the ray is outside
  float* sample_z;                 ///< its depth
  float* sample_back;              ///< where its slab ends
  float* depth;                    ///< NaN as long as the threshold was not reached; null when not wanted
  std::uint16_t* label;            ///< null when not wanted
  std::uint8_t* block;             ///< per block, one of kBlock...
};

/// Entries into and exits out of the drawn cells along each ray of a tile, sorted by depth: event `n` of pixel `p` is
/// at [n * kTilePixels + p]. Behind the last one the depth is infinite.
struct EventView {
  const float* z;
  const float* sample[kMaxSampleParts];
  const std::uint8_t* entering;
  int count;  ///< of layers, the last of which is all infinite
  int* next;  ///< per pixel
};

struct LabelView {
  const std::uint16_t* labels;  ///< null for none
  int dims[3];
  float per_voxel[3], offset[3];  ///< label index = voxel index * per_voxel + offset, rounded
};

struct CompositeJob {
  SampleKind kind;
  const float* sample[kMaxSampleParts];  ///< of the first plane, as FillTarget; plane n is n * kPlaneSamples further on
  int planes;
  const float* z;                      ///< per plane
  const float* front;                  ///< per plane, where its slab begins
  const float* back;                   ///< per plane, where its slab ends
  const std::uint8_t* extra;           ///< per plane
  const std::uint16_t* hits;           ///< per block, the bits of the planes that have samples there
  bool last;                           ///< no plane follows: rays that are inside end
  int tile_x, tile_y;                  ///< first pixel
  int begin_x, end_x, begin_y, end_y;  ///< pixels that are wanted, within the tile
  float cx, cy, slope_x, slope_y;      ///< x and y per metre of depth at a pixel: (x - cx) slope_x; 0: parallel
  float pixel_x, pixel_y;              ///< pixels per metre at depth 1 (perspective), or at any depth
  bool perspective;
  float distance;  ///< of the planes
  TableView table;
  TexelView volume;
  LabelView labels;
  float shading, specular;
  float light[3], half_way[3];  ///< unit vectors, camera frame
  float edge_scale;             ///< 1 / the change of the scalar that counts as a surface
  float normal_step;            ///< within this distance, metres
  float spacing[3];         ///< of the volume's voxels, metres
  float depth_threshold;
  bool jitter;
  bool cross_section;
  int clips;
  float clip[kMaxKernelClips][4];  ///< kept where n . p <= offset, camera frame
  EventView events;                ///< count 0: half a slab before the first and behind the last plane
};

/// Takes the samples of a run of planes into the pixels of a tile. Returns the number of segments.
using CompositeTile = std::size_t (*)(const CompositeJob& job, const PixelState& state);

struct NativeKernel {
  FillPolygon fill;
  CompositeTile composite;
};

const NativeKernel& portableNativeKernel();
const NativeKernel& avx2NativeKernel();
/// The faster one that the processor can run; SOFT_VOLUME_KERNEL=portable in the environment forces the other. Both
/// give the same bits.
const NativeKernel& bestNativeKernel();

}  // namespace soft_volume::core
