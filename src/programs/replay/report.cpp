// --report: a page that says what was compared and found, with plots and pictures, in one file.

#include <soft_volume/RecorderEvent.h>
#include <soft_volume/RecordingInfo.h>
#include <soft_volume/ToolState.h>
#include <stdlib.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <map>
#include <utility>

#include "findings.h"
#include "report_curves.h"
#include "report_frames.h"
#include "report_page.h"
#include "soft_volume/common/error.h"
#include "soft_volume/replay/state_renderer.h"

namespace soft_volume::replay_program {
namespace {

constexpr int kJpegQuality = 92;

/// For gnuplot's and libpng's files, which are read back.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string name = (std::filesystem::temp_directory_path() / "soft_volume_report_XXXXXX").string();
    if (mkdtemp(name.data()) == nullptr)
      throw core::FileError(name + ": the folder cannot be made; set TMPDIR to one that is writable");
    path_ = name;
  }
  ~TemporaryFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  const std::string& path() const { return path_; }

 private:
  std::string path_;
};

std::string fileNameOf(const std::string& path) {
  return std::filesystem::path(path).filename().string();
}

std::string code(const std::string& text) {
  return "<code>" + escaped(text) + "</code>";
}

std::string hash(std::uint64_t value) {
  char text[24];
  std::snprintf(text, sizeof text, "%016llx", static_cast<unsigned long long>(value));
  return value == 0 ? "none" : code(text);
}

std::string title(const Arguments& a) {
  const std::string bag = fileNameOf(a.bag);
  if (a.resimulate)
    return bag + ", simulated again";
  if (!a.against.empty())
    return bag + " against " + fileNameOf(a.against);
  return a.check ? bag + ", replayed" : bag;
}

// ----------------------------------------------------------------------------------------------------- the verdict

std::string counted(std::uint64_t number, const char* one, const char* many) {
  return count(number) + " " + (number == 1 ? one : many);
}

std::string whatWasChecked(const ReplayReport& r) {
  std::string text = "Computed again: " + counted(r.steps, "step", "steps") + " of " +
                     counted(r.sessions, "session", "sessions") + " with " + counted(r.inputs, "input", "inputs") +
                     " (" + count(r.inputs_refused) +
                     " refused). Compared bit for bit: " + counted(r.states, "state", "states") + ", " +
                     counted(r.journals, "hash of the journal", "hashes of the journal") + ", " +
                     counted(r.topologies, "topology", "topologies") + ", " +
                     counted(r.checkpoints, "checkpoint", "checkpoints") + "; " + counted(r.frames, "frame", "frames");
  return text + (r.frames_by_psnr > 0 ? ", " + count(r.frames_by_psnr) + " of them by PSNR." : ".");
}

std::string textOf(const ReplayDifference& d) {
  return "step " + count(d.step) + ", " + d.kind + ": " + d.text;
}

const ComparedQuantity* find(const Comparison& comparison, const std::string& key) {
  const auto found = std::find_if(comparison.quantities.begin(), comparison.quantities.end(),
                                  [&](const ComparedQuantity& q) { return q.key == key; });
  return found == comparison.quantities.end() ? nullptr : &*found;
}

/// How far apart two runs are, in words.
std::vector<std::string> farApart(const Comparison& c) {
  std::vector<std::string> lines;
  if (const ComparedQuantity* q = find(c, "positions")) {
    lines.push_back("The tissue lies up to " + number(1e3 * q->largest) + " mm apart (" +
                    number(q->largest / c.spacing_m) + " of a cell's edge h = " + number(1e3 * c.spacing_m) +
                    " mm), at " + number(q->largest_at_s, 4) + " s; RMS " + number(1e3 * q->rms) +
                    " mm of what moved.");
  }
  for (const ComparedQuantity& q : c.quantities) {
    if (q.key == "force")
      lines.push_back("The force of " + q.subject + " on the tissue differs by up to " + number(q.largest) + " N of " +
                      number(q.scale) + " N; RMS " + number(q.rms) + " N.");
    if (q.key == "device_force")
      lines.push_back("The force at the device (" + q.subject + ") differs by up to " + number(q.largest) + " N of " +
                      number(q.scale) + " N; RMS " + number(q.rms) + " N.");
    if (q.key == "ssim" && q.compared > 0)
      lines.push_back("Frames of " + q.subject + " have a structural similarity of " + number(q.largest, 4) +
                      " at least, " + number(q.rms, 4) + " in the mean.");
  }
  return lines;
}

