#include "arguments.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <functional>

#include "option_values.h"
#include "soft_volume/replay/replay_bag.h"
#include "soft_volume/replay/tolerance.h"

namespace soft_volume::replay_program {
namespace {

constexpr char kExamples[] =
    "Examples:\n"
    "  soft_volume_replay demo.bag --check\n"
    "      Is everything that the bag recorded computed again, bit for bit?\n"
    "  soft_volume_replay demo.bag --check --json result.json --threads 2\n"
    "      The same in a script: counts, `identical` and `first_difference` as JSON.\n"
    "  soft_volume_replay demo.bag --check --tolerance positions=0.01,image_rmse=2,ssim=0.98\n"
    "      On another kind of machine: no vertex is farther than 1 % of a cell's edge from its recorded place, and no\n"
    "      frame than 2 levels.\n"
    "  soft_volume_replay new.bag --against old.bag --tolerance limits.yaml\n"
    "      How far are two recordings apart, and is it too far?\n"
    "  soft_volume_replay demo.bag --resimulate simulation.preset=fast,lattice.spacing_m=0.01 --output fast.bag\n"
    "      The same hand and other settings: how far does the result move, and what does a step cost?\n"
    "  soft_volume_replay demo.bag --check --report page.html\n"
    "      What was found as a page with plots and pictures; also with --against, --resimulate, or nothing else.\n"
    "  soft_volume_replay demo.bag --render side --azimuth 60 --tf ct_bone --every 0.5 --video side.mp4\n"
    "      The recorded states seen from the side, bones only, every half second, also as a video.\n"
    "  soft_volume_replay demo.bag --export-vtu paraview --export-csv tables\n"
    "      The deformed grid for ParaView; forces, poses, inputs and statistics as tables.\n"
    "  soft_volume_replay demo.bag --frames frames\n"
    "      Only compute the recorded frames again, as frames/CAMERA_STEP.png.\n"
    "\n";

constexpr char kFooter[] =
    "The bag holds its own volume and scene; no other file is needed, nor a ROS master. A bag of a recorder that was\n"
    "killed has no index: `rosbag reindex FILE` first; the replay then goes as far as the bag does.\n"
    "\n"
    "Exit code: 0 everything is identical or within the tolerances, 1 something differs, 2 it cannot be done (bad\n"
    "arguments; a bag that is damaged, lacks a topic or comes from another version).\n";

void addWork(CLI::App& app, Arguments& a) {
  app.add_flag("--check", a.check, "compute the run again from its inputs and compare everything with the record");
  CLI::Option* against = app.add_option("--against", a.against, "compare with another recording of the interaction")
                             ->type_name("OTHER.bag");
  CLI::Option* resimulate =
      app.add_option_function<std::string>(
             "--resimulate", [&a](const std::string& changes) { a.resimulate = changes; },
             "compute the run again from the device's motion, with other settings where given, and compare with the "
             "record")
          ->expected(0, 1)
          ->type_name("KEY=VALUE,...")
          ->excludes(against);
  app.add_option("--output", a.output, "bag that --resimulate writes")->type_name("OTHER.bag")->needs(resimulate);
  app.add_option("--device", a.device,
                 "file of the device that was recorded, as in config/devices, for --resimulate; without it the scene's "
                 "own device is meant")
      ->type_name("FILE")
      ->needs(resimulate);
  app.add_option("--tolerance", a.tolerance,
                 "how far things may be apart: limits with commas between them, or a YAML file with a limit a line; "
                 "without it everything must be the same, bit for bit")
      ->type_name("KEY=LIMIT,...");
}

/// A check by a parser that throws.
template <typename Parse>
std::function<std::string(const std::string&)> checked(const Parse& parse) {
  return [parse](const std::string& text) {
    parse(text);
    return std::string();
  };
}

void addRender(CLI::App& app, RenderArguments& r) {
  std::vector<CLI::Option*> details;
  CLI::Option* render =
      app.add_option("--render", r.dir, "draw the recorded states again into this folder, changed as follows")
          ->type_name("DIR");
  CLI::Option* camera =
      app.add_option("--camera", r.camera, "camera from a YAML file, with the keys of a scene's camera (doc/scene.md)");
  details.push_back(camera);
  const auto set_size = [&r](const std::string& text) {
    const core::PictureSize size = core::parseSize(text, "--size");
    r.width = size.width;
    r.height = size.height;
  };
  details.push_back(
      app.add_option_function<std::string>("--size", set_size, "pixels")->type_name("WxH")->excludes(camera));
  for (const auto& angle :
       {app.add_option("--azimuth", r.azimuth_deg, "see the whole grid instead, turned to the camera's right, degrees")
            ->check(CLI::Range(-36000.0, 36000.0)),
        app.add_option("--elevation", r.elevation_deg, "the same: rise of the camera, degrees")
            ->check(CLI::Range(-90.0, 90.0)),
        app.add_option("--zoom", r.zoom, "the same: magnification (1: everything fits)")->check(CLI::Range(1e-3, 1e3)),
        app.add_option("--projection", r.projection, "the same: perspective (default) or parallel")
            ->check(CLI::IsMember({"perspective", "parallel"}))}) {
    angle->excludes(camera);
    details.push_back(angle);
  }
  details.push_back(app.add_option("--tf", r.transfer_function, "transfer function: a preset or a file"));
  details.push_back(app.add_option("--unit-distance", r.unit_distance_m, "length that the opacities refer to, metres")
                        ->check(CLI::Range(1e-12, 1e12)));
  details.push_back(
      app.add_option("--backend", r.backend, "what draws")->check(CLI::IsMember({"native", "gl", "exact"})));
  CLI::Option* slices =
      app.add_option("--slices", r.slices, "planes over the grid's depth")->check(CLI::Range(1, 4096));
  details.push_back(slices);
  details.push_back(app.add_option("--step", r.step_m, "distance of the planes instead of their number, metres")
                        ->check(CLI::Range(1e-12, 1e12))
                        ->excludes(slices));
  details.push_back(app.add_option("--shade", r.shade, "light, 0 (none) to 1")->check(CLI::Range(0.0, 1.0)));
  details.push_back(app.add_option("--background", r.background, "colour behind, 0 to 1 each")
                        ->check(checked([](const std::string& text) { core::parseColour(text, "--background"); }))
                        ->type_name("R,G,B"));
  details.push_back(app.add_option("--clip", r.clip, "draw only where NX*x + NY*y + NZ*z <= OFFSET; up to 8 times")
                        ->allow_extra_args(false)
                        ->check(checked([](const std::string& text) { core::parsePlane(text, "--clip"); }))
                        ->type_name("NX,NY,NZ,OFFSET"));
  details.push_back(app.add_option("--every", r.every_s,
                                   "simulated time between frames, seconds (default: the frames that were recorded)")
                        ->check(CLI::Range(1e-6, 1e6)));
  for (CLI::Option* detail : details)
    detail->needs(render)->group("With --render");
}

void addOutput(CLI::App& app, Arguments& a) {
  app.add_option("--frames", a.frames_dir, "write the frames that are rendered again into this folder")
      ->type_name("DIR");
  app.add_option("--video", a.video, "write the frames as a video at the speed of simulated time (needs ffmpeg)")
      ->type_name("FILE.mp4");
  app.add_option("--export-vtu", a.vtu_dir, "write the states for ParaView: one .pvd, one .vtu for each state")
      ->type_name("DIR");
  app.add_option("--export-csv", a.csv_dir, "write forces, tool poses and statistics as tables")->type_name("DIR");
  app.add_option("--report", a.report, "write what was found as a page with plots and pictures")
      ->type_name("FILE.html");
  app.add_option("--json", a.json, "write counts, differences and judgements into this file")->type_name("FILE");
  app.add_option("--threads", a.threads, "threads of the simulation (default 1); results do not depend on it")
      ->check(CLI::Range(1, 256));
  app.add_flag("--no-progress", a.no_progress, "print no progress");
}

/// Options without which the program has nothing to do.
bool hasWork(const Arguments& a) {
  return a.check || !a.against.empty() || a.resimulate || !a.frames_dir.empty() || !a.render.dir.empty() ||
         !a.video.empty() || !a.vtu_dir.empty() || !a.csv_dir.empty() || !a.report.empty();
}

void checkArguments(const Arguments& a) {
  if (!hasWork(a))
    throw ReplayError("say what to do: --check, --against OTHER.bag, --frames DIR, or several");
  if (!a.tolerance.empty() && !a.check && a.against.empty() && !a.resimulate)
    throw ReplayError("--tolerance judges what --check or --against finds; say one of these");
  if (!a.tolerance.empty())
    parseTolerance(a.tolerance);
}

}  // namespace

std::optional<int> parseArguments(int argc, char** argv, Arguments& arguments) {
  CLI::App app(
      "Runs a recorded bag again, without a ROS master, and compares it with the record or another recording.");
  app.add_option("bag", arguments.bag, "bag file, as written by the recorder or by rosbag record")->required();
  addWork(app, arguments);
  addRender(app, arguments.render);
  addOutput(app, arguments);
  app.footer(std::string(kExamples) + toleranceHelp() + kFooter);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? kWithin : kImpossible;
  }
  checkArguments(arguments);
  return std::nullopt;
}

}  // namespace soft_volume::replay_program
