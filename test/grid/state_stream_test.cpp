#include "soft_volume/grid/state_stream.h"

#include <gtest/gtest.h>

#include <cmath>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

std::vector<Vector3> restLine() {
  return {Vector3(0, 0, 0), Vector3(1, 0, 0), Vector3(2, 0, 0), Vector3(3, 0, 0)};
}

std::vector<Vector3f> asFloat(const std::vector<Vector3>& positions) {
  std::vector<Vector3f> result;
  for (const Vector3& p : positions)
    result.push_back(p.cast<float>());
  return result;
}

/// An encoder and a decoder of one session, and the positions between them.
class StateStream : public testing::Test {
 protected:
  void SetUp() override { decoder_.expect(5, 1, asFloat(positions_)); }

  GridStateFrame encode(std::uint64_t step, bool key_frame) {
    GridStateFrame frame;
    frame.session = 5;
    frame.revision = 1;
    frame.step = step;
    encoder_.encode(positions_, key_frame, frame);
    return frame;
  }

  std::vector<Vector3> positions_ = restLine();
  StateEncoder encoder_;
  StateDecoder decoder_;
};

TEST_F(StateStream, FirstFrameIsAKeyFrameAndDeltasHoldOnlyWhatMoved) {
  EXPECT_TRUE(encode(0, false).key_frame);
  positions_[2].y() = 0.5;
  const GridStateFrame delta = encode(3, false);
  EXPECT_FALSE(delta.key_frame);
  EXPECT_EQ(delta.base_step, 0U);
  EXPECT_EQ(delta.vertex_ids, std::vector<std::uint32_t>{2});
  EXPECT_EQ(delta.moved_m.min(), Vector3f(2.0F, 0.0F, 0.0F));
  EXPECT_EQ(delta.moved_m.max(), Vector3f(2.0F, 0.5F, 0.0F));
}

TEST_F(StateStream, AReceiverMayMissAnyDelta) {
  EXPECT_EQ(decoder_.apply(encode(0, true)), StateDecoder::Result::kApplied);
  positions_[1].z() = 0.25;
  encode(1, false);  // lost
  positions_[3].z() = 0.75;
  EXPECT_EQ(decoder_.apply(encode(2, false)), StateDecoder::Result::kApplied);
  EXPECT_EQ(decoder_.positions(), asFloat(positions_));
  EXPECT_EQ(decoder_.step(), 2U);
}

TEST_F(StateStream, AMissedKeyFrameIsWaitedFor) {
  decoder_.apply(encode(0, true));
  positions_[1].z() = 0.25;
  encode(1, true);  // lost
  positions_[1].z() = 0.5;
  EXPECT_EQ(decoder_.apply(encode(2, false)), StateDecoder::Result::kNeedsKeyFrame);
  EXPECT_EQ(decoder_.positions(), asFloat(restLine()));
  EXPECT_EQ(decoder_.apply(encode(3, true)), StateDecoder::Result::kApplied);
  EXPECT_EQ(decoder_.positions(), asFloat(positions_));
}

TEST_F(StateStream, AVertexThatReturnsToItsBaseIsRestored) {
  decoder_.apply(encode(0, true));
  positions_[1].z() = 0.25;
  decoder_.apply(encode(1, false));
  positions_[1].z() = 0.0;
  decoder_.apply(encode(2, false));
  EXPECT_EQ(decoder_.positions(), asFloat(restLine()));
}

TEST_F(StateStream, RefusesWhatDoesNotFitAndKeepsItsState) {
  decoder_.apply(encode(0, true));
  positions_[1].z() = 0.25;
  positions_[2].z() = 0.25;
  const GridStateFrame good = encode(1, false);
  const auto refuses = [&](const auto& damage) {
    GridStateFrame bad = good;
    damage(bad);
    EXPECT_THROW(decoder_.apply(bad), InputError);
    EXPECT_EQ(decoder_.positions(), asFloat(restLine()));
  };
  refuses([](GridStateFrame& f) { f.session = 6; });
  refuses([](GridStateFrame& f) { f.revision = 2; });
  refuses([](GridStateFrame& f) { f.vertex_count = 3; });
  refuses([](GridStateFrame& f) { f.vertex_ids = {1, 4}; });
  refuses([](GridStateFrame& f) { f.vertex_ids = {2, 1}; });
  refuses([](GridStateFrame& f) { f.vertex_ids = {1}; });
  refuses([](GridStateFrame& f) { f.key_frame = true; });
  refuses([](GridStateFrame& f) { f.positions_m[0].x() = NAN; });
  EXPECT_EQ(decoder_.apply(good), StateDecoder::Result::kApplied);
}

}  // namespace
}  // namespace soft_volume::core
