#pragma once

#include <soft_volume/SimulationCheckpoint.h>
#include <soft_volume/SimulationJournal.h>

#include <atomic>
#include <boost/shared_ptr.hpp>
#include <cstdint>
#include <future>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "soft_volume/scene/scene.h"

namespace soft_volume {

/// What a simulation that was killed left behind: a checkpoint and the journal after it.
struct KeptRun {
  SimulationCheckpoint checkpoint;
  bool paused = false;
  std::vector<SimulationJournal> journals;  ///< those after the checkpoint, without gaps
  std::string damage;                       ///< why what follows them cannot be used; empty: they are all that was kept
};

/// Keeps a running simulation on disk, so that a process that comes after a SIGKILL goes on with its last journaled
/// state.
///
/// The file holds one checkpoint and the journal messages after it. A new checkpoint is written beside it by a thread
/// and takes its place when it is complete, so at every moment the file is a run that can be resumed; the journal is
/// appended in the caller's thread (some microseconds). Every record states its length and hash: an end that was cut
/// off by a kill is left out, damage is found. The content is in the hands of the kernel when a call returns; it
/// survives the process, not a power failure. The file is locked while it is in use.
///
/// Not thread-safe. What goes wrong after the construction is told by takeError(), and the run goes on without.
class ResumeFile {
 public:
  /// Waits some seconds for another process that is about to end. Throws FileError when the file is in use after that,
  /// or cannot be written.
  explicit ResumeFile(std::string path);
  /// Leaves the file where it is.
  ~ResumeFile();
  ResumeFile(const ResumeFile&) = delete;
  ResumeFile& operator=(const ResumeFile&) = delete;

  const std::string& path() const { return path_; }
  /// What an earlier process left; null without any. Throws FileError when its checkpoint cannot be used.
  std::optional<KeptRun> read() const;
  /// Renames what an earlier process left to PATH.refused, replacing a former one; returns that name.
  std::string setAside() const;

  /// From now on the journal follows this checkpoint, which must not be changed any more.
  void begin(boost::shared_ptr<const SimulationCheckpoint> checkpoint, bool paused);
  void append(const SimulationJournal& journal);
  void setPaused(bool paused);
  /// The run has come to its end: there is nothing to resume.
  void remove();
  /// What went wrong since the last call; empty when nothing did.
  std::string takeError();

 private:
  class Lock;
  class File;
  void replace(const SimulationCheckpoint& checkpoint, bool paused);
  std::string adopt(std::unique_ptr<File> file);
  void appendRecord(std::uint32_t kind, const std::vector<std::uint8_t>& payload);

  std::string path_;
  std::unique_ptr<Lock> lock_;
  std::uint64_t session_ = 0;  ///< of the last checkpoint
  std::future<void> writing_;
  std::atomic<bool> replacing_{false};              ///< a checkpoint is being written
  std::mutex mutex_;                                // guards what follows
  std::unique_ptr<File> file_;                      ///< null before the first checkpoint
  std::vector<std::vector<std::uint8_t>> pending_;  ///< records that follow the checkpoint being written
  std::string error_;
};

/// Where a kept run ended.
struct ResumedRun {
  SimulationCheckpoint checkpoint;  ///< of the last journaled state, with its stamp
  double simulation_time_s = 0.0;
  bool paused = false;
  std::uint64_t steps_repeated = 0;  ///< from the kept checkpoint on
};

/// Restores the checkpoint, applies the journal again and compares the hash of every journaled state. Throws InputError
/// when scene or volume are others, or a state is not the journaled one.
ResumedRun resume(const KeptRun& kept, const core::Scene& scene, const core::SceneVolumes& volumes, int threads);

}  // namespace soft_volume
