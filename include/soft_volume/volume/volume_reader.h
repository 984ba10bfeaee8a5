#pragma once

#include <cstdint>
#include <string>

#include "soft_volume/volume/volume.h"

namespace soft_volume::core {

/// Limits for the child process that parses a file. The defaults fit a 1024^3 int16 CT on a workstation.
struct ReadLimits {
  std::uint64_t memory_bytes = std::uint64_t(8)
                               << 30;  ///< address space that the child may take above its own libraries
  double time_s = 120.0;               ///< wall-clock time after which the child is ended
};

/// Reads NIfTI (.nii, .nii.gz), NRRD (.nrrd, .nhdr), MetaImage (.mhd, .mha), VTI (.vti) or a folder with one DICOM
/// series, in a child process (`soft_volume_read_file`), because parsers crash on some damaged files. Millimetres
/// become metres and the file's orientation is kept. The scalars keep their type.
///
/// The grid of the result is right-handed: where the file's axes form a left hand, the slices come in reverse order, so
/// that the volume frame never shows the patient mirrored. Slope and intercept (NIfTI, DICOM) are applied, which may
/// turn integers into floats. Without a statement in the file lengths are millimetres; VTI is taken as RAS.
///
/// Throws FileError with the path and the reason: missing, unknown type, the reader's own errors, more than one
/// component, fewer bytes than the header claims, the child's death, or a limit reached. Blocks; not real-time safe;
/// safe to call from several threads.
Volume readVolume(const std::string& path, const ReadLimits& limits = {});

/// Writes a MetaImage: `path` ends in .mha (one file) or .mhd (header beside a .raw file). Throws FileError.
void writeMetaImage(const Volume& volume, const std::string& path);

}  // namespace soft_volume::core
