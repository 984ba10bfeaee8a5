#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "drawn_grid.h"

namespace soft_volume::core {

/// A cell, or a part of a polyhedron, inside which everything is a polynomial of three reference coordinates (CellMap).
/// The type is one of tetrahedron, pyramid, wedge and hexahedron.
struct Piece {
  std::uint32_t cell;
  CellType type;
  std::array<std::uint32_t, 8> vertices;  ///< in VTK's order for the type
};

/// A face between two pieces, or of one. Three corners make a plane triangle, four a bilinear patch.
struct PieceFace {
  static constexpr std::uint32_t kNone = ~std::uint32_t(0);
  struct Side {
    std::uint32_t piece = kNone;
    bool reversed = false;                  ///< sees the corners run the other way round than the first side does
    std::array<std::uint8_t, 4> corners{};  ///< for each corner of the face its number in the piece
  };
  std::array<std::uint32_t, 4> vertices;  ///< the last is kNone in a triangle
  std::array<Side, 2> sides;

  bool isTriangle() const { return vertices[3] == kNone; }
};

/// Every face of every cell, those of two neighbours once: what ExactTracer intersects with its rays. A polyhedron
/// consists of pyramids and tetrahedra between its faces and the mean of its vertices; its faces with more than four
/// corners are triangles around their own mean, so that neighbours agree on them. The means are vertices that follow
/// those of the grid.
class PieceMesh {
 public:
  PieceMesh() = default;
  explicit PieceMesh(const DrawnGrid& grid);

  const std::vector<Piece>& pieces() const { return pieces_; }
  const std::vector<PieceFace>& faces() const { return faces_; }

  /// Appends the means to a quantity that is given per vertex of the grid.
  template <typename Quantity>
  void appendMeans(std::vector<Quantity>& values) const {
    for (std::size_t mean = 0; mean + 1 < mean_begin_.size(); ++mean) {
      Quantity sum = values[mean_members_[mean_begin_[mean]]];
      for (std::size_t i = mean_begin_[mean] + 1; i < mean_begin_[mean + 1]; ++i)
        sum = sum + values[mean_members_[i]];
      values.push_back(Quantity(sum * (1.0F / float(mean_begin_[mean + 1] - mean_begin_[mean]))));
    }
  }

 private:
  class Builder;

  std::vector<Piece> pieces_;
  std::vector<PieceFace> faces_;
  std::vector<std::size_t> mean_begin_{0};  ///< per mean, into mean_members_, and the end
  std::vector<std::uint32_t> mean_members_;
};

}  // namespace soft_volume::core
