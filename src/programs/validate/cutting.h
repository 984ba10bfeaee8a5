#pragma once

#include "report.h"

// The parts of the suite of cuts.

namespace soft_volume::core::validate {

/// One of the loads under which random strokes cut a block.
enum class CutLoad { kNone, kCompressed, kSheared };

void randomCuts(CutLoad load, bool lips_press, const Options& options, Report& report);
void slicesOfCuts(const Options& options, Report& report);
void lipsUnderLoad(const Options& options, Report& report);
void barCutInTwo(const Options& options, Report& report);
void endOfACut(const Options& options, Report& report);
void stepOfCutTissue(const Options& options, Report& report);
void costOfCuts(const Options& options, Report& report);

}  // namespace soft_volume::core::validate
