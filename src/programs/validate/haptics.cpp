// Haptic loops judged by the virtual device: devices, hands, dampings, delays, jitters, rates and tissues; then what
// happens when something breaks.

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <fstream>
#include <sstream>
#include <thread>

#include "haptic_rig.h"
#include "haptics_force.h"
#include "haptics_strokes.h"
#include "report.h"
#include "soft_volume/common/error.h"

namespace soft_volume::core::validate {
namespace {

constexpr std::array<const char*, 7> kDevices{"touch",       "omni",    "desktop", "premium_1_5",
                                              "premium_3_0", "omega_7", "falcon"};
constexpr std::array<Hand, 5> kHands{Hand::kStiffGrip, Hand::kLooseGrip, Hand::kTapping, Hand::kSliding,
                                     Hand::kRelease};
constexpr std::array<double, 3> kDampings{0.05, 0.2, 1.0};
constexpr std::array<int, 4> kDelays{0, 1, 2, 3};
constexpr std::array<double, 2> kJitters{1e-4, 1e-3};
constexpr std::array<double, 2> kRates{1000.0, 500.0};
constexpr std::array<double, 2> kPatchRates{250.0, 30.0};
constexpr std::array<double, 2> kFrictions{0.0, 0.3};
constexpr std::array<TissueKind, 4> kTissues{TissueKind::kMuscle, TissueKind::kBone, TissueKind::kPrestressed,
                                             TissueKind::kFat};

constexpr double kMostSurplus = 0.01;      // of the energy put in
constexpr double kMostOscillation = 0.05;  // of the mean force
constexpr double kMostGrowth_n_ms = 0.1;
constexpr double kZeroWithin_s = 0.05;
constexpr double kRounding = 1e-9;
/// Contacts that hardly happened have no meaningful share: relative to at least this.
constexpr double kLeastWork_j = 1e-4;

struct Run {
  HapticSetup setup;
  HapticResult result;
};

/// Runs all rows, each by itself in one thread; results do not depend on how many.
void runAll(std::vector<Run>& runs, int threads, bool keep_traces) {
  std::atomic<std::size_t> next{0};
  const auto work = [&] {
    for (std::size_t i = next++; i < runs.size(); i = next++) {
      runs[i].result = HapticRig(runs[i].setup).run();
      if (!keep_traces)
        runs[i].result.trace.clear();
    }
  };
  std::vector<std::thread> pool;
  for (int t = 1; t < threads; ++t)
    pool.emplace_back(work);
  work();
  for (std::thread& thread : pool)
    thread.join();
}

std::size_t place(const std::string& device) {
  return std::size_t(std::find(kDevices.begin(), kDevices.end(), device) - kDevices.begin());
}

/// Numbers without a pattern (splitmix64), so that no factor goes along with another.
std::uint64_t mixed(std::uint64_t x) {
  x += 0x9e3779b97f4a7c15U;
  x = (x ^ (x >> 30U)) * 0xbf58476d1ce4e5b9U;
  x = (x ^ (x >> 27U)) * 0x94d049bb133111ebU;
  return x ^ (x >> 31U);
}

/// Every damping with every delay; jitter, rates and tissue by lot, another one for each device and hand. `full`: all
/// products.
std::vector<HapticSetup> variants(const std::string& device, Hand hand, const Options& options) {
  std::vector<HapticSetup> setups;
  HapticSetup setup;
  setup.device = device;
  setup.hand = hand;
  if (options.quick) {
    setup.damping_n_s_m = 0.2;
    return {setup};
  }
  std::uint64_t lot = 64 * std::uint64_t(place(device)) + std::uint64_t(hand);
  for (const double damping : kDampings) {
    for (const int delay : kDelays) {
      setup.damping_n_s_m = damping;
      setup.delay_samples = delay;
      if (!options.full) {
        lot = mixed(lot);
        setup.jitter_s = kJitters[lot % 2];
        setup.rate_hz = kRates[(lot >> 8U) % 4 == 0 ? 1 : 0];
        setup.patch_rate_hz = kPatchRates[(lot >> 16U) % 2];
        setup.tissue = kTissues[(lot >> 24U) % 4];
        setup.friction = kFrictions[(lot >> 32U) % 2];
        setups.push_back(setup);
        continue;
      }
      for (const double jitter : kJitters) {
        for (const double rate : kRates) {
          for (const double patch_rate : kPatchRates) {
            for (const TissueKind tissue : kTissues) {
              setup.jitter_s = jitter;
              setup.rate_hz = rate;
              setup.patch_rate_hz = patch_rate;
              for (const double friction : kFrictions) {
                setup.tissue = tissue;
                setup.friction = friction;
                setups.push_back(setup);
              }
            }
          }
        }
      }
    }
  }
  return setups;
}

/// Of what the hand put in.
double surplusShare(const HapticResult& result) {
  return result.surplus_j / std::max(result.hand_put_in_j, kLeastWork_j);
}

double handSurplusShare(const HapticResult& result) {
  return result.hand_surplus_j / std::max(result.hand_put_in_j, kLeastWork_j);
}

/// Of what went in through the motors. A held force leaks energy that the device's own damping is there to take, so
/// this one may be above 0 in a loop that is passive for the hand.
double portSurplusShare(const HapticResult& result) {
  return result.port_surplus_j / std::max(result.put_in_j, kLeastWork_j);
}

/// The run where a number is largest.
template <typename Number>
const Run& worst(const std::vector<Run>& runs, const Number& number) {
  return *std::max_element(runs.begin(), runs.end(),
                           [&](const Run& a, const Run& b) { return number(a.result) < number(b.result); });
}

template <typename Number>
void worstRow(const std::string& name, const std::vector<Run>& runs, const Number& number, double bound,
              Report& report) {
  const Run& run = worst(runs, number);
  const double value = number(run.result);
  report.atMost(name + (value > bound ? " (" + run.setup.text() + ")" : ""), value, bound);
}

void writeTable(const std::vector<Run>& runs, const Options& options) {
  if (options.plots.empty())
    return;
  const std::filesystem::path path = options.plots / "haptics_runs.csv";
  const bool fresh = !std::filesystem::exists(path);
  std::ofstream file(path, std::ios::app);
  if (fresh) {
    file << "row;peak N;mean N;K N/m;oscillation;put in J;put out J;released J;port surplus J;hand put in J;surplus "
            "J;hand surplus J;"
            "trips;refused;over limit N;growth N/ms;zero after s;force again N\n";
  }
  for (const Run& run : runs) {
    const HapticResult& r = run.result;
    file << run.setup.text() << (run.setup.sabotage == Sabotage::kNone ? "" : ", " + nameOf(run.setup.sabotage)) << ";"
         << r.peak_force_n << ";" << r.mean_force_n << ";" << r.stiffness_n_m << ";" << r.oscillation << ";"
         << r.put_in_j << ";" << r.put_out_j << ";" << r.released_j << ";" << r.port_surplus_j << ";" << r.hand_put_in_j
         << ";" << r.surplus_j << ";" << r.hand_surplus_j << ";" << r.trips << ";" << r.refused << ";" << r.over_limit_n
         << ";" << r.growth_n_ms << ";" << r.zero_after_s << ";" << r.force_again_n << "\n";
  }
  if (!file)
    throw FileError(path.string() + ": the table cannot be written");
}

void limitsRows(const std::string& name, const std::vector<Run>& runs, Report& report) {
  worstRow(
      name + "force beyond the device's limit, N", runs, [](const HapticResult& r) { return r.over_limit_n; },
      kRounding, report);
  worstRow(
      name + "fastest growth, N/ms", runs, [](const HapticResult& r) { return r.growth_n_ms; },
      kMostGrowth_n_ms * (1.0 + 1e-6), report);
}

void energyRows(const std::string& name, const std::vector<Run>& runs, Report& report) {
  worstRow(name + "energy put out beyond what the hand put in and the tissue released", runs, surplusShare,
           kMostSurplus, report);
  worstRow(name + "energy that the hand got beyond what it put in and the tissue released", runs, handSurplusShare,
           kMostSurplus, report);
  const double port = portSurplusShare(worst(runs, portSurplusShare).result);
  report.row(name + "energy put out beyond what came in through the motors", port, 0.0, port);
}

void normalRows(const std::string& name, bool steady, const std::vector<Run>& runs, Report& report) {
  const Run& strongest = worst(runs, [](const HapticResult& r) { return r.peak_force_n; });
  report.row(name + "largest force, N", strongest.result.peak_force_n, 0.0, strongest.result.peak_force_n);
  energyRows(name, runs, report);
  if (steady)
    worstRow(
        name + "oscillation, of the mean force", runs, [](const HapticResult& r) { return r.oscillation; },
        kMostOscillation, report);
  worstRow(
      name + "trips", runs, [](const HapticResult& r) { return double(r.trips); }, 0.0, report);
  worstRow(
      name + "inputs that the tissue refused", runs, [](const HapticResult& r) { return double(r.refused); }, 0.0,
      report);
  limitsRows(name, runs, report);
}

void normalUse(const std::string& device, const Options& options, Report& report) {
  for (const Hand hand : kHands) {
    std::vector<Run> runs;
    for (const HapticSetup& setup : variants(device, hand, options))
      runs.push_back({setup, {}});
    runAll(runs, options.threads, false);
    writeTable(runs, options);
    normalRows(device + ", " + nameOf(hand) + ": ", hand != Hand::kTapping, runs, report);
  }
}

void cutting(const Options& options, Report& report) {
  std::vector<Run> runs;
  for (const char* device : {"touch", "premium_1_5", "omega_7"}) {
    for (const double damping : kDampings) {
      HapticSetup setup;
      setup.device = device;
      setup.cuts = true;
      setup.tissue = TissueKind::kPrestressed;
      setup.damping_n_s_m = damping;
      runs.push_back({setup, {}});
      if (options.quick)
        break;
    }
    if (options.quick)
      break;
  }
  runAll(runs, options.threads, false);
  writeTable(runs, options);
  normalRows("cut: ", false, runs, report);
}

/// Faults take the force to zero; what is none must not: there only the limits are judged.
bool takesForceToZero(Sabotage sabotage) {
  return sabotage != Sabotage::kTenfoldJitter && sabotage != Sabotage::kSlowLoop;
}

/// A simulation that sends rarely can only be missed later: after three intervals.
void zeroRows(const std::string& name, Sabotage sabotage, const std::vector<Run>& runs, Report& report) {
  const bool killed = sabotage == Sabotage::kSimulationKilled || sabotage == Sabotage::kSimulationRestarts;
  const auto zeroAfter = [](const HapticResult& r) { return r.zero_after_s; };
  std::vector<Run> prompt;
  std::vector<Run> rare;
  for (const Run& run : runs)
    (killed && run.setup.patch_rate_hz < kPatchRates[0] ? rare : prompt).push_back(run);
  worstRow(name + "time until the force is zero, s", prompt, zeroAfter, kZeroWithin_s, report);
  if (!rare.empty())
    worstRow(name + "the same with patches at 30 Hz, s", rare, zeroAfter, 3.0 / kPatchRates[1] + kZeroWithin_s, report);
}

void sabotaged(Sabotage sabotage, const Options& options, Report& report) {
  std::vector<Run> runs;
  for (const char* device : kDevices) {
    for (const double patch_rate : kPatchRates) {
      HapticSetup setup;
      setup.device = device;
      setup.patch_rate_hz = patch_rate;
      setup.damping_n_s_m = 1.0;  // the largest forces
      setup.jitter_s = 1e-3;
      setup.sabotage = sabotage;
      runs.push_back({setup, {}});
      if (options.quick)
        break;
    }
  }
  if (options.quick)
    runs.resize(1);
  runAll(runs, options.threads, false);
  writeTable(runs, options);
  const std::string name = nameOf(sabotage) + ": ";
  limitsRows(name, runs, report);
  if (takesForceToZero(sabotage))
    zeroRows(name, sabotage, runs, report);
  else
    energyRows(name, runs, report);
  if (sabotage == Sabotage::kSimulationRestarts)
    report.positive(name + "force after the restart, N",
                    worst(runs, [](const HapticResult& r) { return -r.force_again_n; }).result.force_again_n);
}

}  // namespace

std::vector<Case> hapticsCases(const Options& options) {
  std::vector<Case> cases;
  const double seconds = options.quick ? 1.0 : options.full ? 350.0 : 16.0;
  for (const char* device : kDevices) {
    if (options.quick && std::string(device) != "touch")
      continue;
    cases.push_back(
        {std::string("device ") + device, seconds, [=](Report& report) { normalUse(device, options, report); }});
  }
  cases.push_back(
      {"force against depth", options.quick ? 1.0 : 5.0, [=](Report& report) { forceAgainstDepth(options, report); }});
  cases.push_back({"strokes", options.quick ? 2.0 : 20.0, [=](Report& report) { hapticStrokes(options, report); }});
  // The last two take minutes.
  for (const char* scene : {"mri_head", "ct_head", "ct_incision"}) {
    if (options.full || (!options.quick && std::string(scene) != "ct_incision"))
      cases.push_back(
          {std::string("scene ") + scene, 10.0, [=](Report& report) { hapticScene(scene, options, report); }});
  }
  if (options.full)
    cases.push_back({"cutting scene", 90.0, [=](Report& report) { strokesInCuttingScene(options, report); }});
  cases.push_back({"cut", options.quick ? 1.0 : 10.0, [=](Report& report) { cutting(options, report); }});
  for (const Sabotage sabotage :
       {Sabotage::kPoseStops, Sabotage::kNotANumber, Sabotage::kTeleport, Sabotage::kTenfoldJitter, Sabotage::kSlowLoop,
        Sabotage::kSimulationKilled, Sabotage::kSimulationRestarts}) {
    cases.push_back({"sabotage " + nameOf(sabotage), options.quick ? 0.3 : 4.0,
                     [=](Report& report) { sabotaged(sabotage, options, report); }});
  }
  return cases;
}

}  // namespace soft_volume::core::validate
