#include "session_replay.h"

#include <soft_volume/GridTopology.h>
#include <soft_volume/RenderStats.h>
#include <soft_volume/SimulationCheckpoint.h>
#include <soft_volume/Volume.h>

#include <algorithm>
#include <cmath>
#include <sstream>
#include <utility>

#include "soft_volume/common/error.h"
#include "soft_volume/common/hash.h"
#include "soft_volume/messages/conversions.h"
#include "soft_volume/messages/topics.h"

namespace soft_volume {
namespace {

std::uint64_t hashText(const std::string& text) {
  return core::hashBytes(text.data(), text.size());
}

std::string nameOf(const SessionMessages& messages) {
  return "session " + std::to_string(messages.session);
}

/// "1.2" of "1.2.3".
std::string majorMinor(const std::string& version) {
  return version.substr(0, version.find('.', version.find('.') + 1));
}

bool isRestore(const JournalEntry& entry) {
  return entry.topic == topics::kRestoreCheckpoint && entry.outcome == JournalEntry::APPLIED;
}

/// Names the first field of two messages that differs.
template <typename Message>
class FieldComparison {
 public:
  FieldComparison(const Message& recorded, const Message& rebuilt) : recorded_(recorded), rebuilt_(rebuilt) {}

  template <typename Field>
  FieldComparison& field(const char* name, Field Message::*member) {
    if (different_.empty() && !(recorded_.*member == rebuilt_.*member))
      different_ = name;
    return *this;
  }
  std::string orElse(const std::string& text) const { return different_.empty() ? text : different_; }

