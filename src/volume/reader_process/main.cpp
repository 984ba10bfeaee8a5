// soft_volume_read_file KIND MEMORY_BYTES PATH ...: parses one file of a volume or a grid and writes it to standard
// output in the form of reader_protocol.h. It is a process of its own because the parsers crash on some damaged files;
// started by readVolume() and readGrid().

#include <sys/prctl.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <new>
#include <string>
#include <vector>

#include "formats.h"
#include "header_text.h"
#include "volume/reader_protocol.h"

namespace soft_volume::core::reader {
namespace {

/// Address space that this process has now: its libraries (and a sanitizer's shadow memory).
std::uint64_t currentAddressSpace() {
  std::uint64_t pages = 0;
  std::ifstream("/proc/self/statm") >> pages;
  return pages * static_cast<std::uint64_t>(sysconf(_SC_PAGESIZE));
}

void limitResources(std::uint64_t memory_bytes) {
  const std::uint64_t space = currentAddressSpace() + memory_bytes;
  const rlimit memory = {space, space};
  setrlimit(RLIMIT_AS, &memory);
  const rlimit no_core = {0, 0};
  setrlimit(RLIMIT_CORE, &no_core);
  prctl(PR_SET_PDEATHSIG, SIGKILL);  // a parent that was killed must not leave us waiting on a file
}

/// Libraries print to standard output; the reply must not be mixed with that.
int takeStandardOutput() {
  const int reply = dup(STDOUT_FILENO);
  dup2(STDERR_FILENO, STDOUT_FILENO);
  return reply;
}

void writeAll(int file, const void* data, std::size_t size) {
  const char* next = static_cast<const char*>(data);
  while (size > 0) {
    const ssize_t done = write(file, next, size);
    if (done < 0 && errno != EINTR) {
      std::_Exit(2);  // nobody listens any more
    }
    if (done > 0) {
      next += done;
      size -= static_cast<std::size_t>(done);
    }
  }
}

Image readAny(const std::string& path, std::uint64_t limit) {
  const std::string name = lowerCase(path);
  if (std::filesystem::is_directory(path)) {
    return readDicomFolder(path, limit);
  }
  if (endsWith(name, ".nii") || endsWith(name, ".nii.gz")) {
    return readNifti(path, limit);
  }
  if (endsWith(name, ".nrrd") || endsWith(name, ".nhdr")) {
    return readNrrd(path, limit);
  }
  if (endsWith(name, ".mha") || endsWith(name, ".mhd")) {
    return readMetaImage(path, limit);
  }
  if (endsWith(name, ".vti")) {
    return readVti(path, limit);
  }
  throw ReadError(
      "the type of this file is not known; use .nii, .nii.gz, .nrrd, .nhdr, .mha, .mhd, .vti or a folder with one "
      "DICOM series");
}

VolumeReply replyFor(const Image& image) {
  VolumeReply reply = {};
  std::memcpy(reply.magic, kVolumeMagic, sizeof reply.magic);
  reply.version = kReaderProtocolVersion;
  reply.scalar_type = static_cast<std::uint32_t>(image.type);
  Eigen::Map<Vector3i>(reply.dims) = image.geometry.dims;
  Eigen::Map<Vector3>(reply.spacing_m) = image.geometry.spacing_m;
  Eigen::Map<Vector3>(reply.origin_m) = image.geometry.origin_m;
  Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(reply.direction) = image.geometry.direction;
  reply.byte_count = image.byte_count;
  return reply;
}

void writeImage(int file, const Image& image) {
  const VolumeReply reply = replyFor(image);
  writeAll(file, &reply, sizeof reply);
  writeAll(file, image.bytes, image.byte_count);
}

/// A grid whose axes form a left hand (many NIfTI files, DICOM seen from the feet) would show the patient mirrored in
/// the volume frame. Its slices are sent in the reverse order, from the other end.
void writeMirroredImage(int file, const Image& image) {
  Image turned = image;
  VolumeGeometry& geometry = turned.geometry;
  geometry.origin_m += geometry.direction.col(2) * (geometry.spacing_m.z() * (geometry.dims.z() - 1));
  geometry.direction.col(2) *= -1.0;
  const VolumeReply reply = replyFor(turned);
  writeAll(file, &reply, sizeof reply);
  const std::uint64_t slice_bytes = image.byte_count / static_cast<std::uint64_t>(geometry.dims.z());
  for (int k = geometry.dims.z() - 1; k >= 0; --k) {
    writeAll(file, image.bytes + static_cast<std::uint64_t>(k) * slice_bytes, slice_bytes);
  }
}

[[noreturn]] void fail(int file, const std::string& reason) {
  writeAll(file, kErrorMagic, sizeof kErrorMagic);
  writeAll(file, reason.data(), reason.size());
  std::_Exit(1);
}

void sendVolume(int file, const std::string& path, std::uint64_t memory_bytes) {
  const Image image = readAny(path, memory_bytes);
  if (image.geometry.direction.determinant() > 0.0) {
    writeImage(file, image);
  } else {
    writeMirroredImage(file, image);
  }
}

template <typename T>
void writeArray(int file, const std::vector<T>& values) {
  writeAll(file, values.data(), values.size() * sizeof(T));
}

GridReply replyFor(const GridFile& grid_file) {
  GridReply reply = {};
  std::memcpy(reply.magic, kGridMagic, sizeof reply.magic);
  reply.version = kReaderProtocolVersion;
  reply.place = static_cast<std::uint32_t>(grid_file.arrays.at(grid_file.taken).place);
  reply.taken = static_cast<std::uint32_t>(grid_file.taken);
  reply.arrays = static_cast<std::uint32_t>(grid_file.arrays.size());
  reply.notes = static_cast<std::uint32_t>(grid_file.notes.size());
  reply.points = grid_file.grid.points.size();
  reply.cells = grid_file.grid.cell_types.size();
  reply.connectivity = grid_file.grid.connectivity.size();
  return reply;
}

void writeArrayReply(int file, const GridArray& array) {
  ArrayReply reply = {};
  std::copy(array.range.begin(), array.range.end(), reply.range);
  reply.place = static_cast<std::uint32_t>(array.place);
  reply.components = static_cast<std::uint32_t>(array.components);
  reply.name_bytes = static_cast<std::uint32_t>(array.name.size());
  writeAll(file, &reply, sizeof reply);
  writeAll(file, array.name.data(), array.name.size());
}

void sendGrid(int file, const std::string& path, const GridReadOptions& options) {
  const GridFile grid_file = readGridFile(path, options);
  const GridReply reply = replyFor(grid_file);
  const IrregularGrid& grid = grid_file.grid;
  writeAll(file, &reply, sizeof reply);
  writeArray(file, grid.points);
  writeArray(file, grid.cell_types);
  writeArray(file, grid.cell_offsets);
  writeArray(file, grid.connectivity);
  writeArray(file, grid.point_scalars);  // one of the two is empty
  writeArray(file, grid.cell_scalars);
  for (const GridArray& array : grid_file.arrays)
    writeArrayReply(file, array);
  for (const std::string& note : grid_file.notes) {
    const auto bytes = static_cast<std::uint32_t>(note.size());
    writeAll(file, &bytes, sizeof bytes);
    writeAll(file, note.data(), note.size());
  }
}

void run(int file, const std::vector<std::string>& arguments) {
  const std::uint64_t memory_bytes = std::strtoull(arguments[1].c_str(), nullptr, 10);
  try {
    limitResources(memory_bytes);
    if (arguments[0] == kReadVolume) {
      sendVolume(file, arguments[2], memory_bytes);
    } else {
      sendGrid(file, arguments[2], {arguments[4], std::atoi(arguments[5].c_str()), arguments[3]});
    }
  } catch (const std::bad_alloc&) {
    fail(file, "needs more memory than the limit of " + std::to_string(memory_bytes >> 20) + " MiB");
  } catch (const std::exception& error) {
    fail(file, error.what());
  }
}

bool isUsable(const std::vector<std::string>& arguments) {
  return (arguments.size() == 3 && arguments[0] == kReadVolume) || (arguments.size() == 6 && arguments[0] == kReadGrid);
}

}  // namespace
}  // namespace soft_volume::core::reader

int main(int argc, char** argv) {
  using namespace soft_volume::core::reader;
  const std::vector<std::string> arguments(argv + 1, argv + argc);
  if (!isUsable(arguments)) {
    std::fprintf(stderr,
                 "usage: soft_volume_read_file volume MEMORY_BYTES PATH\n"
                 "       soft_volume_read_file grid MEMORY_BYTES PATH SOLUTION_PATH ARRAY COMPONENT\n"
                 "Parses a file for soft_volume's readVolume() and readGrid(), which start it; not meant to be run by "
                 "hand.\n");
    return 2;
  }
  run(takeStandardOutput(), arguments);
  std::_Exit(0);  // all is written; freeing gigabytes would only take time
}
