#include "soft_volume/volume/volume_reader.h"

#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <climits>
#include <cstdlib>
#include <cstring>
#include <new>
#include <system_error>
#include <utility>
#include <vector>

#include "child_process.h"
#include "reader_protocol.h"
#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

constexpr const char* kReaderName = "soft_volume_read_volume";
constexpr std::size_t kFirstBlock = std::size_t(1) << 20;
constexpr std::size_t kLongestErrorText = 4096;

std::string besideThisProgram() {
  char path[PATH_MAX];
  const ssize_t length = readlink("/proc/self/exe", path, sizeof path);
  const std::string program(path, length > 0 ? static_cast<std::size_t>(length) : 0);
  return program.substr(0, program.find_last_of('/') + 1) + kReaderName;
}

bool isProgram(const std::string& path) {
  return access(path.c_str(), X_OK) == 0;
}

std::string findReader(const std::string& path) {
  const char* chosen = std::getenv("SOFT_VOLUME_READER");
  if (chosen != nullptr && *chosen != '\0') {
    if (isProgram(chosen)) {
      return chosen;
    }
    throw FileError(path + ": the variable SOFT_VOLUME_READER names " + chosen + ", which cannot be executed");
  }
  const std::array<std::string, 3> places = {besideThisProgram(), SOFT_VOLUME_READER_BUILT,
                                             SOFT_VOLUME_READER_INSTALLED};
  const auto found = std::find_if(places.begin(), places.end(), isProgram);
  if (found == places.end()) {
    throw FileError(path + ": cannot be read because the program " + kReaderName + " is missing (looked for " +
                    places[0] + ", " + places[1] + " and " + places[2] +
                    "); build with SOFT_VOLUME_READER=ON or name it in the variable SOFT_VOLUME_READER");
  }
  return *found;
}

void checkExists(const std::string& path) {
  struct stat status;
  if (stat(path.c_str(), &status) != 0) {
    throw FileError(path + ": cannot be read: " + std::strerror(errno));
  }
}

std::string withMebibytes(std::uint64_t bytes) {
  return std::to_string(bytes >> 20) + " MiB";
}

/// One line of printable characters, whatever the child or a damaged file put there.
std::string printable(std::string text) {
  const auto unprintable = [](unsigned char c) { return c < 0x20 || c == 0x7F; };
  std::replace_if(text.begin(), text.end(), unprintable, ' ');
  text.erase(0, std::min(text.find_first_not_of(' '), text.size()));
  text.erase(text.find_last_not_of(' ') + 1);
  return text;
}

std::string describeEnd(int status) {
  if (status >= 0 && WIFSIGNALED(status)) {
    return std::string("ended by signal ") + std::to_string(WTERMSIG(status)) + ", " + strsignal(WTERMSIG(status));
  }
  if (status >= 0 && WIFEXITED(status)) {
    return "exit code " + std::to_string(WEXITSTATUS(status));
  }
  return "it ended early";
}

/// The child ended without a complete answer.
[[noreturn]] void throwDied(const std::string& path, ChildProcess& child) {
  const std::string end = describeEnd(child.wait());
  const std::string complaints = printable(child.complaints());
  throw FileError(path + ": the reader died (" + end + (complaints.empty() ? "" : "; " + complaints) +
                  "); the file is probably damaged, or it needs more memory than allowed");
}

[[noreturn]] void throwReported(const std::string& path, ChildProcess& child, const std::string& beginning) {
  std::string text(kLongestErrorText, '\0');
  text.resize(child.read(text.data(), text.size()));
  throw FileError(path + ": " + printable(beginning + text));
}

/// The reply is checked like any input: the child parsed a foreign file and may have been damaged by it.
VolumeGeometry geometryOf(const VolumeReply& reply) {
  VolumeGeometry geometry;
  geometry.dims = Eigen::Map<const Vector3i>(reply.dims);
  geometry.spacing_m = Eigen::Map<const Vector3>(reply.spacing_m);
  geometry.origin_m = Eigen::Map<const Vector3>(reply.origin_m);
  geometry.direction = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(reply.direction);
  return geometry;
}

void checkReply(const VolumeReply& reply, const std::string& path, const ReadLimits& limits) {
  if (std::memcmp(reply.magic, kVolumeMagic, sizeof reply.magic) != 0 || reply.version != kReaderProtocolVersion) {
    throw FileError(path + ": the reader's answer is not understood; " + kReaderName + " is of another version");
  }
  if (reply.scalar_type > static_cast<std::uint32_t>(ScalarType::kFloat64)) {
    throw FileError(path + ": the reader's answer has an unknown scalar type");
  }
  if (reply.byte_count > limits.memory_bytes) {
    throw FileError(path + ": the volume has " + withMebibytes(reply.byte_count) + ", more than the limit of " +
                    withMebibytes(limits.memory_bytes));
  }
}

VolumeReply receiveReply(ChildProcess& child, const std::string& path, const ReadLimits& limits) {
  VolumeReply reply;
  const std::size_t got = child.read(&reply, sizeof reply);
  const char* bytes = reinterpret_cast<const char*>(&reply);
  if (got >= sizeof kErrorMagic && std::memcmp(bytes, kErrorMagic, sizeof kErrorMagic) == 0) {
    throwReported(path, child, std::string(bytes + sizeof kErrorMagic, got - sizeof kErrorMagic));
  }
  if (got < sizeof reply) {
    throwDied(path, child);
  }
  checkReply(reply, path, limits);
  return reply;
}

/// Grows with the bytes that arrive, so that a false claim costs nothing.
std::vector<std::uint8_t> receiveData(ChildProcess& child, const std::string& path, std::uint64_t byte_count) {
  std::vector<std::uint8_t> data;
  while (data.size() < byte_count) {
    const std::size_t have = data.size();
    data.resize(std::min<std::size_t>(byte_count, std::max(kFirstBlock, 2 * have)));
    if (child.read(data.data() + have, data.size() - have) < data.size() - have) {
      throwDied(path, child);
    }
  }
  return data;
}

Volume receiveVolume(ChildProcess& child, const std::string& path, const ReadLimits& limits) {
  const VolumeReply reply = receiveReply(child, path, limits);
  std::vector<std::uint8_t> data = receiveData(child, path, reply.byte_count);
  const int status = child.wait();
  if (status > 0) {
    throw FileError(path + ": the reader failed after sending its data (" + describeEnd(status) + ")");
  }
  return Volume(geometryOf(reply), static_cast<ScalarType>(reply.scalar_type), std::move(data));
}

}  // namespace

Volume readVolume(const std::string& path, const ReadLimits& limits) try {
  checkExists(path);
  ChildProcess child(findReader(path), {std::to_string(limits.memory_bytes), path}, limits.time_s);
  return receiveVolume(child, path, limits);
} catch (const ChildProcess::TimeLimitReached&) {
  throw FileError(path + ": reading took longer than " + std::to_string(limits.time_s) +
                  " s and was stopped; the file may be damaged, not a regular file, or on a slow disk");
} catch (const InputError& error) {
  throw FileError(path + ": " + error.what());
} catch (const std::system_error& error) {
  throw FileError(path + ": " + error.what());
} catch (const std::bad_alloc&) {
  throw FileError(path + ": there is not enough memory for this volume; use a smaller file");
}

}  // namespace soft_volume::core
