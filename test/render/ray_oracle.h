#pragma once

#include <cstdint>
#include <limits>
#include <optional>
#include <vector>

#include "soft_volume/grid/irregular_grid.h"
#include "soft_volume/render/camera.h"
#include "soft_volume/volume/transfer_function.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume::core {

/// What the oracle sees along a ray.
struct OraclePixel {
  Eigen::Vector4d rgba = Eigen::Vector4d::Zero();  ///< premultiplied
  double depth_m = std::numeric_limits<double>::quiet_NaN();
};

/// Volume rendering the slow way, as an oracle for the back ends: it marches along the ray in steps that are small
/// beside the cells there, looks for the cell around each point, solves for the point's place in it with the cell's
/// shape functions, and looks the interpolated scalar up. It knows no faces, sorts nothing and integrates nothing but
/// the steps; they are halved until the pixel stays the same. Not thread-safe.
class RayOracle {
 public:
  /// `grid`: its points are in the camera's frame. `texture`: per point, and then `volume` is what is seen; else both
  /// are empty or null, and it is the grid's scalar. Refers to all of them.
  RayOracle(const IrregularGrid& grid, const TransferFunction& function, const std::vector<Vector3f>& texture = {},
            const Volume* volume = nullptr);

  /// Emission and absorption of the ray through pixel (u, v) between two depths, to `accuracy` of the full brightness.
  OraclePixel trace(const Camera& camera, double u, double v, double begin_z, double end_z, double depth_threshold,
                    double accuracy = 2e-4);
  /// The scalar at a point of the camera's frame; nothing outside of all cells.
  std::optional<double> scalarAt(const Vector3& p);

 private:
  /// A part of a cell with shape functions; the vertices of polyhedra's parts may be means.
  struct Part {
    CellType type;
    std::vector<Vector3> points;
    std::vector<Vector3> data;  ///< texture coordinates, or the scalar and two zeros
    Box3 box;
  };

  void addPolyhedron(std::uint32_t cell, const std::uint32_t* stream);
  void addPart(CellType type, std::vector<Vector3> points, std::vector<Vector3> data);
  Vector3 dataOf(std::uint32_t cell, std::uint32_t vertex) const;
  void makeBins();
  std::size_t binOf(const Vector3& p) const;
  bool isIn(const Part& part, const Vector3& p);
  OraclePixel march(const Camera& camera, double u, double v, double begin_z, double end_z, double threshold,
                    double fineness);

  const IrregularGrid& grid_;
  const TransferFunction& function_;
  const std::vector<Vector3f>& texture_;
  const Volume* volume_;
  std::vector<Part> parts_;
  Box3 box_;
  Vector3i bins_ = Vector3i::Ones();
  std::vector<std::vector<std::uint32_t>> parts_in_bin_;
  std::uint32_t last_part_ = 0;
  Vector3 place_ = Vector3::Constant(0.4);  ///< of the last point, in its part
};

}  // namespace soft_volume::core
