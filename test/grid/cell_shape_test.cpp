#include "soft_volume/grid/cell_shape.h"

#include <gtest/gtest.h>

#include <map>
#include <set>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

constexpr std::array<CellType, 5> kTypes = {CellType::kTetrahedron, CellType::kVoxel, CellType::kHexahedron,
                                            CellType::kWedge, CellType::kPyramid};

using Edge = std::pair<std::uint32_t, std::uint32_t>;

/// Where VTK's documentation draws the vertices.
std::vector<Vector3f> cornersOf(CellType type) {
  switch (type) {
    case CellType::kTetrahedron:
      return {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    case CellType::kVoxel:
      return {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0}, {0, 0, 1}, {1, 0, 1}, {0, 1, 1}, {1, 1, 1}};
    case CellType::kHexahedron:
      return {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, {0, 0, 1}, {1, 0, 1}, {1, 1, 1}, {0, 1, 1}};
    case CellType::kWedge:  // the normal of 0 1 2 points outward
      return {{0, 0, 0}, {0, 1, 0}, {1, 0, 0}, {0, 0, 1}, {0, 1, 1}, {1, 0, 1}};
    default:
      return {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, {0.5, 0.5, 1}};
  }
}

std::vector<std::uint32_t> plainNumbers(CellType type) {
  std::vector<std::uint32_t> numbers(shapeOf(type).vertex_count);
  for (std::uint32_t i = 0; i < numbers.size(); ++i)
    numbers[i] = i;
  return numbers;
}

TEST(CellShape, EveryEdgeHasTwoFacesInOppositeDirections) {
  for (const CellType type : kTypes) {
    std::map<Edge, int> directed;
    forEachFace(type, plainNumbers(type).data(), [&](std::size_t, const std::uint32_t* face, std::size_t size) {
      for (std::size_t i = 0; i < size; ++i)
        ++directed[{face[i], face[(i + 1) % size]}];
    });
    const CellShape& shape = shapeOf(type);
    EXPECT_EQ(directed.size(), 2 * shape.edge_count) << "type " << int(type);
    for (std::size_t e = 0; e < shape.edge_count; ++e) {
      const std::uint32_t a = shape.edges[e][0];
      const std::uint32_t b = shape.edges[e][1];
      EXPECT_EQ((directed[{a, b}]), 1) << "type " << int(type) << " edge " << e;
      EXPECT_EQ((directed[{b, a}]), 1) << "type " << int(type) << " edge " << e;
    }
  }
}

TEST(CellShape, FacesPointOutwardAndCloseTheVolume) {
  const std::map<CellType, double> volumes = {{CellType::kTetrahedron, 1.0 / 6},
                                              {CellType::kVoxel, 1.0},
                                              {CellType::kHexahedron, 1.0},
                                              {CellType::kWedge, 0.5},
                                              {CellType::kPyramid, 1.0 / 3}};
  for (const CellType type : kTypes) {
    const auto corners = cornersOf(type);
    double volume = 0.0;
    forEachFace(type, plainNumbers(type).data(), [&](std::size_t number, const std::uint32_t* face, std::size_t size) {
      double part = 0.0;
      for (std::size_t i = 2; i < size; ++i)
        part += double(corners[face[0]].dot(corners[face[i - 1]].cross(corners[face[i]]))) / 6.0;
      EXPECT_GE(part, 0.0) << "type " << int(type) << " face " << number;
      volume += part;
    });
    EXPECT_NEAR(volume, volumes.at(type), 1e-6) << "type " << int(type);
  }
}

TEST(CellShape, PolyhedraListTheFacesOfTheirStream) {
  const std::vector<std::uint32_t> stream = {3, 3, 7, 8, 9, 4, 1, 2, 3, 4, 3, 5, 6, 7};
  std::vector<std::vector<std::uint32_t>> faces;
  forEachFace(CellType::kPolyhedron, stream.data(),
              [&](std::size_t number, const std::uint32_t* face, std::size_t size) {
                EXPECT_EQ(number, faces.size());
                faces.emplace_back(face, face + size);
              });
  EXPECT_EQ(faces, (std::vector<std::vector<std::uint32_t>>{{7, 8, 9}, {1, 2, 3, 4}, {5, 6, 7}}));
  EXPECT_EQ(faceCount(CellType::kPolyhedron, stream.data()), 3U);
  EXPECT_THROW(shapeOf(CellType::kPolyhedron), InputError);
  EXPECT_THROW(shapeOf(CellType(9)), InputError);
}

using FaceSet = std::set<std::pair<std::uint32_t, std::uint32_t>>;

FaceSet boundaryOf(const std::vector<CellType>& types, const std::vector<std::vector<std::uint32_t>>& cells) {
  std::vector<std::uint32_t> offsets = {0};
  std::vector<std::uint32_t> connectivity;
  for (const auto& cell : cells) {
    connectivity.insert(connectivity.end(), cell.begin(), cell.end());
    offsets.push_back(std::uint32_t(connectivity.size()));
  }
  FaceSet result;
  for (const GridFace& face : boundaryFaces(types, offsets, connectivity))
    EXPECT_TRUE(result.insert({face.cell, face.face}).second);
  return result;
}

TEST(BoundaryFaces, NeighboursOfAnyTypesHideTheirCommonFace) {
  // A hexahedron, a pyramid on its top, a tetrahedron on the pyramid's side 1 2 4, a wedge on the hexahedron's right.
  const FaceSet boundary =
      boundaryOf({CellType::kHexahedron, CellType::kPyramid, CellType::kTetrahedron, CellType::kWedge},
                 {{0, 1, 2, 3, 4, 5, 6, 7}, {4, 5, 6, 7, 8}, {5, 8, 6, 9}, {10, 5, 6, 11, 1, 2}});
  const FaceSet expected = {{0, 0}, {0, 2}, {0, 3}, {0, 4}, {1, 1}, {1, 3}, {1, 4},
                            {2, 0}, {2, 1}, {2, 2}, {3, 0}, {3, 1}, {3, 2}, {3, 4}};
  EXPECT_EQ(boundary, expected);
}

TEST(BoundaryFaces, PolyhedraFitOtherCells) {
  const FaceSet boundary = boundaryOf({CellType::kPolyhedron, CellType::kTetrahedron},
                                      {{4, 3, 0, 1, 3, 3, 1, 2, 3, 3, 2, 0, 3, 3, 0, 2, 1}, {1, 3, 2, 4}});
  EXPECT_EQ(boundary, (FaceSet{{0, 0}, {0, 2}, {0, 3}, {1, 0}, {1, 1}, {1, 2}}));
}

TEST(BoundaryFaces, CollapsedFacesAreNoneOrTriangles) {
  // The hexahedron's top is collapsed to the edge 4 5: it is a wedge with sides 0 3 4 and 1 2 5.
  const FaceSet boundary =
      boundaryOf({CellType::kHexahedron, CellType::kTetrahedron}, {{0, 1, 2, 3, 4, 5, 5, 4}, {1, 5, 2, 6}});
  EXPECT_EQ(boundary, (FaceSet{{0, 0}, {0, 2}, {0, 3}, {0, 4}, {1, 0}, {1, 1}, {1, 2}}));
}

TEST(BoundaryFaces, EmptyGridHasNone) {
  EXPECT_TRUE(boundaryFaces({}, {0}, {}).empty());
}

}  // namespace
}  // namespace soft_volume::core
