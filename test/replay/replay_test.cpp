// Runs the real soft_volume_replay on bags that are recorded here, whole and spoiled in one place each.

#include <gtest/gtest.h>
#include <rosbag/view.h>
#include <sensor_msgs/Image.h>
#include <soft_volume/GridState.h>
#include <soft_volume/GridTopology.h>
#include <soft_volume/RenderStats.h>
#include <soft_volume/Scene.h>
#include <soft_volume/SimulationJournal.h>
#include <soft_volume/ToolCut.h>
#include <soft_volume/ToolForce.h>
#include <soft_volume/Volume.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <random>

#include "replay/recorded_run.h"
#include "replay/test_folder.h"
#include "soft_volume/common/hash.h"
#include "soft_volume/messages/journal.h"
#include "soft_volume/render/image_io.h"

namespace soft_volume {
namespace {

class Replay : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new TestFolder;
    recordBag(whole(), {});
  }
  static void TearDownTestSuite() {
    delete folder_;
    folder_ = nullptr;
  }
  /// A bag of one run, recorded once for all tests.
  static std::string whole() { return *folder_ / "whole.bag"; }
  static std::string other(const std::string& name = "other.bag") { return *folder_ / name; }

  static nlohmann::json json(const std::string& bag, int expected_code, const std::string& arguments = "") {
    const std::string file = *folder_ / "result.json";
    const ProgramResult result = replay(bag, "--check --json '" + file + "' " + arguments);
    EXPECT_EQ(result.code, expected_code) << result.output;
    return nlohmann::json::parse(std::ifstream(file));
  }

  /// The bag differs; its first difference is of this kind and in this step.
  static nlohmann::json expectDifference(const std::string& bag, const std::string& kind, std::uint64_t step) {
    const nlohmann::json result = json(bag, 1);
    EXPECT_EQ(result["identical"], false);
    EXPECT_EQ(result["first_difference"]["kind"], kind) << result.dump(2);
    EXPECT_EQ(result["first_difference"]["step"], step) << result.dump(2);
    return result["first_difference"];
  }

  static void expectImpossible(const std::string& bag, const std::string& words) {
    const ProgramResult result = replay(bag);
    EXPECT_EQ(result.code, 2) << result.output;
    EXPECT_NE(result.output.find(words), std::string::npos) << result.output;
  }

  static TestFolder* folder_;
};

TestFolder* Replay::folder_ = nullptr;

TEST_F(Replay, AWholeRunIsIdenticalTwiceWithAnyNumberOfThreads) {
  for (const char* threads : {"--threads 1", "--threads 2", "--threads 1", "--threads 2"}) {
    const nlohmann::json result = json(whole(), 0, threads);
    EXPECT_EQ(result["identical"], true);
    EXPECT_TRUE(result["first_difference"].is_null());
    EXPECT_EQ(result["steps"], 400);
    EXPECT_EQ(result["inputs"], 42);
    EXPECT_EQ(result["inputs_refused"], 1);
    EXPECT_EQ(result["inputs_not_recorded"], 0);
    EXPECT_EQ(result["inputs_not_journaled"], 0);
    EXPECT_EQ(result["states"], 21);
    EXPECT_EQ(result["topologies"], 2) << "the cut did not change the grid";
    EXPECT_EQ(result["checkpoints"], 5);
    EXPECT_EQ(result["frames"], 4);
    EXPECT_EQ(result["frames_by_psnr"], 0);
    EXPECT_EQ(result["not_checked"], 0);
  }
}

TEST_F(Replay, GripsAndChangesOfTheIntegratorAreReplayed) {
  RunSettings settings;
  settings.grips = true;
  recordBag(other(), settings);
  const nlohmann::json result = json(other(), 0);
  EXPECT_EQ(result["identical"], true);
  EXPECT_EQ(result["inputs"], 54);
  EXPECT_EQ(result["inputs_refused"], 1);
  EXPECT_EQ(result["not_checked"], 0);
  // The checkpoint of step 300 holds jaws and a time step that is not the scene's.
  settings.first_recorded_step = 255;
  recordBag(other(), settings);
  const nlohmann::json late = json(other(), 0);
  EXPECT_EQ(late["steps"], 100);
  EXPECT_NE(late["notes"].dump().find("checkpoint of step 300"), std::string::npos);
}

