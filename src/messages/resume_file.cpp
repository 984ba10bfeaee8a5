#include "soft_volume/messages/resume_file.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <thread>
#include <utility>

#include "soft_volume/common/error.h"
#include "soft_volume/common/hash.h"
#include "soft_volume/messages/conversions.h"
#include "soft_volume/messages/journal.h"

#ifndef SOFT_VOLUME_VERSION
#error "the build defines SOFT_VOLUME_VERSION"
#endif

namespace soft_volume {
namespace {

constexpr std::uint32_t kCheckpointRecord = 1;
constexpr std::uint32_t kJournalRecord = 2;
constexpr std::uint32_t kPauseRecord = 3;
constexpr std::chrono::seconds kLockWait(3);

using Bytes = std::vector<std::uint8_t>;

/// What stands before every payload.
struct RecordHead {
  std::uint64_t kind = 0;
  std::uint64_t size = 0;
  std::uint64_t payload_hash = 0;
  std::uint64_t head_hash = 0;  ///< of the three above

  std::uint64_t hash() const { return core::hashBytes(this, offsetof(RecordHead, head_hash)); }
};
static_assert(sizeof(RecordHead) == 32, "written as it lies in memory");

/// Only the same program version can give the same bits, and only the same messages can be read.
std::string title() {
  return std::string("soft_volume resume file 1, version " SOFT_VOLUME_VERSION ", ") +
         ros::message_traits::md5sum<SimulationCheckpoint>() + " " + ros::message_traits::md5sum<SimulationJournal>() +
         "\n";
}

Bytes record(std::uint32_t kind, const Bytes& payload) {
  RecordHead head;
  head.kind = kind;
  head.size = payload.size();
  head.payload_hash = core::hashVector(payload);
  head.head_hash = head.hash();
  Bytes bytes(sizeof(head) + payload.size());
  std::memcpy(bytes.data(), &head, sizeof(head));
  std::copy(payload.begin(), payload.end(), bytes.begin() + sizeof(head));
  return bytes;
}

std::string reasonOf(int error) {
  return std::strerror(error);
}

/// Reads records one after the other; a kill leaves the last one incomplete.
class RecordReader {
 public:
  explicit RecordReader(const std::string& path) : path_(path), in_(path, std::ios::binary) {
    in_.seekg(0, std::ios::end);
    left_ = static_cast<std::uint64_t>(in_.tellg());
    in_.seekg(0);
    std::string line(title().size(), ' ');
    take(line.data(), line.size());
    if (line != title())
      throw core::FileError(path + ": it was not written by this version of soft_volume");
  }

  /// Null at the end. Throws FileError when a record is damaged.
  std::optional<std::pair<std::uint64_t, Bytes>> next() {
    RecordHead head;
    if (left_ < sizeof(head))
      return std::nullopt;
    take(&head, sizeof(head));
    if (head.hash() != head.head_hash)
      throw core::FileError(path_ + ": the head of a record is damaged");
    if (head.size > left_)
      return std::nullopt;
    Bytes payload(head.size);
    take(payload.data(), payload.size());
    if (core::hashVector(payload) != head.payload_hash)
      throw core::FileError(path_ + ": a record is damaged");
    return std::make_pair(head.kind, std::move(payload));
  }

 private:
  void take(void* data, std::uint64_t size) {
    if (size > left_ || !in_.read(static_cast<char*>(data), static_cast<std::streamsize>(size)))
      throw core::FileError(path_ + ": it is too short");
    left_ -= size;
  }

