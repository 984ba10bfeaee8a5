#include <yaml-cpp/yaml.h>

#include <array>
#include <charconv>

#include "soft_volume/render/option_names.h"
#include "soft_volume/scene/scene.h"
#include "soft_volume/simulation/setting_names.h"

namespace soft_volume::core {
namespace {

/// The shortest text that reads back as the same double.
std::string exact(double value) {
  std::array<char, 32> text{};
  const auto end = std::to_chars(text.data(), text.data() + text.size(), value).ptr;
  return {text.data(), end};
}

class Writer {
 public:
  std::string text() const { return out_.c_str(); }

  void number(const char* key, double value) { out_ << YAML::Key << key << YAML::Value << exact(value); }
  void text(const char* key, const std::string& value) {
    out_ << YAML::Key << key << YAML::Value << YAML::DoubleQuoted << value;
  }
  void flag(const char* key, bool value) { out_ << YAML::Key << key << YAML::Value << value; }

  template <typename Values>
  void numbers(const char* key, const Values& values) {
    out_ << YAML::Key << key << YAML::Value;
    row(values);
  }
  template <typename Values>
  void row(const Values& values) {
    out_ << YAML::Flow << YAML::BeginSeq;
    for (const auto value : values)
      out_ << exact(static_cast<double>(value));
    out_ << YAML::EndSeq;
  }
  void vector(const char* key, const Vector3& v) { numbers(key, std::array<double, 3>{v.x(), v.y(), v.z()}); }
  void indices(const char* key, const Vector3i& v) { vector(key, v.cast<double>()); }
  void colour(const char* key, const Vector3f& v) { vector(key, v.cast<double>()); }

  template <typename Content>
  void map(const char* key, const Content& content) {
    out_ << YAML::Key << key << YAML::Value;
    item(content);
  }
  template <typename Content>
  void item(const Content& content) {
    out_ << YAML::BeginMap;
    content();
    out_ << YAML::EndMap;
  }
  template <typename Items, typename Each>
  void list(const char* key, const Items& items, const Each& each) {
    out_ << YAML::Key << key << YAML::Value << YAML::BeginSeq;
    for (const auto& i : items)
      each(i);
    out_ << YAML::EndSeq;
  }

