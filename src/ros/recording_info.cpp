#include "soft_volume/ros/recording_info.h"

#include <ros/common.h>
#include <ros/param.h>
#include <soft_volume/GridPatch.h>
#include <soft_volume/GridState.h>
#include <soft_volume/GridTopology.h>
#include <soft_volume/RenderStats.h>
#include <soft_volume/Scene.h>
#include <soft_volume/SimulationCheckpoint.h>
#include <soft_volume/SimulationJournal.h>
#include <soft_volume/SimulationStats.h>
#include <soft_volume/ToolCut.h>
#include <soft_volume/ToolForce.h>
#include <soft_volume/ToolGrip.h>
#include <soft_volume/ToolState.h>
#include <soft_volume/Volume.h>
#include <yaml-cpp/yaml.h>

#include <filesystem>
#include <fstream>
#include <iterator>

#include "soft_volume/common/hash.h"

namespace soft_volume {
namespace {

using XmlRpc::XmlRpcValue;

/// Beyond this a file is data, not settings; the volume is in the bag itself.
constexpr std::uintmax_t kLargestFile = 64 << 20;

void addFile(const std::string& path, RecordingInfo& info) {
  std::error_code error;
  const bool bag = std::filesystem::path(path).extension() == ".bag";
  if (bag || path.empty() || path[0] != '/' || !std::filesystem::is_regular_file(path, error) ||
      std::filesystem::file_size(path, error) > kLargestFile || error)
    return;
  std::ifstream file(path, std::ios::binary);
  const std::vector<char> content{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  info.files.push_back(path);
  info.file_hashes.push_back(core::hashToString(core::hashVector(content)));
}

/// As YAML; files that texts name are added to `info`.
void write(XmlRpcValue& value, YAML::Emitter& out, RecordingInfo& info) {
  switch (value.getType()) {
    case XmlRpcValue::TypeStruct:
      out << YAML::BeginMap;
      for (auto& member : value) {
        out << YAML::Key << member.first << YAML::Value;
        write(member.second, out, info);
      }
      out << YAML::EndMap;
      break;
    case XmlRpcValue::TypeArray:
      out << YAML::BeginSeq;
      for (int n = 0; n < value.size(); ++n)
        write(value[n], out, info);
      out << YAML::EndSeq;
      break;
    case XmlRpcValue::TypeBoolean:
      out << static_cast<bool>(value);
      break;
    case XmlRpcValue::TypeInt:
      out << static_cast<int>(value);
      break;
    case XmlRpcValue::TypeDouble:
      out << static_cast<double>(value);
      break;
    case XmlRpcValue::TypeString:
      out << static_cast<std::string>(value);
      addFile(static_cast<std::string>(value), info);
      break;
    default:
      out << YAML::Null;  // dates and binary data, which no launch file makes
  }
}

template <typename Message>
void addDefinition(RecordingInfo& info) {
  info.types.push_back(ros::message_traits::DataType<Message>::value());
  info.definitions.push_back(ros::message_traits::MD5Sum<Message>::value());
}

template <typename... Messages>
void addDefinitions(RecordingInfo& info) {
  (addDefinition<Messages>(info), ...);
}

std::string processorName() {
  std::ifstream file("/proc/cpuinfo");
  for (std::string line; std::getline(file, line);) {
    const std::size_t colon = line.find(": ");
    if (line.compare(0, 10, "model name") == 0 && colon != std::string::npos)
      return line.substr(colon + 2);
  }
  return "";
}

void addParameters(RecordingInfo& info) {
  XmlRpcValue all;
  if (!ros::param::get("/", all) || all.getType() != XmlRpcValue::TypeStruct)
    return;
  YAML::Emitter out;
  out.SetDoublePrecision(17);
  write(all, out, info);
  info.parameters = out.c_str();
}

}  // namespace

RecordingInfo makeRecordingInfo() {
  RecordingInfo info;
  info.header.stamp.fromNSec(ros::WallTime::now().toNSec());
  info.package_version = SOFT_VOLUME_VERSION;
  info.ros_version = std::to_string(ROS_VERSION_MAJOR) + "." + std::to_string(ROS_VERSION_MINOR) + "." +
                     std::to_string(ROS_VERSION_PATCH);
  info.compiler = __VERSION__;
  info.processor = processorName();
  addDefinitions<Scene, Volume, GridTopology, GridState, GridPatch, SimulationJournal, SimulationCheckpoint,
                 SimulationStats, RenderStats, ToolForce, ToolCut, ToolGrip, ToolState>(info);
  addParameters(info);
  return info;
}

}  // namespace soft_volume
