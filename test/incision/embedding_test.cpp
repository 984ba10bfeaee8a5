#include "soft_volume/incision/embedding.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <Eigen/Eigenvalues>
#include <chrono>
#include <cstdio>
#include <numeric>

#include "incision/embedded_block.h"
#include "simulation/rest_system.h"
#include "simulation/spring_model.h"
#include "soft_volume/grid/hexahedron.h"
#include "soft_volume/simulation/oracle.h"
#include "soft_volume/simulation/simulation.h"

namespace soft_volume::core {
namespace {

constexpr unsigned kSeed = 20040801;
constexpr double kModulus = 1e4;

using Numbers = std::vector<std::uint32_t>;

std::uint32_t rootOf(const Numbers& parents, std::uint32_t n) {
  while (parents[n] != n)
    n = parents[n];
  return n;
}

void join(Numbers& parents, std::uint32_t a, std::uint32_t b) {
  a = rootOf(parents, a);
  b = rootOf(parents, b);
  parents[std::max(a, b)] = std::min(a, b);
}

Numbers apart(std::size_t count) {
  Numbers parents(count);
  std::iota(parents.begin(), parents.end(), 0U);
  return parents;
}

/// The part of the lattice that every vertex belongs to: they hang together through cells.
Numbers latticeParts(const Lattice& lattice) {
  Numbers parents = apart(lattice.vertexCount());
  for (const auto& cell : lattice.cells) {
    for (const std::uint32_t v : cell)
      join(parents, cell[0], v);
  }
  for (std::uint32_t v = 0; v < parents.size(); ++v)
    parents[v] = rootOf(parents, v);
  return parents;
}

Vector3 anyVector(std::mt19937& random) {
  std::uniform_real_distribution<double> part(-1.0, 1.0);
  const double x = part(random);
  const double y = part(random);
  return {x, y, part(random)};
}

double sum(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0);
}

/// The rules of the embedding from their definition, in one pass over everything.
void expectEmbedded(const EmbeddedBlock& block) {
  const Lattice& lattice = block.lattice;
  const CutMesh& mesh = block.mesh;
  ASSERT_EQ(block.embedding.cellsOfPieces().size(), mesh.pieces().size());
  // Pieces are in one cell if and only if they hang together inside it.
  Numbers bodies = apart(mesh.pieces().size());
  for (const auto& face : mesh.faces()) {
    if (face.pieces[1] != CutMesh::kNone && mesh.pieces()[face.pieces[0]].cell == mesh.pieces()[face.pieces[1]].cell)
      join(bodies, std::uint32_t(face.pieces[0]), std::uint32_t(face.pieces[1]));
  }
  std::map<std::uint32_t, std::uint32_t> cell_of_body;
  std::map<std::uint32_t, double> volume_of_cell;
  for (std::uint32_t p = 0; p < mesh.pieces().size(); ++p) {
    const std::uint32_t cell = block.embedding.cellOf(p);
    ASSERT_EQ(lattice.parent_cells[cell], lattice.parent_cells[mesh.pieces()[p].cell]);
    ASSERT_EQ(cell_of_body.emplace(rootOf(bodies, p), cell).first->second, cell);
    volume_of_cell[cell] += volumeOfPiece(mesh, p);
  }
  ASSERT_EQ(cell_of_body.size(), lattice.cellCount());
  ASSERT_EQ(volume_of_cell.size(), lattice.cellCount());
  const double whole = lattice.spacing_m.prod();
  for (const auto& entry : volume_of_cell)
    ASSERT_NEAR(lattice.shares[entry.first], entry.second / whole, 1e-9);
  // Corners are one vertex if and only if closed faces join their cells around it.
  Numbers corners = apart(8 * lattice.cellCount());
  for (const auto& face : mesh.faces()) {
    if (face.pieces[1] == CutMesh::kNone)
      continue;
    const std::uint32_t a = block.embedding.cellOf(std::uint32_t(face.pieces[0]));
    const std::uint32_t b = block.embedding.cellOf(std::uint32_t(face.pieces[1]));
    if (lattice.parent_cells[a] == lattice.parent_cells[b])
      continue;
    int shared = 0;
    for (std::uint32_t i = 0; i < 8; ++i) {
      for (std::uint32_t j = 0; j < 8; ++j) {
        if (lattice.lattice_nodes[lattice.cells[a][i]] == lattice.lattice_nodes[lattice.cells[b][j]]) {
          join(corners, 8 * a + i, 8 * b + j);
          ++shared;
        }
      }
    }
    ASSERT_EQ(shared, 4);
  }
  std::map<std::uint32_t, std::uint32_t> vertex_of_class;
  std::map<std::uint32_t, std::uint32_t> class_of_vertex;
  for (std::uint32_t n = 0; n < corners.size(); ++n) {
    const std::uint32_t v = lattice.cells[n / 8][n % 8];
    ASSERT_EQ(vertex_of_class.emplace(rootOf(corners, n), v).first->second, v);
    ASSERT_EQ(class_of_vertex.emplace(v, rootOf(corners, n)).first->second, rootOf(corners, n));
    const int* offset = kHexahedronCorners[n % 8];
    const Vector3i at = lattice.cellIndex(lattice.parent_cells[n / 8]) + Vector3i(offset[0], offset[1], offset[2]);
    ASSERT_EQ(lattice.lattice_nodes[v], lattice.latticeNode(at.x(), at.y(), at.z()));
  }
  ASSERT_EQ(class_of_vertex.size(), lattice.vertexCount());
  // Neighbours name each other's place, and the mass is that of before.
  for (std::size_t cell = 0; cell < lattice.cellCount(); ++cell) {
    for (int face = 0; face < 6; ++face) {
      const std::int32_t other = lattice.face_neighbours[cell][face];
      ASSERT_EQ(lattice.cut_faces[cell][face] != 0,
                other == Lattice::kNone &&
                    makeBlock(lattice.dims, lattice.spacing_m)
                            .face_neighbours[lattice.cell_at[lattice.parent_cells[cell]]][face] != Lattice::kNone);
    }
  }
  const double mass_kg = block.materials[0].density_kg_m3 * block.size().prod();
  ASSERT_NEAR(sum(oracleMasses(lattice, block.materials)) / mass_kg, 1.0, 1e-12);
}

TEST(Embedding, WithoutACutNothingChanges) {
  EmbeddedBlock block({3, 4, 2});
  const EmbeddingChange change = block.cutAndFollow({squareQuad(Vector3(100, 0, 0), {1, 0, 0}, kH)});
  EXPECT_EQ(change.cells_added + change.vertices_added, 0U);
  EXPECT_TRUE(change.rest_box_m.isEmpty());
  EXPECT_EQ(block.lattice.revision, 1U);
  ASSERT_NO_FATAL_FAILURE(expectEmbedded(block));
}

TEST(Embedding, RandomCutsOneAfterTheOtherKeepToTheRules) {
  std::mt19937 random(kSeed);
  std::size_t copies = 0;
  std::size_t shared_corners = 0;
  for (int n = 0; n < 12; ++n) {
    EmbeddedBlock block({4, 4, 4});
    for (int cut = 0; cut < 6; ++cut) {
      cutAtRandom(block, 1 + cut % 2, random);
      ASSERT_NO_FATAL_FAILURE(expectEmbedded(block)) << n << ", " << cut;
    }
    copies += block.lattice.cellCount() - 64;
    for (std::size_t cell = 64; cell < block.lattice.cellCount(); ++cell) {
      const auto first = std::size_t(block.lattice.cell_at[block.lattice.parent_cells[cell]]);
      for (std::size_t c = 0; c < 8; ++c)
        shared_corners += block.lattice.cells[cell][c] == block.lattice.cells[first][c] ? 1 : 0;
    }
  }
  std::printf("%zu copies of cells, %zu corners shared with the first of the place\n", copies, shared_corners);
  EXPECT_GT(copies, 1000U);
  EXPECT_GT(shared_corners, 100U) << "no front in the test";
}

TEST(Embedding, IslandsOfTheMeshAreThoseOfTheLattice) {
  std::mt19937 random(kSeed);
  for (int n = 0; n < 10; ++n) {
    EmbeddedBlock block({5, 4, 4});
    for (int cut = 0; cut < 4; ++cut) {
      const Vector3 at = 0.5 * (block.size() + block.size().cwiseProduct(anyVector(random)));
      block.cutAndFollow({squareQuad(at, anyVector(random), 20 * kH)});
    }
    const Numbers parts = latticeParts(block.lattice);
    const Numbers islands = block.mesh.islands();
    std::map<std::uint32_t, std::uint32_t> part_of_island;
    std::map<std::uint32_t, std::uint32_t> island_of_part;
    for (std::uint32_t p = 0; p < islands.size(); ++p) {
      const std::uint32_t part = parts[block.lattice.cells[block.embedding.cellOf(p)][0]];
      EXPECT_EQ(part_of_island.emplace(islands[p], part).first->second, part);
      EXPECT_EQ(island_of_part.emplace(part, islands[p]).first->second, islands[p]);
    }
    EXPECT_GT(island_of_part.size(), 1U);
  }
}

TEST(Embedding, VerticesOfTheMeshLieWhereTheirCellsPutThem) {
  std::mt19937 random(kSeed);
  EmbeddedBlock block({4, 4, 4});
  cutAtRandom(block, 5, random);
  // Trilinear fields are reproduced exactly in every cell; affine ones are the same in all.
  Matrix3 map = Matrix3::Identity();
  for (int d = 0; d < 3; ++d)
    map.col(d) += 0.2 * anyVector(random);
  std::vector<Vector3> positions;
  for (const Vector3& p : block.lattice.rest_positions)
    positions.push_back(map * p);
  for (std::uint32_t v = 0; v < block.mesh.vertexCount(); ++v) {
    const Vector3 place = block.embedding.place(block.mesh, block.lattice, positions, v);
    EXPECT_LT((place - map * block.mesh.restPositions()[v]).norm(), 1e-12 * kH);
  }
}

// --- two cells tall, cut at a share of the upper cell

EmbeddedBlock tall(double share, double poisson_ratio, int fineness = 1) {
  EmbeddedBlock block({3 * fineness, 3 * fineness, 2 * fineness}, kH / fineness);
  block.materials = oneMaterial(kModulus, 0.0, poisson_ratio);
  for (std::size_t v = 0; v < block.lattice.vertexCount(); ++v)
    block.lattice.fixed[v] = block.lattice.rest_positions[v].z() < 1e-9 ? 1 : 0;
  if (share > 0.0)
    block.cutAndFollow({squareQuad(Vector3(1.5, 1.5, 1 + share) * kH, {0, 0, 1}, 10 * kH)});
  return block;
}

TEST(Embedding, NothingIsCarriedAcrossInTension) {
  for (const double share : {0.1, 0.3, 0.5}) {
    const EmbeddedBlock block = tall(share, 0.45);
    ASSERT_NO_FATAL_FAILURE(expectEmbedded(block));
    EXPECT_EQ(block.lattice.cellCount(), 18U + 9U);
    for (std::size_t cell = 9; cell < 18; ++cell)
      EXPECT_NEAR(std::min(block.lattice.shares[cell], 1 - block.lattice.shares[cell]), share, 1e-9);
    const Numbers parts = latticeParts(block.lattice);
    const std::uint32_t top = 47;  // the highest corner
    std::vector<Vector3> u;
    std::size_t moved = 0;
    for (std::uint32_t v = 0; v < block.lattice.vertexCount(); ++v) {
      u.push_back(parts[v] == parts[top] ? Vector3(0, 0, 0.5 * kH) : Vector3::Zero());
      moved += parts[v] == parts[top] ? 1 : 0;
    }
    EXPECT_EQ(moved, 32U);
    // The forces on either part are those of a rigid motion: none, to the rounding of stiffness times edge.
    for (const Vector3& force : oracleForces(block.lattice, block.materials, u))
      EXPECT_LT(force.norm(), 1e-12 * kModulus * kH * kH);
  }
}

/// The derivative of the forces, from differences at rest: exact to about 1e-8 (steps of 1e-6 h on linear forces).
Eigen::MatrixXd stiffnessOf(const Lattice& lattice, const std::vector<Material>& materials) {
  const OracleModel model(lattice, materials, SpringRule::kIsotropic);
  const auto n = static_cast<Eigen::Index>(3 * lattice.vertexCount());
  Eigen::MatrixXd stiffness(n, n);
  std::vector<Vector3> u(lattice.vertexCount(), Vector3::Zero());
  for (Eigen::Index i = 0; i < n; ++i) {
    const double step = 1e-6 * lattice.spacing_m.minCoeff();
    for (const double sign : {1.0, -1.0}) {
      u[std::size_t(i / 3)][i % 3] = sign * step;
      std::vector<Vector3> forces(u.size(), Vector3::Zero());
      model.addForces(u, forces);
      for (Eigen::Index k = 0; k < n; ++k)
        stiffness(k, i) = (sign > 0 ? 0.0 : stiffness(k, i)) - sign * forces[std::size_t(k / 3)][k % 3] / (2.0 * step);
    }
    u[std::size_t(i / 3)][i % 3] = 0.0;
  }
  return 0.5 * (stiffness + stiffness.transpose());
}

/// How a vertex of the mesh hangs on those of the lattice.
std::map<std::uint32_t, double> weightsOf(const EmbeddedBlock& block, std::uint32_t vertex) {
  std::map<std::uint32_t, double> weights;
  std::vector<Vector3> unit(block.lattice.vertexCount(), Vector3::Zero());
  for (const std::uint32_t v : block.lattice.cells[block.embedding.cellOf(block.mesh.piecesAround(vertex).front())]) {
    unit[v].x() = 1.0;
    weights[v] = block.embedding.place(block.mesh, block.lattice, unit, vertex).x();
    unit[v].x() = 0.0;
  }
  return weights;
}

/// Springs between the vertices of the two lips: along z alone where they slide, else in all directions.
void pressLips(const EmbeddedBlock& block, double spring_n_m, bool stick, Eigen::MatrixXd& stiffness) {
  const auto& places = block.mesh.restPositions();
  std::set<std::uint32_t> lips;
  for (const auto& face : block.mesh.faces()) {
    if (face.opened)
      lips.insert(face.loop.begin(), face.loop.end());
  }
  int pairs = 0;
  for (const std::uint32_t a : lips) {
    for (const std::uint32_t b : lips) {
      if (a >= b || (places[a] - places[b]).norm() > 1e-9 * kH)
        continue;
      for (int d = stick ? 0 : 2; d < 3; ++d) {
        Eigen::VectorXd gap = Eigen::VectorXd::Zero(stiffness.rows());
        for (const auto& weight : weightsOf(block, a))
          gap[3 * weight.first + d] += weight.second;
        for (const auto& weight : weightsOf(block, b))
          gap[3 * weight.first + d] -= weight.second;
        stiffness += spring_n_m * gap * gap.transpose();
      }
      ++pairs;
    }
  }
  EXPECT_EQ(pairs, 16);
}

/// Force per metre with which a plate on top is pushed back. Plates and lips hold the tissue sideways, or let it slide.
double pressedStiffness(const EmbeddedBlock& block, bool sticks) {
  const Lattice& lattice = block.lattice;
  Eigen::MatrixXd k = stiffnessOf(lattice, block.materials);
  const double scale = kModulus * kH;
  if (lattice.cellCount() > std::size_t(lattice.dims.prod()))
    pressLips(block, 1e4 * scale, sticks, k);
  const Eigen::Index n = k.rows();
  Eigen::VectorXd given = Eigen::VectorXd::Zero(n);
  Eigen::VectorXd held = Eigen::VectorXd::Constant(n, 1e-7 * scale);  // keeps what slides freely from floating away
  const Numbers parts = latticeParts(lattice);
  for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v) {
    const double z = lattice.rest_positions[v].z();
    const bool bottom = lattice.fixed[v] != 0;
    // Of the vertices at the top those of the part that has the tissue there: the lattice's own.
    const bool top = z > 2 * kH - 1e-9 && lattice.origin_vertices[v] == v;
    for (int d = 0; d < 3; ++d) {
      if ((bottom || top) && (d == 2 || sticks))
        held[3 * v + d] = 1e6 * scale;
    }
    given[3 * v + 2] = top ? -1.0 : 0.0;
  }
  k.diagonal() += held;
  const Eigen::VectorXd u = k.ldlt().solve(held.cwiseProduct(given));
  double force = 0.0;
  for (Eigen::Index i = 2; i < n; i += 3)
    force += given[i] < 0.0 ? held[i] * (given[i] - u[i]) : 0.0;
  return -force;
}

