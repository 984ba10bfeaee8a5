#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <vector>

#include "cell_map.h"
#include "illumination.h"
#include "pixel_integral.h"
#include "volume_lookup.h"

namespace soft_volume::core {

// How each kind of data shows itself along a ray. A medium has a value for the vertices of a piece and makes samples of
// what is interpolated between them; add() integrates the way between two samples, once isStraight() says that the
// samples' values change evenly there.

/// A sample with its place in its piece.
template <typename Sample>
struct Placed {
  Vector3 r;  ///< reference coordinates
  Sample sample;
};

/// Light by gradients that are given per vertex of the PieceMesh; by none where data do not change within cells.
class VertexLight {
 public:
  VertexLight(const Illumination& light, const std::vector<Vector3f>& gradients)
      : light_(light), gradients_(gradients) {}

  Lighting at(const Piece& piece, const Vector3& r) const {
    if (!light_.isOn())
      return {};
    if (gradients_.empty())
      return light_.on(Vector3::Zero());
    const auto vertex = [&](int i) { return Vector3(gradients_[piece.vertices[std::size_t(i)]].cast<double>()); };
    return light_.on(CellPolynomial<3>(piece.type, vertex).at(r));
  }

 private:
  const Illumination& light_;
  const std::vector<Vector3f>& gradients_;
};

/// A scalar given per vertex of the PieceMesh.
class PointScalars {
 public:
  static constexpr int kComponents = 1;
  using Value = Eigen::Matrix<double, 1, 1>;
  using Sample = ScalarSample;

  PointScalars(const TransferIntegral& function, const VertexLight& light, const std::vector<float>& values)
      : profile_(function), light_(light), values_(values) {}

  Value value(const Piece&, std::uint32_t vertex) const { return Value(double(values_[vertex])); }
  Sample sample(double z, const Value& value) const { return profile_.sample(z, value[0]); }
  bool isStraight(const Piece& piece) const { return piece.type == CellType::kTetrahedron; }
  bool isStraight(const PixelIntegral& pixel, const Sample& a, const Sample& m, const Sample& b) const {
    return pixel.isStraight(profile_, a, m, b);
  }
  void add(const Piece& piece, const Placed<Sample>& a, const Placed<Sample>& b, PixelIntegral& pixel) const {
    pixel.add(profile_, a.sample, b.sample, [&] { return light_.at(piece, 0.5 * (a.r + b.r)); });
  }

 private:
  ScalarProfile profile_;
  const VertexLight& light_;
  const std::vector<float>& values_;
};

/// A scalar given per cell.
class CellScalars {
 public:
  static constexpr int kComponents = 1;
  using Value = Eigen::Matrix<double, 1, 1>;
  using Sample = ScalarSample;

  CellScalars(const TransferIntegral& function, const VertexLight& light, const std::vector<float>& values)
      : profile_(function), light_(light), values_(values) {}

  Value value(const Piece& piece, std::uint32_t) const { return Value(double(values_[piece.cell])); }
  Sample sample(double z, const Value& value) const { return profile_.sample(z, value[0]); }
  bool isStraight(const Piece&) const { return true; }
  bool isStraight(const PixelIntegral&, const Sample&, const Sample&, const Sample&) const { return true; }
  void add(const Piece& piece, const Placed<Sample>& a, const Placed<Sample>& b, PixelIntegral& pixel) const {
    pixel.add(profile_, a.sample, b.sample, [&] { return light_.at(piece, a.r); });
  }

 private:
  ScalarProfile profile_;
  const VertexLight& light_;
  const std::vector<float>& values_;
};

/// Colour and absorption given per vertex of the PieceMesh.
class PointColours {
 public:
  static constexpr int kComponents = 4;
  using Value = Eigen::Vector4d;
  using Sample = ColourSample;

  PointColours(const VertexLight& light, const std::vector<Eigen::Vector4f>& values) : light_(light), values_(values) {}

  Value value(const Piece&, std::uint32_t vertex) const { return values_[vertex].cast<double>(); }
  Sample sample(double z, const Value& value) const { return {z, value}; }
  bool isStraight(const Piece& piece) const { return piece.type == CellType::kTetrahedron; }
  bool isStraight(const PixelIntegral& pixel, const Sample& a, const Sample& m, const Sample& b) const {
    return pixel.isStraight(profile_, a, m, b);
  }
  void add(const Piece& piece, const Placed<Sample>& a, const Placed<Sample>& b, PixelIntegral& pixel) const {
    pixel.add(profile_, a.sample, b.sample, [&] { return light_.at(piece, 0.5 * (a.r + b.r)); });
  }

 private:
  ColourProfile profile_;
  const VertexLight& light_;
  const std::vector<Eigen::Vector4f>& values_;
};

/// A volume by texture coordinates that are given per vertex of the PieceMesh.
class TexturedVolume {
 public:
  static constexpr int kComponents = 3;
  using Value = Vector3;
  struct Sample {
    double z;
    Vector3 texture;
  };

