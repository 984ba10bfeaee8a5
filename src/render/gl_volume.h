#pragma once

#include <array>
#include <memory>
#include <vector>

#include "gl_context.h"
#include "gl_program.h"
#include "soft_volume/volume/volume.h"
#include "volume_bricks.h"
#include "volume_texels.h"

namespace soft_volume::core {

/// Texture units that the shaders of gl_shaders.h name.
enum : GLint { kVolumeUnit, kTableUnit, kMeanUnit, kAccumulatedUnit, kLabelUnit };

/// A volume and its segmentation as 3D textures, in bricks where one texture cannot hold them, with mipmaps that are
/// made when they are first needed. All calls need the context current.
class GlVolume {
 public:
  /// `limit`: longest side of a texture in voxels; 0: what the driver takes.
  GlVolume(const GlFunctions& gl, int limit);
  ~GlVolume();
  GlVolume(const GlVolume&) = delete;
  GlVolume& operator=(const GlVolume&) = delete;

  /// Both stay alive until the next call. Throw InputError when a cell or the whole is too large; the former state then
  /// stays. Textures are made as soon as volume and cells are known.
  void setVolume(const Volume& volume);
  void setLabels(const Volume* labels);
  /// Boxes of the cells' texture coordinates, {low, high}.
  void setCells(std::vector<std::array<Vector3f, 2>> boxes);

  const Volume* volume() const { return scene_.volume; }
  bool hasLabels() const { return scene_.labels != nullptr; }
  /// Empty where there is one brick.
  const std::vector<std::uint32_t>& brickOfCell() const { return brick_of_cell_; }
  /// Makes a brick the one that `program`, which is in use, draws with. `level` of the mipmap, 0 for none.
  void use(std::size_t brick, const GlProgram& program, double level);

 private:
  struct Scene {
    const Volume* volume = nullptr;
    const Volume* labels = nullptr;
    std::vector<std::array<Vector3f, 2>> boxes;
  };
  struct BrickTextures {
    Brick brick;
    GlTexture volume;
    GlTexture labels;
    int levels = 1;            ///< that the volume's texture has
    double value_scale = 1.0;  ///< texel times this is the scalar
  };

  void change(Scene scene, bool same_voxels);
  BrickTextures upload(const Scene& scene, const VolumeTexels& texels, const Brick& brick) const;
  void requireMemory() const;
  void addLevels(BrickTextures& textures);
  void setMaps(const BrickTextures& textures, const GlProgram& program) const;

  const GlFunctions& gl_;
  int limit_ = 0;
  Scene scene_;
  std::vector<std::uint32_t> brick_of_cell_;
  int max_level_ = 0;
  std::vector<BrickTextures> textures_;
  GLuint linear_sampler_ = 0;
  GLuint mipmap_sampler_ = 0;
};

}  // namespace soft_volume::core
