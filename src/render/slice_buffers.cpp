#include "slice_buffers.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "polygon_triangles.h"
#include "soft_volume/common/parallel.h"

namespace soft_volume::core {
namespace {

/// The table's entry for a scalar; NaN, which is drawn as nothing, where that is none.
TransferTable::Entry classify(const TransferTable& table, float scalar) {
  if (std::isnan(scalar)) {
    const float nan = std::numeric_limits<float>::quiet_NaN();
    return {nan, nan, nan, nan};
  }
  const double entry = (double(scalar) - table.firstValue()) * table.entriesPerValue();
  return table.entries()[std::size_t(std::clamp(entry, 0.0, double(TransferTable::kSize - 1)) + 0.5)];
}

}  // namespace

void SliceBuffers::setGrid(const DrawnGrid& grid) {
  grid_ = &grid;
  gradients_.setGrid(grid);
}

Matrix3 SliceBuffers::meanTextureMap() const {
  return gradients_.meanOfTexture(threadsFor(0));
}

void SliceBuffers::begin(const DrawJob& job, const GlVariant& variant, const TransferTable& table, int threads) {
  variant_ = variant;
  planes_ = job.planes;
  threads_ = threads;
  const std::vector<int> sizes = attributeSizes(variant);
  stride_ = std::size_t(std::accumulate(sizes.begin(), sizes.end(), 0));
  attributes_.assign(stride_ * std::max(grid_->vertexCount(), grid_->cell_scalars.size()), 0.0F);
  switch (variant.source) {
    case GlSource::kTexture:
      return fillTexture(job);
    case GlSource::kScalar:
      return fillScalar(job);
    case GlSource::kColour:
      return fillColour(job, table);
  }
}

/// How the camera's x and y change per metre of depth along the ray through a vertex, and 1.
Vector3f SliceBuffers::slopeAt(const DrawJob& job, std::size_t vertex) const {
  if (job.camera.projection == Projection::kParallel)
    return Vector3f::UnitZ();
  const Vector3f& p = job.positions[vertex];
  const float z_m = std::max(p.z(), float(job.camera.near_m));
  return {p.x() / z_m, p.y() / z_m, 1.0F};
}

void SliceBuffers::fillTexture(const DrawJob& job) {
  const auto maps = variant_.cross_section
                        ? std::vector<Eigen::Matrix3f>(grid_->vertexCount(), Eigen::Matrix3f(Eigen::Matrix3f::Zero()))
                        : gradients_.ofTexture(job.positions, threads_);
  parallelFor(std::ptrdiff_t(grid_->vertexCount()), threads_, [&](std::ptrdiff_t i) {
    const auto vertex = std::size_t(i);
    using Target = Eigen::Map<Vector3f>;
    float* out = &attributes_[vertex * stride_];
    Target{out} = grid_->texture[vertex];
    Target{out + 3} = maps[vertex] * slopeAt(job, vertex);
    if (!variant_.shaded)
      return;
    Target{out + 6} = maps[vertex].col(0);
    Target{out + 9} = maps[vertex].col(1);
  });
}

void SliceBuffers::fillScalar(const DrawJob& job) {
  const std::vector<float>& scalars = grid_->cell_scalars.empty() ? grid_->point_scalars : grid_->cell_scalars;
  for (std::size_t i = 0; i < scalars.size(); ++i)
    attributes_[i * stride_] = scalars[i];
  if (grid_->cell_scalars.empty() && !variant_.cross_section)
    addGradients(job, 1);
}

void SliceBuffers::fillColour(const DrawJob& job, const TransferTable& table) {
  for (std::size_t i = 0; i < grid_->vertexCount(); ++i) {
    const TransferTable::Entry entry = classify(table, grid_->point_scalars[i]);
    std::copy(entry.begin(), entry.end(), &attributes_[i * stride_]);
  }
  if (variant_.shaded)
    addGradients(job, 4);
}

/// The scalar's change along the ray where a single number follows, its gradient behind that.
void SliceBuffers::addGradients(const DrawJob& job, std::size_t offset) {
  const std::vector<Vector3f> gradients = gradients_.ofScalar(job.positions, threads_);
  parallelFor(std::ptrdiff_t(gradients.size()), threads_, [&](std::ptrdiff_t i) {
    const auto vertex = std::size_t(i);
    float* out = &attributes_[vertex * stride_ + offset];
    if (variant_.source == GlSource::kScalar)
      *out++ = gradients[vertex].dot(slopeAt(job, vertex));
    if (variant_.shaded)
      Eigen::Map<Vector3f>{out} = gradients[vertex];
  });
}

void SliceBuffers::build(const SliceMesh& mesh, const std::vector<std::uint32_t>& brick_of_cell) {
  if (grid_->cell_scalars.empty())
    buildVertices(mesh);
  else
    buildCellVertices(mesh);
  buildBatches(mesh, brick_of_cell);
  buildTriangles(mesh);
}

void SliceBuffers::buildVertices(const SliceMesh& mesh) {
  vertices_.resize(mesh.vertices.size() * floatsPerVertex());
  parallelFor(std::ptrdiff_t(mesh.vertices.size()), threads_, [&](std::ptrdiff_t i) {
    const SliceVertex& vertex = mesh.vertices[std::size_t(i)];
    const float* a = &attributes_[vertex.a * stride_];
    const float* b = &attributes_[vertex.b * stride_];
    float* out = &vertices_[std::size_t(i) * floatsPerVertex()];
    *out++ = vertex.u;
    *out++ = vertex.v;
    for (std::size_t k = 0; k < stride_; ++k)
      *out++ = a[k] + vertex.t * (b[k] - a[k]);
  });
}

/// What belongs to cells cannot be shared between them: each corner of a polygon gets a vertex of its own.
void SliceBuffers::buildCellVertices(const SliceMesh& mesh) {
  vertices_.resize(mesh.corners.size() * floatsPerVertex());
  parallelFor(std::ptrdiff_t(mesh.polygons.size()), threads_, [&](std::ptrdiff_t i) {
    const SlicePolygon& polygon = mesh.polygons[std::size_t(i)];
    const float* attributes = &attributes_[polygon.cell * stride_];
    for (std::uint32_t corner = polygon.first; corner < polygon.first + polygon.size; ++corner) {
      const SliceVertex& vertex = mesh.vertices[mesh.corners[corner]];
      float* out = &vertices_[corner * floatsPerVertex()];
      *out++ = vertex.u;
      *out++ = vertex.v;
      std::copy_n(attributes, stride_, out);
    }
  });
}

/// Gives every polygon its place in the indices: by slice and, within that, by brick.
void SliceBuffers::buildBatches(const SliceMesh& mesh, const std::vector<std::uint32_t>& brick_of_cell) {
  first_index_.resize(mesh.polygons.size());
  batches_.assign(mesh.slices.size(), {});
  std::size_t next = 0;
  std::vector<std::uint32_t> order;
  for (std::size_t i = 0; i < mesh.slices.size(); ++i) {
    const Slice& slice = mesh.slices[i];
    order.resize(slice.polygon_count);
    std::iota(order.begin(), order.end(), slice.first_polygon);
    const auto brickOf = [&](std::uint32_t polygon) -> std::size_t {
      return brick_of_cell.empty() ? 0 : brick_of_cell[mesh.polygons[polygon].cell];
    };
    if (!brick_of_cell.empty())
      std::stable_sort(order.begin(), order.end(), [&](auto a, auto b) { return brickOf(a) < brickOf(b); });
    for (const std::uint32_t polygon : order) {
      if (batches_[i].empty() || batches_[i].back().brick != brickOf(polygon))
        batches_[i].push_back({brickOf(polygon), next, 0});
      const std::size_t count = 3 * std::size_t(mesh.polygons[polygon].size - 2);
      first_index_[polygon] = next;
      batches_[i].back().index_count += count;
      next += count;
    }
  }
  indices_.resize(next);
}

void SliceBuffers::buildTriangles(const SliceMesh& mesh) {
  parallelFor(std::ptrdiff_t(mesh.slices.size()), threads_, [&](std::ptrdiff_t i) {
    const Slice& slice = mesh.slices[std::size_t(i)];
    const auto tip = std::uint32_t(std::fmod(std::abs(rungOf(planes_, slice)), 2.0));
    for (std::uint32_t polygon = slice.first_polygon; polygon < slice.first_polygon + slice.polygon_count; ++polygon)
      buildTriangles(mesh, mesh.polygons[polygon], tip, &indices_[first_index_[polygon]]);
  });
}

void SliceBuffers::buildTriangles(const SliceMesh& mesh, const SlicePolygon& polygon, std::uint32_t tip,
                                  std::uint32_t* triangles) const {
  const bool shared = grid_->cell_scalars.empty();
  triangulate(mesh, polygon, tip, triangles);
  for (std::size_t k = 0; k < 3 * std::size_t(polygon.size - 2); ++k) {
    const std::uint32_t corner = polygon.first + triangles[k];
    triangles[k] = shared ? mesh.corners[corner] : corner;
  }
}

}  // namespace soft_volume::core