/// Between plates that slide, with lips that slide, the strain is uniform, and for that copies are exact. Where
/// everything sticks it is not: there a lattice of 2 cells locks, all the more where tissue is nearly incompressible,
/// and the copies give it nodes that a finer lattice has, too. So the stiffness lies between those of both lattices.
TEST(Embedding, PressedLipsAreAsStiffAsTheWholeBlock) {
  for (const double poisson_ratio : {0.25, 0.45}) {
    for (const bool sticks : {false, true}) {
      const double whole = pressedStiffness(tall(0.0, poisson_ratio), sticks);
      const double finer = pressedStiffness(tall(0.0, poisson_ratio, 2), sticks) / whole;
      if (!sticks) {
        EXPECT_NEAR(whole / (kModulus * 9 * kH / 2), 1.0, 0.01) << "E A / L";
      }
      for (const double share : {0.1, 0.3, 0.5}) {
        const double cut = pressedStiffness(tall(share, poisson_ratio), sticks) / whole;
        std::printf("nu %.2f, cut at %.0f %%, all %s: stiffness %.4f of the whole; cells half as large %.4f\n",
                    poisson_ratio, 100 * share, sticks ? "sticks" : "slides", cut, finer);
        EXPECT_LT(cut, 1.001);
        EXPECT_GT(cut, std::min(0.95, finer)) << "5 % of the whole's, or the finer lattice's";
        EXPECT_GT(cut, sticks ? 0.0 : 0.999);
      }
    }
  }
}

