// Where points lie in tissue that is cut into pieces.

#include <gtest/gtest.h>

#include <functional>
#include <set>

#include "soft_volume/common/error.h"
#include "soft_volume/grid/cell_shape.h"
#include "tissue_in_pieces.h"

namespace soft_volume::core {
namespace {

constexpr double kTolerance = 1e-6 * kH;

Vector3 randomIn(const Vector3& low, const Vector3& high, std::mt19937& random) {
  std::uniform_real_distribution<double> number(0.0, 1.0);
  return low + Vector3(number(random), number(random), number(random)).cwiseProduct(high - low);
}

/// The triangles of a cell's deformed surface, by the rule that patch_contact.h states; bilinear faces finely divided.
class Surface {
 public:
  Surface(const TissueInPieces& tissue, std::uint32_t cell) : tissue_(tissue) {
    const Topology& topology = tissue.topology;
    std::size_t begin = 0;
    for (std::uint32_t c = 0; c < cell; ++c)
      begin += faceCount(topology.cell_types[c], &topology.connectivity[topology.cell_offsets[c]]);
    forEachFace(topology.cell_types[cell], &topology.connectivity[topology.cell_offsets[cell]],
                [&](std::size_t face, const std::uint32_t* loop, std::size_t size) {
                  const std::int32_t other = topology.face_neighbours[begin + face];
                  const bool bilinear =
                      topology.cell_types[cell] == CellType::kHexahedron ||
                      (other >= 0 && topology.cell_types[std::size_t(other)] == CellType::kHexahedron);
                  if (bilinear)
                    addBilinear(loop);
                  else
                    addFan({loop, loop + size});
                });
  }

  /// How often the surface goes around a point: 1 inside, 0 outside.
  double windings(const Vector3& point) const {
    double angle = 0.0;
    for (const auto& t : triangles_) {
      const Vector3 a = t[0] - point;
      const Vector3 b = t[1] - point;
      const Vector3 c = t[2] - point;
      const double below =
          a.norm() * b.norm() * c.norm() + a.dot(b) * c.norm() + b.dot(c) * a.norm() + c.dot(a) * b.norm();
      angle += 2.0 * std::atan2(a.dot(b.cross(c)), below);  // Van Oosterom and Strackee (1983)
    }
    return angle / (4.0 * M_PI);
  }
  const Box3& box() const { return box_; }

 private:
  void add(const Vector3& a, const Vector3& b, const Vector3& c) {
    triangles_.push_back({a, b, c});
    for (const Vector3& p : triangles_.back())
      box_.extend(p);
  }
  void addFan(std::vector<std::uint32_t> loop) {
    std::rotate(loop.begin(), std::min_element(loop.begin(), loop.end()), loop.end());
    for (std::size_t i = 1; i + 1 < loop.size(); ++i)
      add(tissue_.deformed(loop[0]), tissue_.deformed(loop[i]), tissue_.deformed(loop[i + 1]));
  }
  void addBilinear(const std::uint32_t* loop) {
    constexpr int kParts = 12;
    const auto at = [&](int i, int j) {
      const double u = double(i) / kParts;
      const double v = double(j) / kParts;
      return Vector3((1 - v) * ((1 - u) * tissue_.deformed(loop[0]) + u * tissue_.deformed(loop[1])) +
                     v * ((1 - u) * tissue_.deformed(loop[3]) + u * tissue_.deformed(loop[2])));
    };
    for (int j = 0; j < kParts; ++j) {
      for (int i = 0; i < kParts; ++i) {
        add(at(i, j), at(i + 1, j), at(i + 1, j + 1));
        add(at(i, j), at(i + 1, j + 1), at(i, j + 1));
      }
    }
  }

