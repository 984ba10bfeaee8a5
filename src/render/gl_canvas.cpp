#include "gl_canvas.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "light.h"
#include "mipmap.h"
#include "soft_volume/common/error.h"
#include "soft_volume/common/parallel.h"
#include "soft_volume/grid/cell_shape.h"
#include "volume_texels.h"

namespace soft_volume::core {
namespace {

/// Clear value of the depth target; a pixel that keeps it was not hit.
constexpr float kFar = std::numeric_limits<float>::max();

/// Behind this opacity a pixel takes nothing more: what is left out is below a quarter of an 8-bit level.
constexpr float kOpaque = 0.999F;
/// Opaque pixels are masked before the first plane of every so many on their ladder: places that do not depend on the
/// deformation, so that the image changes only where the grid does. More often costs more than it saves.
constexpr int kPlanesPerMask = 8;
/// Marks of planes in the 8-bit stencil buffer: from 1, and one that no plane has and that the buffer never holds.
constexpr GLint kLastMark = 254;
constexpr GLint kNoPlane = 255;
constexpr double kEverywhere = std::numeric_limits<double>::infinity();

std::vector<std::array<Vector3f, 2>> textureBoxes(const DrawnGrid& grid) {
  std::vector<std::array<Vector3f, 2>> boxes;
  boxes.reserve(grid.cellCount());
  for (std::size_t cell = 0; cell < grid.cellCount(); ++cell) {
    Eigen::AlignedBox3f box;
    const auto extend = [&](std::uint32_t vertex) { box.extend(grid.texture[vertex]); };
    const std::uint32_t* begin = &grid.connectivity[grid.cell_offsets[cell]];
    if (grid.cell_types[cell] == CellType::kPolyhedron) {
      for (const std::uint32_t vertex : verticesOfPolyhedron(begin))
        extend(vertex);
    } else {
      std::for_each(begin, &grid.connectivity[0] + grid.cell_offsets[cell + 1], extend);
    }
    boxes.push_back({box.min(), box.max()});
  }
  return boxes;
}

/// Of the numbers that are finite.
std::array<double, 2> rangeOf(const std::vector<float>& scalars) {
  std::array<float, 2> range = {kFar, -kFar};
  for (const float scalar : scalars) {
    if (std::isfinite(scalar))
      range = {std::min(range[0], scalar), std::max(range[1], scalar)};
  }
  return {double(range[0]), double(range[1])};
}

/// With colours times absorption.
TransferTable::Entry weighted(const TransferTable::Entry& entry) {
  return {entry[0] * entry[3], entry[1] * entry[3], entry[2] * entry[3], entry[3]};
}

void attach(const GlFunctions& gl, GLenum attachment, const GlTexture& texture, GLint format, GLenum components,
            GLenum type, int width, int height) {
  gl.BindTexture(GL_TEXTURE_2D, texture.id());
  gl.TexImage2D(GL_TEXTURE_2D, 0, format, width, height, 0, components, type, nullptr);
  gl.FramebufferTexture2D(GL_FRAMEBUFFER, attachment, GL_TEXTURE_2D, texture.id(), 0);
}

}  // namespace

/// What lives in the context.
struct GlCanvas::Objects {
  Objects(const GlFunctions& functions, int max_texture_side)
      : gl(functions),
        volume(functions, max_texture_side),
        mask(functions, kMaskVertexShader, kMaskFragmentShader),
        table(functions, GL_TEXTURE_1D, GL_NEAREST),
        means(functions, GL_TEXTURE_1D, GL_NEAREST),
        colour_target(functions, GL_TEXTURE_2D, GL_NEAREST),
        depth_target(functions, GL_TEXTURE_2D, GL_NEAREST),
        label_target(functions, GL_TEXTURE_2D, GL_NEAREST),
        mask_target(functions, GL_TEXTURE_2D, GL_NEAREST) {
    mask.use();
    gl.Uniform1f(mask["opaque"], kOpaque);
    gl.GenFramebuffers(1, &framebuffer);
    gl.GenVertexArrays(1, &vertex_array);
    gl.GenBuffers(1, &vertex_buffer);
    gl.GenBuffers(1, &index_buffer);
  }
  ~Objects() {
    gl.DeleteFramebuffers(1, &framebuffer);
    gl.DeleteVertexArrays(1, &vertex_array);
    gl.DeleteBuffers(1, &vertex_buffer);
    gl.DeleteBuffers(1, &index_buffer);
  }
  Objects(const Objects&) = delete;
  Objects& operator=(const Objects&) = delete;

