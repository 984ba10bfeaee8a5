#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "findings.h"
#include "soft_volume/render/image_io.h"
#include "soft_volume/replay/recorded_run.h"

namespace soft_volume::replay_program {

/// Of a vertex from its place at rest, metres; nothing where the state cannot be put together.
std::optional<double> largestDisplacement(const RecordedRun& run, std::size_t state);

/// A frame of the recording that a report shows.
struct Moment {
  RecordedFrame frame;
  std::optional<std::size_t> index;  ///< among the run's frames; none: the bag holds no frames, and this shows a state
  std::string caption;               ///< what happens then
};

/// Up to six moments that tell a run: its begin, where the tissue was displaced most and pressed hardest, amid the
/// cuts, its end; and `worst_s`, where two runs differ most. Of the first camera, in the order of time.
std::vector<Moment> chooseMoments(const RecordedRun& run, std::optional<double> worst_s);

/// Tells the difference where both have one size.
void compare(FrameTriplet& triplet);

/// Keeps some of the frames that a check draws again: those of chooseMoments(), and the one that differs most.
class ReplayedFrames {
 public:
  explicit ReplayedFrames(const RecordedBag& bag);
  void add(const ReplayedFrame& frame);
  /// In the order of time.
  std::vector<FrameTriplet> take();

 private:
  struct Kept {
    std::uint64_t step = 0;
    std::string camera;
    FrameTriplet triplet;
  };
  FrameTriplet tripletOf(const ReplayedFrame& frame, const std::string& what) const;

  std::uint64_t session_ = 0;
  std::map<std::uint64_t, double> times_s_;                              ///< of the frames, by step
  std::map<std::pair<std::string, std::uint64_t>, std::string> wanted_;  ///< captions by camera and step
  std::vector<Kept> kept_;
  std::optional<Kept> worst_;
};

/// The largest level of a colour scale for the difference of a triplet that has one.
int differenceScale(const FrameTriplet& triplet);

/// The largest difference of a pixel's channels as a colour: white none, dark red `scale` levels or more.
core::Image differenceMap(const core::Image& first, const core::Image& second, int scale);

/// The same colours as CSS gradient, from none to `scale`.
std::string scaleGradient();

}  // namespace soft_volume::replay_program
