// soft_volume_render: a volume or an irregular grid to a picture. Needs no ROS.

#include <cstdio>
#include <fstream>
#include <new>
#include <nlohmann/json.hpp>

#include "arguments.h"
#include "output.h"
#include "progress_bar.h"
#include "soft_volume/common/error.h"
#include "soft_volume/render/image_io.h"
#include "soft_volume/render/option_names.h"
#include "soft_volume/volume/transfer_function_file.h"
#include "subject.h"
#include "view.h"

namespace soft_volume::core::render_program {
namespace {

constexpr int kDone = 0;
constexpr int kImpossible = 1;

void listPresets() {
  for (const std::string& name : transferFunctionPresets())
    std::printf("%-16s %s\n", name.c_str(), readTransferFunction(name).about.c_str());
}

TransferFunction chooseFunction(const Arguments& arguments, const Subject& subject, nlohmann::json& facts) {
  const std::string& source =
      arguments.transfer_function.empty() ? subject.default_transfer_function : arguments.transfer_function;
  TransferFunctionFile file = readTransferFunction(source);
  for (const std::string& note : file.notes)
    std::fprintf(stderr, "note: %s: %s\n", source.c_str(), note.c_str());
  if (arguments.unit_distance) {
    file.function.unit_distance_m = *arguments.unit_distance;
    file.states_distance = true;
  }
  const TransferFunction function =
      fitTo(file, arguments.range.value_or(subject.range), subject.bounds.diagonal().norm());
  facts = {{"name", file.name}, {"unit_distance", function.unit_distance_m}};
  return function;
}

RenderOptions chooseOptions(const Arguments& arguments, const Subject& subject) {
  RenderOptions options = arguments.options;
  options.slices = arguments.slices.value_or(subject.slices);
  options.shading = arguments.shade.value_or(subject.shading);
  options.lookup = arguments.mode == Mode::kColour ? Lookup::kColour : Lookup::kScalar;
  options.validate();
  return options;
}

/// Everything that makes a frame.
class Drawing {
 public:
  explicit Drawing(const Arguments& arguments)
      : arguments_(arguments), subject_(readSubject(arguments)), renderer_(arguments.backend) {
    showSubject(subject_, renderer_);
    renderer_.setTransferFunction(chooseFunction(arguments, subject_, function_facts_));
    options_ = chooseOptions(arguments, subject_);
  }

  const Frame& draw(double turn_deg = 0.0) {
    const Camera camera = viewOf(arguments_, subject_, turn_deg);
    renderer_.forgetFrame();
    if (!arguments_.cross_section.empty())
      return renderer_.renderCrossSection(camera, sectionDepth(arguments_, subject_, camera));
    return renderer_.render(camera, options_);
  }

  nlohmann::json facts() const {
    return {{"backend", nameOf(arguments_.backend)}, {"driver", renderer_.driver()},
            {"threads", options_.threads},           {"lookup", subject_.volume ? "texture" : nameOf(options_.lookup)},
            {"shading", options_.shading},           {"input", subject_.facts},
            {"transfer_function", function_facts_}};
  }

 private:
  const Arguments& arguments_;
  Subject subject_;
  Renderer renderer_;
  RenderOptions options_;
  nlohmann::json function_facts_;
};

void writeJson(const std::string& path, const Drawing& drawing, const Frame& frame, const StageTimes& times) {
  nlohmann::json json = drawing.facts();
  const StageTimes::Medians medians = times.medians();
  json.update({{"transform_ms", medians.transform_ms},
               {"bucket_ms", medians.bucket_ms},
               {"slice_ms", medians.slice_ms},
               {"render_ms", medians.render_ms},
               {"total_ms", medians.total_ms},
               {"width", frame.width},
               {"height", frame.height},
               {"slices", frame.slices},
               {"cells", frame.cells},
               {"polygons", frame.polygons},
               {"fragments", frame.fragments},
               {"peak_rss_bytes", peakRssBytes()}});
  if (!frame.depth_m.empty()) {
    const DepthRange range = depthRange(frame);
    json["depth_range"] = {range.nearest, range.farthest};
  }
  std::ofstream file(path);
  file << json.dump(2) << "\n";
  file.close();
  if (!file)
    throw FileError(path + ": the JSON cannot be written");
}

void writeFrame(const Arguments& arguments, const Frame& frame) {
  writePng(arguments.out, frame.toRgb8(arguments.background));
  if (!arguments.raw.empty())
    writeFloats(arguments.raw, frame.rgba);
  if (!arguments.depth.empty())
    writeDepth(arguments.depth, frame);
  if (!arguments.label_image.empty())
    writePng16(arguments.label_image, frame.width, frame.height, frame.labels);
}

void say(const std::string& picture, const Frame& frame, const StageTimes& times) {
  std::printf("%s: %d x %d, %d slices, %zu polygons, %.1f ms\n", picture.c_str(), frame.width, frame.height,
              frame.slices, frame.polygons, times.medians().total_ms);
  if (isTransparent(frame)) {
    std::fprintf(
        stderr,
        "note: the picture is empty: the transfer function shows nothing of the data's values, or nothing lies "
        "in the view (--range, --unit-distance, --clip and the camera's near and far decide that)\n");
  }
}

void drawPicture(const Arguments& arguments, Drawing& drawing) {
  ProgressBar bar(arguments.no_progress);
  StageTimes times;
  const Frame* frame = nullptr;
  for (int n = 0; n < arguments.repeat; ++n) {
    bar.update(n, arguments.repeat);
    frame = &drawing.draw();
    times.add(*frame);
  }
  writeFrame(arguments, *frame);
  if (!arguments.json.empty())
    writeJson(arguments.json, drawing, *frame, times);
  say(arguments.out, *frame, times);
}

void drawTurn(const Arguments& arguments, Drawing& drawing) {
  ProgressBar bar(arguments.no_progress);
  StageTimes times;
  const Frame* frame = nullptr;
  for (int n = 0; n < arguments.turntable; ++n) {
    bar.update(n, arguments.turntable);
    frame = &drawing.draw(360.0 * n / arguments.turntable);
    times.add(*frame);
    writePng(numbered(arguments.out, n), frame->toRgb8(arguments.background));
  }
  if (!arguments.json.empty())
    writeJson(arguments.json, drawing, *frame, times);
  say(numbered(arguments.out, 0) + " and so on", *frame, times);
}

void run(const Arguments& arguments) {
  for (const std::string* path :
       {&arguments.out, &arguments.raw, &arguments.depth, &arguments.label_image, &arguments.json})
    checkWritable(*path);
  Drawing drawing(arguments);
  if (arguments.turntable > 0)
    drawTurn(arguments, drawing);
  else
    drawPicture(arguments, drawing);
}

int renderMain(int argc, char** argv) {
  Arguments arguments;
  if (const std::optional<int> code = parseArguments(argc, argv, arguments))
    return *code;
  if (arguments.list_presets)
    listPresets();
  else if (arguments.list_arrays)
    listArrays(arguments);
  else
    run(arguments);
  return kDone;
}

}  // namespace
}  // namespace soft_volume::core::render_program

int main(int argc, char** argv) {
  using namespace soft_volume::core::render_program;
  try {
    return renderMain(argc, argv);
  } catch (const std::bad_alloc&) {
    std::fprintf(stderr, "soft_volume_render: the memory does not suffice; use a smaller file or picture\n");
  } catch (const std::exception& error) {
    std::fprintf(stderr, "soft_volume_render: %s\n", error.what());
  }
  return kImpossible;
}
