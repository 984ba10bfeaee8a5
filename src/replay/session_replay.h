#pragma once

#include <soft_volume/GridTopology.h>
#include <soft_volume/JournalEntry.h>
#include <soft_volume/Scene.h>
#include <soft_volume/SimulationJournal.h>

#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "bag_contents.h"
#include "frame_replay.h"
#include "replay_measure.h"
#include "soft_volume/grid/topology_delta.h"
#include "soft_volume/messages/journal.h"
#include "soft_volume/session/session.h"
#include "state_check.h"

namespace soft_volume {

/// Where the replay of a session begins.
struct ReplayStart {
  std::size_t journal = 0;                 ///< first journal message to apply
  const BagMessage* checkpoint = nullptr;  ///< restored first; null when the journal holds the whole run
};

/// The start of the run if the bag holds it, else the first checkpoint that the journal covers, else nothing.
std::optional<ReplayStart> findStart(const BagContents& contents, const SessionMessages& messages);

/// Rebuilds one session and replays it.
class SessionReplay {
 public:
  using Advance = std::function<void(double work)>;
  /// How long a frame takes, in steps; for the progress only.
  static constexpr double kFrameWork = 2000.0;

  SessionReplay(BagContents& contents, const SessionMessages& messages, const ReplayStart& start,
                const ReplayOptions& options, FrameReplay& frames, Advance advance, ReplayReport& report);

  /// Throws ReplayError.
  void run();
  /// Entries whose input is not in the bag, without a neighbour on one side.
  const std::vector<JournalEntry>& unrecordedInputs() const { return unrecorded_; }

 private:
  using Outcome = std::optional<ReplayDifference>;
  enum class Kind { kTopology, kState, kCheckpoint, kFrame };
  /// Something recorded that is to be compared in a certain step.
  struct Planned {
    std::uint64_t step;
    Kind kind;
    const BagMessage* message;
    const BagMessage* previous;  ///< of the same kind
  };
  /// A planned comparison of the step that is being replayed. An input may change the grid within a step, so a
  /// comparison counts when it holds at any point of its step.
  struct Open {
    std::function<Outcome()> compare;
    std::uint64_t* counter;
    Outcome last;
    std::function<void()> otherwise;  ///< called instead of reporting `last`, at the end of the step; or empty
  };

  void plan();
  void addPlanned(Kind kind, const std::vector<BagMessage>& messages);
  bool rebuild();
  bool checkTexts(const Scene& scene);
  void checkVersion(const Scene& scene) const;
  void restore();

  void replayJournal(const BagMessage& message);
  void checkRange(const BagMessage& message, const SimulationJournal& journal);
  void applyEntry(const JournalEntry& entry);
  void checkInput(const JournalEntry& entry);
  bool recorderMissed(const std::string& topic) const;
  void checkVerdict(const JournalEntry& recorded, const JournalEntry& again);
  void advanceTo(std::uint64_t step);
  void enterStep();
  void skip(const Planned& planned);
  void visit();
  void leaveStep();
  Open open(const Planned& planned);
  Open openTopology(const BagMessage& message);
  Open openState(const BagMessage& message, const BagMessage* previous);
  Open openMeasuredState(const std::shared_ptr<const GridState>& state);
  Open openFrame(const BagMessage& message);
  /// `delta` is what the recorded topology came as; null where it came as a whole.
  Outcome compareTopology(const GridTopology& recorded, const GridTopology* delta) const;
  Outcome compareCheckpoint(const BagMessage& message) const;
  Outcome compareFrame(const BagMessage& message);

  ReplayDifference difference(const char* kind, const std::string& text) const;

  BagContents* contents_;
  const SessionMessages* messages_;
  ReplayStart start_;
  const ReplayOptions* options_;
  FrameReplay* frames_;
  Advance advance_;
  ReplayReport* report_;

  std::unique_ptr<core::Session> session_;
  std::unique_ptr<Journal> journal_;
  core::TopologyDecoder recorded_topologies_;  ///< deltas refer to what was recorded before
  StateCheck states_;
  ReplayMeasure measure_;
  std::vector<Planned> planned_;
  std::size_t next_planned_ = 0;
  std::vector<Open> open_;
  bool entered_ = false;
  std::optional<std::uint64_t> next_order_;
  std::uint64_t journaled_step_ = 0;
  std::vector<JournalEntry> unrecorded_;
};

}  // namespace soft_volume
