#include "soft_volume/tool/grasp.h"

#include <cmath>

#include "directions.h"

namespace soft_volume::core {
namespace {

constexpr int kRings = 8;
constexpr double kTolerance_m = 1e-6;

/// The first tissue on the way to a point in tissue.
PatchContact::CellPoint firstTissue(const PatchContact& field, Vector3 outside_m, Vector3 inside_m) {
  PatchContact::CellPoint at = field.sample(inside_m).at;
  while ((inside_m - outside_m).norm() > kTolerance_m) {
    const Vector3 middle = 0.5 * (inside_m + outside_m);
    const PatchContact::Sample sample = field.sample(middle, at.cell);
    if (sample.tissue) {
      inside_m = middle;
      at = sample.at;
    } else {
      outside_m = middle;
    }
  }
  return at;
}

/// The tissue nearest to a point, as rings of 26 directions find it; not found where there is none within reach.
PatchContact::CellPoint nearestTissue(const PatchContact& field, const Vector3& from_m, double reach_m) {
  const PatchContact::Sample here = field.sample(from_m);
  if (here.tissue)
    return here.at;
  for (int ring = 1; ring <= kRings; ++ring) {
    const double radius_m = reach_m * ring / kRings;
    for (const Vector3& direction : directions()) {
      const Vector3 there_m = from_m + radius_m * direction;
      if (field.sample(there_m).tissue)
        return firstTissue(field, from_m + (radius_m - reach_m / kRings) * direction, there_m);
    }
  }
  return {};
}

}  // namespace

void Grasp::reset() {
  closed_ = false;
  holding_ = false;
}

void Grasp::grip(const PatchContact& field, const Vector3& jaws_m) {
  at_ = nearestTissue(field, jaws_m, reach_m_);
  holding_ = at_.found();
  if (!holding_)
    return;
  revision_ = field.revision();
  cell_id_ = field.cellId(at_.cell);
  cut_faces_ = field.cutFaceCount(at_.cell);
  point_m_ = field.position(at_);
  offset_m_ = jaws_m - point_m_;
}

// Where the gripped tissue is now; false where it was parted, or is not in the patch any more.
bool Grasp::carry(const PatchContact& field) {
  at_.cell = field.cellOfId(cell_id_);
  if (!at_.found())
    return false;
  if (field.revision() != revision_) {
    // The cell may have another shape by now; the tissue is where it was.
    if (field.cutFaceCount(at_.cell) > cut_faces_)
      return false;
    at_ = field.locate(point_m_, at_.cell);
    if (!at_.found())
      return false;
    revision_ = field.revision();
    cell_id_ = field.cellId(at_.cell);
    cut_faces_ = field.cutFaceCount(at_.cell);
  }
  point_m_ = field.position(at_);
  return true;
}

Grasp::Hold Grasp::update(const PatchContact& field, const Vector3& jaws_m, bool closed, double stiffness_n_m) {
  Hold hold;
  const bool closing = closed && !closed_;
  closed_ = closed;
  if (!closed)
    holding_ = false;
  else if (closing)
    grip(field, jaws_m);
  if (!holding_)
    return hold;
  const bool carried = carry(field);
  hold.anchor_m = point_m_ + offset_m_;
  hold.force_n = stiffness_n_m * (hold.anchor_m - jaws_m);
  if (!carried || !(hold.force_n.norm() <= slip_force_n_)) {
    holding_ = false;
    hold = {};
    hold.slipped = true;
    return hold;
  }
  hold.holding = true;
  hold.point_m = point_m_;
  hold.velocity_m_s = field.velocity(at_);
  hold.cell = cell_id_;
  return hold;
}

}  // namespace soft_volume::core
