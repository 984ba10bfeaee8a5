#pragma once

#include <memory>
#include <string>
#include <vector>

#include "soft_volume/common/geometry.h"
#include "soft_volume/grid/topology.h"
#include "soft_volume/render/camera.h"
#include "soft_volume/render/image_io.h"
#include "soft_volume/volume/transfer_function.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume::core {

struct LegacyRenderOptions {
  /// Planes over the depth of the grid at rest, 1 to 4096. A deformed grid that is deeper gets more of the same
  /// distance.
  int slices = 125;
  /// 0 draws the transfer function's colours as they are, in about two thirds of the time, 1 with the full light; [0,
  /// 1].
  double shading = 0.7;
  /// Also compute depth, for about a quarter more time.
  bool depth = false;
  /// Accumulated opacity at which depth is taken, in (0, 1).
  double depth_threshold = 0.5;

  /// Throws SceneError when a number is out of range.
  void validate() const;
};

/// A rendered image. Rows from the top, pixels from the left.
struct LegacyFrame {
  int width = 0;
  int height = 0;
  std::vector<float> rgba;     ///< width * height * 4, premultiplied with opacity; never NaN
  std::vector<float> depth_m;  ///< width * height along the camera's z (REP-118), NaN where nothing was hit; or empty
  int slices = 0;              ///< planes drawn
  std::size_t polygons = 0;    ///< drawn
  std::size_t cells = 0;       ///< not transparent under the transfer function, or next to one that is not

  // Wall time of the stages; the only things in a frame that differ between equal calls.
  double transform_ms = 0.0;  ///< vertices to the camera frame, choice of the planes
  double slice_ms = 0.0;      ///< buckets, active cells, polygons
  double render_ms = 0.0;     ///< drawing and reading back

  /// Over an opaque background (RGB in [0, 1]), rounded. Colours are taken as they are, without a display curve.
  Image toRgb8(const Vector3f& background) const;
};

/// LegacySlice-based volume rendering of a deformed grid (dissertation, chapter 3 and section 4.5): the volume is a 3D
/// texture on the cells, the grid is cut by planes parallel to the view plane, and the slices are composited in
/// float32.
///
/// Optical model: emission and absorption. The transfer function is applied per fragment, after interpolation. A slice
/// stands for the slab around it: its value goes linearly from where the ray enters the slab to where it leaves it, and
/// its opacity is that of the ray's whole way through it, distance / cos(angle to the view axis). Slices are composited
/// front to back ("under" operator), with and without depth, so colours do not depend on whether depth is asked for.
/// Depth is where the accumulated opacity passes the threshold, interpolated within the slab (opacity grows
/// exponentially in it).
///
/// Light: one sun fixed to the camera, at the viewer's upper left (direction (-0.4, -0.6, -1) in the optical frame,
/// normalised), diffuse only. The normal is the gradient of the scalar in the deformed grid: along the ray from the
/// slab's two values, across it from three samples one voxel around its middle. Where the scalar hardly changes there
/// is no surface and a mean brightness.
///
/// A pixel that has become opaque to 0.999 takes nothing more, which leaves out less than a quarter of an 8-bit level.
///
/// The image depends on the input alone, not on earlier calls or the number of threads. Cells over which the transfer
/// function is transparent are not drawn.
///
/// Used from one thread at a time, from any thread. Not real-time safe. Limits: hexahedra only; the volume must fit
/// into one 3D texture.
class SliceRenderer {
 public:
  /// Throws Error when there is no OpenGL 4.5 core context.
  SliceRenderer();
  ~SliceRenderer();
  SliceRenderer(const SliceRenderer&) = delete;
  SliceRenderer& operator=(const SliceRenderer&) = delete;

  /// Uploads the volume: 8- and 16-bit integers as normalised 16-bit texels (-32768 becomes -32767), other types as
  /// float32. Throws InputError when it is null or empty, a side is longer than the driver's largest 3D texture, or
  /// memory runs out; the former volume then stays.
  void setVolume(std::shared_ptr<const Volume> volume);
  /// Throws SceneError when it is not valid; the former function then stays.
  void setTransferFunction(const TransferFunction& function);
  /// The rest positions fix the planes. Throws InputError on a topology that is not valid or has cells other than
  /// hexahedra; the former topology then stays.
  void setTopology(const Topology& topology);

  /// `positions`: volume frame, metres, one per vertex of the topology. Throws InputError when their number is wrong,
  /// one is not usable or they span more than ten times the grid's size at rest, or when volume, transfer function or
  /// topology were not set; SceneError on a camera or options out of range. A grid outside the view gives a transparent
  /// frame.
  LegacyFrame render(const Camera& camera, const std::vector<Vector3f>& positions,
                     const LegacyRenderOptions& options = {});

  /// Renderer and version as the driver states them. Frames of equal input are equal where this is equal.
  std::string driver() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace soft_volume::core
