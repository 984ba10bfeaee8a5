#include "render/ray_oracle.h"

#include <Eigen/LU>

#include <algorithm>
#include <array>
#include <cmath>
#include <set>

namespace soft_volume::core {
namespace {

constexpr double kOnSurface = 1e-9;
constexpr double kShortest = 1e-6;

/// Between two points of the function.
double smallestInterval(const TransferFunction& function) {
  double smallest = function.points[1].value - function.points[0].value;
  for (std::size_t i = 2; i < function.points.size(); ++i)
    smallest = std::min(smallest, function.points[i].value - function.points[i - 1].value);
  return smallest;
}

bool isPrism(CellType type) {
  return type == CellType::kTetrahedron || type == CellType::kWedge;
}

/// VTK's shape functions.
std::array<double, 8> shapeFunctions(CellType type, const Vector3& x) {
  const double r = x.x();
  const double s = x.y();
  const double t = x.z();
  const double r_ = 1.0 - r;
  const double s_ = 1.0 - s;
  const double t_ = 1.0 - t;
  switch (type) {
    case CellType::kTetrahedron:
      return {1.0 - r - s - t, r, s, t};
    case CellType::kWedge:
      return {(1.0 - r - s) * t_, r * t_, s * t_, (1.0 - r - s) * t, r * t, s * t};
    case CellType::kPyramid:
      return {r_ * s_ * t_, r * s_ * t_, r * s * t_, r_ * s * t_, t};
    case CellType::kVoxel:
      return {r_ * s_ * t_, r * s_ * t_, r_ * s * t_, r * s * t_, r_ * s_ * t, r * s_ * t, r_ * s * t, r * s * t};
    default:
      return {r_ * s_ * t_, r * s_ * t_, r * s * t_, r_ * s * t_, r_ * s_ * t, r * s_ * t, r * s * t, r_ * s * t};
  }
}

Vector3 interpolate(CellType type, const std::vector<Vector3>& values, const Vector3& place) {
  const std::array<double, 8> weights = shapeFunctions(type, place);
  Vector3 sum = Vector3::Zero();
  for (std::size_t i = 0; i < values.size(); ++i)
    sum += weights[i] * values[i];
  return sum;
}

/// By central differences, which are exact as the shape functions are linear along each axis.
Matrix3 jacobian(CellType type, const std::vector<Vector3>& points, const Vector3& place) {
  Matrix3 result;
  for (int axis = 0; axis < 3; ++axis) {
    const Vector3 step = 0.5 * Vector3::Unit(axis);
    result.col(axis) = interpolate(type, points, place + step) - interpolate(type, points, place - step);
  }
  return result;
}

bool isInside(CellType type, const Vector3& place) {
  const Vector3 low = place.array() + kOnSurface;
  const double high = type == CellType::kTetrahedron ? place.sum()
                      : isPrism(type)                ? std::max(place.x() + place.y(), place.z())
                                                     : place.maxCoeff();
  return low.minCoeff() >= 0.0 && high <= 1.0 + kOnSurface;
}

/// Newton's method; true when it arrives inside the cell.
bool solve(CellType type, const std::vector<Vector3>& points, const Vector3& p, Vector3& place) {
  for (int step = 0; step < 12; ++step) {
    const Vector3 move = jacobian(type, points, place).fullPivLu().solve(p - interpolate(type, points, place)).eval();
    if (!isFinite(move))
      return false;
    place = (place + move).cwiseMax(-2.0).cwiseMin(3.0);
    if (move.norm() < 1e-6)
      break;
  }
  const double size = (points[1] - points[0]).norm() + (points[2] - points[0]).norm() + (points[3] - points[0]).norm();
  return isInside(type, place) && (interpolate(type, points, place) - p).norm() < 1e-7 * size;
}

}  // namespace

RayOracle::RayOracle(const IrregularGrid& grid, const TransferFunction& function, const std::vector<Vector3f>& texture,
                     const Volume* volume)
    : grid_(grid), function_(function), texture_(texture), volume_(volume) {
  for (std::uint32_t cell = 0; cell < grid.cellCount(); ++cell) {
    const std::uint32_t* begin = &grid.connectivity[grid.cell_offsets[cell]];
    if (grid.cell_types[cell] == CellType::kPolyhedron) {
      addPolyhedron(cell, begin);
      continue;
    }
    std::vector<Vector3> points;
    std::vector<Vector3> data;
    for (std::uint32_t i = 0; i < grid.cell_offsets[cell + 1] - grid.cell_offsets[cell]; ++i) {
      points.push_back(grid.points[begin[i]].cast<double>());
      data.push_back(dataOf(cell, begin[i]));
    }
    addPart(grid.cell_types[cell], points, data);
  }
  makeBins();
}

Vector3 RayOracle::dataOf(std::uint32_t cell, std::uint32_t vertex) const {
  if (volume_ != nullptr)
    return texture_[vertex].cast<double>();
  return {double(grid_.cell_scalars.empty() ? grid_.point_scalars[vertex] : grid_.cell_scalars[cell]), 0.0, 0.0};
}

void RayOracle::addPart(CellType type, std::vector<Vector3> points, std::vector<Vector3> data) {
  if (volume_ == nullptr && !std::all_of(data.begin(), data.end(), [](const Vector3& d) { return isFinite(d); }))
    return;
  Box3 box;
  for (const Vector3& point : points)
    box.extend(point);
  parts_.push_back({type, std::move(points), std::move(data), box});
}

/// A pyramid or tetrahedron from each face to the mean of all vertices; faces of more than four corners are fans around
/// their own mean.
void RayOracle::addPolyhedron(std::uint32_t cell, const std::uint32_t* stream) {
  struct Vertex {
    Vector3 point;
    Vector3 data;
  };
  const auto meanOf = [&](const std::set<std::uint32_t>& vertices) {
    Vertex mean{Vector3::Zero(), Vector3::Zero()};
    for (const std::uint32_t vertex : vertices) {
      mean.point += grid_.points[vertex].cast<double>() / double(vertices.size());
      mean.data += dataOf(cell, vertex) / double(vertices.size());
    }
    return mean;
  };
  std::vector<std::vector<std::uint32_t>> faces;
  std::set<std::uint32_t> all;
  const std::uint32_t* next = stream + 1;
  for (std::uint32_t i = 0; i < stream[0]; ++i, next += 1 + *next) {
    faces.emplace_back(next + 1, next + 1 + *next);
    all.insert(faces.back().begin(), faces.back().end());
  }
  const Vertex centre = meanOf(all);
  for (const std::vector<std::uint32_t>& face : faces) {
    std::vector<Vertex> corners;
    for (const std::uint32_t vertex : face)
      corners.push_back({grid_.points[vertex].cast<double>(), dataOf(cell, vertex)});
    const auto add = [&](CellType type, const std::vector<Vertex>& vertices) {
      std::vector<Vector3> points;
      std::vector<Vector3> data;
      for (const Vertex& vertex : vertices) {
        points.push_back(vertex.point);
        data.push_back(vertex.data);
      }
      addPart(type, points, data);
    };
    if (face.size() == 3)
      add(CellType::kTetrahedron, {corners[0], corners[1], corners[2], centre});
    if (face.size() == 4)
      add(CellType::kPyramid, {corners[0], corners[1], corners[2], corners[3], centre});
    const Vertex middle = meanOf({face.begin(), face.end()});
    for (std::size_t i = 0; i < face.size() && face.size() > 4; ++i)
      add(CellType::kTetrahedron, {corners[i], corners[(i + 1) % face.size()], middle, centre});
  }
}

void RayOracle::makeBins() {
  for (const Part& part : parts_)
    box_.extend(part.box);
  const int side = std::max(1, int(std::cbrt(double(parts_.size()))));
  bins_ = Vector3i::Constant(std::min(2 * side, 100));
  parts_in_bin_.resize(std::size_t(bins_.prod()));
  const auto at = [&](const Vector3& p, int axis) {
    const double part = (p[axis] - box_.min()[axis]) / std::max(1e-12, box_.sizes()[axis]);
    return std::clamp(int(part * bins_[axis]), 0, bins_[axis] - 1);
  };
  for (std::size_t i = 0; i < parts_.size(); ++i) {
    const Box3& box = parts_[i].box;
    for (int z = at(box.min(), 2); z <= at(box.max(), 2); ++z) {
      for (int y = at(box.min(), 1); y <= at(box.max(), 1); ++y) {
        for (int x = at(box.min(), 0); x <= at(box.max(), 0); ++x)
          parts_in_bin_[std::size_t(x + bins_.x() * (y + bins_.y() * z))].push_back(std::uint32_t(i));
      }
    }
  }
}

std::size_t RayOracle::binOf(const Vector3& p) const {
  Vector3i at;
  for (int axis = 0; axis < 3; ++axis) {
    const double part = (p[axis] - box_.min()[axis]) / std::max(1e-12, box_.sizes()[axis]);
    at[axis] = std::clamp(int(part * bins_[axis]), 0, bins_[axis] - 1);
  }
  return std::size_t(at.x() + bins_.x() * (at.y() + bins_.y() * at.z()));
}

bool RayOracle::isIn(const Part& part, const Vector3& p) {
  if (part.box.exteriorDistance(p) > kOnSurface)
    return false;
  for (const double start : {0.3, 0.1, 0.6, 0.9}) {
    place_ = Vector3::Constant(start);
    if (solve(part.type, part.points, p, place_))
      return true;
    if (part.type == CellType::kTetrahedron)
      return false;  // linear: one start is enough
  }
  return false;
}

std::optional<double> RayOracle::scalarAt(const Vector3& p) {
  if (parts_.empty() || box_.exteriorDistance(p) > kOnSurface)
    return std::nullopt;
  bool found = solve(parts_[last_part_].type, parts_[last_part_].points, p, place_);
  if (!found) {
    for (const std::uint32_t part : parts_in_bin_[binOf(p)]) {
      if (!isIn(parts_[part], p))
        continue;
      last_part_ = part;
      found = true;
      break;
    }
  }
  if (!found)
    return std::nullopt;
  const Part& part = parts_[last_part_];
  const Vector3 data = interpolate(part.type, part.data, place_);
  return volume_ != nullptr ? volume_->sample(volume_->geometry().fromTexture(data)) : data.x();
}

OraclePixel RayOracle::march(const Camera& camera, double u, double v, double begin_z, double end_z, double threshold,
                             double fineness) {
  const bool parallel = camera.projection == Projection::kParallel;
  const Vector3 origin =
      parallel ? Vector3((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 0.0) : Vector3(Vector3::Zero());
  const Vector3 direction =
      parallel ? Vector3(Vector3::UnitZ()) : Vector3((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0);
  const auto at = [&](double z) { return scalarAt(origin + z * direction); };
  OraclePixel pixel;
  double left = 1.0;
  const auto addStep = [&](double from, double to, double scalar) {
    const TransferFunction::Sample sample = function_.evaluate(scalar);
    if (!(sample.opacity > 0.0F))
      return;
    const double absorption = -std::log(std::max(1e-12, 1.0 - double(sample.opacity))) / function_.unit_distance_m;
    const double after = left * std::exp(-absorption * (to - from) * direction.norm());
    pixel.rgba.head<3>() += (left - after) * sample.colour.cast<double>();
    if (after <= 1.0 - threshold && left > 1.0 - threshold)
      pixel.depth_m = from + (to - from) * std::log(left / (1.0 - threshold)) / std::log(left / after);
    left = after;
  };
  // Where the surface lies between two depths of which only the first is inside or outside.
  const auto surfaceBetween = [&](double from, double to, bool from_inside) {
    for (int i = 0; i < 40; ++i) {
      const double middle = 0.5 * (from + to);
      (at(middle).has_value() == from_inside ? from : to) = middle;
    }
    return from;
  };
  const double longest = fineness * box_.sizes().z() / 8.0;
  const double largest_change = fineness * 2.0 * smallestInterval(function_);
  const double last = std::min(end_z, box_.max().z() + kOnSurface);
  double z = std::max(begin_z, box_.min().z() - kOnSurface);
  double step = longest;
  std::optional<double> scalar = at(z);
  while (z < last && left > 1e-6) {
    const double to = std::min(z + step, last);
    const std::optional<double> next = at(to);
    if (scalar && next && std::abs(*next - *scalar) > largest_change && step > kShortest) {
      step *= 0.5;
      continue;
    }
    if (scalar && next)
      addStep(z, to, 0.5 * (*scalar + *next));
    // At a surface one goes on from it, in small steps, to see what is there.
    const bool crosses = scalar.has_value() != next.has_value();
    const double surface = crosses ? surfaceBetween(z, to, scalar.has_value()) : to;
    if (crosses && scalar && surface - z > kShortest) {
      step = 0.5 * (surface - z);
      continue;
    }
    z = crosses ? surface + 2.0 * kOnSurface : to;
    scalar = crosses ? at(z) : next;
    step = crosses ? longest / 64.0 : std::min(longest, 2.0 * step);
  }
  pixel.rgba[3] = 1.0 - left;
  return pixel;
}

OraclePixel RayOracle::trace(const Camera& camera, double u, double v, double begin_z, double end_z,
                             double depth_threshold, double accuracy) {
  double fineness = 1.0 / 8.0;
  OraclePixel coarse = march(camera, u, v, begin_z, end_z, depth_threshold, fineness);
  int equal = 0;
  for (int halvings = 0; halvings < 10; ++halvings) {
    fineness *= 0.5;
    const OraclePixel fine = march(camera, u, v, begin_z, end_z, depth_threshold, fineness);
    equal = (fine.rgba - coarse.rgba).cwiseAbs().maxCoeff() < accuracy ? equal + 1 : 0;
    coarse = fine;
    if (equal == 2)
      break;
  }
  return coarse;
}

}  // namespace soft_volume::core
