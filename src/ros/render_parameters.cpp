#include "render_parameters.h"

#include <dynamic_reconfigure/server.h>

#include <array>
#include <charconv>
#include <utility>

#include "soft_volume/common/error.h"
#include "soft_volume/render/option_names.h"

namespace soft_volume {
namespace {

constexpr char kTransferFunction[] = "transfer_function";

/// Keys whose text is a value of its own; the text of the others is YAML.
bool isText(const std::string& key) {
  return key == "backend" || key == kTransferFunction;
}

std::string quoted(const std::string& text) {
  std::string result = "\"";
  for (const char c : text)
    result += c == '"' || c == '\\' ? std::string("\\") + c : std::string(1, c);
  return result + "\"";
}

/// The shortest text that reads back as the same number.
template <typename Number>
std::string yamlOf(Number value) {
  std::array<char, 32> text{};
  return {text.data(), std::to_chars(text.data(), text.data() + text.size(), value).ptr};
}

/// "[A, B, ...]"
template <typename Items, typename ToText>
std::string listOf(const Items& items, const ToText& toText) {
  std::string list;
  for (const auto& item : items)
    list += (list.empty() ? "" : ", ") + toText(item);
  return "[" + list + "]";
}

/// Text of a parameter; lists may be nested.
std::string textOf(const std::string& key, XmlRpc::XmlRpcValue& value) {
  switch (value.getType()) {
    case XmlRpc::XmlRpcValue::TypeBoolean:
      return static_cast<bool>(value) ? "true" : "false";
    case XmlRpc::XmlRpcValue::TypeInt:
      return yamlOf(static_cast<int>(value));
    case XmlRpc::XmlRpcValue::TypeDouble:
      return yamlOf(static_cast<double>(value));
    case XmlRpc::XmlRpcValue::TypeString:
      return static_cast<std::string>(value);
    case XmlRpc::XmlRpcValue::TypeArray:
      break;
    default:
      throw core::InputError("the parameter " + key + " is of a wrong type");
  }
  std::string list;
  for (int n = 0; n < value.size(); ++n)
    list += (n > 0 ? ", " : "") + textOf(key, value[n]);
  return "[" + list + "]";
}

/// Every value of a configuration as text, by name.
std::map<std::string, std::string> valuesOf(const RendererConfig& config) {
  dynamic_reconfigure::Config message;
  config.__toMessage__(message);
  std::map<std::string, std::string> values;
  for (const auto& p : message.bools)
    values[p.name] = p.value != 0 ? "true" : "false";
  for (const auto& p : message.ints)
    values[p.name] = std::to_string(p.value);
  for (const auto& p : message.doubles)
    values[p.name] = yamlOf(p.value);
  for (const auto& p : message.strs)
    values[p.name] = p.value;
  return values;
}

std::string joined(const std::map<std::string, std::string>& values) {
  std::string text;
  for (const auto& value : values)
    text += value.first + ": " + (isText(value.first) ? quoted(value.second) : value.second) + "\n";
  return text.empty() ? "{}" : text;
}

std::string yamlOf(const core::ClipPlane& p) {
  return listOf(std::array<double, 4>{p.normal.x(), p.normal.y(), p.normal.z(), p.offset_m}, yamlOf<double>);
}

RendererConfig configOf(const core::RenderSettings& settings) {
  RendererConfig config;
  config.backend = core::nameOf(settings.backend);
  config.slices = settings.options.slices;
  config.step_m = settings.options.step_m;
  config.shading = settings.options.shading;
  config.specular = settings.options.specular;
  config.exact_boundary = settings.options.exact_boundary;
  config.adaptive = settings.options.adaptive;
  config.jitter = settings.options.jitter;
  config.depth_threshold = settings.options.depth_threshold;
  config.clip_planes = listOf(settings.options.clip_planes, [](const core::ClipPlane& p) { return yamlOf(p); });
  const core::Vector3f& b = settings.background;
  config.background = listOf(std::array<float, 3>{b.x(), b.y(), b.z()}, yamlOf<float>);
  config.incremental = settings.incremental;
  config.progressive = settings.progressive;
  config.rate_hz = settings.rate_hz;
  config.jpeg_quality = settings.jpeg_quality;
  return config;
}

}  // namespace

/// A transfer function is shown by its name, and the scene's own by none.
RenderParameters::Config RenderParameters::shownOf(const core::RenderSettings& settings, const Overrides& overrides) {
  Config config = configOf(settings);
  const auto named = overrides.find(kTransferFunction);
  config.transfer_function = named == overrides.end() ? "" : named->second;
  return config;
}

RenderParameters::RenderParameters(const ros::NodeHandle& private_node, IncidentLog& incidents, Apply apply)
    : incidents_(&incidents), apply_(std::move(apply)) {
  for (const auto& value : valuesOf(RendererConfig::__getDefault__())) {
    XmlRpc::XmlRpcValue parameter;
    if (private_node.getParam(value.first, parameter))
      overrides_[value.first] = textOf(value.first, parameter);
  }
  if (overrides_.count(kTransferFunction) != 0 && overrides_[kTransferFunction].empty())
    overrides_.erase(kTransferFunction);
  shown_ = shownOf(apply_(yaml()), overrides_);
  server_ = std::make_unique<dynamic_reconfigure::Server<Config>>(mutex_, private_node);
  server_->updateConfig(shown_);
  server_->setCallback([this](Config& wanted, std::uint32_t) { hear(wanted); });
}

RenderParameters::~RenderParameters() = default;

std::string RenderParameters::yaml() const {
  const boost::recursive_mutex::scoped_lock lock(mutex_);
  return joined(overrides_);
}

void RenderParameters::show(const core::RenderSettings& settings) {
  const boost::recursive_mutex::scoped_lock lock(mutex_);
  shown_ = shownOf(settings, overrides_);
  server_->updateConfig(shown_);
}

/// What differs from what is shown is what somebody changed.
void RenderParameters::hear(Config& wanted) {
  Overrides changed = overrides_;
  const auto shown = valuesOf(shown_);
  for (const auto& value : valuesOf(wanted)) {
    if (shown.at(value.first) != value.second)
      changed[value.first] = value.second;
  }
  if (wanted.transfer_function.empty())
    changed.erase(kTransferFunction);
  try {
    if (changed != overrides_)
      shown_ = shownOf(apply_(joined(changed)), changed);
    overrides_ = changed;
  } catch (const core::Error& error) {
    incidents_->report("parameters", error.what());
  }
  wanted = shown_;
}

}  // namespace soft_volume
