#include "soft_volume/replay/bag_recorder.h"

#include <rosbag/bag.h>
#include <sys/statvfs.h>

#include <algorithm>
#include <condition_variable>
#include <cstring>
#include <deque>
#include <filesystem>
#include <map>
#include <mutex>
#include <thread>
#include <utility>

#include "bag_file.h"
#include "part_start.h"
#include "queued_message.h"
#include "soft_volume/common/error.h"

namespace soft_volume {
namespace {

using Clock = std::chrono::steady_clock;

std::uint64_t freeBytes(const std::string& file) {
  std::string folder = std::filesystem::path(file).parent_path().string();
  if (folder.empty())
    folder = ".";
  struct statvfs info;
  if (statvfs(folder.c_str(), &info) != 0)
    throw core::FileError(file + ": no free space is known: " + std::strerror(errno));
  return std::uint64_t(info.f_bavail) * info.f_frsize;
}

std::string mebibytes(std::uint64_t bytes) {
  return std::to_string(bytes >> 20) + " MiB";
}

/// The least whole number of MiB that holds them.
std::string mebibytesFor(std::uint64_t bytes) {
  return std::to_string((bytes >> 20) + 1);
}

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

class BagRecorder::Impl {
 public:
  explicit Impl(const BagRecorderSettings& settings)
      : settings_(settings), next_part_(settings.split_bytes > 0 ? firstPart(settings.file) : 0) {
    checkSpace();
    openNext();
    status_.recording = true;
    thread_ = std::thread([this] { run(); });
  }

  bool push(QueuedMessage message) {
    const std::lock_guard<std::mutex> lock(mutex_);
    const std::uint64_t bytes = message.bytes();
    if (!status_.recording || closing_ || (!message.latched && queue_bytes_ + bytes > settings_.queue_bytes)) {
      ++status_.dropped;
      return false;
    }
    if (settings_.split_bytes > 0)
      start_.hear(message);
    queue_bytes_ += bytes;
    queue_.push_back(std::move(message));
    if (settings_.split_bytes > 0)
      splitWhenDue();
    wake_.notify_one();
    return true;
  }

  void close(const std::string& reason) {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      endWith(reason);
    }
    wake_.notify_one();
    const std::lock_guard<std::mutex> joining(join_mutex_);
    if (thread_.joinable())
      thread_.join();
  }

  Status status() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    Status status = status_;
    status.split_waits = status_.recording && part_full_;
    return status;
  }

 private:
  void endWith(const std::string& reason) {
    if (!closing_)
      close_reason_ = reason;
    closing_ = true;
  }

  /// Only at a message that came, because the next part begins with what came before.
  void splitWhenDue() {
    if (!start_checked_ || part_full_) {
      if (!start_.ready())
        return;
      checkSplitSize();
    }
    if (!part_full_ || closing_)
      return;
    part_full_ = false;
    ++parts_queued_;
    std::vector<QueuedMessage> messages = start_.messages();
    QueuedMessage begin;
    begin.start_messages = messages.size();
    messages.insert(messages.begin(), begin);
    for (QueuedMessage& message : messages) {
      queue_bytes_ += message.bytes();
      queue_.push_back(std::move(message));
    }
  }

  void checkSplitSize() {
    if (start_checked_)
      return;
    start_checked_ = true;
    const std::uint64_t latched = start_.latchedBytes();
    if (latched < settings_.split_bytes)
      return;
    status_.refused = true;
    endWith("parts of " + mebibytes(settings_.split_bytes) + " are too small: each begins with " +
            std::to_string(latched) + " bytes of latched messages (volume, scene, topology and others), so split_mib " +
            "must be at least " + mebibytesFor(latched));
  }

  void run() {
    std::string reason;
    try {
      while (takeBatch())
        writeBatch();
      reason = close_reason_;
    } catch (const rosbag::BagException& error) {
      reason = bag_->activePath() + ": cannot be written (" + error.what() + "); is the disk full?";
    } catch (const std::exception& error) {
      reason = error.what();
    }
    stop(reason + finish(reason));
  }

  /// Waits for messages, but not beyond the time at which the open chunk is to be closed. False when nothing is left to
  /// do.
  bool takeBatch() {
    std::unique_lock<std::mutex> lock(mutex_);
    wake_.wait_until(lock, bag_->chunkDeadline(), [this] { return closing_ || !queue_.empty(); });
    // The bytes stay accounted for until they are written.
    batch_.swap(queue_);
    return !closing_ || !batch_.empty();
  }

  void writeBatch() {
    while (!batch_.empty()) {
      if (batch_.front().message) {
        write(batch_.front());
      } else {
        beginPart(batch_.front().start_messages);
      }
      written(batch_.front());
      batch_.pop_front();
      if (settings_.split_bytes > 0)
        checkPart();
      if (Clock::now() >= bag_->chunkDeadline())
        closeChunk();
    }
    if (Clock::now() >= bag_->chunkDeadline())
      closeChunk();
  }

  void write(const QueuedMessage& message) {
    bag_->write(message);
    last_receipt_ = message.receipt;
    if (start_left_ > 0 && --start_left_ == 0)
      begin_bytes_ = bag_->bytes();
  }

