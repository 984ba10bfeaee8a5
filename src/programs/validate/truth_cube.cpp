// The Truth Cube: 343 beads in a silicone cube of 80 mm, located by CT under three compressions (Kerdok et al., Medical
// Image Analysis 7, 2003).

#include <array>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <sstream>

#include "blocks.h"
#include "report.h"
#include "soft_volume/common/error.h"

namespace soft_volume::core::validate {
namespace {

constexpr int kBeads = 7;  ///< along each axis
constexpr int kStates = 4;
constexpr double kCubeM = 0.08;
constexpr double kBeadPitchM = 0.01;
constexpr char kFile[] = "truth_cube/uniaxial_positions.csv";
constexpr int kMaxSteps = 100000;

/// Bead positions in metres by state and bead number i + 7 (j + 7 k), k from the bottom up.
using Beads = std::array<std::vector<Vector3>, kStates>;

int beadNumber(int i, int j, int k) {
  return i + kBeads * (j + kBeads * k);
}

std::vector<double> numbersOf(const std::string& line) {
  std::vector<double> numbers;
  std::istringstream fields(line);
  for (std::string field; std::getline(fields, field, ',');) {
    char* end = nullptr;
    numbers.push_back(std::strtod(field.c_str(), &end));
    if (end == field.c_str())
      return {};
  }
  return numbers;
}

/// Rows of i, j, k from 1 to 7 and 4 positions in millimetres; k counts from the top.
Beads readBeads(const std::filesystem::path& path) {
  std::ifstream file(path);
  Beads beads;
  beads.fill(std::vector<Vector3>(kBeads * kBeads * kBeads, Vector3::Zero()));
  int rows = 0;
  for (std::string line; std::getline(file, line);) {
    const std::vector<double> n = numbersOf(line);
    if (n.size() != 3 + 3 * kStates)
      continue;
    const int bead = beadNumber(int(n[0]) - 1, int(n[1]) - 1, kBeads - int(n[2]));
    if (bead < 0 || bead >= kBeads * kBeads * kBeads)
      throw FileError(path.string() + ": a bead's number is not within 1 to 7");
    for (int s = 0; s < kStates; ++s)
      beads[s][bead] = 1e-3 * Vector3(n[3 + 3 * s], n[4 + 3 * s], n[5 + 3 * s]);
    ++rows;
  }
  if (rows != kBeads * kBeads * kBeads)
    throw FileError(path.string() + ": " + std::to_string(rows) + " beads instead of 343; is the file complete?");
  return beads;
}

std::filesystem::path dataFile() {
  if (const char* folder = std::getenv("SOFT_VOLUME_DATA"))
    return std::filesystem::path(folder) / kFile;
  const std::filesystem::path beside = std::filesystem::path(SOFT_VOLUME_SOURCE_DIR) / "../shared/data" / kFile;
  return std::filesystem::exists(beside) ? beside : std::filesystem::path("../shared/data") / kFile;
}

/// The slab of the cube between bead layers 1 and 7, which are driven; the sides are free. The lattice is placed so
/// that bead (4, 4, 4) lies in its middle.
struct Slab {
  Block block;
  int cells_per_pitch;

  Slab(int cells_per_pitch_, double poisson_ratio, const Beads& beads)
      : block(Vector3i(8, 8, 6) * cells_per_pitch_, Vector3::Constant(kBeadPitchM / cells_per_pitch_),
              silicone(poisson_ratio), beads[0][beadNumber(3, 3, 3)] - 0.5 * Vector3(kCubeM, kCubeM, 0.06)),
        cells_per_pitch(cells_per_pitch_) {}

