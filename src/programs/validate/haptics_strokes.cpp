// Press, slide, cut and press again, as a hand would: force and proxy over time, in a block and in the shipped scenes.

#include "haptics_strokes.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

#include "haptic_block.h"
#include "scripted_run.h"
#include "soft_volume/common/error.h"

namespace soft_volume::core::validate {
namespace {

constexpr double kTiny_n = 1e-3;
constexpr double kNothing = std::numeric_limits<double>::quiet_NaN();

struct Moment {
  double time_s;
  double force_n;
  double device_m;  // depth below where the contact began, along the surface's normal there; not a number without one
  double proxy_m;   // the same
  bool cutting;
};

struct Strokes {
  std::vector<Moment> moments;
  double pressed_n = 0.0;
  double cut_n = 0.0;
  int faults = 0;
  std::size_t refused = 0;
};

/// Where a contact began.
struct Touch {
  Vector3 proxy_m = Vector3::Zero();
  Vector3 normal = Vector3::Zero();
  double depth(const Vector3& p) const { return normal.dot(proxy_m - p); }
};

Strokes play(const Scene& scene, const SceneVolumes& volumes) {
  Session session(scene, volumes.volume, volumes.labels, 1, 1);
  ScriptedRun run(session);
  Strokes strokes;
  std::optional<Touch> touch;
  ForceFault before = ForceFault::kNone;
  while (!run.scriptEnded()) {
    run.move();
    session.step();
    const ToolOutput& output = run.output();
    const Contact& contact = output.contact;
    Moment moment{session.simulationTime(), output.device_force_n.norm(), kNothing, kNothing, output.cutting};
    if (!contact.touching) {
      touch.reset();
    } else {
      touch = touch.value_or(Touch{contact.proxy_m, contact.normal});
      moment.device_m = touch->depth(run.device().position_m());
      moment.proxy_m = touch->depth(contact.proxy_m);
    }
    strokes.moments.push_back(moment);
    double& largest_n = output.cutting ? strokes.cut_n : strokes.pressed_n;
    largest_n = std::max(largest_n, moment.force_n);
    strokes.faults += output.fault != ForceFault::kNone && before == ForceFault::kNone ? 1 : 0;
    before = output.fault;
  }
  strokes.refused = run.refused();
  return strokes;
}

/// Values of all moments, one in so many; a hole where there is none.
template <typename Value>
std::string block(const std::string& name, const Strokes& strokes, const Value& value) {
  const std::size_t stride = std::max<std::size_t>(1, strokes.moments.size() / 3000);
  std::ostringstream lines;
  lines << "$" << name << " << EOD\n";
  for (std::size_t i = 0; i < strokes.moments.size(); i += stride) {
    const double number = value(strokes.moments[i]);
    if (std::isfinite(number))
      lines << strokes.moments[i].time_s << " " << number << "\n";
    else
      lines << "\n";
  }
  lines << "EOD\n";
  return lines.str();
}

std::string plotCommands(const std::string& title, const Strokes& strokes) {
  std::ostringstream script;
  script
      << block("pressed", strokes, [](const Moment& m) { return m.cutting ? kNothing : m.force_n; })
      << block("cut", strokes, [](const Moment& m) { return m.cutting ? m.force_n : kNothing; })
      << block("device", strokes, [](const Moment& m) { return 1e3 * m.device_m; })
      << block("proxy", strokes, [](const Moment& m) { return 1e3 * m.proxy_m; })
      << "set multiplot layout 2,1\nset tmargin 2.5\nset key at graph 1.0,1.1 right horizontal\n"
      << "set label 1 '" << title << "' at graph 0.0,1.07 left noenhanced\n"
      << "set lmargin 9\nset xrange [0:" << strokes.moments.back().time_s
      << "]\nset ylabel 'force on the hand, N'\nset yrange [0:*]\n"
      << "plot $pressed with lines lw 2 lc rgb '#1f77b4' title 'probe', "
      << "$cut with lines lw 2 lc rgb '#d62728' title 'scalpel cuts'\n"
      << "unset label 1\nset yrange [*:*] reverse\nset ylabel 'depth below the first touch, mm'\nset xlabel 'time, s'\n"
      << "plot $device with lines lw 2 lc rgb '#7f7f7f' title 'device', "
      << "$proxy with lines lw 2 lc rgb '#2ca02c' title 'proxy'\nunset multiplot\n";
  return script.str();
}

void reportStrokes(const std::string& name, const Strokes& strokes, Report& report) {
  report.positive(name + ": largest force of the probe, N", strokes.pressed_n);
  report.positive(name + ": largest force while the scalpel cuts, N", strokes.cut_n);
  report.atMost(name + ": force at the end, N", strokes.moments.back().force_n, kTiny_n);
  report.atMost(name + ": faults", strokes.faults, 0.0);
  report.atMost(name + ": inputs that the tissue refused", double(strokes.refused), 0.0);
}

/// A way-point of a hand over the block: `button` is held until the next one.
WayPoint over(double time_s, double x_m, double y_m, double z_m, int button = -1) {
  WayPoint point;
  point.time_s = time_s;
  point.position_m = {x_m, y_m, z_m};
  if (button >= 0)
    point.buttons.set(std::size_t(button));
  return point;
}

/// The probe presses, slides and leaves; the scalpel cuts along the middle; the probe presses beside the cut.
void strokesInBlock(const Options& options, Report& report) {
  HapticBlock block = makeHapticBlock(TissueKind::kPrestressed, 0.5, kToughness_j_m2);
  const double top = block.top_m.z();
  const double y = block.top_m.y();
  Scene& scene = block.scene;
  scene.swap_button = 1;
  scene.device.limits = deviceLimits("premium_1_5");
  scene.device.mass_kg = deviceMechanics("premium_1_5").mass_kg;
  scene.device.friction_n = deviceMechanics("premium_1_5").friction_n;
  scene.device.hand_stiffness_n_m = 1000.0;
  scene.device.hand_damping_n_s_m = 10.0;
  scene.device.workspace_centre_m = block.top_m;
  for (ToolConfig& tool : scene.tools) {
    tool.device = scene.device.limits;
    tool.coupling.stiffness_n_m = 400.0;
    tool.tip_radius_m = tool.kind == ToolKind::kScalpel ? 0.001 : 0.004;
    tool.friction_coefficient = tool.kind == ToolKind::kScalpel ? 0.0 : 0.2;
  }
  constexpr int kCut = 0;
  constexpr int kSwap = 1;
  scene.device.way_points = {over(0.0, 0.019, y, top + 0.012),         over(0.8, 0.019, y, top - 0.006),
                             over(1.4, 0.019, y, top - 0.006),         over(2.6, 0.039, y, top - 0.006),
                             over(3.0, 0.039, y, top - 0.006),         over(3.6, 0.020, y, top + 0.012),
                             over(3.8, 0.010, y, top + 0.012, kSwap),  over(4.0, 0.004, y, top + 0.012),
                             over(4.2, 0.004, y, top + 0.012, kCut),   over(5.0, 0.010, y, top - 0.012, kCut),
                             over(7.4, 0.048, y, top - 0.012, kCut),   over(8.0, 0.050, y, top + 0.012),
                             over(8.2, 0.040, y, top + 0.012, kSwap),  over(8.4, 0.030, y - 0.008, top + 0.012),
                             over(9.2, 0.029, y - 0.008, top - 0.006), over(9.8, 0.029, y - 0.008, top - 0.006),
                             over(10.6, 0.029, y - 0.008, top + 0.012)};
  const Strokes strokes = play(scene, {block.volume, nullptr});
  options.plot("haptics_strokes_block", plotCommands("Press, slide, cut, press beside the cut: a block", strokes));
  reportStrokes("strokes, block", strokes, report);
}

/// A shipped scene with its own tools and device; skipped where its volume is missing.
void playScene(const std::string& scene_name, const std::string& name, void (*change)(Scene&), const Options& options,
               Report& report) {
  Scene scene;
  SceneVolumes volumes;
  try {
    scene = loadScene(SOFT_VOLUME_SOURCE_DIR "/config/scenes/" + scene_name + ".yaml");
    volumes = readVolumes(scene);
  } catch (const Error& error) {
    report.skip(name + ": " + error.what() + "; scripts/sample_data makes its volume");
    return;
  }
  change(scene);
  const Strokes strokes = play(scene, volumes);
  std::string file = "haptics_strokes_" + name;
  std::replace(file.begin(), file.end(), ' ', '_');
  options.plot(file, plotCommands("Press, slide, cut, release: " + name, strokes));
  reportStrokes(name, strokes, report);
}

/// In place of the scene's hand: the probe presses and slides, the scalpel draws the first of the scene's strokes, the
/// probe presses on the incision, as in the scene.
void pressSlideCutAndPress(Scene& scene) {
  constexpr double kFirstStrokeEnds_s = 11.0;
  constexpr double kLastPressBegins_s = 22.8;
  constexpr double kCutBegins_s = 6.5;
  const std::vector<WayPoint> own = scene.device.way_points;
  const Quaternion held = own.back().orientation.value_or(Quaternion::Identity());
  const Vector3 free_m = own.back().position_m;
  const Vector3 pressed_m(0.0913, 0.0774, 0.0257);
  const Vector3 along_m = 0.012 * (pressed_m - free_m).cross(Vector3::UnitY()).normalized();
  Buttons swap;
  swap.set(scene.swap_button);
  std::vector<WayPoint> script{{0.0, free_m, held, swap, false},
                               {0.3, free_m, held, Buttons(), false},
                               {1.5, pressed_m, held, Buttons(), false},
                               {2.3, pressed_m, held, Buttons(), false},
                               {3.5, pressed_m + along_m, held, Buttons(), false},
                               {4.0, pressed_m + along_m, held, Buttons(), false},
                               {5.0, free_m, held, Buttons(), false},
                               {5.2, free_m, held, swap, false}};
  for (const WayPoint& point : own) {
    const bool stroke = point.time_s <= kFirstStrokeEnds_s;
    if (!stroke && point.time_s < kLastPressBegins_s)
      continue;
    WayPoint shifted = point;
    shifted.time_s += stroke ? kCutBegins_s : kCutBegins_s + kFirstStrokeEnds_s + 1.0 - kLastPressBegins_s;
    script.push_back(shifted);
  }
  scene.device.way_points = script;
}

}  // namespace

void hapticStrokes(const Options& options, Report& report) {
  strokesInBlock(options, report);
}

void hapticScene(const std::string& name, const Options& options, Report& report) {
  playScene(
      name, "scene " + name, [](Scene&) {}, options, report);
}

void strokesInCuttingScene(const Options& options, Report& report) {
  playScene("ct_incision", "cutting scene", pressSlideCutAndPress, options, report);
}

}  // namespace soft_volume::core::validate