TEST_F(Replay, ItDoesNotMatterWhichKernelThatProcessorHad) {
  rewriteMessage<Scene>(whole(), other(), 0, [](Scene& scene) { scene.kernel = "another"; });
  EXPECT_EQ(json(other(), 0)["identical"], true);
}

TEST_F(Replay, WritesTheFramesItRenders) {
  const std::string frames = other("frames");
  EXPECT_EQ(replay(whole(), "--frames '" + frames + "'").code, 0);
  for (const char* name : {"camera_000060.png", "camera_000160.png", "camera_000260.png", "camera_000360.png"}) {
    const core::Image image = core::readPng(frames + "/" + name);
    EXPECT_EQ(image.width, 48);
    EXPECT_GT(*std::max_element(image.rgb.begin(), image.rgb.end()), 50) << "the frame is black";
  }
}

TEST_F(Replay, AChangedByteOfAForceMessageNamesItsStep) {
  rewriteMessage<ToolForce>(whole(), other(), 3,
                            [](ToolForce& force) { reinterpret_cast<std::uint8_t*>(&force.force.z)[0] ^= 1; });
  expectDifference(other(), "input", 30);
}

TEST_F(Replay, AnyChangedByteOfAForceMessageIsFound) {
  // Every byte but the first four: header.seq belongs to the transport and is not journaled.
  ToolForce sample;
  sample.tool_id = "probe";
  sample.header.frame_id = "volume";
  const std::size_t size = ros::serialization::serializationLength(sample);
  for (std::size_t byte = 4; byte < size; byte += 9) {
    // The first message has no neighbour before it; the fourth lies between others.
    const int number = byte % 2 == 0 ? 0 : 3;
    int seen = 0;
    rewriteBag(whole(), other(), [&](RawMessage& raw) {
      if (raw.type == "soft_volume/ToolForce" && seen++ == number)
        raw.bytes.at(byte) ^= 0x10;
      return true;
    });
    SCOPED_TRACE(byte);
    expectDifference(other(), "input", static_cast<std::uint64_t>(10 * number));
  }
}

TEST_F(Replay, AChangedByteOfAJournaledForceNamesItsStep) {
  rewriteMessage<SimulationJournal>(whole(), other(), 5, [](SimulationJournal& journal) {
    ASSERT_EQ(journal.entries.size(), 1U);
    journal.entries[0].payload.back() ^= 1;
  });
  expectDifference(other(), "journal", 40);
}

TEST_F(Replay, AForgedJournalIsFoundByTheMessageAndByTheStates) {
  rewriteMessage<SimulationJournal>(whole(), other(), 5, [](SimulationJournal& journal) {
    JournalEntry& entry = journal.entries.at(0);
    auto force = fromPayload<ToolForce>(entry.payload);
    force.force.z *= 2.0;
    entry.payload = journalPayload(force);
    entry.hash = core::hashVector(entry.payload);
  });
  expectDifference(other(), "input", 40);

  rewriteBag(other(), other("no_inputs.bag"), [](RawMessage& raw) { return raw.type != "soft_volume/ToolForce"; });
  expectDifference(other("no_inputs.bag"), "journal", 50);
}

TEST_F(Replay, AnInputThatIsNotInTheBagIsFoundBetweenOthers) {
  int seen = 0;
  rewriteBag(whole(), other(), [&](RawMessage& raw) { return raw.type != "soft_volume/ToolForce" || seen++ != 7; });
  expectDifference(other(), "input", 70);
}

