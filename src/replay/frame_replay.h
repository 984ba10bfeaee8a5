#pragma once

#include <sensor_msgs/Image.h>
#include <soft_volume/RenderStats.h>

#include <map>
#include <optional>
#include <string>

#include "bag_contents.h"
#include "frame_painter.h"
#include "replay_measure.h"
#include "soft_volume/session/session.h"

namespace soft_volume {

/// Renders the recorded frames again and compares them.
class FrameReplay {
 public:
  FrameReplay(BagContents& contents, const ReplayOptions& options, ReplayReport& report);

  /// Forgets the session before. Where `measure` is not null, frames are measured instead of compared.
  void begin(ReplayMeasure* measure) {
    painter_.forget();
    measure_ = measure;
  }
  /// Draws what `stats` describes from the session's state now, which is of that step and revision.
  std::optional<ReplayDifference> check(const core::Session& session, const RenderStats& stats);

 private:
  core::Image render(const core::Session& session, const core::RenderSettings& settings, const RenderStats& stats);
  void show(const RenderStats& stats, const std::optional<sensor_msgs::Image>& recorded,
            const core::Image& image) const;
  void writeFrame(const RenderStats& stats, const core::Image& image);
  std::optional<sensor_msgs::Image> findRecorded(const RenderStats& stats);
  void measureFrame(const core::Session& session, const RenderStats& stats,
                    const std::optional<sensor_msgs::Image>& recorded, const core::Image& image);
  std::optional<ReplayDifference> compareExactly(const core::Image& image, const RenderStats& stats,
                                                 const std::optional<sensor_msgs::Image>& recorded) const;
  std::optional<ReplayDifference> compareByPsnr(const core::Image& image, const RenderStats& stats,
                                                const std::optional<sensor_msgs::Image>& recorded);

  BagContents* contents_;
  const ReplayOptions* options_;
  ReplayReport* report_;
  ReplayMeasure* measure_ = nullptr;
  FramePainter painter_;
  std::map<std::string, int> written_;  ///< frame files by name, and how often the name was wanted
};

}  // namespace soft_volume
