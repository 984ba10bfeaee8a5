#pragma once

#include <array>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "canvas.h"
#include "gl_context.h"
#include "gl_program.h"
#include "gl_shaders.h"
#include "gl_volume.h"
#include "slice_buffers.h"

namespace soft_volume::core {

/// Draws slices with OpenGL into float32 targets (dissertation, section 3.4.2). What is given at vertices is
/// interpolated linearly over the triangles of each polygon.
///
/// A slice is drawn where its plane cuts a cell and stands for its slab there: the scalar goes linearly from where the
/// ray enters the slab to where it leaves it, by its derivative along the ray. Each pixel's slab ends at the clip
/// planes and at near and far. The images of a rectangle are the same bits as those of the whole.
///
/// The planes' slabs fill the depth. With adaptive slicing an extra plane lies between two of them, and its slab in
/// theirs: it is drawn only in pixels that they do not hit, the part that belongs to the front one where that does not,
/// the rest where the back one does not. So no ray takes any depth twice. The stencil buffer holds the mark of the
/// plane that hit each pixel last.
///
/// Textures seen from so far that a pixel is wider than a voxel are looked up in a mipmap of the scalars, at the level
/// that fits the slice's depth and the mean shape of the voxels in the grid at rest.
///
/// Same thread rules as GlContext.
class GlCanvas : public Canvas {
 public:
  /// `max_texture_side`: longest side of a 3D texture in voxels, at least 16; 0: what the driver takes. Throws Error
  /// when there is no OpenGL 4.5.
  explicit GlCanvas(int max_texture_side = 0);
  ~GlCanvas() override;
  GlCanvas(const GlCanvas&) = delete;
  GlCanvas& operator=(const GlCanvas&) = delete;

  /// These throw InputError when the volume, or what a cell needs of it, is too large for the driver; the former state
  /// then stays.
  void setVolume(const Volume& volume) override;
  void setLabels(const Volume* labels) override;
  void setGrid(const DrawnGrid& grid) override;

  void setTable(const TransferTable& table) override;
  void begin(const DrawJob& job) override;
  void draw(const SliceMesh& mesh) override;
  void finish(Frame& frame) override;
  std::string driver() const override;
  /// One where the driver's own threads draw what was sliced before: those of OpenMP, which wait for their next work in
  /// a loop, would take the cores away from them.
  int slicingThreads(int wanted) const override;

 private:
  struct Objects;

  const GlFunctions& gl() const { return context_.gl(); }
  GlVariant variantOf(const DrawJob& job) const;
  void resize(int width, int height, bool depth);
  void prepareTargets() const;
  void bindTextures() const;

  const GlProgram& useProgram(double level);
  void setFrameUniforms(const GlProgram& program) const;
  void setSlice(const GlProgram& program, const Slice& slice, const std::array<double, 2>& slab_m, double level) const;
  void setClipPlanes(const GlProgram& program, double slice_z_m) const;

  void upload() const;
  std::array<double, 2> slabOf(const Slice& slice) const;
  double firstMaskedRung() const;
  void drawPlane(const SliceMesh& mesh, std::size_t number);
  void drawExtras(const SliceMesh& mesh, std::size_t begin, std::size_t end, const std::array<double, 2>& part_m);
  void takeNextMark();
  void setStencil(GLenum function, GLenum write) const;
  double levelOf(const Slice& slice) const;
  void drawSlice(const Slice& slice, const std::array<double, 2>& slab_m,
                 const std::vector<SliceBuffers::Batch>& batches);
  void maskWhereDue(const Slice& slice);
  void maskOpaquePixels() const;

  std::vector<float> readRed(GLenum attachment) const;
  void readColour(Frame& frame) const;
  void readDepth(Frame& frame) const;
  void readLabels(Frame& frame) const;

  mutable GlContext context_;
  std::unique_ptr<Objects> objects_;
  bool is_software_ = false;
  const DrawnGrid* grid_ = nullptr;
  SliceBuffers buffers_;
  std::optional<TransferTable> table_;
  std::array<double, 2> volume_range_{};  ///< scalars of the volume
  std::array<double, 2> grid_range_{};    ///< scalars of the grid's points
  double step_m_ = 1.0;                   ///< shadingStep() of grid and volume
  Matrix3 mean_map_ = Matrix3::Zero();    ///< change of the texture coordinates per metre of the volume frame, at rest

  // While a job is drawn.
  std::optional<DrawJob> job_;
  GlVariant variant_;
  const GlProgram* program_ = nullptr;  ///< in use, with the job's uniforms
  double first_masked_rung_ = 0.0;      ///< opaque pixels are not looked for before it
  std::optional<double> mask_block_;    ///< where on the ladder of planes opaque pixels were masked last
  GLint mark_ = 0;                      ///< of the last plane that is no extra one
  double back_m_ = 0.0;                 ///< where its slab ends
  std::size_t polygons_ = 0;
  int slices_ = 0;
};

}  // namespace soft_volume::core
