#include "soft_volume/replay/comparison.h"

#include <geometry_msgs/WrenchStamped.h>
#include <soft_volume/ToolForce.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <utility>

#include "grid_pair.h"
#include "quantity_json.h"
#include "soft_volume/messages/journal.h"
#include "soft_volume/messages/topics.h"
#include "soft_volume/replay/state_renderer.h"

namespace soft_volume {
namespace {

constexpr double kSameTime_s = 1e-6;
constexpr double kSameFrame_s = 1e-3;
constexpr double kDrawnApart_s = 5e-3;
/// Frames take longest to compare; for the progress only.
constexpr double kFrameWork = 4.0;

ComparedQuantity quantity(const char* key, const std::string& subject, const std::string& title, const char* unit,
                          std::size_t run) {
  ComparedQuantity made;
  made.key = key;
  made.subject = subject;
  made.title = title;
  made.unit = unit;
  made.run = run;
  return made;
}

/// A vector as a function of time that holds between its values.
class HeldVector {
 public:
  void set(double time_s, const core::Vector3& value) {
    if (!values_.empty() && values_.back().first >= time_s) {
      values_.back().second = value;
    } else {
      values_.emplace_back(time_s, value);
    }
  }
  core::Vector3 at(double time_s) const {
    const auto after = std::upper_bound(values_.begin(), values_.end(), time_s + kSameTime_s,
                                        [](double time, const auto& value) { return time < value.first; });
    return after == values_.begin() ? core::Vector3::Zero() : std::prev(after)->second;
  }
  const std::vector<std::pair<double, core::Vector3>>& values() const { return values_; }
  bool empty() const { return values_.empty(); }

 private:
  std::vector<std::pair<double, core::Vector3>> values_;
};

using Vectors = std::map<std::string, HeldVector>;

bool holdsImages(const RecordedRun& run) {
  for (std::size_t n = 0; n < run.frames().size(); ++n) {
    if (run.hasImage(n))
      return true;
  }
  return false;
}

/// The run whose frames are gone through: the first one, unless only the second one shows anything.
const RecordedRun& shownBy(const RecordedRun& first, const RecordedRun& second) {
  return !holdsImages(first) && holdsImages(second) ? second : first;
}

/// What each tool pressed on the tissue, as far as the journal applied it, by the times of the poses that the forces
/// were computed from. `shift_s` is added to all times.
Vectors toolForces(const RecordedRun& run, double shift_s) {
  struct Held {
    HeldVector force;
    double expires_s = INFINITY;
  };
  std::map<std::string, Held> tools;
  const auto expire = [](Held& held, double time_s) {
    if (held.expires_s < time_s)
      held.force.set(held.expires_s, core::Vector3::Zero());
  };
  for (const RecordedEntry& recorded : run.entries()) {
    const JournalEntry& entry = recorded.entry;
    if (entry.topic != topics::kToolForce || entry.outcome != JournalEntry::APPLIED)
      continue;
    const auto message = fromPayload<ToolForce>(entry.payload);
    // Who publishes by hand may leave the stamp out: then the step that applied it tells when.
    const bool stamped = !message.header.stamp.isZero();
    const double time_s = (stamped ? run.timeOf(message.header.stamp) : run.timeOfStep(entry.step)) + shift_s;
    Held& held = tools[message.tool_id];
    expire(held, time_s);
    held.force.set(time_s, fromVector(message.force));
    held.expires_s = time_s + run.timeOfStep(entry.step + message.hold_steps) - run.timeOfStep(entry.step);
  }
  Vectors forces;
  for (auto& [tool, held] : tools) {
    expire(held, INFINITY);
    forces[tool] = std::move(held.force);
  }
  return forces;
}

Vectors deviceForces(const RecordedRun& run, double shift_s) {
  Vectors forces;
  for (const auto& recorded : run.messages<geometry_msgs::WrenchStamped>()) {
    const double time_s = run.timeOf(recorded.message.header.stamp) + shift_s;
    forces[recorded.topic].set(time_s, fromVector(recorded.message.wrench.force));
  }
  return forces;
}

/// What has to be added to times of the second run to get those of the first. Where their stamps overlap, both heard
/// the same devices and these tell; else both began when simulated time did.
double shiftBetween(const RecordedRun& first, const RecordedRun& second) {
  const double begin_s = first.timeOf(second.stampAt(second.states().front().time_s));
  const double end_s = first.timeOf(second.stampAt(second.states().back().time_s));
  const bool overlap = begin_s < first.states().back().time_s && end_s > first.states().front().time_s;
  const double shift_s = begin_s - second.states().front().time_s;
  return overlap && std::abs(shift_s) > kSameTime_s ? shift_s : 0.0;
}

/// The scene's values by their paths: "lattice.spacing.0".
void flatten(const YAML::Node& node, const std::string& path, std::map<std::string, std::string>& values) {
  const std::string dot = path.empty() ? "" : ".";
  if (node.IsMap()) {
    for (const auto& child : node)
      flatten(child.second, path + dot + child.first.as<std::string>(), values);
  } else if (node.IsSequence()) {
    for (std::size_t n = 0; n < node.size(); ++n)
      flatten(node[n], path + dot + std::to_string(n), values);
  } else {
    values[path] = node.IsScalar() ? node.Scalar() : "none";
  }
}

std::vector<std::string> sceneChanges(const std::string& first, const std::string& second) {
  std::map<std::string, std::string> a;
  std::map<std::string, std::string> b;
  flatten(YAML::Load(first), "", a);
  flatten(YAML::Load(second), "", b);
  std::set<std::string> paths;
  for (const auto* values : {&a, &b}) {
    for (const auto& value : *values)
      paths.insert(value.first);
  }
  std::vector<std::string> changes;
  const auto told = [](const auto& values, const std::string& path) {
    const auto value = values.find(path);
    return value == values.end() ? std::string("(none)") : value->second;
  };
  for (const std::string& path : paths) {
    if (told(a, path) != told(b, path))
      changes.push_back(path + ": " + told(a, path) + " -> " + told(b, path));
  }
  return changes;
}

/// Compares one session of two bags.
class RunComparison {
 public:
  RunComparison(const RecordedRun& first, const RecordedRun& second, std::size_t run, const ComparisonOptions& options,
                Comparison& comparison, std::function<void(double)> advance)
      : first_(first),
        second_(second),
        run_(run),
        options_(options),
        comparison_(comparison),
        advance_(std::move(advance)),
        shift_s_(shiftBetween(first, second)) {}

