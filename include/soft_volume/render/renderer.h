#pragma once

#include <array>
#include <memory>
#include <string>
#include <vector>

#include "soft_volume/common/geometry.h"
#include "soft_volume/grid/irregular_grid.h"
#include "soft_volume/grid/topology.h"
#include "soft_volume/render/camera.h"
#include "soft_volume/render/image_io.h"
#include "soft_volume/volume/transfer_function.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume::core {

/// What makes the image. gl and native draw the same slices; exact draws no slices but integrates every cell.
enum class Backend {
  kGl,      ///< OpenGL 4.5: OSMesa, or EGL without a surface
  kNative,  ///< our own rasteriser of slices, on threads
  kExact,   ///< every face of every cell, sorted per pixel: the reference for the two others
};

/// How a scalar that is given at vertices gets its colour (dissertation, section 3.4.2). Volumes are textures always.
enum class Lookup {
  kScalar,  ///< the scalar is interpolated, every fragment looks its colour up
  kColour,  ///< the vertices look their colours up, colour and absorption are interpolated
};

/// Keeps what lies where normal . p <= offset_m.
struct ClipPlane {
  Vector3 normal = Vector3::UnitX();  ///< volume frame, unit length
  double offset_m = 0.0;
};

struct RenderOptions {
  static constexpr int kMaxClipPlanes = 8;

  /// Planes over the depth of the grid at rest, 1 to 4096. A deformed grid that is deeper gets more of the same
  /// distance.
  int slices = 125;
  double step_m = 0.0;  ///< distance of the planes; 0: from `slices`. At most 4096 planes are drawn
  Lookup lookup = Lookup::kScalar;
  /// 0 draws the transfer function's colours as they are, 1 with the full light; [0, 1].
  double shading = 0.7;
  double specular = 0.2;  ///< strength of the highlight when shaded, [0, 1]
  /// Boundary faces get their exact depth instead of half a slice distance. native only; exact always does.
  bool exact_boundary = false;
  /// Cells between two planes are cut too (dissertation, section 3.7.1).
  bool adaptive = false;
  /// Displaces each pixel's samples by a fixed pattern of up to half a slice distance: noise instead of bands.
  bool jitter = false;
  bool depth = false;            ///< also compute depth
  double depth_threshold = 0.5;  ///< accumulated opacity at which depth and label are taken, in (0, 1)
  bool labels = false;           ///< also compute the label image; needs setLabels
  std::vector<ClipPlane> clip_planes;
  int threads = 0;  ///< of native and exact; 0: all cores. Never changes the image

  /// Throws SceneError when a number is out of range.
  void validate() const;
};

/// Half-open.
struct PixelRect {
  int begin_x = 0;
  int begin_y = 0;
  int end_x = 0;
  int end_y = 0;
  bool empty() const { return begin_x >= end_x || begin_y >= end_y; }
  std::size_t pixels() const { return empty() ? 0 : std::size_t(end_x - begin_x) * std::size_t(end_y - begin_y); }
};

/// A rendered image. Rows from the top, pixels from the left.
struct Frame {
  int width = 0;
  int height = 0;
  std::vector<float> rgba;            ///< width * height * 4, premultiplied with opacity; never NaN
  std::vector<float> depth_m;         ///< along the camera's z (REP-118), NaN where nothing was hit; or empty
  std::vector<std::uint16_t> labels;  ///< at the place of the depth, 0 where nothing was hit; or empty
  PixelRect updated;                  ///< all that was drawn anew lies in it; the rest is as before

  int slices = 0;             ///< planes drawn
  std::size_t polygons = 0;   ///< drawn; faces in exact
  std::size_t cells = 0;      ///< that may show something under the transfer function
  std::size_t fragments = 0;  ///< samples composited; segments in exact; 0 in gl, which does not know

  // Wall time of the stages (Table 5.1); the only things in a frame that differ between equal calls.
  double transform_ms = 0.0;  ///< vertices to the camera frame, choice of the planes
  double bucket_ms = 0.0;
  double slice_ms = 0.0;   ///< active lists, polygons
  double render_ms = 0.0;  ///< filling and compositing

