// Compares bags that are recorded here with changed copies of themselves, whose distance is known.

#include "soft_volume/replay/comparison.h"

#include <gtest/gtest.h>
#include <sensor_msgs/Image.h>
#include <soft_volume/GridState.h>
#include <soft_volume/Scene.h>
#include <soft_volume/SimulationCheckpoint.h>
#include <soft_volume/SimulationJournal.h>
#include <soft_volume/ToolForce.h>

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>

#include "replay/recorded_run.h"
#include "replay/test_folder.h"
#include "soft_volume/common/hash.h"
#include "soft_volume/messages/journal.h"
#include "soft_volume/replay/tolerance.h"

namespace soft_volume {
namespace {

constexpr double kSpacing_m = 0.008;
const ReplayProgress kNoProgress = [](double, double) {};

/// With a time step of its own, so that runs of other lattices and materials have states at the same times.
void fixTimeStep(core::Scene& scene) {
  scene.simulation.dt_s = 0.0005;
}

void scaleStiffness(core::Scene& scene, double factor) {
  for (core::Material& material : scene.materials)
    material.youngs_modulus_pa *= factor;
}

class CompareBags : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new TestFolder;
    recordBag(whole(), {});
  }
  static void TearDownTestSuite() {
    delete folder_;
    folder_ = nullptr;
  }
  static std::string whole() { return *folder_ / "whole.bag"; }
  static std::string other(const std::string& name = "other.bag") { return *folder_ / name; }

  static Comparison compare(const std::string& first, const std::string& second) {
    return compareBags(RecordedBag(first), RecordedBag(second), kNoProgress);
  }
  static const ComparedQuantity& find(const Comparison& comparison, const std::string& key,
                                      const std::string& subject = "") {
    for (const ComparedQuantity& quantity : comparison.quantities) {
      if (quantity.key == key && quantity.subject == subject)
        return quantity;
    }
    ADD_FAILURE() << key << " " << subject << " was not compared";
    static const ComparedQuantity kNone;
    return kNone;
  }
  /// The keys of what is not identical, in their order.
  static std::set<std::string> different(const Comparison& comparison) {
    std::set<std::string> keys;
    for (const ComparedQuantity& quantity : comparison.quantities) {
      if (!quantity.identical && quantity.reproducible)
        keys.insert(quantity.key);
    }
    return keys;
  }

  static TestFolder* folder_;
};

TestFolder* CompareBags::folder_ = nullptr;

TEST_F(CompareBags, RecordedPositionsAreThoseOfTheCheckpoint) {
  const RecordedBag bag(whole());
  ASSERT_EQ(bag.size(), 1U);
  const RecordedRun& run = bag.run(0);
  const auto rest = run.topology(1)->rest_positions;
  std::size_t compared = 0;
  for (const auto& checkpoint : run.messages<SimulationCheckpoint>()) {
    for (std::size_t n = 0; n < run.states().size(); ++n) {
      if (run.states()[n].step != checkpoint.message.step || run.states()[n].revision != 1)
        continue;
      const auto positions = run.positions(n);
      const auto& d = checkpoint.message.displacements;
      ASSERT_EQ(3 * positions.size(), d.size());
      for (std::size_t v = 0; v < positions.size(); ++v) {
        const core::Vector3 place = rest[v].cast<double>() + core::Vector3(d[3 * v], d[3 * v + 1], d[3 * v + 2]);
        ASSERT_LT((positions[v].cast<double>() - place).norm(), 1e-8);
      }
      ++compared;
    }
  }
  EXPECT_GE(compared, 3U);
}

/// Keys of what a tolerance does not let pass.
std::set<std::string> beyond(const Comparison& comparison, const std::string& tolerance) {
  std::set<std::string> keys;
  for (const Judgement& judgement : judge(comparison.quantities, comparison.spacing_m, parseTolerance(tolerance))) {
    if (!judgement.within)
      keys.insert(judgement.key);
  }
  return keys;
}