  void compare() {
    if (shift_s_ != 0.0)
      note("simulated time began " + std::to_string(std::abs(shift_s_)) + " s " +
           (shift_s_ > 0.0 ? "later" : "earlier") + " in the second run; times are those of stamps");
    compareScenes();
    compareEnds();
    compareGrids();
    compareVectors("force", "force of the tool on the tissue", toolForces(first_, 0.0), toolForces(second_, shift_s_));
    compareVectors("device_force", "force sent to the device", deviceForces(first_, 0.0),
                   deviceForces(second_, shift_s_));
    compareFrames();
    compareStats();
  }

 private:
  /// A time of the first run in the second one: a mean of two states, or one state.
  struct Moment {
    std::size_t before = 0;
    std::size_t after = 0;
    double weight = 0.0;  ///< of `after`
  };

  void note(const std::string& text) {
    if (std::find(comparison_.notes.begin(), comparison_.notes.end(), text) == comparison_.notes.end())
      comparison_.notes.push_back(text);
  }
  void keep(ComparedQuantity quantity) {
    if (!quantity.samples.empty() || quantity.left_out > 0)
      comparison_.quantities.push_back(std::move(quantity));
  }

  void compareScenes() {
    const Scene a = first_.sceneMessage();
    const Scene b = second_.sceneMessage();
    if (a.volume_hash != b.volume_hash)
      throw ReplayError("the bags show other volumes: there is nothing to compare");
    comparison_.scene_changes = sceneChanges(a.yaml, b.yaml);
    if (a.package_version != b.package_version)
      note("the first was recorded by soft_volume " + a.package_version + ", the second by " + b.package_version);
    if (a.kernel != b.kernel || a.precision != b.precision)
      note("the first was computed with kernel " + a.kernel + " (" + a.precision + "), the second with " + b.kernel +
           " (" + b.precision + ")");
  }