TEST_F(Replay, InputsBeforeTheRecordingAreCounted) {
  int seen = 0;
  rewriteBag(whole(), other(), [&](RawMessage& raw) { return raw.type != "soft_volume/ToolForce" || seen++ >= 7; });
  EXPECT_EQ(json(other(), 0)["inputs_not_recorded"], 7);
}

TEST_F(Replay, AChangedOutcomeIsFound) {
  rewriteMessage<SimulationJournal>(whole(), other(), 16, [](SimulationJournal& journal) {
    ASSERT_EQ(journal.entries.back().outcome, JournalEntry::REFUSED);
    journal.entries.back().reason = "because";
  });
  const nlohmann::json first = expectDifference(other(), "journal", 150);
  EXPECT_NE(first["text"].get<std::string>().find("not finite"), std::string::npos);
}

TEST_F(Replay, AChangedStateNamesTheVertexAndTheDistance) {
  std::uint32_t vertex = 0;
  rewriteMessage<GridState>(whole(), other(), 4, [&](GridState& state) {
    ASSERT_FALSE(state.key_frame);
    ASSERT_GT(state.vertex_ids.size(), 10U);
    vertex = state.vertex_ids[10];
    state.positions[10].y += 0.5e-3F;
  });
  const nlohmann::json first = expectDifference(other(), "state", 80);
  EXPECT_EQ(first["vertex"], vertex);
  EXPECT_NEAR(first["size_m"].get<double>(), 0.5e-3, 1e-6);
}

TEST_F(Replay, TheLastBitOfAKeyFrameCounts) {
  rewriteMessage<GridState>(whole(), other(), 5, [](GridState& state) {
    ASSERT_TRUE(state.key_frame);
    reinterpret_cast<std::uint8_t*>(&state.positions[3].x)[0] ^= 1;
  });
  EXPECT_EQ(expectDifference(other(), "state", 100)["vertex"], 3);
}

TEST_F(Replay, AVertexThatADeltaLeavesOutIsFound) {
  std::uint32_t vertex = 0;
  rewriteMessage<GridState>(whole(), other(), 4, [&](GridState& state) {
    vertex = state.vertex_ids[2];
    state.vertex_ids.erase(state.vertex_ids.begin() + 2);
    state.positions.erase(state.positions.begin() + 2);
  });
  EXPECT_EQ(expectDifference(other(), "state", 80)["vertex"], vertex);
}

TEST_F(Replay, EveryFieldOfAStateIsCompared) {
  const std::vector<std::function<void(GridState&)>> changes = {[](GridState& s) { s.state_hash ^= 1; },
                                                                [](GridState& s) { s.moved_min.x -= 1e-6F; },
                                                                [](GridState& s) { s.simulation_time += 1e-9; },
                                                                [](GridState& s) { s.vertex_count += 1; },
                                                                [](GridState& s) { s.revision += 1; },
                                                                [](GridState& s) { s.key_frame = 1; },
                                                                [](GridState& s) { s.vertex_ids.back() = 100000; }};
  for (const auto& change : changes) {
    rewriteMessage<GridState>(whole(), other(), 4, change);
    expectDifference(other(), "state", 80);
  }
}

TEST_F(Replay, AChangedTopologyIsFound) {
  rewriteMessage<GridTopology>(whole(), other(), 1, [](GridTopology& topology) { topology.cut_faces[5] ^= 1; });
  const nlohmann::json first = expectDifference(other(), "topology", 200);
  EXPECT_NE(first["text"].get<std::string>().find("cut_faces"), std::string::npos);
}

