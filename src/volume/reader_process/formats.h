#pragma once

#include <string>

#include "image.h"
#include "soft_volume/grid/grid_reader.h"

namespace soft_volume::core::reader {

/// Each reads one file (or folder), refuses more than one component and more than `limit` bytes, and throws ReadError.
Image readNifti(const std::string& path, std::uint64_t limit);
Image readNrrd(const std::string& path, std::uint64_t limit);
Image readMetaImage(const std::string& path, std::uint64_t limit);
Image readVti(const std::string& path, std::uint64_t limit);
Image readDicomFolder(const std::string& path, std::uint64_t limit);

/// Reads a grid as readGrid() does; throws ReadError.
GridFile readGridFile(const std::string& path, const GridReadOptions& options);

}  // namespace soft_volume::core::reader
