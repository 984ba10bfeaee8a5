#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "soft_volume/common/error.h"
#include "soft_volume/render/image_io.h"
#include "soft_volume/replay/compared_quantity.h"

namespace soft_volume {

/// A bag that cannot be replayed: damaged, incomplete, or of another version. The message says what to do.
class ReplayError : public core::Error {
 public:
  using Error::Error;
};

/// A frame that was drawn again.
struct ReplayedFrame {
  std::string camera;
  std::uint64_t session = 0;
  std::uint64_t step = 0;
  const core::Image* recorded = nullptr;  ///< null where no image of this size was recorded
  const core::Image* replayed = nullptr;
};

struct ReplayOptions {
  bool check = true;  ///< compare with what was recorded; otherwise frames are only rendered again
  /// States, topologies and frames need not be the same: how far they are apart is measured. What was recorded has to
  /// hold together all the same, and inputs have to be applied and refused as they were.
  bool measure = false;
  std::string frames_dir;  ///< where rendered frames go as CAMERA_STEP.png; empty for nowhere
  int threads = 1;
  std::function<void(const ReplayedFrame&)> on_frame;  ///< called for every frame that is compared; or empty
};

/// Something that is not as it was recorded.
struct ReplayDifference {
  std::string kind;  ///< scene, volume, topology, state, journal, input, checkpoint, frame, session
  std::uint64_t session = 0;
  std::uint64_t step = 0;  ///< steps done when it shows
  std::string text;
  std::optional<std::uint32_t> vertex;  ///< first vertex that differs
  std::optional<double> size_m;         ///< how far apart its two places are
  std::string camera;                   ///< of a frame
  std::optional<std::uint32_t> pixel_x;
  std::optional<std::uint32_t> pixel_y;
  std::optional<double> size;  ///< of a pixel, 8-bit levels
};

/// What a replay did and found.
struct ReplayReport {
  std::uint64_t sessions = 0;          ///< rebuilt and replayed
  std::uint64_t sessions_skipped = 0;  ///< without a start or checkpoint in the bag
  std::uint64_t steps = 0;
  std::uint64_t inputs = 0;                ///< journal entries applied again
  std::uint64_t inputs_refused = 0;        ///< of these, refused as they were in the run
  std::uint64_t inputs_not_recorded = 0;   ///< journaled, but sent while their topic was not recorded yet or no more
  std::uint64_t inputs_not_journaled = 0;  ///< recorded, but never in the hands of the simulation
  std::uint64_t journals = 0;              ///< state hashes of journal messages compared
  std::uint64_t states = 0;                ///< compared bit for bit
  std::uint64_t topologies = 0;
  std::uint64_t checkpoints = 0;
  std::uint64_t frames = 0;                ///< rendered again
  std::uint64_t frames_by_psnr = 0;        ///< compared by PSNR: another driver drew them
  std::uint64_t frames_without_image = 0;  ///< only their hash was recorded, and compared
  std::uint64_t images_without_stats = 0;  ///< images that cannot be checked: nothing says what they show
  std::uint64_t not_checked = 0;           ///< recorded before the start or after the end of the journal
  double lowest_psnr_db = 0.0;             ///< of frames_by_psnr; 0 without any
  double wall_s = 0.0;

  std::uint64_t differences = 0;
  std::vector<ReplayDifference> first_differences;  ///< the first few, in the order in which they were found
  std::vector<std::string> notes;                   ///< what a reader of the counts should know

  std::vector<ComparedQuantity> measured;  ///< when asked for: the record first, the replay second
  double spacing_m = 0.0;                  ///< shortest edge of a cell, of the coarsest grid

  /// Nothing differs that was not measured.
  bool identical() const { return differences == 0; }
  void add(ReplayDifference difference);
};

/// `done` of `total` units of work.
using ReplayProgress = std::function<void(double done, double total)>;

/// Rebuilds every session of a bag from its own scene and volume, applies the journal again and compares everything
/// that was recorded: inputs, topologies, states and checkpoints bit for bit, frames exactly (by PSNR of 40 dB where
/// another driver drew them).
///
/// Which inputs have to be in the bag: a journaled input that is not recorded although earlier and later ones of the
/// same tool and session are is a difference. At the edges it is only counted, because a recorder that starts late or
/// is killed misses some.
///
/// `report` is filled as far as the replay comes. Throws ReplayError. Reading a damaged bag may crash rosbag's library:
/// call it in a process that may die. Needs no master.
void replayBag(const std::string& path, const ReplayOptions& options, const ReplayProgress& progress,
               ReplayReport& report);

/// Counts, `identical`, `first_difference` and `error` (empty, or why the replay could not be done) as JSON text.
std::string toJson(const ReplayReport& report, const std::string& error);

}  // namespace soft_volume
