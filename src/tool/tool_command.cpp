#include "soft_volume/tool/tool_command.h"

namespace soft_volume::core {
namespace {

ToolCommandHeader fullHeader(const std::string& tool_id, const TickHeader& tick) {
  ToolCommandHeader header;
  header.session = tick.session;
  header.revision = tick.revision;
  header.step = tick.step;
  header.tool_id = tool_id;
  header.sequence = tick.sequence;
  return header;
}

}  // namespace

ToolForceCommand toCommand(const std::string& tool_id, const TissueForce& force) {
  ToolForceCommand command;
  command.header = fullHeader(tool_id, force.header);
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
  command.header = fullHeader(tool_id, cut.header);
  if (cut.quad)
    command.quads.push_back(*cut.quad);
  command.lifted = cut.lifted;
  return command;
}

}  // namespace soft_volume::core