/// A simulation that dies halfway must not pass because the first half is the same.
TEST_F(CompareBags, ARunThatEndsEarlyIsWithinNoLimit) {
  RunSettings half;
  half.steps = 150;
  recordBag(other(), half);
  for (const auto& bags : {std::pair(whole(), other()), std::pair(other(), whole())}) {
    const Comparison comparison = compare(bags.first, bags.second);
    EXPECT_GT(find(comparison, "duration").largest, kSameDuration_s);
    EXPECT_FALSE(comparison.identical());
    EXPECT_EQ(beyond(comparison, "positions=1,force=100"), (std::set<std::string>{"duration"}));
    EXPECT_EQ(beyond(comparison, "positions=1,force=100,duration=10"), (std::set<std::string>{}));
  }
}

TEST_F(CompareBags, FramesOfAnotherSizeAreNotPassedOver) {
  rewriteBag(whole(), other(), [](RawMessage& raw) {
    if (raw.type == "sensor_msgs/Image") {
      sensor_msgs::Image image;
      ros::serialization::IStream in(raw.bytes.data(), static_cast<std::uint32_t>(raw.bytes.size()));
      ros::serialization::deserialize(in, image);
      image.height /= 2;
      image.data.resize(image.height * image.step);
      raw.bytes.resize(ros::serialization::serializationLength(image));
      ros::serialization::OStream out(raw.bytes.data(), static_cast<std::uint32_t>(raw.bytes.size()));
      ros::serialization::serialize(out, image);
    }
    return true;
  });
  const Comparison comparison = compare(other(), whole());
  EXPECT_EQ(different(comparison), (std::set<std::string>{"image_rmse", "ssim"}));
  EXPECT_FALSE(comparison.identical());
  EXPECT_EQ(beyond(comparison, "ssim=0.1"), (std::set<std::string>{"ssim"}));
}

TEST_F(CompareBags, ARunHasWhatWasRecorded) {
  const RecordedBag bag(whole());
  const RecordedRun& run = bag.run(0);
  EXPECT_EQ(run.states().size(), 21U);
  EXPECT_EQ(run.revisions(), (std::vector<std::uint32_t>{1, 2}));
  EXPECT_EQ(run.topology(2)->revision, 2U);
  EXPECT_EQ(run.topology(1)->revision, 1U) << "going back";
  EXPECT_EQ(run.topology(3), nullptr);
  ASSERT_EQ(run.frames().size(), 4U);
  EXPECT_TRUE(run.hasImage(0));
  EXPECT_EQ(run.image(0).width, 48);
  EXPECT_EQ(core::hashVector(run.image(3).rgb), run.frames()[3].stats.image_hash);
  EXPECT_EQ(run.frames()[1].stats.step, 160U);
  EXPECT_DOUBLE_EQ(run.frames()[1].time_s, run.timeOfStep(160));
  EXPECT_EQ(run.messages<ToolForce>().size(), 41U);
  EXPECT_EQ(run.entries().size(), 42U);
  EXPECT_EQ(run.stats().size(), 4U);
  EXPECT_EQ(run.scene().name, "ball");
  // States are stamped with simulated time after the start, which the recording puts at 1000 s.
  EXPECT_NEAR(run.timeOf(ros::Time(1000.5)), 0.5, 1e-9);
}

TEST_F(CompareBags, ABagIsIdenticalToItself) {
  const Comparison comparison = compare(whole(), whole());
  EXPECT_TRUE(comparison.identical());
  EXPECT_TRUE(comparison.scene_changes.empty());
  for (const ComparedQuantity& quantity : comparison.quantities) {
    EXPECT_TRUE(quantity.identical) << quantity.key;
    EXPECT_EQ(quantity.left_out, 0U) << quantity.key;
    EXPECT_GT(quantity.compared, 0U) << quantity.key;
    EXPECT_EQ(quantity.largest, quantity.key == "ssim" ? 1.0 : 0.0) << quantity.key;
  }
  EXPECT_EQ(find(comparison, "positions").compared,
            11 * 216U + 10 * RecordedBag(whole()).run(0).topology(2)->vertexCount());
  EXPECT_EQ(find(comparison, "image_rmse", "camera").compared, 4U);
  EXPECT_EQ(find(comparison, "force", "probe").samples.size(), 40U);
  EXPECT_NEAR(comparison.spacing_m, kSpacing_m, 1e-8);
  EXPECT_TRUE(judge(comparison.quantities, comparison.spacing_m, {}).empty());
}

