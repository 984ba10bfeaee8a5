#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// What a tool's tick says of the state that it worked on, without the tool's name.
struct TickHeader {
  std::uint64_t session = 0;
  std::uint32_t revision = 0;
  std::uint64_t step = 0;  ///< of the patch that it was computed on
  std::uint64_t sequence = 0;
};

/// What every command of a tool to the tissue carries; mirrors the leading fields of the messages ToolForce, ToolCut
/// and ToolGrip, whose comments define them.
struct ToolCommandHeader : TickHeader {
  std::string tool_id;
  std::uint64_t apply_at_step = 0;  ///< 0: next
};

/// A force on the tissue, spread over a footprint; volume frame.
struct ToolForceCommand {
  ToolCommandHeader header;
  std::uint32_t hold_steps = 0;
  Vector3 force_n = Vector3::Zero();
  Vector3 point_m = Vector3::Zero();
  double footprint_radius_m = 0.0;
  std::vector<std::uint32_t> cells;  ///< of the topology; what an incision parts from them is left alone
};

/// A quad swept by a blade's edge on the deformed tissue: tip and heel before, heel and tip after; volume frame,
/// metres.
using SweptQuad = std::array<Vector3, 4>;

struct ToolCutCommand {
  ToolCommandHeader header;
  std::vector<SweptQuad> quads;
  bool lifted = false;  ///< the stroke ends with these quads, which may then be none
};

/// Jaws that hold tissue and move it; volume frame.
struct ToolGripCommand {
  ToolCommandHeader header;
  std::uint32_t hold_steps = 0;
  bool closed = false;
  Vector3 point_m = Vector3::Zero();  ///< where they close, on the deformed tissue
  double radius_m = 0.0;
  Pose pose;  ///< of the jaws; what they hold follows its change since they closed
};

/// A ToolForceCommand as a tick gives it: of a fixed size, because a tick takes no memory.
struct TissueForce {
  TickHeader header;
  std::uint32_t hold_steps = 0;
  Vector3 force_n = Vector3::Zero();
  Vector3 point_m = Vector3::Zero();
  double footprint_radius_m = 0.0;
  std::optional<std::uint32_t> cell;  ///< that is pressed
};

/// A ToolCutCommand as a tick gives it: at most one quad.
struct TissueCut {
  TickHeader header;
  std::optional<SweptQuad> quad;
  bool lifted = false;
};

/// The commands in full, for the tool of that name.
ToolForceCommand toCommand(const std::string& tool_id, const TissueForce& force);
ToolCutCommand toCommand(const std::string& tool_id, const TissueCut& cut);

}  // namespace soft_volume::core