  double totalMs() const { return transform_ms + bucket_ms + slice_ms + render_ms; }
  /// Over an opaque background (RGB in [0, 1]), rounded. Colours are taken as they are, without a display curve.
  Image toRgb8(const Vector3f& background) const;
};

/// Volume rendering of an irregular or deformed grid (dissertation, chapter 3): the grid is cut by planes parallel to
/// the view plane, and the slices are composited front to back in float32. Data are either a volume, which is a 3D
/// texture on the cells of a topology, or a grid with scalars.
///
/// Optical model: emission and absorption; opacity per unit distance, so that images do not depend on the distance of
/// the planes. Between two planes the scalar goes linearly from one sample to the next, and the transfer function is
/// integrated over that way.
///
/// Interpolants: "trilinear" in hexahedra and voxels, linear in tetrahedra; in other cells linear along edges and
/// between them. gl interpolates linearly over the triangles of a polygon's fan instead.
///
/// Light: one sun fixed to the camera at the viewer's upper left (direction (-0.4, -0.6, -1) in the optical frame,
/// normalised), diffuse and specular. Normals are gradients of the scalar in the deformed grid.
///
/// The image depends on the input alone, not on earlier calls or the number of threads. When nothing but positions
/// changed since the last call, only the rectangle that the change touches is drawn; the frame is the same as if all
/// were.
///
/// Used from one thread at a time, from any thread. Not real-time safe.
class Renderer {
 public:
  /// Throws Error when there is no OpenGL 4.5 core context for kGl.
  explicit Renderer(Backend backend);
  ~Renderer();
  Renderer(const Renderer&) = delete;
  Renderer& operator=(const Renderer&) = delete;

  /// Throws InputError when it is null, empty, or too large for the back end; the former volume then stays.
  void setVolume(std::shared_ptr<const Volume> volume);
  /// A segmentation on any grid of its own over the same box; null for none.
  void setLabels(std::shared_ptr<const Volume> labels);
  /// Throws SceneError when it is not valid; the former function then stays.
  void setTransferFunction(const TransferFunction& function);
  /// Draws the volume on these cells. The rest positions fix the planes. Throws InputError when not valid; the former
  /// grid then stays.
  void setTopology(const Topology& topology);
  /// Draws the grid's scalars instead of a volume. Throws InputError when not valid; the former grid then stays.
  void setGrid(const IrregularGrid& grid);

  /// `positions`: volume frame, metres, one per vertex of the grid. Throws InputError when their number is wrong, one
  /// is not usable or they span more than ten times the grid's size at rest, or when grid, volume or transfer function
  /// were not set; SceneError on a camera or options out of range. A grid outside the view gives a transparent frame.
  /// The reference is valid until the next call.
  const Frame& render(const Camera& camera, const std::vector<Vector3f>& positions, const RenderOptions& options = {});
  /// The grid at rest.
  const Frame& render(const Camera& camera, const RenderOptions& options = {});
  /// One slice through the grid at depth z_m of the camera frame, with the transfer function's colours and without
  /// transparency (Figure 5.2). Throws as render(), and InputError where the depth is not between near and far. Not for
  /// kExact.
  const Frame& renderCrossSection(const Camera& camera, const std::vector<Vector3f>& positions, double z_m);
  /// The grid at rest.
  const Frame& renderCrossSection(const Camera& camera, double z_m);
  /// The slices of the last frame's view and positions, seen from another camera (dissertation, section 3.7.3): for
  /// while a view changes, as it cuts nothing anew. Good up to some 45 degrees, empty at 90. Throws InputError when
  /// nothing was drawn yet. Not for kExact.
  const Frame& renderStored(const Camera& camera);
  /// Forgets the last frame, so that the next call draws everything.
  void forgetFrame();

  /// What draws, as far as it decides the picture: frames of equal input are equal where this is equal.
  std::string driver() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

/// A topology of cells, each a box of `cell_voxels` voxels at most, that fills a volume: how a regular volume is drawn.
/// With 0 it is a single cell (dissertation, section 3.4.2).
Topology volumeTopology(const VolumeGeometry& geometry, int cell_voxels = 0);

/// The box of all vertices; for cameras that are to see the whole grid.
Box3 boundsOf(const std::vector<Vector3f>& points);

}  // namespace soft_volume::core
