#include "soft_volume/replay/replay_bag.h"

#include <algorithm>
#include <chrono>
#include <nlohmann/json.hpp>
#include <utility>

#include "bag_contents.h"
#include "frame_replay.h"
#include "quantity_json.h"
#include "session_replay.h"

namespace soft_volume {
namespace {

constexpr std::size_t kMostDifferences = 20;
constexpr std::size_t kMostEvents = 50;

struct PlannedSession {
  const SessionMessages* messages;
  ReplayStart start;
  double work() const {
    const std::uint64_t begin =
        start.checkpoint != nullptr ? start.checkpoint->step : messages->journals[start.journal].first_step;
    const std::uint64_t end = messages->journals.back().step;
    return static_cast<double>(end > begin ? end - begin : 0) +
           SessionReplay::kFrameWork * static_cast<double>(messages->render_stats.size());
  }
};

/// The sessions that can be replayed, in the order of the bag.
std::vector<PlannedSession> planSessions(BagContents& contents, ReplayReport& report) {
  std::vector<PlannedSession> planned;
  for (const SessionMessages& messages : contents.sessions()) {
    if (messages.scenes.empty() && messages.volumes.empty()) {
      ReplayDifference difference;
      difference.kind = "session";
      difference.session = messages.session;
      difference.text = "the bag holds messages of a session without its scene and volume";
      report.add(std::move(difference));
    } else if (const auto start = findStart(contents, messages)) {
      planned.push_back({&messages, *start});
    } else {
      ++report.sessions_skipped;
      report.notes.push_back("session " + std::to_string(messages.session) +
                             " was not replayed: the bag holds neither its start nor a checkpoint with the journal "
                             "that follows");
    }
  }
  return planned;
}

/// What the recorder saw happen, as far as it explains what the bag lacks.
void noteEvents(const std::vector<RecorderEvent>& events, ReplayReport& report) {
  std::size_t told = 0;
  for (const RecorderEvent& event : events) {
    if (++told <= kMostEvents)
      report.notes.push_back("recorder, step " + std::to_string(event.step) + ": " + event.text);
  }
  if (told > kMostEvents)
    report.notes.push_back("recorder: " + std::to_string(told - kMostEvents) + " more events");
}

/// Inputs that seemed to be sent while nothing was recorded, but whose messages are there with another tool or number.
void checkAltered(const RecordedInputs& inputs, const std::vector<JournalEntry>& entries, std::uint64_t session,
                  ReplayReport& report) {
  for (const JournalEntry& entry : entries) {
    if (!inputs.wasAltered(entry))
      continue;
    ReplayDifference difference;
    difference.kind = "input";
    difference.session = session;
    difference.step = entry.step;
    difference.text = entry.topic + " " + std::to_string(entry.sequence) +
                      ": the recorded message is not the one that the journal applied";
    report.add(std::move(difference));
  }
}

}  // namespace

void ReplayReport::add(ReplayDifference difference) {
  ++differences;
  const auto later = std::find_if(first_differences.begin(), first_differences.end(), [&](const auto& other) {
    return other.session == difference.session && other.step > difference.step;
  });
  first_differences.insert(later, std::move(difference));
  if (first_differences.size() > kMostDifferences)
    first_differences.pop_back();
}

void replayBag(const std::string& path, const ReplayOptions& options, const ReplayProgress& progress,
               ReplayReport& report) {
  const auto begin = std::chrono::steady_clock::now();
  BagContents contents(path);
  noteEvents(contents.events(), report);
  const std::vector<PlannedSession> planned = planSessions(contents, report);
  if (planned.empty()) {
    throw ReplayError(path +
                      ": the bag holds neither the start of a run nor a checkpoint to start from; start the "
                      "recorder before the simulation, or record until the next checkpoint");
  }
  double total = 0.0;
  for (const PlannedSession& session : planned)
    total += session.work();
  double done = 0.0;
  const auto advance = [&](double work) { progress(done += work, total); };

  FrameReplay frames(contents, options, report);
  std::vector<std::pair<std::uint64_t, std::vector<JournalEntry>>> unrecorded;
  for (const PlannedSession& session : planned) {
    SessionReplay replay(contents, *session.messages, session.start, options, frames, advance, report);
    replay.run();
    unrecorded.emplace_back(session.messages->session, replay.unrecordedInputs());
  }
  for (const auto& entry : unrecorded) {
    checkAltered(contents.inputs(), entry.second, entry.first, report);
  }
  if (options.check) {
    report.inputs_not_journaled = contents.inputs().unmatched();
    report.images_without_stats = static_cast<std::uint64_t>(
        std::count_if(contents.images().begin(), contents.images().end(), [](const BagImage& i) { return !i.used; }));
  }
  report.wall_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

namespace {

/// What was measured is the same all the same.
bool allSame(const std::vector<ComparedQuantity>& measured) {
  return std::all_of(measured.begin(), measured.end(), [](const ComparedQuantity& q) { return q.identical; });
}

nlohmann::json differenceJson(const ReplayDifference& difference) {
  nlohmann::json json = {
      {"kind", difference.kind}, {"session", difference.session}, {"step", difference.step}, {"text", difference.text}};
  if (difference.vertex)
    json["vertex"] = *difference.vertex;
  if (difference.size_m)
    json["size_m"] = *difference.size_m;
  if (!difference.camera.empty())
    json["camera"] = difference.camera;
  if (difference.pixel_x)
    json["pixel"] = {*difference.pixel_x, *difference.pixel_y};
  if (difference.size)
    json["size"] = *difference.size;
  return json;
}

}  // namespace

std::string toJson(const ReplayReport& report, const std::string& error) {
  nlohmann::json differences = nlohmann::json::array();
  for (const ReplayDifference& difference : report.first_differences)
    differences.push_back(differenceJson(difference));
  nlohmann::json measured = nlohmann::json::array();
  for (const ComparedQuantity& quantity : report.measured)
    measured.push_back(quantityJson(quantity));
  nlohmann::json json = {{"identical", error.empty() && report.identical() && allSame(report.measured)},
                         {"error", error},
                         {"first_difference", differences.empty() ? nlohmann::json() : differences.front()},
                         {"first_differences", differences},
                         {"differences", report.differences},
                         {"sessions", report.sessions},
                         {"sessions_skipped", report.sessions_skipped},
                         {"steps", report.steps},
                         {"inputs", report.inputs},
                         {"inputs_refused", report.inputs_refused},
                         {"inputs_not_recorded", report.inputs_not_recorded},
                         {"inputs_not_journaled", report.inputs_not_journaled},
                         {"journals", report.journals},
                         {"states", report.states},
                         {"topologies", report.topologies},
                         {"checkpoints", report.checkpoints},
                         {"frames", report.frames},
                         {"frames_by_psnr", report.frames_by_psnr},
                         {"frames_without_image", report.frames_without_image},
                         {"images_without_stats", report.images_without_stats},
                         {"not_checked", report.not_checked},
                         {"lowest_psnr_db", report.lowest_psnr_db},
                         {"measured", measured},
                         {"spacing_m", report.spacing_m},
                         {"wall_s", report.wall_s},
                         {"notes", report.notes}};
  return json.dump(2, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";
}

}  // namespace soft_volume