TEST_F(CompareBags, AMovedVertexIsMeasured) {
  std::uint64_t step = 0;
  rewriteMessage<GridState>(whole(), other(), 7, [&step](GridState& state) {
    ASSERT_FALSE(state.key_frame);
    step = state.step;
    state.positions[3].y += 0.001F;
  });
  const Comparison comparison = compare(whole(), other());
  EXPECT_EQ(different(comparison), std::set<std::string>{"positions"});
  const ComparedQuantity& positions = find(comparison, "positions");
  EXPECT_NEAR(positions.largest, 0.001, 1e-8);
  EXPECT_DOUBLE_EQ(positions.largest_at_s, RecordedBag(whole()).run(0).timeOfStep(step));
  // Over all vertices of all states that are farther than 1 % of h from rest.
  const RecordedBag bag(whole());
  const RecordedRun& run = bag.run(0);
  double moved = 0.0;
  for (std::size_t n = 0; n < run.states().size(); ++n) {
    const auto rest = run.topology(run.states()[n].revision)->rest_positions;
    const auto places = run.positions(n);
    for (std::size_t v = 0; v < places.size(); ++v)
      moved += (places[v] - rest[v]).cast<double>().norm() > 0.01 * comparison.spacing_m ? 1.0 : 0.0;
  }
  EXPECT_NEAR(positions.rms, 0.001 / std::sqrt(moved), 0.01 * positions.rms + 1e-12);
}

TEST_F(CompareBags, AnotherForceIsMeasuredInNewtons) {
  double time_s = 0.0;
  int seen = 0;
  rewriteBag(whole(), other(), [&](RawMessage& raw) {
    if (raw.type != "soft_volume/SimulationJournal")
      return true;
    auto journal = parseMessage<SimulationJournal>(raw.bytes);
    for (JournalEntry& entry : journal.entries) {
      if (entry.topic != "tool/force" || seen++ != 11)
        continue;
      auto force = fromPayload<ToolForce>(entry.payload);
      force.force.x += 0.03;
      force.force.y -= 0.04;
      time_s = force.header.stamp.toSec() - 1000.0;
      entry.payload = journalPayload(force);
    }
    raw.bytes.resize(ros::serialization::serializationLength(journal));
    ros::serialization::OStream out(raw.bytes.data(), static_cast<std::uint32_t>(raw.bytes.size()));
    ros::serialization::serialize(out, journal);
    return true;
  });
  const Comparison comparison = compare(whole(), other());
  EXPECT_EQ(different(comparison), std::set<std::string>{"force"});
  const ComparedQuantity& force = find(comparison, "force", "probe");
  EXPECT_NEAR(force.largest, 0.05, 1e-9);
  EXPECT_NEAR(force.largest_at_s, time_s, 1e-6);
  EXPECT_NEAR(force.rms, 0.05 / std::sqrt(double(force.samples.size())), 1e-9);
  EXPECT_NEAR(force.scale, 0.0596, 0.03) << "the pushes' own size";
}

TEST_F(CompareBags, AnotherPixelIsMeasuredInLevels) {
  rewriteMessage<sensor_msgs::Image>(whole(), other(), 2, [](sensor_msgs::Image& image) {
    image.data[5000] = static_cast<std::uint8_t>(image.data[5000] ^ 0x40);
  });
  const Comparison comparison = compare(whole(), other());
  EXPECT_EQ(different(comparison), (std::set<std::string>{"image_rmse", "ssim"}));
  EXPECT_NEAR(find(comparison, "image_rmse", "camera").largest, 64.0 / std::sqrt(48.0 * 40.0 * 3.0), 1e-9);
  EXPECT_LT(find(comparison, "ssim", "camera").largest, 1.0);
  EXPECT_GT(find(comparison, "ssim", "camera").largest, 0.9);
  EXPECT_DOUBLE_EQ(find(comparison, "image_rmse", "camera").largest_at_s,
                   RecordedBag(whole()).run(0).frames()[2].time_s);
}