  const TissueInPieces& tissue_;
  std::vector<std::array<Vector3, 3>> triangles_;
  Box3 box_;
};

TEST(CutContactTest, AgreesWithWindingNumbersOfTheCellsSurfaces) {
  std::mt19937 random(21);
  int inside = 0;
  int disputed = 0;
  for (int round = 0; round < caseCount(6); ++round) {
    TissueInPieces tissue({4, 4, 4});
    cutAtRandom(tissue, 4, random);
    const double x = 0.45 * tissue.block.size().x();
    tissue.part(x, [&](const Vector3& p, int side) { return Vector3(warp(p) + 0.4 * kH * side * Vector3::UnitX()); });
    const PatchContact contact = tissue.contact();
    std::vector<Surface> surfaces;
    for (std::uint32_t c = 0; c < tissue.topology.cellCount(); ++c)
      surfaces.emplace_back(tissue, c);
    for (int n = 0; n < 1500; ++n) {
      const Vector3 point = randomIn(contact.bounds().min(), contact.bounds().max(), random);
      std::set<std::uint32_t> holders;
      bool near_border = false;
      for (std::uint32_t c = 0; c < surfaces.size(); ++c) {
        if (!surfaces[c].box().contains(point))
          continue;
        const double windings = surfaces[c].windings(point);
        near_border |= std::abs(windings - std::round(windings)) > 1e-6;
        if (std::round(windings) != 0.0)
          holders.insert(c);
      }
      const auto found = contact.locate(point);
      ASSERT_FALSE(near_border);
      inside += holders.empty() ? 0 : 1;
      // Twelve chords are off a warped face by little, but by something.
      const bool agrees = found.found() ? holders.count(contact.cellId(found.cell)) == 1 : holders.empty();
      disputed += agrees ? 0 : 1;
      if (found.found()) {
        EXPECT_LT((contact.position(found) - point).norm(), kTolerance);
      }
    }
  }
  EXPECT_GT(inside, 1000);
  EXPECT_LE(disputed, inside / 500);
}

/// Calls visit(cell, face's loop, neighbour) for the closed faces inside the tissue.
void forEachInnerFace(
    const Topology& topology,
    const std::function<void(std::uint32_t, const std::vector<std::uint32_t>&, std::uint32_t)>& visit) {
  std::size_t at = 0;
  for (std::uint32_t c = 0; c < topology.cellCount(); ++c) {
    forEachFace(topology.cell_types[c], &topology.connectivity[topology.cell_offsets[c]],
                [&](std::size_t, const std::uint32_t* loop, std::size_t size) {
                  if (topology.face_neighbours[at] >= 0)
                    visit(c, {loop, loop + size}, std::uint32_t(topology.face_neighbours[at]));
                  ++at;
                });
  }
}

TEST(CutContactTest, NoGapsBetweenNeighboursWhateverTheirKind) {
  std::mt19937 random(22);
  std::uniform_real_distribution<double> number(0.0, 1.0);
  int bilinear = 0;
  int flat = 0;
  int jumps = 0;
  for (int round = 0; round < caseCount(12); ++round) {
    TissueInPieces tissue({4, 4, 4});
    cutAtRandom(tissue, 5, random);
    tissue.part(0.0, [](const Vector3& p, int) { return warp(p); });
    ASSERT_GT(tissue.polyhedra(), 20U);
    const PatchContact contact = tissue.contact();
    forEachInnerFace(tissue.topology, [&](std::uint32_t cell, std::vector<std::uint32_t> loop, std::uint32_t other) {
      const auto& types = tissue.topology.cell_types;
      const bool to_hexahedron = types[cell] == CellType::kHexahedron || types[other] == CellType::kHexahedron;
      const double u = number(random);
      const double v = number(random);
      Vector3 point;
      if (to_hexahedron) {
        point = (1 - v) * ((1 - u) * tissue.deformed(loop[0]) + u * tissue.deformed(loop[1])) +
                v * ((1 - u) * tissue.deformed(loop[3]) + u * tissue.deformed(loop[2]));
        bilinear += types[cell] != types[other] ? 1 : 0;
      } else {
        std::rotate(loop.begin(), std::min_element(loop.begin(), loop.end()), loop.end());
        const std::size_t i = 1 + std::size_t(u * double(loop.size() - 2));
        const double w = std::min(v, 1.0 - u);
        point =
            (1.0 - u - w) * tissue.deformed(loop[0]) + u * tissue.deformed(loop[i]) + w * tissue.deformed(loop[i + 1]);
        ++flat;
      }
      const auto a = contact.locateIn(contact.cellOfId(cell), point);
      const auto b = contact.locateIn(contact.cellOfId(other), point);
      ASSERT_TRUE(a.found() && b.found()) << "cells " << cell << " and " << other;
      EXPECT_LT((contact.position(a) - point).norm(), kTolerance);
      // Where a bent edge folds a face's triangle over the next one, a point has two places that are near each other.
      const double jump = (contact.volumePoint(a) - contact.volumePoint(b)).norm();
      EXPECT_LT(jump, 0.01 * kH);
      jumps += jump > 5.0 * kTolerance ? 1 : 0;
    });
  }
  EXPECT_GT(bilinear, 200);
  EXPECT_GT(flat, 500);
  EXPECT_LT(jumps, (bilinear + flat) / 50);
}

TEST(CutContactTest, LinesThroughClosedCutsNeverMeetAir) {
  std::mt19937 random(23);
  TissueInPieces tissue({4, 4, 4});
  cutAtRandom(tissue, 6, random);
  const PatchContact contact = tissue.contact();
  const std::size_t vertices = tissue.topology.vertexCount();
  for (int n = 0; n < 300; ++n) {  // from vertex to vertex, along edges and through whatever
    const Vector3 a = tissue.deformed(std::uint32_t(random() % vertices));
    const Vector3 b = tissue.deformed(std::uint32_t(random() % vertices));
    for (int i = 0; i <= 40; ++i)
      ASSERT_TRUE(contact.locate(a + i / 40.0 * (b - a)).found());
  }
}

/// There the volume's gradient is not that of a ramp.
bool nearVolumesEnd(const TissueInPieces& tissue, const Vector3& place) {
  const Vector3 size = tissue.block.size();
  return place.minCoeff() < 0.6 * kH || (size - place).minCoeff() < 0.6 * kH;
}

TEST(CutContactTest, AffineTissueIsMappedBackExactly) {
  std::mt19937 random(24);
  TissueInPieces tissue({4, 4, 4}, [](const Vector3& p) { return 100.0 * p.x() - 50.0 * p.y() + 30.0 * p.z(); });
  cutAtRandom(tissue, 5, random);
  Matrix3 a;
  a << 1.2, 0.3, 0.0, -0.1, 0.9, 0.2, 0.1, 0.0, 0.7;
  tissue.part(0.0, [&](const Vector3& p, int) { return Vector3(a * p - p + Vector3(0.01, 0.02, -0.01)); });
  for (std::size_t v = 0; v < tissue.patch.velocities.size(); ++v)
    tissue.patch.velocities[v] = (a * tissue.block.mesh.restPositions()[v]).cast<float>();
  const PatchContact contact = tissue.contact(-100.0);
  const Vector3 wanted = a.inverse().transpose() * Vector3(100.0, -50.0, 30.0);
  int cones = 0;
  for (int n = 0; n < 3000; ++n) {
    const Vector3 rest =
        randomIn(Vector3::Constant(0.1 * kH), tissue.block.size() - Vector3::Constant(0.1 * kH), random);
    const auto sample = contact.sample(a * rest + Vector3(0.01, 0.02, -0.01));
    ASSERT_TRUE(sample.tissue);
    EXPECT_LT((contact.volumePoint(sample.at) - rest).norm(), 2e-8);  // positions are floats
    EXPECT_LT((contact.velocity(sample.at) - a * rest).norm(), 2e-8);
    if (!nearVolumesEnd(tissue, rest)) {
      EXPECT_LT((contact.gradient(sample.at) - wanted).norm(), 1e-3 * wanted.norm());
    }
    cones += tissue.topology.cell_types[contact.cellId(sample.at.cell)] == CellType::kPolyhedron ? 1 : 0;
  }
  EXPECT_GT(cones, 1000);
}

TEST(CutContactTest, GradientIsTheDerivativeInWarpedPieces) {
  std::mt19937 random(25);
  TissueInPieces tissue({4, 4, 4}, [](const Vector3& p) { return 1e3 * p.x() - 2e3 * p.y() + 3e3 * p.z(); });
  cutAtRandom(tissue, 3, random);
  tissue.part(0.0, [](const Vector3& p, int) { return warp(p); });
  const PatchContact contact = tissue.contact(-1e9);
  int tried = 0;
  for (int n = 0; n < 500; ++n) {
    const Vector3 point = randomIn(contact.bounds().min(), contact.bounds().max(), random);
    const auto at = contact.locate(point);
    if (!at.found() || tissue.topology.cell_types[contact.cellId(at.cell)] != CellType::kPolyhedron ||
        nearVolumesEnd(tissue, contact.volumePoint(at)))
      continue;
    const Vector3 gradient = contact.gradient(at);
    for (int axis = 0; axis < 3; ++axis) {
      const Vector3 step = 1e-7 * Vector3::Unit(axis);
      const auto up = contact.sample(point + step);
      const auto down = contact.sample(point - step);
      if (up.at.cell != at.cell || down.at.cell != at.cell || up.at.cone != at.cone || down.at.cone != at.cone)
        continue;
      EXPECT_NEAR(gradient[axis], (up.intensity - down.intensity) / 2e-7, 2e-3 * gradient.norm());
      ++tried;
    }
  }
  EXPECT_GT(tried, 100);
}

/// A unit cell cut by the plane x = 0.4 of its edge into two pieces, by hand: six faces each, one vertex per cut edge
/// and lip. Its neighbour in +y is a whole cell whose edges have got vertices: a polyhedron. Its neighbour in -x is a
/// hexahedron.
struct HandMade {
  HandMade() {
    for (const double x : {-1.0, 0.0, 0.4, 0.4, 1.0}) {  // 0.4 twice: the lips
      for (const double y : {0.0, 1.0}) {
        for (const double z : {0.0, 1.0})
          add({x, y, z});
      }
    }
    const std::uint32_t far = std::uint32_t(topology.rest_positions.size());
    for (const double x : {0.0, 1.0}) {
      for (const double z : {0.0, 1.0})
        add({x, 2.0, z});
    }
    addCell(CellType::kHexahedron,
            {v(0, 0, 0), v(1, 0, 0), v(1, 1, 0), v(0, 1, 0), v(0, 0, 1), v(1, 0, 1), v(1, 1, 1), v(0, 1, 1)},
            {-1, 1, -1, -1, -1, -1}, 0);
    addBox(1, 2, {0, -1, -1, 3, -1, -1}, 1U << 1);
    addBox(3, 4, {-1, -1, -1, -1, -1, -1}, 1U << 0);
    // The neighbour in +y is joined to the first piece only: its face there is the piece's, its rest a surface.
    addCell(CellType::kPolyhedron, {7, 4,          v(1, 1, 0), v(2, 1, 0), v(2, 1, 1), v(1, 1, 1),  // to the piece
                                    4, v(2, 1, 0), v(4, 1, 0), v(4, 1, 1), v(2, 1, 1),              // beside it
                                    4, far,        far + 1,    far + 3,    far + 2,                 // +y
                                    4, v(1, 1, 0), v(1, 1, 1), far + 1,    far,                     // -x
                                    4, v(4, 1, 0), far + 2,    far + 3,    v(4, 1, 1),              // +x
                                    5, v(1, 1, 0), far,        far + 2,    v(4, 1, 0), v(2, 1, 0),  // -z
                                    5, v(1, 1, 1), v(2, 1, 1), v(4, 1, 1), far + 3,    far + 1},    // +z
            {1, -1, -1, -1, -1, -1, -1}, 0);
    patch.session = topology.session = 1;
    patch.revision = topology.revision = 2;
    for (std::uint32_t c = 0; c < topology.cellCount(); ++c)
      patch.cell_ids.push_back(c);
    patch.stiffness_pa.assign(patch.cell_ids.size(), 10000.0F);
  }
  /// Vertex at the layer of x (0 to 4), and y and z of 0 or 1.
  static std::uint32_t v(std::uint32_t x, std::uint32_t y, std::uint32_t z) { return 4 * x + 2 * y + z; }