  const GlFunctions& gl;
  GlVolume volume;
  std::map<unsigned, std::unique_ptr<GlProgram>> programs;  ///< by GlVariant::key(), made when first used
  GlProgram mask;
  GlTexture table;
  GlTexture means;  ///< integrals, then entries with colours times absorption
  GlTexture colour_target;
  GlTexture depth_target;
  GlTexture label_target;
  GlTexture mask_target;  ///< depth, 0 where a pixel is opaque, and stencil, the marks of planes
  GLuint framebuffer = 0;
  GLuint vertex_array = 0;
  GLuint vertex_buffer = 0;
  GLuint index_buffer = 0;
  int width = 0;
  int height = 0;
  bool has_depth = false;  ///< depth_target and label_target have the size, too
};

GlCanvas::GlCanvas(int max_texture_side) {
  const GlContext::Current current(context_);
  objects_ = std::make_unique<Objects>(gl(), max_texture_side);
  is_software_ = context_.isSoftware();
}

GlCanvas::~GlCanvas() {
  if (glHasEnded()) {
    keepBeyondGl(std::move(objects_));
    return;
  }
  const GlContext::Current current(context_);
  objects_.reset();
}

void GlCanvas::setVolume(const Volume& volume) {
  const GlContext::Current current(context_);
  objects_->volume.setVolume(volume);
  volume_range_ = scalarRanges(volume, {{Vector3f::Zero(), Vector3f::Ones()}}).front();
  if (grid_ != nullptr)
    step_m_ = shadingStep(*grid_, &volume.geometry());
}

void GlCanvas::setLabels(const Volume* labels) {
  const GlContext::Current current(context_);
  objects_->volume.setLabels(labels);
}

void GlCanvas::setGrid(const DrawnGrid& grid) {
  const GlContext::Current current(context_);
  objects_->volume.setCells(grid.isTextured() ? textureBoxes(grid) : std::vector<std::array<Vector3f, 2>>());
  grid_ = &grid;
  grid_range_ = rangeOf(grid.point_scalars);
  buffers_.setGrid(grid);
  mean_map_ = grid.isTextured() ? buffers_.meanTextureMap() : Matrix3(Matrix3::Zero());
  const Volume* volume = objects_->volume.volume();
  if (!grid.isTextured() || volume != nullptr)
    step_m_ = shadingStep(grid, grid.isTextured() ? &volume->geometry() : nullptr);
}

void GlCanvas::setTable(const TransferTable& table) {
  const GlContext::Current current(context_);
  const auto fill = [&](const GlTexture& texture, const std::vector<TransferTable::Entry>& entries) {
    gl().BindTexture(GL_TEXTURE_1D, texture.id());
    gl().TexImage1D(GL_TEXTURE_1D, 0, GL_RGBA32F, GLsizei(entries.size()), 0, GL_RGBA, GL_FLOAT, entries.data());
  };
  fill(objects_->table, table.entries());
  std::vector<TransferTable::Entry> means = table.integrals();
  for (const TransferTable::Entry& entry : table.entries())
    means.push_back(weighted(entry));
  fill(objects_->means, means);
  table_ = table;
}

GlVariant GlCanvas::variantOf(const DrawJob& job) const {
  const RenderOptions& options = job.options;
  GlVariant variant;
  const bool by_colour = options.lookup == Lookup::kColour && grid_->cell_scalars.empty();
  variant.source = grid_->isTextured() ? GlSource::kTexture : by_colour ? GlSource::kColour : GlSource::kScalar;
  variant.slab_values = grid_->isTextured() || !grid_->point_scalars.empty();
  const std::array<double, 2>& range = grid_->isTextured() ? volume_range_ : grid_range_;
  const double last_value = table_->firstValue() + (TransferTable::kSize - 1) / table_->entriesPerValue();
  variant.beyond = range[0] < table_->firstValue() || range[1] > last_value;
  variant.cross_section = job.cross_section;
  variant.shaded = options.shading > 0.0 && !job.cross_section;
  variant.depth = options.depth || options.labels;
  variant.labels = options.labels && objects_->volume.hasLabels() && grid_->isTextured();
  variant.clipped = !options.clip_planes.empty() && !job.cross_section;
  variant.jitter = options.jitter && !job.cross_section;
  variant.parallel = job.camera.projection == Projection::kParallel;
  return variant;
}

void GlCanvas::resize(int width, int height, bool depth) {
  Objects& o = *objects_;
  gl().BindFramebuffer(GL_FRAMEBUFFER, o.framebuffer);
  gl().Viewport(0, 0, width, height);
  if (width == o.width && height == o.height && (o.has_depth || !depth))
    return;
  o.width = 0;  // in case that something throws
  gl().ActiveTexture(GL_TEXTURE0 + kAccumulatedUnit);
  attach(gl(), GL_COLOR_ATTACHMENT0, o.colour_target, GL_RGBA32F, GL_RGBA, GL_FLOAT, width, height);
  for (const auto& [attachment, texture] : {std::pair(GL_COLOR_ATTACHMENT1, &o.depth_target),  //
                                            std::pair(GL_COLOR_ATTACHMENT2, &o.label_target)}) {
    if (depth)
      attach(gl(), GLenum(attachment), *texture, GL_R32F, GL_RED, GL_FLOAT, width, height);
    else  // one of another size would cut off the picture
      gl().FramebufferTexture2D(GL_FRAMEBUFFER, GLenum(attachment), GL_TEXTURE_2D, 0, 0);
  }
  attach(gl(), GL_DEPTH_STENCIL_ATTACHMENT, o.mask_target, GL_DEPTH24_STENCIL8, GL_DEPTH_STENCIL, GL_UNSIGNED_INT_24_8,
         width, height);
  if (gl().CheckFramebufferStatus(GL_FRAMEBUFFER) != GL_FRAMEBUFFER_COMPLETE)
    throw Error("the OpenGL driver has no float32 render target of " + std::to_string(width) + " x " +
                std::to_string(height) + " pixels");
  o.width = width;
  o.height = height;
  o.has_depth = depth;
}

/// Colour goes under what is there; of the depths the nearest stays, of the labels the largest, which are all 0 but
/// one.
void GlCanvas::prepareTargets() const {
  const std::array<GLenum, 3> targets = {GL_COLOR_ATTACHMENT0, GL_COLOR_ATTACHMENT1, GL_COLOR_ATTACHMENT2};
  gl().DrawBuffers(variant_.labels ? 3 : variant_.depth ? 2 : 1, targets.data());
  gl().Enable(GL_BLEND);
  gl().BlendFunci(0, GL_ONE_MINUS_DST_ALPHA, GL_ONE);
  gl().BlendEquationi(0, GL_FUNC_ADD);
  gl().BlendEquationi(1, GL_MIN);
  gl().BlendEquationi(2, GL_MAX);
  const PixelRect& rect = job_->rect;
  gl().Enable(GL_SCISSOR_TEST);
  gl().Scissor(rect.begin_x, rect.begin_y, rect.end_x - rect.begin_x, rect.end_y - rect.begin_y);
  const std::array<float, 4> zero{};
  const std::array<float, 4> far{kFar, kFar, kFar, kFar};
  gl().ClearBufferfv(GL_COLOR, 0, zero.data());
  if (variant_.depth)
    gl().ClearBufferfv(GL_COLOR, 1, far.data());
  if (variant_.labels)
    gl().ClearBufferfv(GL_COLOR, 2, zero.data());
  const float not_opaque = 1.0F;
  const GLint not_hit = 0;
  gl().Disable(GL_STENCIL_TEST);
  if (job_->options.adaptive)
    gl().ClearBufferiv(GL_STENCIL, 0, &not_hit);
  gl().Disable(GL_DEPTH_TEST);  // until pixels are masked
  gl().DepthFunc(GL_LESS);
  gl().DepthMask(GL_TRUE);
  gl().ClearBufferfv(GL_DEPTH, 0, &not_opaque);
  gl().DepthMask(GL_FALSE);
}

void GlCanvas::bindTextures() const {
  const auto bind = [&](GLint unit, GLenum target, const GlTexture& texture) {
    gl().ActiveTexture(GLenum(GL_TEXTURE0 + unit));
    gl().BindTexture(target, texture.id());
  };
  bind(kTableUnit, GL_TEXTURE_1D, objects_->table);
  bind(kMeanUnit, GL_TEXTURE_1D, objects_->means);
  bind(kAccumulatedUnit, GL_TEXTURE_2D, objects_->colour_target);
}

void GlCanvas::begin(const DrawJob& job) {
  job_.emplace(job);
  polygons_ = 0;
  slices_ = 0;
  program_ = nullptr;
  mask_block_.reset();
  mark_ = kNoPlane;
  back_m_ = 0.0;
  if (job.rect.empty())
    return;
  variant_ = variantOf(job);
  first_masked_rung_ = firstMaskedRung();
  const GlContext::Current current(context_);
  resize(job.camera.width, job.camera.height, variant_.depth);
  prepareTargets();
  bindTextures();
  buffers_.begin(job, variant_, *table_, slicingThreads(job.options.threads));
}

void GlCanvas::draw(const SliceMesh& mesh) {
  polygons_ += mesh.polygons.size();
  slices_ += int(mesh.slices.size());
  if (job_->rect.empty())
    return;
  const GlContext::Current current(context_);
  buffers_.build(mesh, objects_->volume.brickOfCell());
  upload();
  for (std::size_t first = 0, plane = 0; first < mesh.slices.size(); first = plane + 1) {
    plane = first;
    while (plane < mesh.slices.size() && mesh.slices[plane].extra)
      ++plane;
    const double border_m = plane < mesh.slices.size() ? double(mesh.slices[plane].front_m) : back_m_;
    drawExtras(mesh, first, plane, {-kEverywhere, border_m});
    if (plane < mesh.slices.size())
      drawPlane(mesh, plane);
    else
      mark_ = kNoPlane;
    drawExtras(mesh, first, plane, {border_m, kEverywhere});
  }
}

void GlCanvas::drawPlane(const SliceMesh& mesh, std::size_t number) {
  const Slice& slice = mesh.slices[number];
  back_m_ = double(slice.back_m);
  maskWhereDue(slice);
  if (job_->options.adaptive) {
    takeNextMark();
    setStencil(GL_ALWAYS, GL_REPLACE);
  }
  drawSlice(slice, slabOf(slice), buffers_.batches()[number]);
}

void GlCanvas::takeNextMark() {
  mark_ = mark_ < kLastMark ? mark_ + 1 : 1;
  const GLint not_hit = 0;
  if (mark_ == 1)
    gl().ClearBufferiv(GL_STENCIL, 0, &not_hit);
}

void GlCanvas::setStencil(GLenum function, GLenum write) const {
  gl().Enable(GL_STENCIL_TEST);
  gl().StencilFunc(function, mark_, 0xFF);
  gl().StencilOp(GL_KEEP, GL_KEEP, write);
}

/// Slices [begin, end), as far as their slabs lie in `part_m`, where the last plane was not hit.
void GlCanvas::drawExtras(const SliceMesh& mesh, std::size_t begin, std::size_t end,
                          const std::array<double, 2>& part_m) {
  if (begin < end)
    setStencil(GL_NOTEQUAL, GL_KEEP);
  for (std::size_t i = begin; i < end; ++i) {
    const Slice& slice = mesh.slices[i];
    const std::array<double, 2> slab_m = slabOf(slice);
    drawSlice(slice,
              {std::max(slab_m[0], part_m[0] - double(slice.z_m)), std::min(slab_m[1], part_m[1] - double(slice.z_m))},
              buffers_.batches()[i]);
  }
}

void GlCanvas::upload() const {
  const auto fill = [&](GLenum target, GLuint buffer, const auto& data) {
    gl().BindBuffer(target, buffer);
    gl().BufferData(target, GLsizeiptr(data.size() * sizeof(data[0])), data.data(), GL_STREAM_DRAW);
  };
  gl().BindVertexArray(objects_->vertex_array);
  fill(GL_ARRAY_BUFFER, objects_->vertex_buffer, buffers_.vertices());
  fill(GL_ELEMENT_ARRAY_BUFFER, objects_->index_buffer, buffers_.indices());
  std::vector<int> sizes = attributeSizes(variant_);
  sizes.insert(sizes.begin(), 2);
  constexpr GLuint kLocations = 5;
  std::size_t offset = 0;
  for (GLuint location = 0; location < kLocations; ++location) {
    if (location >= sizes.size()) {
      gl().DisableVertexAttribArray(location);
      continue;
    }
    gl().EnableVertexAttribArray(location);
    gl().VertexAttribPointer(location, sizes[location], GL_FLOAT, GL_FALSE,
                             GLsizei(buffers_.floatsPerVertex() * sizeof(float)),
                             reinterpret_cast<const void*>(offset * sizeof(float)));
    offset += std::size_t(sizes[location]);
  }
}

/// From and to, behind the slice; empty (from >= to) outside near and far.
std::array<double, 2> GlCanvas::slabOf(const Slice& slice) const {
  const double z_m = slice.z_m;
  return {std::max(double(slice.front_m), job_->camera.near_m) - z_m,
          std::min(double(slice.back_m), job_->camera.far_m) - z_m};
}

/// Of the mipmap: how many times a pixel has to be halved to be no wider than a voxel.
double GlCanvas::levelOf(const Slice& slice) const {
  if (variant_.source != GlSource::kTexture)
    return 0.0;
  const Camera& camera = job_->camera;
  const double depth = camera.projection == Projection::kPerspective ? double(slice.z_m) : 1.0;
  const Vector3i& dims = objects_->volume.volume()->geometry().dims;
  return std::max(0.0, std::log2(depth * pixelWidth(camera, dims, mean_map_)));
}

const GlProgram& GlCanvas::useProgram(double level) {
  GlVariant variant = variant_;
  variant.mipmapped = level > 0.0;
  auto& program = objects_->programs[variant.key()];
  if (!program)
    program = std::make_unique<GlProgram>(gl(), vertexShader(variant), fragmentShader(variant));
  program->use();
  if (program_ != program.get())
    setFrameUniforms(*program);
  program_ = program.get();
  return *program;
}

void GlCanvas::setFrameUniforms(const GlProgram& program) const {
  const Camera& camera = job_->camera;
  const RenderOptions& options = job_->options;
  gl().Uniform2f(program["image_size"], float(camera.width), float(camera.height));
  gl().Uniform4f(program["pinhole"], float(camera.cx), float(camera.cy), float(1.0 / camera.fx),
                 float(1.0 / camera.fy));
  gl().Uniform2f(program["table_map"], float(table_->firstValue()), float(table_->entriesPerValue()));
  gl().Uniform2f(program["value_range"], float(grid_range_[0]), float(grid_range_[1]));
  gl().Uniform4fv(program["low_end"], 1, weighted(table_->entries().front()).data());
  gl().Uniform4fv(program["high_end"], 1, weighted(table_->entries().back()).data());
  gl().Uniform1f(program["surface_scale"],
                 float(step_m_ * kEdgesPerRange * table_->entriesPerValue() / TransferTable::kSize));
  const Vector3f light = lightDirection();
  const Vector3f highlight = highlightDirection();
  gl().Uniform4f(program["light"], light.x(), light.y(), light.z(), float(options.shading));
  gl().Uniform4f(program["highlight"], highlight.x(), highlight.y(), highlight.z(),
                 float(options.shading * options.specular));
  gl().Uniform1f(program["threshold"], float(options.depth_threshold));
}

void GlCanvas::setSlice(const GlProgram& program, const Slice& slice, const std::array<double, 2>& slab_m,
                        double level) const {
  gl().Uniform2f(program["slab"], float(slab_m[0]), float(slab_m[1]));
  gl().Uniform1f(program["spacing"],
                 float(slice.extra ? job_->planes.distance_m : double(slice.back_m) - double(slice.front_m)));
  gl().Uniform1f(program["slice_z"], slice.z_m);
  gl().Uniform1f(program["normal_step"], float(step_m_ * std::exp2(level)));
  if (variant_.clipped)
    setClipPlanes(program, double(slice.z_m));
}

/// In the camera frame, with offsets from the point of the camera's axis at the slice, so that float numbers are exact
/// to a small part of a slab.
void GlCanvas::setClipPlanes(const GlProgram& program, double slice_z_m) const {
  const Pose& T_volume_camera = job_->camera.T_volume_camera;
  std::array<float, 4 * RenderOptions::kMaxClipPlanes> planes{};
  float* next = planes.data();
  for (const ClipPlane& plane : job_->options.clip_planes) {
    const Vector3 normal = T_volume_camera.orientation.conjugate() * plane.normal;
    const double offset_m = plane.offset_m - plane.normal.dot(T_volume_camera.position_m) - normal.z() * slice_z_m;
    for (const double number : {normal.x(), normal.y(), normal.z(), offset_m})
      *next++ = float(number);
  }
  gl().Uniform4fv(program["clip_planes"], RenderOptions::kMaxClipPlanes, planes.data());
  gl().Uniform1i(program["clip_count"], int(job_->options.clip_planes.size()));
}

void GlCanvas::drawSlice(const Slice& slice, const std::array<double, 2>& slab_m,
                         const std::vector<SliceBuffers::Batch>& batches) {
  if (batches.empty() || (!variant_.cross_section && !(slab_m[0] < slab_m[1])))
    return;
  const double level = levelOf(slice);
  const GlProgram& program = useProgram(level);
  setSlice(program, slice, slab_m, level);
  if (variant_.depth)
    gl().TextureBarrier();  // the shader reads the opacity that the slices before have left
  for (const SliceBuffers::Batch& batch : batches) {
    if (variant_.source == GlSource::kTexture)
      objects_->volume.use(batch.brick, program, level);
    gl().DrawElements(GL_TRIANGLES, GLsizei(batch.index_count), GL_UNSIGNED_INT,
                      reinterpret_cast<const void*>(batch.first_index * sizeof(std::uint32_t)));
  }
}

void GlCanvas::maskWhereDue(const Slice& slice) {
  const double rung = rungOf(job_->planes, slice);
  const double block = std::floor(rung / kPlanesPerMask);
  if (rung < first_masked_rung_ || mask_block_ == block)
    return;
  mask_block_ = block;
  maskOpaquePixels();
}

/// The first one that a ray from the grid's front at rest can reach opaque, where the way is longest and the transfer
/// function densest.
double GlCanvas::firstMaskedRung() const {
  const auto less = [](const TransferTable::Entry& a, const TransferTable::Entry& b) { return a[3] < b[3]; };
  const double absorption = double((*std::max_element(table_->entries().begin(), table_->entries().end(), less))[3]);
  const Camera& camera = job_->camera;
  double lengthening = 1.0;
  if (camera.projection == Projection::kPerspective) {
    const double x = std::max(std::abs(camera.cx), std::abs(camera.width - camera.cx)) / camera.fx;
    const double y = std::max(std::abs(camera.cy), std::abs(camera.height - camera.cy)) / camera.fy;
    lengthening = std::sqrt(1.0 + x * x + y * y);
  }
  return -std::log2(1.0 - double(kOpaque)) / (absorption * job_->planes.distance_m * lengthening);
}

void GlCanvas::maskOpaquePixels() const {
  gl().TextureBarrier();  // the mask reads what the slices before have left
  gl().Disable(GL_STENCIL_TEST);
  gl().Enable(GL_DEPTH_TEST);
  objects_->mask.use();
  gl().ColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  gl().DepthMask(GL_TRUE);
  gl().DrawArrays(GL_TRIANGLES, 0, 3);
  gl().DepthMask(GL_FALSE);
  gl().ColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
}

void GlCanvas::finish(Frame& frame) {
  frame.polygons = polygons_;
  frame.slices = slices_;
  frame.fragments = 0;
  if (!job_->rect.empty()) {
    const GlContext::Current current(context_);
    readColour(frame);
    if (job_->options.depth)
      readDepth(frame);
    if (job_->options.labels)
      readLabels(frame);
    if (gl().GetError() != GL_NO_ERROR)
      throw Error("OpenGL reported an error while a frame was drawn");
  }
  job_.reset();
}

void GlCanvas::readColour(Frame& frame) const {
  const PixelRect& rect = job_->rect;
  gl().PixelStorei(GL_PACK_ALIGNMENT, 1);
  gl().PixelStorei(GL_PACK_ROW_LENGTH, frame.width);
  gl().PixelStorei(GL_PACK_SKIP_PIXELS, rect.begin_x);
  gl().PixelStorei(GL_PACK_SKIP_ROWS, rect.begin_y);
  gl().ReadBuffer(GL_COLOR_ATTACHMENT0);
  gl().ReadPixels(rect.begin_x, rect.begin_y, rect.end_x - rect.begin_x, rect.end_y - rect.begin_y, GL_RGBA, GL_FLOAT,
                  frame.rgba.data());
  for (const GLenum state : {GL_PACK_ROW_LENGTH, GL_PACK_SKIP_PIXELS, GL_PACK_SKIP_ROWS})
    gl().PixelStorei(state, 0);
}

/// The job's rectangle of a target of one component.
std::vector<float> GlCanvas::readRed(GLenum attachment) const {
  const PixelRect& rect = job_->rect;
  std::vector<float> values(rect.pixels());
  gl().ReadBuffer(attachment);
  gl().ReadPixels(rect.begin_x, rect.begin_y, rect.end_x - rect.begin_x, rect.end_y - rect.begin_y, GL_RED, GL_FLOAT,
                  values.data());
  return values;
}

void GlCanvas::readDepth(Frame& frame) const {
  const std::vector<float> depths = readRed(GL_COLOR_ATTACHMENT1);
  auto next = depths.begin();
  const PixelRect& rect = job_->rect;
  for (int y = rect.begin_y; y < rect.end_y; ++y) {
    for (int x = rect.begin_x; x < rect.end_x; ++x, ++next) {
      const std::size_t pixel = std::size_t(y) * std::size_t(frame.width) + std::size_t(x);
      frame.depth_m[pixel] = *next == kFar ? std::numeric_limits<float>::quiet_NaN() : *next;
    }
  }
}

void GlCanvas::readLabels(Frame& frame) const {
  const PixelRect& rect = job_->rect;
  const std::vector<float> labels =
      variant_.labels ? readRed(GL_COLOR_ATTACHMENT2) : std::vector<float>(rect.pixels(), 0.0F);
  auto next = labels.begin();
  for (int y = rect.begin_y; y < rect.end_y; ++y) {
    for (int x = rect.begin_x; x < rect.end_x; ++x, ++next)
      frame.labels[std::size_t(y) * std::size_t(frame.width) + std::size_t(x)] = std::uint16_t(*next);
  }
}

int GlCanvas::slicingThreads(int wanted) const {
  return is_software_ ? 1 : threadsFor(wanted);
}

std::string GlCanvas::driver() const {
  const GlContext::Current current(context_);
  const auto text = [this](GLenum name) { return reinterpret_cast<const char*>(gl().GetString(name)); };
  return std::string(context_.makerName()) + ", " + text(GL_RENDERER) + ", " + text(GL_VERSION);
}

}  // namespace soft_volume::core