  /// `maps`: how the texture coordinates change in the camera frame (VertexGradients); empty without light.
  TexturedVolume(const TransferIntegral& function, const Illumination& light, const VolumeLookup& volume,
                 const std::vector<Vector3f>& texture, const std::vector<Eigen::Matrix3f>& maps)
      : profile_(function), light_(light), volume_(volume), texture_(texture), maps_(maps) {}

  Value value(const Piece&, std::uint32_t vertex) const { return texture_[vertex].cast<double>(); }
  Sample sample(double z, const Value& value) const { return {z, value}; }
  bool isStraight(const Piece& piece) const { return piece.type == CellType::kTetrahedron; }
  bool isStraight(const PixelIntegral&, const Sample& a, const Sample& m, const Sample& b) const {
    return voxels(m.texture - 0.5 * (a.texture + b.texture)) < kBendVoxels;
  }

  void add(const Piece& piece, const Placed<Sample>& a, const Placed<Sample>& b, PixelIntegral& pixel) const {
    const bool had_depth = !std::isnan(pixel.depth());
    const Line line{a.sample, b.sample};
    MapAt map(*this, piece, a, b);
    const int steps = std::max(1, int(std::ceil(voxels(b.sample.texture - a.sample.texture) / kStepVoxels)));
    ScalarSample from = look(line, 0.0);
    for (int i = 1; i <= steps && !pixel.isOpaque(); ++i) {
      const ScalarSample to = look(line, double(i) / steps);
      refine(line, map, from, to, kMaxHalvings, pixel);
      from = to;
    }
    if (!had_depth && !std::isnan(pixel.depth()))
      pixel.setTextureAtDepth(line.textureAt(pixel.depth()));
  }

 private:
  static constexpr double kBendVoxels = 0.005;
  static constexpr double kStepVoxels = 0.5;
  static constexpr int kMaxHalvings = 8;

  /// Texture coordinates between two samples.
  struct Line {
    const Sample& a;
    const Sample& b;
    double part(double z) const { return b.z > a.z ? (z - a.z) / (b.z - a.z) : 0.0; }
    Vector3 textureAt(double z) const { return a.texture + part(z) * (b.texture - a.texture); }
  };

  /// The map from the camera frame to texture coordinates along the way, made where it is asked for.
  class MapAt {
   public:
    MapAt(const TexturedVolume& medium, const Piece& piece, const Placed<Sample>& a, const Placed<Sample>& b)
        : medium_(medium), piece_(piece), a_(a), b_(b) {}
    Matrix3 at(double part) {
      if (!polynomial_)
        polynomial_.emplace(piece_.type, [&](int i) { return vertex(piece_.vertices[std::size_t(i)]); });
      const Eigen::Matrix<double, 9, 1> map = polynomial_->at(a_.r + part * (b_.r - a_.r));
      return Eigen::Map<const Matrix3>(map.data());
    }

   private:
    Eigen::Matrix<double, 9, 1> vertex(std::uint32_t number) const {
      return Eigen::Map<const Eigen::Matrix<float, 9, 1>>(medium_.maps_[number].data()).cast<double>();
    }
    const TexturedVolume& medium_;
    const Piece& piece_;
    const Placed<Sample>& a_;
    const Placed<Sample>& b_;
    std::optional<CellPolynomial<9>> polynomial_;
  };

  double voxels(const Vector3& texture) const { return texture.cwiseProduct(volume_.dims()).cwiseAbs().maxCoeff(); }

  ScalarSample look(const Line& line, double part) const {
    const Vector3 texture = line.a.texture + part * (line.b.texture - line.a.texture);
    return profile_.sample(line.a.z + part * (line.b.z - line.a.z), volume_.at(texture));
  }

  void refine(const Line& line, MapAt& map, const ScalarSample& a, const ScalarSample& b, int halvings,
              PixelIntegral& pixel) const {
    const ScalarSample m = look(line, 0.5 * (line.part(a.z) + line.part(b.z)));
    if (halvings > 0 && !pixel.isStraight(profile_, a, m, b)) {
      refine(line, map, a, m, halvings - 1, pixel);
      refine(line, map, m, b, halvings - 1, pixel);
      return;
    }
    const auto lighting = [&] { return light_.isOn() ? light_.on(gradient(line, map, m.z)) : Lighting(); };
    pixel.add(profile_, a, m, lighting);
    pixel.add(profile_, m, b, lighting);
  }

  Vector3 gradient(const Line& line, MapAt& map, double z) const {
    const Matrix3 steps = light_.stepM() * map.at(line.part(z));
    const Vector3 texture = line.textureAt(z);
    Vector3 result;
    for (int axis = 0; axis < 3; ++axis)
      result[axis] = volume_.at(texture + steps.col(axis)) - volume_.at(texture - steps.col(axis));
    return result / (2.0 * light_.stepM());
  }

  ScalarProfile profile_;
  const Illumination& light_;
  const VolumeLookup& volume_;
  const std::vector<Vector3f>& texture_;
  const std::vector<Eigen::Matrix3f>& maps_;
};

}  // namespace soft_volume::core