std::string resimulatedWith(const Resimulation& run) {
  const double speed = run.stepping_s > 0.0 ? run.simulated_s / run.stepping_s : 0.0;
  return "Simulated again from the device's motion: " + counted(run.steps, "step", "steps") + " of " +
         number(1e3 * run.time_step_s) + " ms, " + count(run.cells) + " cells, " + number(run.step_ms_median) +
         " ms a step in the median, " + number(speed) + " simulated seconds per second.";
}

void addJudgedVerdict(const Arguments& a, const Findings& f, std::vector<std::string> lines, Page& page) {
  std::vector<std::string> beyond;
  for (const Judgement& judgement : f.judgements) {
    if (!judgement.within)
      beyond.push_back(judgement.text);
  }
  lines.insert(lines.begin(), beyond.begin(), beyond.end());
  const std::string all = counted(f.judgements.size(), "limit", "limits");
  if (beyond.empty())
    page.addVerdict(Page::Mood::kGood, "Within the limits: " + all + " held", lines);
  else if (a.tolerance.empty())
    page.addVerdict(
        Page::Mood::kBad,
        "Different: " + counted(beyond.size(), "quantity is", "quantities are") + " not the same, bit for bit", lines);
  else
    page.addVerdict(Page::Mood::kBad, "Different: " + std::to_string(beyond.size()) + " of " + all + " exceeded",
                    lines);
}

void addVerdict(const Arguments& a, const Findings& f, Page& page) {
  std::vector<std::string> lines;
  if (f.check)
    lines.push_back(whatWasChecked(*f.check));
  if (f.resimulation)
    lines.push_back(resimulatedWith(*f.resimulation));
  if (f.comparison) {
    for (const std::string& line : farApart(*f.comparison))
      lines.push_back(line);
  }
  if (!f.error.empty()) {
    lines.insert(lines.begin(), f.error);
    page.addVerdict(Page::Mood::kBad, "It could not be done", lines);
  } else if (f.check && !f.check->identical()) {
    for (std::size_t n = 0; n < std::min<std::size_t>(5, f.check->first_differences.size()); ++n)
      lines.push_back((n == 0 ? "First difference: " : "Then: ") + textOf(f.check->first_differences[n]));
    page.addVerdict(Page::Mood::kBad,
                    "Different: " + counted(f.check->differences, "difference was", "differences were") + " found",
                    lines);
  } else if (!f.judgements.empty()) {
    addJudgedVerdict(a, f, lines, page);
  } else if (f.comparison && !f.comparison->identical()) {
    page.addVerdict(Page::Mood::kPlain, "How far the result moved", lines);
  } else if (f.check || f.comparison) {
    page.addVerdict(Page::Mood::kGood, "Identical, bit for bit", lines);
  } else {
    page.addVerdict(Page::Mood::kPlain, "A recording; nothing was compared", {});
  }
}

// ------------------------------------------------------------------------------------------------ what was compared

std::string fileSize(const std::string& path) {
  std::error_code ignored;
  const std::uintmax_t bytes = std::filesystem::file_size(path, ignored);
  return ignored ? "" : number(1e-6 * double(bytes)) + " MB";
}

using Facts = std::vector<std::pair<std::string, std::string>>;

/// Names and html of what identifies a run.
Facts factsOf(const RecordedBag& bag, const RecordedRun& run) {
  const Scene scene = run.sceneMessage();
  const double end_s = run.states().empty() ? 0.0 : run.states().back().time_s;
  const std::string step = run.states().empty() ? "0" : count(run.states().back().step);
  Facts facts = {{"Bag", code(bag.path()) + " " + fileSize(bag.path())},
                 {"Sessions", std::to_string(bag.size()) + (bag.size() > 1 ? ", the longest is shown" : "")},
                 {"Session", code(std::to_string(run.session()))},
                 {"Simulated time", number(end_s, 5) + " s, to step " + step},
                 {"Scene", escaped(scene.name)},
                 {"Version", escaped(scene.package_version + ", kernel " + scene.kernel + ", " + scene.precision)},
                 {"Scene's hash", hash(scene.scene_hash)},
                 {"Volume's hash", hash(scene.volume_hash)},
                 {"Labels' hash", hash(scene.label_hash)},
                 {"Recorded", counted(run.states().size(), "state", "states") + ", " +
                                  counted(run.frames().size(), "frame", "frames") + ", " +
                                  counted(run.revisions().size(), "topology", "topologies")}};
  if (!run.frames().empty())
    facts.emplace_back("Drawn by", escaped(run.frames().front().stats.renderer));
  return facts;
}

