#include "simulation_scene.h"

#include <algorithm>
#include <cmath>
#include <map>

namespace soft_volume::core {
namespace {

constexpr double kPi = 3.14159265358979323846;

/// Rises from 0 to 1 over [begin, end] with a continuous slope.
double smoothRise(double time_s, double begin_s, double end_s) {
  const double x = std::clamp((time_s - begin_s) / (end_s - begin_s), 0.0, 1.0);
  return x * x * (3.0 - 2.0 * x);
}

/// When a tool presses, slides and lets go.
struct Course {
  double press_end_s;
  double slide_end_s;
  double release_end_s;
};

/// A round footprint on the top of a slab, pressure (1 - r^2/R^2)^2, and its path.
struct Footprint {
  static constexpr double kRadius_m = 0.015;
  static constexpr double kPress_n = 1.0;
  static constexpr double kFriction_n = 0.3;
  static constexpr double kSlide_m = 0.02;
  static constexpr int kPoints = 24;  ///< quadrature points across; finer than the finest lattice
  Vector3 start_m;
  Course course;
};

Vector3 footprintForce(const Course& course, double time_s) {
  const double press = smoothRise(time_s, 0.0, course.press_end_s);
  const double release = smoothRise(time_s, course.slide_end_s, course.release_end_s);
  const bool slides = time_s > course.press_end_s;
  const double start_of_slide_s = course.press_end_s + 0.1 * (course.slide_end_s - course.press_end_s);
  const double friction = slides ? smoothRise(time_s, course.press_end_s, start_of_slide_s) : 0.0;
  return (1.0 - release) * Vector3(Footprint::kFriction_n * friction, 0.0, -Footprint::kPress_n * press);
}

std::vector<PointForce> footprintForces(const Footprint& footprint, double time_s) {
  const Vector3 force_n = footprintForce(footprint.course, time_s);
  if (force_n.isZero(0.0))
    return {};
  const double slide = smoothRise(time_s, footprint.course.press_end_s, footprint.course.slide_end_s);
  const Vector3 centre_m = footprint.start_m + Vector3(slide * Footprint::kSlide_m, 0.0, 0.0);
  const double cell_m = 2.0 * Footprint::kRadius_m / Footprint::kPoints;
  std::vector<PointForce> forces;
  double total = 0.0;
  for (int j = 0; j < Footprint::kPoints; ++j) {
    for (int i = 0; i < Footprint::kPoints; ++i) {
      const Vector3 offset((i + 0.5) * cell_m - Footprint::kRadius_m, (j + 0.5) * cell_m - Footprint::kRadius_m, 0.0);
      const double share = 1.0 - offset.squaredNorm() / (Footprint::kRadius_m * Footprint::kRadius_m);
      if (share <= 0.0)
        continue;
      forces.push_back({centre_m + offset, share * share * force_n});
      total += share * share;
    }
  }
  for (PointForce& point : forces)
    point.force_n /= total;
  return forces;
}

/// Points of a 5 mm grid within a footprint's radius of its path: what the user looks at and feels. Farther away every
/// setting moves next to nothing and is right.
std::vector<Vector3> pointsNearPath(const Vector3& size_m, const Vector3& start_m) {
  constexpr double kGrid_m = 0.005;
  std::vector<Vector3> points;
  for (double z = kGrid_m; z < size_m.z() + 1e-9; z += kGrid_m) {
    for (double y = kGrid_m; y < size_m.y(); y += kGrid_m) {
      for (double x = kGrid_m; x < size_m.x(); x += kGrid_m) {
        const Vector3 point(x, y, z);
        Vector3 nearest = start_m;
        nearest.x() = std::clamp(x, start_m.x(), start_m.x() + Footprint::kSlide_m);
        if ((point - nearest).norm() < Footprint::kRadius_m + 1e-9)
          points.push_back(point);
      }
    }
  }
  return points;
}

Material tissue(double youngs_modulus_pa, double poisson_ratio, double damping_ratio) {
  Material material;
  material.name = "tissue";
  material.density_kg_m3 = 1060.0;
  material.youngs_modulus_pa = youngs_modulus_pa;
  material.poisson_ratio = poisson_ratio;
  material.damping_ratio = damping_ratio;
  return material;
}

struct CellPlace {
  std::size_t cell;
  Vector3 local;  ///< in [0, 1]^3
};

CellPlace placeOf(const Lattice& lattice, const Vector3& rest_point_m) {
  const Vector3 scaled = (rest_point_m - lattice.origin_m).cwiseQuotient(lattice.spacing_m);
  Vector3i index;
  for (int d = 0; d < 3; ++d)
    index[d] = std::clamp(static_cast<int>(std::floor(scaled[d])), 0, lattice.dims[d] - 1);
  const std::int32_t cell = lattice.cell_at[lattice.latticeCell(index.x(), index.y(), index.z())];
  return {static_cast<std::size_t>(cell), scaled - index.cast<double>()};
}

double cornerWeight(int corner, const Vector3& local) {
  double weight = 1.0;
  for (int d = 0; d < 3; ++d)
    weight *= kHexahedronCorners[corner][d] == 1 ? local[d] : 1.0 - local[d];
  return weight;
}

/// Deflection of an end-loaded cantilever of square section by Timoshenko: P L^3 / (3 E I) + P L / (k G A) with the
/// shear coefficient k = 10 (1 + nu) / (12 + 11 nu) of a rectangle (Cowper, 1966).
double timoshenkoDeflection(const Material& material, double length_m, double width_m, double load_n) {
  const double area = width_m * width_m;
  const double inertia = area * area / 12.0;
  const double nu = material.poisson_ratio;
  const double shear_pa = material.youngs_modulus_pa / (2.0 * (1.0 + nu));
  const double coefficient = 10.0 * (1.0 + nu) / (12.0 + 11.0 * nu);
  return load_n * length_m * length_m * length_m / (3.0 * material.youngs_modulus_pa * inertia) +
         load_n * length_m / (coefficient * shear_pa * area);
}

/// Period of the first bending mode of a slender cantilever of square section, seconds.
double bendingPeriod(const Material& material, double length_m, double width_m) {
  constexpr double kFirstRoot = 1.8751040687;  // of cos x cosh x = -1
  const double radius_of_gyration = width_m / std::sqrt(12.0);
  const double frequency = kFirstRoot * kFirstRoot * radius_of_gyration / (length_m * length_m) *
                           std::sqrt(material.youngs_modulus_pa / material.density_kg_m3);
  return 2.0 * kPi / frequency;
}

/// Midpoints of an n x n grid on the face x = length of a beam.
std::vector<Vector3> endFacePoints(double length_m, double width_m, int n) {
  std::vector<Vector3> points;
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < n; ++i)
      points.emplace_back(length_m, (i + 0.5) * width_m / n, (j + 0.5) * width_m / n);
  }
  return points;
}

}  // namespace