  void add(const Vector3& p) {
    const Vector3 rest = kH * (p + Vector3::Ones());
    patch.vertex_ids.push_back(std::uint32_t(topology.rest_positions.size()));
    topology.rest_positions.push_back(rest.cast<float>());
    topology.texture_coordinates.push_back(volume->geometry().toTexture(rest).cast<float>());
    topology.fixed.push_back(0);
    patch.positions.push_back(rest.cast<float>());
    patch.velocities.push_back(Vector3f::Zero());
  }
  void addCell(CellType type, const std::vector<std::uint32_t>& numbers, const std::vector<std::int32_t>& neighbours,
               unsigned cut) {
    topology.cell_types.push_back(type);
    topology.materials.push_back(0);
    topology.connectivity.insert(topology.connectivity.end(), numbers.begin(), numbers.end());
    topology.cell_offsets.push_back(std::uint32_t(topology.connectivity.size()));
    topology.face_neighbours.insert(topology.face_neighbours.end(), neighbours.begin(), neighbours.end());
    for (std::size_t f = 0; f < neighbours.size(); ++f)
      topology.cut_faces.push_back(cut >> f & 1U);
  }
  /// A box as a polyhedron, faces in the order -x, +x, -y, +y, -z, +z.
  void addBox(std::uint32_t a, std::uint32_t b, const std::vector<std::int32_t>& neighbours, unsigned cut) {
    addCell(CellType::kPolyhedron,
            {6,          4,          v(a, 0, 0), v(a, 0, 1), v(a, 1, 1), v(a, 1, 0), 4,          v(b, 0, 0),
             v(b, 1, 0), v(b, 1, 1), v(b, 0, 1), 4,          v(a, 0, 0), v(b, 0, 0), v(b, 0, 1), v(a, 0, 1),
             4,          v(a, 1, 0), v(a, 1, 1), v(b, 1, 1), v(b, 1, 0), 4,          v(a, 0, 0), v(a, 1, 0),
             v(b, 1, 0), v(b, 0, 0), 4,          v(a, 0, 1), v(b, 0, 1), v(b, 1, 1), v(a, 1, 1)},
            neighbours, cut);
  }
  PatchContact contact() const {
    topology.validate();
    PatchContact contact(volume, 0.0);
    contact.update(topology, patch);
    return contact;
  }

