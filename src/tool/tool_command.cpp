#include "soft_volume/tool/tool_command.h"

namespace soft_volume::core {
ToolForceCommand toCommand(const std::string& tool_id, const TissueForce& force) {
  ToolForceCommand command;
  command.header = {force.header, tool_id, 0};
  command.hold_steps = force.hold_steps;
  command.force_n = force.force_n;
  command.point_m = force.point_m;
  command.footprint_radius_m = force.footprint_radius_m;
  if (force.cell)
    command.cells.push_back(*force.cell);
  return command;
}

ToolCutCommand toCommand(const std::string& tool_id, const TissueCut& cut) {
  ToolCutCommand command;
  command.header = {cut.header, tool_id, 0};
  if (cut.quad)
    command.quads.push_back(*cut.quad);
  command.lifted = cut.lifted;
  return command;
}

}  // namespace soft_volume::core