TEST(Embedding, TwoHalvesUnderOneStrainStoreWhatTheWholeStores) {
  Matrix3 strain;
  strain << 1.02, 0.01, 0.0, -0.02, 0.98, 0.03, 0.0, 0.01, 0.9;
  const auto energy = [&](const EmbeddedBlock& block) {
    std::vector<Vector3> u;
    for (const Vector3& p : block.lattice.rest_positions)
      u.push_back(strain * p - p);
    return oracleEnergy(block.lattice, block.materials, u);
  };
  for (const double share : {0.1, 0.3, 0.5})
    EXPECT_NEAR(energy(tall(share, 0.45)) / energy(tall(0.0, 0.45)), 1.0, 1e-12);
}

// --- a free bar

struct Axial {
  double frequency_rad_s;
  double likeness;  ///< of the mode with the one looked for, 1 at best
};

/// The mode most like u_x = cos(pi (x - begin) / length) between begin and end and 0 elsewhere, by lattice part.
Axial axialMode(const EmbeddedBlock& block, double begin_m, double length_m, std::uint32_t part) {
  const std::vector<double> masses = oracleMasses(block.lattice, block.materials);
  Eigen::MatrixXd k = stiffnessOf(block.lattice, block.materials);
  Eigen::VectorXd root(k.rows());
  Eigen::VectorXd wanted = Eigen::VectorXd::Zero(k.rows());
  const Numbers parts = latticeParts(block.lattice);
  for (std::uint32_t v = 0; v < block.lattice.vertexCount(); ++v) {
    root.segment<3>(3 * v).setConstant(std::sqrt(masses[v]));
    if (parts[v] == part)
      wanted[3 * v] = root[3 * v] * std::cos(M_PI * (block.lattice.rest_positions[v].x() - begin_m) / length_m);
  }
  wanted.normalize();
  const Eigen::VectorXd inverse = root.cwiseInverse();
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> modes(inverse.asDiagonal() * k * inverse.asDiagonal());
  Eigen::Index best = 0;
  (modes.eigenvectors().transpose() * wanted).cwiseAbs().maxCoeff(&best);
  return {std::sqrt(std::max(0.0, modes.eigenvalues()[best])), std::abs(modes.eigenvectors().col(best).dot(wanted))};
}