TEST_F(Replay, DeltasOfTheTopologyAreComparedAsWhatTheyLeadTo) {
  RunSettings settings;
  settings.deltas = true;
  const std::string bag = other("deltas.bag");
  recordBag(bag, settings);
  const nlohmann::json result = json(bag, 0);
  EXPECT_EQ(result["identical"], true);
  EXPECT_EQ(result["topologies"], 2);
  EXPECT_EQ(result["not_checked"], 0);
  rewriteMessage<GridTopology>(bag, other(), 1, [](GridTopology& topology) {
    ASSERT_TRUE(topology.delta);
    ASSERT_LT(topology.cell_ids.size(), topology.cell_count);
    topology.cut_faces[5] ^= 1;
  });
  EXPECT_NE(expectDifference(other(), "topology", 200)["text"].get<std::string>().find("cut_faces"), std::string::npos);
  rewriteMessage<GridTopology>(bag, other(), 1, [](GridTopology& topology) { topology.cut_faces.pop_back(); });
  expectDifference(other(), "topology", 200);
  rewriteMessage<GridTopology>(bag, other(), 1, [](GridTopology& topology) { topology.base_revision = 0; });
  EXPECT_EQ(json(other(), 0)["not_checked"], 1) << "a receiver would wait for the next full one";
}

TEST_F(Replay, AChangedCheckpointIsFound) {
  rewriteMessage<SimulationCheckpoint>(whole(), other(), 2,
                                       [](SimulationCheckpoint& checkpoint) { checkpoint.velocities[30] += 1e-12; });
  expectDifference(other(), "checkpoint", 200);
}

TEST_F(Replay, AChangedPixelNamesTheFrame) {
  rewriteMessage<sensor_msgs::Image>(whole(), other(), 1,
                                     [](sensor_msgs::Image& image) { image.data[3 * (20 * 48 + 17) + 1] += 3; });
  const nlohmann::json first = expectDifference(other(), "frame", 160);
  EXPECT_EQ(first["camera"], "camera");
  EXPECT_EQ(first["pixel"], (std::vector<int>{17, 20}));
  EXPECT_EQ(first["size"], 3);
}

TEST_F(Replay, FramesOfAnotherDriverAreComparedByPsnr) {
  const auto other_driver = [](RawMessage& raw) {
    if (raw.type != "soft_volume/RenderStats")
      return true;
    auto stats = fromPayload<RenderStats>(raw.bytes);
    stats.renderer = "another driver";
    raw.bytes = journalPayload(stats);
    return true;
  };
  rewriteBag(whole(), other(), other_driver);
  const nlohmann::json result = json(other(), 0);
  EXPECT_EQ(result["frames_by_psnr"], 4);
  EXPECT_NE(result["notes"].dump().find("PSNR"), std::string::npos);

  // Noise that a person sees, with the hash that belongs to it.
  std::uint64_t hash = 0;
  rewriteMessage<sensor_msgs::Image>(other(), other("noise.bag"), 2, [&](sensor_msgs::Image& image) {
    for (std::size_t n = 0; n < image.data.size(); n += 2)
      image.data[n] ^= 0x20;
    hash = core::hashVector(image.data);
  });
  rewriteMessage<RenderStats>(other("noise.bag"), other("noise_hash.bag"), 2,
                              [&](RenderStats& stats) { stats.image_hash = hash; });
  expectDifference(other("noise_hash.bag"), "frame", 260);
}

TEST_F(Replay, FramesWithoutAnImageAreComparedByTheirHash) {
  rewriteBag(whole(), other(), [](RawMessage& raw) { return raw.type != "sensor_msgs/Image"; });
  EXPECT_EQ(json(other(), 0)["frames_without_image"], 4);
  rewriteMessage<RenderStats>(other(), other("hash.bag"), 0, [](RenderStats& stats) { stats.image_hash ^= 4; });
  expectDifference(other("hash.bag"), "frame", 60);
}

TEST_F(Replay, AChangedSceneOrVolumeIsFound) {
  rewriteMessage<Scene>(whole(), other(), 0, [](Scene& scene) { scene.yaml.back() = '#'; });
  expectDifference(other(), "scene", 0);
  rewriteMessage<Volume>(whole(), other(), 0, [](Volume& volume) { volume.data[1000] ^= 1; });
  expectDifference(other(), "volume", 0);
}

