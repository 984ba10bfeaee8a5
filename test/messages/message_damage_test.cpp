// Messages that are cut off, claim huge arrays or have random bytes in them, as a node gets them: each must be refused
// or be drawn, never crash, hang or cost much memory.

#include <geometry_msgs/PoseStamped.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <iterator>
#include <random>
#include <string>
#include <utility>

#include "message_session.h"
#include "soft_volume/common/error.h"
#include "soft_volume/messages/checked_stream.h"
#include "soft_volume/render/renderer.h"
#include "soft_volume/tool/tool.h"
#include "volume/file_damage.h"

namespace soft_volume {
namespace {

using Bytes = std::vector<std::uint8_t>;
using Overrun = ros::serialization::StreamOverrunException;
using core::testing_volume::fuzzRounds;

template <typename Message>
Bytes bytesOf(const Message& message) {
  Bytes bytes(ros::serialization::serializationLength(message));
  ros::serialization::OStream stream(bytes.data(), static_cast<std::uint32_t>(bytes.size()));
  stream.next(message);
  return bytes;
}

template <typename Message>
Message read(Bytes bytes) {
  Message message;
  CheckedStream stream(bytes.data(), static_cast<std::uint32_t>(bytes.size()));
  stream.next(message);
  return message;
}

/// Reads a message and notes where in it the lengths of strings and arrays are.
class LengthFinder : public ros::serialization::Stream {
 public:
  static const ros::serialization::StreamType stream_type = ros::serialization::stream_types::Input;

  explicit LengthFinder(Bytes& bytes)
      : Stream(bytes.data(), static_cast<std::uint32_t>(bytes.size())), begin_(bytes.data()) {}

  template <typename T>
  void next(T& value) {
    ros::serialization::deserialize(*this, value);
  }
  template <typename T>
  void next(std::vector<T>& values) {
    note(values);
  }
  void next(std::string& text) { note(text); }

  const std::vector<std::size_t>& places() const { return places_; }

 private:
  template <typename T>
  void note(T& value) {
    places_.push_back(static_cast<std::size_t>(getData() - begin_));
    ros::serialization::deserialize(*this, value);
  }

  std::uint8_t* begin_;
  std::vector<std::size_t> places_;
};

template <typename Message>
std::vector<std::size_t> lengthPlaces(Bytes bytes) {
  LengthFinder finder(bytes);
  Message message;
  finder.next(message);
  return finder.places();
}

void put(std::uint32_t value, std::size_t at, Bytes& bytes) {
  std::memcpy(bytes.data() + at, &value, sizeof(value));
}

/// What the messages of a run look like; labels, a force, a cut and a polyhedron in them.
struct Good {
  Good() {
    const auto labelled = makeSession(kSession, true);
    scene = sceneMessage(*labelled);
    volume = toMessage(*labelled);
    const auto session = makeUsedSession();
    topology = topologyMessage(*session);
    core::GridStateFrame frame;
    frame.session = kSession;
    frame.revision = topology.revision;
    core::StateEncoder encoder;
    encoder.encode(session->drawnPositions(), true, frame);
    key_frame = toMessage(frame);
    for (int n = 0; n < 20; ++n)
      session->step();
    frame.step = 20;
    encoder.encode(session->drawnPositions(), false, frame);
    delta = toMessage(frame);
    patch = toMessage(session->patch("probe", {0.024, 0.024, 0.031}, 0.01));
    view.pose = toPose(session->scene().rendering.cameras.at(0).camera.T_volume_camera);
    cut = cutMessage(9);
  }

  template <typename Visitor>
  void visit(const Visitor& visitor) const {
    visitor(scene);
    visitor(volume);
    visitor(topology);
    visitor(key_frame);
    visitor(delta);
    visitor(patch);
    visitor(view);
    visitor(cut);
  }

