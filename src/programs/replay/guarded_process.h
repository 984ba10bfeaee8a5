#pragma once

#include <functional>
#include <string>
#include <vector>

namespace soft_volume::replay_program {

/// Runs `work` in a child process with limited memory, and returns its exit code: rosbag's library crashes on some
/// damaged bags, and a damaged length may ask for any amount of memory. A child that dies is `died`'s to tell of.
/// Throws ReplayError when no process can be started.
int runGuarded(const std::vector<std::string>& bags, const std::function<int()>& work,
               const std::function<int(int signal)>& died);

}  // namespace soft_volume::replay_program
