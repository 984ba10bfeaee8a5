#pragma once

#include <array>
#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include "gl_context.h"
#include "soft_volume/render/camera.h"
#include "soft_volume/render/slice_renderer.h"
#include "soft_volume/render/slicer.h"
#include "transfer_table.h"

namespace soft_volume::core {

/// Everything of the slice renderer that talks to OpenGL: the textures, the programs (with and without depth and light)
/// and the float32 targets. Knows no grid. Same thread rules as GlContext.
class SliceCanvas {
 public:
  SliceCanvas();
  ~SliceCanvas();
  SliceCanvas(const SliceCanvas&) = delete;
  SliceCanvas& operator=(const SliceCanvas&) = delete;

  /// Throws InputError as SliceRenderer::setVolume says.
  void setVolume(const Volume& volume);
  void setTable(const TransferTable& table);

  /// Draws the slices and reads the frame back.
  LegacyFrame draw(const Camera& camera, const LegacySliceMesh& mesh, const SlicePlanes& planes,
                   const LegacyRenderOptions& options);
  std::string driver();

 private:
  struct Program;
  static std::size_t programIndex(bool depth, bool shaded) { return std::size_t(depth) + 2 * std::size_t(shaded); }
  void resize(int width, int height);
  void upload(const LegacySliceMesh& mesh);
  void setUniforms(const Program& program, const Camera& camera, double slice_distance_m,
                   const LegacyRenderOptions& options);
  void bindTextures();
  void prepareTargets(bool depth);
  void drawSlices(const Program& program, const LegacySliceMesh& mesh, int first_number, bool depth);
  void drawSlice(const Program& program, const LegacySlice& slice, bool depth);
  void maskOpaquePixels();
  void read(LegacyFrame& frame, bool depth);

  GlContext context_;
  std::array<std::unique_ptr<Program>, 4> programs_;
  GLuint mask_program_ = 0;
  GLuint volume_texture_ = 0;
  GLuint table_texture_ = 0;
  GLuint integral_texture_ = 0;
  GLuint colour_target_ = 0;
  GLuint depth_target_ = 0;
  GLuint mask_target_ = 0;  ///< depth buffer, 0 where a pixel is opaque
  GLuint framebuffer_ = 0;
  GLuint vertex_array_ = 0;
  GLuint vertex_buffer_ = 0;
  GLuint index_buffer_ = 0;
  int width_ = 0;
  int height_ = 0;
  double value_scale_ = 1.0;    ///< texel to scalar
  double normal_step_m_ = 0.0;  ///< how far towards the light the second sample lies
  double table_first_ = 0.0;
  double table_scale_ = 1.0;
};

}  // namespace soft_volume::core