void addRecordingInfo(const RecordedBag& bag, Facts& facts) {
  const auto infos = bag.messages<RecordingInfo>();
  if (infos.empty())
    return;
  const RecordingInfo& info = infos.front().message;
  facts.emplace_back("Recorder", escaped(info.package_version + ", ROS " + info.ros_version + ", " + info.compiler));
  facts.emplace_back("Processor", escaped(info.processor));
  for (std::size_t n = 0; n < std::min(info.files.size(), info.file_hashes.size()); ++n)
    facts.emplace_back("File", code(info.files[n]) + " " + code(info.file_hashes[n]));
}

void addFacts(const std::vector<Facts>& runs, const std::vector<ReportedRun>& names, Page& page) {
  std::vector<std::string> header = {""};
  for (std::size_t n = 0; n < runs.size(); ++n)
    header.push_back(runs.size() > 1 ? names[n].name : "");
  std::vector<Page::Row> rows;
  for (std::size_t n = 0; n < runs.front().size(); ++n) {
    const std::string& name = runs.front()[n].first;
    Page::Row row{{escaped(name), runs.front()[n].second}, ""};
    for (std::size_t other = 1; other < runs.size(); ++other) {
      const auto same =
          std::find_if(runs[other].begin(), runs[other].end(), [&](const auto& f) { return f.first == name; });
      row.cells.push_back(same == runs[other].end() ? "" : same->second);
    }
    rows.push_back(row);
  }
  page.addTable(header, rows, 9);
}

// ---------------------------------------------------------------------------------------------------------- numbers

std::string nameOf(const ComparedQuantity& q) {
  return escaped(q.title.empty() ? q.key : q.title) + (q.subject.empty() ? "" : " " + code(q.subject)) +
         (q.run > 0 ? " (session " + std::to_string(q.run + 1) + ")" : "");
}

void addQuantities(const std::vector<ComparedQuantity>& quantities, double spacing_m, Page& page) {
  std::vector<Page::Row> rows;
  for (const ComparedQuantity& q : quantities) {
    const std::string unit = q.unit.empty() ? "" : " " + escaped(q.unit == "m^2" ? "m\u00b2" : q.unit);
    const std::string left_out =
        q.left_out > 0 ? count(q.left_out) + " left out: " + escaped(q.left_out_reason) : std::string();
    const bool equal = q.identical && (q.largest == 0.0 || q.key == "ssim");
    const bool same = equal && q.left_out == 0;
    std::string remark = equal ? "bit for bit the same" : "";
    if (!q.reproducible)
      remark = "wall time: no two runs share it";
    rows.push_back(
        {{nameOf(q), remark + (remark.empty() || left_out.empty() ? "" : "; ") + left_out, number(q.rms) + unit,
          number(q.largest) + unit, q.largest > 0.0 ? number(q.largest_at_s, 4) + " s" : "",
          q.scale > 0.0 ? number(q.scale) + unit : "", count(q.compared)},
         same && q.reproducible ? "good" : ""});
    if (q.key == "positions" && spacing_m > 0.0)
      rows.push_back(
          {{"", "in cells' edges", number(q.rms / spacing_m) + " h", number(q.largest / spacing_m) + " h", "", "", ""},
           ""});
  }
  page.addTable({"Quantity", "", "RMS apart", "most apart", "at", "largest value", "compared"}, rows, 2);
}

void addJudgements(const Arguments& a, const Findings& f, Page& page) {
  if (f.judgements.empty() || a.tolerance.empty())
    return;
  page.addHeading("Against the limits");
  std::vector<Page::Row> rows;
  for (const Judgement& j : f.judgements) {
    rows.push_back(
        {{code(j.key) + " " + escaped(j.subject), escaped(j.text), number(j.measured, 4), number(j.limit, 4)},
         j.within ? "good" : "bad"});
  }
  page.addTable({"Limit", "", "measured", "allowed"}, rows, 2);
}

void addNumbers(const Arguments& a, const Findings& f, Page& page) {
  addJudgements(a, f, page);
  if (f.comparison && !f.comparison->scene_changes.empty()) {
    page.addHeading("What is different in the scene");
    page.addList(f.comparison->scene_changes);
  }
  const bool measured = f.comparison || (f.check && !f.check->measured.empty());
  if (!measured)
    return;
  page.addHeading("How far apart");
  if (f.comparison)
    addQuantities(f.comparison->quantities, f.comparison->spacing_m, page);
  else
    addQuantities(f.check->measured, f.check->spacing_m, page);
}

