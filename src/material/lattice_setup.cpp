#include "soft_volume/material/lattice_setup.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

constexpr std::int32_t kNone = Lattice::kNone;

bool claims(const Material& material, double intensity, double label) {
  if (material.byLabel()) {
    const auto id = static_cast<std::int64_t>(label);
    return std::find(material.labels.begin(), material.labels.end(), id) != material.labels.end();
  }
  return intensity >= material.intensity_min && intensity < material.intensity_max;
}

std::int32_t materialOf(const std::vector<Material>& materials, double intensity, double label) {
  for (std::size_t m = 0; m < materials.size(); ++m) {
    if (claims(materials[m], intensity, label)) return static_cast<std::int32_t>(m);
  }
  return kNone;
}

void checkLabels(const Volume& volume, const Volume* labels, const std::vector<Material>& materials) {
  const bool needed = std::any_of(materials.begin(), materials.end(), [](const Material& m) { return m.byLabel(); });
  if (needed && labels == nullptr) {
    throw SceneError("a material names labels, but the scene has no label volume: add volume.labels");
  }
  if (labels == nullptr) return;
  const VolumeGeometry& a = volume.geometry();
  const VolumeGeometry& b = labels->geometry();
  const bool same = a.dims == b.dims && a.spacing_m.isApprox(b.spacing_m, 1e-4) &&
                    (a.origin_m - b.origin_m).norm() < 0.5 * a.spacing_m.minCoeff() &&
                    a.direction.isApprox(b.direction, 1e-3);
  if (!same) {
    throw SceneError("the label volume lies on another grid than the volume: both need the same dimensions, spacing, "
                     "origin and orientation");
  }
}

/// Counts the voxels of each material and all voxels in every lattice cell.
class Votes {
 public:
  Votes(const Vector3i& dims, std::size_t materials)
      : dims_(dims), materials_(materials), votes_(std::size_t(dims.prod()) * (materials + 1), 0) {}

  void add(const Vector3i& cell, std::int32_t material) {
    std::uint32_t* entry = at(index(cell));
    ++entry[materials_];
    if (material != kNone) ++entry[material];
  }
  std::uint32_t* at(std::size_t cell) { return votes_.data() + cell * (materials_ + 1); }

 private:
  std::size_t index(const Vector3i& c) const {
    return std::size_t(c.x()) + std::size_t(dims_.x()) * (std::size_t(c.y()) + std::size_t(dims_.y()) * std::size_t(c.z()));
  }
  Vector3i dims_;
  std::size_t materials_;
  std::vector<std::uint32_t> votes_;
};

Votes countVotes(const Volume& volume, const Volume* labels, const std::vector<Material>& materials,
                 const Vector3i& dims, const Vector3& origin_m, double spacing_m) {
  Votes votes(dims, materials.size());
  const VolumeGeometry& geometry = volume.geometry();
  for (int k = 0; k < geometry.dims.z(); ++k) {
    for (int j = 0; j < geometry.dims.y(); ++j) {
      for (int i = 0; i < geometry.dims.x(); ++i) {
        const Vector3 p = geometry.spacing_m.cwiseProduct(Vector3(i, j, k));
        const Vector3i cell = ((p - origin_m) / spacing_m).cast<int>().cwiseMin(dims - Vector3i::Ones());
        const double label = labels != nullptr ? labels->at(i, j, k) : 0.0;
        votes.add(cell, materialOf(materials, volume.at(i, j, k), label));
      }
    }
  }
  return votes;
}

double stiffnessRank(const Material& material) {
  return material.fixed ? HUGE_VAL : material.youngs_modulus_pa;
}

std::int32_t decide(const std::uint32_t* votes, const std::vector<Material>& materials, const LatticeSettings& settings) {
  std::uint32_t tissue = 0;
  for (std::size_t m = 0; m < materials.size(); ++m) tissue += votes[m];
  const std::uint32_t all = votes[materials.size()];
  if (tissue == 0 || tissue < settings.minimum_tissue_fraction * all) return kNone;
  std::int32_t stiffest = kNone;
  std::int32_t most = 0;
  for (std::size_t m = 0; m < materials.size(); ++m) {
    if (votes[m] > votes[most]) most = static_cast<std::int32_t>(m);
    const bool enough = votes[m] > 0 && votes[m] >= settings.stiff_fraction * tissue;
    if (enough && (stiffest == kNone || stiffnessRank(materials[m]) > stiffnessRank(materials[stiffest]))) {
      stiffest = static_cast<std::int32_t>(m);
    }
  }
  return stiffest != kNone ? stiffest : most;
}