  /// Whether both hold the same time: what only one of them did is compared nowhere else. A run that began later with a
  /// state of its own beginning lacks nothing.
  void compareEnds() {
    const auto& a = first_.states();
    const auto& b = second_.states();
    const double begin_s = b.front().time_s + shift_s_;
    const double end_s = b.back().time_s + shift_s_;
    const double later_began_s = begin_s > a.front().time_s ? b.front().time_s : a.front().time_s;
    const double at_begin_s = std::min(std::abs(begin_s - a.front().time_s), later_began_s);
    const double at_end_s = std::abs(end_s - a.back().time_s);
    ComparedQuantity ends = quantity("duration", "", "simulated time that only one run holds", "s", run_);
    ends.addValues(std::max(begin_s, a.front().time_s), a.front().time_s, begin_s, at_begin_s);
    ends.addValues(std::min(end_s, a.back().time_s), a.back().time_s, end_s, at_end_s);
    ends.identical = ends.largest <= kSameDuration_s;
    if (at_begin_s > kSameDuration_s)
      tellEnd(begin_s > a.front().time_s, "begins", at_begin_s, "later");
    if (at_end_s > kSameDuration_s)
      tellEnd(end_s < a.back().time_s, "ends", at_end_s, "earlier");
    keep(std::move(ends));
  }

  void tellEnd(bool of_second, const char* what, double apart_s, const char* when) {
    char text[160];
    std::snprintf(text, sizeof(text), "the %s run %s %.3f s %s than the other: that time is not compared",
                  of_second ? "second" : "first", what, apart_s, when);
    note(text);
  }

  std::shared_ptr<const core::Topology> uncut(const RecordedRun& run) const {
    const std::vector<std::uint32_t> revisions = run.revisions();
    return revisions.empty() ? nullptr : run.topology(revisions.front());
  }

  /// False where the second run has no state near a time of the first.
  bool findMoment(double first_time_s, Moment& moment) const {
    const double time_s = first_time_s - shift_s_;
    const auto& states = second_.states();
    const auto after = std::lower_bound(states.begin(), states.end(), time_s - kSameTime_s,
                                        [](const RecordedState& s, double time) { return s.time_s < time; });
    if (after == states.end())
      return false;
    moment.after = moment.before = static_cast<std::size_t>(after - states.begin());
    if (std::abs(after->time_s - time_s) <= kSameTime_s)
      return true;
    if (after == states.begin() || std::prev(after)->revision != after->revision)
      return false;
    --moment.before;
    moment.weight = (time_s - states[moment.before].time_s) / (after->time_s - states[moment.before].time_s);
    return true;
  }

  std::vector<core::Vector3f> positionsAt(const Moment& moment) const {
    std::vector<core::Vector3f> positions = second_.positions(moment.after);
    if (moment.before == moment.after)
      return positions;
    const std::vector<core::Vector3f> before = second_.positions(moment.before);
    const auto weight = static_cast<float>(moment.weight);
    for (std::size_t v = 0; v < positions.size(); ++v)
      positions[v] = before[v] + weight * (positions[v] - before[v]);
    return positions;
  }

  void compareGrids() {
    const auto first_uncut = uncut(first_);
    const auto second_uncut = uncut(second_);
    if (!first_uncut || !second_uncut) {
      note("no positions are compared: a bag holds no grid/topology");
      return;
    }
    const double h_m = std::max(core::Vector3(cellEdges(*first_uncut)).minCoeff(), cellEdges(*second_uncut).minCoeff());
    comparison_.spacing_m = std::max(comparison_.spacing_m, h_m);
    ComparedQuantity positions = quantity("positions", "", "places of material points", "m", run_);
    ComparedQuantity areas = quantity("cut_area", "", "area of the cuts, at rest", "m^2", run_);
    ComparedQuantity parts = quantity("parts", "", "parts of the tissue", "", run_);
    ComparedQuantity revisions = quantity("revision", "", "revisions of the topology", "", run_);
    std::unique_ptr<GridPair> pair;
    std::uint64_t without_time = 0;
    for (std::size_t n = 0; n < first_.states().size(); ++n, advance_(1.0)) {
      const RecordedState& state = first_.states()[n];
      Moment moment;
      const bool known = first_.hasPositions(n) && findMoment(state.time_s, moment) &&
                         second_.hasPositions(moment.before) && second_.hasPositions(moment.after);
      const RecordedState* other = known ? &second_.states()[moment.after] : nullptr;
      const auto a = known ? first_.topology(state.revision) : nullptr;
      const auto b = known ? second_.topology(other->revision) : nullptr;
      if (!a || !b) {
        ++without_time;
        continue;
      }
      if (!pair || !pair->isOf(a, b)) {
        pair = std::make_unique<GridPair>(a, b, first_uncut, second_uncut);
        areas_ = {cutArea(*a), cutArea(*b)};
        parts_ = {static_cast<double>(partCount(*a)), static_cast<double>(partCount(*b))};
      }
      const auto first_positions = first_.positions(n);
      const auto second_positions = positionsAt(moment);
      if (first_positions.size() != a->vertexCount() || second_positions.size() != b->vertexCount())
        throw ReplayError("the bag is damaged: a state has another number of vertices than its topology");
      pair->compare(state.time_s, first_positions, second_positions, kMovedPart * h_m, positions);
      interpolated_ += moment.before != moment.after ? 1 : 0;
      areas.addValues(state.time_s, areas_.first, areas_.second, std::abs(areas_.first - areas_.second));
      parts.addValues(state.time_s, parts_.first, parts_.second, std::abs(parts_.first - parts_.second));
      const double revision = state.revision;
      revisions.addValues(state.time_s, revision, other->revision, std::abs(revision - other->revision));
    }
    tellGrids(pair.get(), positions, without_time);
    for (ComparedQuantity* made : {&positions, &areas, &parts, &revisions})
      keep(std::move(*made));
  }