TEST_F(CompareBags, WhatACutChangedIsLeftOutAndCounted) {
  RunSettings uncut;
  uncut.cuts = false;
  recordBag(other(), uncut);
  const Comparison comparison = compare(whole(), other());
  const ComparedQuantity& area = find(comparison, "cut_area");
  const RecordedBag bag(whole());
  const auto grid = bag.run(0).topology(1);
  Eigen::AlignedBox3f box;
  for (const auto& p : grid->rest_positions)
    box.extend(p);
  // The blade's plane parts the whole block above its tip.
  EXPECT_NEAR(area.largest, double(box.sizes().y()) * (double(box.max().z()) - 0.015), 0.1 * area.largest);
  EXPECT_EQ(area.samples.back().second, 0.0);
  EXPECT_EQ(area.samples.front().first, 0.0);
  EXPECT_EQ(find(comparison, "revision").largest, 1.0);
  const ComparedQuantity& positions = find(comparison, "positions");
  EXPECT_GT(positions.left_out, 0U);
  EXPECT_FALSE(positions.left_out_reason.empty());
  EXPECT_FALSE(positions.identical);
  // Before the cut all is the same, after it what the cut did not touch is compared and moves otherwise.
  EXPECT_EQ(positions.samples[10].largest, 0.0);
  EXPECT_GT(positions.samples.back().largest, 1e-5);
  EXPECT_LT(positions.samples.back().largest, 0.5 * kSpacing_m);
}

TEST_F(CompareBags, GridsOfOtherSpacingAreComparedByInterpolation) {
  RunSettings fine;
  fine.change = [](core::Scene& scene) {
    fixTimeStep(scene);
    scene.lattice.spacing_m = core::Vector3::Constant(0.004);
  };
  fine.cuts = false;
  RunSettings coarse;
  coarse.change = fixTimeStep;
  coarse.cuts = false;
  recordBag(other("coarse.bag"), coarse);
  recordBag(other(), fine);
  const Comparison comparison = compare(other("coarse.bag"), other());
  EXPECT_NEAR(comparison.spacing_m, kSpacing_m, 1e-8);
  const ComparedQuantity& positions = find(comparison, "positions");
  const ComparedQuantity swapped = find(compare(other(), other("coarse.bag")), "positions");
  EXPECT_GT(positions.rms, 1e-6);
  EXPECT_LT(positions.rms, 0.3 * positions.scale) << "the same block under the same forces";
  EXPECT_NEAR(swapped.rms, positions.rms, 1e-9) << "the same points";
  EXPECT_LT(positions.samples.front().largest, 1e-7) << "at rest both are in the same place";
  EXPECT_GT(positions.compared, 1000U);
  ASSERT_FALSE(comparison.scene_changes.empty());
  EXPECT_NE(comparison.scene_changes[0].find("lattice.spacing"), std::string::npos) << comparison.scene_changes[0];
}

TEST_F(CompareBags, OnePercentOfStiffnessIsSeen) {
  RunSettings soft;
  soft.change = fixTimeStep;
  RunSettings stiffer;
  stiffer.change = [](core::Scene& scene) {
    fixTimeStep(scene);
    scaleStiffness(scene, 1.01);
  };
  recordBag(other("soft.bag"), soft);
  recordBag(other(), stiffer);
  const Comparison comparison = compare(other("soft.bag"), other());
  const ComparedQuantity& positions = find(comparison, "positions");
  EXPECT_GT(positions.rms, 0.001 * positions.scale);
  EXPECT_LT(positions.rms, 0.03 * positions.scale);
  EXPECT_TRUE(find(comparison, "force", "probe").identical);
  EXPECT_FALSE(find(comparison, "energy", "elastic").identical);
}

TEST_F(CompareBags, OtherVolumesCannotBeCompared) {
  rewriteMessage<Scene>(whole(), other(), 0, [](Scene& scene) { ++scene.volume_hash; });
  EXPECT_THROW(compare(whole(), other()), ReplayError);
}

