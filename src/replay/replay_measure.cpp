#include "replay_measure.h"

#include <algorithm>
#include <cmath>

#include "soft_volume/messages/conversions.h"

namespace soft_volume {

void ReplayMeasure::beginSession(const core::Session& session, std::size_t run) {
  run_ = run;
  uncut_ = std::make_shared<core::Topology>(session.topology());
  recorded_uncut_ = nullptr;
  replayed_ = uncut_;
  pair_ = nullptr;
  decoder_ = core::StateDecoder();
  decoded_session_ = 0;
  report_->spacing_m = std::max(report_->spacing_m, cellEdges(*uncut_).minCoeff());
}

std::shared_ptr<const GridPair::Positions> ReplayMeasure::decode(const GridState& recorded) {
  const core::GridStateFrame frame = fromMessage(recorded);
  const bool other = frame.session != decoded_session_ || frame.revision != decoded_revision_ ||
                     frame.vertex_count != decoded_vertices_;
  if (other) {
    decoder_.expect(frame.session, frame.revision, GridPair::Positions(frame.vertex_count, core::Vector3f::Zero()));
    decoded_session_ = frame.session;
    decoded_revision_ = frame.revision;
    decoded_vertices_ = frame.vertex_count;
  }
  if (decoder_.apply(frame) != core::StateDecoder::Result::kApplied)
    return nullptr;
  return std::make_shared<const GridPair::Positions>(decoder_.positions());
}

void ReplayMeasure::compareState(const core::Session& session, const GridState& recorded,
                                 const GridPair::Positions& positions, const GridPair::Grid& topology) {
  if (replayed_->revision != session.lattice().revision)
    replayed_ = std::make_shared<core::Topology>(session.topology());
  // A recording that started late may lack the topology; with as many vertices it is taken to be the session's.
  const GridPair::Grid grid = topology && topology->revision == recorded.revision ? topology : replayed_;
  if (grid->vertexCount() != positions.size()) {
    ComparedQuantity& places = quantity("positions", "", "places of material points", "m");
    places.left_out += positions.size();
    places.left_out_reason = "in states whose topology was not recorded";
    return;
  }
  if (!recorded_uncut_)
    recorded_uncut_ = grid;
  if (!pair_ || !pair_->isOf(grid, replayed_)) {
    // The first recorded grid may be cut already, when the replay begins at a checkpoint: so is the session's then.
    const bool same_begin = recorded_uncut_->revision == uncut_->revision;
    pair_ = std::make_unique<GridPair>(grid, replayed_, same_begin ? recorded_uncut_ : uncut_, uncut_);
    recorded_area_m2_ = cutArea(*grid);
    replayed_area_m2_ = cutArea(*replayed_);
    recorded_parts_ = static_cast<double>(partCount(*grid));
    replayed_parts_ = static_cast<double>(partCount(*replayed_));
  }
  GridPair::Positions replayed;
  for (const core::Vector3& p : session.drawnPositions())
    replayed.push_back(p.cast<float>());
  const double time_s = session.simulationTime();
  ComparedQuantity& places = quantity("positions", "", "places of material points", "m");
  pair_->compare(time_s, positions, replayed, kMovedPart * report_->spacing_m, places);
  if (places.left_out > 0)
    places.left_out_reason = "in cells that only one of the runs has cut, or cut otherwise, or new by a cut";
  quantity("cut_area", "", "area of the cuts, at rest", "m^2")
      .addValues(time_s, recorded_area_m2_, replayed_area_m2_, std::abs(recorded_area_m2_ - replayed_area_m2_));
  quantity("parts", "", "parts of the tissue", "")
      .addValues(time_s, recorded_parts_, replayed_parts_, std::abs(recorded_parts_ - replayed_parts_));
  const double revision = session.lattice().revision;
  quantity("revision", "", "revisions of the topology", "")
      .addValues(time_s, recorded.revision, revision, std::abs(recorded.revision - revision));
}

void ReplayMeasure::compareFrame(const core::Session& session, const RenderStats& stats, const core::Image& recorded,
                                 const core::Image& replayed) {
  const core::ImageDifference apart = core::compareImages(recorded, replayed);
  const auto values = static_cast<std::uint64_t>(recorded.rgb.size());
  const double time_s = session.simulationTime();
  imageQuantity(stats).add({time_s, 0.0, 0.0, apart.rmse, apart.rmse}, 1,
                           {apart.rmse * apart.rmse * static_cast<double>(values), values});
  similarityQuantity(stats).addIndex(time_s, apart.ssim);
}

void ReplayMeasure::leaveOutFrame(const RenderStats& stats, const std::string& reason) {
  for (const auto member : {&ReplayMeasure::imageQuantity, &ReplayMeasure::similarityQuantity}) {
    ComparedQuantity& frames = (this->*member)(stats);
    ++frames.left_out;
    frames.left_out_reason = reason;
    frames.identical = false;
  }
}

ComparedQuantity& ReplayMeasure::imageQuantity(const RenderStats& stats) {
  return quantity("image_rmse", stats.camera, "frames, RMSE", "levels");
}

ComparedQuantity& ReplayMeasure::similarityQuantity(const RenderStats& stats) {
  return quantity("ssim", stats.camera, "frames, structural similarity", "");
}

ComparedQuantity& ReplayMeasure::quantity(const char* key, const std::string& subject, const char* title,
                                          const char* unit) {
  auto& all = report_->measured;
  const auto found = std::find_if(all.begin(), all.end(), [&](const ComparedQuantity& q) {
    return q.key == key && q.subject == subject && q.run == run_;
  });
  if (found != all.end())
    return *found;
  ComparedQuantity made;
  made.key = key;
  made.subject = subject;
  made.title = title;
  made.unit = unit;
  made.run = run_;
  all.push_back(std::move(made));
  return all.back();
}

}  // namespace soft_volume
