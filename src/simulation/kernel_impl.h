// The kernels, compiled once for every instruction set: SOFT_VOLUME_KERNEL_SPACE names the namespace. Nothing here may
// use an inline function of another header: the linker would keep one copy of it, perhaps the one with instructions
// that the processor lacks.

#include "kernel.h"

#if defined(__SSE2__)
#include <immintrin.h>
#endif

namespace soft_volume::core {
namespace SOFT_VOLUME_KERNEL_SPACE {
namespace {

#define SOFT_VOLUME_INLINE static inline __attribute__((always_inline))

template <typename Real>
struct PackOf;
template <>
struct PackOf<float> {
  typedef float Type __attribute__((vector_size(32)));
};
template <>
struct PackOf<double> {
  typedef double Type __attribute__((vector_size(32)));
};
template <typename Real>
using Pack = typename PackOf<Real>::Type;

template <typename Real>
SOFT_VOLUME_INLINE Pack<Real> load(const Real* from) {
  Pack<Real> pack;
  __builtin_memcpy(&pack, from, sizeof(pack));
  return pack;
}

template <typename Real>
SOFT_VOLUME_INLINE void store(Real* to, const Pack<Real>& pack) {
  __builtin_memcpy(to, &pack, sizeof(pack));
}

template <typename Real>
SOFT_VOLUME_INLINE Pack<Real> gather(const Real* from, const std::uint32_t* index) {
  Pack<Real> pack;
  for (std::size_t n = 0; n < kLanes<Real>; ++n)
    pack[n] = from[index[n]];
  return pack;
}

template <typename Real>
SOFT_VOLUME_INLINE Pack<Real> all(Real value) {
  return value - Pack<Real>{};
}

#if defined(__AVX__)
SOFT_VOLUME_INLINE Pack<float> squareRoot(const Pack<float>& x) {
  return (Pack<float>)_mm256_sqrt_ps((__m256)x);
}
SOFT_VOLUME_INLINE Pack<double> squareRoot(const Pack<double>& x) {
  return (Pack<double>)_mm256_sqrt_pd((__m256d)x);
}
#elif defined(__SSE2__)
SOFT_VOLUME_INLINE Pack<float> squareRoot(const Pack<float>& x) {
  __m128 halves[2];
  __builtin_memcpy(halves, &x, sizeof(x));
  halves[0] = _mm_sqrt_ps(halves[0]);
  halves[1] = _mm_sqrt_ps(halves[1]);
  return load<float>(reinterpret_cast<const float*>(halves));
}
SOFT_VOLUME_INLINE Pack<double> squareRoot(const Pack<double>& x) {
  __m128d halves[2];
  __builtin_memcpy(halves, &x, sizeof(x));
  halves[0] = _mm_sqrt_pd(halves[0]);
  halves[1] = _mm_sqrt_pd(halves[1]);
  return load<double>(reinterpret_cast<const double*>(halves));
}
#else
SOFT_VOLUME_INLINE Pack<float> squareRoot(Pack<float> x) {
  for (std::size_t n = 0; n < kLanes<float>; ++n)
    x[n] = __builtin_sqrtf(x[n]);
  return x;
}
SOFT_VOLUME_INLINE Pack<double> squareRoot(Pack<double> x) {
  for (std::size_t n = 0; n < kLanes<double>; ++n)
    x[n] = __builtin_sqrt(x[n]);
  return x;
}
#endif

template <typename Real>
struct Pack3 {
  Pack<Real> x, y, z;
};

template <typename Real>
SOFT_VOLUME_INLINE Pack3<Real> operator+(const Pack3<Real>& a, const Pack3<Real>& b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template <typename Real>
SOFT_VOLUME_INLINE Pack3<Real> operator-(const Pack3<Real>& a, const Pack3<Real>& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template <typename Real>
SOFT_VOLUME_INLINE Pack3<Real> times(const Pack<Real>& s, const Pack3<Real>& a) {
  return {s * a.x, s * a.y, s * a.z};
}
template <typename Real>
SOFT_VOLUME_INLINE Pack<Real> dot(const Pack3<Real>& a, const Pack3<Real>& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
template <typename Real>
SOFT_VOLUME_INLINE Pack3<Real> cross(const Pack3<Real>& a, const Pack3<Real>& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
template <typename Real>
SOFT_VOLUME_INLINE Pack<Real> larger(const Pack<Real>& a, const Pack<Real>& b) {
  return a > b ? a : b;
}
template <typename Real>
SOFT_VOLUME_INLINE Pack<Real> smaller(const Pack<Real>& a, const Pack<Real>& b) {
  return a < b ? a : b;
}

template <typename Real>
SOFT_VOLUME_INLINE Pack3<Real> load3(const Real* const from[3], std::size_t at) {
  return {load(from[0] + at), load(from[1] + at), load(from[2] + at)};
}
template <typename Real>
SOFT_VOLUME_INLINE Pack3<Real> load3(Real* const from[3], std::size_t at) {
  return {load<Real>(from[0] + at), load<Real>(from[1] + at), load<Real>(from[2] + at)};
}
template <typename Real>
SOFT_VOLUME_INLINE void store3(Real* const to[3], std::size_t at, const Pack3<Real>& pack) {
  store<Real>(to[0] + at, pack.x);
  store<Real>(to[1] + at, pack.y);
  store<Real>(to[2] + at, pack.z);
}

/// Values of the neighbours that a spring entry names.
template <typename Real>
SOFT_VOLUME_INLINE Pack3<Real> neighbours(const KernelView<Real>& view, const SpringEntry& entry,
                                          const Real* const from[3]) {
  if (entry.contiguous)
    return load3<Real>(from, entry.index);
  const std::uint32_t* index = view.indices + entry.index;
  return {gather(from[0], index), gather(from[1], index), gather(from[2], index)};
}

template <typename Real>
SOFT_VOLUME_INLINE Pack<Real> stiffnessOf(const KernelView<Real>& view, const SpringEntry& entry) {
  return entry.uniform ? all(view.stiffness[entry.stiffness]) : load(view.stiffness + entry.stiffness);
}

template <typename Real>
SOFT_VOLUME_INLINE Pack3<Real> broadcast(const Real (&v)[3]) {
  return {all(v[0]), all(v[1]), all(v[2])};
}

// --- forces

template <typename Real>
SOFT_VOLUME_INLINE void addVolumeForces(const KernelView<Real>& view, std::uint32_t block, Pack3<Real>& force) {
  const std::size_t at = block * kLanes<Real>;
  for (int c = 0; c < 8; ++c) {
    const std::uint32_t* index = view.cell_of + c * view.vertex_stride + at;
    const Real* values = view.corner_force + 3 * c * kLanes<Real>;
    force.x += gather(values, index);
    force.y += gather(values + kLanes<Real>, index);
    force.z += gather(values + 2 * kLanes<Real>, index);
  }
  if (view.more_begin == nullptr)
    return;
  for (std::uint32_t row = view.more_begin[block]; row < view.more_begin[block + 1]; ++row) {
    const std::uint32_t* index = view.more_cells + row * kLanes<Real>;
    force.x += gather(view.corner_force, index);
    force.y += gather(view.corner_force + kLanes<Real>, index);
    force.z += gather(view.corner_force + 2 * kLanes<Real>, index);
  }
}

template <typename Real>
void forces(const KernelView<Real>& view, const std::uint32_t* blocks, std::size_t begin, std::size_t end) {
  const Pack<Real> tiny = all(Real(1e-30));
  const Pack<Real> huge = all(Real(1e30));
  const Pack3<Real> gravity = broadcast(view.gravity);
  for (std::size_t n = begin; n < end; ++n) {
    const std::uint32_t block = blocks[n];
    const std::size_t at = block * kLanes<Real>;
    const Pack3<Real> own = load3<Real>(view.displacement, at);
    Pack3<Real> force = load3<Real>(view.external, at) + times<Real>(load(view.mass + at), gravity);
    Pack<Real> nearest = huge;
    for (std::uint32_t e = view.entry_begin[block]; e < view.entry_begin[block + 1]; ++e) {
      const SpringEntry& entry = view.entries[e];
      const Pack<Real> k = stiffnessOf<Real>(view, entry);
      const Pack3<Real> rest = broadcast(view.offset[entry.direction]);
      const Pack3<Real> apart = neighbours<Real>(view, entry, view.displacement) - own;
      const Pack3<Real> d = rest + apart;
      const Pack<Real> squared = larger<Real>(dot(d, d), tiny);
      const Pack<Real> length = squareRoot(squared);
      // length^2 - rest^2 from the displacements alone: nothing cancels, so float loses no digits near rest.
      Pack<Real> difference = dot(apart, d + rest);
      Pack<Real> rest_length = all(view.length[entry.direction]);
      if (entry.stretched != SpringEntry::kUnstretched) {
        rest_length = load(view.stretched + entry.stretched);
        difference += load(view.stretched + entry.stretched + kLanes<Real>);
      }
      force = force + times<Real>(k, times<Real>(difference / (length * (length + rest_length)), d) +
                                         times<Real>(all(view.linear[entry.direction]), apart));
      if (entry.edge || view.nearest_of_all)
        nearest = smaller<Real>(nearest, k > Real(0) ? squared : huge);
    }
    if (view.corner_force != nullptr)
      addVolumeForces(view, block, force);
    store3<Real>(view.force, at, force);
    store<Real>(view.nearest_squared + at, nearest);
  }
}

template <typename Real>
void stiffnessProduct(const KernelView<Real>& view, const Real* const direction[3], Real* const product[3],
                      const std::uint32_t* blocks, std::size_t begin, std::size_t end) {
  const Pack<Real> tiny = all(Real(1e-30));
  const Pack<Real> zero = all(Real(0));
  for (std::size_t n = begin; n < end; ++n) {
    const std::uint32_t block = blocks[n];
    const std::size_t at = block * kLanes<Real>;
    const Pack3<Real> own = load3<Real>(view.displacement, at);
    const Pack3<Real> own_direction = load3<Real>(direction, at);
    Pack3<Real> sum = {zero, zero, zero};
    for (std::uint32_t e = view.entry_begin[block]; e < view.entry_begin[block + 1]; ++e) {
      const SpringEntry& entry = view.entries[e];
      const Pack<Real> k = stiffnessOf<Real>(view, entry);
      const Pack3<Real> d =
          broadcast(view.offset[entry.direction]) + neighbours<Real>(view, entry, view.displacement) - own;
      const Pack3<Real> q = own_direction - neighbours<Real>(view, entry, direction);
      const Pack<Real> squared = larger<Real>(dot(d, d), tiny);
      const Pack<Real> length = squareRoot(squared);
      Pack<Real> rest_length = all(view.length[entry.direction]);
      if (entry.stretched != SpringEntry::kUnstretched)
        rest_length = load(view.stretched + entry.stretched);
      // Compressed springs would make the matrix indefinite across their direction; their part there is left out.
      const Pack<Real> across = larger<Real>(all(Real(1)) - rest_length / length, zero);
      const Pack<Real> along = (all(Real(1)) - across) * dot(d, q) / squared;
      sum = sum + times<Real>(k, times<Real>(across + all(view.linear[entry.direction]), q) + times<Real>(along, d));
    }
    store3<Real>(product, at, sum);
  }
}

// --- moves

template <typename Real>
void advance(const KernelView<Real>& view, const AdvanceRule<Real>& rule, const std::uint32_t* blocks,
             std::size_t begin, std::size_t end, std::uint64_t* limited) {
  const Pack<Real> dt = all(rule.dt);
  const Pack<Real> one = all(Real(1));
  const Pack<Real> zero = all(Real(0));
  const Pack<Real> tiny = all(Real(1e-30));
  for (std::size_t n = begin; n < end; ++n) {
    const std::size_t at = blocks[n] * kLanes<Real>;
    const Pack<Real> inverse_mass = load(view.inverse_mass + at);
    const Pack3<Real> acceleration = times<Real>(inverse_mass, load3<Real>(view.force, at));
    // Damping is taken implicitly: it can only take energy out, whatever its rate.
    const Pack<Real> kept = rule.damped ? one / (one + dt * load(view.damping_rate + at)) : one;
    Pack3<Real> velocity = times<Real>(kept, load3<Real>(view.velocity, at) + times<Real>(dt, acceleration));
    Pack3<Real> move = times<Real>(dt, velocity) + times<Real>(all(rule.half_dt_squared), acceleration);
    Pack<Real> squared = dot(move, move);
    if (rule.limits) {
      const Pack<Real> nearest = squareRoot(load(view.nearest_squared + at));
      const Pack<Real> apart = larger<Real>((nearest - all(rule.epsilon)) * all(Real(0.5)), zero);
      const Pack<Real> longest =
          smaller<Real>(smaller<Real>(all(rule.nearest_fraction) * nearest, apart), all(rule.largest_move));
      const auto over = squared > longest * longest;
      const Pack<Real> scale = over ? longest / squareRoot(larger<Real>(squared, tiny)) : one;
      move = times<Real>(scale, move);
      squared = over ? dot(move, move) : squared;
      if (rule.consistent) {
        const Pack<Real> inverse_dt = one / dt;
        velocity.x = over ? move.x * inverse_dt : velocity.x;
        velocity.y = over ? move.y * inverse_dt : velocity.y;
        velocity.z = over ? move.z * inverse_dt : velocity.z;
      }
      for (std::size_t lane = 0; lane < kLanes<Real>; ++lane)
        *limited += over[lane] ? 1 : 0;
    }
    store3<Real>(view.velocity, at, velocity);
    store3<Real>(view.move, at, move);
    store<Real>(view.move_squared + at, squared);
  }
}

template <typename Real>
void apply(const KernelView<Real>& view, const std::uint32_t* blocks, std::size_t begin, std::size_t end) {
  for (std::size_t n = begin; n < end; ++n) {
    const std::size_t at = blocks[n] * kLanes<Real>;
    store3<Real>(view.displacement, at, load3<Real>(view.displacement, at) + load3<Real>(view.move, at));
  }
}

// --- cells

/// Corner neighbours along x, y and z, and whether the three edges taken in this order are right-handed.
constexpr int kCornerEdges[8][3] = {{1, 3, 4}, {0, 2, 5}, {3, 1, 6}, {2, 0, 7},
                                    {5, 7, 0}, {4, 6, 1}, {7, 5, 2}, {6, 4, 3}};
constexpr int kCornerSigns[8][3] = {{1, 1, 1},  {-1, 1, 1},  {-1, -1, 1},  {1, -1, 1},
                                    {1, 1, -1}, {-1, 1, -1}, {-1, -1, -1}, {1, -1, -1}};

template <typename Real>
SOFT_VOLUME_INLINE Pack3<Real> corner(const KernelView<Real>& view, std::size_t at, bool contiguous, int c,
                                      const Real* const from[3]) {
  const std::uint32_t* index = view.corners + c * view.cell_stride + at;
  if (contiguous)
    return load3<Real>(from, index[0]);
  return {gather(from[0], index), gather(from[1], index), gather(from[2], index)};
}

/// What displacements add to the edge of a corner along an axis, pointing along the positive axis at rest.
template <typename Real>
SOFT_VOLUME_INLINE Pack3<Real> edgeChange(const Pack3<Real> (&p)[8], int c, int axis) {
  const bool forward = kCornerSigns[c][axis] > 0;
  const Pack3<Real>& from = forward ? p[c] : p[kCornerEdges[c][axis]];
  const Pack3<Real>& to = forward ? p[kCornerEdges[c][axis]] : p[c];
  return to - from;
}

template <typename Real>
SOFT_VOLUME_INLINE Pack3<Real> cornerEdge(const KernelView<Real>& view, const Pack3<Real> (&p)[8], int c, int axis) {
  Pack3<Real> edge = edgeChange<Real>(p, c, axis);
  (axis == 0 ? edge.x : axis == 1 ? edge.y : edge.z) += view.spacing[axis];
  return edge;
}

/// Least width of the eight corner tetrahedra; negative where one is inverted.
template <typename Real>
SOFT_VOLUME_INLINE Pack<Real> cellWidth(const KernelView<Real>& view, const Pack3<Real> (&p)[8]) {
  const Pack<Real> tiny = all(Real(1e-30));
  Pack<Real> least = all(Real(1e30));
  for (int c = 0; c < 8; ++c) {
    // Edges along the axes, signs left in: mirrored corners then have mirrored normals and the same determinant.
    Pack3<Real> a = cornerEdge<Real>(view, p, c, 0);
    Pack3<Real> b = cornerEdge<Real>(view, p, c, 1);
    Pack3<Real> d = cornerEdge<Real>(view, p, c, 2);
    const Pack3<Real> bd = cross(b, d);
    const Pack<Real> det = dot(a, bd);
    // Scaled by the edges' signs these are the normals of the tetrahedron's faces.
    const Pack3<Real> n1 = times<Real>(all(Real(kCornerSigns[c][0])), bd);
    const Pack3<Real> n2 = times<Real>(all(Real(kCornerSigns[c][1])), cross(d, a));
    const Pack3<Real> n3 = times<Real>(all(Real(kCornerSigns[c][2])), cross(a, b));
    const Pack3<Real> n12 = n1 + n2;
    const Pack3<Real> n13 = n1 + n3;
    const Pack3<Real> n23 = n2 + n3;
    const Pack3<Real> n123 = n12 + n3;
    Pack<Real> most = larger<Real>(dot(n1, n1), larger<Real>(dot(n2, n2), dot(n3, n3)));
    most = larger<Real>(most, larger<Real>(dot(n12, n12), larger<Real>(dot(n13, n13), dot(n23, n23))));
    most = larger<Real>(most, larger<Real>(dot(n123, n123), tiny));
    least = smaller<Real>(least, det / squareRoot(most));
  }
  return least;
}

template <typename Real>
void refreshWidths(const KernelView<Real>& view, Real threshold, std::size_t begin, std::size_t end) {
  for (std::size_t block = begin; block < end; ++block) {
    const std::size_t at = block * kLanes<Real>;
    const Pack<Real> bound = load(view.width_bound + at);
    bool needed = false;
    for (std::size_t lane = 0; lane < kLanes<Real>; ++lane)
      needed = needed || bound[lane] < threshold;
    if (!needed)
      continue;
    Pack3<Real> p[8];
    for (int c = 0; c < 8; ++c)
      p[c] = corner<Real>(view, at, view.cells_contiguous[block] != 0, c, view.displacement);
    store<Real>(view.width_bound + at, cellWidth<Real>(view, p));
  }
}

template <typename Real>
SOFT_VOLUME_INLINE bool anyBelow(const Pack<Real>& values, Real threshold) {
  const auto below = values < threshold;
  auto any = below[0];
  for (std::size_t lane = 1; lane < kLanes<Real>; ++lane)
    any |= below[lane];
  return any != 0;
}

template <typename Real>
void checkWidths(const KernelView<Real>& view, Real least, std::size_t begin, std::size_t end,
                 std::uint8_t* suspicious) {
  for (std::size_t block = begin; block < end; ++block) {
    const std::size_t at = block * kLanes<Real>;
    const bool contiguous = view.cells_contiguous[block] != 0;
    Pack<Real> most = all(Real(0));
    for (int c = 0; c < 8; ++c) {
      const std::uint32_t* index = view.corners + c * view.cell_stride + at;
      most = larger<Real>(most, contiguous ? load(view.move_squared + index[0]) : gather(view.move_squared, index));
    }
    // A width changes by at most twice the largest move. The factor covers the rounding of its evaluation.
    Pack<Real> bound = load(view.width_bound + at) - all(Real(2.0001)) * squareRoot(most);
    suspicious[block] = 0;
    if (anyBelow<Real>(bound, least)) {
      Pack3<Real> p[8];
      for (int c = 0; c < 8; ++c) {
        p[c] =
            corner<Real>(view, at, contiguous, c, view.displacement) + corner<Real>(view, at, contiguous, c, view.move);
      }
      bound = cellWidth<Real>(view, p);
      suspicious[block] = anyBelow<Real>(bound, least) ? 1 : 0;
    }
    store<Real>(view.width_bound + at, bound);
  }
}

template <typename Real>
void volumeForces(const KernelView<Real>& view, std::size_t begin, std::size_t end) {
  const Pack<Real> hx = all(view.spacing[0]);
  const Pack<Real> hy = all(view.spacing[1]);
  const Pack<Real> hz = all(view.spacing[2]);
  const Pack<Real> volume = hx * hy * hz;
  const Pack<Real> zero = all(Real(0));
  for (std::size_t block = begin; block < end; ++block) {
    const std::size_t at = block * kLanes<Real>;
    Pack3<Real> p[8];
    Pack3<Real> gradient[8];
    for (int c = 0; c < 8; ++c) {
      p[c] = corner<Real>(view, at, view.cells_contiguous[block] != 0, c, view.displacement);
      gradient[c] = {zero, zero, zero};
    }
    Pack<Real> sum = zero;
    for (int c = 0; c < 8; ++c) {
      // With edges hx e_x + a and so on, determinant and normals are expanded in a, b and d: nothing cancels, so float
      // loses no digits near rest.
      const Pack3<Real> a = edgeChange<Real>(p, c, 0);
      const Pack3<Real> b = edgeChange<Real>(p, c, 1);
      const Pack3<Real> d = edgeChange<Real>(p, c, 2);
      const Pack3<Real> bd = cross(b, d);
      const Pack3<Real> da = cross(d, a);
      const Pack3<Real> ab = cross(a, b);
      sum += hy * hz * a.x + hz * hx * b.y + hx * hy * d.z + hx * bd.x + hy * da.y + hz * ab.z + dot(a, bd);
      const Pack3<Real> normals[3] = {{bd.x + hy * hz + hy * d.z + hz * b.y, bd.y - hz * b.x, bd.z - hy * d.x},
                                      {da.x - hz * a.y, da.y + hz * hx + hz * a.x + hx * d.z, da.z - hx * d.y},
                                      {ab.x - hy * a.z, ab.y - hx * b.z, ab.z + hx * hy + hx * b.y + hy * a.x}};
      for (int axis = 0; axis < 3; ++axis) {
        const int other = kCornerEdges[c][axis];
        const Pack3<Real> n = times<Real>(all(Real(kCornerSigns[c][axis])), normals[axis]);
        gradient[other] = gradient[other] + n;
        gradient[c] = gradient[c] - n;
      }
    }
    // J = (sum + 8 V) / (8 V s), s the stretch of the rest volume; the energy 1/2 kappa V s (J - 1)^2 has the gradient
    // kappa (J - 1) / 8 times that of the sum.
    const Pack<Real> stretch = load(view.volume_stretch + at);
    const Pack<Real> excess = sum + all(Real(8)) * volume * (all(Real(1)) - stretch);
    const Pack<Real> pressure = load(view.volume_modulus + at) * excess / (all(Real(64)) * volume * stretch);
    for (int c = 0; c < 8; ++c) {
      Real* to = view.corner_force + 24 * at + 3 * c * kLanes<Real>;
      const Pack3<Real> force = times<Real>(zero - pressure, gradient[c]);
      store<Real>(to, force.x);
      store<Real>(to + kLanes<Real>, force.y);
      store<Real>(to + 2 * kLanes<Real>, force.z);
    }
  }
}

template <typename Real>
constexpr Kernel<Real> kKernel = {forces<Real>,        advance<Real>,     apply<Real>,           volumeForces<Real>,
                                  refreshWidths<Real>, checkWidths<Real>, stiffnessProduct<Real>};

}  // namespace
}  // namespace SOFT_VOLUME_KERNEL_SPACE
}  // namespace soft_volume::core
