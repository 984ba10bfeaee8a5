#include "soft_volume/replay/tolerance.h"

#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <set>
#include <sstream>

#include "soft_volume/replay/replay_bag.h"

namespace soft_volume {
namespace {

/// What a limit is measured in.
enum class Unit {
  kOwn,       ///< of the quantity
  kSpacing,   ///< edges of a cell
  kRelative,  ///< the quantity's largest value in either run
};

struct Limit {
  const char* key;
  const char* quantity;
  bool rms;  ///< of all differences, else the largest
  Unit unit;
  double most;  ///< that makes sense as a limit
  const char* meaning;
};

constexpr double kAny = 1e9;
constexpr std::array<Limit, 14> kLimits{{
    {"positions", "positions", false, Unit::kSpacing, kAny, "farthest material point, in edges of a cell"},
    {"positions_rms", "positions", true, Unit::kSpacing, kAny, "the same as RMS over points that moved"},
    {"force", "force", false, Unit::kOwn, kAny, "force of a tool on the tissue, largest difference [N]"},
    {"force_rms", "force", true, Unit::kOwn, kAny, "the same as RMS over the messages [N]"},
    {"device_force", "device_force", false, Unit::kOwn, kAny, "force sent to a device, largest difference [N]"},
    {"device_force_rms", "device_force", true, Unit::kOwn, kAny, "the same as RMS over the messages [N]"},
    {"image_rmse", "image_rmse", false, Unit::kOwn, 255.0, "RMSE of the worst frame [8-bit levels]"},
    {"ssim", "ssim", false, Unit::kOwn, 1.0, "structural similarity of the worst frame, at least"},
    {"energy", "energy", false, Unit::kRelative, kAny, "kinetic and elastic energy, part of its largest value"},
    {"cut_area", "cut_area", false, Unit::kRelative, kAny, "area that blades opened, part of its largest value"},
    {"parts", "parts", false, Unit::kOwn, kAny, "number of parts of the tissue"},
    {"revision", "revision", false, Unit::kOwn, kAny, "number of cuts so far"},
    {"active_cells", "active_cells", false, Unit::kRelative, kAny, "cells in the solve, part of the largest number"},
    {"duration", "duration", false, Unit::kOwn, kAny, "time at the ends that only one run holds [s]; 0.1 if not given"},
}};

bool isSimilarity(const Limit& limit) {
  return std::string(limit.key) == "ssim";
}

const Limit& limitNamed(const std::string& key) {
  const auto limit = std::find_if(kLimits.begin(), kLimits.end(), [&key](const Limit& l) { return l.key == key; });
  if (limit != kLimits.end())
    return *limit;
  std::string keys;
  for (const Limit& known : kLimits)
    keys += (keys.empty() ? "" : ", ") + std::string(known.key);
  throw ReplayError("tolerance: there is no limit '" + key + "'; use " + keys);
}

void setLimit(const std::string& key, const std::string& text, Tolerance& tolerance) {
  const Limit& limit = limitNamed(key);
  char* end = nullptr;
  const double value = std::strtod(text.c_str(), &end);
  if (text.empty() || *end != '\0' || !(value >= 0.0 && value <= limit.most)) {
    std::ostringstream most;
    most << limit.most;
    throw ReplayError("tolerance: " + key + " must be a number from 0 to " + most.str() + ", not '" + text + "'");
  }
  if (!tolerance.limits.emplace(key, value).second)
    throw ReplayError("tolerance: " + key + " is given twice");
}

Tolerance readFile(const std::string& path) {
  Tolerance tolerance;
  try {
    const YAML::Node file = YAML::LoadFile(path);
    if (!file.IsMap() || file.size() == 0)
      throw ReplayError(path + ": tolerances are a map, a line `KEY: LIMIT` each");
    for (const auto& entry : file) {
      if (!entry.second.IsScalar())
        throw ReplayError(path + ": " + entry.first.as<std::string>() + " must be a number");
      setLimit(entry.first.as<std::string>(), entry.second.Scalar(), tolerance);
    }
  } catch (const YAML::Exception& error) {
    throw ReplayError(path + ": the tolerances cannot be read: " + error.what());
  }
  return tolerance;
}

double measured(const ComparedQuantity& quantity, const Limit& limit, double spacing_m) {
  const double value = limit.rms ? quantity.rms : quantity.largest;
  if (limit.unit == Unit::kSpacing)
    return value / spacing_m;
  if (limit.unit == Unit::kRelative)
    return quantity.scale > 0.0 ? value / quantity.scale : 0.0;
  return value;
}

std::string nameOf(const ComparedQuantity& quantity) {
  return quantity.key + (quantity.subject.empty() ? "" : " " + quantity.subject);
}

std::string inWords(const Judgement& judgement, const ComparedQuantity& quantity, const Limit& limit) {
  const char* unit = limit.unit == Unit::kSpacing    ? " h"
                     : limit.unit == Unit::kRelative ? " of the largest"
                     : quantity.unit.empty()         ? ""
                                                     : " ";
  char text[256];
  std::snprintf(text, sizeof(text), "%s is %.4g%s%s%s (%s %.4g)", nameOf(quantity).c_str(), judgement.measured, unit,
                limit.unit == Unit::kOwn ? quantity.unit.c_str() : "", limit.rms ? " RMS" : "",
                isSimilarity(limit) ? "at least" : "at most", judgement.limit);
  std::string words = text;
  if (!limit.rms && !quantity.samples.empty()) {
    std::snprintf(text, sizeof(text), ", worst at %.3f s", quantity.largest_at_s);
    words += text;
  }
  return words;
}

Judgement judgeOne(const ComparedQuantity& quantity, const Limit& limit, double value, double spacing_m) {
  Judgement judgement;
  judgement.key = limit.key;
  judgement.subject = quantity.subject;
  judgement.limit = value;
  judgement.measured = measured(quantity, limit, spacing_m);
  judgement.within = isSimilarity(limit) ? judgement.measured >= value : judgement.measured <= value;
  judgement.text = inWords(judgement, quantity, limit);
  return judgement;
}

/// What is not the same, where everything has to be.
std::vector<Judgement> judgeIdentity(const std::vector<ComparedQuantity>& quantities) {
  std::vector<Judgement> judgements;
  for (const ComparedQuantity& quantity : quantities) {
    if (quantity.identical || !quantity.reproducible)
      continue;
    Judgement judgement;
    judgement.key = quantity.key;
    judgement.subject = quantity.subject;
    judgement.measured = quantity.largest;
    char text[256];
    std::snprintf(text, sizeof(text), "%s %.4g %s at %.3f s", quantity.key == "ssim" ? "as low as" : "differs by up to",
                  quantity.largest, quantity.unit.c_str(), quantity.largest_at_s);
    judgement.text = nameOf(quantity) + ": " + (quantity.compared > 0 ? text : "nothing could be compared");
    if (quantity.left_out > 0)
      judgement.text += "; " + std::to_string(quantity.left_out) + " left out: " + quantity.left_out_reason;
    judgements.push_back(std::move(judgement));
  }
  return judgements;
}

/// A limit for something of which nothing could be compared.
Judgement judgeNothing(const std::string& key, const std::string& subject, double value, const std::string& reason) {
  Judgement missing;
  missing.key = key;
  missing.subject = subject;
  missing.limit = value;
  missing.text = key + (subject.empty() ? "" : " " + subject) + " has a limit, but there is nothing to compare" +
                 (reason.empty() ? "" : ": all is left out, " + reason);
  return missing;
}

/// Runs that ended elsewhere are within no limit of each other unless one allows that.
void judgeDuration(const std::vector<ComparedQuantity>& quantities, std::vector<Judgement>& judgements) {
  for (const ComparedQuantity& quantity : quantities) {
    if (quantity.key == "duration" && !quantity.identical)
      judgements.push_back(judgeOne(quantity, limitNamed("duration"), kSameDuration_s, 1.0));
  }
}

}  // namespace

Tolerance parseTolerance(const std::string& text) {
  std::error_code error;
  if (text.find('=') == std::string::npos || std::filesystem::is_regular_file(text, error))
    return readFile(text);
  Tolerance tolerance;
  std::istringstream limits(text + ",");
  for (std::string limit; std::getline(limits, limit, ',');) {
    const std::size_t equals = limit.find('=');
    if (equals == std::string::npos)
      throw ReplayError("tolerance: '" + limit + "' must be KEY=LIMIT");
    setLimit(limit.substr(0, equals), limit.substr(equals + 1), tolerance);
  }
  return tolerance;
}

std::string toleranceHelp() {
  std::string help = "Limits of --tolerance (what has none is told, not judged):\n";
  for (const Limit& limit : kLimits) {
    char line[160];
    std::snprintf(line, sizeof(line), "  %-17s %s\n", limit.key, limit.meaning);
    help += line;
  }
  return help + "\n";
}

std::vector<Judgement> judge(const std::vector<ComparedQuantity>& quantities, double spacing_m,
                             const Tolerance& tolerance) {
  if (tolerance.empty())
    return judgeIdentity(quantities);
  std::vector<Judgement> judgements;
  for (const auto& [key, value] : tolerance.limits) {
    const Limit& limit = limitNamed(key);
    const std::size_t before = judgements.size();
    for (const ComparedQuantity& quantity : quantities) {
      if (quantity.key != limit.quantity)
        continue;
      judgements.push_back(quantity.compared > 0
                               ? judgeOne(quantity, limit, value, spacing_m)
                               : judgeNothing(key, quantity.subject, value, quantity.left_out_reason));
    }
    if (judgements.size() == before)
      judgements.push_back(judgeNothing(key, "", value, ""));
  }
  if (tolerance.limits.count("duration") == 0)
    judgeDuration(quantities, judgements);
  return judgements;
}

Tolerance measurableInReplay(const Tolerance& tolerance) {
  const std::set<std::string> measured = {"positions", "image_rmse", "ssim", "cut_area", "parts", "revision"};
  Tolerance measurable;
  for (const auto& limit : tolerance.limits) {
    if (measured.count(limitNamed(limit.first).quantity) != 0)
      measurable.limits.insert(limit);
  }
  return measurable;
}

bool allWithin(const std::vector<Judgement>& judgements) {
  return std::all_of(judgements.begin(), judgements.end(), [](const Judgement& j) { return j.within; });
}

}  // namespace soft_volume
