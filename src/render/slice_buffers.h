#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "canvas.h"
#include "gl_shaders.h"
#include "vertex_gradients.h"

namespace soft_volume::core {

/// Turns slices into what OpenGL draws: vertices with the attributes that a variant of the shaders wants, and
/// triangles. Knows no OpenGL.
///
/// Triangles interpolate linearly what is bilinear in a polygon of four corners. With the other diagonal the difference
/// has the other sign, so that planes take them by turns: along a ray the differences cancel.
class SliceBuffers {
 public:
  /// The triangles of one slice in one brick of the volume.
  struct Batch {
    std::size_t brick;
    std::size_t first_index;
    std::size_t index_count;
  };

  /// The grid stays alive until the next call.
  void setGrid(const DrawnGrid& grid);
  /// Mean change of the texture coordinates per metre of the volume frame in the grid at rest.
  Matrix3 meanTextureMap() const;
  /// Computes what the job's grid has at its vertices. The job stays alive while slices are built.
  void begin(const DrawJob& job, const GlVariant& variant, const TransferTable& table, int threads);
  /// `brick_of_cell` is empty where there is one brick. The result is valid until the next call.
  void build(const SliceMesh& mesh, const std::vector<std::uint32_t>& brick_of_cell);

  /// Place in the image (2 numbers), then attributeSizes(variant).
  const std::vector<float>& vertices() const { return vertices_; }
  std::size_t floatsPerVertex() const { return 2 + stride_; }
  const std::vector<std::uint32_t>& indices() const { return indices_; }
  /// Per slice of the mesh.
  const std::vector<std::vector<Batch>>& batches() const { return batches_; }

 private:
  void fillTexture(const DrawJob& job);
  void fillScalar(const DrawJob& job);
  void fillColour(const DrawJob& job, const TransferTable& table);
  void addGradients(const DrawJob& job, std::size_t offset);
  Vector3f slopeAt(const DrawJob& job, std::size_t vertex) const;
  void buildVertices(const SliceMesh& mesh);
  void buildCellVertices(const SliceMesh& mesh);
  void buildBatches(const SliceMesh& mesh, const std::vector<std::uint32_t>& brick_of_cell);
  void buildTriangles(const SliceMesh& mesh);
  void buildTriangles(const SliceMesh& mesh, const SlicePolygon& polygon, std::uint32_t tip,
                      std::uint32_t* triangles) const;

  const DrawnGrid* grid_ = nullptr;
  VertexGradients gradients_;
  GlVariant variant_;
  SlicePlanes planes_;
  int threads_ = 1;
  std::size_t stride_ = 0;         ///< floats per entry of attributes_
  std::vector<float> attributes_;  ///< per vertex of the grid, or per cell where the cells have the scalars
  std::vector<float> vertices_;
  std::vector<std::uint32_t> indices_;
  std::vector<std::size_t> first_index_;  ///< per polygon
  std::vector<std::vector<Batch>> batches_;
};

}  // namespace soft_volume::core
