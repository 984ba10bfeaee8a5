#include "bag_file.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>

#include "soft_volume/common/error.h"

namespace soft_volume {
namespace {

namespace fs = std::filesystem;

/// Together with the time that a write takes this stays under the half second that the recorder promises.
constexpr std::chrono::milliseconds kChunkInterval(400);
constexpr std::uint32_t kChunkBytes = 768 * 1024;

std::string systemError() {
  return std::strerror(errno);
}

/// The N of a file name STEM_N, STEM_N.bag, STEM_N.bag.active and so on; -1 for another name.
long partNumber(const std::string& name, const std::string& stem) {
  if (name.compare(0, stem.size() + 1, stem + "_") != 0)
    return -1;
  const std::string rest = name.substr(stem.size() + 1);
  const std::size_t digits = std::min(rest.find_first_not_of("0123456789"), rest.size());
  const bool is_part = digits > 0 && digits < 7 && (digits == rest.size() || rest[digits] == '.');
  return is_part ? std::stol(rest.substr(0, digits)) : -1;
}

/// BASE, BASE.2, BASE.3 and so on, the first that is not there yet.
std::string freeName(const std::string& base) {
  std::string name = base;
  for (int n = 2; fs::exists(name); ++n)
    name = base + "." + std::to_string(n);
  return name;
}

}  // namespace

std::uint32_t firstPart(const std::string& file) {
  const fs::path path(file);
  const fs::path folder = path.has_parent_path() ? path.parent_path() : fs::path(".");
  long last = -1;
  std::error_code unreadable;  // then the file cannot be opened either, which says why
  for (const fs::directory_entry& entry : fs::directory_iterator(folder, unreadable))
    last = std::max(last, partNumber(entry.path().filename().string(), path.stem().string()));
  return static_cast<std::uint32_t>(last + 1);
}

std::string partFile(const std::string& file, std::uint32_t part) {
  const fs::path path(file);
  const std::string name = path.stem().string() + "_" + std::to_string(part) + path.extension().string();
  return (path.parent_path() / name).string();
}

ActiveFile::ActiveFile(const std::string& file) : path_(file + ".active") {
  const bool existed = open(O_RDWR);
  if (existed) {
    keepInterrupted(file);
    ::close(descriptor_);
  }
  if (existed || descriptor_ < 0)
    open(O_RDWR | O_CREAT);
  if (descriptor_ < 0)
    throw core::FileError(path_ + ": cannot be written: " + systemError());
}

ActiveFile::~ActiveFile() {
  if (descriptor_ >= 0)
    ::close(descriptor_);
}

bool ActiveFile::open(int flags) {
  descriptor_ = ::open(path_.c_str(), flags | O_CLOEXEC, 0644);
  if (descriptor_ < 0)
    return false;
  if (flock(descriptor_, LOCK_EX | LOCK_NB) == 0)
    return true;
  ::close(descriptor_);
  throw core::FileError(path_ + ": another recorder is writing it; choose another file");
}

/// A bag that a killed recorder left behind holds data that may be the only copy.
void ActiveFile::keepInterrupted(const std::string& file) const {
  fs::rename(path_, freeName(file + ".interrupted"));
}

BagFile::BagFile(const std::string& file, bool compress)
    : file_(file), active_(file), chunk_deadline_(Clock::now() + kChunkInterval) {
  try {
    bag_->open(active_.path(), rosbag::bagmode::Write);
    bag_->setCompression(compress ? rosbag::compression::LZ4 : rosbag::compression::Uncompressed);
    bag_->setChunkThreshold(kChunkBytes);
  } catch (const rosbag::BagException& error) {
    abandon();
    throw core::FileError(active_.path() + ": cannot be written: " + error.what());
  }
}

void BagFile::write(const QueuedMessage& message) {
  bag_->write(message.topic, message.receipt, *message.message, message.header);
  if (chunk_restart_) {
    // The message above went into a chunk of its own. See closeChunk().
    chunk_restart_ = false;
    bag_->setChunkThreshold(kChunkBytes);
  }
  chunk_written_ = true;
}

/// Setting a threshold closes the open chunk, but keeps rosbag's copy of it in memory; only a chunk that ends by its
/// size lets it go. So the threshold stays 0 for one message.
void BagFile::closeChunk() {
  chunk_deadline_ = Clock::now() + kChunkInterval;
  if (!chunk_written_)
    return;
  bag_->setChunkThreshold(0);
  chunk_restart_ = true;
  chunk_written_ = false;
  // rosbag gives no access to its FILE. This hands its buffer, with the chunk's index, to the kernel; what fails here
  // rosbag never learns of.
  std::fflush(nullptr);
  std::error_code unknown;
  const std::uintmax_t arrived = fs::file_size(active_.path(), unknown);
  if (!unknown && arrived < bag_->getSize())
    throw core::FileError(active_.path() + ": cannot be written: the disk took only " + std::to_string(arrived) +
                          " of " + std::to_string(bag_->getSize()) + " bytes; is it full?");
}

void BagFile::close() {
  bag_->close();
  // A recorder that is started again after each end has the same file every time.
  if (fs::exists(file_))
    fs::rename(file_, freeName(file_ + ".former"));
  fs::rename(active_.path(), file_);
}

/// A bag that could not be written would try again in its destructor, and throw from there.
void BagFile::abandon() {
  static_cast<void>(bag_.release());
}

}  // namespace soft_volume