// ---------------------------------------------------------------------------------------------- plots and pictures

void addPlots(const std::vector<ReportedRun>& runs, const Findings& f, const std::string& folder, Page& page) {
  page.addHeading("Over time");
  std::string html = "<div class=\"plots\">\n";
  for (const std::string& svg : drawPlots(reportPlots(runs, f), folder))
    html += "<img alt=\"plot\" src=\"" + dataUri("image/svg+xml", {svg.begin(), svg.end()}) + "\">\n";
  page.addHtml(html + "</div>\n");
  if (runs.front().run->stats().empty())
    page.addText(
        "Energies, step times and active cells are missing: the bag holds no simulation/stats of this version.");
}

std::string figure(const std::string& uri, const std::string& caption) {
  return "<figure><img alt=\"picture\" src=\"" + uri + "\"><figcaption>" + caption + "</figcaption></figure>\n";
}

std::string jpegUri(const core::Image& image) {
  return dataUri("image/jpeg", core::encodeJpeg(image, kJpegQuality));
}

std::string differenceText(const core::ImageDifference& d, std::size_t pixels) {
  if (d.pixels == 0)
    return "no difference, byte for byte";
  return "difference: RMSE " + number(d.rmse) + " levels, SSIM " + number(d.ssim, 4) + ", at most " +
         std::to_string(d.largest) + " levels, " + number(100.0 * double(d.pixels) / double(pixels), 2) +
         " % of pixels";
}

/// Colours and what they mean.
std::string scaleHtml(int scale) {
  return "<br>0 <span class=\"scale\" style=\"background: " + scaleGradient() + "\"></span> " + std::to_string(scale) +
         " levels" + (scale < 255 ? " or more" : "") + " (amplified " + number(255.0 / scale) + " times)";
}

std::string differenceHtml(const FrameTriplet& t, const std::string& folder) {
  const int scale = differenceScale(t);
  const std::string path = folder + "/difference.png";
  core::writePng(path, differenceMap(t.first, t.second, scale));
  const std::string text = differenceText(*t.difference, t.first.rgb.size() / 3);
  return figure(dataUri("image/png", readBytesOf(path)), t.difference->pixels == 0 ? text : text + scaleHtml(scale));
}

std::string tripletHtml(const FrameTriplet& t, const std::string& folder) {
  const int columns = t.difference ? 3 : t.second.rgb.empty() ? 1 : 2;
  std::string html = "<p class=\"moment\">" + escaped(t.caption) +
                     "</p>\n<div class=\"frames\" style=\"grid-template-columns: repeat(" + std::to_string(columns) +
                     ", minmax(0, " + (columns == 1 ? "520px" : "1fr") + "))\">\n";
  html += figure(jpegUri(t.first), escaped(t.first_name));
  if (!t.second.rgb.empty())
    html += figure(jpegUri(t.second), escaped(t.second_name));
  if (t.difference)
    html += differenceHtml(t, folder);
  return html + "</div>\n";
}

void addTriplets(const std::vector<FrameTriplet>& triplets, const std::string& folder, Page& page) {
  page.addHeading("Frames");
  if (triplets.empty())
    page.addText("The bag holds neither frames nor states that could be drawn.");
  else if (std::any_of(triplets.begin(), triplets.end(), [](const auto& t) { return t.difference.has_value(); }))
    page.addText("Differences are those of the channel that differs most; their colours have a scale for each frame.");
  for (const FrameTriplet& triplet : triplets)
    page.addHtml(tripletHtml(triplet, folder));
}

std::string momentCaption(const RecordedFrame& frame, const std::string& what) {
  return number(frame.time_s, 5) + " s, step " + count(frame.stats.step) + ", seen by " + frame.stats.camera + ": " +
         what;
}

/// The state of the second run at a frame's time, drawn as the frame was.
core::Image otherFrame(StateRenderer& first, const RecordedFrame& frame, const ReportedRun& other,
                       StateRenderer& renderer) {
  const auto& states = other.run->states();
  std::optional<std::size_t> nearest;
  const auto distance = [&](std::size_t n) { return std::abs(other.begin_s + states[n].time_s - frame.time_s); };
  for (std::size_t n = 0; n < states.size(); ++n) {
    if ((!nearest || distance(n) < distance(*nearest)) && renderer.canDraw(n))
      nearest = n;
  }
  const auto camera = first.cameraOf(frame);
  if (!nearest || !camera)
    return {};
  return renderer.draw(*nearest, first.settingsOf(frame), frame.stats.settings, *camera, frame.stats.coarseness);
}