 private:
  const Message& recorded_;
  const Message& rebuilt_;
  std::string different_;
};

std::string differentField(const GridTopology& recorded, const GridTopology& rebuilt) {
  using T = GridTopology;
  return FieldComparison<T>(recorded, rebuilt)
      .field("revision", &T::revision)
      .field("step", &T::step)
      .field("vertex_count", &T::vertex_count)
      .field("cell_count", &T::cell_count)
      .field("rest_positions", &T::rest_positions)
      .field("texture_coordinates", &T::texture_coordinates)
      .field("fixed", &T::fixed)
      .field("origin_vertices", &T::origin_vertices)
      .field("connectivity", &T::connectivity)
      .field("parent_cells", &T::parent_cells)
      .field("materials", &T::materials)
      .field("face_neighbours", &T::face_neighbours)
      .field("cut_faces", &T::cut_faces)
      .orElse("another field");
}

std::string differentField(const SimulationCheckpoint& recorded, const SimulationCheckpoint& rebuilt) {
  using C = SimulationCheckpoint;
  return FieldComparison<C>(recorded, rebuilt)
      .field("revision", &C::revision)
      .field("scene_hash", &C::scene_hash)
      .field("volume_hash", &C::volume_hash)
      .field("state_hash", &C::state_hash)
      .field("displacements", &C::displacements)
      .field("velocities", &C::velocities)
      .field("lifetimes", &C::lifetimes)
      .field("forces", &C::forces)
      .field("grips", &C::grips)
      .field("integrator", &C::integrator)
      .field("dt", &C::dt)
      .field("dt_since_step", &C::dt_since_step)
      .field("dt_since_time", &C::dt_since_time)
      .field("sequence_tools", &C::sequence_tools)
      .field("sequences", &C::sequences)
      .orElse("incisions");
}

template <typename Message>
std::vector<std::uint8_t> serialized(const Message& message) {
  std::vector<std::uint8_t> bytes(ros::serialization::serializationLength(message));
  ros::serialization::OStream stream(bytes.data(), static_cast<std::uint32_t>(bytes.size()));
  ros::serialization::serialize(stream, message);
  return bytes;
}

}  // namespace

std::optional<ReplayStart> findStart(const BagContents& contents, const SessionMessages& messages) {
  if (messages.journals.empty())
    return std::nullopt;
  const BagMessage& first = messages.journals.front();
  if (first.first_step == 0)
    return ReplayStart{};
  const auto journal = contents.read<SimulationJournal>(*first.instance);
  if (!journal.entries.empty() && journal.entries[0].order == 0 && isRestore(journal.entries[0]))
    return ReplayStart{};
  for (const BagMessage& checkpoint : messages.checkpoints) {
    for (std::size_t n = 0; n < messages.journals.size(); ++n) {
      const BagMessage& candidate = messages.journals[n];
      if (candidate.first_step <= checkpoint.step && checkpoint.step < candidate.step) {
        return ReplayStart{n, &checkpoint};
      }
    }
  }
  return std::nullopt;
}

SessionReplay::SessionReplay(BagContents& contents, const SessionMessages& messages, const ReplayStart& start,
                             const ReplayOptions& options, FrameReplay& frames, Advance advance, ReplayReport& report)
    : contents_(&contents),
      messages_(&messages),
      start_(start),
      options_(&options),
      frames_(&frames),
      advance_(std::move(advance)),
      report_(&report),
      states_(messages.states),
      measure_(report) {}

ReplayDifference SessionReplay::difference(const char* kind, const std::string& text) const {
  ReplayDifference difference;
  difference.kind = kind;
  difference.session = messages_->session;
  difference.step = session_ ? session_->steps() : 0;
  difference.text = text;
  return difference;
}

void SessionReplay::run() {
  ++report_->sessions;
  if (!rebuild())
    return;
  plan();
  frames_->begin(options_->measure ? &measure_ : nullptr);
  if (start_.checkpoint != nullptr)
    restore();
  if (options_->measure)
    measure_.beginSession(*session_, report_->sessions - 1);
  for (std::size_t n = start_.journal; n < messages_->journals.size(); ++n)
    replayJournal(messages_->journals[n]);
  leaveStep();
  report_->not_checked += planned_.size() - next_planned_;
}

void SessionReplay::plan() {
  addPlanned(Kind::kFrame, messages_->render_stats);
  if (options_->check) {
    addPlanned(Kind::kTopology, messages_->topologies);
    addPlanned(Kind::kState, messages_->states);
    addPlanned(Kind::kCheckpoint, messages_->checkpoints);
  }
  std::stable_sort(planned_.begin(), planned_.end(),
                   [](const Planned& a, const Planned& b) { return a.step < b.step; });
}

void SessionReplay::addPlanned(Kind kind, const std::vector<BagMessage>& messages) {
  const BagMessage* previous = nullptr;
  for (const BagMessage& message : messages) {
    // A topology names the first step that uses it; it was published in the step before.
    const std::uint64_t step = kind == Kind::kTopology && message.step > 0 ? message.step - 1 : message.step;
    planned_.push_back({step, kind, &message, previous});
    previous = &message;
  }
}

void SessionReplay::checkVersion(const Scene& scene) const {
  if (majorMinor(scene.package_version) != majorMinor(SOFT_VOLUME_VERSION)) {
    throw ReplayError("the bag was recorded by soft_volume " + scene.package_version + ", this is " +
                      SOFT_VOLUME_VERSION + ": replay it with a version " + majorMinor(scene.package_version) + ".x");
  }
}

/// The texts and numbers that identify what was simulated. False when nothing can be rebuilt from them.
bool SessionReplay::checkTexts(const Scene& scene) {
  for (const auto* list : {&messages_->scenes, &messages_->volumes}) {
    const std::vector<std::uint8_t> first = contents_->bytes(*list->front().instance);
    for (const BagMessage& other : *list) {
      const std::vector<std::uint8_t> bytes = contents_->bytes(*other.instance);
      // Bytes 0 to 3 are header.seq, which each connection counts for itself.
      const bool same = bytes.size() == first.size() && std::equal(bytes.begin() + 4, bytes.end(), first.begin() + 4);
      if (!same)
        report_->add(difference("scene", "the bag holds two different scenes or volumes of one session"));
    }
  }
  if (hashText(scene.yaml) == scene.scene_hash)
    return true;
  report_->add(difference("scene", "the recorded scene does not have its recorded hash"));
  return false;
}

bool SessionReplay::rebuild() {
  if (messages_->scenes.empty() || messages_->volumes.empty()) {
    throw ReplayError("the bag holds no " + std::string(messages_->scenes.empty() ? "scene" : "volume") + " of " +
                      nameOf(*messages_) + "; record the latched topics 'scene' and 'volume' too");
  }
  const auto scene = contents_->read<Scene>(*messages_->scenes.front().instance);
  checkVersion(scene);
  if (!checkTexts(scene))
    return false;
  VolumeAndLabels volumes;
  try {
    volumes = fromMessage(contents_->read<Volume>(*messages_->volumes.front().instance));
  } catch (const core::InputError& error) {
    report_->add(difference("volume", error.what()));
    return false;
  }
  const core::Scene settings = core::parseScene(scene.yaml, "the bag's scene", ".");
  session_ =
      std::make_unique<core::Session>(settings, volumes.volume, volumes.labels, messages_->session, options_->threads);
  journal_ = std::make_unique<Journal>(*session_);

  const Scene again = sceneMessage(*session_);
  if (scene.volume_hash != again.volume_hash) {
    report_->add(difference("volume", "the recorded volume is not the one that the scene names"));
  }
  if (scene.label_hash != again.label_hash) {
    report_->add(difference("volume", "the recorded labels are not those that the scene names"));
  }
  if (scene.scene_hash != again.scene_hash) {
    report_->add(difference("scene", "the scene is not the same when it is read and written again"));
  }
  return true;
}

void SessionReplay::restore() {
  const auto message = contents_->read<SimulationCheckpoint>(*start_.checkpoint->instance);
  const core::Verdict verdict = session_->apply(fromMessage(message));
  if (!verdict.applied) {
    throw ReplayError("the checkpoint of step " + std::to_string(message.step) +
                      " cannot be restored: " + verdict.reason);
  }
  report_->notes.push_back("the start of " + nameOf(*messages_) +
                           " is not in the bag: the replay begins at the checkpoint of step " +
                           std::to_string(message.step));
  if (session_->simulation().stateHash() != message.state_hash) {
    report_->add(difference("checkpoint", "the state of the checkpoint does not have its recorded hash"));
  }
}

void SessionReplay::checkRange(const BagMessage& message, const SimulationJournal& journal) {
  const bool first = &message == &messages_->journals[start_.journal];
  if (!first && journal.first_step != journaled_step_) {
    throw ReplayError(nameOf(*messages_) + ": the journal has a gap: steps " + std::to_string(journaled_step_) +
                      " to " + std::to_string(journal.first_step) +
                      " are missing, so the replay ends there; record without drops");
  }
  if (journal.last_step < journal.first_step || journal.step != journal.last_step) {
    throw ReplayError(nameOf(*messages_) + ": the journal message of step " + std::to_string(journal.step) +
                      " contradicts itself");
  }
  journaled_step_ = journal.last_step;
}

void SessionReplay::replayJournal(const BagMessage& message) {
  const auto journal = contents_->read<SimulationJournal>(*message.instance);
  checkRange(message, journal);
  for (const JournalEntry& entry : journal.entries) {
    // A checkpoint is taken before the inputs of its step are applied.
    if (start_.checkpoint != nullptr && entry.step < start_.checkpoint->step)
      continue;
    const bool in_range = entry.step >= journal.first_step && entry.step <= journal.last_step;
    if (!in_range) {
      report_->add(difference("journal", "entry " + std::to_string(entry.order) + " names step " +
                                             std::to_string(entry.step) + ", outside its message"));
    }
    // A session that continues from a checkpoint takes its step from there.
    const bool restores = !entered_ && isRestore(entry);
    if (in_range && !restores)
      advanceTo(entry.step);
    applyEntry(entry);
    visit();
  }
  advanceTo(journal.last_step);
  if (!options_->check)
    return;
  ++report_->journals;
  if (options_->measure)
    return;
  if (journal.state_hash != session_->simulation().stateHash()) {
    report_->add(difference("journal", "the state does not have the hash that the journal states"));
  }
  if (journal.revision != session_->lattice().revision) {
    report_->add(difference("journal", "the journal states another topology revision"));
  }
}

void SessionReplay::applyEntry(const JournalEntry& entry) {
  const std::string name =
      "entry " + std::to_string(entry.order) + " (" + entry.topic + " " + std::to_string(entry.sequence) + ")";
  ++report_->inputs;
  if (options_->check) {
    if (core::hashVector(entry.payload) != entry.hash) {
      report_->add(difference("journal", name + ": the payload does not have its recorded hash"));
    } else {
      checkInput(entry);
    }
  }
  try {
    checkVerdict(entry, journal_->reapply(entry));
  } catch (const core::InputError& error) {
    report_->add(difference("journal", name + ": " + error.what()));
  }
  journal_->take();
}

void SessionReplay::checkInput(const JournalEntry& entry) {
  const bool from_tool =
      entry.topic == topics::kToolForce || entry.topic == topics::kToolCut || entry.topic == topics::kToolGrip;
  if (!from_tool)
    return;
  const std::string name = entry.topic + " " + std::to_string(entry.sequence);
  switch (contents_->inputs().match(entry)) {
    case RecordedInputs::Match::kSame:
      break;
    case RecordedInputs::Match::kDiffers:
      report_->add(difference("input", name + ": the recorded message is not the one that the journal applied"));
      break;
    case RecordedInputs::Match::kMissing:
      if (!recorderMissed(entry.topic)) {
        report_->add(difference("input", name + ": the journal applied a message that is not in the bag, although "
                                                "earlier and later ones are"));
        break;
      }
      [[fallthrough]];
    case RecordedInputs::Match::kOutOfRange:
      ++report_->inputs_not_recorded;
      unrecorded_.push_back(entry);
      unrecorded_.back().step = session_->steps();
      break;
  }
}

/// A tool that was killed, or a network that was out, takes along what was on its way to the recorder; it noticed that.
bool SessionReplay::recorderMissed(const std::string& topic) const {
  const std::vector<RecorderEvent>& events = contents_->events();
  return std::any_of(events.begin(), events.end(), [&topic](const RecorderEvent& event) {
    const bool missed = event.kind == RecorderEvent::LOST || event.kind == RecorderEvent::CONNECTION;
    return missed && std::any_of(event.topics.begin(), event.topics.end(), [&topic](const std::string& name) {
             return name == topic || (name.size() > topic.size() && name.compare(name.size() - topic.size() - 1,
                                                                                 std::string::npos, "/" + topic) == 0);
           });
  });
}

void SessionReplay::checkVerdict(const JournalEntry& recorded, const JournalEntry& again) {
  report_->inputs_refused += again.outcome == JournalEntry::REFUSED ? 1 : 0;
  if (!options_->check)
    return;
  if (!next_order_)
    next_order_ = start_.checkpoint != nullptr ? recorded.order : 0;
  std::string text;
  if (recorded.order != *next_order_)
    text = "its place is not the one after the entry before it";
  if (recorded.sequence != again.sequence || recorded.type != again.type || recorded.step != again.step) {
    text = "its step, type or sequence is not that of its payload";
  }
  if (recorded.outcome != again.outcome || recorded.reason != again.reason) {
    const auto told = [](const JournalEntry& entry) {
      return entry.outcome == JournalEntry::REFUSED ? "refused (" + entry.reason + ")" : std::string("applied");
    };
    text = "it was " + told(recorded) + " in the run and is " + told(again) + " now";
  }
  next_order_ = recorded.order + 1;
  if (!text.empty()) {
    report_->add(difference("journal", "entry " + std::to_string(recorded.order) + " (" + recorded.topic + " " +
                                           std::to_string(recorded.sequence) + "): " + text));
  }
}

void SessionReplay::advanceTo(std::uint64_t step) {
  if (!entered_)
    enterStep();
  while (session_->steps() < step) {
    leaveStep();
    session_->step();
    ++report_->steps;
    advance_(1.0);
    enterStep();
  }
}

void SessionReplay::enterStep() {
  entered_ = true;
  const std::uint64_t step = session_->steps();
  for (; next_planned_ < planned_.size() && planned_[next_planned_].step <= step; ++next_planned_) {
    if (planned_[next_planned_].step < step) {
      skip(planned_[next_planned_]);
    } else {
      open_.push_back(open(planned_[next_planned_]));
    }
  }
  visit();
}

/// What was recorded before the replay begins. Later states and topologies refer to it.
void SessionReplay::skip(const Planned& planned) {
  ++report_->not_checked;
  if (options_->measure && planned.kind == Kind::kState)
    measure_.decode(contents_->read<GridState>(*planned.message->instance));
  if (options_->measure && planned.kind == Kind::kTopology)
    openTopology(*planned.message);
}

void SessionReplay::visit() {
  if (!entered_)
    return;
  states_.visit(*session_);
  for (auto check = open_.begin(); check != open_.end();) {
    check->last = check->compare();
    if (check->last) {
      ++check;
    } else {
      if (check->counter != nullptr)
        ++*check->counter;
      check = open_.erase(check);
    }
  }
}

void SessionReplay::leaveStep() {
  for (Open& check : open_) {
    if (check.counter != nullptr)
      ++*check.counter;
    if (check.otherwise) {
      check.otherwise();
    } else if (options_->check) {
      report_->add(std::move(*check.last));
    }
  }
  open_.clear();
}

SessionReplay::Open SessionReplay::open(const Planned& planned) {
  const BagMessage* message = planned.message;
  switch (planned.kind) {
    case Kind::kTopology:
      return openTopology(*message);
    case Kind::kState:
      return openState(*message, planned.previous);
    case Kind::kCheckpoint:
      if (options_->measure)
        return {[] { return std::nullopt; }, &report_->checkpoints, {}, {}};
      return {[this, message] { return compareCheckpoint(*message); }, &report_->checkpoints, {}, {}};
    case Kind::kFrame:
      break;
  }
  return openFrame(*message);
}

/// Drawing takes long and uses an image up, so it happens once.
SessionReplay::Open SessionReplay::openFrame(const BagMessage& message) {
  auto drawn = std::make_shared<std::optional<Outcome>>();
  Open open{[this, &message, drawn] {
              if (*drawn)
                return **drawn;
              const Outcome outcome = compareFrame(message);
              if (message.revision == session_->lattice().revision)
                *drawn = outcome;
              return outcome;
            },
            nullptr,
            {},
            {}};
  if (options_->measure) {
    open.otherwise = [this, &message] {
      measure_.leaveOutFrame(contents_->read<RenderStats>(*message.instance), "of another revision than the replay's");
    };
  }
  return open;
}

SessionReplay::Open SessionReplay::openState(const BagMessage& message, const BagMessage* previous) {
  auto state = std::make_shared<GridState>(contents_->read<GridState>(*message.instance));
  if (options_->measure)
    return openMeasuredState(state);
  return {[this, state, previous] { return states_.compare(*session_, *state, previous); }, &report_->states, {}, {}};
}

/// Measured where the step shows the recorded revision, else at its end.
SessionReplay::Open SessionReplay::openMeasuredState(const std::shared_ptr<const GridState>& state) {
  const auto positions = measure_.decode(*state);
  const auto topology = recorded_topologies_.topology();
  const auto measure = [this, state, positions, topology] {
    if (positions) {
      measure_.compareState(*session_, *state, *positions, topology);
    } else {
      ++report_->not_checked;
    }
  };
  const Outcome other_revision = difference("state", "it has another revision");
  return {[this, state, measure, other_revision]() -> Outcome {
            if (state->revision != session_->lattice().revision)
              return other_revision;
            measure();
            return std::nullopt;
          },
          &report_->states,
          {},
          measure};
}

/// A delta is compared as the whole grid that it leads to.
SessionReplay::Open SessionReplay::openTopology(const BagMessage& message) {
  auto recorded = std::make_shared<GridTopology>(contents_->read<GridTopology>(*message.instance));
  try {
    const auto result = takeMessage(*recorded, recorded_topologies_);
    if (recorded->delta && result != core::TopologyDecoder::Result::kApplied)
      return {[] { return std::nullopt; }, &report_->not_checked, {}, {}};
  } catch (const core::InputError& error) {
    const ReplayDifference bad = difference("topology", error.what());
    return {[bad] { return bad; }, &report_->topologies, {}, {}};
  }
  if (options_->measure)
    return {[] { return std::nullopt; }, &report_->topologies, {}, {}};
  std::shared_ptr<const GridTopology> delta;
  if (recorded->delta) {
    delta = std::make_shared<GridTopology>(*recorded);
    *recorded = toMessage(*recorded_topologies_.topology(), delta->step);
    recorded->header = delta->header;
  }
  return {[this, recorded, delta] { return compareTopology(*recorded, delta.get()); }, &report_->topologies, {}, {}};
}

SessionReplay::Outcome SessionReplay::compareTopology(const GridTopology& recorded, const GridTopology* delta) const {
  GridTopology rebuilt = topologyMessage(*session_);
  rebuilt.header = recorded.header;
  if (serialized(recorded) != serialized(rebuilt)) {
    return difference("topology", "revision " + std::to_string(recorded.revision) +
                                      ": the recorded topology differs in " + differentField(recorded, rebuilt));
  }
  // Not all that a delta says is needed for the grid that it leads to.
  if (delta == nullptr)
    return std::nullopt;
  rebuilt = toMessage(session_->topologyChange(), delta->step);
  rebuilt.header = delta->header;
  if (rebuilt.base_revision != delta->base_revision || serialized(*delta) == serialized(rebuilt))
    return std::nullopt;
  return difference("topology", "revision " + std::to_string(delta->revision) + ": the recorded change differs in " +
                                    differentField(*delta, rebuilt));
}

SessionReplay::Outcome SessionReplay::compareCheckpoint(const BagMessage& message) const {
  const auto recorded = contents_->read<SimulationCheckpoint>(*message.instance);
  SimulationCheckpoint rebuilt = toMessage(*session_, session_->checkpoint());
  rebuilt.header = recorded.header;
  if (serialized(recorded) == serialized(rebuilt))
    return std::nullopt;
  return difference("checkpoint", "the recorded checkpoint differs in " + differentField(recorded, rebuilt));
}

SessionReplay::Outcome SessionReplay::compareFrame(const BagMessage& message) {
  if (message.revision != session_->lattice().revision) {
    return difference("frame", "it shows revision " + std::to_string(message.revision) + ", the rebuilt grid has " +
                                   std::to_string(session_->lattice().revision));
  }
  Outcome outcome = frames_->check(*session_, contents_->read<RenderStats>(*message.instance));
  advance_(kFrameWork);
  return outcome;
}

}  // namespace soft_volume
