#pragma once

#include <soft_volume/RecordingInfo.h>

namespace soft_volume {

/// Versions, definitions, all parameters of the master, and hashes of the files that they name. Asks the master, so it
/// takes some milliseconds. What cannot be had is left empty.
RecordingInfo makeRecordingInfo();

}  // namespace soft_volume
