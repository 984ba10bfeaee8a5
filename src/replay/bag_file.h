#pragma once

#include <rosbag/bag.h>

#include <chrono>
#include <cstdint>
#include <memory>
#include <string>

#include "queued_message.h"

namespace soft_volume {

/// The number of the first part that a new recording of NAME.bag writes: beyond all that are there, whole or
/// interrupted, so that no recording is ever replaced by another.
std::uint32_t firstPart(const std::string& file);
/// NAME_2.bag for part 2 of NAME.bag.
std::string partFile(const std::string& file, std::uint32_t part);

/// Holds FILE.active for this process as long as it lives, so that two recorders cannot write the same file.
class ActiveFile {
 public:
  /// Throws core::FileError when it cannot be written or another recorder holds it. A former FILE.active is kept as
  /// FILE.interrupted.
  explicit ActiveFile(const std::string& file);
  ~ActiveFile();
  ActiveFile(const ActiveFile&) = delete;
  ActiveFile& operator=(const ActiveFile&) = delete;

  const std::string& path() const { return path_; }

 private:
  bool open(int flags);
  void keepInterrupted(const std::string& file) const;

  std::string path_;
  int descriptor_ = -1;
};

/// A bag that is being written as FILE.active, and of which little is lost whatever happens. Not thread-safe.
class BagFile {
 public:
  using Clock = std::chrono::steady_clock;

  /// Throws core::FileError when it cannot be written.
  BagFile(const std::string& file, bool compress);
  BagFile(const BagFile&) = delete;
  BagFile& operator=(const BagFile&) = delete;

  /// Throws rosbag::BagException when a write fails; then only abandon() makes sense.
  void write(const QueuedMessage& message);
  /// When the open chunk is to be closed at the latest.
  Clock::time_point chunkDeadline() const { return chunk_deadline_; }
  /// Hands everything to the kernel. Throws core::FileError when less than that has arrived in the file.
  void closeChunk();
  /// Ends the bag and renames it to FILE; a FILE that was there is kept as FILE.former, or FILE.former.2 and so on.
  /// Throws on failure; FILE.active then holds what was written.
  void close();
  bool isOpen() const { return bag_ && bag_->isOpen(); }
  /// Leaves FILE.active as it is.
  void abandon();

  const std::string& file() const { return file_; }
  const std::string& activePath() const { return active_.path(); }
  /// Size of the file [bytes].
  std::uint64_t bytes() const { return bag_->getSize(); }

 private:
  std::string file_;
  ActiveFile active_;
  std::unique_ptr<rosbag::Bag> bag_ = std::make_unique<rosbag::Bag>();
  bool chunk_written_ = false;
  bool chunk_restart_ = false;
  Clock::time_point chunk_deadline_;
};

}  // namespace soft_volume
