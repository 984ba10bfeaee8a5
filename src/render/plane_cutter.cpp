#include "plane_cutter.h"

#include <algorithm>

namespace soft_volume::core {

void PlaneCutter::cut(const BucketedGrid& grid, const Camera& camera, std::size_t begin, std::size_t end,
                      SliceMesh& mesh) {
  grid_ = &grid;
  camera_ = &camera;
  mesh_ = &mesh;
  vertex_of_edge_.resize(grid.edges.ends.size());
  seed(begin, end);
  for (std::size_t i = begin; i < end; ++i)
    cutPlane(grid.planes[i]);
}

/// What is active on the first plane that is not an extra one, but does not begin there.
void PlaneCutter::seed(std::size_t begin, std::size_t end) {
  active_edges_.clear();
  active_cells_.clear();
  while (begin < end && grid_->planes[begin].extra)
    ++begin;
  if (begin == end)
    return;
  const int plane = int(grid_->planes[begin].number);
  grid_->cell_buckets.seed(plane, active_cells_);
  grid_->edge_buckets.seed(plane, seeds_);
  for (const PlaneBuckets::Item& item : seeds_)
    active_edges_.push_back(lineOf(item.number, item.end));
}

PlaneCutter::EdgeLine PlaneCutter::lineOf(std::uint32_t edge, std::uint32_t end) const {
  const auto [a, b] = grid_->edges.ends[edge];
  const Vector3f& from = grid_->positions[a];
  const Vector3f& to = grid_->positions[b];
  return {from.z(), 1.0F / (to.z() - from.z()), from.x(), to.x() - from.x(), from.y(), to.y() - from.y(), a, b, edge,
          end};
}

void PlaneCutter::cutPlane(const CutPlane& plane) {
  const bool is_parallel = camera_->projection == Projection::kParallel;
  const double scale = is_parallel ? 1.0 : 1.0 / double(plane.z_m);
  scale_ = {float(camera_->fx * scale), float(camera_->fy * scale), float(camera_->cx), float(camera_->cy)};
  const auto first_polygon = std::uint32_t(mesh_->polygons.size());
  if (plane.extra) {
    cutMissed(plane);
  } else {
    cutEdges(int(plane.number), plane.z_m);
    cutCells(int(plane.number));
  }
  mesh_->slices.push_back({plane.z_m, plane.front_m, plane.back_m, plane.extra, first_polygon,
                           std::uint32_t(mesh_->polygons.size()) - first_polygon});
}

std::uint32_t PlaneCutter::addVertex(const EdgeLine& line, float z_m) {
  const float t = std::clamp((z_m - line.z0_m) * line.per_m, 0.0F, 1.0F);
  const float x_m = line.x0_m + t * line.dx_m;
  const float y_m = line.y0_m + t * line.dy_m;
  mesh_->vertices.push_back({scale_.u * x_m + scale_.cx, scale_.v * y_m + scale_.cy, t, line.a, line.b});
  return std::uint32_t(mesh_->vertices.size() - 1);
}

void PlaneCutter::cutEdges(int plane, float z_m) {
  const PlaneBuckets& buckets = grid_->edge_buckets;
  const auto isBefore = [plane](const EdgeLine& line) { return int(line.end) <= plane; };
  active_edges_.erase(std::remove_if(active_edges_.begin(), active_edges_.end(), isBefore), active_edges_.end());
  for (auto item = buckets.begin(plane); item != buckets.end(plane); ++item)
    active_edges_.push_back(lineOf(item->number, item->end));
  for (const EdgeLine& line : active_edges_)
    vertex_of_edge_[line.edge] = addVertex(line, z_m);
}

void PlaneCutter::cutCells(int plane) {
  const PlaneBuckets& buckets = grid_->cell_buckets;
  const auto isBefore = [plane](const PlaneBuckets::Item& item) { return int(item.end) <= plane; };
  active_cells_.erase(std::remove_if(active_cells_.begin(), active_cells_.end(), isBefore), active_cells_.end());
  active_cells_.insert(active_cells_.end(), buckets.begin(plane), buckets.end(plane));
  const auto isPositive = [ranks = grid_->ranks.data(), plane](std::uint32_t v) { return int(ranks[v]) > plane; };
  const auto vertexOf = [this](std::uint32_t edge) { return vertex_of_edge_[edge]; };
  for (const PlaneBuckets::Item& item : active_cells_)
    cutCell(item.number, isPositive, vertexOf);
}

/// Few cells: their edges are cut when the first cell asks for them. Cells that are cut at a depth of their own share
/// no vertices.
void PlaneCutter::cutMissed(const CutPlane& plane) {
  float z_m = plane.z_m;
  std::size_t first = mesh_->vertices.size();
  const auto isPositive = [&](std::uint32_t v) { return grid_->positions[v].z() >= z_m; };
  const auto vertexOf = [&](std::uint32_t edge) {
    const auto [a, b] = grid_->edges.ends[edge];
    const std::uint32_t known = vertex_of_edge_[edge];
    const bool is_of_plane = known >= first && known < mesh_->vertices.size();
    if (is_of_plane && mesh_->vertices[known].a == a && mesh_->vertices[known].b == b)
      return known;
    return vertex_of_edge_[edge] = addVertex(lineOf(edge, 0), z_m);
  };
  const std::size_t end = grid_->missed_begin[plane.number + std::size_t(1)];
  for (std::size_t i = grid_->missed_begin[plane.number]; i < end; ++i) {
    if (grid_->missed[i].z_m != z_m) {
      z_m = grid_->missed[i].z_m;
      first = mesh_->vertices.size();
    }
    cutCell(grid_->missed[i].cell, isPositive, vertexOf);
  }
}

template <typename IsPositive, typename VertexOf>
void PlaneCutter::cutCell(std::uint32_t cell, const IsPositive& isPositive, const VertexOf& vertexOf) {
  if (grid_->types[cell] == CellType::kPolyhedron)
    cutPolyhedron(cell, isPositive, vertexOf);
  else
    cutShape(cell, isPositive, vertexOf);
}

template <typename IsPositive, typename VertexOf>
void PlaneCutter::cutShape(std::uint32_t cell, const IsPositive& isPositive, const VertexOf& vertexOf) {
  const std::uint32_t* numbers = &grid_->connectivity[grid_->offsets[cell]];
  const std::uint32_t* edges = &grid_->edges.cell_edges[grid_->edges.cell_offsets[cell]];
  const std::uint32_t vertices = grid_->offsets[cell + 1] - grid_->offsets[cell];
  unsigned signs = 0;
  for (std::uint32_t i = 0; i < vertices; ++i)
    signs |= unsigned(isPositive(numbers[i])) << i;
  const SliceLoops& loops = sliceTable(grid_->types[cell])[signs];
  const std::uint8_t* local = loops.edges.data();
  const auto add = grid_->is_collapsed[cell] != 0 ? &PlaneCutter::addCollapsedPolygon : &PlaneCutter::addPolygon;
  for (std::size_t loop = 0; loop < loops.loop_count; ++loop) {
    const std::size_t size = loops.loop_sizes[loop];
    std::array<std::uint32_t, 12> corners;
    for (std::size_t i = 0; i < size; ++i)
      corners[i] = vertexOf(edges[local[i]]);
    (this->*add)(cell, corners.data(), local, size);
    local += size;
  }
}

void PlaneCutter::addPolygon(std::uint32_t cell, const std::uint32_t* corners, const std::uint8_t* edges,
                             std::size_t size) {
  mesh_->polygons.push_back({cell, std::uint32_t(mesh_->corners.size()), std::uint32_t(size)});
  mesh_->corners.insert(mesh_->corners.end(), corners, corners + size);
  mesh_->edges.insert(mesh_->edges.end(), edges, edges + size);
}

/// Several edges of the cell are the same edge of the grid: their common corner is kept once.
void PlaneCutter::addCollapsedPolygon(std::uint32_t cell, const std::uint32_t* corners, const std::uint8_t* edges,
                                      std::size_t size) {
  kept_corners_.clear();
  kept_edges_.clear();
  for (std::size_t i = 0; i < size; ++i) {
    if (corners[i] == corners[i + 1 < size ? i + 1 : 0])
      continue;
    kept_corners_.push_back(corners[i]);
    kept_edges_.push_back(edges[i]);
  }
  if (kept_corners_.size() >= 3)
    addPolygon(cell, kept_corners_.data(), kept_edges_.data(), kept_corners_.size());
}

template <typename IsPositive, typename VertexOf>
void PlaneCutter::cutPolyhedron(std::uint32_t cell, const IsPositive& isPositive, const VertexOf& vertexOf) {
  const std::uint32_t* edge = &grid_->edges.cell_edges[grid_->edges.cell_offsets[cell]];
  polyhedron_.begin(mesh_->vertices);
  forEachFace(CellType::kPolyhedron, &grid_->connectivity[grid_->offsets[cell]],
              [&](std::size_t, const std::uint32_t* corners, std::size_t size) {
                polyhedron_.beginFace(size);
                for (std::size_t i = 0; i < size; ++i, ++edge) {
                  const bool is_positive = isPositive(corners[i]);
                  if (is_positive != isPositive(corners[i + 1 < size ? i + 1 : 0]))
                    polyhedron_.addCut(vertexOf(*edge), is_positive);
                }
                polyhedron_.endFace();
              });
  polyhedron_.finish();
  for (std::size_t loop = 0; loop < polyhedron_.loopCount(); ++loop) {
    const std::size_t size = polyhedron_.loopSize(loop);
    no_edges_.resize(std::max(no_edges_.size(), size), 255);
    addCollapsedPolygon(cell, polyhedron_.loop(loop), no_edges_.data(), size);
  }
}

}  // namespace soft_volume::core
