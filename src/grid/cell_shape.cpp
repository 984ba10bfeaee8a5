#include "soft_volume/grid/cell_shape.h"

#include <algorithm>
#include <numeric>
#include <string>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

constexpr CellShape kEmpty = {};

constexpr CellShape kTetrahedron = {4,
                                    6,
                                    4,
                                    {{{0, 1}, {1, 2}, {2, 0}, {0, 3}, {1, 3}, {2, 3}}},
                                    {3, 3, 3, 3},
                                    {{{0, 1, 3}, {1, 2, 3}, {2, 0, 3}, {0, 2, 1}}}};

/// The vertex number's bits are the coordinates.
constexpr CellShape kVoxel = {
    8,
    12,
    6,
    {{{0, 1}, {1, 3}, {2, 3}, {0, 2}, {4, 5}, {5, 7}, {6, 7}, {4, 6}, {0, 4}, {1, 5}, {2, 6}, {3, 7}}},
    {4, 4, 4, 4, 4, 4},
    {{{0, 4, 6, 2}, {1, 3, 7, 5}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 2, 3, 1}, {4, 5, 7, 6}}}};

constexpr CellShape kHexahedron = {
    8,
    12,
    6,
    {{{0, 1}, {1, 2}, {3, 2}, {0, 3}, {4, 5}, {5, 6}, {7, 6}, {4, 7}, {0, 4}, {1, 5}, {2, 6}, {3, 7}}},
    {4, 4, 4, 4, 4, 4},
    {{{0, 4, 7, 3}, {1, 2, 6, 5}, {0, 1, 5, 4}, {3, 7, 6, 2}, {0, 3, 2, 1}, {4, 5, 6, 7}}}};

constexpr CellShape kWedge = {6,
                              9,
                              5,
                              {{{0, 1}, {1, 2}, {2, 0}, {3, 4}, {4, 5}, {5, 3}, {0, 3}, {1, 4}, {2, 5}}},
                              {3, 3, 4, 4, 4},
                              {{{0, 1, 2}, {3, 5, 4}, {0, 3, 4, 1}, {1, 4, 5, 2}, {2, 5, 3, 0}}}};

constexpr CellShape kPyramid = {5,
                                8,
                                5,
                                {{{0, 1}, {1, 2}, {2, 3}, {3, 0}, {0, 4}, {1, 4}, {2, 4}, {3, 4}}},
                                {4, 3, 3, 3, 3},
                                {{{0, 3, 2, 1}, {0, 1, 4}, {1, 2, 4}, {2, 3, 4}, {3, 0, 4}}}};

/// The different vertices of a face in ascending order.
using FaceKey = std::vector<std::uint32_t>;

void makeKey(const std::uint32_t* vertices, std::size_t size, FaceKey& key) {
  key.assign(vertices, vertices + size);
  std::sort(key.begin(), key.end());
  key.erase(std::unique(key.begin(), key.end()), key.end());
}

/// A face with an area and where its vertices are.
struct PlacedFace {
  GridFace face;
  std::uint32_t begin;  ///< polyhedra: of its vertices in the connectivity; others: of the cell's
};

struct GridCells {
  const std::vector<CellType>& types;
  const std::vector<std::uint32_t>& offsets;
  const std::vector<std::uint32_t>& connectivity;

  void makeKeyOf(const PlacedFace& placed, FaceKey& key) const {
    const std::uint32_t* begin = &connectivity[placed.begin];
    if (types[placed.face.cell] == CellType::kPolyhedron)
      return makeKey(begin, begin[-1], key);
    const CellShape& shape = shapeOf(types[placed.face.cell]);
    std::array<std::uint32_t, 4> vertices{};
    for (std::size_t k = 0; k < shape.face_sizes[placed.face.face]; ++k)
      vertices[k] = begin[shape.faces[placed.face.face][k]];
    makeKey(vertices.data(), shape.face_sizes[placed.face.face], key);
  }

  /// Calls visit(placed face, smallest vertex).
  template <typename Visit>
  void forEachFaceWithArea(const Visit& visit) const {
    FaceKey key;
    for (std::size_t cell = 0; cell < types.size(); ++cell) {
      const std::uint32_t* numbers = &connectivity[offsets[cell]];
      const bool is_polyhedron = types[cell] == CellType::kPolyhedron;
      forEachFace(types[cell], numbers, [&](std::size_t face, const std::uint32_t* vertices, std::size_t size) {
        makeKey(vertices, size, key);
        const std::ptrdiff_t begin = is_polyhedron ? vertices - numbers : 0;
        if (key.size() >= 3)
          visit(PlacedFace{{std::uint32_t(cell), std::uint32_t(face)}, std::uint32_t(offsets[cell] + begin)},
                key.front());
      });
    }
  }
};