TEST(Embedding, HalvesOfAFreeBarVibrateTwiceAsFast) {
  // The lumped masses of the coarsest half, 4 cells, already cost 2.4 %; off the middle there are still fewer.
  for (const int cells : {8, 9, 12}) {
    for (const double off : {0.0, 0.25, 0.4}) {
      if (off > 0.0 && cells < 9)
        continue;
      const double length = cells * kH;
      EmbeddedBlock block({cells, 1, 1});
      block.materials = oneMaterial(kModulus, 0.0, 0.25);
      const Axial whole = axialMode(block, 0.0, length, 0);
      EXPECT_NEAR(whole.frequency_rad_s, M_PI / length * std::sqrt(kModulus / 1000.0), 0.02 * whole.frequency_rad_s);
      const double at = 0.5 * length + off * kH;
      block.cutAndFollow({squareQuad(Vector3(at, 0.5 * kH, 0.5 * kH), {1, 0, 0}, 10 * kH)});
      const Numbers parts = latticeParts(block.lattice);
      const std::uint32_t left = parts[block.lattice.cells[0][0]];
      const std::uint32_t right = parts[block.lattice.cells[std::size_t(cells - 1)][6]];
      ASSERT_NE(left, right);
      const Axial low = axialMode(block, 0.0, at, left);
      const Axial high = axialMode(block, at, length - at, right);
      // A half of length l has the frequency of the whole bar times L / l, which is 2 at its middle.
      const double of_left = low.frequency_rad_s / whole.frequency_rad_s / (length / at);
      const double of_right = high.frequency_rad_s / whole.frequency_rad_s / (length / (length - at));
      std::printf(
          "%2d cells, cut at %.2f: frequencies %.4f and %.4f of L / l times the whole bar's (likeness %.2f %.2f)\n",
          cells, at / kH, of_left, of_right, low.likeness, high.likeness);
      EXPECT_NEAR(of_left, 1.0, 0.05);
      EXPECT_NEAR(of_right, 1.0, 0.05);
      EXPECT_GT(std::min({whole.likeness, low.likeness, high.likeness}), 0.95);
    }
  }
}

