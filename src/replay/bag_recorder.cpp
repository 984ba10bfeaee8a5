#include "soft_volume/replay/bag_recorder.h"

#include <fcntl.h>
#include <rosbag/bag.h>
#include <sys/file.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <cstring>
#include <deque>
#include <filesystem>
#include <map>
#include <mutex>
#include <thread>
#include <utility>

#include "soft_volume/common/error.h"

namespace soft_volume {
namespace {

using Clock = std::chrono::steady_clock;

/// Together with the time that a write takes this stays under the half second that the header promises.
constexpr std::chrono::milliseconds kChunkInterval(400);
constexpr std::uint32_t kChunkBytes = 768 * 1024;
/// What a queued message costs beside its bytes.
constexpr std::uint64_t kQueueOverhead = 256;

struct Queued {
  std::string topic;
  ros::Time receipt;
  boost::shared_ptr<const AnyMessage> message;
  boost::shared_ptr<ros::M_string> header;
  std::uint64_t bytes() const { return message->size() + kQueueOverhead; }
};

std::string systemError() {
  return std::strerror(errno);
}

std::uint64_t freeBytes(const std::string& file) {
  std::string folder = std::filesystem::path(file).parent_path().string();
  if (folder.empty())
    folder = ".";
  struct statvfs info;
  if (statvfs(folder.c_str(), &info) != 0)
    throw core::FileError(file + ": no free space is known: " + systemError());
  return std::uint64_t(info.f_bavail) * info.f_frsize;
}

std::string mebibytes(std::uint64_t bytes) {
  return std::to_string(bytes >> 20) + " MiB";
}

/// Holds FILE.active for this process as long as it lives, so that two recorders cannot write the same file.
class ActiveFile {
 public:
  explicit ActiveFile(const std::string& file) : path_(file + ".active") {
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
  ~ActiveFile() {
    if (descriptor_ >= 0)
      ::close(descriptor_);
  }
  ActiveFile(const ActiveFile&) = delete;
  ActiveFile& operator=(const ActiveFile&) = delete;

  const std::string& path() const { return path_; }

 private:
  bool open(int flags) {
    descriptor_ = ::open(path_.c_str(), flags | O_CLOEXEC, 0644);
    if (descriptor_ < 0)
      return false;
    if (flock(descriptor_, LOCK_EX | LOCK_NB) == 0)
      return true;
    ::close(descriptor_);
    throw core::FileError(path_ + ": another recorder is writing it; choose another file");
  }

  /// A bag that a killed recorder left behind holds data that may be the only copy.
  void keepInterrupted(const std::string& file) const {
    std::string kept = file + ".interrupted";
    for (int n = 2; std::filesystem::exists(kept); ++n)
      kept = file + ".interrupted." + std::to_string(n);
    std::filesystem::rename(path_, kept);
  }

  std::string path_;
  int descriptor_ = -1;
};

}  // namespace

class BagRecorder::Impl {
 public:
  explicit Impl(const BagRecorderSettings& settings) : settings_(settings), active_(settings.file) {
    checkSpace();
    try {
      bag_->open(active_.path(), rosbag::bagmode::Write);
      bag_->setCompression(settings.compress ? rosbag::compression::LZ4 : rosbag::compression::Uncompressed);
      bag_->setChunkThreshold(kChunkBytes);
    } catch (const rosbag::BagException& error) {
      throw core::FileError(active_.path() + ": cannot be written: " + error.what());
    }
    status_.recording = true;
    thread_ = std::thread([this] { run(); });
  }

  bool push(Queued queued, bool latched) {
    const std::lock_guard<std::mutex> lock(mutex_);
    const std::uint64_t bytes = queued.bytes();
    if (!status_.recording || closing_ || (!latched && queue_bytes_ + bytes > settings_.queue_bytes)) {
      ++status_.dropped;
      return false;
    }
    queue_bytes_ += bytes;
    queue_.push_back(std::move(queued));
    wake_.notify_one();
    return true;
  }

  void close(const std::string& reason) {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (!closing_)
        close_reason_ = reason;
      closing_ = true;
    }
    wake_.notify_one();
    const std::lock_guard<std::mutex> joining(join_mutex_);
    if (thread_.joinable())
      thread_.join();
  }

  Status status() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return status_;
  }

 private:
  void run() {
    std::string reason;
    try {
      while (takeBatch())
        writeBatch();
      reason = close_reason_;
    } catch (const std::exception& error) {
      reason = error.what();
    }
    stop(reason + finish());
  }

  /// Waits for messages, but not beyond the time at which the open chunk is to be closed. False when nothing is left to
  /// do.
  bool takeBatch() {
    std::unique_lock<std::mutex> lock(mutex_);
    wake_.wait_until(lock, chunk_deadline_, [this] { return closing_ || !queue_.empty(); });
    // The bytes stay accounted for until they are written.
    batch_.swap(queue_);
    return !closing_ || !batch_.empty();
  }

