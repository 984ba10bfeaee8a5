#include "soft_volume/material/lattice_setup.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>
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
    if (claims(materials[m], intensity, label))
      return static_cast<std::int32_t>(m);
  }
  return kNone;
}

void checkLabels(const Volume& volume, const Volume* labels, const std::vector<Material>& materials) {
  const bool needed = std::any_of(materials.begin(), materials.end(), [](const Material& m) { return m.byLabel(); });
  if (needed && labels == nullptr) {
    throw SceneError("a material names labels, but the scene has no label volume: add volume.labels");
  }
  if (labels == nullptr)
    return;
  const VolumeGeometry& a = volume.geometry();
  const VolumeGeometry& b = labels->geometry();
  const bool same = a.dims == b.dims && a.spacing_m.isApprox(b.spacing_m, 1e-4) &&
                    (a.origin_m - b.origin_m).norm() < 0.5 * a.spacing_m.minCoeff() &&
                    a.direction.isApprox(b.direction, 1e-3);
  if (!same) {
    throw SceneError(
        "the label volume lies on another grid than the volume: both need the same dimensions, spacing, "
        "origin and orientation");
  }
}

/// Tissue voxels per lattice cell and material.
class Votes {
 public:
  Votes(const Vector3i& dims, std::size_t materials)
      : dims_(dims), materials_(materials), votes_(std::size_t(dims.prod()) * materials, 0) {}

  void add(const Vector3i& cell, std::int32_t material) { ++votes_[index(cell) * materials_ + std::size_t(material)]; }
  const std::uint32_t* of(std::size_t cell) const { return votes_.data() + cell * materials_; }
  std::size_t index(const Vector3i& c) const {
    return std::size_t(c.x()) +
           std::size_t(dims_.x()) * (std::size_t(c.y()) + std::size_t(dims_.y()) * std::size_t(c.z()));
  }

 private:
  Vector3i dims_;
  std::size_t materials_;
  std::vector<std::uint32_t> votes_;
};

struct Census {
  Votes own;     ///< voxels inside the cell
  Votes nearby;  ///< voxels of other cells within one voxel of it
};

/// Votes for the cells that a box of one voxel around `p` reaches beyond the voxel's own cell.
void voteNearby(const Vector3& p, const Vector3& voxel_m, const std::function<Vector3i(const Vector3&)>& cell_of,
                std::int32_t material, Votes& nearby) {
  const Vector3i own = cell_of(p);
  const Vector3i low = cell_of(p - voxel_m);
  const Vector3i high = cell_of(p + voxel_m);
  for (int k = low.z(); k <= high.z(); ++k) {
    for (int j = low.y(); j <= high.y(); ++j) {
      for (int i = low.x(); i <= high.x(); ++i) {
        if (Vector3i(i, j, k) != own)
          nearby.add({i, j, k}, material);
      }
    }
  }
}

Census takeCensus(const Volume& volume, const Volume* labels, const std::vector<Material>& materials,
                  const Vector3i& dims, const Vector3& origin_m, const Vector3& spacing_m) {
  Census census{Votes(dims, materials.size()), Votes(dims, materials.size())};
  const VolumeGeometry& geometry = volume.geometry();
  const auto cell_of = [&](const Vector3& p) -> Vector3i {
    return (p - origin_m)
        .cwiseQuotient(spacing_m)
        .array()
        .floor()
        .cast<int>()
        .matrix()
        .cwiseMax(0)
        .cwiseMin(dims - Vector3i::Ones());
  };
  for (int k = 0; k < geometry.dims.z(); ++k) {
    for (int j = 0; j < geometry.dims.y(); ++j) {
      for (int i = 0; i < geometry.dims.x(); ++i) {
        const double label = labels != nullptr ? labels->at(i, j, k) : 0.0;
        const std::int32_t material = materialOf(materials, volume.at(i, j, k), label);
        if (material == kNone)
          continue;
        const Vector3 p = geometry.spacing_m.cwiseProduct(Vector3(i, j, k));
        census.own.add(cell_of(p), material);
        voteNearby(p, geometry.spacing_m, cell_of, material, census.nearby);
      }
    }
  }
  return census;
}

double stiffnessRank(const Material& material) {
  return material.fixed ? HUGE_VAL : material.youngs_modulus_pa;
}

std::int32_t mostFrequent(const std::uint32_t* votes, std::size_t materials) {
  const std::uint32_t* most = std::max_element(votes, votes + materials);
  return *most > 0 ? static_cast<std::int32_t>(most - votes) : kNone;
}