double largestFrequency(const Lattice& lattice, const std::vector<Material>& materials) {
  const SpringModel model = makeSpringModel(lattice, materials, SpringRule::kIsotropic, 0.0);
  return RestSystem(lattice, SpringRule::kIsotropic, model).largestFrequency();
}

// --- in a simulation

TEST(Embedding, ACutKeepsMassMomentumAndEnergy) {
  std::mt19937 random(kSeed);
  std::normal_distribution<double> normal;
  EmbeddedBlock block({5, 4, 4});
  block.materials = oneMaterial(kModulus, 0.0, 0.45);
  SimulationSettings settings;
  settings.active_set = ActiveSet::kAll;
  settings.precision = Precision::kDouble;
  Simulation simulation(block.lattice, block.materials, settings, 1);
  SimulationState state = simulation.state();
  for (std::size_t v = 0; v < block.lattice.vertexCount(); ++v) {
    state.displacements_m[v] = 0.01 * kH * Vector3(normal(random), normal(random), normal(random));
    state.velocities_m_s[v] = Vector3(0.05 + 0.01 * normal(random), 0.01 * normal(random), 0.01 * normal(random));
  }
  simulation.restore(state);
  const double dt_s = simulation.settings().dt_s;
  for (int cut = 0; cut < 6; ++cut) {
    const Mechanics before = simulation.mechanics();
    block.reach_m = simulation.reach();
    for (std::uint32_t v = 0; v < block.mesh.vertexCount(); ++v)
      block.positions_m[v] = block.embedding.place(block.mesh, block.lattice, simulation.positions(), v);
    cutAtRandom(block, 1, random);
    simulation.adoptTopology();
    const Mechanics after = simulation.mechanics();
    double mass_kg = 0.0;
    for (std::uint32_t v = 0; v < block.lattice.vertexCount(); ++v)
      mass_kg += simulation.mass(v);
    EXPECT_NEAR(mass_kg / (1000.0 * block.size().prod()), 1.0, 1e-12);
    const double momentum = before.linear_momentum_kg_m_s.norm();
    EXPECT_LT((after.linear_momentum_kg_m_s - before.linear_momentum_kg_m_s).norm(), 1e-12 * momentum);
    EXPECT_LT((after.angular_momentum_kg_m2_s - before.angular_momentum_kg_m2_s).norm(),
              1e-12 * momentum * block.size().norm());
    EXPECT_NEAR(after.kinetic_j / before.kinetic_j, 1.0, 1e-12);
    EXPECT_NEAR(after.elastic_j / before.elastic_j, 1.0, 1e-12) << "a cut alone stores and frees nothing";
    for (int n = 0; n < 20; ++n)
      simulation.step();
    ASSERT_EQ(simulation.limitedMoves(), 0U) << "the guard does not keep momentum";
    EXPECT_LT((simulation.mechanics().linear_momentum_kg_m_s - before.linear_momentum_kg_m_s).norm(), 1e-9 * momentum);
    ASSERT_EQ(simulation.settings().dt_s, dt_s);
  }
  EXPECT_GT(block.lattice.cellCount(), 120U) << "hardly anything was cut";
}