 private:
  YAML::Emitter out_;
};

std::array<double, 4> xyzw(const Quaternion& q) {
  return {q.x(), q.y(), q.z(), q.w()};
}

void writeMaterial(Writer& out, const Material& m) {
  out.item([&] {
    out.text("name", m.name);
    if (m.byLabel()) {
      out.numbers("labels", m.labels);
    } else {
      out.numbers("intensity", std::array<double, 2>{m.intensity_min, m.intensity_max});
    }
    out.number("density_kg_m3", m.density_kg_m3);
    out.number("youngs_modulus_pa", m.youngs_modulus_pa);
    out.number("poisson_ratio", m.poisson_ratio);
    out.number("damping_ratio", m.damping_ratio);
    out.number("prestretch", m.prestretch);
    out.number("cut_resistance_j_m2", m.cut_resistance_j_m2);
    out.flag("fixed", m.fixed);
    out.colour("colour", m.colour);
    out.number("opacity", m.opacity);
  });
}

void writeBox(Writer& out, const Box3& box) {
  out.vector("min", box.min());
  out.vector("max", box.max());
}

void writeLattice(Writer& out, const LatticeSettings& lattice) {
  out.vector("spacing_m", lattice.spacing_m);
  out.number("stiff_fraction", lattice.stiff_fraction);
  out.flag("keep_largest_part", lattice.keep_largest_part);
  out.list("fixed_regions_m", lattice.fixed_regions_m,
           [&out](const Box3& box) { out.item([&] { writeBox(out, box); }); });
}

void writePressure(Writer& out, const SurfacePressure& pressure) {
  out.item([&] {
    writeBox(out, pressure.region_m);
    out.number("pressure_pa", pressure.pressure_pa);
  });
}

void writeSimulation(Writer& out, const Scene& scene) {
  const SimulationSettings& s = scene.simulation;
  out.text("integrator", nameOf(s.integrator));
  out.text("safe_move", nameOf(s.safe_move));
  out.text("active_set", nameOf(s.active_set));
  out.text("spring_rule", nameOf(s.spring_rule));
  out.text("precision", nameOf(s.precision));
  if (s.dt_s > 0.0) {
    out.number("dt_s", s.dt_s);
  } else {
    out.text("dt_s", "auto");
  }
  out.number("dt_fraction", s.dt_fraction);
  out.flag("substeps", s.substeps);
  out.number("activation_radius_m", s.activation_radius_m);
  out.number("activation_threshold", s.activation_threshold);
  out.number("lifetime_s", s.lifetime_s);
  out.number("error_tolerance", s.error_tolerance);
  out.vector("gravity_m_s2", s.gravity_m_s2);
  out.list("pressures", s.pressures, [&out](const SurfacePressure& p) { writePressure(out, p); });
  out.number("max_tool_force_n", scene.max_tool_force_n);
}

void writeCamera(Writer& out, const CameraSettings& settings) {
  const Camera& c = settings.camera;
  out.item([&] {
    out.text("name", settings.name);
    out.text("projection", nameOf(c.projection));
    out.number("width", c.width);
    out.number("height", c.height);
    out.number("fx", c.fx);
    out.number("fy", c.fy);
    out.number("cx", c.cx);
    out.number("cy", c.cy);
    out.number("near_m", c.near_m);
    out.number("far_m", c.far_m);
    out.vector("position_m", c.T_volume_camera.position_m);
    out.numbers("orientation_xyzw", xyzw(c.T_volume_camera.orientation));
  });
}

void writeOptions(Writer& out, const RenderOptions& o) {
  out.number("slices", o.slices);
  out.number("step_m", o.step_m);
  out.number("shading", o.shading);
  out.number("specular", o.specular);
  out.flag("exact_boundary", o.exact_boundary);
  out.flag("adaptive", o.adaptive);
  out.flag("jitter", o.jitter);
  out.number("depth_threshold", o.depth_threshold);
  out.list("clip_planes", o.clip_planes, [&out](const ClipPlane& p) {
    out.row(std::array<double, 4>{p.normal.x(), p.normal.y(), p.normal.z(), p.offset_m});
  });
}

/// Everything but the cameras.
void writeSettings(Writer& out, const RenderSettings& r) {
  out.map("transfer_function", [&] {
    out.number("unit_distance_m", r.transfer_function.unit_distance_m);
    out.list("points", r.transfer_function.points, [&out](const TransferFunction::Point& p) {
      out.row(std::array<double, 5>{p.value, p.colour.x(), p.colour.y(), p.colour.z(), p.opacity});
    });
  });
  out.text("backend", nameOf(r.backend));
  writeOptions(out, r.options);
  out.flag("incremental", r.incremental);
  out.flag("progressive", r.progressive);
  out.colour("background", r.background);
  out.number("rate_hz", r.rate_hz);
  out.number("jpeg_quality", r.jpeg_quality);
}

void writeTool(Writer& out, const ToolConfig& t) {
  out.item([&] {
    out.text("id", t.id);
    out.text("kind", nameOf(t.kind));
    out.number("tissue_threshold", t.tissue_threshold);
    out.number("tip_radius_m", t.tip_radius_m);
    out.number("footprint_radius_m", t.footprint_radius_m);
    out.number("patch_radius_m", t.patch_radius_m);
    out.number("friction_coefficient", t.friction_coefficient);
    out.number("hold_steps", t.hold_steps);
    out.number("stiffness_n_m", t.coupling.stiffness_n_m);
    out.number("damping_n_s_m", t.coupling.damping_n_s_m);
    out.number("device_damping_n_s_m", t.coupling.device_damping_n_s_m);
    out.number("sample_period_s", t.coupling.sample_period_s);
    out.number("delay_s", t.coupling.delay_s);
    out.number("max_growth_n_s", t.safety.max_growth_n_s);
    out.number("ramp_in_s", t.safety.ramp_in_s);
    out.number("stale_after_s", t.safety.stale_after_s);
    out.number("drop_s", t.safety.drop_s);
    out.number("max_speed_m_s", t.safety.max_speed_m_s);
    out.number("blade_length_m", t.blade_length_m);
    out.number("blade_min_move_m", t.blade_min_move_m);
    out.number("cutting_drag_n_s_m", t.cutting_drag_n_s_m);
    out.number("cut_button", t.cut_button);
    out.number("grasp_reach_m", t.grasp_reach_m);
    out.number("slip_force_n", t.slip_force_n);
    out.number("grasp_button", t.grasp_button);
  });
}

std::vector<int> pressed(const Buttons& buttons) {
  std::vector<int> numbers;
  for (std::size_t b = 0; b < buttons.size(); ++b) {
    if (buttons[b])
      numbers.push_back(static_cast<int>(b));
  }
  return numbers;
}

void writeWayPoint(Writer& out, const WayPoint& p) {
  out.item([&] {
    out.number("time_s", p.time_s);
    out.vector("position_m", p.position_m);
    if (p.orientation)
      out.numbers("orientation_xyzw", xyzw(*p.orientation));
    out.numbers("buttons", pressed(p.buttons));
    out.flag("pass", p.pass);
  });
}

void writeDevice(Writer& out, const Scene& scene) {
  const VirtualDeviceConfig& d = scene.device;
  out.map("limits", [&] {
    out.number("max_force_n", d.limits.max_force_n);
    out.number("max_stiffness_n_m", d.limits.max_stiffness_n_m);
    out.number("max_damping_n_s_m", d.limits.max_damping_n_s_m);
    out.number("workspace_radius_m", d.limits.workspace_radius_m);
  });
  out.number("mass_kg", d.mass_kg);
  out.number("damping_n_s_m", d.damping_n_s_m);
  out.number("hand_stiffness_n_m", d.hand_stiffness_n_m);
  out.number("hand_damping_n_s_m", d.hand_damping_n_s_m);
  out.number("position_resolution_m", d.position_resolution_m);
  out.vector("workspace_centre_m", d.workspace_centre_m);
  out.number("swap_button", scene.swap_button);
  out.list("way_points", d.way_points, [&out](const WayPoint& p) { writeWayPoint(out, p); });
}

}  // namespace

std::string writeRendering(const RenderSettings& settings) {
  Writer out;
  out.item([&] { writeSettings(out, settings); });
  return out.text();
}

std::string writeScene(const Scene& scene) {
  Writer out;
  out.item([&] {
    out.number("format", 1);
    out.text("name", scene.name);
    out.map("volume", [&] {
      out.text("file", scene.volume.file);
      out.text("labels", scene.volume.labels);
      out.indices("begin", scene.volume.begin);
      out.indices("end", scene.volume.end);
      out.indices("stride", scene.volume.stride);
    });
    out.list("materials", scene.materials, [&out](const Material& m) { writeMaterial(out, m); });
    out.map("lattice", [&] { writeLattice(out, scene.lattice); });
    out.map("simulation", [&] { writeSimulation(out, scene); });
    out.map("incision", [&] {
      out.text("method", nameOf(scene.incision.method));
      out.number("rest_fraction", scene.incision.rest_fraction);
      out.number("opening_pressure_pa", scene.incision.opening_pressure_pa);
    });
    out.map("output", [&] {
      out.number("state_rate_hz", scene.output.state_rate_hz);
      out.number("patch_rate_hz", scene.output.patch_rate_hz);
      out.number("key_frame_interval_s", scene.output.key_frame_interval_s);
      out.number("checkpoint_interval_s", scene.output.checkpoint_interval_s);
    });
    out.map("rendering", [&] {
      writeSettings(out, scene.rendering);
      out.list("cameras", scene.rendering.cameras, [&out](const CameraSettings& c) { writeCamera(out, c); });
    });
    out.list("tools", scene.tools, [&out](const ToolConfig& t) { writeTool(out, t); });
    out.map("device", [&] { writeDevice(out, scene); });
  });
  return out.text();
}

}  // namespace soft_volume::core
