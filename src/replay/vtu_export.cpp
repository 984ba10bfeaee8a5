#include <soft_volume/ToolForce.h>
#include <soft_volume/ToolState.h>

#include <cstdio>
#include <filesystem>
#include <map>
#include <utility>

#include "soft_volume/common/error.h"
#include "soft_volume/replay/bag_export.h"
#include "vtu_file.h"

namespace soft_volume {
namespace {

void makeFolder(const std::string& path) {
  std::error_code error;
  std::filesystem::create_directories(path, error);
  if (error)
    throw core::FileError(path + ": the folder cannot be made: " + error.message());
}

/// tissue/tissue_00001200.vtu; a number of its own where an incision gave one step several states.
std::string fileName(const char* series, const RecordedState& state, bool again) {
  char name[96];
  std::snprintf(name, sizeof name, "%s/%s_%08llu", series, series, static_cast<unsigned long long>(state.step));
  return name + (again ? "_" + std::to_string(state.revision) : std::string()) + ".vtu";
}

/// What every tool did last, while time goes on.
class ToolMotion {
 public:
  explicit ToolMotion(const RecordedRun& run)
      : run_(&run), states_(run.messages<ToolState>()), forces_(run.messages<ToolForce>()) {}

  void advanceTo(double time_s) {
    for (; next_state_ < states_.size() && timeOf(states_[next_state_]) <= time_s; ++next_state_)
      tools_[states_[next_state_].message.tool_id].state = &states_[next_state_].message;
    for (; next_force_ < forces_.size() && timeOf(forces_[next_force_]) <= time_s; ++next_force_)
      tools_[forces_[next_force_].message.tool_id].force = &forces_[next_force_].message;
  }

  /// Tip and resting place of each tool.
  VtuGrid grid() const {
    std::vector<core::Vector3f> points;
    std::vector<std::uint32_t> numbers;
    std::vector<std::uint8_t> rest_places;
    std::vector<float> on_tissue;
    std::vector<float> on_device;
    std::uint32_t number = 0;
    for (const auto& [name, tool] : tools_) {
      if (tool.state == nullptr)
        continue;
      for (const geometry_msgs::Point& p : {tool.state->pose.position, tool.state->proxy.position}) {
        rest_places.push_back(points.size() % 2 == 0 ? 0 : 1);
        points.emplace_back(float(p.x), float(p.y), float(p.z));
        numbers.push_back(number);
        append(on_device, tool.state->device_force);
        append(on_tissue, tool.force != nullptr ? tool.force->force : geometry_msgs::Vector3());
      }
      ++number;
    }
    VtuGrid grid = pointGrid(std::move(points));
    grid.point_arrays = {{"tool", 1, std::move(numbers)},
                         {"at_rest_place", 1, std::move(rest_places)},
                         {"force_on_tissue", 3, std::move(on_tissue)},
                         {"device_force", 3, std::move(on_device)}};
    return grid;
  }

 private:
  struct Last {
    const ToolState* state = nullptr;
    const ToolForce* force = nullptr;
  };

  template <typename Recorded>
  double timeOf(const Recorded& recorded) const {
    return run_->timeOf(recorded.message.header.stamp);
  }
  static void append(std::vector<float>& numbers, const geometry_msgs::Vector3& v) {
    for (const double x : {v.x, v.y, v.z})
      numbers.push_back(float(x));
  }

  const RecordedRun* run_;
  std::vector<RecordedMessage<ToolState>> states_;
  std::vector<RecordedMessage<ToolForce>> forces_;
  std::size_t next_state_ = 0;
  std::size_t next_force_ = 0;
  std::map<std::string, Last> tools_;
};

std::string materialNames(const RecordedRun& run) {
  std::string names = "materials:";
  const core::Scene scene = run.scene();
  for (std::size_t n = 0; n < scene.materials.size(); ++n)
    names += " " + std::to_string(n) + " " + scene.materials[n].name;
  return names;
}

}  // namespace

ExportResult exportVtu(const RecordedRun& run, const std::string& folder, const ReplayProgress& progress) {
  makeFolder(folder + "/tissue");
  makeFolder(folder + "/tools");
  ExportResult result;
  ToolMotion tools(run);
  std::vector<VtuSeriesEntry> tissue_files;
  std::vector<VtuSeriesEntry> tool_files;
  std::size_t unreadable = 0;
  const auto& states = run.states();
  for (std::size_t n = 0; n < states.size(); ++n, progress(double(n), double(states.size()))) {
    const auto topology = run.topology(states[n].revision);
    if (topology == nullptr || !run.hasPositions(n)) {
      ++unreadable;
      continue;
    }
    const bool again = n > 0 && states[n - 1].step == states[n].step;
    tissue_files.push_back({states[n].time_s, fileName("tissue", states[n], again)});
    writeVtu(folder + "/" + tissue_files.back().file, deformedGrid(*topology, run.positions(n)));
    tools.advanceTo(states[n].time_s);
    tool_files.push_back({states[n].time_s, fileName("tools", states[n], again)});
    writeVtu(folder + "/" + tool_files.back().file, tools.grid());
    ++result.states;
  }
  if (unreadable > 0)
    result.notes.push_back(std::to_string(unreadable) + " states were left out: the key frame or the topology that " +
                           "they refer to is not in the bag");
  writePvd(folder + "/tissue.pvd", tissue_files, materialNames(run));
  writePvd(folder + "/tools.pvd", tool_files, "tools by their number, in the order of their names");
  result.files = tissue_files.size() + tool_files.size() + 2;
  return result;
}

}  // namespace soft_volume