/// A block on a fixed floor that incisions divide, some of them ending inside.
EmbeddedBlock cutOnFloor(double poisson_ratio) {
  std::mt19937 random(kSeed);
  EmbeddedBlock block({6, 5, 5});
  block.materials = oneMaterial(kModulus, 0.3, poisson_ratio);
  for (std::size_t v = 0; v < block.lattice.vertexCount(); ++v)
    block.lattice.fixed[v] = block.lattice.rest_positions[v].z() < 1e-9 ? 1 : 0;
  cutAtRandom(block, 6, random);
  return block;
}

/// In proportion to mass, so that a chip is pulled no more than it can bear.
std::vector<VertexLoad> pullsOnTop(const EmbeddedBlock& block, double acceleration_m_s2) {
  const Lattice& lattice = block.lattice;
  const std::vector<double> masses = oracleMasses(lattice, block.materials);
  std::vector<VertexLoad> loads;
  for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v) {
    const Vector3& p = lattice.rest_positions[v];
    if (p.z() > 4.9 * kH)
      loads.push_back({v, masses[v] * acceleration_m_s2 * Vector3(std::sin(300 * p.x()), 0.3, std::cos(500 * p.y()))});
  }
  return loads;
}

/// The same sums in another order: after 200 steps of a stable motion rounding errors of 1e-16 are still tiny.
TEST(Embedding, TheFastEngineMovesCopiesAsTheOracleDoes) {
  for (const double poisson_ratio : {0.25, 0.45}) {
    EmbeddedBlock block = cutOnFloor(poisson_ratio);
    block.materials[0].damping_ratio = 0.0;
    SimulationSettings settings;
    settings.active_set = ActiveSet::kAll;
    settings.precision = Precision::kDouble;
    Simulation fast(block.lattice, block.materials, settings, 2);
    OracleSettings oracle_settings;
    oracle_settings.dt_s = fast.settings().dt_s / fast.substeps();  // chips divide it
    OracleSimulation slow(block.lattice, block.materials, oracle_settings);
    const std::vector<VertexLoad> loads = pullsOnTop(block, 1.0);
    std::vector<Vector3> forces(block.lattice.vertexCount(), Vector3::Zero());
    for (const VertexLoad& load : loads)
      forces[load.vertex] = load.force_n;
    fast.setLoads(loads);
    slow.setForces(forces);
    for (int n = 0; n < 200; ++n) {
      fast.step();
      for (int part = 0; part < fast.substeps(); ++part)
        slow.step();
    }
    double worst_m = 0.0;
    for (std::size_t v = 0; v < forces.size(); ++v)
      worst_m = std::max(worst_m, (fast.state().displacements_m[v] - slow.displacements()[v]).norm());
    EXPECT_EQ(fast.limitedMoves() + slow.limitedMoves(), 0U);
    EXPECT_GT(fast.maxDisplacement(), 1e-3 * kH);
    EXPECT_LT(worst_m, 1e-10 * fast.maxDisplacement());
  }
}

