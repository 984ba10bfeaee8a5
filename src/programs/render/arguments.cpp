#include "arguments.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>

#include "option_values.h"
#include "soft_volume/common/error.h"
#include "soft_volume/render/option_names.h"

namespace soft_volume::core {

template <>
inline constexpr std::array<NamedChoice<render_program::Mode>, 3> kChoices<render_program::Mode>{
    {{"texture", render_program::Mode::kTexture},
     {"scalar", render_program::Mode::kScalar},
     {"colour", render_program::Mode::kColour}}};

namespace render_program {
namespace {

constexpr char kAbout[] =
    "Draws a volume or an irregular grid into a PNG. Lengths: a volume is in metres (its file's millimetres are "
    "converted),\na grid is in its file's own unit of length; colours and opacities come from a transfer function.";

constexpr char kFooter[] =
    "Examples:\n"
    "  soft_volume_render head.nii.gz\n"
    "      A first look: the whole head from the front, into head.png. Patients are upright and look at the viewer.\n"
    "  soft_volume_render ct.mha --tf ct_bone --azimuth 30 --elevation 15 --size 1280x960 --out skull.png\n"
    "      The skull from the patient's left and above. --list-tf names the other transfer functions.\n"
    "  soft_volume_render ct.mha --tf ct_skin --clip 1,0,0,0.12 --azimuth 60 --out open.png\n"
    "      The half with x <= 0.12 m, looked into from the open side.\n"
    "  soft_volume_render flow.vtu --list-arrays\n"
    "  soft_volume_render flow.vtu --array pressure --tf inferno --slices 400 --out flow.png\n"
    "      What a simulation's file holds, and one of its arrays.\n"
    "  soft_volume_render finxyz.bin finq.bin --array Density --tf shells --projection parallel --out fin.png\n"
    "      PLOT3D: the grid and its solution.\n"
    "  soft_volume_render flow.vtu --cross-section 0.5 --out cut.png\n"
    "      One slice half-way through the depth of the view, opaque. --cross-section 0,0,1,2.5 is the plane z = 2.5.\n"
    "  soft_volume_render ct.mha --turntable 60 --out turn.png && ffmpeg -i turn_%03d.png turn.mp4\n"
    "      A turn in 60 frames.\n"
    "  soft_volume_render flow.vtu --backend gl --repeat 9 --json times.json\n"
    "      How long each stage takes, as medians of 9 frames.\n"
    "\n"
    "Files: volumes are NIfTI, NRRD, MetaImage, VTI or a folder with a DICOM series; grids are legacy VTK (.vtk), "
    ".vtu,\n"
    ".vts, .vtr and binary PLOT3D. Transfer functions are presets, YAML, colour maps of ParaView (.json; maps from 0 "
    "to\n"
    "1 are stretched over the data's range) or volume properties of 3D Slicer (.vp, .mrml).\n"
    "\n"
    "View: at azimuth 0 a patient is seen from the front with the head up, a grid from +z with y up. Positive azimuth\n"
    "takes the camera to its right, positive elevation up. The whole grid is in the picture at zoom 1.\n"
    "\n"
    "Opacity counts per unit distance, so more slices make the picture better but not denser. A grid that looks too\n"
    "thin or too dense wants another --unit-distance.\n"
    "\n"
    "Outputs beside the PNG: --raw is float32 (this machine's byte order) red, green, blue, opacity of every pixel, "
    "row\n"
    "by row from the top, colours premultiplied with opacity, without background. --depth is the distance along the\n"
    "view's axis where the opacity passes --depth-threshold: FILE.png has 16-bit grey from 65535 (nearest) to 1\n"
    "(farthest), 0 where there is nothing; any other name has float32 lengths, NaN where there is nothing. "
    "--label-image\n"
    "is a 16-bit grey PNG with the label at that depth. --json has transform_ms, bucket_ms, slice_ms, render_ms,\n"
    "total_ms, cells (that may show something), polygons, fragments, peak_rss_bytes, and facts about the input.\n"
    "\n"
    "Exit code: 0 done, 1 it cannot be done (bad arguments, a file that is missing or damaged, no OpenGL for "
    "--backend gl).\n";

template <typename Choice, typename Target>
CLI::Option* addChoice(CLI::App& app, const char* name, Target& target, const std::string& about) {
  const auto set = [&target](const std::string& word) { target = *choiceNamed<Choice>(word); };
  return app.add_option_function<std::string>(name, set, about)->check(CLI::IsMember(choiceNames<Choice>()));
}

void parseSize(const std::string& text, Arguments& arguments) {
  const PictureSize size = core::parseSize(text, "--size");
  arguments.width = size.width;
  arguments.height = size.height;
}

void parseCrossSection(const std::string& text, Arguments& arguments) {
  const std::vector<double> numbers = parseNumbers(text, "--cross-section");
  if (numbers.size() == 1 && numbers[0] >= 0.0 && numbers[0] <= 1.0) {
    arguments.cross_section = numbers;
  } else if (numbers.size() == 4) {
    const ClipPlane plane = parsePlane(text, "--cross-section");
    arguments.cross_section = {plane.normal.x(), plane.normal.y(), plane.normal.z(), plane.offset_m};
  } else {
    throw CLI::ValidationError("--cross-section",
                               "'" + text + "' must be a part of the depth from 0 to 1, or a plane NX,NY,NZ,OFFSET");
  }
}

/// An option whose text is parsed by `parse(text)`.
template <typename Parse>
CLI::Option* addParsed(CLI::App& app, const char* name, const Parse& parse, const std::string& about,
                       const char* type) {
  return app.add_option_function<std::string>(name, parse, about)->type_name(type);
}

void addInput(CLI::App& app, Arguments& a) {
  app.add_option("files", a.files, "INPUT [SOLUTION] [OUT.png]: a volume or grid; PLOT3D's solution; the picture");
  app.add_option("--solution", a.solution, "PLOT3D: the solution (Q) file of the grid");
  app.add_option("--array", a.array, "array of the grid that is drawn; default: the file's active or first one");
  app.add_option("--component", a.component, "component of a vector, from 0; default: its length")
      ->check(CLI::Range(0, 255));
  app.add_flag("--list-arrays", a.list_arrays, "say what the file holds, and draw nothing");
  app.add_option("--labels", a.labels, "segmentation (a volume over the same box), for --label-image");
}

void addLook(CLI::App& app, Arguments& a) {
  app.add_option("--tf", a.transfer_function,
                 "transfer function: a preset or a file; default: ct_skin, mri_t1_head or viridis by the data");
  app.add_flag("--list-tf", a.list_presets, "list the presets, and draw nothing");
  addParsed(
      app, "--range",
      [&a](const std::string& text) {
        const std::vector<double> low_high = parseNumbers(text, "--range", 2);
        if (low_high[0] > low_high[1])
          throw CLI::ValidationError("--range", "LOW must not exceed HIGH");
        a.range = {low_high[0], low_high[1]};
      },
      "values that a relative transfer function is stretched over; default: the data's range", "LOW,HIGH");
  app.add_option("--unit-distance", a.unit_distance,
                 "length that the opacities refer to; default: the transfer function's, else 1/100 of the diagonal")
      ->check(CLI::Range(1e-12, 1e12));
  addChoice<Mode>(app, "--mode", a.mode,
                  "what is interpolated; default: texture for volumes, scalar for grids; a volume's voxels become "
                  "cells in the other two");
  app.add_option("--shade", a.shade, "light, 0 (none) to 1; default: 0.7 for volumes, 0 for grids")
      ->check(CLI::Range(0.0, 1.0));
  app.add_option("--specular", a.options.specular, "strength of highlights, 0 to 1 (default 0.2)")
      ->check(CLI::Range(0.0, 1.0));
  addParsed(
      app, "--background", [&a](const std::string& text) { a.background = parseColour(text, "--background"); },
      "colour behind, 0 to 1 each (default 0,0,0)", "R,G,B");
  const auto clip = [&a](const std::vector<std::string>& planes) {
    for (const std::string& plane : planes)
      a.options.clip_planes.push_back(parsePlane(plane, "--clip"));
  };
  app.add_option_function<std::vector<std::string>>(
         "--clip", clip, "draw only where NX*x + NY*y + NZ*z <= OFFSET (normal of length 1); up to 8 times")
      ->allow_extra_args(false)
      ->type_name("NX,NY,NZ,OFFSET");
}

void addMethod(CLI::App& app, Arguments& a) {
  addChoice<Backend>(app, "--backend", a.backend, "what draws (default native); exact is slow and the reference");
  CLI::Option* slices =
      app.add_option("--slices", a.slices, "planes over the grid's depth; default: 400 for volumes, 200 for grids")
          ->check(CLI::Range(1, 4096));
  app.add_option("--step", a.options.step_m, "distance of the planes instead of their number")
      ->check(CLI::Range(1e-12, 1e12))
      ->excludes(slices);
  app.add_flag("--adaptive", a.options.adaptive, "cut cells between two planes too");
  app.add_flag("--exact-boundary", a.options.exact_boundary, "exact depth of boundary faces (native)");
  app.add_flag("--jitter", a.options.jitter, "noise instead of bands where slices are few");
  app.add_option("--threads", a.options.threads, "default: all cores; never changes the picture")
      ->check(CLI::Range(0, 256));
}

void addView(CLI::App& app, Arguments& a) {
  CLI::Option* size = addParsed(
      app, "--size", [&a](const std::string& text) { parseSize(text, a); }, "pixels (default 640x480)", "WxH");
  CLI::Option* projection =
      addChoice<Projection>(app, "--projection", a.projection, "kind of projection (default perspective)");
  CLI::Option* azimuth = app.add_option("--azimuth", a.azimuth_deg, "turn of the camera to its right, degrees");
  CLI::Option* elevation =
      app.add_option("--elevation", a.elevation_deg, "rise of the camera, degrees")->check(CLI::Range(-90.0, 90.0));
  azimuth->check(CLI::Range(-36000.0, 36000.0));
  CLI::Option* zoom =
      app.add_option("--zoom", a.zoom, "magnification (default 1: everything fits)")->check(CLI::Range(1e-3, 1e3));
  CLI::Option* camera = app.add_option("--camera", a.camera,
                                       "camera from a YAML file, with the keys of a scene's "
                                       "camera (doc/scene.md)");
  CLI::Option* section = addParsed(
      app, "--cross-section", [&a](const std::string& text) { parseCrossSection(text, a); },
      "one opaque slice: at a part (0 to 1) of the view's depth, or the plane NX,NY,NZ,OFFSET seen along its "
      "normal",
      "PLANE");
  CLI::Option* turntable =
      app.add_option("--turntable", a.turntable, "draw a full turn in so many frames")->check(CLI::Range(1, 9999));
  for (CLI::Option* other : {size, projection, azimuth, elevation, zoom, turntable})
    camera->excludes(other);
  section->excludes(turntable);
}

void addOutput(CLI::App& app, Arguments& a) {
  app.add_option("--out", a.out, "the picture (default: the input's name with .png, in the current folder)");
  app.add_option("--raw", a.raw, "write the float image");
  app.add_option("--depth", a.depth, "write the depth image");
  app.add_option("--depth-threshold", a.options.depth_threshold, "opacity at which depth is taken (default 0.5)")
      ->check(CLI::Range(0.01, 0.99));
  app.add_option("--label-image", a.label_image, "write the label image (16-bit PNG)");
  app.add_option("--json", a.json, "write times and counts");
  app.add_option("--repeat", a.repeat, "draw so many times, for the times' medians")->check(CLI::Range(1, 10000));
  app.add_flag("--no-progress", a.no_progress, "print no progress");
}

bool isPng(const std::string& path) {
  return path.size() > 4 && path.compare(path.size() - 4, 4, ".png") == 0;
}

std::string stemOf(const std::string& path) {
  const std::size_t last = path.find_last_not_of('/');
  const std::string name = path.substr(0, last + 1);
  const std::string base = name.substr(name.find_last_of('/') + 1);
  return base.substr(0, base.find('.', 1));
}

/// The files after the input are told apart by their names.
void takeFiles(Arguments& a) {
  if (a.files.empty())
    throw InputError("no input: name a volume or a grid (--help shows examples)");
  for (std::size_t n = 1; n < a.files.size(); ++n) {
    std::string& place = isPng(a.files[n]) ? a.out : a.solution;
    if (!place.empty())
      throw InputError("do not know what to do with '" + a.files[n] + "' beside '" + place + "'");
    place = a.files[n];
  }
  if (a.out.empty())
    a.out = stemOf(a.files.front()) + ".png";
  if (!isPng(a.out))
    throw InputError(a.out + ": the picture's name must end in .png");
}

void checkCombinations(const Arguments& a) {
  if (a.label_image.empty() != a.labels.empty())
    throw InputError("--labels (what is segmented) and --label-image (where to write) need each other");
  if (a.options.exact_boundary && a.backend == Backend::kGl)
    throw InputError("--exact-boundary needs --backend native");
  if (a.options.clip_planes.size() > RenderOptions::kMaxClipPlanes)
    throw InputError("--clip can be given " + std::to_string(RenderOptions::kMaxClipPlanes) + " times at most");
  if (!a.cross_section.empty() && a.backend == Backend::kExact)
    throw InputError("--cross-section needs --backend native or gl");
  if (!a.cross_section.empty() && !(a.depth.empty() && a.label_image.empty()))
    throw InputError("--cross-section has no depth and no labels");
  if (a.cross_section.size() == 4 && (a.azimuth_deg != 0.0 || a.elevation_deg != 0.0))
    throw InputError("--cross-section with a plane is seen along its normal, without --azimuth and --elevation");
  if (a.turntable > 0 && !(a.raw.empty() && a.depth.empty() && a.label_image.empty()))
    throw InputError("--turntable writes pictures alone, without --raw, --depth or --label-image");
}

}  // namespace

std::optional<int> parseArguments(int argc, char** argv, Arguments& arguments) {
  CLI::App app(kAbout);
  app.set_help_flag("-h,--help", "this text");
  addInput(app, arguments);
  addLook(app, arguments);
  addMethod(app, arguments);
  addView(app, arguments);
  addOutput(app, arguments);
  app.footer(kFooter);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 1;
  }
  if (arguments.list_presets)
    return std::nullopt;
  takeFiles(arguments);
  checkCombinations(arguments);
  arguments.options.depth = !arguments.depth.empty() || !arguments.label_image.empty();
  arguments.options.labels = !arguments.label_image.empty();
  return std::nullopt;
}

}  // namespace render_program
}  // namespace soft_volume::core
