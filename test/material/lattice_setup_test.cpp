#include "soft_volume/material/lattice_setup.h"

#include <gtest/gtest.h>

#include "analytic_volumes.h"
#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

Material tissue(double min, double max, double youngs_modulus_pa = 5000.0) {
  Material m;
  m.name = "tissue";
  m.intensity_min = min;
  m.intensity_max = max;
  m.youngs_modulus_pa = youngs_modulus_pa;
  return m;
}

Material bone(double min, double max) {
  Material m = tissue(min, max, 1e9);
  m.fixed = true;
  return m;
}

LatticeSettings coarse() {
  LatticeSettings settings;
  settings.spacing_m.setConstant(0.004);
  return settings;
}

/// 32^3 voxels of 1 mm: air (0) below z = 8 mm, tissue (100) above.
Volume halfSpace() {
  return makeVolume({32, 32, 32}, 0.001, [](const Vector3& p) { return p.z() < 0.0079 ? 0.0 : 100.0; });
}

/// What the lattice of halfSpace() has: layers 2 to 7 with tissue of their own and layer 1 within one voxel of it.
constexpr std::size_t kHalfSpaceCells = 8 * 8 * 7;

TEST(LatticeSetup, CellsExistOnlyWhereThereIsTissue) {
  const Lattice lattice = buildLattice(halfSpace(), nullptr, {tissue(50, 200)}, coarse());
  EXPECT_EQ(lattice.dims, Vector3i(8, 8, 8));
  EXPECT_EQ(lattice.cellCount(), kHalfSpaceCells);
  for (const std::uint32_t parent : lattice.parent_cells)
    EXPECT_GE(lattice.cellIndex(parent).z(), 1);
}

TEST(LatticeSetup, TextureCoordinatesCoverTheVolumeExactly) {
  const Volume volume = halfSpace();
  const Lattice lattice = buildLattice(volume, nullptr, {tissue(-1, 200)}, coarse());
  const Topology topology = makeTopology(lattice, volume.geometry(), 1);
  EXPECT_TRUE(topology.texture_coordinates.front().isZero(1e-6F));
  EXPECT_TRUE(topology.texture_coordinates.back().isOnes(1e-6F));
}

TEST(LatticeSetup, TheStiffestMaterialWinsFromItsFractionOn) {
  // Bone fills the given depth of every 4 mm cell along x.
  const auto mixed = [](int depth) {
    return makeVolume({16, 4, 4}, 0.001, [depth](const Vector3& p) {
      return static_cast<int>(p.x() * 1000.0 + 0.5) % 4 < depth ? 1000.0 : 100.0;
    });
  };
  const std::vector<Material> materials = {tissue(50, 200), bone(500, 2000)};
  LatticeSettings settings = coarse();
  settings.stiff_fraction = 0.5;
  EXPECT_EQ(buildLattice(mixed(1), nullptr, materials, settings).materials[0], 0U);
  EXPECT_EQ(buildLattice(mixed(2), nullptr, materials, settings).materials[0], 1U);
  settings.stiff_fraction = 0.25;
  EXPECT_EQ(buildLattice(mixed(1), nullptr, materials, settings).materials[0], 1U);
}

TEST(LatticeSetup, FixesBoneAndStatedRegions) {
  const Volume volume =
      makeVolume({16, 16, 16}, 0.001, [](const Vector3& p) { return p.x() < 0.0039 ? 1000.0 : 100.0; });
  LatticeSettings settings = coarse();
  settings.fixed_regions_m = {Box3(Vector3(-1, -1, 0.0149), Vector3(1, 1, 1))};
  const Lattice lattice = buildLattice(volume, nullptr, {tissue(50, 200), bone(500, 2000)}, settings);
  for (std::size_t v = 0; v < lattice.vertexCount(); ++v) {
    const Vector3& p = lattice.rest_positions[v];
    EXPECT_EQ(lattice.fixed[v] == 1, p.x() < 0.0036 || p.z() > 0.0149) << p.transpose();
  }
}

TEST(LatticeSetup, DropsPartsThatDoNotHangTogether) {
  const Volume volume =
      makeVolume({32, 8, 8}, 0.001, [](const Vector3& p) { return p.x() > 0.0079 && p.x() < 0.0199 ? 0.0 : 100.0; });
  LatticeSettings settings = coarse();
  EXPECT_EQ(buildLattice(volume, nullptr, {tissue(50, 200)}, settings).cellCount(), 4U * 2U * 2U);
  settings.keep_largest_part = false;
  EXPECT_EQ(buildLattice(volume, nullptr, {tissue(50, 200)}, settings).cellCount(), 7U * 2U * 2U);
}

TEST(LatticeSetup, LabelsDecideWhereAMaterialNamesThem) {
  const Volume volume = makeVolume({12, 8, 8}, 0.001, [](const Vector3&) { return 100.0; });
  const Volume labels = makeVolume({12, 8, 8}, 0.001, [](const Vector3& p) { return p.x() < 0.0039 ? 7.0 : 0.0; });
  Material grey = tissue(0, 0);
  grey.labels = {3, 7};
  const Lattice lattice = buildLattice(volume, &labels, {grey}, coarse());
  EXPECT_EQ(lattice.cellCount(), 2U * 2U * 2U);  // one layer of its own, one within a voxel of it
}

TEST(LatticeSetup, RefusesWhatDoesNotFit) {
  const Volume volume = halfSpace();
  Material by_label = tissue(0, 0);
  by_label.labels = {1};
  EXPECT_THROW(buildLattice(volume, nullptr, {by_label}, coarse()), SceneError);
  const Volume other_grid = makeVolume({16, 16, 16}, 0.001, [](const Vector3&) { return 1.0; });
  EXPECT_THROW(buildLattice(volume, &other_grid, {by_label}, coarse()), SceneError);
  EXPECT_THROW(buildLattice(volume, nullptr, {tissue(5000, 6000)}, coarse()), SceneError);
  LatticeSettings fine = coarse();
  fine.spacing_m.setConstant(0.0005);
  EXPECT_THROW(buildLattice(volume, nullptr, {tissue(50, 200)}, fine), SceneError);
}

TEST(LatticeSetup, CellsNeedNotBeCubes) {
  LatticeSettings settings = coarse();
  settings.spacing_m = {0.004, 0.005, 0.006};
  const Lattice lattice = buildLattice(halfSpace(), nullptr, {tissue(-1, 200)}, settings);
  EXPECT_EQ(lattice.dims, Vector3i(8, 7, 6));
  EXPECT_TRUE((lattice.rest_positions.back() - lattice.origin_m).isApprox(Vector3(0.032, 0.035, 0.036), 1e-12));
  settings.spacing_m = {0.001, 0.001, 0.0009};
  EXPECT_THROW(buildLattice(halfSpace(), nullptr, {tissue(-1, 200)}, settings), SceneError);
}

}  // namespace
}  // namespace soft_volume::core