TradeoffScene indentationScene(bool quick) {
  TradeoffScene scene;
  scene.name = "indentation";
  scene.size_m = quick ? Vector3(0.08, 0.08, 0.04) : Vector3(0.12, 0.12, 0.04);
  scene.fixed_m = Box3(Vector3(-1.0, -1.0, -1e-6), Vector3(1.0, 1.0, 1e-6));
  scene.material = tissue(10e3, 0.45, 0.3);
  const Course course = quick ? Course{0.15, 0.3, 0.32} : Course{0.3, 0.7, 0.72};
  scene.duration_s = quick ? 0.4 : 1.0;
  scene.sample_s = quick ? 0.02 : 0.05;
  Footprint footprint;
  footprint.course = course;
  footprint.start_m = Vector3(0.5 * (scene.size_m.x() - Footprint::kSlide_m), 0.5 * scene.size_m.y(), scene.size_m.z());
  scene.probes_m = pointsNearPath(scene.size_m, footprint.start_m);
  scene.forces = [footprint](double time_s) { return footprintForces(footprint, time_s); };
  scene.description = std::string("A slab of soft tissue (") + (quick ? "80 x 80" : "120 x 120") +
                      " x 40 mm, E = 10 kPa, nu = 0.45, 1060 kg/m3, damping ratio 0.3) lies on a rigid base. A round "
                      "footprint of 30 mm "
                      "presses with 1 N, slides 20 mm with a friction of 0.3 N and lets go within 20 ms; the slab "
                      "swings back. Compared "
                      "are the displacements of all points of a 5 mm grid within 15 mm of the footprint's path, at " +
                      std::to_string(std::lround(scene.duration_s / scene.sample_s)) + " times in " +
                      (quick ? "0.4" : "1") + " s.";
  return scene;
}

