#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "light.h"
#include "mipmap.h"
#include "polygon_triangles.h"
#include "render/canvas_scene.h"
#include "render/cell_grids.h"
#include "render/render_scenes.h"
#include "soft_volume/common/error.h"
#include "transfer_table.h"
#include "vertex_gradients.h"
#include "volume_bricks.h"

namespace soft_volume::core {
namespace {

// --- mipmaps

double meanOf(const std::vector<float>& texels) {
  double sum = 0.0;
  for (const float texel : texels)
    sum += double(texel);
  return sum / double(texels.size());
}

TEST(Mipmap, EveryLevelKeepsTheMean) {
  std::mt19937 random(1);
  std::uniform_real_distribution<float> value(0.0F, 1.0F);
  for (const Vector3i& size : {Vector3i(16, 8, 4), Vector3i(17, 9, 5), Vector3i(1, 7, 3), Vector3i(30, 1, 1)}) {
    Vector3i dims = size;
    std::vector<float> level(std::size_t(dims.prod()));
    for (float& texel : level)
      texel = value(random);
    const double mean = meanOf(level);
    while (dims.maxCoeff() > 1) {
      level = halveVolume(level.data(), dims);
      dims = halvedDims(dims);
      ASSERT_EQ(level.size(), std::size_t(dims.prod()));
      EXPECT_NEAR(meanOf(level), mean, 1e-6) << dims.transpose();
    }
  }
}

TEST(Mipmap, OddSidesAreShared) {
  const std::vector<float> five = {0, 10, 20, 30, 40};
  // 2.5 voxels each: the middle one belongs to both by half.
  EXPECT_EQ(halveVolume(five.data(), Vector3i(5, 1, 1)), (std::vector<float>{8.0F, 32.0F}));
  EXPECT_EQ(halveVolume(five.data(), Vector3i(1, 1, 5)), (std::vector<float>{8.0F, 32.0F}));
}

TEST(Mipmap, IntegersAreRounded) {
  const std::vector<std::int16_t> row = {-3, -4, 5, 6};
  EXPECT_EQ(halveVolume(row.data(), Vector3i(4, 1, 1)), (std::vector<std::int16_t>{-4, 6}));
  const std::vector<std::uint16_t> high = {65535, 65535, 0, 1};
  EXPECT_EQ(halveVolume(high.data(), Vector3i(4, 1, 1)), (std::vector<std::uint16_t>{65535, 1}));
}

TEST(Mipmap, NanIsLeftOutUnlessItIsTheMost) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const std::vector<float> square = {1, nan, 5, nan, 3, nan, nan, nan};  // 4 x 2
  const std::vector<float> half = halveVolume(square.data(), Vector3i(4, 2, 1));
  ASSERT_EQ(half.size(), 2U);
  EXPECT_EQ(half[0], 2.0F);
  EXPECT_TRUE(std::isnan(half[1]));
}

// --- bricks

using TextureBox = std::array<Vector3f, 2>;

std::vector<TextureBox> boxesOf(const Vector3i& cells) {
  std::vector<TextureBox> boxes;
  const Vector3f size = cells.cast<float>().cwiseInverse();
  for (int k = 0; k < cells.z(); ++k) {
    for (int j = 0; j < cells.y(); ++j) {
      for (int i = 0; i < cells.x(); ++i) {
        const Vector3f corner = Vector3i(i, j, k).cast<float>();
        boxes.push_back({corner.cwiseProduct(size), (corner + Vector3f::Ones()).cwiseProduct(size)});
      }
    }
  }
  return boxes;
}

TEST(VolumeBricks, AVolumeThatFitsIsOneBrick) {
  const BrickLayout layout = layoutBricks(boxesOf(Vector3i(3, 3, 3)), Vector3i(64, 32, 16), Vector3i::Zero(), 64);
  ASSERT_EQ(layout.bricks.size(), 1U);
  EXPECT_EQ(layout.bricks[0].volume.begin, Vector3i(0, 0, 0));
  EXPECT_EQ(layout.bricks[0].volume.end, Vector3i(64, 32, 16));
  EXPECT_TRUE(layout.brick_of_cell.empty());
}

TEST(VolumeBricks, EveryCellHasItsVoxelsAndAMargin) {
  const Vector3i dims(200, 130, 70);
  const Vector3i label_dims(100, 260, 70);
  const auto boxes = boxesOf(Vector3i(20, 13, 14));
  const int limit = 64;
  const BrickLayout layout = layoutBricks(boxes, dims, label_dims, limit);
  ASSERT_EQ(layout.brick_of_cell.size(), boxes.size());
  EXPECT_LT(layout.bricks.size(), boxes.size() / 8) << "neighbours share bricks";
  const auto expectInside = [&](const VoxelBox& brick, const TextureBox& box, const Vector3i& size) {
    EXPECT_LE(brick.sizes().maxCoeff(), limit);
    for (int axis = 0; axis < 3; ++axis) {
      EXPECT_LE(brick.begin[axis], std::max(0.0, std::floor(double(box[0][axis]) * size[axis]) - 4.0));
      EXPECT_GE(brick.end[axis], std::min(double(size[axis]), std::ceil(double(box[1][axis]) * size[axis]) + 4.0));
      EXPECT_EQ(brick.begin[axis] % (1 << layout.max_level), 0);
    }
  };
  for (std::size_t cell = 0; cell < boxes.size(); ++cell) {
    const Brick& brick = layout.bricks[layout.brick_of_cell[cell]];
    expectInside(brick.volume, boxes[cell], dims);
    expectInside(brick.labels, boxes[cell], label_dims);
  }
}

TEST(VolumeBricks, ACellThatIsTooLargeIsRefused) {
  EXPECT_THROW(layoutBricks(boxesOf(Vector3i(1, 1, 1)), Vector3i(65, 8, 8), Vector3i::Zero(), 64), InputError);
  EXPECT_THROW(layoutBricks(boxesOf(Vector3i(1, 1, 1)), Vector3i(8, 8, 8), Vector3i(8, 8, 65), 64), InputError);
  EXPECT_NO_THROW(layoutBricks(boxesOf(Vector3i(4, 1, 1)), Vector3i(65, 8, 8), Vector3i::Zero(), 64));
}

// --- triangles

SliceMesh polygonMesh(const std::vector<Eigen::Vector2f>& corners) {
  SliceMesh mesh;
  for (const Eigen::Vector2f& corner : corners) {
    mesh.corners.push_back(std::uint32_t(mesh.vertices.size()));
    mesh.vertices.push_back({corner.x(), corner.y(), 0.0F, 0, 0});
  }
  mesh.polygons.push_back({0, 0, std::uint32_t(corners.size())});
  return mesh;
}

double areaOf(const SliceMesh& mesh, std::uint32_t a, std::uint32_t b, std::uint32_t c) {
  const auto at = [&](std::uint32_t i) {
    return Eigen::Vector2d(double(mesh.vertices[mesh.corners[i]].u), double(mesh.vertices[mesh.corners[i]].v));
  };
  const Eigen::Vector2d p = at(b) - at(a);
  const Eigen::Vector2d q = at(c) - at(a);
  return 0.5 * (p.x() * q.y() - p.y() * q.x());
}

TEST(PolygonTriangles, TrianglesTileThePolygon) {
  // Star-shaped around the origin, so simple, but with many reflex corners; both orientations.
  std::mt19937 random(2);
  std::uniform_real_distribution<double> radius(0.2, 5.0);
  for (int trial = 0; trial < 400; ++trial) {
    const int size = 3 + trial % 14;
    std::vector<Eigen::Vector2f> corners;
    for (int i = 0; i < size; ++i) {
      const double angle = (trial % 2 == 0 ? 1.0 : -1.0) * 2.0 * M_PI * i / size;
      corners.emplace_back((radius(random) * Eigen::Vector2d(std::cos(angle), std::sin(angle))).cast<float>());
    }
    const SliceMesh mesh = polygonMesh(corners);
    double polygon = 0.0;
    for (std::uint32_t i = 2; i < std::uint32_t(size); ++i)
      polygon += areaOf(mesh, 0, i - 1, i);
    std::vector<std::uint32_t> triangles(3 * std::size_t(size - 2));
    triangulate(mesh, mesh.polygons[0], std::uint32_t(trial % 3), triangles.data());
    // Triangles that all turn the same way and have the polygon's area in sum cover it once.
    double sum = 0.0;
    for (std::size_t i = 0; i < triangles.size(); i += 3)
      sum += std::abs(areaOf(mesh, triangles[i], triangles[i + 1], triangles[i + 2]));
    EXPECT_NEAR(sum, std::abs(polygon), 1e-5 * std::abs(polygon)) << "trial " << trial;
  }
}

TEST(PolygonTriangles, TrianglesOfConvexLoopsMeetAtTheTip) {
  const SliceMesh mesh = polygonMesh({{0, 0}, {4, 0}, {5, 3}, {2, 5}, {-1, 3}});
  for (std::uint32_t tip = 0; tip < 5; ++tip) {
    std::vector<std::uint32_t> triangles(9, 99);
    triangulate(mesh, mesh.polygons[0], tip, triangles.data());
    EXPECT_EQ(std::count(triangles.begin(), triangles.end(), tip), 3) << "tip " << tip;
  }
}

TEST(PolygonTriangles, LoopsThatCrossThemselvesStayWithinTheirCorners) {
  const SliceMesh mesh = polygonMesh({{0, 0}, {4, 4}, {4, 0}, {0, 4}, {2, -3}});
  std::vector<std::uint32_t> triangles(9, 99);
  triangulate(mesh, mesh.polygons[0], 0, triangles.data());
  for (const std::uint32_t corner : triangles)
    EXPECT_LT(corner, 5U);
}

// --- gradients

DrawnGrid mixedGrid() {
  std::mt19937 random(8);
  CellGrid cells = makeMixedCells(Vector3f::Zero(), Vector3i(4, 4, 4), random);
  cells.points = jittered(cells.points, 0.1F, random);
  DrawnGrid grid;
  grid.cell_types = cells.types;
  grid.cell_offsets = cells.offsets;
  grid.connectivity = cells.connectivity;
  grid.rest_positions = cells.points;
  return grid;
}

TEST(VertexGradients, LinearScalarsAreExactInCellsOfEveryType) {
  DrawnGrid grid = mixedGrid();
  const Vector3f gradient(2.0F, -3.0F, 0.5F);
  for (const Vector3f& p : grid.rest_positions)
    grid.point_scalars.push_back(gradient.dot(p) + 7.0F);
  VertexGradients gradients;
  gradients.setGrid(grid);
  for (const Vector3f& found : gradients.ofScalar(grid.rest_positions, 2))
    EXPECT_LT((found - gradient).norm(), 1e-3) << found.transpose();
}

TEST(VertexGradients, TextureFollowsTheDeformation) {
  DrawnGrid grid = mixedGrid();
  for (const Vector3f& p : grid.rest_positions)
    grid.texture.push_back(p / 4.0F);
  VertexGradients gradients;
  gradients.setGrid(grid);
  Eigen::Matrix3f deformation;
  deformation << 1.5F, 0.3F, 0.0F, -0.2F, 0.8F, 0.1F, 0.0F, 0.4F, 1.1F;
  std::vector<Vector3f> positions;
  for (const Vector3f& p : grid.rest_positions)
    positions.emplace_back(deformation * p + Vector3f(3, 4, 5));
  const Eigen::Matrix3f expected = deformation.inverse() / 4.0F;
  for (const Eigen::Matrix3f& found : gradients.ofTexture(positions, 2))
    EXPECT_LT((found - expected).norm(), 1e-3);
}

TEST(VertexGradients, NumberOfThreadsChangesNothing) {
  DrawnGrid grid = mixedGrid();
  for (const Vector3f& p : grid.rest_positions)
    grid.point_scalars.push_back(p.squaredNorm());
  VertexGradients gradients;
  gradients.setGrid(grid);
  EXPECT_EQ(gradients.ofScalar(grid.rest_positions, 1), gradients.ofScalar(grid.rest_positions, 3));
}

TEST(VertexGradients, FlatCellsAndNanGiveZero) {
  const Topology block = makeBlock(Box3(Vector3::Zero(), Vector3::Ones()), Vector3i(1, 1, 1));
  DrawnGrid grid = drawnGrid(block);
  grid.texture.clear();
  grid.point_scalars.assign(8, 1.0F);
  grid.point_scalars[3] = std::numeric_limits<float>::quiet_NaN();
  VertexGradients gradients;
  gradients.setGrid(grid);
  for (const Vector3f& found : gradients.ofScalar(grid.rest_positions, 1))
    EXPECT_EQ(found, Vector3f(Vector3f::Zero()));
  grid.point_scalars = {0, 1, 2, 3, 4, 5, 6, 7};
  std::vector<Vector3f> flat = grid.rest_positions;
  for (Vector3f& p : flat)
    p.z() *= 1e-6F;
  for (const Vector3f& found : gradients.ofScalar(flat, 1))
    EXPECT_TRUE(found.allFinite()) << found.transpose();
}

// --- light

TEST(Light, JitterCoversItsRangeEvenly) {
  std::vector<int> counts(10, 0);
  double sum = 0.0;
  for (std::uint32_t y = 0; y < 100; ++y) {
    for (std::uint32_t x = 0; x < 100; ++x) {
      const float shift = jitterAt(x, y);
      ASSERT_GE(shift, -0.5F);
      ASSERT_LT(shift, 0.5F);
      ++counts[std::size_t((shift + 0.5F) * 10.0F)];
      sum += double(shift);
    }
  }
  EXPECT_NEAR(sum / 10000.0, 0.0, 0.01);
  for (const int count : counts)
    EXPECT_NEAR(count, 1000, 100);
}

TEST(Light, TheShadingStepIsTheSizeOfVoxelsOrCells) {
  const Topology block = makeBlock(Box3(Vector3::Zero(), Vector3(0.4, 0.2, 0.2)), Vector3i(4, 2, 2));
  const DrawnGrid grid = drawnGrid(block);
  VolumeGeometry geometry;
  geometry.dims = Vector3i(40, 20, 20);
  EXPECT_NEAR(shadingStep(grid, &geometry), 0.01, 1e-6) << "of the grid, whatever the volume's own spacing says";
  EXPECT_NEAR(shadingStep(grid, nullptr), 0.1, 1e-6);
}

/// Two peaks at the ends of the table: scalars beyond them show nothing, though they lie next to opaque entries.
TEST(TransferTable, IsTransparentWhereNoLookUpFindsOpacity) {
  TransferFunction function;
  for (const double peak : {1.0, 4.0}) {
    for (const double offset : {-0.1, 0.0, 0.1})
      function.points.push_back({peak + offset, Vector3f::Ones(), offset == 0.0 ? 0.5F : 0.0F});
  }
  const TransferTable table(function);
  EXPECT_TRUE(table.isTransparent(-5.0, 0.8));
  EXPECT_TRUE(table.isTransparent(1.2, 3.8));
  EXPECT_TRUE(table.isTransparent(4.2, 9.0));
  EXPECT_FALSE(table.isTransparent(-5.0, 0.95));
  EXPECT_FALSE(table.isTransparent(0.0, 9.0));
  EXPECT_FALSE(table.isTransparent(4.05, 9.0));
  const unsigned seed = 5;
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> scalar(0.5, 4.5);
  for (int round = 0; round < 2000; ++round) {
    const double low = scalar(random);
    const double high = low + 0.1 * (scalar(random) - 0.5);
    for (double value = low; value <= high; value += (high - low) / 20.0) {
      const double place = (value - table.firstValue()) * table.entriesPerValue();
      const auto entry = std::size_t(std::clamp(place, 0.0, double(TransferTable::kSize - 1)) + 0.5);
      ASSERT_FALSE(table.isTransparent(low, high) && table.entries()[entry][3] > 0.0F) << value << ", seed " << seed;
    }
  }
}

}  // namespace
}  // namespace soft_volume::core