std::optional<double> worstTime(const Findings& f) {
  const ComparedQuantity* positions = f.comparison ? find(*f.comparison, "positions") : nullptr;
  return positions != nullptr && positions->largest > 0.0 ? std::optional<double>(positions->largest_at_s)
                                                          : std::nullopt;
}

std::vector<FrameTriplet> drawnTriplets(const std::vector<ReportedRun>& runs, const Findings& f, int threads) {
  const RecordedRun& run = *runs.front().run;
  StateRenderer first(run, threads);
  std::unique_ptr<StateRenderer> second;
  if (runs.size() > 1)
    second = std::make_unique<StateRenderer>(*runs[1].run, threads);
  std::vector<FrameTriplet> triplets;
  for (const Moment& moment : chooseMoments(run, worstTime(f))) {
    const RecordedFrame& frame = moment.frame;
    const bool has_image = moment.index && run.hasImage(*moment.index);
    FrameTriplet triplet;
    triplet.caption = momentCaption(frame, moment.caption);
    triplet.first_name = has_image ? "recorded" : "recorded state, drawn again";
    if (second != nullptr && runs[0].name != "recorded")
      triplet.first_name = runs[0].name + ", " + triplet.first_name;
    triplet.first = has_image ? run.image(*moment.index) : first.drawAgain(frame).value_or(core::Image());
    if (triplet.first.rgb.empty())
      continue;
    if (second != nullptr) {
      triplet.second_name = runs[1].name;
      triplet.second = otherFrame(first, frame, runs[1], *second);
    }
    compare(triplet);
    triplets.push_back(std::move(triplet));
  }
  return triplets;
}

// ----------------------------------------------------------------------------------------------- what else happened

std::string eventKind(std::uint8_t kind) {
  static const char* const kKinds[] = {"session", "silence", "return", "lost", "connection", "part", "end"};
  return kind < 7 ? kKinds[kind] : std::to_string(kind);
}

/// Faults and trips of tools, and refused inputs: how often each, and when first.
class Troubles {
 public:
  void add(const std::string& who, const std::string& text, double time_s) {
    Trouble& trouble = troubles_[{who, text}];
    trouble.first_s = trouble.times++ == 0 ? time_s : std::min(trouble.first_s, time_s);
  }
  void addTo(std::vector<Page::Row>& rows) const {
    for (const auto& [what, trouble] : troubles_)
      rows.push_back(
          {{escaped(what.first), escaped(what.second), number(trouble.first_s, 5) + " s", count(trouble.times)}, ""});
  }

 private:
  struct Trouble {
    double first_s = 0.0;
    std::uint64_t times = 0;
  };
  std::map<std::pair<std::string, std::string>, Trouble> troubles_;
};

void addTroubles(const std::vector<ReportedRun>& runs, Page& page) {
  std::vector<Page::Row> rows;
  for (const ReportedRun& reported : runs) {
    const RecordedRun& run = *reported.run;
    const std::string prefix = reported.name.empty() ? "" : reported.name + ": ";
    Troubles troubles;
    for (const auto& recorded : run.messages<ToolState>()) {
      const ToolState& tool = recorded.message;
      const std::string text = tool.tripped ? "tripped: " + tool.trip_reason : tool.fault;
      if (!text.empty())
        troubles.add(prefix + "tool " + tool.tool_id, text, run.timeOf(tool.header.stamp));
    }
    for (const RecordedEntry& recorded : run.entries()) {
      if (recorded.entry.outcome == JournalEntry::REFUSED)
        troubles.add(prefix + recorded.entry.topic, "refused: " + recorded.entry.reason, recorded.time_s);
    }
    troubles.addTo(rows);
  }
  if (rows.empty())
    page.addText("No tool told of a fault, and no input was refused.");
  else
    page.addTable({"Who", "Fault or refusal", "first at", "messages"}, rows, 2);
}

/// The replay notes what the recorder told, too.
bool tellsOfEvent(const std::string& note, const std::vector<const RecordedBag*>& bags) {
  return std::any_of(bags.begin(), bags.end(), [&](const RecordedBag* bag) {
    return std::any_of(bag->events().begin(), bag->events().end(), [&](const RecorderEvent& event) {
      return note.rfind("recorder, ", 0) == 0 && !event.text.empty() && note.find(event.text) != std::string::npos;
    });
  });
}

