#pragma once

#include <filesystem>
#include <string>

#include "soft_volume/replay/replay_bag.h"

namespace soft_volume::replay_program {

/// Makes a folder and those above it. Throws ReplayError.
inline void makeFolder(const std::string& path) {
  std::error_code error;
  std::filesystem::create_directories(path, error);
  if (error)
    throw ReplayError(path + ": the folder cannot be made: " + error.message());
}

}  // namespace soft_volume::replay_program