/// The stiffest material with enough of a cell's own tissue, or kNone.
std::int32_t stiffest(const std::uint32_t* votes, const std::vector<Material>& materials, double stiff_fraction) {
  const std::uint32_t tissue = std::accumulate(votes, votes + materials.size(), 0U);
  std::int32_t winner = kNone;
  for (std::size_t m = 0; m < materials.size(); ++m) {
    const bool enough = votes[m] > 0 && votes[m] >= stiff_fraction * tissue;
    if (enough && (winner == kNone || stiffnessRank(materials[m]) > stiffnessRank(materials[winner]))) {
      winner = static_cast<std::int32_t>(m);
    }
  }
  return winner;
}

std::int32_t decide(const Census& census, std::size_t cell, const std::vector<Material>& materials,
                    double stiff_fraction) {
  const std::uint32_t* own = census.own.of(cell);
  const std::int32_t frequent = mostFrequent(own, materials.size());
  if (frequent == kNone)
    return mostFrequent(census.nearby.of(cell), materials.size());
  const std::int32_t winner = stiffest(own, materials, stiff_fraction);
  return winner != kNone ? winner : frequent;
}

/// Face-connected part of every cell; parts are numbered from 0 in lattice order.
std::vector<std::int32_t> connectedParts(const Lattice& lattice) {
  std::vector<std::int32_t> part(lattice.cellCount(), kNone);
  std::int32_t count = 0;
  std::vector<std::uint32_t> stack;
  for (std::uint32_t seed = 0; seed < lattice.cellCount(); ++seed) {
    if (part[seed] != kNone)
      continue;
    stack.push_back(seed);
    part[seed] = count;
    while (!stack.empty()) {
      const std::uint32_t cell = stack.back();
      stack.pop_back();
      for (const std::int32_t next : lattice.face_neighbours[cell]) {
        if (next == kNone || part[next] != kNone)
          continue;
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
  for (const std::int32_t p : part)
    ++size[p];
  const auto largest = static_cast<std::int32_t>(std::max_element(size.begin(), size.end()) - size.begin());
  for (std::size_t cell = 0; cell < part.size(); ++cell) {
    if (part[cell] != largest)
      cell_materials[lattice.parent_cells[cell]] = kNone;
  }
}

void fixVertices(Lattice& lattice, const std::vector<Material>& materials, const std::vector<Box3>& regions) {
  for (std::size_t cell = 0; cell < lattice.cellCount(); ++cell) {
    if (!materials[lattice.materials[cell]].fixed)
      continue;
    for (const std::uint32_t v : lattice.cells[cell])
      lattice.fixed[v] = 1;
  }
  for (std::size_t v = 0; v < lattice.vertexCount(); ++v) {
    const auto holds = [&](const Box3& box) { return box.contains(lattice.rest_positions[v]); };
    if (std::any_of(regions.begin(), regions.end(), holds))
      lattice.fixed[v] = 1;
  }
}

void checkSpacing(const VolumeGeometry& geometry, const Vector3& spacing_m) {
  for (int a = 0; a < 3; ++a) {
    if (spacing_m[a] >= geometry.spacing_m[a] * (1.0 - 1e-6))
      continue;
    throw SceneError("lattice.spacing_m " + std::to_string(spacing_m[a]) + " is finer along " + "xyz"[a] +
                     " than the volume's voxels (" + std::to_string(geometry.spacing_m[a]) +
                     " m): cells would be empty; choose at least that");
  }
}

}  // namespace

Lattice buildLattice(const Volume& volume, const Volume* labels, const std::vector<Material>& materials,
                     const LatticeSettings& settings) {
  checkLabels(volume, labels, materials);
  checkSpacing(volume.geometry(), settings.spacing_m);
  const Box3 bounds = volume.geometry().bounds();
  const Vector3& spacing = settings.spacing_m;
  const Vector3 cells = bounds.sizes().cwiseQuotient(spacing);
  const Vector3i dims = (cells.array() - 1e-9).ceil().cast<int>().max(1);
  const Census census = takeCensus(volume, labels, materials, dims, bounds.min(), spacing);
  std::vector<std::int32_t> cell_materials(std::size_t(dims.prod()));
  for (std::size_t c = 0; c < cell_materials.size(); ++c) {
    cell_materials[c] = decide(census, c, materials, settings.stiff_fraction);
  }

  Lattice lattice = makeLattice(dims, spacing, bounds.min(), cell_materials);
  if (lattice.cells.empty()) {
    throw SceneError(
        "the lattice is empty: no voxel has an intensity or label that a material claims; check the "
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