  void tellGrids(const GridPair* pair, ComparedQuantity& positions, std::uint64_t without_time) {
    if (pair == nullptr)
      throw ReplayError("the bags have no simulated time in common: there is nothing to compare");
    if (positions.left_out > 0) {
      positions.left_out_reason = pair->sameLattice()
                                      ? "in cells that only one of the runs has cut, or cut otherwise, or new by a cut"
                                      : "in cells that are cut, or outside of the other grid";
    }
    if (!pair->sameLattice())
      note("the lattices differ: vertices of the coarser one are looked up in the cells of the finer one");
    if (interpolated_ > 0)
      note(std::to_string(interpolated_) + " of " + std::to_string(first_.states().size()) +
           " states of the second run lie between two recorded ones (linear)");
    if (without_time > 0)
      note(std::to_string(without_time) + " of " + std::to_string(first_.states().size()) +
           " states of the first run have no counterpart in the second");
    positions.identical = positions.identical && interpolated_ == 0 && positions.left_out == 0;
  }

  /// Names of both, in pairs; a single one on each side belongs together whatever it is called.
  static std::vector<std::pair<std::string, std::string>> pairNames(const Vectors& first, const Vectors& second) {
    if (first.size() == 1 && second.size() == 1)
      return {{first.begin()->first, second.begin()->first}};
    std::vector<std::pair<std::string, std::string>> names;
    for (const auto& entry : first) {
      if (second.count(entry.first) != 0)
        names.emplace_back(entry.first, entry.first);
    }
    return names;
  }

  void compareVectors(const char* key, const char* title, const Vectors& first, const Vectors& second) {
    const auto names = pairNames(first, second);
    if (names.size() < std::max(first.size(), second.size())) {
      note(std::string(key) + ": " + std::to_string(first.size()) + " in the first bag, " +
           std::to_string(second.size()) + " in the second, " + std::to_string(names.size()) + " compared");
    }
    for (const auto& name : names) {
      ComparedQuantity made = quantity(key, name.first, title, "N", run_);
      const HeldVector& a = first.at(name.first);
      const HeldVector& b = second.at(name.second);
      std::set<double> times;
      for (const HeldVector* values : {&a, &b}) {
        for (const auto& value : values->values())
          times.insert(value.first);
      }
      const double end_s = std::min(first_.states().back().time_s, second_.states().back().time_s + shift_s_);
      double last_s = -INFINITY;
      for (const double time_s : times) {
        if (time_s < 0.0 || time_s > end_s || time_s <= last_s + kSameTime_s)
          continue;
        last_s = time_s;
        const core::Vector3 in_first = a.at(time_s);
        const core::Vector3 in_second = b.at(time_s);
        made.addValues(time_s, in_first.norm(), in_second.norm(), (in_first - in_second).norm());
      }
      keep(std::move(made));
    }
  }