  std::string path_;
  std::ifstream in_;
  std::uint64_t left_ = 0;
};

/// Takes a record after the checkpoint. False when it is of a run that began later, whose checkpoint is not there.
bool takeRecord(std::uint64_t kind, Bytes payload, KeptRun& run) {
  if (kind == kPauseRecord) {
    run.paused = !payload.empty() && payload[0] != 0;
    return true;
  }
  if (kind != kJournalRecord)
    throw core::InputError("a record of an unknown kind");
  auto journal = fromPayload<SimulationJournal>(std::move(payload));
  if (journal.session != run.checkpoint.session)
    return false;
  const std::uint64_t reached = run.journals.empty() ? run.checkpoint.step : run.journals.back().last_step;
  if (journal.first_step != reached)
    throw core::InputError("the journal has a gap");
  run.journals.push_back(std::move(journal));
  return true;
}

}  // namespace

/// A file that is open for one process alone, as long as this lives.
class ResumeFile::Lock {
 public:
  /// Throws FileError when another process has it for longer than the wait, or it cannot be made.
  explicit Lock(std::string path) : path_(std::move(path)) {
    const auto end = std::chrono::steady_clock::now() + kLockWait;
    while (!take()) {
      if (std::chrono::steady_clock::now() > end)
        throw core::FileError(path_ + ": another simulation keeps its run there; name another file (~resume_file)");
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
    }
  }
  ~Lock() { ::close(descriptor_); }
  Lock(const Lock&) = delete;
  Lock& operator=(const Lock&) = delete;

  void remove() const { ::unlink(path_.c_str()); }

 private:
  bool take() {
    descriptor_ = ::open(path_.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
    if (descriptor_ < 0)
      throw core::FileError(path_ + ": the run cannot be kept there: " + reasonOf(errno));
    if (::flock(descriptor_, LOCK_EX | LOCK_NB) == 0 && isThere())
      return true;
    ::close(descriptor_);
    return false;
  }
  /// The one before may have removed the file that was opened here.
  bool isThere() const {
    struct stat opened, named;
    return ::fstat(descriptor_, &opened) == 0 && ::stat(path_.c_str(), &named) == 0 && opened.st_ino == named.st_ino;
  }

  std::string path_;
  int descriptor_ = -1;
};

/// A file that is written to its end.
class ResumeFile::File {
 public:
  explicit File(const std::string& path)
      : path_(path), descriptor_(::open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644)) {
    if (descriptor_ < 0)
      throw core::FileError(path_ + ": the run cannot be kept there: " + reasonOf(errno));
  }
  ~File() { ::close(descriptor_); }
  File(const File&) = delete;
  File& operator=(const File&) = delete;

  /// Throws FileError; then nothing more is written, because it would follow half a record.
  void append(const void* data, std::size_t size) {
    const auto* bytes = static_cast<const std::uint8_t*>(data);
    while (size > 0 && !broken_) {
      const ssize_t written = ::write(descriptor_, bytes, size);
      if (written < 0 && errno == EINTR)
        continue;
      broken_ = written < 0;
      if (broken_)
        throw core::FileError(path_ + ": the run is no longer kept there: " + reasonOf(errno));
      bytes += written;
      size -= static_cast<std::size_t>(written);
    }
  }
  void append(const Bytes& bytes) { append(bytes.data(), bytes.size()); }