TradeoffScene cantileverScene() {
  constexpr double kLength_m = 0.16;
  constexpr double kWidth_m = 0.02;
  TradeoffScene scene;
  scene.name = "cantilever";
  scene.size_m = Vector3(kLength_m, kWidth_m, kWidth_m);
  scene.fixed_m = Box3(Vector3(-1e-6, -1.0, -1.0), Vector3(1e-6, 1.0, 1.0));
  scene.material = tissue(100e3, 0.25, 1.0);
  scene.probes_m = endFacePoints(kLength_m, kWidth_m, 2);
  // Critically damped, what is left of the load's onset after two periods is 5e-5.
  scene.duration_s = 2.0 * bendingPeriod(scene.material, kLength_m, kWidth_m);
  scene.sample_s = scene.duration_s;
  const double deflection_m = 0.01 * kLength_m;
  const double load_n = deflection_m / timoshenkoDeflection(scene.material, kLength_m, kWidth_m, 1.0);
  std::vector<PointForce> forces;
  constexpr int kPoints = 24;
  for (const Vector3& point : endFacePoints(kLength_m, kWidth_m, kPoints))
    forces.push_back({point, Vector3(0.0, 0.0, -load_n / (kPoints * kPoints))});
  scene.forces = [forces](double) { return forces; };
  scene.known = KnownAnswer{-Vector3::UnitZ(), deflection_m, "Timoshenko's deflection"};
  scene.description =
      "A beam of 160 x 20 x 20 mm (E = 100 kPa, nu = 0.25, 1060 kg/m3, critically damped), clamped at one end, gets a "
      "load at the other and comes to rest. Compared is the deflection of the end with Timoshenko's beam.";
  return scene;
}

Lattice sceneLattice(const TradeoffScene& scene, double spacing_m) {
  Vector3i dims;
  for (int d = 0; d < 3; ++d)
    dims[d] = static_cast<int>(std::lround(scene.size_m[d] / spacing_m));
  const std::size_t cells = std::size_t(dims.x()) * std::size_t(dims.y()) * std::size_t(dims.z());
  const Vector3 spacing = scene.size_m.cwiseQuotient(dims.cast<double>());
  Lattice lattice = makeLattice(dims, spacing, Vector3::Zero(), std::vector<std::int32_t>(cells, 0));
  for (std::size_t v = 0; v < lattice.vertexCount(); ++v)
    lattice.fixed[v] = scene.fixed_m.contains(lattice.rest_positions[v]) ? 1 : 0;
  return lattice;
}

std::vector<VertexLoad> vertexLoads(const Lattice& lattice, const std::vector<PointForce>& forces) {
  std::map<std::uint32_t, Vector3> sums;
  for (const PointForce& point : forces) {
    const CellPlace place = placeOf(lattice, point.rest_point_m);
    for (int corner = 0; corner < 8; ++corner) {
      const double weight = cornerWeight(corner, place.local);
      if (weight > 0.0)
        sums.try_emplace(lattice.cells[place.cell][corner], Vector3::Zero()).first->second += weight * point.force_n;
    }
  }
  std::vector<VertexLoad> loads;
  for (const auto& entry : sums)
    loads.push_back({entry.first, entry.second});
  return loads;
}

std::vector<Vector3> displacementsAt(const Lattice& lattice, const std::vector<Vector3>& displacements_m,
                                     const std::vector<Vector3>& rest_points_m) {
  std::vector<Vector3> values;
  for (const Vector3& point : rest_points_m) {
    const CellPlace place = placeOf(lattice, point);
    Vector3 value = Vector3::Zero();
    for (int corner = 0; corner < 8; ++corner)
      value += cornerWeight(corner, place.local) * displacements_m[lattice.cells[place.cell][corner]];
    values.push_back(value);
  }
  return values;
}

}  // namespace soft_volume::core
