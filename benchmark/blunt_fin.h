#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "soft_volume/common/error.h"
#include "soft_volume/grid/irregular_grid.h"
#include "soft_volume/render/camera.h"
#include "soft_volume/volume/transfer_function.h"

/// What the renderer is measured on: the blunt fin (Hung and Buning 1985, a NASA PLOT3D sample), three transfer
/// functions of its density and the four views of the dissertation's Figure 5.1. Shared by benchmark, tests and tools.
namespace soft_volume::core {

/// The folder of bluntfinxyz.bin and bluntfinq.bin below $SOFT_VOLUME_DATA, by default the folder shared/data beside
/// the sources; empty when the files are not there.
inline std::string bluntFinFolder(const std::string& source_folder) {
  const char* variable = std::getenv("SOFT_VOLUME_DATA");
  const std::string data = variable != nullptr ? variable : source_folder + "/../shared/data";
  const std::string folder = data + "/blunt_fin";
  const bool there = std::filesystem::exists(folder + "/bluntfinxyz.bin") &&  //
                     std::filesystem::exists(folder + "/bluntfinq.bin");
  return there ? folder : "";
}

namespace blunt_fin_detail {

inline std::vector<std::uint8_t> readBytes(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::vector<std::uint8_t> bytes((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
  if (bytes.empty())
    throw FileError(path + ": cannot be read");
  return bytes;
}

/// Big-endian four-byte words from byte `begin` on.
template <typename Word>
std::vector<Word> words(const std::vector<std::uint8_t>& bytes, std::size_t begin, std::size_t count,
                        const std::string& path) {
  if (begin + 4 * count > bytes.size())
    throw FileError(path + ": is shorter than its sizes say; fetch it again");
  std::vector<Word> result(count);
  for (std::size_t i = 0; i < count; ++i) {
    const std::uint8_t* b = &bytes[begin + 4 * i];
    const std::uint32_t bits =
        std::uint32_t(b[0]) << 24 | std::uint32_t(b[1]) << 16 | std::uint32_t(b[2]) << 8 | std::uint32_t(b[3]);
    std::memcpy(&result[i], &bits, 4);
  }
  return result;
}

inline std::array<std::uint32_t, 3> dimensions(const std::vector<std::uint8_t>& bytes, const std::string& path) {
  const auto dims = words<std::uint32_t>(bytes, 0, 3, path);
  for (const std::uint32_t n : dims) {
    if (n < 2 || n > 1024)
      throw FileError(path + ": is not a big-endian PLOT3D file of one block");
  }
  return {dims[0], dims[1], dims[2]};
}

}  // namespace blunt_fin_detail

/// Vertices i + ni (j + nj k) of a curvilinear grid as hexahedra, cells in the same order.
inline void addHexahedra(const std::array<std::uint32_t, 3>& dims, IrregularGrid& grid) {
  const auto vertex = [&](std::uint32_t i, std::uint32_t j, std::uint32_t k) {
    return i + dims[0] * (j + dims[1] * k);
  };
  grid.cell_offsets.assign(1, 0);
  for (std::uint32_t k = 0; k + 1 < dims[2]; ++k) {
    for (std::uint32_t j = 0; j + 1 < dims[1]; ++j) {
      for (std::uint32_t i = 0; i + 1 < dims[0]; ++i) {
        for (const std::uint32_t corner :
             {vertex(i, j, k), vertex(i + 1, j, k), vertex(i + 1, j + 1, k), vertex(i, j + 1, k), vertex(i, j, k + 1),
              vertex(i + 1, j, k + 1), vertex(i + 1, j + 1, k + 1), vertex(i, j + 1, k + 1)})
          grid.connectivity.push_back(corner);
        grid.cell_types.push_back(CellType::kHexahedron);
        grid.cell_offsets.push_back(std::uint32_t(grid.connectivity.size()));
      }
    }
  }
}

/// The blunt fin with its density (0.193 to 4.978): 40 x 32 x 32 vertices, 37,479 hexahedra of which 38 are degenerate.
/// Throws FileError.
inline IrregularGrid readBluntFin(const std::string& folder) {
  const std::string grid_path = folder + "/bluntfinxyz.bin";
  const std::string solution_path = folder + "/bluntfinq.bin";
  const auto grid_bytes = blunt_fin_detail::readBytes(grid_path);
  const auto solution_bytes = blunt_fin_detail::readBytes(solution_path);
  const auto dims = blunt_fin_detail::dimensions(grid_bytes, grid_path);
  if (blunt_fin_detail::dimensions(solution_bytes, solution_path) != dims)
    throw FileError(solution_path + ": has other dimensions than " + grid_path);
  const std::size_t count = std::size_t(dims[0]) * dims[1] * dims[2];
  const auto xyz = blunt_fin_detail::words<float>(grid_bytes, 12, 3 * count, grid_path);
  IrregularGrid grid;
  // Before the density come the dimensions and the flow's Mach number, angle, Reynolds number and time.
  grid.point_scalars = blunt_fin_detail::words<float>(solution_bytes, 28, count, solution_path);
  for (std::size_t i = 0; i < count; ++i)
    grid.points.emplace_back(xyz[i], xyz[count + i], xyz[2 * count + i]);
  addHexahedra(dims, grid);
  return grid;
}

/// TF-A, haze: low opacities over the whole range of the density, the flow at rest (density 1) in pale blue.
///   density  0.19  0.6   1.0   1.8   3.2   5.0
///   opacity  0.02  0.05  0.04  0.16  0.32  0.50   per unit of length of the grid
inline TransferFunction hazeFunction() {
  TransferFunction function;
  function.points = {{0.19, {0.10F, 0.10F, 0.60F}, 0.02F}, {0.6, {0.10F, 0.60F, 0.90F}, 0.05F},
                     {1.0, {0.60F, 0.80F, 1.00F}, 0.04F},  {1.8, {0.30F, 0.90F, 0.30F}, 0.16F},
                     {3.2, {1.00F, 0.80F, 0.10F}, 0.32F},  {5.0, {1.00F, 0.20F, 0.10F}, 0.50F}};
  function.unit_distance_m = 1.0;
  return function;
}

/// TF-B, narrow peaks: triangles of half width 0.03 at the densities 0.55 (blue, opacity 0.90), 1.5 (green, 0.95), 2.4
/// (yellow, 0.95) and 3.6 (red, 0.98) per unit of length; exactly transparent between them. Colours change only where
/// nothing is seen.
inline TransferFunction peaksFunction() {
  struct Peak {
    double value;
    Vector3f colour;
    float opacity;
  };
  const std::array<Peak, 4> peaks = {{{0.55, {0.20F, 0.40F, 1.00F}, 0.90F},
                                      {1.5, {0.20F, 0.90F, 0.30F}, 0.95F},
                                      {2.4, {1.00F, 0.90F, 0.20F}, 0.95F},
                                      {3.6, {1.00F, 0.25F, 0.15F}, 0.98F}}};
  TransferFunction function;
  for (const Peak& peak : peaks) {
    function.points.push_back({peak.value - 0.03, peak.colour, 0.0F});
    function.points.push_back({peak.value, peak.colour, peak.opacity});
    function.points.push_back({peak.value + 0.03, peak.colour, 0.0F});
  }
  function.unit_distance_m = 1.0;
  return function;
}

/// TF-C, opaque: transparent up to the density 0.6, 0.98 per unit of length from 0.8, 0.999 from 1.5 on.
inline TransferFunction opaqueFunction() {
  TransferFunction function;
  function.points = {{0.6, {0.15F, 0.30F, 0.90F}, 0.0F},
                     {0.8, {0.20F, 0.60F, 1.00F}, 0.98F},
                     {1.5, {0.30F, 0.90F, 0.40F}, 0.999F},
                     {3.0, {1.00F, 0.80F, 0.20F}, 0.999F},
                     {5.0, {1.00F, 0.20F, 0.10F}, 0.999F}};
  function.unit_distance_m = 1.0;
  return function;
}

struct NamedFunction {
  std::string name;
  TransferFunction function;
};

inline std::vector<NamedFunction> bluntFinFunctions() {
  return {{"haze", hazeFunction()}, {"peaks", peaksFunction()}, {"opaque", opaqueFunction()}};
}

/// Looks at the blunt fin's centre from `angle_rad` about y away from its +z side, x to the right, y upwards, parallel;
/// at 0 the grid fills 95 % of the image from left to right.
inline Camera bluntFinCamera(double angle_rad, int width = 640, int height = 480) {
  const Vector3 centre(3.27323, 4.16378, 2.86213);
  const double length = 22.17795;
  const double distance = 40.0;
  const Vector3 view(std::sin(angle_rad), 0.0, -std::cos(angle_rad));
  Camera camera = Camera::lookAtParallel(centre - distance * view, centre, Vector3::UnitY(),
                                         length / 0.95 * height / width, width, height);
  camera.near_m = 1.0;
  camera.far_m = 100.0;
  return camera;
}

/// A view of Figure 5.1 with the polygons that its slices have there.
struct BluntFinView {
  std::string name;
  Camera camera;
  int slices;
  std::size_t polygons;  ///< Table 5.1; at "straight" with 50 slices the dissertation counts 49 of them
};

inline std::vector<BluntFinView> bluntFinViews() {
  const Camera straight = bluntFinCamera(0.0);
  const Camera angle = bluntFinCamera(M_PI / 4);
  return {{"straight", straight, 50, 59241},
          {"angle", angle, 50, 45371},
          {"straight", straight, 100, 120900},
          {"angle", angle, 100, 90784}};
}

}  // namespace soft_volume::core