/// Pulled far beyond what tissue carries and let go: nothing inverts, and whatever integrates the motion, it fades.
TEST(Embedding, ACutBlockStandsViolentLoadsAndSettles) {
  const EmbeddedBlock block = cutOnFloor(0.45);
  const std::vector<std::pair<Integrator, ActiveSet>> cases = {{Integrator::kSymplecticEuler, ActiveSet::kAll},
                                                               {Integrator::kSymplecticEuler, ActiveSet::kGrowth},
                                                               {Integrator::kRungeKutta4, ActiveSet::kGrowth},
                                                               {Integrator::kBackwardEuler, ActiveSet::kAll},
                                                               {Integrator::kQuasiStatic, ActiveSet::kGrowth}};
  for (const auto& c : cases) {
    SimulationSettings settings;
    settings.integrator = c.first;
    settings.active_set = c.second;
    Simulation simulation(block.lattice, block.materials, settings, 1);
    simulation.setLoads(pullsOnTop(block, 1e6));
    for (int n = 0; n < 50; ++n) {
      simulation.step();
      ASSERT_GT(simulation.minWidth(), 0.0);
    }
    const double speed = simulation.maxSpeed();
    EXPECT_GT(simulation.maxDisplacement(), 0.1 * kH);
    EXPECT_GT(simulation.limitedMoves() + simulation.stats().saturated_forces, 0U);
    simulation.setLoads({});
    for (double t = 0.0; t < 0.75; t += simulation.settings().dt_s)
      simulation.step();
    EXPECT_LT(simulation.maxSpeed(), 0.1 * speed) << "integrator " << int(c.first);
    EXPECT_GT(simulation.minWidth(), 0.0);
  }
}

/// A step close to the limit of the whole lattice is beyond that of chips: it is divided when they appear.
TEST(Embedding, AStepNearTheLimitStaysStableAmongChips) {
  EmbeddedBlock block({6, 5, 5});
  block.materials = oneMaterial(kModulus, 0.0, 0.45);
  SimulationSettings settings;
  settings.active_set = ActiveSet::kAll;
  settings.precision = Precision::kDouble;
  settings.dt_fraction = 0.98;
  Simulation simulation(block.lattice, block.materials, settings, 1);
  const double dt_s = simulation.settings().dt_s;
  EXPECT_EQ(simulation.substeps(), 1);
  std::mt19937 random(kSeed);
  cutAtRandom(block, 12, random);
  ASSERT_GT(dt_s * largestFrequency(block.lattice, block.materials), 2.0) << "the chips are not fast enough to test it";
  simulation.adoptTopology();
  EXPECT_EQ(simulation.substeps(), 2);
  EXPECT_EQ(simulation.settings().dt_s, dt_s);
  SimulationState state = simulation.state();
  for (Vector3& u : state.displacements_m)
    u = 1e-4 * kH * anyVector(random);
  simulation.restore(state);
  const Mechanics before = simulation.mechanics();
  for (int n = 0; n < 500; ++n)
    simulation.step();
  const Mechanics after = simulation.mechanics();
  EXPECT_LT(after.elastic_j + after.kinetic_j, 2.0 * (before.elastic_j + before.kinetic_j));
}

TEST(Embedding, ThreadsDoNotChangeTheBitsOfACutBlock) {
  const EmbeddedBlock block = cutOnFloor(0.45);
  std::vector<std::uint64_t> hashes;
  for (const int threads : {1, 2, 3}) {
    Simulation simulation(block.lattice, block.materials, SimulationSettings(), threads);
    simulation.setLoads(pullsOnTop(block, 30.0));
    for (int n = 0; n < 60; ++n)
      simulation.step();
    hashes.push_back(simulation.stateHash());
  }
  EXPECT_EQ(hashes, std::vector<std::uint64_t>(3, hashes[0]));
}

TEST(Embedding, OnlyTissueThatTouchesAFixedFloorIsFixed) {
  EmbeddedBlock block({3, 3, 2});
  for (std::size_t v = 0; v < block.lattice.vertexCount(); ++v)
    block.lattice.fixed[v] = block.lattice.rest_positions[v].z() < 1e-9 ? 1 : 0;
  block.cutAndFollow({squareQuad(Vector3(1.5, 1.5, 0.3) * kH, {0, 0, 1}, 10 * kH)});
  const auto partsWithFixed = [&] {
    const Numbers parts = latticeParts(block.lattice);
    std::map<std::uint32_t, int> fixed;
    for (std::uint32_t v = 0; v < block.lattice.vertexCount(); ++v)
      fixed[parts[v]] += block.lattice.fixed[v];
    return fixed;
  };
  std::map<std::uint32_t, int> fixed = partsWithFixed();
  ASSERT_EQ(fixed.size(), 2U);
  EXPECT_EQ(std::min(fixed.begin()->second, fixed.rbegin()->second), 0) << "what lies above the cut is free";
  EXPECT_EQ(std::max(fixed.begin()->second, fixed.rbegin()->second), 16);
  // A strip between two cuts within a cell has no corner of the lattice, but it stands on the floor.
  block.cutAndFollow({squareQuad(Vector3(1.3, 1.5, 0.1) * kH, {1, 0, 0}, 10 * kH)});
  block.cutAndFollow({squareQuad(Vector3(1.7, 1.5, 0.1) * kH, {1, 0, 0}, 10 * kH)});
  ASSERT_NO_FATAL_FAILURE(expectEmbedded(block));
  fixed = partsWithFixed();
  EXPECT_EQ(fixed.size(), 6U);
  int free = 0;
  for (const auto& part : fixed)
    free += part.second == 0 ? 1 : 0;
  EXPECT_EQ(free, 3) << "the three parts above";
}