TEST_F(Replay, SeveralSessionsInOneBag) {
  {
    BagRecorderSettings settings;
    settings.file = other();
    settings.reserve_bytes = 1 << 20;
    BagRecorder recorder(settings);
    RunSettings first;
    first.steps = 230;
    RunSettings second;
    second.session = 2;
    second.restore = recordRun(recorder, first);
    second.steps = 120;
    RunSettings third;
    third.session = 3;
    third.steps = 100;
    recordRun(recorder, second);
    recordRun(recorder, third);
  }
  const nlohmann::json result = json(other(), 0);
  EXPECT_EQ(result["sessions"], 3);
  EXPECT_EQ(result["steps"], 450);
  EXPECT_EQ(result["not_checked"], 0);
  // The third frame is the second session's.
  rewriteMessage<sensor_msgs::Image>(other(), other("pixel.bag"), 2,
                                     [](sensor_msgs::Image& image) { image.data[0] ^= 1; });
  EXPECT_EQ(json(other("pixel.bag"), 1)["first_difference"]["session"], 2);
}

TEST_F(Replay, StartsFromTheFirstCheckpointWhenTheStartIsMissing) {
  RunSettings settings;
  settings.first_recorded_step = 55;
  recordBag(other(), settings);
  const nlohmann::json result = json(other(), 0);
  EXPECT_EQ(result["steps"], 300);
  EXPECT_EQ(result["not_checked"], 4) << "the first topology, two states and a frame come before";
  EXPECT_NE(result["notes"].dump().find("checkpoint of step 100"), std::string::npos);
}

TEST_F(Replay, WithoutStartAndCheckpointSaysWhatToDo) {
  RunSettings settings;
  settings.first_recorded_step = 55;
  settings.steps = 90;
  recordBag(other(), settings);
  expectImpossible(other(), "start the recorder before the simulation");
}

TEST_F(Replay, AJournalWithAGapEndsTheReplay) {
  int seen = 0;
  rewriteBag(whole(), other(),
             [&](RawMessage& raw) { return raw.type != "soft_volume/SimulationJournal" || seen++ != 9; });
  expectImpossible(other(), "steps 80 to 90 are missing");
}

TEST_F(Replay, AMissingTopicIsNamed) {
  for (const std::string topic : {"/scene", "/volume", "/simulation/journal", "/grid/state"}) {
    rewriteBag(whole(), other(), [&](RawMessage& raw) { return raw.topic != topic; });
    expectImpossible(other(), "'" + topic.substr(1) + "'");
  }
}

TEST_F(Replay, AnotherVersionIsRefused) {
  rewriteMessage<Scene>(whole(), other(), 0, [](Scene& scene) { scene.package_version = "77.3.1"; });
  expectImpossible(other(), "soft_volume 77.3.1");
  rewriteBag(whole(), other(), [](RawMessage& raw) {
    if (raw.type == "soft_volume/GridState")
      raw.md5sum[0] = raw.md5sum[0] == '0' ? '1' : '0';
    return true;
  });
  expectImpossible(other(), "recorded by another version");
}

TEST_F(Replay, AMessageUnderAWrongNameIsNotLeftOut) {
  rewriteBag(whole(), other(), [](RawMessage& raw) {
    if (raw.type == "soft_volume/RenderStats")
      raw.type = "soft_volume/RenderStatr";
    return true;
  });
  expectImpossible(other(), "damaged");
}

TEST_F(Replay, RemappedTopicsAreFound) {
  rewriteBag(whole(), other(), [](RawMessage& raw) {
    raw.topic = "/left/theatre" + raw.topic;
    return true;
  });
  EXPECT_EQ(json(other(), 0)["frames_without_image"], 0);
}

TEST_F(Replay, BadFilesAndArguments) {
  expectImpossible(other("nowhere.bag"), "no such bag");
  std::ofstream(other("empty.bag"));
  expectImpossible(other("empty.bag"), "empty");
  std::ofstream(other("text.bag")) << "this is no bag, but a text that is long enough to be one";
  expectImpossible(other("text.bag"), "not a bag");
  expectImpossible(*folder_ / "", "no such bag");
  EXPECT_EQ(replay(whole(), "").code, 2);
  EXPECT_EQ(replay(whole(), "--check --threads 0").code, 2);
  EXPECT_EQ(replay(whole(), "--check --no-such-option").code, 2);
  EXPECT_EQ(replay(whole(), "--help").code, 0);
}

