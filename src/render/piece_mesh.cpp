#include "piece_mesh.h"

#include <algorithm>
#include <map>

#include "soft_volume/grid/cell_shape.h"

namespace soft_volume::core {
namespace {

/// A face as one piece sees it: its different corners in order.
struct SeenFace {
  std::size_t size = 0;
  std::array<std::uint32_t, 4> vertices{PieceFace::kNone, PieceFace::kNone, PieceFace::kNone, PieceFace::kNone};
  std::array<std::uint8_t, 4> corners{};
};

/// Corners that repeat their neighbour are left out: a quadrilateral with two equal ones is a triangle.
SeenFace seenFace(const Piece& piece, const std::uint8_t* corners, std::size_t size) {
  SeenFace face;
  for (std::size_t i = 0; i < size; ++i) {
    const std::uint32_t vertex = piece.vertices[corners[i]];
    if (vertex == piece.vertices[corners[(i + 1) % size]])
      continue;
    face.vertices[face.size] = vertex;
    face.corners[face.size++] = corners[i];
  }
  return face;
}

std::uint64_t hashOf(const SeenFace& face) {
  std::array<std::uint32_t, 4> key = face.vertices;
  std::sort(key.begin(), key.end());
  std::uint64_t hash = 0;
  for (const std::uint32_t vertex : key) {
    hash = (hash ^ vertex) * 0x9E3779B97F4A7C15U;
    hash ^= hash >> 29;
  }
  return hash;
}

std::size_t sizeOf(const PieceFace& face) {
  return face.isTriangle() ? 3 : 4;
}

/// Whether `seen` is the face from its other side (or, where cells are oriented differently, from the same); if so,
/// fills that side.
bool match(const PieceFace& face, const SeenFace& seen, PieceFace::Side& side) {
  const std::size_t n = seen.size;
  if (sizeOf(face) != n)
    return false;
  for (const bool reversed : {true, false}) {
    for (std::size_t shift = 0; shift < n; ++shift) {
      const auto at = [&](std::size_t i) { return reversed ? (shift + n - i) % n : (shift + i) % n; };
      std::size_t equal = 0;
      while (equal < n && face.vertices[equal] == seen.vertices[at(equal)])
        ++equal;
      if (equal < n)
        continue;
      for (std::size_t i = 0; i < n; ++i)
        side.corners[i] = seen.corners[at(i)];
      side.reversed = reversed;
      return true;
    }
  }
  return false;
}

Piece makePiece(std::uint32_t cell, CellType type, const std::vector<std::uint32_t>& vertices) {
  Piece piece{cell, type, {}};
  std::copy(vertices.begin(), vertices.end(), piece.vertices.begin());
  return piece;
}

}  // namespace

class PieceMesh::Builder {
 public:
  Builder(const DrawnGrid& grid, PieceMesh& mesh) : grid_(grid), mesh_(mesh) {
    std::size_t size = 1024;
    while (size < 4 * grid.cellCount())
      size *= 2;
    buckets_.assign(size, PieceFace::kNone);
  }

  void addCell(std::uint32_t cell) {
    const std::uint32_t* begin = &grid_.connectivity[grid_.cell_offsets[cell]];
    const CellType type = grid_.cell_types[cell];
    if (type == CellType::kPolyhedron)
      return addPolyhedron(cell, begin);
    std::vector<std::uint32_t> vertices(begin, &grid_.connectivity[0] + grid_.cell_offsets[cell + 1]);
    if (type == CellType::kVoxel) {
      std::swap(vertices[2], vertices[3]);
      std::swap(vertices[6], vertices[7]);
    }
    addPiece(makePiece(cell, type == CellType::kVoxel ? CellType::kHexahedron : type, vertices));
  }

 private:
  void addPiece(const Piece& piece) {
    const CellShape& shape = shapeOf(piece.type);
    for (std::size_t i = 0; i < shape.face_count; ++i)
      addFace(seenFace(piece, shape.faces[i].data(), shape.face_sizes[i]), std::uint32_t(mesh_.pieces_.size()));
    mesh_.pieces_.push_back(piece);
  }

  void addFace(const SeenFace& seen, std::uint32_t piece) {
    if (seen.size < 3)
      return;
    std::uint32_t& bucket = buckets_[hashOf(seen) & (buckets_.size() - 1)];
    for (std::uint32_t i = bucket; i != PieceFace::kNone; i = next_[i]) {
      PieceFace& face = mesh_.faces_[i];
      if (face.sides[1].piece == PieceFace::kNone && match(face, seen, face.sides[1])) {
        face.sides[1].piece = piece;
        return;
      }
    }
    next_.push_back(bucket);
    bucket = std::uint32_t(mesh_.faces_.size());
    mesh_.faces_.push_back({seen.vertices, {{{piece, false, seen.corners}, {}}}});
  }

  void addPolyhedron(std::uint32_t cell, const std::uint32_t* stream) {
    std::vector<std::uint32_t> all;
    forEachFace(CellType::kPolyhedron, stream, [&](std::size_t, const std::uint32_t* vertices, std::size_t size) {
      all.insert(all.end(), vertices, vertices + size);
    });
    const std::uint32_t centre = meanOf(all);
    forEachFace(CellType::kPolyhedron, stream, [&](std::size_t, const std::uint32_t* face, std::size_t size) {
      addCone(cell, {face, face + size}, centre);
    });
  }

  void addCone(std::uint32_t cell, std::vector<std::uint32_t> face, std::uint32_t centre) {
    const std::size_t size = face.size();
    if (size <= 4) {
      face.push_back(centre);
      return addPiece(makePiece(cell, size == 3 ? CellType::kTetrahedron : CellType::kPyramid, face));
    }
    const std::uint32_t middle = sharedMeanOf(face);
    for (std::size_t i = 0; i < size; ++i)
      addPiece(makePiece(cell, CellType::kTetrahedron, {face[i], face[(i + 1) % size], middle, centre}));
  }

  /// A new vertex: the mean of these, each taken once and in increasing order.
  std::uint32_t meanOf(std::vector<std::uint32_t>& vertices) {
    std::sort(vertices.begin(), vertices.end());
    vertices.erase(std::unique(vertices.begin(), vertices.end()), vertices.end());
    mesh_.mean_members_.insert(mesh_.mean_members_.end(), vertices.begin(), vertices.end());
    mesh_.mean_begin_.push_back(mesh_.mean_members_.size());
    return std::uint32_t(grid_.vertexCount() + mesh_.mean_begin_.size() - 2);
  }

  /// The same vertex for both sides of a face.
  std::uint32_t sharedMeanOf(std::vector<std::uint32_t> face) {
    std::sort(face.begin(), face.end());
    const auto known = face_means_.find(face);
    if (known != face_means_.end())
      return known->second;
    std::vector<std::uint32_t> vertices = face;
    return face_means_[face] = meanOf(vertices);
  }

  const DrawnGrid& grid_;
  PieceMesh& mesh_;
  std::vector<std::uint32_t> buckets_;  ///< by hash, the last face there; next_ leads to the one before
  std::vector<std::uint32_t> next_;
  std::map<std::vector<std::uint32_t>, std::uint32_t> face_means_;
};

PieceMesh::PieceMesh(const DrawnGrid& grid) {
  pieces_.reserve(grid.cellCount());
  Builder builder(grid, *this);
  for (std::size_t cell = 0; cell < grid.cellCount(); ++cell)
    builder.addCell(std::uint32_t(cell));
}

}  // namespace soft_volume::core