  Scene scene;
  Volume volume;
  GridTopology topology;
  GridState key_frame;
  GridState delta;
  GridPatch patch;
  geometry_msgs::PoseStamped view;
  ToolCut cut;
};

const Good& good() {
  static const Good messages;
  return messages;
}

long peakMemory_kib() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return usage.ru_maxrss;
}

TEST(CheckedStream, ReadsWhatRoscppReads) {
  good().visit([](const auto& message) {
    using Message = std::decay_t<decltype(message)>;
    EXPECT_EQ(read<Message>(bytesOf(message)), message) << ros::message_traits::datatype<Message>();
  });
}

TEST(MessageDamage, CutOffMessagesAreRefused) {
  good().visit([](const auto& message) {
    using Message = std::decay_t<decltype(message)>;
    const Bytes bytes = bytesOf(message);
    const std::size_t stride = 1 + bytes.size() / 500;
    for (std::size_t size = 0; size < bytes.size(); size += stride)
      EXPECT_THROW(read<Message>(Bytes(bytes.begin(), bytes.begin() + size)), Overrun)
          << size << " of " << bytes.size();
  });
}

/// 0x20000001 times 8 bytes and 0x40000001 times 4 are 8 and 4 in 32 bits, which is what roscpp computes with.
TEST(MessageDamage, ClaimedLengthsAreRefusedBeforeTheyCostMemory) {
  constexpr std::uint32_t kClaims[] = {1000000, 0x20000001, 0x40000001, 0x7fffffff, 0x80000000, 0xfffffffc, 0xffffffff};
  const long before_kib = peakMemory_kib();
  int claims = 0;
  good().visit([&claims, &kClaims](const auto& message) {
    using Message = std::decay_t<decltype(message)>;
    const Bytes bytes = bytesOf(message);
    for (const std::size_t place : lengthPlaces<Message>(bytes)) {
      for (const std::uint32_t claim : kClaims) {
        Bytes damaged = bytes;
        put(claim, place, damaged);
        EXPECT_THROW(read<Message>(damaged), Overrun)
            << ros::message_traits::datatype<Message>() << " claims " << claim << " at byte " << place;
        ++claims;
      }
    }
  });
  EXPECT_GT(claims, 200);
  EXPECT_LT(peakMemory_kib() - before_kib, 64 * 1024);
}

/// Does with messages what renderer_node and tool_node do with them.
class Receiver {
 public:
  Receiver() { restore(); }

  void restore() {
    take(good().scene);
    take(good().volume);
    take(good().topology);
    take(good().key_frame);
    take(good().patch);
    take(good().view);
  }

  void take(const Scene& message) {
    const core::Scene scene = core::parseScene(message.yaml, "the scene message", "/");
    settings_ = core::overrideRendering(scene, "{}", "the parameters");
    settings_.options.slices = std::min(settings_.options.slices, 100);  // for time alone
    camera_ = settings_.cameras.at(0).camera;
    camera_.width = std::min(camera_.width, 40);
    camera_.height = std::min(camera_.height, 30);
    tool_ = std::make_unique<core::Tool>(scene.tools.at(0), 1);
    fit();
  }

  void take(const Volume& message) {
    const VolumeAndLabels content = fromMessage(message);
    renderer_.setVolume(content.volume);
    renderer_.setLabels(content.labels);
    volume_ = content.volume;
    has_labels_ = content.labels != nullptr;
    tool_->setVolume(volume_);
    fit();
  }

  void take(const GridTopology& message) {
    const auto topology = std::make_shared<const core::Topology>(fromMessage(message));
    decoder_.expect(topology->session, topology->revision, topology->rest_positions);
    renderer_.setTopology(*topology);
    tool_->setTopology(topology);
  }

  void take(const GridState& message) {
    decoder_.apply(fromMessage(message));
    for (const core::Vector3f& p : decoder_.positions())
      ASSERT_TRUE(p.allFinite());
  }

  void take(const GridPatch& message) { tool_->setPatch(fromMessage(message)); }

  void take(const geometry_msgs::PoseStamped& message) {
    core::Pose pose = fromPose(message.pose);
    if (!core::isUsable(pose))
      throw core::InputError("the pose is not finite or its quaternion is not a rotation");
    pose.orientation.normalize();
    camera_.T_volume_camera = pose;
  }

  void take(const ToolCut& message) {
    const auto session = makeSession();
    const core::Verdict verdict = session->apply(fromMessage(message));
    if (!verdict.applied)
      throw core::InputError(verdict.reason);
    session->step();
  }

  /// In one of the ways that a scene may ask for.
  void draw(unsigned variant) {
    core::RenderOptions options = settings_.options;
    options.depth = options.labels = has_labels_;
    options.exact_boundary = (variant & 1) != 0;
    options.adaptive = (variant & 2) != 0;
    options.jitter = (variant & 4) != 0;
    options.threads = 1;
    const core::Frame& frame = renderer_.render(camera_, decoder_.positions(), options);
    for (const float value : frame.rgba)
      ASSERT_TRUE(std::isfinite(value));
  }

 private:
  void fit() {
    if (volume_ == nullptr)
      return;
    core::fitTransferFunction(settings_, *volume_);
    renderer_.setTransferFunction(settings_.transfer_function);
  }