TEST_F(Replay, ATruncatedBagIsReplayedAfterReindexing) {
  const std::string long_bag = other("chunks.bag");
  rewriteBag(whole(), long_bag, [](RawMessage&) { return true; });
  const auto size = std::filesystem::file_size(long_bag);
  std::uint64_t steps_before = 0;
  for (const double part : {0.02, 0.6, 0.8, 0.97}) {
    std::filesystem::copy_file(long_bag, other(), std::filesystem::copy_options::overwrite_existing);
    std::filesystem::resize_file(other(), static_cast<std::uintmax_t>(part * static_cast<double>(size)));
    EXPECT_EQ(replay(other()).code, 2) << part;
    EXPECT_EQ(std::system(("PATH=/usr/bin:$PATH rosbag reindex -q -f '" + other() + "'").c_str()), 0);
    std::filesystem::remove(other("other.orig.bag"));
    const ProgramResult result = replay(other());
    if (result.code == 2)
      continue;  // not even the first journal is left
    const std::uint64_t steps = json(other(), 0)["steps"];
    EXPECT_GE(steps, steps_before);
    steps_before = steps;
  }
  EXPECT_GT(steps_before, 100U);
}

TEST_F(Replay, DamagedBagsNeverCrashItAndAreNeverTakenForIdentical) {
  // Chunks of lz4 carry checksums. Flips outside chunks may be harmless: then the content must be all there.
  std::ifstream in(whole(), std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
  const nlohmann::json expected = json(whole(), 0);
  std::mt19937 random(1997);
  int found = 0;
  constexpr int kFlips = 100;
  for (int n = 0; n < kFlips; ++n) {
    std::string damaged = bytes;
    const std::size_t at = random() % damaged.size();
    damaged[at] = static_cast<char>(damaged[at] ^ (1 << random() % 8));
    std::ofstream(other(), std::ios::binary) << damaged;
    const std::string file = *folder_ / "fuzz.json";
    const ProgramResult result = replay(other(), "--check --json '" + file + "'");
    ASSERT_TRUE(result.code >= 0 && result.code <= 2) << "byte " << at << ": " << result.code << "\n" << result.output;
    found += result.code != 0 ? 1 : 0;
    if (result.code != 0)
      continue;
    const nlohmann::json same = nlohmann::json::parse(std::ifstream(file));
    for (const char* count : {"steps", "inputs", "states", "frames", "journals", "checkpoints", "topologies"}) {
      EXPECT_EQ(same[count], expected[count]) << "byte " << at << ", " << count;
    }
  }
  EXPECT_GT(found, kFlips / 2);
}

TEST_F(Replay, DamagedUncompressedBagsNeverCrashIt) {
  // Without checksums a flip reaches every reader of the format and of the messages.
  const std::string plain = other("plain.bag");
  rewriteBag(
      whole(), plain, [](RawMessage&) { return true; }, false);
  std::ifstream in(plain, std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
  std::mt19937 random(1997);
  int found = 0;
  for (int n = 0; n < 60; ++n) {
    std::string damaged = bytes;
    // Four bytes in a row, so that lengths and offsets become large.
    const std::size_t at = random() % (damaged.size() - 4);
    for (std::size_t b = at; b < at + 4; ++b)
      damaged[b] = static_cast<char>(random());
    std::ofstream(other(), std::ios::binary) << damaged;
    const ProgramResult result = replay(other());
    ASSERT_TRUE(result.code >= 0 && result.code <= 2) << "byte " << at << ": " << result.code << "\n" << result.output;
    found += result.code != 0 ? 1 : 0;
  }
  EXPECT_GT(found, 30);
}

}  // namespace
}  // namespace soft_volume