  /// The frame of the second run that shows what a frame of the first shows, or none.
  std::size_t counterpart(const RecordedFrame& frame, std::vector<bool>& used) const {
    std::size_t best = second_.frames().size();
    double best_apart_s = kSameFrame_s;
    for (std::size_t n = 0; n < second_.frames().size(); ++n) {
      const RecordedFrame& other = second_.frames()[n];
      const double apart_s = std::abs(other.time_s + shift_s_ - frame.time_s);
      if (!used[n] && second_.hasImage(n) && other.stats.camera == frame.stats.camera &&
          other.stats.coarseness == frame.stats.coarseness && apart_s < best_apart_s) {
        best = n;
        best_apart_s = apart_s;
      }
    }
    if (best < used.size())
      used[best] = true;
    return best;
  }

  using Cameras = std::map<std::string, std::pair<ComparedQuantity, ComparedQuantity>>;

  void compareFrames() {
    Cameras cameras;
    if (holdsImages(first_) && holdsImages(second_))
      compareRecordedFrames(cameras);
    else if (holdsImages(first_) || holdsImages(second_))
      compareDrawnFrames(cameras);
    else
      note("no pictures are compared: neither bag holds any");
    for (auto& camera : cameras) {
      keep(std::move(camera.second.first));
      keep(std::move(camera.second.second));
    }
  }

  std::pair<ComparedQuantity, ComparedQuantity>& ofCamera(Cameras& cameras, const std::string& camera) const {
    return cameras
        .try_emplace(camera, quantity("image_rmse", camera, "frames, RMSE", "levels", run_),
                     quantity("ssim", camera, "frames, structural similarity", "", run_))
        .first->second;
  }

  void compareRecordedFrames(Cameras& cameras) {
    std::vector<bool> used(second_.frames().size(), false);
    for (std::size_t n = 0; n < first_.frames().size(); ++n, advance_(kFrameWork)) {
      if (!first_.hasImage(n))
        continue;
      const RecordedFrame& frame = first_.frames()[n];
      auto& made = ofCamera(cameras, frame.stats.camera);
      const std::size_t other = counterpart(frame, used);
      if (other < second_.frames().size())
        compareImages(first_.image(n), second_.image(other), frame.time_s, made);
      else
        leaveOut(made, "without a frame of the same camera and time in the second bag");
    }
  }

  /// Frames of the only run that holds images against the other one's states.
  void compareDrawnFrames(Cameras& cameras) {
    const RecordedRun& shown = shownBy(first_, second_);
    const double to_first_s = &shown == &first_ ? 0.0 : shift_s_;
    const auto every = drawnEvery(shown);
    std::map<std::string, std::size_t> seen;
    for (std::size_t n = 0; n < shown.frames().size(); ++n, advance_(kFrameWork)) {
      if (!shown.hasImage(n))
        continue;
      const RecordedFrame& frame = shown.frames()[n];
      const std::string& camera = frame.stats.camera;
      const bool wanted = every.at(camera) > 0 && seen[camera]++ % every.at(camera) == 0;
      const auto drawn = wanted ? drawOther(shown, frame) : std::nullopt;
      if (drawn)
        compareImages(shown.image(n), *drawn, frame.time_s + to_first_s, ofCamera(cameras, camera));
      else
        leaveOut(ofCamera(cameras, camera), "that the other bag does not hold and that were not drawn");
    }
    tellDrawn(&shown == &first_ ? "second" : "first");
  }

  /// Every so many of a camera's frames are drawn, so that all cameras have an equal share; 0: none.
  std::map<std::string, std::size_t> drawnEvery(const RecordedRun& shown) const {
    std::map<std::string, std::size_t> frames;
    for (std::size_t n = 0; n < shown.frames().size(); ++n)
      frames[shown.frames()[n].stats.camera] += shown.hasImage(n) ? 1 : 0;
    const std::size_t most = options_.most_drawn_frames;
    const std::size_t share = std::max<std::size_t>(1, most / frames.size());
    for (auto& camera : frames)
      camera.second = most == 0 ? 0 : std::max<std::size_t>(1, (camera.second + share - 1) / share);
    return frames;
  }

  void tellDrawn(const char* run) {
    char text[160];
    if (drawn_frames_ > 0)
      std::snprintf(text, sizeof(text),
                    "the %s bag holds no images: %zu were drawn from its states, up to %.2g ms beside the frame's time",
                    run, drawn_frames_, 1e3 * drawn_apart_s_);
    else
      std::snprintf(text, sizeof(text), "no frames are compared: the %s bag holds no images", run);
    note(text);
  }

