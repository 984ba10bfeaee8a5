#pragma once

#include <string>
#include <vector>

#include "soft_volume/replay/recorded_run.h"
#include "soft_volume/scene/device_profile.h"
#include "soft_volume/tool/device_streams.h"

namespace soft_volume {

/// What a device did in a recorded run.
struct DeviceRecording {
  std::vector<core::DeviceSample> samples;  ///< in the order of their stamps
  std::string frame_id;                     ///< of the poses
  std::vector<std::string> notes;
};

/// Reads the topics of the device. `volume_frame`: the frame that poses have to be in without a profile (null).
/// Throws ReplayError when they are not.
DeviceRecording readDevice(const RecordedRun& run, const core::DeviceProfile* profile, const std::string& volume_frame);

}  // namespace soft_volume