std::size_t cutPlaces(const Lattice& lattice) {
  std::set<std::uint32_t> places;
  for (std::size_t cell = 0; cell < lattice.cellCount(); ++cell) {
    if (lattice.shares[cell] < 1.0)
      places.insert(lattice.parent_cells[cell]);
  }
  return places.size();
}

TEST(Embedding, IncisionsThroughManyCellsHardlyShortenTheStableStep) {
  EmbeddedBlock block({13, 12, 9});
  const Lattice whole = block.lattice;
  const Vector3 middle = 0.5 * block.size();
  block.cutAndFollow({squareQuad(middle + Vector3(0.1, 0.23, 0.05) * kH, {0.1, 0.2, 1.0}, 20 * kH)});
  block.cutAndFollow({squareQuad(middle + Vector3(0.03, 0, 0) * kH, {1.0, 0.15, -0.2}, 20 * kH)});
  EXPECT_GE(cutPlaces(block.lattice), 200U);
  for (const double poisson_ratio : {0.25, 0.45}) {
    block.materials = oneMaterial(kModulus, 0.0, poisson_ratio);
    const double ratio = largestFrequency(whole, block.materials) / largestFrequency(block.lattice, block.materials);
    std::printf("nu %.2f: two incisions through %zu cells, least share %.1e: stable step %.4f of the uncut\n",
                poisson_ratio, cutPlaces(block.lattice),
                *std::min_element(block.lattice.shares.begin(), block.lattice.shares.end()), ratio);
    EXPECT_GT(ratio, 0.8);
  }
}

/// Stiffness and mass matrices are sums over cells of shares times those of one cell, so no frequency is above that of
/// a cell by itself (to the power iteration's 1e-4), however small the pieces.
TEST(Embedding, NoPieceVibratesFasterThanAFreeCell) {
  std::mt19937 random(kSeed);
  EmbeddedBlock block({8, 8, 8});
  const Lattice whole = block.lattice;
  while (block.lattice.cellCount() < 900)
    cutAtRandom(block, 1, random);
  for (const double poisson_ratio : {0.25, 0.45, 0.49}) {
    block.materials = oneMaterial(kModulus, 0.0, poisson_ratio);
    const double uncut = largestFrequency(whole, block.materials);
    const double cut = largestFrequency(block.lattice, block.materials);
    const double free_cell = largestFrequency(makeBlock(1, 1, 1, kH), block.materials);
    std::printf(
        "nu %.2f: %zu cells cut to chips, least share %.1e: stable step %.4f of the uncut, a free cell's %.4f\n",
        poisson_ratio, cutPlaces(block.lattice),
        *std::min_element(block.lattice.shares.begin(), block.lattice.shares.end()), uncut / cut, uncut / free_cell);
    EXPECT_LT(cut, free_cell * (1 + 1e-3));
    EXPECT_GT(uncut / cut, SimulationSettings().dt_fraction) << "an automatic step must stay stable";
  }
}

TEST(Embedding, PressuresActOnEverySurfaceOnce) {
  EmbeddedBlock block({3, 3, 2});
  SimulationSettings settings;
  settings.pressures.push_back({Box3(Vector3(-kH, -kH, 1.99 * kH), Vector3(4 * kH, 4 * kH, 2.01 * kH)), 500.0});
  const auto total = [&] {
    Simulation simulation(block.lattice, block.materials, settings, 1);
    simulation.step();
    return Vector3(simulation.mechanics().linear_momentum_kg_m_s / simulation.settings().dt_s);
  };
  const Vector3 whole = total();
  EXPECT_NEAR(whole.z(), -500.0 * 9 * kH * kH, 1e-4 * whole.norm());
  block.cutAndFollow({squareQuad(Vector3(1.3, 1.5, 2) * kH, {1, 0.2, 0.3}, 10 * kH)});
  EXPECT_LT((total() - whole).norm(), 1e-4 * whole.norm());
}

TEST(Embedding, TakesAsLongAsTheCutIsLarge) {
  for (const int cells : {8, 16, 32}) {
    EmbeddedBlock block({cells, cells, cells});
    double best_s = 1e9;
    for (int n = 0; n < 5; ++n) {
      const double x = (0.4 + 1.1 * n) * kH;
      const Vector3 a(x, 0.3 * kH, (cells - 1.6) * kH);
      const Vector3 up(0, 0, 5 * kH);
      const Vector3 go(0.1 * kH, 4.4 * kH, 0);
      block.cut({{a, a + up, a + up + go, a + go}});
      const auto start = std::chrono::steady_clock::now();
      const EmbeddingChange change = block.embedding.update(block.mesh, block.lattice);
      best_s = std::min(best_s, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
      EXPECT_GE(change.cells_added, 3U);
    }
    std::printf("%d^3 cells: %.3f ms for a stroke through 10 of them\n", cells, 1e3 * best_s);
  }
}

}  // namespace
}  // namespace soft_volume::core