  /// What a frame of one run would show of the other one, from its nearest state.
  std::optional<core::Image> drawOther(const RecordedRun& shown, const RecordedFrame& frame) {
    const bool of_first = &shown == &first_;
    const auto& states = (of_first ? second_ : first_).states();
    const double time_s = frame.time_s + (of_first ? -shift_s_ : shift_s_);
    const auto nearest = std::min_element(states.begin(), states.end(), [time_s](const auto& a, const auto& b) {
      return std::abs(a.time_s - time_s) < std::abs(b.time_s - time_s);
    });
    const double apart_s = std::abs(nearest->time_s - time_s);
    if (apart_s > kDrawnApart_s)
      return std::nullopt;
    if (!first_renderer_) {
      first_renderer_ = std::make_unique<StateRenderer>(first_, options_.threads);
      second_renderer_ = std::make_unique<StateRenderer>(second_, options_.threads);
    }
    const StateRenderer& as = of_first ? *first_renderer_ : *second_renderer_;
    StateRenderer& renderer = of_first ? *second_renderer_ : *first_renderer_;
    const auto camera = as.cameraOf(frame);
    const auto state = static_cast<std::size_t>(nearest - states.begin());
    if (!camera || !renderer.canDraw(state))
      return std::nullopt;
    ++drawn_frames_;
    drawn_apart_s_ = std::max(drawn_apart_s_, apart_s);
    return renderer.draw(state, as.settingsOf(frame), frame.stats.settings, *camera, frame.stats.coarseness);
  }

  static void leaveOut(std::pair<ComparedQuantity, ComparedQuantity>& made, const char* reason) {
    for (ComparedQuantity* one : {&made.first, &made.second}) {
      ++one->left_out;
      one->left_out_reason = reason;
      one->identical = false;
    }
  }

  static void compareImages(const core::Image& a, const core::Image& b, double time_s,
                            std::pair<ComparedQuantity, ComparedQuantity>& made) {
    if (a.width != b.width || a.height != b.height) {
      leaveOut(made, "of another size");
      return;
    }
    const core::ImageDifference apart = core::compareImages(a, b);
    const auto pixels = static_cast<std::uint64_t>(a.rgb.size());
    made.first.add({time_s, 0.0, 0.0, apart.rmse, apart.rmse}, 1,
                   {apart.rmse * apart.rmse * static_cast<double>(pixels), pixels});
    made.second.addIndex(time_s, apart.ssim);
  }

  using Member = double (*)(const SimulationStats&);

  void compareStats() {
    if (first_.stats().empty() || second_.stats().empty()) {
      note("energies and step times are not compared: a bag holds no simulation/stats of this version");
      return;
    }
    compareStat(quantity("energy", "elastic", "elastic energy", "J", run_),
                [](const SimulationStats& s) { return s.elastic_energy; });
    compareStat(quantity("energy", "kinetic", "kinetic energy", "J", run_),
                [](const SimulationStats& s) { return s.kinetic_energy; });
    compareStat(quantity("active_cells", "", "cells in the solve", "", run_),
                [](const SimulationStats& s) { return static_cast<double>(s.active_cells); });
    ComparedQuantity step_time = quantity("step_time", "", "wall time of a step, median", "ms", run_);
    step_time.reproducible = false;
    compareStat(std::move(step_time), [](const SimulationStats& s) { return s.step_ms_median; });
  }

  /// Statistics come by wall time, at any step: between those of the second run they are interpolated, and only what
  /// both tell of one step decides whether they are identical. Without such a step nothing does.
  void compareStat(ComparedQuantity made, Member member) {
    bool identical = true;
    std::size_t same_steps = 0;
    const auto& others = second_.stats();
    for (const SimulationStats& stats : first_.stats()) {
      const double time_s = stats.simulation_time - shift_s_;
      const auto after = std::lower_bound(others.begin(), others.end(), time_s - kSameTime_s,
                                          [](const auto& s, double time) { return s.simulation_time < time; });
      if (after == others.end() || (after == others.begin() && after->simulation_time > time_s + kSameTime_s))
        continue;
      double value = member(*after);
      if (std::abs(after->simulation_time - time_s) > kSameTime_s) {
        const auto before = std::prev(after);
        const double weight = (time_s - before->simulation_time) / (after->simulation_time - before->simulation_time);
        value = member(*before) + weight * (value - member(*before));
      } else {
        ++same_steps;
        identical = identical && member(stats) == value;
      }
      made.addValues(stats.simulation_time, member(stats), value, std::abs(member(stats) - value));
    }
    made.reproducible = made.reproducible && same_steps > 0;
    made.identical = same_steps > 0 ? identical : made.largest == 0.0;
    keep(std::move(made));
  }

