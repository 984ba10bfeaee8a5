#pragma once

#include <string>

#include "report.h"

namespace soft_volume::core::validate {

/// Press, slide, cut and press again in a block.
void hapticStrokes(const Options& options, Report& report);
/// A shipped scene with its own tools, device and scripted hand; skipped where its volume is missing.
void hapticScene(const std::string& name, const Options& options, Report& report);
/// Press, slide, cut and press again in the cutting scene, with its tools and device.
void strokesInCuttingScene(const Options& options, Report& report);

}  // namespace soft_volume::core::validate
