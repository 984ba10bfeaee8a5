#pragma once

#include <map>
#include <string>
#include <vector>

#include "soft_volume/replay/compared_quantity.h"

namespace soft_volume {

/// How far two runs may be apart: a limit for each quantity that is judged, by the keys of toleranceHelp(). What has no
/// limit is told and not judged. Empty: everything has to be the same, bit for bit.
struct Tolerance {
  std::map<std::string, double> limits;
  bool empty() const { return limits.empty(); }
};

/// `KEY=LIMIT,...`, or the path of a YAML file with a map of keys and limits. Throws ReplayError for a key that does
/// not exist, a limit that is out of range, and a file that cannot be read.
Tolerance parseTolerance(const std::string& text);

/// The keys with their meaning and units, for a program's help.
std::string toleranceHelp();

/// What became of one limit, or of one quantity where there are none.
struct Judgement {
  std::string key;
  std::string subject;    ///< tool, topic or camera; empty for the whole run
  double measured = 0.0;  ///< in the limit's unit
  double limit = 0.0;
  bool within = false;
  std::string text;  ///< in words, with unit and time
};

/// One for every limit and subject, in the order of the keys; `spacing_m` is the edge of a cell. A limit for something
/// that was not compared is not kept. Ends that are apart (duration) fail without a limit, too. Without limits, one for
/// everything that is not the same.
std::vector<Judgement> judge(const std::vector<ComparedQuantity>& quantities, double spacing_m,
                             const Tolerance& tolerance);

/// The limits of what a replay measures when it applies a journal again: forces are its inputs, wall times and the
/// solver's statistics are not compared.
Tolerance measurableInReplay(const Tolerance& tolerance);

bool allWithin(const std::vector<Judgement>& judgements);

}  // namespace soft_volume
