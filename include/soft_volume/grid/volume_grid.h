#pragma once

#include <cstddef>

#include "soft_volume/grid/irregular_grid.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume::core {

/// Most voxels that gridOf() takes: 256^3.
constexpr std::size_t kMaxGridVoxels = std::size_t(1) << 24;

/// A regular volume as cells of the type voxel, with the scalars at their vertices, which are the centres of the
/// volume's voxels: for what needs scalars at vertices instead of a texture. In the volume frame; some 55 bytes a
/// voxel. Throws InputError when an axis has fewer than two voxels or the volume more than kMaxGridVoxels.
IrregularGrid gridOf(const Volume& volume);

}  // namespace soft_volume::core