  std::shared_ptr<const Volume> volume = makeVolume({9, 9, 9}, 0.5 * kH, [](const Vector3&) { return 1.0; });
  Topology topology{0, 0, {}, {}, {}, {}, {}, {0}, {}, {}, {}, {}, {}};
  GridPatch patch;
};

Vector3 inCells(double x, double y, double z) {
  return kH * (Vector3(x, y, z) + Vector3::Ones());
}

TEST(CutContactTest, TwoHalvesOfACubeByHand) {
  HandMade tissue;
  const PatchContact closed = tissue.contact();
  EXPECT_EQ(closed.cellCount(), 4U);
  EXPECT_TRUE(closed.hasCuts());
  EXPECT_FALSE(closed.isCut(0));
  EXPECT_TRUE(closed.isCut(1) && closed.isCut(2));
  const auto cellAt = [](const PatchContact& contact, const Vector3& p) { return contact.locate(p).cell; };
  EXPECT_EQ(cellAt(closed, inCells(-0.5, 0.5, 0.5)), 0U);
  EXPECT_EQ(cellAt(closed, inCells(0.39, 0.5, 0.5)), 1U);
  EXPECT_EQ(cellAt(closed, inCells(0.41, 0.5, 0.5)), 2U);
  EXPECT_EQ(cellAt(closed, inCells(0.41, 1.5, 0.5)), 3U);
  // The lips part by half a cell and one of them is sheared.
  for (std::uint32_t n = HandMade::v(3, 0, 0); n <= HandMade::v(4, 1, 1); ++n)
    tissue.patch.positions[n] += float(kH) * Vector3f(0.5F, 0.0F, 0.2F * (n % 2));
  const PatchContact open = tissue.contact();
  EXPECT_EQ(cellAt(open, inCells(0.39, 0.5, 0.5)), 1U);
  for (const double x : {0.41, 0.6, 0.89})
    EXPECT_FALSE(open.locate(inCells(x, 0.5, 0.5)).found()) << x;
  const auto there = open.locate(inCells(0.91, 0.5, 0.6));
  ASSERT_TRUE(there.found());
  EXPECT_EQ(there.cell, 2U);
  EXPECT_LT((open.volumePoint(there) - inCells(0.41, 0.5, 0.5)).norm(), 1e-7);
}

TEST(CutContactTest, KnowsBehindWhichFacesThePatchEnds) {
  HandMade tissue;
  tissue.patch.cell_ids = {1};
  tissue.patch.stiffness_pa = {10000.0F};
  const PatchContact contact = tissue.contact();
  const auto goesOn = [&](double x, double y, double z) {
    return contact.gridGoesOn(contact.locate(inCells(x, y, z)));
  };
  EXPECT_TRUE(goesOn(0.01, 0.5, 0.5));   // the hexahedron
  EXPECT_TRUE(goesOn(0.2, 0.99, 0.5));   // the polyhedron
  EXPECT_FALSE(goesOn(0.39, 0.5, 0.5));  // the cut
  EXPECT_FALSE(goesOn(0.2, 0.01, 0.5));  // the surface
  EXPECT_FALSE(goesOn(0.2, 0.5, 0.99));
}

TEST(CutContactTest, FlatAndFoldedPiecesHoldNoSurprises) {
  HandMade tissue;
  for (std::uint32_t n = HandMade::v(4, 0, 0); n <= HandMade::v(4, 1, 1); ++n)
    tissue.patch.positions[n].x() = tissue.patch.positions[HandMade::v(3, 0, 0)].x();  // without volume
  const PatchContact flat = tissue.contact();
  EXPECT_EQ(flat.locate(inCells(0.5, 0.5, 0.5)).found(), false);
  EXPECT_EQ(flat.locate(inCells(0.2, 0.5, 0.5)).cell, 1U);
  for (std::uint32_t n = HandMade::v(4, 0, 0); n <= HandMade::v(4, 1, 1); ++n)
    tissue.patch.positions[n].x() -= float(0.2 * kH);  // inside out
  const PatchContact folded = tissue.contact();
  const auto at = folded.locateIn(2, inCells(0.3, 0.5, 0.5));
  ASSERT_TRUE(at.found());
  EXPECT_LT((folded.position(at) - inCells(0.3, 0.5, 0.5)).norm(), kTolerance);
}

TEST(CutContactTest, RefusesWhatDoesNotFit) {
  const HandMade tissue;
  PatchContact contact = tissue.contact();
  for (std::uint32_t lost = 0; lost < tissue.patch.vertex_ids.size(); ++lost) {
    GridPatch patch = tissue.patch;
    patch.vertex_ids.erase(patch.vertex_ids.begin() + lost);
    patch.positions.erase(patch.positions.begin() + lost);
    patch.velocities.erase(patch.velocities.begin() + lost);
    EXPECT_THROW(contact.update(tissue.topology, patch), InputError) << "vertex " << lost;
    EXPECT_TRUE(contact.sample(inCells(0.2, 0.5, 0.5)).tissue);
  }
  const auto invalid = [&](const std::function<void(Topology&)>& damage) {
    Topology topology = tissue.topology;
    damage(topology);
    EXPECT_THROW(topology.validate(), InputError);
  };
  const std::uint32_t stream = tissue.topology.cell_offsets[1];
  invalid([&](Topology& t) { t.connectivity[stream] = 7; });
  invalid([&](Topology& t) { t.connectivity[stream] = 3; });
  invalid([&](Topology& t) { t.connectivity[stream + 1] = 0xffffffffU; });
  invalid([&](Topology& t) { t.connectivity[stream + 1] = 5; });
  invalid([&](Topology& t) { t.connectivity[stream + 2] = std::uint32_t(t.vertexCount()); });
  invalid([&](Topology& t) { t.face_neighbours.pop_back(); });
  invalid([&](Topology& t) { t.cut_faces.pop_back(); });
}

/// The vertices of a cell of each type with a fixed shape, in VTK's order, in the unit cube.
std::vector<Vector3> cornersOf(CellType type) {
  switch (type) {
    case CellType::kTetrahedron:
      return {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    case CellType::kPyramid:
      return {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, {0.5, 0.5, 1}};
    case CellType::kWedge:
      return {{0, 0, 0}, {0, 1, 0}, {1, 0, 0}, {0, 0, 1}, {0, 1, 1}, {1, 0, 1}};
    default:
      return {};
  }
}

TEST(CutContactTest, TetrahedraWedgesAndPyramidsAreFelt) {
  const double volumes[] = {1.0 / 6.0, 0.5, 1.0 / 3.0};
  int n = 0;
  std::mt19937 random(26);
  for (const CellType type : {CellType::kTetrahedron, CellType::kWedge, CellType::kPyramid}) {
    HandMade tissue;
    tissue.topology = Topology{1, 2, {}, {}, {}, {}, {}, {0}, {}, {}, {}, {}, {}};
    tissue.patch.vertex_ids.clear();
    tissue.patch.positions.clear();
    tissue.patch.velocities.clear();
    tissue.patch.cell_ids = {0};
    tissue.patch.stiffness_pa = {10000.0F};
    std::vector<std::uint32_t> numbers;
    for (const Vector3& p : cornersOf(type)) {
      numbers.push_back(std::uint32_t(numbers.size()));
      tissue.add(p);
    }
    tissue.addCell(type, numbers, std::vector<std::int32_t>(shapeOf(type).face_count, -1), 0);
    const PatchContact contact = tissue.contact();
    int inside = 0;
    constexpr int kPoints = 4000;
    for (int i = 0; i < kPoints; ++i) {
      const Vector3 point = randomIn(inCells(0, 0, 0), inCells(1, 1, 1), random);
      const auto at = contact.locate(point);
      if (!at.found())
        continue;
      ++inside;
      EXPECT_LT((contact.volumePoint(at) - point).norm(), 2e-8);
    }
    EXPECT_NEAR(double(inside) / kPoints, volumes[n++], 0.025);
  }
}

}  // namespace
}  // namespace soft_volume::core
