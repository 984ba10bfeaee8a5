#include "face_hits.h"

#include <algorithm>
#include <array>

namespace soft_volume::core {
namespace {

/// A point as the line of sight sees it: the line is at (0, 0).
struct Seen {
  double a = 0.0;
  double b = 0.0;
};

/// Exactly -cross(q, p).
double cross(const Seen& p, const Seen& q) {
  return p.a * q.b - p.b * q.a;
}

Seen operator-(const Seen& p, const Seen& q) {
  return {p.a - q.a, p.b - q.b};
}

Seen see(const Ray& ray, const Vector3& p) {
  return {p.x() - ray.x - ray.slope_x * p.z(), p.y() - ray.y - ray.slope_y * p.z()};
}

/// What the edge adds to the number of times that a polygon runs around the line.
int crossing(const Seen& p, const Seen& q) {
  if (p.b <= 0.0 && q.b > 0.0)
    return cross(p, q) > 0.0 ? 1 : 0;
  if (p.b > 0.0 && q.b <= 0.0)
    return cross(p, q) < 0.0 ? -1 : 0;
  return 0;
}

/// NaN becomes the middle.
double limit(double x) {
  return x >= 0.0 ? std::min(x, 1.0) : (x < 0.0 ? 0.0 : 0.5);
}

/// How far outside [0, 1].
double excess(double x) {
  return x >= 0.0 ? std::max(0.0, x - 1.0) : (x < 0.0 ? -x : 1e300);
}

/// Where a bilinear patch is at the line: at most two solutions of p0 + u e + v f + u v g = 0.
class PatchRoots {
 public:
  explicit PatchRoots(const std::array<Seen, 4>& p) : p_(p), e_(p[1] - p[0]), f_(p[3] - p[0]), g_((p[2] - p[1]) - f_) {
    const double quadratic = cross(g_, f_);
    const double linear = cross(e_, f_) - cross(p[0], g_);
    const double constant = cross(e_, p[0]);
    const double discriminant = linear * linear - 4.0 * quadratic * constant;
    real_ = discriminant > 0.0;
    root_ = std::sqrt(std::max(0.0, discriminant));
    const double turn = linear >= 0.0 ? root_ : -root_;
    const double q = -0.5 * (linear + turn);
    add(constant / q, turn);
    add(q / quadratic, -turn);
  }

  struct Root {
    double u, v;
    double turn;  ///< which side of the patch is seen there: its sign
    double outside() const { return std::max(excess(u), excess(v)); }
  };
  const Root& nearest() const { return roots_[0].outside() <= roots_[1].outside() ? roots_[0] : roots_[1]; }
  /// The two roots when both lie on the patch, which then covers itself.
  bool areTwo() const { return real_ && roots_[0].outside() <= 0.0 && roots_[1].outside() <= 0.0; }
  const Root& operator[](std::size_t i) const { return roots_[i]; }

 private:
  void add(double v, double turn) {
    const Seen along = {e_.a + v * g_.a, e_.b + v * g_.b};
    const Seen from = {p_[0].a + v * f_.a, p_[0].b + v * f_.b};
    const double u = std::abs(along.a) > std::abs(along.b) ? -from.a / along.a : -from.b / along.b;
    roots_[count_++] = {u, v, turn};
  }

  const std::array<Seen, 4>& p_;
  Seen e_, f_, g_;
  bool real_ = false;
  double root_ = 0.0;
  std::array<Root, 2> roots_{};
  std::size_t count_ = 0;
};

class FaceIntersection {
 public:
  FaceIntersection(const std::vector<Vector3>& positions, const PieceFace& face, std::uint32_t number,
                   std::vector<FaceHit>& hits)
      : positions_(positions), face_(face), number_(number), hits_(hits) {}

  void triangle(const std::array<Seen, 4>& p) {
    const int winding = crossing(p[0], p[1]) + crossing(p[1], p[2]) + crossing(p[2], p[0]);
    if (winding == 0)
      return;
    const double w0 = std::abs(cross(p[1], p[2]));
    const double w1 = std::abs(cross(p[2], p[0]));
    const double w2 = std::abs(cross(p[0], p[1]));
    const double sum = w0 + w1 + w2;
    addTriangle(sum > 0.0 ? w1 / sum : 1.0 / 3.0, sum > 0.0 ? w2 / sum : 1.0 / 3.0, winding);
  }

  void patch(const std::array<Seen, 4>& p, bool may_fold) {
    const int winding = crossing(p[0], p[1]) + crossing(p[1], p[2]) + crossing(p[2], p[3]) + crossing(p[3], p[0]);
    if (winding == 0 && !may_fold)
      return;
    const PatchRoots roots(p);
    if (winding != 0)
      return addPatch(roots.nearest(), winding);
    if (!roots.areTwo())
      return;
    addPatch(roots[0], roots[0].turn > 0.0 ? 1 : -1);
    addPatch(roots[1], roots[0].turn > 0.0 ? -1 : 1);
  }

 private:
  double z(std::size_t corner) const { return positions_[face_.vertices[corner]].z(); }

  void addTriangle(double u, double v, int winding) {
    hits_.push_back({z(0) + u * (z(1) - z(0)) + v * (z(2) - z(0)), float(u), float(v), number_, winding});
  }

  void addPatch(const PatchRoots::Root& root, int winding) {
    const double u = limit(root.u);
    const double v = limit(root.v);
    const double near = z(0) + u * (z(1) - z(0));
    const double far = z(3) + u * (z(2) - z(3));
    hits_.push_back({near + v * (far - near), float(u), float(v), number_, winding});
  }

  const std::vector<Vector3>& positions_;
  const PieceFace& face_;
  const std::uint32_t number_;
  std::vector<FaceHit>& hits_;
};

}  // namespace

void intersect(const Ray& ray, const std::vector<Vector3>& positions, const PieceFace& face, std::uint32_t number,
               bool may_fold, std::vector<FaceHit>& hits) {
  FaceIntersection intersection(positions, face, number, hits);
  std::array<Seen, 4> seen;
  for (std::size_t i = 0; i < 3; ++i)
    seen[i] = see(ray, positions[face.vertices[i]]);
  if (face.isTriangle())
    return intersection.triangle(seen);
  seen[3] = see(ray, positions[face.vertices[3]]);
  intersection.patch(seen, may_fold);
}

}  // namespace soft_volume::core