  void writeBatch() {
    while (!batch_.empty()) {
      writeOne(batch_.front());
      written(batch_.front().bytes());
      batch_.pop_front();
      if (Clock::now() >= chunk_deadline_)
        closeChunk();
    }
    if (Clock::now() >= chunk_deadline_)
      closeChunk();
  }

  void written(std::uint64_t bytes) {
    const std::lock_guard<std::mutex> lock(mutex_);
    queue_bytes_ -= bytes;
    ++status_.messages;
  }

  void writeOne(const Queued& queued) {
    bag_->write(queued.topic, queued.receipt, *queued.message, queued.header);
    if (chunk_restart_) {
      // The message above went into a chunk of its own. See closeChunk().
      chunk_restart_ = false;
      bag_->setChunkThreshold(kChunkBytes);
    }
    chunk_written_ = true;
  }

  /// Setting a threshold closes the open chunk, but keeps rosbag's copy of it in memory; only a chunk that ends by its
  /// size lets it go. So the threshold stays 0 for one message.
  void closeChunk() {
    if (chunk_written_) {
      bag_->setChunkThreshold(0);
      chunk_restart_ = true;
      chunk_written_ = false;
      // rosbag gives no access to its FILE. This hands its buffer, with the chunk's index, to the kernel.
      std::fflush(nullptr);
    }
    chunk_deadline_ = Clock::now() + kChunkInterval;
    checkSpace();
  }

  void checkSpace() {
    const std::uint64_t free_bytes = freeBytes(settings_.file);
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      status_.free_bytes = free_bytes;
      if (status_.recording)
        status_.bytes = bag_->getSize();
    }
    if (free_bytes < settings_.reserve_bytes) {
      throw core::FileError(settings_.file + ": the disk has " + mebibytes(free_bytes) +
                            " left, less than the reserve of " + mebibytes(settings_.reserve_bytes) +
                            "; free some space or lower the reserve");
    }
  }

  /// Returns what went wrong, or nothing.
  std::string finish() {
    try {
      bag_->close();
      std::filesystem::rename(active_.path(), settings_.file);
    } catch (const std::exception& error) {
      // A bag that could not be closed would try again in its destructor, and throw from there.
      static_cast<void>(bag_.release());
      return "; closing failed: " + std::string(error.what()) + " (rosbag reindex " + active_.path() +
             " saves what was written)";
    }
    return "";
  }

  void stop(const std::string& reason) {
    std::error_code ignored;
    const std::uintmax_t bytes = std::filesystem::file_size(settings_.file, ignored);
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!ignored)
      status_.bytes = bytes;
    status_.recording = false;
    status_.stop_reason = reason;
    status_.dropped += queue_.size() + batch_.size();
    queue_.clear();
    batch_.clear();
  }

  const BagRecorderSettings settings_;
  ActiveFile active_;
  std::unique_ptr<rosbag::Bag> bag_ = std::make_unique<rosbag::Bag>();

  mutable std::mutex mutex_;
  std::condition_variable wake_;
  std::deque<Queued> queue_;
  std::uint64_t queue_bytes_ = 0;
  Status status_;
  bool closing_ = false;
  std::string close_reason_;
  std::mutex join_mutex_;

  // The thread's own.
  std::deque<Queued> batch_;
  bool chunk_written_ = false;
  bool chunk_restart_ = false;
  Clock::time_point chunk_deadline_ = Clock::now() + kChunkInterval;
  std::thread thread_;
};

namespace {

/// rosbag tells connections apart by the content of their headers, and a reader needs three fields.
boost::shared_ptr<ros::M_string> completeHeader(const AnyMessage& message,
                                                const boost::shared_ptr<ros::M_string>& header, bool latched) {
  const bool complete = header && header->count("type") && header->count("md5sum") &&
                        header->count("message_definition") && (!latched || header->count("latching"));
  if (complete)
    return header;
  const auto result = header ? boost::make_shared<ros::M_string>(*header) : boost::make_shared<ros::M_string>();
  result->emplace("type", message.getDataType());
  result->emplace("md5sum", message.getMD5Sum());
  result->emplace("message_definition", message.getMessageDefinition());
  if (latched)
    (*result)["latching"] = "1";
  return result;
}

}  // namespace

BagRecorder::BagRecorder(const BagRecorderSettings& settings) : impl_(std::make_unique<Impl>(settings)) {}

BagRecorder::~BagRecorder() {
  impl_->close("the recorder ended");
}

bool BagRecorder::write(const std::string& topic, const ros::Time& receipt, boost::shared_ptr<const AnyMessage> message,
                        const boost::shared_ptr<ros::M_string>& header, bool latched) {
  auto complete = completeHeader(*message, header, latched);
  // A clock that has not started yet stands at zero, which a bag cannot hold.
  return impl_->push({topic, std::max(receipt, ros::TIME_MIN), std::move(message), std::move(complete)}, latched);
}

void BagRecorder::close(const std::string& reason) {
  impl_->close(reason);
}

BagRecorder::Status BagRecorder::status() const {
  return impl_->status();
}

}  // namespace soft_volume