/// All faces by their smallest vertex: faces with the same vertices are then in the same short list. A counting sort.
class FaceBuckets {
 public:
  explicit FaceBuckets(const GridCells& grid) : begin_(2, 0) {
    grid.forEachFaceWithArea([&](const PlacedFace&, std::uint32_t smallest) {
      if (begin_.size() < smallest + std::size_t(2))
        begin_.resize(smallest + std::size_t(2), 0);
      ++begin_[smallest + std::size_t(1)];
    });
    std::partial_sum(begin_.begin(), begin_.end(), begin_.begin());
    faces_.resize(begin_.back());
    std::vector<std::uint32_t> next = begin_;
    grid.forEachFaceWithArea([&](const PlacedFace& face, std::uint32_t smallest) { faces_[next[smallest]++] = face; });
  }

  std::size_t size() const { return begin_.size() - 1; }
  const PlacedFace* begin(std::size_t bucket) const { return faces_.data() + begin_[bucket]; }
  std::size_t count(std::size_t bucket) const { return begin_[bucket + 1] - begin_[bucket]; }

 private:
  std::vector<std::uint32_t> begin_;
  std::vector<PlacedFace> faces_;
};

/// Appends the faces among the first `count` whose key no other has.
void appendLoneFaces(const PlacedFace* faces, const std::vector<FaceKey>& keys, std::size_t count,
                     std::vector<std::uint32_t>& order, std::vector<GridFace>& lone) {
  order.resize(count);
  std::iota(order.begin(), order.end(), 0U);
  std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) { return keys[a] < keys[b]; });
  for (std::size_t i = 0; i < count; ++i) {
    const bool as_before = i > 0 && keys[order[i - 1]] == keys[order[i]];
    const bool as_after = i + 1 < count && keys[order[i + 1]] == keys[order[i]];
    if (!as_before && !as_after)
      lone.push_back(faces[order[i]].face);
  }
}

}  // namespace

const CellShape& shapeOf(CellType type) {
  switch (type) {
    case CellType::kEmpty:
      return kEmpty;
    case CellType::kTetrahedron:
      return kTetrahedron;
    case CellType::kVoxel:
      return kVoxel;
    case CellType::kHexahedron:
      return kHexahedron;
    case CellType::kWedge:
      return kWedge;
    case CellType::kPyramid:
      return kPyramid;
    case CellType::kPolyhedron:
      break;
  }
  throw InputError("cells of VTK type " + std::to_string(int(type)) +
                   " have no fixed shape; give tetrahedra, voxels, hexahedra, wedges, pyramids or face streams");
}

std::size_t faceCount(CellType type, const std::uint32_t* cell) {
  return type == CellType::kPolyhedron ? cell[0] : shapeOf(type).face_count;
}

std::vector<std::uint32_t> verticesOfPolyhedron(const std::uint32_t* face_stream) {
  std::vector<std::uint32_t> vertices;
  forEachFace(CellType::kPolyhedron, face_stream, [&](std::size_t, const std::uint32_t* face, std::size_t size) {
    vertices.insert(vertices.end(), face, face + size);
  });
  std::sort(vertices.begin(), vertices.end());
  vertices.erase(std::unique(vertices.begin(), vertices.end()), vertices.end());
  return vertices;
}

std::vector<GridFace> boundaryFaces(const std::vector<CellType>& types, const std::vector<std::uint32_t>& offsets,
                                    const std::vector<std::uint32_t>& connectivity) {
  const GridCells grid{types, offsets, connectivity};
  const FaceBuckets buckets(grid);
  std::vector<GridFace> boundary;
  std::vector<FaceKey> keys;
  std::vector<std::uint32_t> order;
  for (std::size_t bucket = 0; bucket < buckets.size(); ++bucket) {
    const std::size_t count = buckets.count(bucket);
    keys.resize(std::max(keys.size(), count));
    for (std::size_t i = 0; i < count; ++i)
      grid.makeKeyOf(buckets.begin(bucket)[i], keys[i]);
    appendLoneFaces(buckets.begin(bucket), keys, count, order, boundary);
  }
  std::sort(boundary.begin(), boundary.end(),
            [](const GridFace& a, const GridFace& b) { return a.cell != b.cell ? a.cell < b.cell : a.face < b.face; });
  return boundary;
}

}  // namespace soft_volume::core
