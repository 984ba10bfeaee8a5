#include "soft_volume/replay/recorded_run.h"

#include <rosbag/exceptions.h>
#include <sensor_msgs/Image.h>
#include <soft_volume/GridState.h>
#include <soft_volume/GridTopology.h>
#include <soft_volume/Volume.h>

#include <algorithm>
#include <limits>
#include <set>

#include "bag_contents.h"
#include "soft_volume/common/error.h"
#include "soft_volume/common/hash.h"
#include "soft_volume/grid/topology_delta.h"

namespace soft_volume {
namespace {

constexpr std::size_t kNone = std::numeric_limits<std::size_t>::max();

using Lists = std::vector<BagMessage> SessionMessages::*;
constexpr Lists kLists[] = {&SessionMessages::scenes,      &SessionMessages::volumes,  &SessionMessages::topologies,
                            &SessionMessages::states,      &SessionMessages::journals, &SessionMessages::checkpoints,
                            &SessionMessages::render_stats};

/// When the first message of a session was received.
ros::Time firstReceipt(const SessionMessages& messages) {
  ros::Time first = ros::TIME_MAX;
  for (const Lists list : kLists) {
    for (const BagMessage& message : messages.*list)
      first = std::min(first, message.instance->getTime());
  }
  return first;
}

bool endsWith(const std::string& text, const std::string& ending) {
  return text.size() >= ending.size() && text.compare(text.size() - ending.size(), ending.size(), ending) == 0;
}

core::Image toImage(sensor_msgs::Image message) {
  const std::size_t size = std::size_t(3) * message.width * message.height;
  const bool usable = message.encoding == "rgb8" && message.step == 3 * message.width && message.data.size() == size;
  if (!usable)
    throw ReplayError("an image of the bag is not an rgb8 image without gaps; record the renderer's own images");
  return {static_cast<int>(message.width), static_cast<int>(message.height), std::move(message.data)};
}

}  // namespace

struct RecordedRun::Decoder {
  std::size_t key_frame = kNone;
  std::vector<core::Vector3f> key_positions;
  core::TopologyDecoder topologies;
  std::size_t next_topology = 0;
};

RecordedRun::RecordedRun(const RecordedBag& bag, const SessionMessages& messages)
    : bag_(&bag), messages_(&messages), end_(ros::TIME_MAX), decoder_(std::make_unique<Decoder>()) {
  readStates();
  readFrames();
  for (RecordedMessage<SimulationStats>& stats : this->messages<SimulationStats>())
    stats_.push_back(std::move(stats.message));
  std::stable_sort(stats_.begin(), stats_.end(), [](const auto& a, const auto& b) { return a.step < b.step; });
}

RecordedRun::~RecordedRun() = default;

std::uint64_t RecordedRun::session() const {
  return messages_->session;
}

bool RecordedRun::isMine(std::uint64_t session) const {
  return session == messages_->session;
}

void RecordedRun::readStates() {
  for (const BagMessage& state : messages_->states)
    states_.push_back({state.step, state.revision, state.time_s, state.key_frame});
  if (!messages_->states.empty()) {
    reference_stamp_ = bag_->contents_->read<GridState>(*messages_->states.front().instance).header.stamp;
    reference_time_s_ = messages_->states.front().time_s;
  } else if (!messages_->scenes.empty()) {
    reference_stamp_ = sceneMessage().header.stamp;
  }
}

std::size_t RecordedRun::findImage(const RenderStats& stats) const {
  const std::string ending = "/" + stats.camera + "/image_raw";
  const std::vector<BagImage>& images = bag_->contents_->images();
  std::vector<std::size_t> candidates;
  for (std::size_t n = 0; n < images.size(); ++n) {
    const bool mine = std::find(images_.begin(), images_.end(), n) == images_.end();
    if (mine && images[n].stamp_ns == stats.header.stamp.toNSec() && endsWith("/" + images[n].topic, ending))
      candidates.push_back(n);
  }
  // Several views of one state carry the same stamp.
  const auto same = std::find_if(candidates.begin(), candidates.end(), [&](std::size_t n) {
    return candidates.size() == 1 ||
           core::hashVector(bag_->contents_->read<sensor_msgs::Image>(*images[n].instance).data) == stats.image_hash;
  });
  return same == candidates.end() ? kNone : *same;
}

void RecordedRun::readFrames() {
  for (const BagMessage& message : messages_->render_stats) {
    RecordedFrame frame;
    frame.stats = bag_->contents_->read<RenderStats>(*message.instance);
    frame.time_s = timeOfStep(frame.stats.step);
    images_.push_back(findImage(frame.stats));
    if (images_.back() != kNone)
      frame.topic = bag_->contents_->images()[images_.back()].topic;
    frames_.push_back(std::move(frame));
  }
}

Scene RecordedRun::sceneMessage() const {
  if (messages_->scenes.empty())
    throw ReplayError(bag_->path() + ": the bag holds no scene of session " + std::to_string(session()) +
                      "; record the latched topic 'scene' too");
  return bag_->contents_->read<Scene>(*messages_->scenes.front().instance);
}

core::Scene RecordedRun::scene() const {
  return core::parseScene(sceneMessage().yaml, "the bag's scene", ".");
}

VolumeAndLabels RecordedRun::volume() const {
  if (messages_->volumes.empty())
    throw ReplayError(bag_->path() + ": the bag holds no volume of session " + std::to_string(session()) +
                      "; record the latched topic 'volume' too");
  try {
    return fromMessage(bag_->contents_->read<Volume>(*messages_->volumes.front().instance));
  } catch (const core::InputError& error) {
    throw ReplayError(bag_->path() + ": the bag is damaged: " + error.what());
  }
}

std::size_t RecordedRun::findKeyFrame(std::size_t state) const {
  const BagMessage& wanted = messages_->states.at(state);
  for (std::size_t n = state + 1; n-- > 0;) {
    const BagMessage& candidate = messages_->states[n];
    if (candidate.key_frame && candidate.step == wanted.base_step && candidate.revision == wanted.revision)
      return n;
  }
  return kNone;
}

bool RecordedRun::hasPositions(std::size_t state) const {
  return findKeyFrame(state) != kNone;
}

std::vector<core::Vector3f> RecordedRun::positions(std::size_t state) const {
  const std::size_t key_frame = findKeyFrame(state);
  if (key_frame == kNone)
    throw ReplayError(bag_->path() + ": the key frame of the state of step " +
                      std::to_string(messages_->states.at(state).step) + " is not in the bag");
  const auto read = [this](std::size_t n) {
    return fromMessage(bag_->contents_->read<GridState>(*messages_->states[n].instance));
  };
  try {
    if (decoder_->key_frame != key_frame) {
      decoder_->key_positions = read(key_frame).positions_m;
      decoder_->key_frame = key_frame;
    }
    core::StateDecoder decoder;
    core::GridStateFrame base;
    base.session = session();
    base.revision = states_[key_frame].revision;
    base.step = base.base_step = states_[key_frame].step;
    base.key_frame = true;
    base.vertex_count = static_cast<std::uint32_t>(decoder_->key_positions.size());
    base.positions_m = decoder_->key_positions;
    decoder.expect(session(), base.revision, base.positions_m);
    decoder.apply(base);
    if (key_frame != state)
      decoder.apply(read(state));
    return decoder.positions();
  } catch (const core::InputError& error) {
    throw ReplayError(bag_->path() + ": the bag is damaged: the state of step " + std::to_string(states_[state].step) +
                      ": " + error.what());
  }
}

std::vector<std::uint32_t> RecordedRun::revisions() const {
  std::set<std::uint32_t> all;
  for (const BagMessage& message : messages_->topologies)
    all.insert(message.revision);
  return {all.begin(), all.end()};
}

std::shared_ptr<const core::Topology> RecordedRun::topology(std::uint32_t revision) const {
  const auto here = [&] {
    const auto& topology = decoder_->topologies.topology();
    return topology && topology->revision == revision ? topology : nullptr;
  };
  if (here())
    return here();
  const auto& known = decoder_->topologies.topology();
  if (known && known->revision > revision) {
    decoder_->topologies = core::TopologyDecoder();
    decoder_->next_topology = 0;
  }
  const std::vector<BagMessage>& messages = messages_->topologies;
  try {
    while (decoder_->next_topology < messages.size() && messages[decoder_->next_topology].revision <= revision) {
      const BagMessage& message = messages[decoder_->next_topology++];
      takeMessage(bag_->contents_->read<GridTopology>(*message.instance), decoder_->topologies);
    }
  } catch (const core::InputError& error) {
    throw ReplayError(bag_->path() + ": the bag is damaged: a topology: " + error.what());
  }
  return here();
}

bool RecordedRun::hasImage(std::size_t frame) const {
  return images_.at(frame) != kNone;
}

core::Image RecordedRun::image(std::size_t frame) const {
  if (!hasImage(frame))
    throw ReplayError(bag_->path() + ": the image of step " + std::to_string(frames_.at(frame).stats.step) +
                      " was not recorded");
  return toImage(bag_->contents_->read<sensor_msgs::Image>(*bag_->contents_->images()[images_[frame]].instance));
}

std::vector<SimulationJournal> RecordedRun::journals() const {
  std::vector<SimulationJournal> all;
  for (const BagMessage& message : messages_->journals)
    all.push_back(bag_->contents_->read<SimulationJournal>(*message.instance));
  return all;
}

std::vector<RecordedEntry> RecordedRun::entries() const {
  std::vector<RecordedEntry> all;
  for (const BagMessage& message : messages_->journals) {
    auto journal = bag_->contents_->read<SimulationJournal>(*message.instance);
    for (JournalEntry& entry : journal.entries) {
      const double time_s = timeOfStep(entry.step);
      all.push_back({time_s, std::move(entry)});
    }
  }
  return all;
}

double RecordedRun::timeOfStep(std::uint64_t step) const {
  const auto after = std::lower_bound(states_.begin(), states_.end(), step,
                                      [](const RecordedState& state, std::uint64_t s) { return state.step < s; });
  if (after != states_.end() && after->step == step)
    return after->time_s;
  // A line through two states of different steps, the nearest ones; before the first and after the last as beside it.
  auto high = after == states_.end() ? after - (states_.empty() ? 0 : 1) : after;
  auto low = high;
  while (low != states_.begin() && low->step == high->step)
    --low;
  while (!states_.empty() && high + 1 != states_.end() && low->step == high->step)
    ++high;
  if (states_.empty() || low->step == high->step)
    return states_.empty() ? 0.0 : low->time_s;
  const double dt_s = (high->time_s - low->time_s) / static_cast<double>(high->step - low->step);
  return low->time_s + dt_s * (static_cast<double>(step) - static_cast<double>(low->step));
}

void RecordedBag::forEach(const std::string& type, const std::string& md5sum, const Take& take) const {
  try {
    const bool same_version = contents_->visit(type, md5sum, [&](const rosbag::MessageInstance& instance) {
      take(instance.getTopic(), instance.getTime(), contents_->bytes(instance));
    });
    const std::string note = "messages of type " + type + " are of another version and were left out";
    if (!same_version && std::find(notes_.begin(), notes_.end(), note) == notes_.end())
      notes_.push_back(note);
  } catch (const ros::Exception& error) {
    throw ReplayError(path_ + ": the bag is damaged: " + error.what());
  }
}

const std::vector<RecorderEvent>& RecordedBag::events() const {
  return contents_->events();
}

RecordedBag::RecordedBag(const std::string& path) : path_(path), contents_(std::make_unique<BagContents>(path)) {
  for (const SessionMessages& messages : contents_->sessions())
    runs_.emplace_back(new RecordedRun(*this, messages));
  for (std::size_t n = 1; n < runs_.size(); ++n)
    runs_[n]->begin_ = runs_[n - 1]->end_ = firstReceipt(contents_->sessions()[n]);
}

RecordedBag::~RecordedBag() = default;

const RecordedRun& RecordedBag::longest() const {
  const auto duration = [](const auto& run) { return run->states().empty() ? -1.0 : run->states().back().time_s; };
  const auto longest = std::max_element(runs_.begin(), runs_.end(),
                                        [&](const auto& a, const auto& b) { return duration(a) < duration(b); });
  if (longest == runs_.end())
    throw ReplayError(path_ + ": the bag holds no run");
  return **longest;
}

}  // namespace soft_volume