/// Face-connected part of every cell; parts are numbered from 0 in lattice order.
std::vector<std::int32_t> connectedParts(const Lattice& lattice) {
  std::vector<std::int32_t> part(lattice.cellCount(), kNone);
  std::int32_t count = 0;
  std::vector<std::uint32_t> stack;
  for (std::uint32_t seed = 0; seed < lattice.cellCount(); ++seed) {
    if (part[seed] != kNone) continue;
    stack.push_back(seed);
    part[seed] = count;
    while (!stack.empty()) {
      const std::uint32_t cell = stack.back();
      stack.pop_back();
      for (const std::int32_t next : lattice.face_neighbours[cell]) {
        if (next == kNone || part[next] != kNone) continue;
        part[next] = count;
        stack.push_back(static_cast<std::uint32_t>(next));
      }
    }
    ++count;
  }
  return part;
}

void dropSmallParts(const Lattice& lattice, std::vector<std::int32_t>& cell_materials) {
  const std::vector<std::int32_t> part = connectedParts(lattice);
  std::vector<std::size_t> size(part.size(), 0);
  for (const std::int32_t p : part) ++size[p];
  const auto largest = static_cast<std::int32_t>(std::max_element(size.begin(), size.end()) - size.begin());
  for (std::size_t cell = 0; cell < part.size(); ++cell) {
    if (part[cell] != largest) cell_materials[lattice.parent_cells[cell]] = kNone;
  }
}

void fixVertices(Lattice& lattice, const std::vector<Material>& materials, const std::vector<Box3>& regions) {
  for (std::size_t cell = 0; cell < lattice.cellCount(); ++cell) {
    if (!materials[lattice.materials[cell]].fixed) continue;
    for (const std::uint32_t v : lattice.cells[cell]) lattice.fixed[v] = 1;
  }
  for (std::size_t v = 0; v < lattice.vertexCount(); ++v) {
    const auto holds = [&](const Box3& box) { return box.contains(lattice.rest_positions[v]); };
    if (std::any_of(regions.begin(), regions.end(), holds)) lattice.fixed[v] = 1;
  }
}

void checkSpacing(const VolumeGeometry& geometry, double spacing_m) {
  const double voxel = geometry.spacing_m.maxCoeff();
  if (spacing_m >= voxel * (1.0 - 1e-6)) return;
  throw SceneError("lattice.spacing_m " + std::to_string(spacing_m) + " is finer than the volume's voxels (" +
                   std::to_string(voxel) + " m): cells would be empty; choose at least that");
}

}  // namespace

Lattice buildLattice(const Volume& volume, const Volume* labels, const std::vector<Material>& materials,
                     const LatticeSettings& settings) {
  checkLabels(volume, labels, materials);
  checkSpacing(volume.geometry(), settings.spacing_m);
  const Box3 bounds = volume.geometry().bounds();
  const double h = settings.spacing_m;
  const Vector3i dims = (bounds.sizes() / h - Vector3::Constant(1e-9)).array().ceil().cast<int>().max(1);
  const Vector3 spacing = Vector3::Constant(h);
  Votes votes = countVotes(volume, labels, materials, dims, bounds.min(), h);
  std::vector<std::int32_t> cell_materials(std::size_t(dims.prod()));
  for (std::size_t c = 0; c < cell_materials.size(); ++c) cell_materials[c] = decide(votes.at(c), materials, settings);

  Lattice lattice = makeLattice(dims, spacing, bounds.min(), cell_materials);
  if (lattice.cells.empty()) {
    throw SceneError("the lattice is empty: no voxel has an intensity or label that a material claims; check the "
                     "materials' intervals against the volume's range");
  }
  if (settings.keep_largest_part) {
    dropSmallParts(lattice, cell_materials);
    lattice = makeLattice(dims, spacing, bounds.min(), cell_materials);
  }
  fixVertices(lattice, materials, settings.fixed_regions_m);
  return lattice;
}

}  // namespace soft_volume::core
