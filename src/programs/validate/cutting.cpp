#include "cutting.h"

namespace soft_volume::core::validate {

std::vector<Case> cuttingCases(const Options& options) {
  struct Item {
    const char* name;
    double seconds;
    double quick_seconds;
    std::function<void(const Options&, Report&)> run;
  };
  const auto randomUnder = [](CutLoad load, bool lips_press) {
    return [=](const Options& given, Report& report) { randomCuts(load, lips_press, given, report); };
  };
  std::vector<Item> items = {{"random cuts at rest", 60, 3, randomUnder(CutLoad::kNone, false)},
                             {"random cuts, compressed", 60, 3, randomUnder(CutLoad::kCompressed, false)},
                             {"random cuts, sheared", 60, 3, randomUnder(CutLoad::kSheared, false)},
                             {"random cuts, lips press, compressed", 40, 2, randomUnder(CutLoad::kCompressed, true)},
                             {"random cuts, lips press, sheared", 40, 2, randomUnder(CutLoad::kSheared, true)},
                             {"slices", 10, 1, slicesOfCuts},
                             {"lips under load", 4, 1, lipsUnderLoad},
                             {"bar cut in two", 4, 1, barCutInTwo},
                             {"end of a cut", 4, 1, endOfACut},
                             {"stable step", 10, 2, stepOfCutTissue}};
  // How long something takes is no matter for tests, which run beside others.
  if (!options.quick)
    items.push_back({"cost", 20, 0, costOfCuts});
  std::vector<Case> cases;
  for (const Item& item : items) {
    const auto run = item.run;
    cases.push_back({item.name, options.quick ? item.quick_seconds : item.seconds,
                     [run, options](Report& report) { run(options, report); }});
  }
  return cases;
}

}  // namespace soft_volume::core::validate