  const RecordedRun& first_;
  const RecordedRun& second_;
  std::size_t run_;
  const ComparisonOptions& options_;
  Comparison& comparison_;
  std::function<void(double)> advance_;
  double shift_s_;
  std::pair<double, double> areas_;
  std::pair<double, double> parts_;
  std::uint64_t interpolated_ = 0;
  std::unique_ptr<StateRenderer> first_renderer_;
  std::unique_ptr<StateRenderer> second_renderer_;
  std::size_t drawn_frames_ = 0;
  double drawn_apart_s_ = 0.0;
};

using Runs = std::vector<const RecordedRun*>;

Runs runsWithStates(const RecordedBag& bag) {
  Runs runs;
  for (std::size_t n = 0; n < bag.size(); ++n) {
    if (!bag.run(n).states().empty())
      runs.push_back(&bag.run(n));
  }
  if (runs.empty())
    throw ReplayError(bag.path() + ": the bag holds no states: there is nothing to compare");
  return runs;
}

/// The sessions in their order. A bag with a single one, as a resimulation writes it, is held against the longest one
/// of the other.
void pairRuns(const RecordedBag& first, const RecordedBag& second, Runs& first_runs, Runs& second_runs,
              Comparison& comparison) {
  const std::size_t in_first = first_runs.size();
  const std::size_t in_second = second_runs.size();
  if (in_first == in_second)
    return;
  const bool one = std::min(in_first, in_second) == 1;
  if (one) {
    first_runs = {&first.longest()};
    second_runs = {&second.longest()};
  }
  const std::size_t count = std::min(first_runs.size(), second_runs.size());
  first_runs.resize(count);
  second_runs.resize(count);
  comparison.notes.push_back("the first bag holds " + std::to_string(in_first) + " sessions, the second " +
                             std::to_string(in_second) + ": only the " +
                             (one ? std::string("longest") : "first " + std::to_string(count)) + " compared");
}

}  // namespace

bool Comparison::identical() const {
  const bool complete = std::any_of(quantities.begin(), quantities.end(), [](const auto& q) { return q.compared > 0; });
  return complete && std::all_of(quantities.begin(), quantities.end(), [](const ComparedQuantity& quantity) {
           return quantity.identical || !quantity.reproducible;
         });
}

Comparison compareBags(const RecordedBag& first, const RecordedBag& second, const ReplayProgress& progress,
                       const ComparisonOptions& options) {
  Comparison comparison;
  comparison.first = first.path();
  comparison.second = second.path();
  Runs first_runs = runsWithStates(first);
  Runs second_runs = runsWithStates(second);
  pairRuns(first, second, first_runs, second_runs, comparison);
  const std::size_t count = first_runs.size();
  double total = 0.0;
  for (std::size_t n = 0; n < count; ++n)
    total += static_cast<double>(first_runs[n]->states().size()) +
             kFrameWork * static_cast<double>(shownBy(*first_runs[n], *second_runs[n]).frames().size());
  double done = 0.0;
  for (std::size_t n = 0; n < count; ++n) {
    RunComparison(*first_runs[n], *second_runs[n], n, options, comparison, [&](double work) {
      progress(done += work, total);
    }).compare();
  }
  for (const RecordedBag* bag : {&first, &second}) {
    for (const std::string& note : bag->notes()) {
      const std::string text = bag->path() + ": " + note;
      if (std::find(comparison.notes.begin(), comparison.notes.end(), text) == comparison.notes.end())
        comparison.notes.push_back(text);
    }
  }
  return comparison;
}

std::string toJson(const Comparison& comparison) {
  nlohmann::json quantities = nlohmann::json::array();
  for (const ComparedQuantity& quantity : comparison.quantities)
    quantities.push_back(quantityJson(quantity));
  const nlohmann::json json = {
      {"first", comparison.first},         {"second", comparison.second}, {"identical", comparison.identical()},
      {"spacing_m", comparison.spacing_m}, {"quantities", quantities},    {"scene_changes", comparison.scene_changes},
      {"notes", comparison.notes}};
  return json.dump(2, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";
}

}  // namespace soft_volume
