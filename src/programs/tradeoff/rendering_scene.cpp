#include "rendering_scene.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <utility>

#include "soft_volume/common/error.h"
#include "soft_volume/grid/lattice.h"
#include "soft_volume/volume/volume_reader.h"

namespace soft_volume::core {
namespace {

// ---------------------------------------------------------------------------------------------- the curvilinear grid

/// Parameters in [0, 1]^3: along the flow, away from the wall, along the obstacle.
Vector3 curvilinearPoint(double a, double b, double c) {
  const double angle = M_PI * (0.1 + 0.8 * a) + 0.25 * std::sin(2.0 * c) + 0.05 * std::sin(9.0 * b + 2.0 * c);
  const double radius = (0.8 + 3.2 * (0.2 * b + 0.8 * b * b)) * (1.0 + 0.1 * std::sin(2.0 * M_PI * c + 3.0 * a));
  const double height = 5.0 * c + 0.2 * std::sin(6.0 * a + 4.0 * b);
  return {radius * std::cos(angle), height, radius * std::sin(angle)};
}

/// From 0 to 1: low before a bow front, high behind it, highest where the flow meets the wall.
double flowDensity(const Vector3& p) {
  const double radius = std::hypot(p.x(), p.z());
  const double front = 1.9 + 0.25 * p.x() + 0.2 * std::sin(1.3 * p.y());
  const double behind = 0.5 * (1.0 - std::tanh(3.0 * (radius - front)));
  const double stagnation = std::exp(-std::pow(p.x() + 0.6, 2) - 2.0 * std::pow(radius - 0.9, 2));
  const double waves = 0.08 * std::sin(3.0 * p.x()) * std::cos(2.0 * p.y() + p.z());
  return std::clamp(0.15 + 0.4 * behind + 0.35 * stagnation + waves, 0.0, 1.0);
}

IrregularGrid curvilinearGrid(std::uint32_t cells_per_side) {
  const std::uint32_t vertices = cells_per_side + 1;
  IrregularGrid grid;
  for (std::uint32_t k = 0; k < vertices; ++k) {
    for (std::uint32_t j = 0; j < vertices; ++j) {
      for (std::uint32_t i = 0; i < vertices; ++i) {
        const Vector3 p = curvilinearPoint(double(i) / cells_per_side, double(j) / cells_per_side,  //
                                           double(k) / cells_per_side);
        grid.points.push_back(p.cast<float>());
        grid.point_scalars.push_back(float(flowDensity(p)));
      }
    }
  }
  addHexahedra({vertices, vertices, vertices}, grid);
  return grid;
}

TransferFunction functionOf(double unit_distance_m, const std::vector<TransferFunction::Point>& points) {
  TransferFunction function;
  function.points = points;
  function.unit_distance_m = unit_distance_m;
  return function;
}

/// The functions of the blunt fin for a scalar from 0 to 1.
std::vector<NamedFunction> flowFunctions() {
  const Vector3f blue(0.2F, 0.4F, 1.0F);
  const Vector3f green(0.2F, 0.9F, 0.3F);
  const Vector3f yellow(1.0F, 0.9F, 0.2F);
  const Vector3f red(1.0F, 0.25F, 0.15F);
  return {{"haze", functionOf(1.0, {{0.0, blue, 0.02F}, {0.3, green, 0.1F}, {0.6, yellow, 0.3F}, {1.0, red, 0.5F}})},
          {"peaks", functionOf(1.0, {{0.18, blue, 0.0F},
                                     {0.20, blue, 0.9F},
                                     {0.22, blue, 0.0F},
                                     {0.33, green, 0.0F},
                                     {0.35, green, 0.95F},
                                     {0.37, green, 0.0F},
                                     {0.68, red, 0.0F},
                                     {0.70, red, 0.98F},
                                     {0.72, red, 0.0F}})},
          {"opaque",
           functionOf(1.0, {{0.15, blue, 0.0F}, {0.2, green, 0.98F}, {0.4, yellow, 0.999F}, {1.0, red, 0.999F}})}};
}

// --------------------------------------------------------------------------------------------------- the MRI lattice

std::string mriPath() {
  if (const char* cache = std::getenv("SOFT_VOLUME_CACHE"))
    return std::string(cache) + "/ch2.nii.gz";
  if (const char* cache = std::getenv("XDG_CACHE_HOME"))
    return std::string(cache) + "/soft_volume/ch2.nii.gz";
  const char* home = std::getenv("HOME");
  return std::string(home != nullptr ? home : "") + "/.cache/soft_volume/ch2.nii.gz";
}

/// Bent about x by a quarter of a radian from end to end, squeezed at half height by 8 %, with ripples of 3 mm.
Vector3 deformed(const Vector3& p, const Box3& box) {
  const Vector3 s = (p - box.min()).cwiseQuotient(box.sizes());
  const Vector3 from_centre = p - box.center();
  const double squeeze = 1.0 - 0.08 * std::sin(M_PI * s.z());
  const Vector3 squeezed(from_centre.x() * squeeze, from_centre.y() * squeeze, from_centre.z());
  const double bend = 0.25 * (s.y() - 0.5);
  const Vector3 bent(squeezed.x(), std::cos(bend) * squeezed.y() - std::sin(bend) * squeezed.z(),
                     std::sin(bend) * squeezed.y() + std::cos(bend) * squeezed.z());
  const Vector3 ripple(std::sin(9.0 * s.y() + 4.0 * s.z()), std::sin(7.0 * s.z()), std::sin(8.0 * s.x() + 5.0 * s.y()));
  return box.center() + bent + 0.003 * ripple;
}

/// Signal of the template: below 20 air, bone and liquor, brain from 60 to 180, fat above 200.
std::vector<NamedFunction> mriFunctions() {
  const Vector3f skin(0.88F, 0.66F, 0.55F);
  const Vector3f brain(0.84F, 0.60F, 0.55F);
  const Vector3f fat(1.0F, 0.95F, 0.80F);
  return {
      {"haze",
       functionOf(
           0.001,
           {{0.0, skin, 0.0F}, {15.0, skin, 0.0F}, {45.0, skin, 0.01F}, {120.0, brain, 0.02F}, {255.0, fat, 0.06F}})},
      {"peaks", functionOf(0.001, {{24.0, skin, 0.0F},
                                   {30.0, skin, 0.6F},
                                   {36.0, skin, 0.0F},
                                   {204.0, fat, 0.0F},
                                   {215.0, fat, 0.9F},
                                   {226.0, fat, 0.0F}})}};
}

Volume mriRegion() {
  const Volume head = readVolume(mriPath());
  const Vector3i begin(26, 8, 12);
  const Vector3i end = begin + Vector3i(129, 200, 158);
  return head.region(begin, end, {1, 1, 2});
}

Topology latticeTopology(const Volume& volume, const Vector3i& cells) {
  const Box3 box = volume.geometry().bounds();
  const std::vector<std::int32_t> materials(std::size_t(cells.prod()), 0);
  const Lattice lattice = makeLattice(cells, box.sizes().cwiseQuotient(cells.cast<double>()), box.min(), materials);
  return makeTopology(lattice, volume.geometry(), 1);
}

RenderingView perspectiveView(const std::string& name, const Box3& box, const Vector3& direction, const Vector3& up) {
  return {name, [=](int width, int height) {
            const double fov_rad = 0.6;
            const double distance_m = 0.65 * box.diagonal().norm() / std::tan(0.5 * fov_rad);
            return Camera::lookAt(box.center() + distance_m * direction.normalized(), box.center(), up, fov_rad, width,
                                  height);
          }};
}

// ----------------------------------------------------------------------------------------------------------- a touch

/// The part of the image that a cell covers, and how far from the middle of the touch its nearest vertex appears.
struct CellImage {
  double distance = std::numeric_limits<double>::infinity();
  Eigen::AlignedBox2d box;
};

Eigen::Vector2d pixelOf(const Camera& camera, const Vector3f& position) {
  return camera.project(camera.T_volume_camera.inverse() * position.cast<double>());
}

const std::vector<std::uint32_t>& connectivityOf(const RenderingScene& scene) {
  return scene.volume ? scene.topology.connectivity : scene.grid.connectivity;
}

/// All cells of the scenes are hexahedra.
std::vector<CellImage> cellImages(const RenderingScene& scene, const Camera& camera, const Eigen::Vector2d& middle) {
  const std::vector<std::uint32_t>& connectivity = connectivityOf(scene);
  std::vector<CellImage> cells(connectivity.size() / 8);
  for (std::size_t n = 0; n < connectivity.size(); ++n) {
    const Eigen::Vector2d pixel = pixelOf(camera, scene.positions[connectivity[n]]);
    cells[n / 8].distance = std::min(cells[n / 8].distance, (pixel - middle).norm());
    cells[n / 8].box.extend(pixel);
  }
  std::sort(cells.begin(), cells.end(), [](const CellImage& a, const CellImage& b) { return a.distance < b.distance; });
  return cells;
}

/// Radius in pixels within which vertices move so that the cells at them span the wanted area.
double touchRadius(const std::vector<CellImage>& cells, const Camera& camera, double wanted_pixels) {
  const Eigen::AlignedBox2d image(Eigen::Vector2d(0.0, 0.0), Eigen::Vector2d(camera.width, camera.height));
  Eigen::AlignedBox2d rect;
  double radius = 0.0;
  double nearest = std::numeric_limits<double>::infinity();
  for (std::size_t n = 0; n + 1 < cells.size(); ++n) {
    rect.extend(cells[n].box);
    const double off = std::abs(rect.intersection(image).volume() - wanted_pixels);
    if (off < nearest && cells[n + 1].distance > cells[n].distance) {
      nearest = off;
      radius = 0.5 * (cells[n].distance + cells[n + 1].distance);
    }
  }
  return radius;
}

}  // namespace

RenderingView parallelView(const std::string& name, const Box3& box, const Vector3& direction, const Vector3& up) {
  return {name, [=](int width, int height) {
            const Vector3 back = direction.normalized();
            const Vector3 right = up.cross(back).normalized();
            const Vector3 above = back.cross(right);
            const double across_m = box.sizes().dot(right.cwiseAbs());
            const double tall_m = box.sizes().dot(above.cwiseAbs());
            const double height_m = std::max(tall_m, across_m * height / width) / 0.95;
            const double distance_m = 2.0 * box.diagonal().norm();
            Camera camera =
                Camera::lookAtParallel(box.center() + distance_m * back, box.center(), up, height_m, width, height);
            camera.near_m = 0.1 * distance_m;
            camera.far_m = 2.0 * distance_m;
            return camera;
          }};
}

RenderingScene curvilinearScene(std::size_t cells) {
  const auto per_side = static_cast<std::uint32_t>(std::lround(std::cbrt(double(cells))));
  RenderingScene scene;
  scene.name = "curvilinear";
  scene.grid = curvilinearGrid(per_side);
  scene.positions = scene.grid.points;
  scene.functions = flowFunctions();
  scene.description = "A curvilinear grid of " + std::to_string(scene.grid.cellCount()) +
                      " warped hexahedra around an obstacle, nine times finer at the wall than far from it, with a "
                      "density that has a front across the cells; made by formulas, so that no file is needed.";
  const Box3 box = boundsOf(scene.positions);
  scene.views = {parallelView("straight", box, Vector3::UnitZ(), Vector3::UnitY()),
                 parallelView("angle", box, {1.0, 0.0, 1.0}, Vector3::UnitY()),
                 parallelView("oblique", box, {-0.5, 0.4, 0.8}, Vector3::UnitY())};
  return scene;
}

std::unique_ptr<RenderingScene> mriLatticeScene(std::string& why_not) {
  auto scene = std::make_unique<RenderingScene>();
  try {
    scene->volume = std::make_shared<const Volume>(mriRegion());
  } catch (const Error& error) {
    why_not = std::string(error.what()) + " (scripts/sample_data makes the sample volumes)";
    return nullptr;
  }
  scene->name = "mri_lattice";
  scene->description =
      "129 x 200 x 79 voxels of the sample MRI of a head on 10 x 20 x 16 cells, bent about x by 0.25 rad from end to "
      "end, squeezed by 8 % and rippled by 3 mm.";
  scene->topology = latticeTopology(*scene->volume, {10, 20, 16});
  const Box3 box = scene->volume->geometry().bounds();
  for (const Vector3f& p : scene->topology.rest_positions)
    scene->positions.push_back(deformed(p.cast<double>(), box).cast<float>());
  scene->functions = mriFunctions();
  const Box3 drawn = boundsOf(scene->positions);
  scene->views = {parallelView("straight", drawn, -Vector3::UnitX(), Vector3::UnitZ()),
                  parallelView("angle", drawn, {-1.0, 1.0, 0.3}, Vector3::UnitZ()),
                  perspectiveView("perspective", drawn, {-0.6, 1.0, 0.4}, Vector3::UnitZ())};
  scene->slices = 125;
  return scene;
}

std::unique_ptr<Renderer> makeRenderer(const RenderingScene& scene, Backend backend) {
  auto renderer = std::make_unique<Renderer>(backend);
  if (scene.volume) {
    renderer->setVolume(scene.volume);
    renderer->setTopology(scene.topology);
  } else {
    renderer->setGrid(scene.grid);
  }
  renderer->setTransferFunction(scene.functions.front().function);
  return renderer;
}

std::vector<Vector3f> touched(const RenderingScene& scene, const Camera& camera, double part) {
  const Box3 box = boundsOf(scene.positions);
  const Eigen::Vector2d middle = pixelOf(camera, box.center().cast<float>());
  const double radius = touchRadius(cellImages(scene, camera, middle), camera, part * camera.width * camera.height);
  const Vector3 push = 0.003 * box.diagonal().norm() * (camera.T_volume_camera.orientation * Vector3(0.3, 0.3, 1.0));
  std::vector<Vector3f> positions = scene.positions;
  for (Vector3f& p : positions) {
    const double r = (pixelOf(camera, p) - middle).norm() / radius;
    if (r < 1.0)
      p += (push * (1.0 - r * r)).cast<float>();
  }
  return positions;
}

double rmseLevels(const Frame& image, const Frame& reference) {
  if (image.rgba.size() != reference.rgba.size())
    throw InputError("images of different size cannot be compared: render both with one camera");
  double squares = 0.0;
  std::size_t count = 0;
  for (std::size_t p = 0; p + 3 < image.rgba.size(); p += 4) {
    double pixel = 0.0;
    bool black = true;
    for (std::size_t c = p; c < p + 3; ++c) {
      pixel += std::pow(255.0 * (double(image.rgba[c]) - double(reference.rgba[c])), 2);
      black = black && image.rgba[c] == 0.0F && reference.rgba[c] == 0.0F;
    }
    squares += pixel;
    count += black ? 0 : 3;
  }
  return count > 0 ? std::sqrt(squares / double(count)) : 0.0;
}

}  // namespace soft_volume::core
