#include "extremes.h"

namespace soft_volume::core::validate {

std::vector<Case> extremesCases(const Options& options) {
  struct Item {
    const char* name;
    double seconds;
    double quick_seconds;
    void (*run)(const Options&, Report&);
  };
  constexpr Item kItems[] = {{"1 full limit moves", 1, 0.3, fullLimitMoves},
                             {"2 huge tool forces", 60, 3, hugeToolForces},
                             {"3 neighbours and noise", 30, 3, neighboursAndNoise},
                             {"4 long steps", 30, 5, longSteps},
                             {"5 masses and stiffness", 20, 3, unequalMassAndStiffness},
                             {"6 tool speeds", 20, 3, toolSpeeds},
                             {"7 huge deformations", 30, 3, hugeDeformations},
                             {"8 conservation", 20, 3, conservation},
                             {"9 precision and origin", 3, 1, precisionAndOrigin},
                             {"10 freezing and thawing", 20, 3, freezingAndThawing},
                             {"11 refused inputs", 1, 1, refusedInputs}};
  std::vector<Case> cases;
  for (const Item& item : kItems) {
    const auto run = item.run;
    cases.push_back({item.name, options.quick ? item.quick_seconds : item.seconds,
                     [run, options](Report& report) { run(options, report); }});
  }
  return cases;
}

}  // namespace soft_volume::core::validate
