// The kernels of the native back end, compiled once for every instruction set: SOFT_VOLUME_KERNEL_SPACE names the
// namespace. Nothing here may use an inline function of another header: the linker would keep one copy of it, perhaps
// the one with instructions that the processor lacks.

#include "native_kernel.h"

#if defined(__SSE2__)
#include <immintrin.h>
#endif

namespace soft_volume::core {
namespace SOFT_VOLUME_KERNEL_SPACE {
namespace {

#define SOFT_VOLUME_INLINE static inline __attribute__((always_inline))

typedef float Floats __attribute__((vector_size(32)));
typedef std::int32_t Ints __attribute__((vector_size(32)));
typedef std::uint32_t UInts __attribute__((vector_size(32)));
typedef float Floats4 __attribute__((vector_size(16)));

constexpr int kAllLanes = (1 << kPixelLanes) - 1;
constexpr float kOpaque = 0.999F;  ///< behind this a pixel takes nothing more: less than a quarter of an 8-bit level
constexpr float kHuge = 3.402823466e38F;

SOFT_VOLUME_INLINE Floats load(const float* from) {
  Floats x;
  __builtin_memcpy(&x, from, sizeof(x));
  return x;
}
SOFT_VOLUME_INLINE void store(float* to, const Floats& x) {
  __builtin_memcpy(to, &x, sizeof(x));
}
SOFT_VOLUME_INLINE Floats all(float x) {
  return x - Floats{};
}
SOFT_VOLUME_INLINE Ints allInts(std::int32_t x) {
  return x - Ints{};
}
SOFT_VOLUME_INLINE Floats lanes() {
  return Floats{0.0F, 1.0F, 2.0F, 3.0F, 4.0F, 5.0F, 6.0F, 7.0F};
}
SOFT_VOLUME_INLINE Floats toFloats(const Ints& x) {
  return __builtin_convertvector(x, Floats);
}
/// Towards zero; x must be within the range of int.
SOFT_VOLUME_INLINE Ints toInts(const Floats& x) {
  return __builtin_convertvector(x, Ints);
}
SOFT_VOLUME_INLINE Floats select(const Ints& mask, const Floats& a, const Floats& b) {
  return mask ? a : b;
}
SOFT_VOLUME_INLINE Floats smaller(const Floats& a, const Floats& b) {
  return select(a < b, a, b);
}
SOFT_VOLUME_INLINE Floats larger(const Floats& a, const Floats& b) {
  return select(a > b, a, b);
}
/// NaN becomes `low`.
SOFT_VOLUME_INLINE Floats clamp(const Floats& x, float low, float high) {
  return smaller(larger(x, all(low)), all(high));
}
SOFT_VOLUME_INLINE Ints isNumber(const Floats& x) {
  return x == x;
}
SOFT_VOLUME_INLINE Floats nothing() {
  return all(__builtin_nanf(""));
}

#if defined(__AVX__)
SOFT_VOLUME_INLINE int bitsOf(const Ints& mask) {
  return _mm256_movemask_ps((__m256)mask);
}
SOFT_VOLUME_INLINE Floats squareRoot(const Floats& x) {
  return (Floats)_mm256_sqrt_ps((__m256)x);
}
#elif defined(__SSE2__)
SOFT_VOLUME_INLINE int bitsOf(const Ints& mask) {
  __m128 halves[2];
  __builtin_memcpy(halves, &mask, sizeof(mask));
  return _mm_movemask_ps(halves[0]) | _mm_movemask_ps(halves[1]) << 4;
}
SOFT_VOLUME_INLINE Floats squareRoot(const Floats& x) {
  __m128 halves[2];
  __builtin_memcpy(halves, &x, sizeof(x));
  halves[0] = _mm_sqrt_ps(halves[0]);
  halves[1] = _mm_sqrt_ps(halves[1]);
  Floats root;
  __builtin_memcpy(&root, halves, sizeof(root));
  return root;
}
#else
SOFT_VOLUME_INLINE int bitsOf(const Ints& mask) {
  int bits = 0;
  for (int n = 0; n < kPixelLanes; ++n)
    bits |= (mask[n] != 0) << n;
  return bits;
}
SOFT_VOLUME_INLINE Floats squareRoot(Floats x) {
  for (int n = 0; n < kPixelLanes; ++n)
    x[n] = __builtin_sqrtf(x[n]);
  return x;
}
#endif

SOFT_VOLUME_INLINE bool any(const Ints& mask) {
  return bitsOf(mask) != 0;
}

/// Below this a short series gives 1 - 2^-x, and keeps the digits of a small one.
constexpr float kThin = 0.5F;

/// 1 - 2^-x for each x >= 0, within 2e-7. Sums are made in pairs, which wait less for each other than in Horner's rule.
/// Which of the two ways a lane goes depends on its own x alone.
template <int count>
SOFT_VOLUME_INLINE void opacitiesOf(const Floats* x, Floats* opacity) {
  Ints thick{};
  for (int n = 0; n < count; ++n)
    thick |= ~(x[n] < kThin);
  Floats x2[count];
  Floats x4[count];
  for (int n = 0; n < count; ++n)
    x2[n] = x[n] * x[n];
  for (int n = 0; n < count; ++n)
    x4[n] = x2[n] * x2[n];
  for (int n = 0; n < count; ++n) {
    const Floats low = (0.69314718F - 0.24022651F * x[n]) + x2[n] * (5.5504109e-2F - 9.6181291e-3F * x[n]);
    opacity[n] = x[n] * (low + x4[n] * (1.3333558e-3F - 1.5403530e-4F * x[n]));
  }
  if (!any(thick))
    return;
  for (int n = 0; n < count; ++n) {
    const Floats y = larger(-x[n], all(-126.0F));
    const Ints whole = toInts(y - 0.5F);
    const Floats f = y - toFloats(whole);
    const Floats f2 = f * f;
    const Floats low = (1.0F + 0.69314718F * f) + f2 * (0.24022651F + 5.5504109e-2F * f);
    const Floats high = (9.6181291e-3F + 1.3333558e-3F * f) + 1.5403530e-4F * f2;
    const Ints scale = (whole + 127) << 23;
    Floats scaled;
    __builtin_memcpy(&scaled, &scale, sizeof(scaled));
    opacity[n] = select(x[n] < kThin, opacity[n], 1.0F - (low + (f2 * f2) * high) * scaled);
  }
}

// --- Filling polygons

SOFT_VOLUME_INLINE int ceilBetween(float x, int low, int high) {
  if (!(x > float(low)))
    return low;
  if (x >= float(high))
    return high;
  const int whole = int(x);
  return whole + int(float(whole) < x);
}

SOFT_VOLUME_INLINE Floats trilinearAt(const float* c, const Floats& u, const Floats& v, const Floats& w) {
  const Floats low = c[0] + u * c[1] + v * (c[2] + u * c[4]);
  const Floats high = c[3] + u * c[5] + v * (c[6] + u * c[7]);
  return low + w * high;
}

/// Notes which blocks of a row of the tile have samples in [begin, end).
SOFT_VOLUME_INLINE void markBlocks(const FillTarget& target, int row, int begin, int end) {
  if (row < 0 || row >= kTileHeight)
    return;
  const int first = begin > 0 ? begin / kPixelLanes : 0;
  const int last = end < kTileWidth ? end : kTileWidth;
  std::uint16_t* blocks = target.hits + row * (kTileWidth / kPixelLanes);
  for (int block = first; block * kPixelLanes < last; ++block)
    blocks[block] = std::uint16_t(blocks[block] | target.plane);
}

/// The pixels between two crossings of a row. Values are computed from the crossing, not from where the tile begins.
template <int attributes, bool trilinear>
SOFT_VOLUME_INLINE void fillSpan(const FillTarget& target, int y, const Crossing& left, const Crossing& right,
                                 const float* coefficients) {
  const int begin = ceilBetween(left.x, target.begin_x, target.end_x);
  const int end = ceilBetween(right.x, target.begin_x, target.end_x);
  if (begin >= end)
    return;
  const float per_pixel = 1.0F / (right.x - left.x);
  float slope[attributes];
  for (int n = 0; n < attributes; ++n)
    slope[n] = (right.value[n] - left.value[n]) * per_pixel;
  const std::size_t row = std::size_t(y - target.first_y) * kSampleStride;
  for (int x = begin; x < end; x += kPixelLanes) {
    const Floats way = (float(x) + lanes()) - left.x;
    Floats value[attributes];
    for (int n = 0; n < attributes; ++n)
      value[n] = left.value[n] + way * slope[n];
    if (trilinear)
      value[0] = trilinearAt(coefficients, value[0], value[attributes > 1 ? 1 : 0], value[attributes > 2 ? 2 : 0]);
    const std::size_t at = row + std::size_t(x - target.first_x);
    const Ints inside = lanes() < all(float(end - x));
    for (int n = 0; n < (trilinear ? 1 : attributes); ++n) {
      float* sample = target.sample[n] + at;
      store(sample, select(inside, value[n], load(sample)));
    }
  }
  if (target.hits != nullptr)
    markBlocks(target, y - target.first_y - kApron, begin - target.first_x - kPixelLanes,
               end - target.first_x - kPixelLanes);
}

SOFT_VOLUME_INLINE void sortCrossings(Crossing* crossings, int count) {
  for (int i = 1; i < count; ++i) {
    const Crossing crossing = crossings[i];
    int at = i;
    for (; at > 0 && crossings[at - 1].x > crossing.x; --at)
      crossings[at] = crossings[at - 1];
    crossings[at] = crossing;
  }
}

/// From its lower to its higher end, whichever polygon it belongs to.
template <int attributes>
SOFT_VOLUME_INLINE void crossRows(const FillCorner& from, const FillCorner& to, int begin_y, int end_y, int size,
                                  Crossing* crossings, std::uint16_t* counts) {
  const FillCorner& low = from.y < to.y ? from : to;
  const FillCorner& high = from.y < to.y ? to : from;
  const int begin = ceilBetween(low.y, begin_y, end_y);
  const int end = ceilBetween(high.y, begin_y, end_y);
  if (begin >= end)
    return;
  const float per_row = 1.0F / (high.y - low.y);
  const float slope_x = (high.x - low.x) * per_row;
  float slope[attributes];
  for (int n = 0; n < attributes; ++n)
    slope[n] = (high.value[n] - low.value[n]) * per_row;
  for (int y = begin; y < end; ++y) {
    const int row = y - begin_y;
    const float way = float(y) - low.y;
    Crossing& crossing = crossings[row * size + counts[row]++];
    crossing.x = low.x + way * slope_x;
    for (int n = 0; n < attributes; ++n)
      crossing.value[n] = low.value[n] + way * slope[n];
  }
}

template <int attributes, bool trilinear>
void fillPolygon(const FillTarget& target, const FillCorner* corners, int size, const float* coefficients,
                 Crossing* crossings) {
  float low = corners[0].y;
  float high = corners[0].y;
  for (int i = 1; i < size; ++i) {
    low = corners[i].y < low ? corners[i].y : low;
    high = corners[i].y > high ? corners[i].y : high;
  }
  const int begin = ceilBetween(low, target.begin_y, target.end_y);
  const int end = ceilBetween(high, target.begin_y, target.end_y);
  std::uint16_t counts[kSampleRows];
  for (int row = 0; row < end - begin; ++row)
    counts[row] = 0;
  for (int i = 0, before = size - 1; i < size; before = i++)
    crossRows<attributes>(corners[before], corners[i], begin, end, size, crossings, counts);
  for (int y = begin; y < end; ++y) {
    Crossing* row = crossings + (y - begin) * size;
    const int count = counts[y - begin];
    sortCrossings(row, count);
    for (int n = 0; n + 1 < count; n += 2)
      fillSpan<attributes, trilinear>(target, y, row[n], row[n + 1], coefficients);
  }
}

void fill(const FillTarget& target, const FillCorner* corners, int size, int attributes, const float* trilinear,
          Crossing* crossings) {
  if (trilinear != nullptr)
    return fillPolygon<3, true>(target, corners, size, trilinear, crossings);
  switch (attributes) {
    case 1:
      return fillPolygon<1, false>(target, corners, size, nullptr, crossings);
    case 2:
      return fillPolygon<2, false>(target, corners, size, nullptr, crossings);
    case 3:
      return fillPolygon<3, false>(target, corners, size, nullptr, crossings);
    case 4:
      return fillPolygon<4, false>(target, corners, size, nullptr, crossings);
    default:
      return fillPolygon<5, false>(target, corners, size, nullptr, crossings);
  }
}

// --- Compositing

/// Red, green, blue, absorption.
struct Entry {
  Floats c[4];
};

SOFT_VOLUME_INLINE Floats4 load4(const float* from) {
  Floats4 x;
  __builtin_memcpy(&x, from, sizeof(x));
  return x;
}

SOFT_VOLUME_INLINE Floats join(const Floats4& low, const Floats4& high) {
  return __builtin_shufflevector(low, high, 0, 1, 2, 3, 4, 5, 6, 7);
}

/// Eight entries of four floats, turned to four vectors.
SOFT_VOLUME_INLINE Entry lookUp(const float* table, const Ints& index) {
  const Ints place = index * 4;
  std::int32_t places[kPixelLanes];
  __builtin_memcpy(places, &place, sizeof(places));
  Floats rows[4];
  for (int n = 0; n < 4; ++n)
    rows[n] = join(load4(table + places[n]), load4(table + places[n + 4]));
  const Floats a = __builtin_shufflevector(rows[0], rows[1], 0, 8, 1, 9, 4, 12, 5, 13);
  const Floats b = __builtin_shufflevector(rows[2], rows[3], 0, 8, 1, 9, 4, 12, 5, 13);
  const Floats c = __builtin_shufflevector(rows[0], rows[1], 2, 10, 3, 11, 6, 14, 7, 15);
  const Floats d = __builtin_shufflevector(rows[2], rows[3], 2, 10, 3, 11, 6, 14, 7, 15);
  return {{__builtin_shufflevector(a, b, 0, 1, 8, 9, 4, 5, 12, 13),
           __builtin_shufflevector(a, b, 2, 3, 10, 11, 6, 7, 14, 15),
           __builtin_shufflevector(c, d, 0, 1, 8, 9, 4, 5, 12, 13),
           __builtin_shufflevector(c, d, 2, 3, 10, 11, 6, 7, 14, 15)}};
}

SOFT_VOLUME_INLINE Ints entryOf(const TableView& table, const Floats& value) {
  return toInts(clamp((value - table.first_value) * table.entries_per_value, 0.0F, float(table.size - 1)) + 0.5F);
}

/// Where in the volume: the texel before a place, and how far behind it the place lies.
struct Place {
  Ints x, y, z;
  Floats fx, fy, fz;
};

/// Clamped to the volume.
SOFT_VOLUME_INLINE Place placeOf(const TexelView& volume, const Floats* voxel) {
  const Floats x = clamp(voxel[0], 0.0F, float(volume.dims[0] - 1));
  const Floats y = clamp(voxel[1], 0.0F, float(volume.dims[1] - 1));
  const Floats z = clamp(voxel[2], 0.0F, float(volume.dims[2] - 1));
  Place place;
  place.x = toInts(smaller(x, all(float(volume.dims[0] - 2))));
  place.y = toInts(smaller(y, all(float(volume.dims[1] - 2))));
  place.z = toInts(smaller(z, all(float(volume.dims[2] - 2))));
  place.fx = x - toFloats(place.x);
  place.fy = y - toFloats(place.y);
  place.fz = z - toFloats(place.z);
  return place;
}

/// Two texels that follow each other, as loaded with one instruction where they have 16 bits.
SOFT_VOLUME_INLINE void splitPair(const std::int32_t* pairs, std::int16_t, Floats& first, Floats& second) {
  Ints both;
  __builtin_memcpy(&both, pairs, sizeof(both));
  first = toFloats((both << 16) >> 16);
  second = toFloats(both >> 16);
}
SOFT_VOLUME_INLINE void splitPair(const std::int32_t* pairs, std::uint16_t, Floats& first, Floats& second) {
  Ints both;
  __builtin_memcpy(&both, pairs, sizeof(both));
  first = toFloats(both & 0xFFFF);
  second = toFloats((both >> 16) & 0xFFFF);
}
SOFT_VOLUME_INLINE void splitPair(const std::int64_t* pairs, float, Floats& first, Floats& second) {
  float texels[2 * kPixelLanes];
  __builtin_memcpy(texels, pairs, sizeof(texels));
  for (int n = 0; n < kPixelLanes; ++n) {
    first[n] = texels[2 * n];
    second[n] = texels[2 * n + 1];
  }
}

/// The rows of two texels around each lane's place. Lanes that are not wanted get what was there.
template <typename Texel, typename Pair>
SOFT_VOLUME_INLINE void loadPairs(const TexelView& volume, const Place& place, int wanted,
                                  Pair (&pairs)[4][kPixelLanes]) {
  const Texel* texels = static_cast<const Texel*>(volume.texels);
  const UInts number =
      (UInts)place.x + (UInts)place.y * std::uint32_t(volume.row) + (UInts)place.z * std::uint32_t(volume.slice);
  std::uint32_t numbers[kPixelLanes];
  __builtin_memcpy(numbers, &number, sizeof(numbers));
  for (int n = 0; n < kPixelLanes; ++n) {
    if ((wanted >> n & 1) == 0)
      continue;
    const Texel* at = texels + std::size_t(numbers[n]);
    __builtin_memcpy(&pairs[0][n], at, sizeof(Pair));
    __builtin_memcpy(&pairs[1][n], at + volume.row, sizeof(Pair));
    __builtin_memcpy(&pairs[2][n], at + volume.slice, sizeof(Pair));
    __builtin_memcpy(&pairs[3][n], at + volume.slice + volume.row, sizeof(Pair));
  }
}

template <typename Texel, typename Pair>
SOFT_VOLUME_INLINE Floats trilinearTexels(const TexelView& volume, const Place& place, int wanted) {
  Pair pairs[4][kPixelLanes] = {};
  loadPairs<Texel>(volume, place, wanted, pairs);
  Floats row[4];
  for (int n = 0; n < 4; ++n) {
    Floats first;
    Floats second;
    splitPair(pairs[n], Texel(), first, second);
    row[n] = first + place.fx * (second - first);
  }
  const Floats front = row[0] + place.fy * (row[1] - row[0]);
  const Floats back = row[2] + place.fy * (row[3] - row[2]);
  return front + place.fz * (back - front);
}

/// The scalar at a place given in texels, clamped to the volume; lanes that are not wanted get anything.
SOFT_VOLUME_INLINE Floats fetchTexels(const TexelView& volume, const Floats* voxel, int wanted) {
  const Place place = placeOf(volume, voxel);
  if (volume.type == 0)
    return trilinearTexels<std::int16_t, std::int32_t>(volume, place, wanted);
  if (volume.type == 1)
    return trilinearTexels<std::uint16_t, std::int32_t>(volume, place, wanted);
  return trilinearTexels<float, std::int64_t>(volume, place, wanted);
}

/// In voxels.
SOFT_VOLUME_INLINE Floats pixelWidth(const TexelView& volume, const Floats& z) {
  return volume.pixel_width + z * volume.pixel_width_per_depth;
}

/// Of the mipmap: how many times a pixel has to be halved to be no wider than a voxel. The logarithm goes linearly from
/// one power of two to the next, as a float number's bits do.
SOFT_VOLUME_INLINE Floats levelOf(const TexelView& volume, const Floats& z) {
  const Floats width = pixelWidth(volume, z);
  Ints bits;
  __builtin_memcpy(&bits, &width, sizeof(bits));
  constexpr std::int32_t kBitsOfOne = 0x3F800000;
  return clamp(toFloats(bits - kBitsOfOne) * (1.0F / 8388608.0F), 0.0F, float(volume.coarser_levels));
}

/// From the two levels of the mipmap that fit best, in parts.
__attribute__((noinline)) void fetchMipmapped(const TexelView& volume, const Floats* voxel, const Floats& z, int wanted,
                                              Floats& value) {
  const Floats level = levelOf(volume, z);
  value = all(0.0F);
  for (int n = 0; n <= volume.coarser_levels; ++n) {
    const Floats part = 1.0F - larger(level - float(n), float(n) - level);
    const Ints takes = part > 0.0F;
    const int bits = bitsOf(takes) & wanted;
    if (bits == 0)
      continue;
    const TexelView& texels = n == 0 ? volume : volume.coarser[n - 1];
    Floats texel[3];
    for (int axis = 0; axis < 3; ++axis)
      texel[axis] = n == 0 ? voxel[axis] : voxel[axis] * texels.per_voxel[axis] + texels.offset[axis];
    const Floats scalar = bits == kAllLanes ? fetchTexels(texels, texel, kAllLanes) : fetchTexels(texels, texel, bits);
    value += select(takes, part * scalar, all(0.0F));
  }
}

/// The scalar at a place given in voxels, clamped to the volume, as pixels at depth z see it; lanes that are not wanted
/// get anything.
SOFT_VOLUME_INLINE Floats fetch(const TexelView& volume, const Floats* voxel, const Floats& z, int wanted) {
  if (volume.coarser_levels == 0)
    return fetchTexels(volume, voxel, wanted);
  Floats value;
  fetchMipmapped(volume, voxel, z, wanted, value);
  return value;
}

/// Lanes in or next to a brick that shows something, and those where pixels see the means of many bricks.
SOFT_VOLUME_INLINE Ints isVisible(const TexelView& volume, const Floats* voxel, float z, int wanted) {
  if (volume.visible == nullptr || (volume.coarser_levels > 0 && pixelWidth(volume, all(z))[0] > 1.0F))
    return allInts(-1);
  const Place place = placeOf(volume, voxel);
  const Ints brick = (place.x >> kBrickShift) + (place.y >> kBrickShift) * volume.brick_row +
                     (place.z >> kBrickShift) * volume.brick_slice;
  Ints visible{};
  for (int n = 0; n < kPixelLanes; ++n) {
    if ((wanted >> n & 1) != 0)
      visible[n] = volume.visible[brick[n]] != 0 ? -1 : 0;
  }
  return visible;
}

/// A sample of eight rays. Only what its kind needs is set.
struct Sample {
  Floats value;    ///< the scalar, or the absorption; NaN where there is none
  Floats more[3];  ///< where it lies, or what colour it has
  Ints entry;      ///< of the transfer function
  Entry sum;       ///< the transfer function's integral up to there
};

/// As the compiler copies a Sample with string instructions, which takes longer than all the rest of a plane.
template <SampleKind kind>
SOFT_VOLUME_INLINE void copySample(Sample& to, const Sample& from) {
  to.value = from.value;
  for (int n = 0; n < 3 && kind != SampleKind::kScalar; ++n)
    to.more[n] = from.more[n];
  if (kind == SampleKind::kColour)
    return;
  to.entry = from.entry;
  for (int n = 0; n < 4; ++n)
    to.sum.c[n] = from.sum.c[n];
}

/// The entries that were looked up last: where a grid is uniform they are the same again and again.
struct EntryCache {
  Ints index;
  Entry entry;
};

/// What the eight rays have gathered.
struct Rays {
  Floats colour[3];
  Floats opacity;
  Sample sample;  ///< value NaN where the ray is outside
  Floats z, back;
  Floats before;    ///< kScalar: the sample before; NaN where the ray has entered at the last plane
  Floats before_z;  ///< its depth, or where the slab begins that the ray has entered in
  Floats depth;
  Floats way_per_z;
  Floats slope_x, slope_y;
  Floats clip_front, clip_back;
  Floats moment;  ///< of what the segment at hand has added: opacity times twice the depth
  Floats along;   ///< change of the scalar per metre of depth before the last plane
  EntryCache cache;
  int pixel;  ///< in the tile
};

/// A stretch of eight rays between two samples.
struct Segment {
  Ints mask;
  Sample from, to;
  Floats front, back;  ///< depths
};

SOFT_VOLUME_INLINE Floats between(const Floats& a, const Floats& b, const Floats& t) {
  return a + t * (b - a);
}
/// Looks the scalar up; nothing to be done for colours.
template <SampleKind kind>
SOFT_VOLUME_INLINE void classify(const TableView& table, Sample& sample) {
  if (kind == SampleKind::kColour)
    return;
  sample.entry = entryOf(table, sample.value);
  sample.sum = lookUp(table.integrals, sample.entry);
}
template <SampleKind kind>
SOFT_VOLUME_INLINE void selectSample(const Ints& mask, const Sample& a, const Sample& b, Sample& s) {
  s.value = select(mask, a.value, b.value);
  for (int n = 0; n < 3 && kind != SampleKind::kScalar; ++n)
    s.more[n] = select(mask, a.more[n], b.more[n]);
  if (kind == SampleKind::kColour)
    return;
  s.entry = mask ? a.entry : b.entry;
  for (int n = 0; n < 4; ++n)
    s.sum.c[n] = select(mask, a.sum.c[n], b.sum.c[n]);
}
/// The sample of a volume is looked up anew, at depth z, those of grids go linearly from one to the other.
template <SampleKind kind>
SOFT_VOLUME_INLINE void sampleBetween(const CompositeJob& job, const Sample& a, const Sample& b, const Floats& t,
                                      const Floats& z, int wanted, Sample& s) {
  for (int n = 0; n < 3 && kind != SampleKind::kScalar; ++n)
    s.more[n] = between(a.more[n], b.more[n], t);
  if (kind == SampleKind::kTexture)
    s.value = fetch(job.volume, s.more, z, wanted);
  else
    s.value = between(a.value, b.value, t);
  classify<kind>(job.table, s);
}

/// The mean over the entries that lie between two (their difference of the integrals), or the entry itself. The colour
/// is multiplied by what `colour_scale` becomes.
struct Mean {
  Floats sum[4];
  Floats absorption;    ///< halvings per metre
  Floats colour_scale;  ///< colour n is sum[n] * colour_scale
};

SOFT_VOLUME_INLINE Mean meanBetween(const TableView& table, const Sample& from, const Sample& to, const Ints& mask,
                                    EntryCache& cache) {
  const Ints same = from.entry == to.entry;
  Mean mean;
  for (int n = 0; n < 4; ++n)
    mean.sum[n] = to.sum.c[n] - from.sum.c[n];
  const Floats count = select(same, all(1.0F), toFloats(to.entry - from.entry));
  if (any(same & mask)) {
    if (any(cache.index != to.entry)) {
      cache.index = to.entry;
      cache.entry = lookUp(table.entries, to.entry);
    }
    for (int n = 0; n < 3; ++n)
      mean.sum[n] = select(same, cache.entry.c[n] * cache.entry.c[3], mean.sum[n]);
    mean.sum[3] = select(same, cache.entry.c[3], mean.sum[3]);
  }
  // One division for both quotients; the sums and the count have the same sign.
  const Floats total = select(mean.sum[3] != 0.0F, mean.sum[3], all(1.0F));
  const Floats inverse = 1.0F / (total * count);
  mean.absorption = mean.sum[3] * inverse * total;
  mean.colour_scale = inverse * count;
  return mean;
}

/// Colour and absorption are linear: the mean of their product over the mean absorption.
SOFT_VOLUME_INLINE Mean meanOfColours(const Sample& from, const Sample& to) {
  Mean mean;
  mean.absorption = 0.5F * (from.value + to.value);
  mean.colour_scale = 1.0F / (6.0F * larger(mean.absorption, all(1e-30F)));
  const Floats of_from = 2.0F * from.value + to.value;
  const Floats of_to = from.value + 2.0F * to.value;
  for (int n = 0; n < 3; ++n)
    mean.sum[n] = of_from * from.more[n] + of_to * to.more[n];
  return mean;
}

template <SampleKind kind>
SOFT_VOLUME_INLINE Mean meanOf(const CompositeJob& job, const Segment& segment, EntryCache& cache) {
  return kind == SampleKind::kColour ? meanOfColours(segment.from, segment.to)
                                     : meanBetween(job.table, segment.from, segment.to, segment.mask, cache);
}

SOFT_VOLUME_INLINE void setDepth(const CompositeJob& job, const PixelState& state, Rays& rays, const Segment& segment,
                                 const Floats& before, const Floats& after, const Floats& halvings) {
  const int bits = bitsOf(segment.mask & (before < job.depth_threshold) & (after >= job.depth_threshold));
  if (bits == 0)
    return;
  for (int n = 0; n < kPixelLanes; ++n) {
    if ((bits >> n & 1) == 0)
      continue;
    float part = __builtin_log2f((1.0F - before[n]) / (1.0F - job.depth_threshold)) / halvings[n];
    part = part > 0.0F ? (part < 1.0F ? part : 1.0F) : 0.0F;
    rays.depth[n] = segment.front[n] + part * (segment.back[n] - segment.front[n]);
    if (state.label == nullptr || job.labels.labels == nullptr)
      continue;
    std::size_t index = 0;
    std::size_t stride = 1;
    for (int axis = 0; axis < 3; ++axis) {
      const float from = segment.from.more[axis][n];
      const float voxel = from + part * (segment.to.more[axis][n] - from);
      const float place = voxel * job.labels.per_voxel[axis] + job.labels.offset[axis] + 0.5F;
      const float highest = float(job.labels.dims[axis] - 1);
      index += stride * std::size_t(place > 0.0F ? (place < highest ? place : highest) : 0.0F);
      stride *= std::size_t(job.labels.dims[axis]);
    }
    state.label[rays.pixel + n] = job.labels.labels[index];
  }
}

/// Adds a stretch of one material to the rays: emission and absorption, front to back.
SOFT_VOLUME_INLINE void addMean(const CompositeJob& job, const PixelState& state, Rays& rays, const Segment& segment,
                                const Mean& mean, const Floats& halvings) {
  Floats opacity;
  opacitiesOf<1>(&halvings, &opacity);
  opacity = select(segment.mask, opacity, all(0.0F));
  const Floats share = (1.0F - rays.opacity) * opacity;
  for (int n = 0; n < 3; ++n)  // other lanes may hold NaN
    rays.colour[n] += select(segment.mask, share * mean.colour_scale * mean.sum[n], all(0.0F));
  rays.moment += select(segment.mask, share * (segment.front + segment.back), all(0.0F));
  const Floats after = rays.opacity + share;
  if (state.depth != nullptr || state.label != nullptr)
    setDepth(job, state, rays, segment, rays.opacity, after, halvings);
  rays.opacity = after;
}

SOFT_VOLUME_INLINE Floats halvingsOf(const Rays& rays, const Segment& segment, const Floats& absorption) {
  return absorption * (segment.back - segment.front) * rays.way_per_z;
}

/// A value that changes across many entries is integrated in parts, front to back, where the parts hide each other or,
/// for a volume, where the way between two places is too long to be taken as linear.
constexpr int kParts = 4;
constexpr int kHidingEntries = 8;
constexpr float kHidingHalvings = 0.4F;
/// Part of the table that a volume's scalar may cross between two samples.
constexpr int kTextureEntriesShare = 40;
constexpr float kPartedHalvings = 0.1F;

/// Whether a way adds something, or may after a closer look. That it does not is known without its mean where the
/// integral is the same at both ends, except for ways within one entry other than the transparent ends of the table.
SOFT_VOLUME_INLINE Ints mayAdd(const TableView& table, const Sample& from, const Sample& to) {
  const std::int32_t last = table.size - 1;
  const Ints first_ends = (to.entry == 0) & (table.entries[3] == 0.0F ? allInts(-1) : Ints{});
  const Ints last_ends = (to.entry == last) & (table.entries[std::size_t(last) * 4 + 3] == 0.0F ? allInts(-1) : Ints{});
  const Ints difference = to.entry - from.entry;
  const Ints crossed = difference < 0 ? -difference : difference;
  return (to.sum.c[3] != from.sum.c[3]) | ((difference == 0) & ~(first_ends | last_ends)) | (crossed > table.size / 4);
}

template <SampleKind kind>
__attribute__((noinline)) void addParts(const CompositeJob& job, const PixelState& state, Rays& rays,
                                        const Segment& segment) {
  Sample samples[kParts];
  Floats depths[kParts];
  for (int n = 0; n < kParts - 1; ++n) {
    const Floats t = all(float(n + 1) / float(kParts));
    depths[n] = between(segment.front, segment.back, t);
    sampleBetween<kind>(job, segment.from, segment.to, t, depths[n], kAllLanes, samples[n]);
  }
  copySample<kind>(samples[kParts - 1], segment.to);
  depths[kParts - 1] = segment.back;
  Segment part;
  for (int n = 0; n < kParts; ++n) {
    const Sample& from = n == 0 ? segment.from : samples[n - 1];
    part.mask = segment.mask & isNumber(samples[n].value) & isNumber(from.value);
    if (kind != SampleKind::kColour && !any(part.mask & mayAdd(job.table, from, samples[n])))
      continue;
    copySample<kind>(part.from, from);
    copySample<kind>(part.to, samples[n]);
    part.front = n == 0 ? segment.front : depths[n - 1];
    part.back = depths[n];
    const Mean mean = meanOf<kind>(job, part, rays.cache);
    if (any(part.mask & (mean.absorption > 0.0F)))
      addMean(job, state, rays, part, mean, halvingsOf(rays, part, mean.absorption));
  }
}

// Light.

struct Gradient {
  Floats x, y, z;
};

/// Central difference of two neighbours that may be missing.
SOFT_VOLUME_INLINE Floats difference(const Floats& low, const Floats& middle, const Floats& high) {
  const Ints has_low = isNumber(low);
  const Ints has_high = isNumber(high);
  const Floats both = 0.5F * (high - low);
  return select(has_low, select(has_high, both, middle - low), select(has_high, high - middle, all(0.0F)));
}

/// Change of the sample per pixel to the right and downwards in plane `plane`.
SOFT_VOLUME_INLINE void pixelDifferences(const float* sample, int at, Floats& right, Floats& down) {
  const Floats middle = load(sample + at);
  right = difference(load(sample + at - 1), middle, load(sample + at + 1));
  down = difference(load(sample + at - kSampleStride), middle, load(sample + at + kSampleStride));
}

/// From the gradient's parts across the ray and along it, per metre of depth.
SOFT_VOLUME_INLINE Gradient inCameraFrame(const Rays& rays, const Floats& x, const Floats& y, const Floats& along) {
  return {x, y, along - rays.slope_x * x - rays.slope_y * y};
}

/// Where a ray enters, nothing tells yet where it leads in the volume: across the two steps that lead across it.
SOFT_VOLUME_INLINE void fillAlong(const CompositeJob& job, float step, const Floats* right, const Floats* down,
                                  Floats* along) {
  const Ints unknown = (along[0] == 0.0F) & (along[1] == 0.0F) & (along[2] == 0.0F);
  if (!any(unknown))
    return;
  for (int axis = 0; axis < 3; ++axis) {
    const int next = (axis + 1) % 3;
    const int last = (axis + 2) % 3;
    const float scale = job.spacing[next] * job.spacing[last] / (job.spacing[axis] * step);
    const Floats across = (right[next] * down[last] - right[last] * down[next]) * scale;
    along[axis] = select(unknown, across, along[axis]);
  }
}

/// Gradient of a volume in the camera frame at part `t` of a segment: from four samples around it at the corners of a
/// tetrahedron, about normal_step away. Where steps across the ray lead in the volume is what the neighbouring pixels
/// of the plane tell, so the deformation is followed.
SOFT_VOLUME_INLINE Gradient textureGradient(const CompositeJob& job, const Rays& rays, const Segment& segment,
                                            int plane, int at, const Floats& t, int wanted) {
  const float width = job.volume.coarser_levels > 0 ? pixelWidth(job.volume, all(job.z[plane]))[0] : 1.0F;
  const float step = 0.6F * job.normal_step * (width > 1.0F ? width : 1.0F);
  const float step_x = step * (job.perspective ? job.pixel_x / job.z[plane] : job.pixel_x);
  const float step_y = step * (job.perspective ? job.pixel_y / job.z[plane] : job.pixel_y);
  const Floats step_z = step / (segment.back - segment.front);
  Floats right[3];
  Floats down[3];
  Floats along[3];
  for (int axis = 0; axis < 3; ++axis) {
    pixelDifferences(job.sample[axis] + std::size_t(plane) * kPlaneSamples, at, right[axis], down[axis]);
    right[axis] = right[axis] * step_x;
    down[axis] = down[axis] * step_y;
    along[axis] = (segment.to.more[axis] - segment.from.more[axis]) * step_z;
  }
  fillAlong(job, step, right, down, along);
  Floats corners[4][3];
  for (int axis = 0; axis < 3; ++axis) {
    const Floats centre = between(segment.from.more[axis], segment.to.more[axis], t);
    corners[0][axis] = centre + right[axis] + down[axis] + along[axis];
    corners[1][axis] = centre + right[axis] - down[axis] - along[axis];
    corners[2][axis] = centre - right[axis] + down[axis] - along[axis];
    corners[3][axis] = centre - right[axis] - down[axis] + along[axis];
  }
  Floats s[4];
  for (int n = 0; n < 4; ++n)
    s[n] = fetch(job.volume, corners[n], all(job.z[plane]), wanted);
  const float per_step = 0.25F / step;
  return inCameraFrame(rays, ((s[0] + s[1]) - (s[2] + s[3])) * per_step, ((s[0] + s[2]) - (s[1] + s[3])) * per_step,
                       ((s[0] + s[3]) - (s[1] + s[2])) * per_step);
}

/// Gradient of a grid's own scalar around the sample of plane `plane`: across the ray from what the neighbouring pixels
/// saw, along it from the sample before.
SOFT_VOLUME_INLINE Gradient scalarGradient(const CompositeJob& job, const Rays& rays, int plane, int at) {
  Floats right;
  Floats down;
  pixelDifferences(job.sample[0] + std::size_t(plane) * kPlaneSamples, at, right, down);
  const float scale_x = job.perspective ? job.pixel_x / job.z[plane] : job.pixel_x;
  const float scale_y = job.perspective ? job.pixel_y / job.z[plane] : job.pixel_y;
  return inCameraFrame(rays, right * scale_x, down * scale_y, rays.along);
}

/// How a surface is lit, for all colours alike.
struct Lighting {
  Floats brightness, highlight;
};

/// Light on the surface that the gradient makes, from either side; where the gradient is weak there is no surface, only
/// a mean brightness.
SOFT_VOLUME_INLINE Lighting lightOn(const CompositeJob& job, const Gradient& g) {
  const Floats square = g.x * g.x + g.y * g.y + g.z * g.z;
  const Ints usable = (square > 1e-30F) & (square < kHuge);
  const Floats length = squareRoot(select(usable, square, all(1.0F)));
  const Floats towards =
      select(usable, (g.x * job.light[0] + g.y * job.light[1] + g.z * job.light[2]) / length, all(0.0F));
  const Floats diffuse = select(towards < 0.0F, -towards, towards);
  Floats shine =
      select(usable, (g.x * job.half_way[0] + g.y * job.half_way[1] + g.z * job.half_way[2]) / length, all(0.0F));
  shine = shine * shine;  // from either side
  for (int n = 0; n < 4; ++n)
    shine = shine * shine;  // the 32nd power
  const Floats surface = select(usable, smaller(length * (job.normal_step * job.edge_scale), all(1.0F)), all(0.0F));
  const Floats lit = 0.7F + surface * (0.9F * diffuse - 0.5F);
  return {1.0F + job.shading * (lit - 1.0F), job.shading * job.specular * surface * shine};
}

/// Shortens a segment to what the clip planes leave of it.
template <SampleKind kind>
SOFT_VOLUME_INLINE void clipSegment(const CompositeJob& job, const Rays& rays, Segment& segment) {
  const Floats length = segment.back - segment.front;
  const Floats front = larger(segment.front, rays.clip_front);
  const Floats back = smaller(segment.back, rays.clip_back);
  segment.mask &= back > front;
  const int wanted = bitsOf(segment.mask & ((front > segment.front) | (back < segment.back)));
  if (wanted == 0)
    return;
  const Floats inverse = 1.0F / select(length > 0.0F, length, all(1.0F));
  Sample from;
  Sample to;
  sampleBetween<kind>(job, segment.from, segment.to, (front - segment.front) * inverse, front, wanted, from);
  sampleBetween<kind>(job, segment.from, segment.to, (back - segment.front) * inverse, back, wanted, to);
  selectSample<kind>(front > segment.front, from, segment.from, segment.from);
  selectSample<kind>(back < segment.back, to, segment.to, segment.to);
  segment.front = front;
  segment.back = back;
}

/// Where the integral has to be made in parts.
template <SampleKind kind>
SOFT_VOLUME_INLINE Ints needsParts(const CompositeJob& job, const Ints& from_entry, const Ints& to_entry,
                                   const Mean& mean, const Floats& halvings) {
  if (kind == SampleKind::kColour)
    return Ints{};
  const Ints difference = to_entry - from_entry;
  const Ints crossed = difference < 0 ? -difference : difference;
  if (kind == SampleKind::kScalar)
    return (crossed > kHidingEntries) & (halvings > kHidingHalvings);
  // A transparent mean may hide a peak between two samples of the volume, so it is looked at more closely as well.
  return ((crossed > job.table.size / kTextureEntriesShare) & (halvings > kPartedHalvings)) |
         ((crossed > job.table.size / 4) & (mean.absorption == 0.0F));
}

/// Where a ray leaves the grid, no plane is near whose samples would tell of a surface.
constexpr int kNoPlane = -1;

/// Integrates the transfer function over a segment into the rays. `plane` is the one that it ends at.
template <SampleKind kind>
SOFT_VOLUME_INLINE void addSegmentUnlit(const CompositeJob& job, const PixelState& state, Rays& rays,
                                        Segment& segment) {
  const Mean mean = meanOf<kind>(job, segment, rays.cache);
  const Floats halvings = halvingsOf(rays, segment, mean.absorption);
  const Ints mask = segment.mask;
  const Ints in_parts = needsParts<kind>(job, segment.from.entry, segment.to.entry, mean, halvings) & mask;
  segment.mask = mask & ~in_parts & (mean.absorption > 0.0F);
  if (any(segment.mask))
    addMean(job, state, rays, segment, mean, halvings);
  segment.mask = in_parts;
  if (any(in_parts))
    addParts<kind>(job, state, rays, segment);
  segment.mask = mask;
}

/// Lights what a segment has added to the rays, at the place where most of it lies: so the light does not depend on
/// where the planes cut a surface.
template <SampleKind kind>
SOFT_VOLUME_INLINE void lightSegment(const CompositeJob& job, Rays& rays, const Segment& segment, int plane, int at,
                                     const Floats* colour_before, const Floats& opacity_before) {
  const Floats share = rays.opacity - opacity_before;
  const Ints added = segment.mask & (share > 0.0F);
  const int wanted = bitsOf(added);
  if (wanted == 0)
    return;
  Gradient gradient = {Floats{}, Floats{}, Floats{}};
  if (plane != kNoPlane && kind == SampleKind::kTexture) {
    const Floats depth = 0.5F * rays.moment / select(added, share, all(1.0F));
    const Floats t = clamp((depth - segment.front) / (segment.back - segment.front), 0.0F, 1.0F);
    gradient = textureGradient(job, rays, segment, plane, at, t, wanted);
  } else if (plane != kNoPlane) {
    gradient = scalarGradient(job, rays, plane, at);
  }
  const Lighting lighting = lightOn(job, gradient);
  for (int n = 0; n < 3; ++n) {
    const Floats lit = (rays.colour[n] - colour_before[n]) * lighting.brightness + share * lighting.highlight;
    rays.colour[n] = select(added, colour_before[n] + smaller(lit, share), rays.colour[n]);
  }
}

template <SampleKind kind, bool shaded>
SOFT_VOLUME_INLINE void addSegment(const CompositeJob& job, const PixelState& state, Rays& rays, Segment& segment,
                                   int plane, int at) {
  segment.mask &= (rays.opacity < kOpaque) & (segment.back > segment.front);
  if (job.clips > 0)
    clipSegment<kind>(job, rays, segment);
  if (!any(segment.mask))
    return;
  rays.moment = all(0.0F);
  const Floats colour_before[3] = {rays.colour[0], rays.colour[1], rays.colour[2]};
  const Floats opacity_before = rays.opacity;
  addSegmentUnlit<kind>(job, state, rays, segment);
  if (shaded)
    lightSegment<kind>(job, rays, segment, plane, at, colour_before, opacity_before);
}

/// jitterAt() of light.h for eight pixels, from 0 on.
SOFT_VOLUME_INLINE Floats jitterOf(int x, int y) {
  Floats noise;
  for (int n = 0; n < kPixelLanes; ++n) {
    const std::uint32_t inner = std::uint32_t(x + n) * 288237660U + std::uint32_t(y) * 25070368U;
    const std::uint32_t outer = inner * 52U + (inner >> 16) * 64417U;
    noise[n] = float(outer >> 8) * (1.0F / 16777216.0F);
  }
  return noise;
}

/// Value of a sample that nobody needed yet: it lies where a volume shows nothing.
SOFT_VOLUME_INLINE Floats pending() {
  return all(__builtin_inff());
}

/// What the tile was filled with. The value of a volume's sample is pending.
template <SampleKind kind>
SOFT_VOLUME_INLINE Sample readSample(const CompositeJob& job, int plane, int at) {
  const std::size_t place = std::size_t(plane) * kPlaneSamples + std::size_t(at);
  Sample sample;
  const Floats first = load(job.sample[0] + place);
  if (kind == SampleKind::kScalar) {
    sample.value = first;
    return sample;
  }
  sample.more[0] = first;
  sample.more[1] = load(job.sample[1] + place);
  sample.more[2] = load(job.sample[2] + place);
  sample.value =
      kind == SampleKind::kColour ? load(job.sample[3] + place) : select(isNumber(first), pending(), nothing());
  sample.entry = Ints{};  // the entries of all lanes are looked up, also of those that are still pending
  return sample;
}

/// Gets the values of a volume's samples at depth z that are wanted and pending.
SOFT_VOLUME_INLINE void fetchPending(const CompositeJob& job, const Ints& wanted, const Floats& z, Sample& sample) {
  const Ints missing = wanted & (sample.value == pending());
  const int bits = bitsOf(missing);
  if (bits == 0)
    return;
  sample.value = select(missing, fetch(job.volume, sample.more, z, bits), sample.value);
  classify<SampleKind::kTexture>(job.table, sample);
}

/// Gets the values at both ends of the rays' way to a sample, where either end can be seen. False when none can be.
SOFT_VOLUME_INLINE bool fetchEnds(const CompositeJob& job, Rays& rays, const Ints& inside, float z, Sample& sample,
                                  Ints& in_sight) {
  const Ints alive = isNumber(sample.value) & (rays.opacity < kOpaque);
  in_sight = isVisible(job.volume, sample.more, z, bitsOf(alive));
  const Ints visible = alive & (in_sight | (inside & (rays.sample.value != pending())));
  if (!any(visible))
    return false;
  fetchPending(job, visible, all(z), sample);
  fetchPending(job, visible & inside, rays.z, rays.sample);
  return true;
}

/// The part of the rays that no clip plane cuts away.
SOFT_VOLUME_INLINE void clipRays(const CompositeJob& job, Rays& rays, int x, int y) {
  rays.clip_front = all(-kHuge);
  rays.clip_back = all(kHuge);
  const Floats across = job.perspective ? all(0.0F) : (float(x) + lanes() - job.cx) / job.pixel_x;
  const float below = job.perspective ? 0.0F : (float(y) - job.cy) / job.pixel_y;
  for (int n = 0; n < job.clips; ++n) {
    const float* plane = job.clip[n];
    // n . (across + slope_x z, below + slope_y z, z) <= offset
    const Floats rate = plane[0] * rays.slope_x + plane[1] * rays.slope_y + plane[2];
    const Floats rest = plane[3] - plane[0] * across - plane[1] * below;
    const Floats z = rest / rate;
    rays.clip_back = select(rate > 0.0F, smaller(rays.clip_back, z), rays.clip_back);
    rays.clip_front = select(rate < 0.0F, larger(rays.clip_front, z), rays.clip_front);
    rays.clip_back = select((rate == 0.0F) & (rest < 0.0F), all(-kHuge), rays.clip_back);
  }
}

/// Depth of the first event of the eight rays that is still to come.
SOFT_VOLUME_INLINE float nextEvent(const CompositeJob& job, const Rays& rays) {
  float first = kHuge;
  for (int n = 0; n < kPixelLanes && job.events.count > 0; ++n) {
    const std::size_t pixel = std::size_t(rays.pixel + n);
    const float z = job.events.z[std::size_t(job.events.next[pixel]) * kTilePixels + pixel];
    first = z < first ? z : first;
  }
  return first;
}

/// Takes the rays through the entries and exits before depth z.
template <SampleKind kind, bool shaded>
__attribute__((noinline)) std::size_t passEvents(const CompositeJob& job, const PixelState& state, Rays& rays,
                                                 float z) {
  const EventView& events = job.events;
  std::size_t segments = 0;
  for (;;) {
    Floats event_z;
    for (int n = 0; n < kPixelLanes; ++n)
      event_z[n] = events.z[std::size_t(events.next[rays.pixel + n]) * kTilePixels + std::size_t(rays.pixel + n)];
    const Ints reached = event_z <= all(z);
    const int bits = bitsOf(reached);
    if (bits == 0)
      return segments;
    Sample sample{};
    Ints entering{};
    for (int n = 0; n < kPixelLanes; ++n) {
      if ((bits >> n & 1) == 0)
        continue;
      const std::size_t place = std::size_t(events.next[rays.pixel + n]++) * kTilePixels + std::size_t(rays.pixel + n);
      entering[n] = events.entering[place] != 0 ? -1 : 0;
      if (kind == SampleKind::kScalar) {
        sample.value[n] = events.sample[0][place];
      } else {
        for (int axis = 0; axis < 3; ++axis)
          sample.more[axis][n] = events.sample[axis][place];
        if (kind == SampleKind::kColour)
          sample.value[n] = events.sample[3][place];
      }
    }
    if (kind == SampleKind::kTexture)
      sample.value = fetch(job.volume, sample.more, event_z, bits);
    classify<kind>(job.table, sample);
    Segment segment;
    segment.mask = reached & ~entering & isNumber(rays.sample.value);
    if (kind == SampleKind::kTexture)
      fetchPending(job, segment.mask, rays.z, rays.sample);
    copySample<kind>(segment.from, rays.sample);
    copySample<kind>(segment.to, sample);
    segment.front = kind == SampleKind::kScalar ? select(isNumber(rays.before), rays.z, rays.before_z) : rays.z;
    segment.back = event_z;
    segments += std::size_t(__builtin_popcount(unsigned(bitsOf(segment.mask))));
    addSegment<kind, shaded>(job, state, rays, segment, kNoPlane, 0);
    const Ints enters = reached & entering;
    selectSample<kind>(enters, sample, rays.sample, rays.sample);
    rays.sample.value = select(reached & ~entering, nothing(), rays.sample.value);
    rays.z = select(enters, event_z, rays.z);
    rays.back = select(enters, event_z, rays.back);
    rays.before = select(enters, sample.value, rays.before);
    rays.before_z = select(enters, event_z, rays.before_z);
  }
}

/// Where the ray shows something, its scalar goes on as it went from `before` to `last` for `part` of that way. Where
/// it shows nothing it stays: the cells behind may be there and have been left out.
SOFT_VOLUME_INLINE void extrapolate(const TableView& table, const Ints& wanted, const Floats& before,
                                    const Sample& last, const Floats& part, Sample& s) {
  const Ints shows = wanted & (lookUp(table.entries, last.entry).c[3] > 0.0F);
  s.value = select(shows, last.value + part * (last.value - before), last.value);
  classify<SampleKind::kScalar>(table, s);
}

/// A ray ends half a slab behind the last plane that hit.
template <SampleKind kind, bool shaded>
__attribute__((noinline)) void leave(const CompositeJob& job, const PixelState& state, Rays& rays,
                                     const Ints& leaving) {
  Segment segment;
  segment.mask = leaving & (rays.sample.value != pending());
  copySample<kind>(segment.from, rays.sample);
  copySample<kind>(segment.to, rays.sample);
  segment.front = rays.z;
  segment.back = rays.back;
  if (kind == SampleKind::kScalar) {
    const Ints passed = isNumber(rays.before);
    segment.front = select(passed, rays.z, rays.before_z);
    extrapolate(job.table, leaving & passed & (rays.z > rays.before_z), rays.before, rays.sample,
                (rays.back - rays.z) / (rays.z - rays.before_z), segment.to);
  }
  addSegment<kind, shaded>(job, state, rays, segment, kNoPlane, 0);
  rays.sample.value = select(leaving, nothing(), rays.sample.value);
}

/// Near a boundary face of a warped cell a slice may end on the other side of it: the slice's side is the straight line
/// between two edges, the face is triangles. There the face decides.
struct Disputed {
  Ints entered;  ///< a face says inside: what the plane lacks does not end the ray
  Ints left;     ///< a face says outside: what the plane has does not begin it
};

/// For a plane at depth z, whose events up to there have been passed. Where what overlaps or faces away makes entries
/// and exits follow each other in another order than in turn, a face counts for one distance of planes only.
SOFT_VOLUME_INLINE Disputed disputedAt(const CompositeJob& job, const Rays& rays, float z) {
  Disputed disputed{};
  const EventView& events = job.events;
  for (int n = 0; n < kPixelLanes; ++n) {
    const auto pixel = std::size_t(rays.pixel + n);
    const auto place = [&](int event) { return std::size_t(event) * kTilePixels + pixel; };
    const int next = events.next[pixel];
    const float last_z = next > 0 ? events.z[place(next - 1)] : -kHuge;
    const float next_z = events.z[place(next)];
    const bool is_near = next_z - z < job.distance;
    const bool was_near = z - last_z < job.distance;
    const bool entered = next > 0 && events.entering[place(next - 1)] != 0;
    const bool enters = next_z < kHuge && events.entering[place(next)] != 0;
    const bool no_plane_since = entered && rays.z[n] == last_z;
    disputed.entered[n] = no_plane_since || (is_near && !enters) ? -1 : 0;
    disputed.left[n] = (enters && !entered) || (was_near && !entered) || (is_near && enters) ? -1 : 0;
  }
  return disputed;
}

template <SampleKind kind, bool shaded>
__attribute__((noinline)) std::size_t passPlane(const CompositeJob& job, const PixelState& state, Rays& rays, int plane,
                                                int at, const Floats& jitter) {
  const bool extra = job.extra[plane] != 0;
  const Ints inside = isNumber(rays.sample.value);
  Sample sample = readSample<kind>(job, plane, at);
  Ints held{};
  if (job.events.count > 0 && any(inside ^ isNumber(sample.value))) {
    const Disputed disputed = disputedAt(job, rays, job.z[plane]);
    held = disputed.entered;
    sample.value = select(disputed.left & ~inside, nothing(), sample.value);
  }
  Ints in_sight;
  const bool seen = kind != SampleKind::kTexture || fetchEnds(job, rays, inside, job.z[plane], sample, in_sight);
  const Ints hit = isNumber(sample.value);
  const Ints leaving = inside & ~hit & ~held;
  if (!extra && any(leaving))
    leave<kind, shaded>(job, state, rays, leaving);
  const int hits = bitsOf(hit);
  if (hits == 0)
    return 0;
  if (!seen) {
    selectSample<kind>(hit, sample, rays.sample, rays.sample);
    rays.z = select(hit, all(job.z[plane]), rays.z);
    rays.back = select(hit, all(job.back[plane]), rays.back);
    return 0;
  }
  if (kind != SampleKind::kTexture)
    classify<kind>(job.table, sample);
  Segment segment;
  segment.mask = hit & (sample.value != pending());
  selectSample<kind>(inside, rays.sample, sample, segment.from);
  copySample<kind>(segment.to, sample);
  segment.front = select(inside, rays.z, all(job.front[plane]));
  segment.back = all(job.z[plane]);
  if (kind == SampleKind::kScalar) {
    // How the scalar goes through the slab that a ray enters in is known at the next plane only.
    segment.mask &= inside;
    const Ints entered = segment.mask & ~isNumber(rays.before);
    if (any(entered)) {
      segment.front = select(entered, rays.before_z, segment.front);
      extrapolate(job.table, entered, sample.value, rays.sample, (rays.z - rays.before_z) / (segment.back - rays.z),
                  segment.from);
    }
    rays.before = select(hit, select(inside, rays.sample.value, nothing()), rays.before);
    rays.before_z = select(hit, select(inside, rays.z, all(job.front[plane])), rays.before_z);
  }
  rays.along = select(inside & hit, (sample.value - rays.sample.value) / (job.z[plane] - rays.z), all(0.0F));
  if (job.jitter && !extra) {
    // The sample moves back towards the one before, its slab with it: all by the same part of the planes' distance.
    const Ints moves = segment.mask & inside;
    const Floats place = segment.back - (1.0F - jitter) * job.distance;
    const Floats t = clamp((place - segment.front) / (segment.back - segment.front), 0.0F, 1.0F);
    const Floats z = between(segment.front, segment.back, t);
    Sample moved;
    sampleBetween<kind>(job, segment.from, segment.to, t, z, bitsOf(moves), moved);
    selectSample<kind>(moves, moved, segment.to, segment.to);
    segment.back = select(moves, z, segment.back);
  }
  selectSample<kind>(hit, segment.to, rays.sample, rays.sample);
  rays.z = select(hit, segment.back, rays.z);
  rays.back = select(hit, all(job.back[plane]), rays.back);
  addSegment<kind, shaded>(job, state, rays, segment, plane, at);
  if (kind == SampleKind::kTexture)  // the way on from here may not need it again
    rays.sample.value = select(hit & ~in_sight, pending(), rays.sample.value);
  return std::size_t(__builtin_popcount(unsigned(hits)));
}

/// passPlane() for `count` planes where nothing special happens: all eight rays are inside before and behind each, and
/// nothing but the colours of scalars is asked for. Most planes of most pixels are of this kind. False, with nothing
/// done, for all others. Each step is done for all planes before the next one: the steps wait for each other, the
/// planes do not.
template <int count>
SOFT_VOLUME_INLINE bool passPlainPlanes(const CompositeJob& job, Rays& rays, int plane, int at) {
  Sample samples[count];
  Ints everywhere = isNumber(rays.sample.value) & isNumber(rays.before) & (rays.opacity < kOpaque);
  for (int n = 0; n < count; ++n) {
    samples[n].value = load(job.sample[0] + std::size_t(plane + n) * kPlaneSamples + std::size_t(at));
    everywhere &= isNumber(samples[n].value);
  }
  if (bitsOf(everywhere) != (1 << kPixelLanes) - 1)
    return false;
  for (int n = 0; n < count; ++n)
    classify<SampleKind::kScalar>(job.table, samples[n]);
  Mean means[count];
  Floats halvings[count];
  Ints hiding{};
  Ints absorbing{};
  for (int n = 0; n < count; ++n) {
    const Sample& before = n == 0 ? rays.sample : samples[n - 1];
    means[n] = meanBetween(job.table, before, samples[n], everywhere, rays.cache);
    const Floats front = n == 0 ? rays.z : all(job.z[plane + n - 1]);
    halvings[n] = means[n].absorption * (job.z[plane + n] - front) * rays.way_per_z;
    const Ints crossed = samples[n].entry - before.entry;
    hiding |= ((crossed > kHidingEntries) | (crossed < -kHidingEntries)) & (halvings[n] > kHidingHalvings);
    absorbing |= means[n].absorption > 0.0F;
  }
  if (any(hiding))
    return false;
  if (any(absorbing)) {
    Floats opacities[count];
    opacitiesOf<count>(halvings, opacities);
    for (int n = 0; n < count; ++n) {
      const Floats opacity = select(rays.opacity < kOpaque, opacities[n], all(0.0F));
      const Floats share = (1.0F - rays.opacity) * opacity;
      for (int c = 0; c < 3; ++c)
        rays.colour[c] += share * means[n].colour_scale * means[n].sum[c];
      rays.opacity += share;
    }
  }
  rays.before = count > 1 ? samples[count - 2].value : rays.sample.value;
  rays.before_z = count > 1 ? all(job.z[plane + count - 2]) : rays.z;
  copySample<SampleKind::kScalar>(rays.sample, samples[count - 1]);
  rays.z = all(job.z[plane + count - 1]);
  rays.back = all(job.back[plane + count - 1]);
  return true;
}

__attribute__((noinline)) void addPlainSegment(const CompositeJob& job, const PixelState& state, Rays& rays,
                                               const Sample& from, const Sample& to, int plane, bool first) {
  Segment segment;
  segment.mask = rays.opacity < kOpaque;
  copySample<SampleKind::kTexture>(segment.from, from);
  copySample<SampleKind::kTexture>(segment.to, to);
  segment.front = first ? rays.z : all(job.z[plane - 1]);
  segment.back = all(job.z[plane]);
  rays.moment = all(0.0F);
  addSegmentUnlit<SampleKind::kTexture>(job, state, rays, segment);
}

/// The ways from where the rays are to samples of the next planes.
template <int count>
SOFT_VOLUME_INLINE void addPlainSegments(const CompositeJob& job, const PixelState& state, Rays& rays,
                                         const Sample* samples, int plane) {
  const Ints alive = rays.opacity < kOpaque;
  Ints may_add{};
  for (int n = 0; n < count; ++n)
    may_add |= mayAdd(job.table, n == 0 ? rays.sample : samples[n - 1], samples[n]);
  if (!any(may_add & alive))
    return;
  Mean means[count];
  Floats halvings[count];
  Ints in_parts{};
  Ints absorbing{};
  for (int n = 0; n < count; ++n) {
    const Sample& before = n == 0 ? rays.sample : samples[n - 1];
    const Floats front = n == 0 ? rays.z : all(job.z[plane + n - 1]);
    means[n] = meanBetween(job.table, before, samples[n], alive, rays.cache);
    halvings[n] = means[n].absorption * (job.z[plane + n] - front) * rays.way_per_z;
    in_parts |= needsParts<SampleKind::kTexture>(job, before.entry, samples[n].entry, means[n], halvings[n]);
    absorbing |= means[n].absorption > 0.0F;
  }
  if (any(in_parts & alive)) {
    for (int n = 0; n < count; ++n)
      addPlainSegment(job, state, rays, n == 0 ? rays.sample : samples[n - 1], samples[n], plane + n, n == 0);
    return;
  }
  if (!any(absorbing & alive))
    return;
  Floats opacities[count];
  opacitiesOf<count>(halvings, opacities);
  for (int n = 0; n < count; ++n) {
    const Floats opacity = select(rays.opacity < kOpaque, opacities[n], all(0.0F));
    const Floats share = (1.0F - rays.opacity) * opacity;
    for (int c = 0; c < 3; ++c)
      rays.colour[c] += share * means[n].colour_scale * means[n].sum[c];
    rays.opacity += share;
  }
}

/// Whether one of eight places is in or next to a brick that shows something; see isVisible().
SOFT_VOLUME_INLINE bool isAnyVisible(const TexelView& volume, const Floats* voxel, float z) {
  if (volume.visible == nullptr || (volume.coarser_levels > 0 && pixelWidth(volume, all(z))[0] > 1.0F))
    return true;
  const Place place = placeOf(volume, voxel);
  const Ints brick = (place.x >> kBrickShift) + (place.y >> kBrickShift) * volume.brick_row +
                     (place.z >> kBrickShift) * volume.brick_slice;
  std::int32_t bricks[kPixelLanes];
  __builtin_memcpy(bricks, &brick, sizeof(bricks));
  unsigned visible = 0;
  for (int n = 0; n < kPixelLanes; ++n)
    visible |= volume.visible[bricks[n]];
  return visible != 0;
}

/// passPlane() for `count` planes of a volume where nothing special happens: all eight rays are inside before and
/// behind each, and nothing but the colours is asked for. Whether a way is looked at is decided for all eight rays
/// together. False, with nothing done, for other planes, and for two of which one alone is seen.
template <int count>
SOFT_VOLUME_INLINE bool passPlainTextures(const CompositeJob& job, const PixelState& state, Rays& rays, int plane,
                                          int at, std::size_t& segments) {
  Sample samples[count];
  Ints everywhere = isNumber(rays.sample.value);
  for (int n = 0; n < count; ++n) {
    for (int axis = 0; axis < 3; ++axis)
      samples[n].more[axis] = load(job.sample[axis] + std::size_t(plane + n) * kPlaneSamples + std::size_t(at));
    everywhere &= isNumber(samples[n].more[0]);
  }
  if (bitsOf(everywhere) != kAllLanes)
    return false;
  bool in_sight[count];
  int seen = 0;
  for (int n = 0; n < count; ++n) {
    in_sight[n] = isAnyVisible(job.volume, samples[n].more, job.z[plane + n]);
    seen += in_sight[n] || (n == 0 ? any(rays.sample.value != pending()) : in_sight[n - 1]);
  }
  if (seen != 0 && seen != count)
    return false;
  if (seen != 0) {
    fetchPending(job, everywhere, rays.z, rays.sample);
    for (int n = 0; n < count; ++n) {
      samples[n].value = fetch(job.volume, samples[n].more, all(job.z[plane + n]), kAllLanes);
      everywhere &= isNumber(samples[n].value);
    }
    if (bitsOf(everywhere) != kAllLanes)
      return false;
    for (int n = 0; n < count; ++n)
      classify<SampleKind::kTexture>(job.table, samples[n]);
    addPlainSegments<count>(job, state, rays, samples, plane);
    segments += count * kPixelLanes;
  }
  copySample<SampleKind::kTexture>(rays.sample, samples[count - 1]);
  if (!in_sight[count - 1])
    rays.sample.value = pending();
  rays.z = all(job.z[plane + count - 1]);
  rays.back = all(job.back[plane + count - 1]);
  return true;
}

SOFT_VOLUME_INLINE Rays loadRays(const CompositeJob& job, const PixelState& state, int x, int y) {
  Rays rays;
  rays.pixel = (y - job.tile_y) * kTileWidth + (x - job.tile_x);
  rays.along = all(0.0F);
  rays.cache.index = allInts(-1);
  for (int n = 0; n < 3; ++n)
    rays.colour[n] = load(state.colour[n] + rays.pixel);
  rays.opacity = load(state.opacity + rays.pixel);
  rays.before = Floats{};
  rays.before_z = Floats{};
  if (job.kind == SampleKind::kScalar) {
    rays.sample.value = load(state.sample[0] + rays.pixel);
    rays.before = load(state.sample[1] + rays.pixel);
    rays.before_z = load(state.sample[2] + rays.pixel);
  } else {
    for (int n = 0; n < 3; ++n)
      rays.sample.more[n] = load(state.sample[n] + rays.pixel);
    rays.sample.value = load(state.sample[3] + rays.pixel);
  }
  rays.z = load(state.sample_z + rays.pixel);
  rays.back = load(state.sample_back + rays.pixel);
  rays.depth = state.depth != nullptr ? load(state.depth + rays.pixel) : Floats{};
  rays.slope_x = (float(x) + lanes() - job.cx) * job.slope_x;
  rays.slope_y = all((float(y) - job.cy) * job.slope_y);
  rays.way_per_z = squareRoot(1.0F + rays.slope_x * rays.slope_x + rays.slope_y * rays.slope_y);
  if (job.clips > 0)
    clipRays(job, rays, x, y);
  return rays;
}

SOFT_VOLUME_INLINE void storeRays(const CompositeJob& job, const PixelState& state, const Rays& rays) {
  for (int n = 0; n < 3; ++n)
    store(state.colour[n] + rays.pixel, rays.colour[n]);
  store(state.opacity + rays.pixel, rays.opacity);
  if (job.kind == SampleKind::kScalar) {
    store(state.sample[0] + rays.pixel, rays.sample.value);
    store(state.sample[1] + rays.pixel, rays.before);
    store(state.sample[2] + rays.pixel, rays.before_z);
  } else {
    for (int n = 0; n < 3; ++n)
      store(state.sample[n] + rays.pixel, rays.sample.more[n]);
    store(state.sample[3] + rays.pixel, rays.sample.value);
  }
  store(state.sample_z + rays.pixel, rays.z);
  store(state.sample_back + rays.pixel, rays.back);
  if (state.depth != nullptr)
    store(state.depth + rays.pixel, rays.depth);
}

template <SampleKind kind, bool shaded>
SOFT_VOLUME_INLINE std::size_t compositeBlock(const CompositeJob& job, const PixelState& state, int x, int y) {
  const int block = ((y - job.tile_y) * kTileWidth + (x - job.tile_x)) / kPixelLanes;
  const unsigned hits = job.hits[block];
  if (state.block[block] == kBlockOpaque || (hits == 0 && state.block[block] == kBlockOutside && job.events.count == 0))
    return 0;
  Rays rays = loadRays(job, state, x, y);
  classify<kind>(job.table, rays.sample);
  const int at = (y - job.tile_y + kApron) * kSampleStride + (x - job.tile_x + kPixelLanes);
  const Floats jitter = job.jitter ? jitterOf(x, y) : Floats{};
  std::size_t segments = 0;
  const bool plain = kind != SampleKind::kColour && !shaded && state.depth == nullptr && state.label == nullptr &&
                     job.clips == 0 && !job.jitter;
  float next_event_z = nextEvent(job, rays);
  bool is_inside = state.block[block] != kBlockOutside;
  for (int plane = 0; plane < job.planes; ++plane) {
    if (next_event_z <= job.z[plane]) {
      segments += passEvents<kind, shaded>(job, state, rays, job.z[plane]);
      next_event_z = nextEvent(job, rays);
      is_inside = true;
    }
    if ((hits >> plane & 1) == 0) {
      if (is_inside && job.extra[plane] == 0) {
        Ints leaving = isNumber(rays.sample.value);
        if (job.events.count > 0)
          leaving &= ~disputedAt(job, rays, job.z[plane]).entered;
        leave<kind, shaded>(job, state, rays, leaving);
        is_inside = any(isNumber(rays.sample.value));
      }
      continue;
    }
    is_inside = true;
    if (plain && kind == SampleKind::kTexture) {
      const bool two = (hits >> plane & 3) == 3 && next_event_z > job.z[plane + 1];
      if (two && passPlainTextures<2>(job, state, rays, plane, at, segments)) {
        ++plane;
        if (!any(rays.opacity < kOpaque))
          break;
        continue;
      }
      if (passPlainTextures<1>(job, state, rays, plane, at, segments))
        continue;
    }
    if (plain && kind == SampleKind::kScalar) {
      const bool two = (hits >> plane & 3) == 3 && next_event_z > job.z[plane + 1];
      if (two && passPlainPlanes<2>(job, rays, plane, at)) {
        segments += 2 * kPixelLanes;
        ++plane;
        continue;
      }
      if (passPlainPlanes<1>(job, rays, plane, at)) {
        segments += kPixelLanes;
        continue;
      }
    }
    segments += passPlane<kind, shaded>(job, state, rays, plane, at, jitter);
    if ((plane & 3) == 3 && !any(rays.opacity < kOpaque))
      break;
  }
  if (job.last) {
    if (job.events.count > 0)
      segments += passEvents<kind, shaded>(job, state, rays, kHuge);
    leave<kind, shaded>(job, state, rays, isNumber(rays.sample.value));
  }
  state.block[block] = !any(rays.opacity < kOpaque)       ? kBlockOpaque
                       : any(isNumber(rays.sample.value)) ? kBlockInside
                                                          : kBlockOutside;
  storeRays(job, state, rays);
  return segments;
}

/// One slice by itself: the transfer function's colours without transparency.
SOFT_VOLUME_INLINE std::size_t showBlock(const CompositeJob& job, const PixelState& state, int x, int y) {
  const int at = (y - job.tile_y + kApron) * kSampleStride + (x - job.tile_x + kPixelLanes);
  const int pixel = (y - job.tile_y) * kTileWidth + (x - job.tile_x);
  for (int plane = 0; plane < job.planes; ++plane) {
    if ((job.hits[pixel / kPixelLanes] >> plane & 1) == 0)
      continue;
    Sample sample{};
    Entry entry{};
    if (job.kind == SampleKind::kColour) {
      sample = readSample<SampleKind::kColour>(job, plane, at);
      for (int n = 0; n < 3; ++n)
        entry.c[n] = sample.more[n];
    } else {
      sample = job.kind == SampleKind::kScalar ? readSample<SampleKind::kScalar>(job, plane, at)
                                               : readSample<SampleKind::kTexture>(job, plane, at);
      if (job.kind == SampleKind::kTexture)
        fetchPending(job, isNumber(sample.value), all(job.z[plane]), sample);
      entry = lookUp(job.table.entries, entryOf(job.table, sample.value));
    }
    const Ints hit = isNumber(sample.value);
    for (int n = 0; n < 3; ++n)
      store(state.colour[n] + pixel, select(hit, entry.c[n], load(state.colour[n] + pixel)));
    store(state.opacity + pixel, select(hit, all(1.0F), load(state.opacity + pixel)));
    if (state.depth != nullptr)
      store(state.depth + pixel, select(hit, all(job.z[plane]), load(state.depth + pixel)));
  }
  return 0;
}

template <SampleKind kind, bool shaded>
std::size_t compositeTile(const CompositeJob& job, const PixelState& state) {
  std::size_t segments = 0;
  for (int y = job.begin_y; y < job.end_y; ++y) {
    for (int x = job.begin_x & -kPixelLanes; x < job.end_x; x += kPixelLanes)
      segments += job.cross_section ? showBlock(job, state, x, y) : compositeBlock<kind, shaded>(job, state, x, y);
  }
  return segments;
}

std::size_t composite(const CompositeJob& job, const PixelState& state) {
  if (job.kind == SampleKind::kColour)
    return compositeTile<SampleKind::kColour, false>(job, state);
  const bool shaded = job.shading > 0.0F;
  if (job.kind == SampleKind::kScalar)
    return shaded ? compositeTile<SampleKind::kScalar, true>(job, state)
                  : compositeTile<SampleKind::kScalar, false>(job, state);
  return shaded ? compositeTile<SampleKind::kTexture, true>(job, state)
                : compositeTile<SampleKind::kTexture, false>(job, state);
}

constexpr NativeKernel kNativeKernel = {fill, composite};

}  // namespace
}  // namespace SOFT_VOLUME_KERNEL_SPACE
}  // namespace soft_volume::core
