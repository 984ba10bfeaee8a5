#pragma once

#include <optional>

#include "soft_volume/common/geometry.h"
#include "soft_volume/tool/patch_contact.h"
#include "soft_volume/tool/tool_command.h"

namespace soft_volume::core {

/// The stroke of a blade: turns poses into the quads that its edge sweeps through tissue.
///
/// The edge runs from the tip (the pose's position) along the tool's +z axis, which points up the shaft to the hand. A
/// quad is emitted once one end of the edge has moved at least `min_move_m` since the last quad, and starts where that
/// one ended, so a stroke has no gaps whatever its speed, and a blade that stands still cuts nothing. The stroke begins
/// with the last pose before the tissue, so that the skin is cut too, and it ends, without a rest shorter than
/// `min_move_m`, when the blade has been out of the tissue for 5 mm of its way, the button is let go or the device
/// fails: an incision that gapes, or one that is crossed, does not break a stroke in two. No allocation; one thread at
/// a time.
class Scalpel {
 public:
  Scalpel(double blade_length_m, double min_move_m) : blade_length_m_(blade_length_m), min_move_m_(min_move_m) {}

  struct Sweep {
    std::optional<SweptQuad> quad;  ///< what the edge swept since the last one
    bool ended = false;             ///< the blade has left the tissue, which ends a stroke that cut
  };
  /// Call for every pose while the cut button is held.
  Sweep cut(const PatchContact& field, const Pose& pose);
  /// Ends the stroke: the next cut() starts a new one. True when it had cut.
  bool lift();
  /// True while the edge of the last cut() was in tissue.
  bool inTissue() const { return start_ && start_->in_tissue; }

 private:
  struct Edge {
    Vector3 tip;
    Vector3 heel;
    bool in_tissue = false;
  };
  bool edgeInTissue(const PatchContact& field, const Vector3& tip, const Vector3& heel) const;
  bool sweptTissue(const PatchContact& field, const Edge& from, const Edge& to) const;

  double blade_length_m_;
  double min_move_m_;
  std::optional<Edge> start_;     // edge where the next quad begins; in_tissue is that of the newest pose
  bool start_in_tissue_ = false;  // whether the quad's beginning lies in tissue
  bool has_cut_ = false;          // the stroke under way has emitted quads
  double in_air_m_ = 0.0;         // way of the blade since it was in tissue
};

}  // namespace soft_volume::core