  void written(const QueuedMessage& message) {
    const std::lock_guard<std::mutex> lock(mutex_);
    queue_bytes_ -= message.bytes();
    status_.messages += message.message ? 1 : 0;
  }

  void beginPart(std::size_t start_messages) {
    const std::string next = partFile(settings_.file, next_part_);
    writeLast(next, "");
    bag_->close();
    closed_bytes_ += std::filesystem::file_size(bag_->file());
    openNext();
    start_left_ = start_messages;
    const std::lock_guard<std::mutex> lock(mutex_);
    ++status_.parts;
    --parts_queued_;
  }

  void openNext() {
    const std::string file = settings_.split_bytes > 0 ? partFile(settings_.file, next_part_++) : settings_.file;
    bag_ = std::make_unique<BagFile>(file, settings_.compress);
    const std::lock_guard<std::mutex> lock(mutex_);
    status_.file = file;
  }

  void closeChunk() {
    bag_->closeChunk();
    checkSpace();
  }

  void checkPart() {
    const bool full = start_left_ == 0 && bag_->bytes() >= std::max(settings_.split_bytes, 2 * begin_bytes_);
    const std::lock_guard<std::mutex> lock(mutex_);
    part_full_ = full && parts_queued_ == 0;
  }

  void checkSpace() {
    const std::uint64_t free_bytes = freeBytes(settings_.file);
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      status_.free_bytes = free_bytes;
      if (status_.recording)
        status_.bytes = closed_bytes_ + bag_->bytes();
    }
    if (free_bytes < settings_.reserve_bytes) {
      throw core::FileError(settings_.file + ": the disk has " + mebibytes(free_bytes) +
                            " left, less than the reserve of " + mebibytes(settings_.reserve_bytes) +
                            "; free some space or lower the reserve");
    }
  }

  void writeLast(const std::string& next_file, const std::string& reason) {
    if (!settings_.last_message)
      return;
    QueuedMessage last;
    last.topic = settings_.last_topic;
    last.message = settings_.last_message(next_file, reason);
    last.receipt = last_receipt_;
    last.header = completeHeader(*last.message, nullptr, false);
    bag_->write(last);
  }

  /// Returns what went wrong, or nothing.
  std::string finish(const std::string& reason) {
    try {
      if (bag_->isOpen()) {
        writeLast("", reason);
        bag_->close();
      }
    } catch (const std::exception& error) {
      bag_->abandon();
      return "; closing failed: " + std::string(error.what()) + " (with some space, `rosbag reindex -f '" +
             bag_->activePath() + "'` saves what was written)";
    }
    const std::lock_guard<std::mutex> lock(mutex_);
    status_.closed = true;
    return "";
  }

  void stop(const std::string& reason) {
    std::error_code ignored;
    const std::uintmax_t bytes = std::filesystem::file_size(bag_->file(), ignored);
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!ignored)
      status_.bytes = closed_bytes_ + bytes;
    status_.recording = false;
    status_.stop_reason = reason;
    for (const auto* list : {&queue_, &batch_})
      status_.dropped += std::count_if(list->begin(), list->end(), [](const auto& queued) { return queued.message; });
    queue_.clear();
    batch_.clear();
  }

  const BagRecorderSettings settings_;

  mutable std::mutex mutex_;
  std::condition_variable wake_;
  std::deque<QueuedMessage> queue_;
  std::uint64_t queue_bytes_ = 0;
  Status status_;
  bool closing_ = false;
  std::string close_reason_;
  PartStart start_;
  bool start_checked_ = false;
  bool part_full_ = false;
  std::size_t parts_queued_ = 0;
  std::mutex join_mutex_;

  // The thread's own.
  std::uint32_t next_part_;
  std::unique_ptr<BagFile> bag_;
  ros::Time last_receipt_ = ros::TIME_MIN;
  std::size_t start_left_ = 0;      ///< of what the part begins with
  std::uint64_t begin_bytes_ = 0;   ///< of the part, when it held what it begins with
  std::uint64_t closed_bytes_ = 0;  ///< of the parts before
  std::deque<QueuedMessage> batch_;
  std::thread thread_;
};

BagRecorder::BagRecorder(const BagRecorderSettings& settings) : impl_(std::make_unique<Impl>(settings)) {}

BagRecorder::~BagRecorder() {
  impl_->close("the recorder ended");
}

bool BagRecorder::write(const std::string& topic, const ros::Time& receipt, boost::shared_ptr<const AnyMessage> message,
                        const boost::shared_ptr<ros::M_string>& header, bool latched) {
  auto complete = completeHeader(*message, header, latched);
  // A clock that has not started yet stands at zero, which a bag cannot hold.
  return impl_->push({topic, std::max(receipt, ros::TIME_MIN), std::move(message), std::move(complete), latched});
}

void BagRecorder::close(const std::string& reason) {
  impl_->close(reason);
}

BagRecorder::Status BagRecorder::status() const {
  return impl_->status();
}

}  // namespace soft_volume