  static Material silicone(double poisson_ratio) {
    Material material = tissue(poisson_ratio, 1.0);
    material.name = "silicone";
    material.youngs_modulus_pa = 15300.0;
    material.density_kg_m3 = 980.0;
    return material;
  }
};

/// Displacement at (x, y) of a bead layer, linear between beads and beyond the outermost ones.
Vector3 layerDisplacement(const Beads& beads, int state, int layer, double x, double y) {
  const int i = std::clamp(static_cast<int>(std::floor(x)), 0, kBeads - 2);
  const int j = std::clamp(static_cast<int>(std::floor(y)), 0, kBeads - 2);
  const double u = x - i;
  const double v = y - j;
  const auto moved = [&](int di, int dj) {
    const int bead = beadNumber(i + di, j + dj, layer);
    return Vector3(beads[state][bead] - beads[0][bead]);
  };
  return (1 - u) * (1 - v) * moved(0, 0) + u * (1 - v) * moved(1, 0) + (1 - u) * v * moved(0, 1) + u * v * moved(1, 1);
}

void drive(const Slab& slab, Simulation& simulation, const Beads& beads, int state) {
  std::vector<std::uint32_t> vertices;
  std::vector<Vector3> places;
  const int top = slab.block.lattice.dims.z();
  for (std::uint32_t v = 0; v < slab.block.lattice.vertexCount(); ++v) {
    const Vector3i n = slab.block.node(v);
    if (n.z() != 0 && n.z() != top)
      continue;
    const Vector3 at = n.cast<double>() / slab.cells_per_pitch - Vector3::Ones();
    vertices.push_back(v);
    places.push_back(slab.block.lattice.rest_positions[v] +
                     layerDisplacement(beads, state, n.z() == 0 ? 0 : kBeads - 1, at.x(), at.y()));
  }
  simulation.leadVertices("plates", vertices, places, kForever);
}

/// Trilinear in the cell around the bead's place at rest.
Vector3 displacementAt(const Slab& slab, const Simulation& simulation, const Vector3& rest_m) {
  const Lattice& lattice = slab.block.lattice;
  const Vector3 at = (rest_m - lattice.origin_m).cwiseQuotient(lattice.spacing_m);
  Vector3i cell;
  for (int a = 0; a < 3; ++a)
    cell[a] = std::clamp(static_cast<int>(std::floor(at[a])), 0, lattice.dims[a] - 1);
  const Vector3 f = at - cell.cast<double>();
  Vector3 sum = Vector3::Zero();
  for (const auto& corner : kHexahedronCorners) {
    double weight = 1.0;
    for (int a = 0; a < 3; ++a)
      weight *= corner[a] == 1 ? f[a] : 1.0 - f[a];
    const std::uint32_t v = slab.block.vertex(cell.x() + corner[0], cell.y() + corner[1], cell.z() + corner[2]);
    sum += weight * simulation.state().displacements_m[v];
  }
  return sum;
}

/// Root mean square distance, in metres, of the 245 beads of layers 2 to 6 from where they were measured.
template <typename Predict>
double rmsOfInnerBeads(const Beads& beads, int state, const Predict& predict) {
  double squares = 0.0;
  for (int k = 1; k < kBeads - 1; ++k) {
    for (int j = 0; j < kBeads; ++j) {
      for (int i = 0; i < kBeads; ++i) {
        const int bead = beadNumber(i, j, k);
        squares += (beads[0][bead] + predict(i, j, k) - beads[state][bead]).squaredNorm();
      }
    }
  }
  return std::sqrt(squares / (kBeads * kBeads * (kBeads - 2)));
}

/// What one would guess without physics: linear between the driven layers.
double rmsOfInterpolation(const Beads& beads, int state) {
  return rmsOfInnerBeads(beads, state, [&](int i, int j, int k) {
    const double share = k / (kBeads - 1.0);
    return Vector3((1.0 - share) * layerDisplacement(beads, state, 0, i, j) +
                   share * layerDisplacement(beads, state, kBeads - 1, i, j));
  });
}

/// Beads of the middle section: measured and predicted places in millimetres, as gnuplot's columns.
std::string middleBeads(const Slab& slab, const Simulation& simulation, const Beads& beads, int state) {
  std::ostringstream lines;
  for (int k = 0; k < kBeads; ++k) {
    for (int i = 0; i < kBeads; ++i) {
      const int bead = beadNumber(i, 3, k);
      const Vector3 measured = 1e3 * beads[state][bead];
      const Vector3 predicted = 1e3 * (beads[0][bead] + displacementAt(slab, simulation, beads[0][bead]));
      lines << measured.x() << " " << measured.z() << " " << predicted.x() << " " << predicted.z() << "\n";
    }
  }
  return lines.str();
}

void plotSection(const Slab& slab, const Simulation& simulation, const Beads& beads, int state,
                 const Options& options) {
  const int h_mm = 10 / slab.cells_per_pitch;
  options.plot("truth_cube_" + std::to_string(h_mm) + "mm",
               "$lattice << EOD\n" +
                   layerLines(slab.block, simulation.positions(), 1, slab.block.lattice.dims.y() / 2, 1e-3) +
                   "EOD\n$beads << EOD\n" + middleBeads(slab, simulation, beads, state) +
                   "EOD\nset title 'Truth Cube, state 3, middle section, h = " + std::to_string(h_mm) +
                   " mm'\nset size ratio -1\nset xlabel 'x, mm'\nset ylabel 'z, mm'\nset key outside bottom\n"
                   "plot $lattice w l lc rgb '#c0d0e0' t 'lattice', $beads u 1:2 w p pt 6 lc 'black' t 'measured', "
                   "$beads u 3:4 w p pt 2 lc 'red' t 'predicted'\n");
}

struct Compression {
  int cells_per_pitch;
  double poisson_ratio;
  double bound_m;  ///< for state 3
};

void compress(const Compression& compression, const Beads& beads, const Options& options, Report& report) {
  const Slab slab(compression.cells_per_pitch, compression.poisson_ratio, beads);
  Simulation simulation(slab.block.lattice, slab.block.materials, exactSettings(), options.threads);
  std::ostringstream prefix;
  prefix << "h " << 10 / compression.cells_per_pitch << " mm, nu " << compression.poisson_ratio << ", state ";
  for (int state = 1; state < kStates; ++state) {
    drive(slab, simulation, beads, state);
    const bool rests = settle(simulation, 1e-6, kMaxSteps);
    const double rms = rmsOfInnerBeads(beads, state, [&](int i, int j, int k) {
      return displacementAt(slab, simulation, beads[0][beadNumber(i, j, k)]);
    });
    report.row(prefix.str() + std::to_string(state) + ": RMS of 245 beads, mm (reference: linear guess)", rms * 1e3,
               rmsOfInterpolation(beads, state) * 1e3, rms * 1e3,
               state == kStates - 1 ? compression.bound_m * 1e3 : kNoBound);
    report.atMost(prefix.str() + std::to_string(state) + (rests ? "" : " (not at rest)") + ": grip lag, mm",
                  simulation.stats().grip_lag_m * 1e3, 1e-3);
  }
  report.positive(prefix.str() + "3: least width, h", simulation.minWidth() / slab.block.edge(), std::nullopt);
  // Of the material that the cube is made of.
  if (compression.poisson_ratio > 0.4)
    plotSection(slab, simulation, beads, kStates - 1, options);
}

void compressAll(const Options& options, Report& report) {
  const std::filesystem::path path = dataFile();
  if (!std::filesystem::exists(path)) {
    report.skip(path.string() +
                " is not there: set the environment variable SOFT_VOLUME_DATA to the folder that holds " + kFile);
    return;
  }
  const Beads beads = readBeads(path);
  compress({1, 0.49, 0.6e-3}, beads, options, report);
  if (options.quick)
    return;
  compress({1, 0.25, kNoBound}, beads, options, report);
  compress({2, 0.49, 0.6e-3}, beads, options, report);
}

}  // namespace

std::vector<Case> truthCubeCases(const Options& options) {
  return {{"compression", options.quick ? 2.0 : 30.0, [=](Report& report) { compressAll(options, report); }}};
}

}  // namespace soft_volume::core::validate
