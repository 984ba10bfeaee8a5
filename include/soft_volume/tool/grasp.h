#pragma once

#include <cstdint>

#include "soft_volume/common/geometry.h"
#include "soft_volume/tool/patch_contact.h"

namespace soft_volume::core {

/// Jaws that hold a point of the tissue by a spring, in any direction.
///
/// They grip what is nearest when they close, if it is within reach, and the spring is slack there and then. They let
/// go when they open, when the spring pulls harder than they can hold, and when a cut parts the tissue that they hold;
/// then they hold nothing until they have been opened and closed again. Allocates nothing; one thread at a time.
class Grasp {
 public:
  struct Hold {
    bool holding = false;
    bool slipped = false;                        ///< let go in this update, by force or by a cut
    Vector3 force_n = Vector3::Zero();           ///< wished force on the device; the tissue takes the opposite
    Vector3 point_m = Vector3::Zero();           ///< the gripped point of the tissue, volume frame
    Vector3 velocity_m_s = Vector3::Zero();      ///< of it, as it is shown
    Vector3 anchor_m = Vector3::Zero();          ///< where the jaws feel no force: the spring's end in the tissue
    std::uint32_t cell = PatchContact::kNoCell;  ///< the topology's number of the cell that is gripped
  };

  /// `reach_m`: farthest tissue that closing jaws grip; `slip_force_n`: the most that they hold.
  Grasp(double reach_m, double slip_force_n) : reach_m_(reach_m), slip_force_n_(slip_force_n) {}

  /// Call once per tick, also while the jaws are open. `jaws_m` is their place, volume frame, and `stiffness_n_m` that
  /// of the spring.
  Hold update(const PatchContact& field, const Vector3& jaws_m, bool closed, double stiffness_n_m);
  bool holding() const { return holding_; }
  /// Lets go; the jaws count as open.
  void reset();

 private:
  void grip(const PatchContact& field, const Vector3& jaws_m);
  bool carry(const PatchContact& field);

  double reach_m_;
  double slip_force_n_;
  bool closed_ = false;
  bool holding_ = false;
  std::uint32_t revision_ = 0;
  std::uint32_t cell_id_ = 0;
  std::uint32_t cut_faces_ = 0;
  PatchContact::CellPoint at_;
  Vector3 point_m_ = Vector3::Zero();
  Vector3 offset_m_ = Vector3::Zero();  // from the gripped point to the jaws as they closed
};

}  // namespace soft_volume::core
