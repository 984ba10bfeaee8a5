#pragma once

#include <vector>

#include "soft_volume/grid/lattice.h"
#include "soft_volume/material/material.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume::core {

/// How a volume becomes a lattice. Defaults are those of the scene file.
struct LatticeSettings {
  Vector3 spacing_m = Vector3::Constant(0.008);  ///< edges of a cell
  double stiff_fraction = 0.25;                  ///< the stiffest material that fills this fraction of the tissue wins
  bool keep_largest_part = true;                 ///< drop parts that are not face-connected to the largest one
  std::vector<Box3> fixed_regions_m;             ///< vertices inside do not move, volume frame
};

/// Covers the volume with a lattice of box-shaped cells that exist only where there is tissue (section 4.2).
///
/// Every voxel centre inside a cell votes: a voxel is tissue when a material claims its label or intensity (the first
/// material in the list that does). Mixed cells: the stiffest material with at least `stiff_fraction` of the cell's
/// tissue voxels gives the cell its density and stiffness, fixed materials counting as the stiffest; if none reaches
/// it, the most frequent one does. The dissertation lets the stiffer material win outright, which would freeze a thin
/// skin over bone. A cell without tissue voxels of its own exists too where a tissue voxel of a neighbouring cell lies
/// within one voxel of it, with the most frequent material of those: between two voxels the volume is interpolated, so
/// the tissue that is seen and touched reaches into such cells. Vertices of cells of a fixed material do not move, nor
/// do those in `fixed_regions_m`.
///
/// `labels` may be null when no material names labels. Throws SceneError when labels are needed but missing or on
/// another grid, when no cell remains, or when a cell would be shorter than a voxel.
Lattice buildLattice(const Volume& volume, const Volume* labels, const std::vector<Material>& materials,
                     const LatticeSettings& settings);

}  // namespace soft_volume::core