TEST_F(CompareBags, AMissingSessionIsSaid) {
  {
    BagRecorderSettings settings;
    settings.file = other();
    settings.reserve_bytes = 1 << 20;
    BagRecorder recorder(settings);
    RunSettings run;
    recordRun(recorder, run);
    run.session = 2;
    run.steps = 600;
    recordRun(recorder, run);
  }
  const Comparison comparison = compare(whole(), other());
  EXPECT_TRUE(std::any_of(comparison.notes.begin(), comparison.notes.end(), [](const std::string& note) {
    return note.find("2") != std::string::npos && note.find("sessions") != std::string::npos;
  }));
  EXPECT_FALSE(comparison.identical());
}

TEST(Tolerance, IsReadAndRefused) {
  const Tolerance tolerance = parseTolerance("positions=0.01,ssim=0.98");
  EXPECT_EQ(tolerance.limits, (std::map<std::string, double>{{"positions", 0.01}, {"ssim", 0.98}}));
  for (const char* bad : {"position=0.1", "positions=", "positions=x", "positions=-1", "ssim=1.1", "image_rmse=300",
                          "positions=nan", "positions=1,positions=2", "positions=1,", "positions", "no such file.yaml"})
    EXPECT_THROW(parseTolerance(bad), ReplayError) << bad;
  const TestFolder folder;
  const auto file = [&folder](const std::string& text) {
    std::ofstream(folder / "limits.yaml") << text;
    return folder / "limits.yaml";
  };
  EXPECT_EQ(parseTolerance(file("# limits\npositions: 0.01\nforce: 0.05\n")).limits,
            (std::map<std::string, double>{{"positions", 0.01}, {"force", 0.05}}));
  for (const char* bad : {"", "positions", "positions: [1]", "position: 1", "positions: x", "a: b: c"})
    EXPECT_THROW(parseTolerance(file(bad)), ReplayError) << bad;
}

TEST(Tolerance, JudgesInItsUnits) {
  ComparedQuantity positions;
  positions.key = "positions";
  positions.addValues(1.0, 0.02, 0.02, 0.002);
  ComparedQuantity energy;
  energy.key = "energy";
  energy.subject = "elastic";
  energy.addValues(1.0, 2.0, 1.5, 0.5);
  ComparedQuantity similarity;
  similarity.key = "ssim";
  similarity.addIndex(0.5, 0.9);
  const std::vector<ComparedQuantity> all = {positions, energy, similarity};
  const auto within = [&all](const std::string& limits) { return allWithin(judge(all, 0.01, parseTolerance(limits))); };
  EXPECT_TRUE(within("positions=0.2001"));
  EXPECT_FALSE(within("positions=0.1999"));
  EXPECT_TRUE(within("energy=0.2501"));
  EXPECT_FALSE(within("energy=0.2499"));
  EXPECT_TRUE(within("ssim=0.9"));
  EXPECT_FALSE(within("ssim=0.91"));
  EXPECT_FALSE(within("force=1000")) << "nothing to compare";
}

class CompareProgram : public CompareBags {};

TEST_F(CompareProgram, AgainstTellsAndJudges) {
  RunSettings stiffer;
  stiffer.change = [](core::Scene& scene) { scaleStiffness(scene, 1.01); };
  recordBag(other(), stiffer);
  const auto against = [](const std::string& first, const std::string& second, const std::string& more = "") {
    return replay(first, "--against '" + second + "' " + more);
  };
  ProgramResult result = against(whole(), whole());
  EXPECT_EQ(result.code, 0) << result.output;
  EXPECT_NE(result.output.find("identical"), std::string::npos) << result.output;
  result = against(whole(), other());
  EXPECT_EQ(result.code, 1) << result.output;
  EXPECT_NE(result.output.find("DIFFERENT"), std::string::npos) << result.output;
  EXPECT_EQ(against(whole(), other(), "--tolerance positions=0.1,image_rmse=10,ssim=0.9").code, 0);
  EXPECT_EQ(against(whole(), other(), "--tolerance positions=0.0001").code, 1);
  EXPECT_EQ(against(whole(), other(), "--tolerance position=1").code, 2);
  EXPECT_EQ(against(whole(), other("none.bag")).code, 2);
  EXPECT_EQ(replay(whole(), "--tolerance positions=1").code, 2) << "nothing to judge";
  const std::string file = other("result.json");
  against(whole(), other(), "--tolerance positions=0.0001 --json '" + file + "'");
  const auto json = nlohmann::json::parse(std::ifstream(file));
  EXPECT_EQ(json["within"], false);
  EXPECT_EQ(json["identical"], false);
  EXPECT_EQ(json["judgements"][0]["key"], "positions");
  EXPECT_EQ(json["judgements"][0]["within"], false);
  EXPECT_NEAR(json["comparison"]["spacing_m"].get<double>(), kSpacing_m, 1e-8);
}

