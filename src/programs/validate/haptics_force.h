#pragma once

#include "report.h"

namespace soft_volume::core::validate {

void forceAgainstDepth(const Options& options, Report& report);

}  // namespace soft_volume::core::validate
