#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/WrenchStamped.h>
#include <soft_volume/ToolForce.h>
#include <soft_volume/ToolState.h>

#include <charconv>
#include <cmath>
#include <fstream>
#include <type_traits>

#include "soft_volume/common/error.h"
#include "soft_volume/replay/bag_export.h"

namespace soft_volume {
namespace {

/// Shortest text that reads back as the same number, whatever the locale.
std::string field(double value) {
  char text[32];
  return {text, std::to_chars(text, text + sizeof text, value).ptr};
}

template <typename Integer, typename = std::enable_if_t<std::is_integral_v<Integer>>>
std::string field(Integer value) {
  return std::to_string(value);
}

std::string field(const std::string& text) {
  if (text.find_first_of(",\"\n\r") == std::string::npos)
    return text;
  std::string quoted = "\"";
  for (const char c : text)
    quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
  return quoted + "\"";
}

std::string field(const geometry_msgs::Point& p) {
  return field(p.x) + "," + field(p.y) + "," + field(p.z);
}

std::string field(const geometry_msgs::Vector3& v) {
  return field(v.x) + "," + field(v.y) + "," + field(v.z);
}

std::string field(const geometry_msgs::Pose& pose) {
  const auto& q = pose.orientation;
  return field(pose.position) + "," + field(q.x) + "," + field(q.y) + "," + field(q.z) + "," + field(q.w);
}

/// Differences of stamps, without the digits that they do not have.
double rounded(double time_s) {
  return std::round(1e9 * time_s) / 1e9;
}

double length(const geometry_msgs::Vector3& v) {
  return std::hypot(v.x, v.y, v.z);
}

/// A table in a file.
class CsvFile {
 public:
  CsvFile(const std::string& path, const char* header) : path_(path), file_(path) { file_ << header << "\n"; }

  template <typename First, typename... Others>
  void add(const First& first, const Others&... others) {
    file_ << field(first);
    ((file_ << "," << field(others)), ...);
    file_ << "\n";
  }
  void close() {
    file_.close();
    if (!file_)
      throw core::FileError(path_ + ": cannot be written; check that the folder is writable and has space left");
  }

 private:
  std::string path_;
  std::ofstream file_;
};

void writeTissueForces(const RecordedRun& run, const std::string& path) {
  CsvFile csv(path,
              "time_s,tool,step,force_x_N,force_y_N,force_z_N,force_N,point_x_m,point_y_m,point_z_m,"
              "footprint_radius_m,hold_steps");
  for (const auto& recorded : run.messages<ToolForce>()) {
    const ToolForce& m = recorded.message;
    csv.add(rounded(run.timeOf(m.header.stamp)), m.tool_id, m.step, m.force, length(m.force), m.point,
            m.footprint_radius, m.hold_steps);
  }
  csv.close();
}

void writeDeviceForces(const RecordedRun& run, const std::string& path) {
  CsvFile csv(path, "time_s,topic,frame,force_x_N,force_y_N,force_z_N,force_N");
  for (const auto& recorded : run.messages<geometry_msgs::WrenchStamped>()) {
    const geometry_msgs::WrenchStamped& m = recorded.message;
    csv.add(rounded(run.timeOf(m.header.stamp)), recorded.topic, m.header.frame_id, m.wrench.force,
            length(m.wrench.force));
  }
  csv.close();
}

void writeDevicePoses(const RecordedRun& run, const std::string& path) {
  CsvFile csv(path, "time_s,topic,frame,x_m,y_m,z_m,qx,qy,qz,qw");
  for (const auto& recorded : run.messages<geometry_msgs::PoseStamped>()) {
    const geometry_msgs::PoseStamped& m = recorded.message;
    csv.add(rounded(run.timeOf(m.header.stamp)), recorded.topic, m.header.frame_id, m.pose);
  }
  csv.close();
}

void writeTools(const RecordedRun& run, const std::string& path) {
  CsvFile csv(path,
              "time_s,tool,x_m,y_m,z_m,qx,qy,qz,qw,velocity_x_m_s,velocity_y_m_s,velocity_z_m_s,in_contact,"
              "penetration_m,rest_x_m,rest_y_m,rest_z_m,gripping,device_force_x_N,device_force_y_N,device_force_z_N,"
              "coupling_stiffness_N_m,saturated,tripped,fault");
  for (const auto& recorded : run.messages<ToolState>()) {
    const ToolState& m = recorded.message;
    csv.add(rounded(run.timeOf(m.header.stamp)), m.tool_id, m.pose, m.twist.linear, m.in_contact, m.penetration,
            m.proxy.position, m.gripping, m.device_force, m.coupling_stiffness, m.saturated, m.tripped, m.fault);
  }
  csv.close();
}

void writeInputs(const RecordedRun& run, const std::string& path) {
  CsvFile csv(path, "time_s,step,order,topic,type,sequence,outcome,reason");
  constexpr const char* kOutcomes[] = {"applied", "refused", "noted"};
  for (const RecordedEntry& recorded : run.entries()) {
    const JournalEntry& e = recorded.entry;
    const std::string outcome = e.outcome < 3 ? kOutcomes[e.outcome] : std::to_string(e.outcome);
    csv.add(rounded(recorded.time_s), e.step, e.order, e.topic, e.type, e.sequence, outcome, e.reason);
  }
  csv.close();
}

void writeSimulation(const RecordedRun& run, const std::string& path) {
  CsvFile csv(path,
              "time_s,step,dt_s,integrator,real_time_factor,step_ms_median,step_ms_max,active_cells,active_vertices,"
              "max_displacement_m,max_speed_m_s,kinetic_energy_J,elastic_energy_J,cut_opening_m,faces_opened,parts,"
              "inputs_applied,inputs_refused,states_published");
  for (const SimulationStats& m : run.stats()) {
    csv.add(rounded(m.simulation_time), m.step, m.dt, m.integrator, m.real_time_factor, m.step_ms_median, m.step_ms_max,
            m.active_cells, m.active_vertices, m.max_displacement, m.max_speed, m.kinetic_energy, m.elastic_energy,
            m.cut_opening, m.faces_opened, m.parts, m.inputs_applied, m.inputs_refused, m.states_published);
  }
  csv.close();
}

void writeRendering(const RecordedRun& run, const std::string& path) {
  CsvFile csv(path,
              "time_s,step,revision,camera,backend,slices,polygons,cells,updated_pixels,transform_ms,bucket_ms,"
              "slice_ms,render_ms,total_ms,frames_skipped,renderer");
  for (const RecordedFrame& frame : run.frames()) {
    const RenderStats& m = frame.stats;
    csv.add(rounded(frame.time_s), m.step, m.revision, m.camera, m.backend, m.slices, m.polygons, m.cells,
            std::uint64_t(m.updated_width) * m.updated_height, m.transform_ms, m.bucket_ms, m.slice_ms, m.render_ms,
            m.total_ms, m.frames_skipped, m.renderer);
  }
  csv.close();
}

}  // namespace

ExportResult exportCsv(const RecordedRun& run, const std::string& folder) {
  ExportResult result;
  const auto write = [&](const char* name, void (*writer)(const RecordedRun&, const std::string&)) {
    writer(run, folder + "/" + name);
    ++result.files;
  };
  write("tissue_force.csv", writeTissueForces);
  write("device_force.csv", writeDeviceForces);
  write("device_pose.csv", writeDevicePoses);
  write("tool.csv", writeTools);
  write("inputs.csv", writeInputs);
  write("simulation.csv", writeSimulation);
  write("rendering.csv", writeRendering);
  result.states = run.states().size();
  return result;
}

}  // namespace soft_volume