/// A changed material constant, as a change of the code would make it: the inputs are the recorded ones.
class OnePercent : public CompareBags {
 protected:
  static void recordWithChangedScene() {
    rewriteMessage<Scene>(whole(), other(), 0, [](Scene& scene) {
      core::Scene changed = core::parseScene(scene.yaml, "test", ".");
      scaleStiffness(changed, 1.01);
      scene.yaml = core::writeScene(changed);
      scene.scene_hash = core::hashBytes(scene.yaml.data(), scene.yaml.size());
    });
  }
};

TEST_F(OnePercent, IsCaughtByTheCheck) {
  recordWithChangedScene();
  EXPECT_EQ(replay(whole(), "--check").code, 0);
  EXPECT_EQ(replay(other(), "--check").code, 1);
}

TEST_F(OnePercent, IsCaughtByTheCheckWithTolerances) {
  recordWithChangedScene();
  const std::string check = "--check --tolerance positions=0.002,image_rmse=2,ssim=0.98";
  ProgramResult result = replay(whole(), check);
  EXPECT_EQ(result.code, 0) << result.output;
  EXPECT_NE(result.output.find("within"), std::string::npos) << result.output;
  result = replay(other(), check);
  EXPECT_EQ(result.code, 1) << result.output;
  EXPECT_NE(result.output.find("BEYOND: positions"), std::string::npos) << result.output;
  EXPECT_EQ(replay(other(), "--check --tolerance positions=0.1").code, 0) << "a limit that is loose enough";
}

TEST_F(OnePercent, IsCaughtByTheMotionOfTheDevice) {
  const std::string bag = SOFT_VOLUME_SOURCE_DIR "/test/data/press_lockstep.bag";
  const auto resimulate = [&](const std::string& changes, const std::string& limits) {
    return replay(bag, "--resimulate=" + changes + " --output '" + other() + "' --tolerance " + limits);
  };
  ProgramResult result = resimulate("", "positions=0,force=0,device_force=0");
  EXPECT_EQ(result.code, 0) << result.output;
  for (const char* limit : {"positions=0.005", "positions_rms=0.001", "force=0.01", "device_force=0.01"}) {
    result = resimulate("materials.0.youngs_modulus_pa=6060", limit);
    EXPECT_EQ(result.code, 1) << limit << "\n" << result.output;
    EXPECT_NE(result.output.find("BEYOND"), std::string::npos) << result.output;
  }
  result = resimulate("materials.0.youngs_modulus_pa=6060", "positions=0.1,force=0.2");
  EXPECT_EQ(result.code, 0) << result.output;
}

TEST_F(OnePercent, ALimitNeedsSomethingToJudge) {
  rewriteBag(whole(), other(), [](RawMessage& raw) { return raw.type != "sensor_msgs/Image"; });
  EXPECT_EQ(replay(other(), "--check --tolerance positions=0.1").code, 0);
  const ProgramResult result = replay(other(), "--check --tolerance positions=0.1,ssim=0.9");
  EXPECT_EQ(result.code, 1) << result.output;
  EXPECT_NE(result.output.find("nothing to compare"), std::string::npos) << result.output;
}

}  // namespace
}  // namespace soft_volume