  core::Renderer renderer_{core::Backend::kNative};
  core::RenderSettings settings_;
  core::Camera camera_;
  core::StateDecoder decoder_;
  std::shared_ptr<const core::Volume> volume_;
  std::unique_ptr<core::Tool> tool_;
  bool has_labels_ = false;
};

/// Numbers that programs stumble over: lengths, NaN, infinity, 1e38, a denormal, and small ones, which are valid
/// indices.
std::uint32_t badNumber(std::mt19937& random) {
  constexpr std::uint32_t kBad[] = {0,          1,          0xffffffff, 0x7fffffff, 0x80000000, 0x20000001,
                                    0x7fc00000, 0x7f800000, 0x7e967699, 0xfe967699, 0x00000400, 0xbf800000};
  return random() % 2 == 0 ? kBad[random() % std::size(kBad)] : random() % 64;
}

/// Damages the front of a message, where most of its fields are, more often than the rest.
std::size_t place(std::size_t size, std::mt19937& random) {
  return random() % (random() % 2 == 0 ? size : std::min<std::size_t>(size, 200));
}

Bytes damaged(Bytes bytes, const std::vector<std::size_t>& lengths, std::mt19937& random) {
  const std::size_t at = place(bytes.size(), random);
  switch (random() % 6) {
    case 0:
      bytes.resize(at);
      break;
    case 1:
      put(badNumber(random), lengths[random() % lengths.size()], bytes);
      break;
    case 2:
      for (std::size_t n = 0, count = 1 + random() % 8; n < count; ++n)
        put(badNumber(random), place(bytes.size() - 3, random), bytes);
      break;
    case 3:
      bytes.erase(bytes.begin() + at, bytes.begin() + std::min(bytes.size(), at + random() % 40));
      break;
    case 4:
      bytes.insert(bytes.begin() + at, random() % 40, static_cast<std::uint8_t>(random()));
      break;
    default:
      for (std::size_t n = 0, count = 1 + random() % 4; n < count; ++n)
        bytes[place(bytes.size(), random)] ^= static_cast<std::uint8_t>(1U << random() % 8);
  }
  return bytes;
}

/// A hostile sender states the hash of what it sends.
void mend(Volume& message) {
  try {
    fromMessage(message);
  } catch (const core::InputError&) {
    core::VolumeGeometry geometry;
    for (int d = 0; d < 3; ++d) {
      geometry.dims[d] = static_cast<int>(message.dims[d]);
      geometry.spacing_m[d] = message.spacing[d];
      geometry.origin_m[d] = message.origin[d];
      for (int c = 0; c < 3; ++c)
        geometry.direction(d, c) = message.direction[3 * d + c];
    }
    message.hash = core::Volume(geometry, static_cast<core::ScalarType>(message.scalar_type), message.data).hash();
  }
}
template <typename Message>
void mend(Message&) {}

class Fuzz {
 public:
  explicit Fuzz(unsigned seed) : random_(seed) {}

  template <typename Message>
  void tryOne(const Message& message) {
    const Bytes bytes = bytesOf(message);
    const std::vector<std::size_t> lengths = lengthPlaces<Message>(bytes);
    Message hostile;
    try {
      hostile = read<Message>(damaged(bytes, lengths, random_));
    } catch (const Overrun&) {
      ++unreadable_;
      return;
    }
    try {
      mend(hostile);
      receiver_.take(hostile);
      receiver_.draw(static_cast<unsigned>(random_()));
      ++accepted_;
    } catch (const core::Error&) {
      ++refused_;
    }
    receiver_.restore();
  }

  void report(std::ostream& out) const {
    out << unreadable_ << " unreadable, " << refused_ << " refused, " << accepted_ << " accepted\n";
  }

  int unreadable() const { return unreadable_; }
  int refused() const { return refused_; }
  int accepted() const { return accepted_; }

 private:
  std::mt19937 random_;
  Receiver receiver_;
  int unreadable_ = 0;
  int refused_ = 0;
  int accepted_ = 0;
};

/// SOFT_VOLUME_FUZZ_SEED chooses another one.
unsigned fuzzSeed() {
  const char* seed = std::getenv("SOFT_VOLUME_FUZZ_SEED");
  return seed != nullptr ? static_cast<unsigned>(std::atoi(seed)) : 1997;
}

TEST(MessageDamage, RandomDamageIsRefusedOrDrawn) {
  const unsigned seed = fuzzSeed();
  SCOPED_TRACE("seed " + std::to_string(seed));
  Fuzz fuzz(seed);
  const long before_kib = peakMemory_kib();
  for (int round = 0; round < fuzzRounds(300); ++round)
    good().visit([&fuzz](const auto& message) { fuzz.tryOne(message); });
  std::cout << "seed " << seed << ": ";
  fuzz.report(std::cout);
  EXPECT_GT(fuzz.unreadable(), 0);
  EXPECT_GT(fuzz.refused(), 0);
  EXPECT_GT(fuzz.accepted(), 0);
  EXPECT_LT(peakMemory_kib() - before_kib, 512 * 1024);
}

}  // namespace
}  // namespace soft_volume