 private:
  std::string path_;
  int descriptor_;
  bool broken_ = false;
};

ResumeFile::ResumeFile(std::string path) : path_(std::move(path)), lock_(std::make_unique<Lock>(path_ + ".lock")) {}

ResumeFile::~ResumeFile() {
  if (writing_.valid())
    writing_.wait();
}

std::optional<KeptRun> ResumeFile::read() const {
  if (::access(path_.c_str(), F_OK) != 0)
    return std::nullopt;
  RecordReader reader(path_);
  KeptRun run;
  auto first = reader.next();
  if (!first || first->first != kCheckpointRecord)
    throw core::FileError(path_ + ": it has no checkpoint");
  try {
    run.checkpoint = fromPayload<SimulationCheckpoint>(std::move(first->second));
  } catch (const core::InputError& error) {
    throw core::FileError(path_ + ": " + error.what());
  }
  try {
    while (auto record = reader.next()) {
      if (!takeRecord(record->first, std::move(record->second), run))
        break;
    }
  } catch (const core::Error& error) {
    run.damage = error.what();
  }
  return run;
}

std::string ResumeFile::setAside() const {
  const std::string name = path_ + ".refused";
  std::rename(path_.c_str(), name.c_str());
  return name;
}

void ResumeFile::begin(boost::shared_ptr<const SimulationCheckpoint> checkpoint, bool paused) {
  const bool busy = writing_.valid() && writing_.wait_for(std::chrono::seconds(0)) != std::future_status::ready;
  // A disk that is too slow for the next checkpoint still takes the journal; that of another run has to be there.
  if (busy && checkpoint->session == session_)
    return;
  if (writing_.valid())
    writing_.get();
  session_ = checkpoint->session;
  replacing_ = true;
  writing_ = std::async(std::launch::async, [this, checkpoint, paused] { replace(*checkpoint, paused); });
}

/// In a thread of its own.
void ResumeFile::replace(const SimulationCheckpoint& checkpoint, bool paused) {
  const std::string next = path_ + ".next";
  std::string error;
  std::unique_ptr<File> file;
  try {
    file = std::make_unique<File>(next);
    const std::string line = title();
    file->append(line.data(), line.size());
    file->append(record(kCheckpointRecord, journalPayload(checkpoint)));
    file->append(record(kPauseRecord, {static_cast<std::uint8_t>(paused)}));
  } catch (const std::exception& failure) {
    error = failure.what();
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  if (error.empty())
    error = adopt(std::move(file));
  if (!error.empty())
    error_ = error;
  replacing_ = false;
  pending_.clear();
}

/// The file that is complete but for what was appended meanwhile takes the place of the one before. Returns what went
/// wrong.
std::string ResumeFile::adopt(std::unique_ptr<File> file) {
  try {
    for (const Bytes& bytes : pending_)
      file->append(bytes);
  } catch (const core::FileError& failure) {
    return failure.what();
  }
  if (std::rename((path_ + ".next").c_str(), path_.c_str()) != 0)
    return path_ + ": it cannot be replaced: " + reasonOf(errno);
  file_ = std::move(file);
  return "";
}

void ResumeFile::append(const SimulationJournal& journal) {
  appendRecord(kJournalRecord, journalPayload(journal));
}

void ResumeFile::setPaused(bool paused) {
  appendRecord(kPauseRecord, {static_cast<std::uint8_t>(paused)});
}

void ResumeFile::appendRecord(std::uint32_t kind, const Bytes& payload) {
  Bytes bytes = record(kind, payload);
  const std::lock_guard<std::mutex> lock(mutex_);
  try {
    if (file_)
      file_->append(bytes);
  } catch (const core::FileError& error) {
    error_ = error.what();
  }
  if (replacing_)
    pending_.push_back(std::move(bytes));
}

void ResumeFile::remove() {
  if (writing_.valid())
    writing_.get();
  ::unlink(path_.c_str());
  ::unlink((path_ + ".next").c_str());
  lock_->remove();
  file_.reset();
}

std::string ResumeFile::takeError() {
  const std::lock_guard<std::mutex> lock(mutex_);
  return std::exchange(error_, "");
}

namespace {

void advance(core::Session& session, std::uint64_t step) {
  while (session.steps() < step)
    session.step();
}

void repeat(const SimulationJournal& kept, core::Session& session, Journal& journal) {
  for (const JournalEntry& entry : kept.entries) {
    advance(session, entry.step);
    journal.reapply(entry);
  }
  advance(session, kept.last_step);
  journal.take();
  if (session.simulation().stateHash() != kept.state_hash)
    throw core::InputError("the state of step " + std::to_string(kept.last_step) +
                           " is not the one that was journaled");
}

}  // namespace

ResumedRun resume(const KeptRun& kept, const core::Scene& scene, const core::SceneVolumes& volumes, int threads) {
  core::Session session(scene, volumes.volume, volumes.labels, kept.checkpoint.session, threads);
  const core::Verdict verdict = session.apply(fromMessage(kept.checkpoint));
  if (!verdict.applied)
    throw core::InputError(verdict.reason);
  if (session.simulation().stateHash() != kept.checkpoint.state_hash)
    throw core::InputError("the state of the checkpoint does not have its hash");
  Journal journal(session);
  ResumedRun run;
  for (const SimulationJournal& message : kept.journals)
    repeat(message, session, journal);
  run.checkpoint = toMessage(session, session.checkpoint());
  run.checkpoint.header = kept.journals.empty() ? kept.checkpoint.header : kept.journals.back().header;
  run.simulation_time_s = session.simulationTime();
  run.paused = kept.paused;
  run.steps_repeated = session.steps() - kept.checkpoint.step;
  return run;
}

}  // namespace soft_volume
