#pragma once

#include <cstddef>
#include <cstdint>

namespace soft_volume::core {

/// Vertices and cells are worked on in blocks of as many lanes as fit into 32 bytes.
template <typename Real>
constexpr std::size_t kLanes = 32 / sizeof(Real);

/// Neighbours by lattice offset: direction (dx+1) + 3 (dy+1) + 9 (dz+1); 13 is the vertex itself.
constexpr std::size_t kDirections = 27;

/// One spring of every vertex of a block, all in the same direction; stiffness 0 where a vertex has none.
struct SpringEntry {
  static constexpr std::uint32_t kUnstretched = 0xffffffffU;
  std::uint32_t stiffness;  ///< place of the stiffness: one value for all lanes if `uniform`, else one for each
  std::uint32_t index;      ///< contiguous: the first vertex's neighbour; else the place of the block's in `indices`
  std::uint32_t stretched;  ///< place of rest length and |r|^2 - length^2 of each lane, or kUnstretched
  std::uint8_t direction;
  std::uint8_t edge;  ///< along a cell edge
  std::uint8_t uniform;
  std::uint8_t contiguous;  ///< the neighbours of successive vertices follow each other
};

/// Plain pointers to the arrays of a solve (SolveSet), as the kernels see them. Vectors are three arrays. Arrays of
/// vertices and cells are padded to whole blocks.
template <typename Real>
struct KernelView {
  // Per vertex.
  Real* displacement[3];
  Real* velocity[3];
  Real* force[3];
  Real* move[3];
  Real* external[3];
  Real* nearest_squared;  ///< squared distance to the nearest neighbour
  Real* move_squared;
  const Real* mass;
  Real* inverse_mass;        ///< 0: does not move
  const Real* damping_rate;  ///< 1/s

  // Springs, by block of vertices.
  const std::uint32_t* entry_begin;
  const SpringEntry* entries;
  const Real* stiffness;
  const std::uint32_t* indices;
  const Real* stretched;
  Real offset[kDirections][3];  ///< to the neighbour at rest
  Real length[kDirections];
  Real linear[kDirections];  ///< linear springs without rest length, in units of the stiffness (SpringModel)

  // Per cell: corner c of cell n is vertex corners[c * cell_stride + n].
  const std::uint32_t* corners;
  std::size_t cell_stride;
  const std::uint8_t* cells_contiguous;  ///< per block of cells: the corners of successive cells follow each other
  Real* width_bound;                     ///< no corner tetrahedron of the cell is thinner than this
  Real spacing[3];

  // Volume energy; null where no material has it.
  const Real* volume_modulus;    ///< per cell, pascal
  const Real* volume_stretch;    ///< per cell, rest volume over that of a cell
  Real* corner_force;            ///< [cell blocks][8][3][lanes]: force of a cell on its corners
  const std::uint32_t* cell_of;  ///< [8][vertex_stride]: place of the cell in which the vertex is corner c, or of none
  std::size_t vertex_stride;
  /// Where several cells have a vertex as the same corner: rows [more_begin[block], more_begin[block + 1]) of places of
  /// further corner forces, one for each vertex of the block. Null where there are none.
  const std::uint32_t* more_begin;
  const std::uint32_t* more_cells;

  Real gravity[3];
  bool nearest_of_all;  ///< nearest neighbour along any spring, not along cell edges alone
};

/// How a step turns forces into moves.
template <typename Real>
struct AdvanceRule {
  Real dt;
  Real half_dt_squared;   ///< dt^2 / 2 in the dissertation's rule, else 0
  Real nearest_fraction;  ///< largest move as a fraction of the distance to the nearest neighbour
  Real largest_move;      ///< and in metres
  Real epsilon;           ///< two vertices may not come closer than this (section 4.3)
  bool damped;            ///< the materials' damping applies
  bool limits;            ///< any of these applies
  bool consistent;        ///< a shortened move shortens the velocity with it
};

/// The passes of a step over blocks [begin, end) of a list. Same bits on every processor: IEEE operations in one order.
template <typename Real>
struct Kernel {
  /// Spring, volume and external forces of the vertices in `blocks`, and the distance to their nearest neighbours.
  void (*forces)(const KernelView<Real>&, const std::uint32_t* blocks, std::size_t begin, std::size_t end);
  /// Velocities and limited moves from the forces.  Adds the number of shortened moves to `*limited`.
  void (*advance)(const KernelView<Real>&, const AdvanceRule<Real>&, const std::uint32_t* blocks, std::size_t begin,
                  std::size_t end, std::uint64_t* limited);
  /// Displacements += moves.
  void (*apply)(const KernelView<Real>&, const std::uint32_t* blocks, std::size_t begin, std::size_t end);
  /// Forces of the volume energy of cell blocks on their corners.
  void (*volumeForces)(const KernelView<Real>&, std::size_t begin, std::size_t end);
  /// Computes widths before the move where the bound is below `threshold`.
  void (*refreshWidths)(const KernelView<Real>&, Real threshold, std::size_t begin, std::size_t end);
  /// Lowers the width bounds by what the moves can take; where that may be below `least`, computes the widths after the
  /// move. Sets suspicious[block] where a width is below `least`.
  void (*checkWidths)(const KernelView<Real>&, Real least, std::size_t begin, std::size_t end,
                      std::uint8_t* suspicious);
  /// force = tangent stiffness times `direction`, at the present displacements; for implicit steps.
  void (*stiffnessProduct)(const KernelView<Real>&, const Real* const direction[3], Real* const product[3],
                           const std::uint32_t* blocks, std::size_t begin, std::size_t end);
};

const Kernel<float>& portableKernelFloat();
const Kernel<double>& portableKernelDouble();
const Kernel<float>& avx2KernelFloat();
const Kernel<double>& avx2KernelDouble();

/// The fastest one that this processor runs.
template <typename Real>
const Kernel<Real>& bestKernel();

/// "avx2" or "portable". SOFT_VOLUME_KERNEL=portable in the environment chooses the portable one.
const char* kernelName();

}  // namespace soft_volume::core
