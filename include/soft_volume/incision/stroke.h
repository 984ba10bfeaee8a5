#pragma once

#include <array>
#include <optional>
#include <utility>
#include <vector>

#include "soft_volume/incision/blade_cut.h"
#include "soft_volume/tool/tool_command.h"

namespace soft_volume::core {

/// Joins the short sweeps of a blade into quads that are wide enough to cut with (see blade_cut.h), without gaps: every
/// quad starts with exactly the edge where the one before ended, and the first and last edge are those of the sweeps.
///
/// A quad is complete when an end of the edge has moved by the stride since its start, or earlier when the blade would
/// leave it by more than the tolerance, but never before its width is enough. So the incision is behind the blade by
/// less than the stride. It owns the lips of the cut that its quads make, for cutMesh(). Not thread-safe.
class Stroke {
 public:
  /// Lengths in metres: `least_width_m` of a quad, which what is left at the end of a stroke need not have.
  struct Settings {
    double stride_m;
    double least_width_m;
    double tolerance_m;
  };
  /// A place of the blade's edge.
  struct Edge {
    Vector3 tip = Vector3::Zero();
    Vector3 heel = Vector3::Zero();
    bool operator==(const Edge& other) const { return tip == other.tip && heel == other.heel; }
  };
  /// All that a stroke under way remembers, as a saved state holds it.
  struct State {
    std::vector<Edge> edges;  ///< since the last quad ended; the first is where it did, or where the stroke begins
    Edge blade;               ///< where the last sweep ended
    bool has_joint = false;   ///< a quad of this stroke has ended
    Lips lips;
  };
  explicit Stroke(const Settings& settings) : settings_(settings) {}
  Stroke(const Settings& settings, State state) : settings_(settings), state_(std::move(state)) {}
  const State& state() const { return state_; }

  /// Takes a sweep and appends the quads that became complete. A sweep that does not start with the edge where the last
  /// one ended begins a new stroke.
  void add(const SweptQuad& sweep, std::vector<SweptQuad>& quads);
  /// Ends the stroke and appends what is left.
  void end(std::vector<SweptQuad>& quads);
  /// To be given to cutMesh() with the quads, all of them, in order.
  Lips& lips() { return state_.lips; }

  /// Tip and heel of the blade where the last quad of this stroke ended; nothing before its first and after its end.
  std::optional<std::array<Vector3, 2>> joint() const;
  /// Puts them where the tissue that they cut has gone since, so that the next quad starts there. For a stroke that has
  /// a joint, after cutMesh() had its quads. The sweeps after it stay where they were.
  void moveJoint(const std::array<Vector3, 2>& edge_m);

 private:
  bool leaves(const Edge& next) const;
  void emit(std::vector<SweptQuad>& quads);

  Settings settings_;
  State state_;
};

}  // namespace soft_volume::core