void addIncidents(const std::vector<const RecordedBag*>& bags, const std::vector<ReportedRun>& runs, const Findings& f,
                  Page& page) {
  page.addHeading("What the recording tells of itself");
  std::vector<Page::Row> rows;
  for (const RecordedBag* bag : bags) {
    for (const RecorderEvent& event : bag->events())
      rows.push_back(
          {{escaped(bags.size() > 1 ? fileNameOf(bag->path()) : ""), eventKind(event.kind), escaped(event.text),
            count(event.step), number((event.stamp - bag->events().front().stamp).toSec(), 5) + " s"},
           ""});
  }
  if (rows.empty())
    page.addText("The recorder told of no events: nothing is known of restarts, losses and silences.");
  else
    page.addTable({"", "Event", "", "at step", "noticed after"}, rows, 3);
  addTroubles(runs, page);
  std::vector<std::string> notes = f.notes;
  const auto append = [&notes](const std::vector<std::string>& more) {
    notes.insert(notes.end(), more.begin(), more.end());
  };
  if (f.check)
    append(f.check->notes);
  if (f.comparison)
    append(f.comparison->notes);
  for (const RecordedBag* bag : bags)
    append(bag->notes());
  std::vector<std::string> distinct;
  for (const std::string& note : notes) {
    if (std::find(distinct.begin(), distinct.end(), note) == distinct.end() && !tellsOfEvent(note, bags))
      distinct.push_back(note);
  }
  if (!distinct.empty())
    page.addList(distinct);
}

/// The second run's time 0 in the first one's time: by stamps where they overlap, as compareBags() does.
double beginOf(const RecordedRun& second, const RecordedRun& first) {
  if (first.states().empty() || second.states().empty())
    return 0.0;
  const double begin_s = first.timeOf(second.stampAt(0.0));
  const double end_s = begin_s + second.states().back().time_s;
  return begin_s < first.states().back().time_s && end_s > 0.0 ? begin_s : 0.0;
}

/// As its bag where two bags were given; in full where both have the same name.
std::string bagName(const std::string& path, const std::string& other) {
  return fileNameOf(path) == fileNameOf(other) ? path : fileNameOf(path);
}

std::string firstName(const Arguments& a) {
  return a.resimulate ? "recorded" : bagName(a.bag, a.against);
}

std::string secondName(const Arguments& a) {
  return a.resimulate ? "simulated again" : bagName(a.against, a.bag);
}

void addRuns(const Arguments& arguments, const Findings& findings, const std::string& folder, Page& page) {
  const RecordedBag bag(arguments.bag);
  std::unique_ptr<RecordedBag> other;
  const std::string& other_path = arguments.resimulate ? arguments.output : arguments.against;
  if (!other_path.empty() && findings.comparison)
    other = std::make_unique<RecordedBag>(other_path);

  std::vector<ReportedRun> runs = {{&bag.longest(), other ? firstName(arguments) : "", false, 0.0}};
  std::vector<const RecordedBag*> bags = {&bag};
  if (other) {
    const RecordedRun& second = other->longest();
    runs.push_back({&second, secondName(arguments), true, beginOf(second, bag.longest())});
    bags.push_back(other.get());
  }
  page.addHeading("What was compared");
  std::vector<Facts> facts;
  for (std::size_t n = 0; n < runs.size(); ++n) {
    facts.push_back(factsOf(*bags[n], *runs[n].run));
    addRecordingInfo(*bags[n], facts.back());
  }
  addFacts(facts, runs, page);
  addNumbers(arguments, findings, page);
  addPlots(runs, findings, folder, page);
  addTriplets(findings.replayed_frames.empty() || other ? drawnTriplets(runs, findings, arguments.threads)
                                                        : findings.replayed_frames,
              folder, page);
  addIncidents(bags, runs, findings, page);
}

}  // namespace

void report(const Arguments& arguments, const Findings& findings) {
  if (arguments.report.empty())
    return;
  const TemporaryFolder folder;
  Page page("Replay report: " + title(arguments));
  addVerdict(arguments, findings, page);
  if (findings.error.empty())
    addRuns(arguments, findings, folder.path(), page);
  std::ofstream file(arguments.report);
  file << page.text();
  file.close();
  if (!file)
    throw ReplayError(arguments.report + ": the report cannot be written; check that its folder is there and writable");
}

}  // namespace soft_volume::replay_program
