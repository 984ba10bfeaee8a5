#include "gl_volume.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "mipmap.h"
#include "soft_volume/common/error.h"
#include "soft_volume/common/parallel.h"
#include "volume_texels.h"

namespace soft_volume::core {
namespace {

GLuint makeSampler(const GlFunctions& gl, GLint min_filter) {
  GLuint sampler = 0;
  gl.GenSamplers(1, &sampler);
  gl.SamplerParameteri(sampler, GL_TEXTURE_MIN_FILTER, min_filter);
  gl.SamplerParameteri(sampler, GL_TEXTURE_MAG_FILTER, GL_LINEAR);
  for (const GLenum wrap : {GL_TEXTURE_WRAP_S, GL_TEXTURE_WRAP_T, GL_TEXTURE_WRAP_R})
    gl.SamplerParameteri(sampler, wrap, GL_CLAMP_TO_EDGE);
  return sampler;
}

template <typename Texel>
std::vector<Texel> copyBox(const Texel* texels, const Vector3i& dims, const VoxelBox& box) {
  const Vector3i size = box.sizes();
  std::vector<Texel> part(std::size_t(size.x()) * std::size_t(size.y()) * std::size_t(size.z()));
  Texel* next = part.data();
  for (int k = box.begin.z(); k < box.end.z(); ++k) {
    for (int j = box.begin.y(); j < box.end.y(); ++j) {
      const std::size_t row = (std::size_t(k) * std::size_t(dims.y()) + std::size_t(j)) * std::size_t(dims.x());
      next = std::copy_n(texels + row + std::size_t(box.begin.x()), size.x(), next);
    }
  }
  return part;
}

/// Labels as whole numbers; what is none is 0.
std::vector<std::uint16_t> labelsIn(const Volume& labels, const VoxelBox& box) {
  const Vector3i size = box.sizes();
  const std::size_t plane = std::size_t(size.x()) * std::size_t(size.y());
  std::vector<std::uint16_t> result(plane * std::size_t(size.z()));
  parallelFor(size.z(), threadsFor(0), [&](std::ptrdiff_t k) {
    std::uint16_t* next = &result[plane * std::size_t(k)];
    for (int j = box.begin.y(); j < box.end.y(); ++j) {
      for (int i = box.begin.x(); i < box.end.x(); ++i) {
        const double label = std::round(labels.at(i, j, box.begin.z() + int(k)));
        *next++ = label >= 0.0 && label <= 65535.0 ? std::uint16_t(label) : std::uint16_t(0);
      }
    }
  });
  return result;
}

}  // namespace

GlVolume::GlVolume(const GlFunctions& gl, int limit)
    : gl_(gl),
      limit_(limit),
      linear_sampler_(makeSampler(gl, GL_LINEAR)),
      mipmap_sampler_(makeSampler(gl, GL_LINEAR_MIPMAP_LINEAR)) {
  if (limit == 0)
    gl.GetIntegerv(GL_MAX_3D_TEXTURE_SIZE, &limit_);
}

GlVolume::~GlVolume() {
  gl_.DeleteSamplers(1, &linear_sampler_);
  gl_.DeleteSamplers(1, &mipmap_sampler_);
}

void GlVolume::setVolume(const Volume& volume) {
  Scene scene = scene_;
  scene.volume = &volume;
  change(std::move(scene), false);
}

void GlVolume::setLabels(const Volume* labels) {
  Scene scene = scene_;
  scene.labels = labels;
  change(std::move(scene), false);
}

void GlVolume::setCells(std::vector<std::array<Vector3f, 2>> boxes) {
  Scene scene = scene_;
  scene.boxes = std::move(boxes);
  change(std::move(scene), true);
}

void GlVolume::change(Scene scene, bool same_voxels) {
  if (scene.volume == nullptr || scene.boxes.empty()) {
    if (!same_voxels)
      textures_.clear();
    scene_ = std::move(scene);
    return;
  }
  const Vector3i label_dims = scene.labels != nullptr ? scene.labels->geometry().dims : Vector3i(Vector3i::Zero());
  BrickLayout layout = layoutBricks(scene.boxes, scene.volume->geometry().dims, label_dims, limit_);
  const auto isSame = [](const BrickTextures& a, const Brick& b) { return a.brick == b; };
  if (!same_voxels ||
      !std::equal(textures_.begin(), textures_.end(), layout.bricks.begin(), layout.bricks.end(), isSame)) {
    const VolumeTexels texels(*scene.volume);
    std::vector<BrickTextures> textures;
    for (const Brick& brick : layout.bricks)
      textures.push_back(upload(scene, texels, brick));
    textures_ = std::move(textures);
  }
  scene_ = std::move(scene);
  brick_of_cell_ = std::move(layout.brick_of_cell);
  max_level_ = layout.max_level;
}

/// Straight out of the volume's memory where the driver can read its type.
GlVolume::BrickTextures GlVolume::upload(const Scene& scene, const VolumeTexels& texels, const Brick& brick) const {
  BrickTextures textures;
  textures.brick = brick;
  textures.value_scale = texels.scale();
  const Vector3i dims = scene.volume->geometry().dims;
  const Vector3i size = brick.volume.sizes();
  gl_.ActiveTexture(GL_TEXTURE0 + kVolumeUnit);
  gl_.PixelStorei(GL_UNPACK_ALIGNMENT, 1);
  gl_.PixelStorei(GL_UNPACK_ROW_LENGTH, dims.x());
  gl_.PixelStorei(GL_UNPACK_IMAGE_HEIGHT, dims.y());
  gl_.PixelStorei(GL_UNPACK_SKIP_PIXELS, brick.volume.begin.x());
  gl_.PixelStorei(GL_UNPACK_SKIP_ROWS, brick.volume.begin.y());
  gl_.PixelStorei(GL_UNPACK_SKIP_IMAGES, brick.volume.begin.z());
  textures.volume = GlTexture(gl_, GL_TEXTURE_3D, GL_LINEAR);
  gl_.TexImage3D(GL_TEXTURE_3D, 0, texels.internalFormat(), size.x(), size.y(), size.z(), 0, GL_RED, texels.type(),
                 texels.data());
  for (const GLenum state : {GL_UNPACK_ROW_LENGTH, GL_UNPACK_IMAGE_HEIGHT, GL_UNPACK_SKIP_PIXELS, GL_UNPACK_SKIP_ROWS,
                             GL_UNPACK_SKIP_IMAGES})
    gl_.PixelStorei(state, 0);
  requireMemory();
  if (scene.labels == nullptr)
    return textures;
  const std::vector<std::uint16_t> labels = labelsIn(*scene.labels, brick.labels);
  const Vector3i label_size = brick.labels.sizes();
  textures.labels = GlTexture(gl_, GL_TEXTURE_3D, GL_NEAREST);
  gl_.TexImage3D(GL_TEXTURE_3D, 0, GL_R16UI, label_size.x(), label_size.y(), label_size.z(), 0, GL_RED_INTEGER,
                 GL_UNSIGNED_SHORT, labels.data());
  requireMemory();
  return textures;
}

void GlVolume::requireMemory() const {
  if (gl_.GetError() != GL_NO_ERROR)
    throw InputError("the volume does not fit into texture memory; read it with a stride or a region of interest");
}

void GlVolume::addLevels(BrickTextures& textures) {
  const VolumeTexels texels(*scene_.volume);
  const auto add = [&](const auto* all) {
    Vector3i dims = textures.brick.volume.sizes();
    auto level = copyBox(all, scene_.volume->geometry().dims, textures.brick.volume);
    while (dims.maxCoeff() > 1 && textures.levels <= max_level_) {
      level = halveVolume(level.data(), dims);
      dims = halvedDims(dims);
      gl_.TexImage3D(GL_TEXTURE_3D, textures.levels++, texels.internalFormat(), dims.x(), dims.y(), dims.z(), 0, GL_RED,
                     texels.type(), level.data());
    }
  };
  gl_.PixelStorei(GL_UNPACK_ALIGNMENT, 1);
  switch (texels.type()) {
    case GL_SHORT:
      add(static_cast<const std::int16_t*>(texels.data()));
      break;
    case GL_UNSIGNED_SHORT:
      add(static_cast<const std::uint16_t*>(texels.data()));
      break;
    default:
      add(static_cast<const float*>(texels.data()));
      break;
  }
  gl_.TexParameteri(GL_TEXTURE_3D, GL_TEXTURE_MAX_LEVEL, textures.levels - 1);
  requireMemory();
}

void GlVolume::use(std::size_t brick, const GlProgram& program, double level) {
  BrickTextures& textures = textures_[brick];
  if (hasLabels()) {
    gl_.ActiveTexture(GL_TEXTURE0 + kLabelUnit);
    gl_.BindTexture(GL_TEXTURE_3D, textures.labels.id());
  }
  gl_.ActiveTexture(GL_TEXTURE0 + kVolumeUnit);
  gl_.BindTexture(GL_TEXTURE_3D, textures.volume.id());
  if (level > 0.0 && textures.levels == 1)
    addLevels(textures);
  gl_.BindSampler(kVolumeUnit, level > 0.0 ? mipmap_sampler_ : linear_sampler_);
  gl_.Uniform1f(program["level"], float(std::min(level, double(max_level_))));
  gl_.Uniform1f(program["value_scale"], float(textures.value_scale));
  setMaps(textures, program);
}

/// From the volume's texture coordinates to the brick's, and from these to those of its labels.
void GlVolume::setMaps(const BrickTextures& textures, const GlProgram& program) const {
  using Array = Eigen::Array3d;
  const auto set = [&](const char* name, const Array& value) {
    gl_.Uniform3f(program[name], float(value.x()), float(value.y()), float(value.z()));
  };
  const Array dims = scene_.volume->geometry().dims.cast<double>();
  const Array begin = textures.brick.volume.begin.cast<double>();
  const Array size = textures.brick.volume.sizes().cast<double>();
  set("brick_scale", dims / size);
  set("brick_offset", -begin / size);
  if (!hasLabels())
    return;
  const Array label_dims = scene_.labels->geometry().dims.cast<double>();
  const Array label_begin = textures.brick.labels.begin.cast<double>();
  const Array label_size = textures.brick.labels.sizes().cast<double>();
  set("label_scale", size / dims * label_dims / label_size);
  set("label_offset", (begin / dims * label_dims - label_begin) / label_size);
}

}  // namespace soft_volume::core
