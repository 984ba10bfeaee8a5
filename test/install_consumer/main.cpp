// Deforms a block of tissue and renders it before and after, with installed headers and libraries only.

#include <cstdint>
#include <cstdio>
#include <exception>
#include <memory>
#include <vector>

#include "soft_volume/render/renderer.h"
#include "soft_volume/session/session.h"

namespace sv = soft_volume::core;

namespace {

constexpr char kScene[] = R"(
format: 1
name: block
volume: {file: not_read.mha}
materials:
  - {name: tissue, intensity: [50, 200], density_kg_m3: 1000, youngs_modulus_pa: 5000, damping_ratio: 0.2}
lattice:
  spacing_m: 0.01
  fixed_regions_m: [{min: [-0.1, -0.1, -0.1], max: [0.2, 0.2, 0.006]}]
simulation: {dt_s: 0.001}
rendering:
  transfer_function: {points: [[0, 0, 0, 0, 0], [100, 1, 0.8, 0.6, 0.5]]}
  cameras: [{name: camera, width: 64, height: 48, eye_m: [0.12, 0.12, 0.06], target_m: [0.025, 0.025, 0.025], up: [0, 0, 1]}]
tools: [{id: probe, kind: probe, tissue_threshold: 50}]
)";

std::shared_ptr<const sv::Volume> makeTissue() {
  sv::VolumeGeometry geometry;
  geometry.dims = sv::Vector3i(11, 11, 11);
  geometry.spacing_m = sv::Vector3::Constant(0.005);
  return std::make_shared<sv::Volume>(geometry, sv::ScalarType::kUInt8, std::vector<std::uint8_t>(11 * 11 * 11, 100));
}

sv::ToolForceCommand push(const sv::Session& session) {
  sv::ToolForceCommand command;
  command.header.session = session.id();
  command.header.revision = session.lattice().revision;
  command.header.tool_id = "probe";
  command.header.sequence = 1;
  command.hold_steps = 500;
  command.force_n = sv::Vector3(0.0, -0.5, 0.0);
  command.point_m = sv::Vector3(0.025, 0.045, 0.025);
  command.footprint_radius_m = 0.015;
  return command;
}

std::vector<sv::Vector3f> toFloat(const std::vector<sv::Vector3>& positions) {
  std::vector<sv::Vector3f> result;
  for (const sv::Vector3& position : positions)
    result.push_back(position.cast<float>());
  return result;
}

std::size_t differentBytes(const sv::Image& a, const sv::Image& b) {
  std::size_t count = 0;
  for (std::size_t n = 0; n < a.rgb.size(); ++n)
    count += a.rgb[n] != b.rgb[n] ? 1 : 0;
  return count;
}

int run() {
  const sv::Scene scene = sv::parseScene(kScene, "consumer", ".");
  const auto tissue = makeTissue();
  sv::Session session(scene, tissue, nullptr, 1, 1);
  sv::Renderer renderer(sv::Backend::kNative);
  renderer.setVolume(tissue);
  renderer.setTransferFunction(scene.rendering.transfer_function);
  renderer.setTopology(session.topology());
  const sv::Camera& camera = scene.rendering.cameras.front().camera;
  const auto draw = [&] {
    return renderer.render(camera, toFloat(session.simulation().positions())).toRgb8(scene.rendering.background);
  };
  const sv::Image before = draw();
  const sv::Verdict verdict = session.apply(push(session));
  if (!verdict.applied)
    std::printf("refused: %s\n", verdict.reason.c_str());
  for (int step = 0; step < 300; ++step)
    session.step();
  const double moved_m = session.simulation().maxDisplacement();
  const std::size_t changed = differentBytes(before, draw());
  std::printf("%zu cells moved by up to %.2f mm, which changed %zu bytes of the image\n", session.lattice().cellCount(),
              1000.0 * moved_m, changed);
  return moved_m > 0.001 && changed > 100 ? 0 : 1;
}

}  // namespace

int main() {
  try {
    return run();
  } catch (const std::exception& error) {
    std::printf("%s\n", error.what());
    return 1;
  }
}
