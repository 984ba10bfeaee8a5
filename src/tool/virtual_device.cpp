#include "soft_volume/tool/virtual_device.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <iterator>

#include "range_check.h"

namespace soft_volume::core {
namespace {

const char* const kOwner = "virtual device";

struct NamedMechanics {
  const char* name;
  DeviceMechanics mechanics;
};

// The makers of the parallel devices state neither apparent mass nor friction: both are assumptions, by the size of
// their moving parts.
constexpr const char* kSensAble = "data sheet of the maker (SensAble, later 3D Systems)";
constexpr const char* kForceDimension = "resolution and rate: data sheet of the maker; mass and friction assumed";
constexpr const char* kNovint = "resolution (400 dpi) and rate: the maker; mass and friction assumed";
constexpr NamedMechanics kMechanics[] = {
    {"touch", {0.045, 0.26, 55e-6, 1000.0, kSensAble}},      {"omni", {0.045, 0.26, 55e-6, 1000.0, kSensAble}},
    {"desktop", {0.045, 0.06, 23e-6, 1000.0, kSensAble}},    {"premium_1_5", {0.075, 0.04, 30e-6, 1000.0, kSensAble}},
    {"premium_3_0", {0.159, 0.2, 20e-6, 1000.0, kSensAble}}, {"omega_7", {0.25, 0.1, 10e-6, 4000.0, kForceDimension}},
    {"falcon", {0.25, 0.3, 64e-6, 1000.0, kNovint}}};

void add(double work_j, PortWork& port) {
  port.into_device_j += std::max(0.0, work_j);
  port.out_of_device_j += std::max(0.0, -work_j);
}

void checkWayPoint(const VirtualDeviceConfig& config, std::size_t i) {
  const std::string owner = std::string(kOwner) + ": way-point " + std::to_string(i + 1);
  const WayPoint& point = config.way_points[i];
  checkRange(owner + ": time_s", point.time_s, 0.0, 86400.0);
  if (i > 0 && point.time_s <= config.way_points[i - 1].time_s) {
    throw SceneError(owner + ": time_s must be later than that of the way-point before");
  }
  const double distance = (point.position_m - config.workspace_centre_m).norm();
  checkRange(owner + ": distance of position_m from the workspace's centre in m", distance, 0.0,
             config.limits.workspace_radius_m);
  if (point.orientation)
    checkRange(owner + ": norm of the orientation", point.orientation->norm(), 0.99, 1.01);
}

/// A cubic on [0, 1] with given values and slopes at its ends.
template <typename T>
struct Hermite {
  T from;
  T to;
  T from_slope;
  T to_slope;

  T value(double u) const {
    const double v = 1.0 - u;
    return (1.0 + 2.0 * u) * v * v * from + u * v * v * from_slope + u * u * (3.0 - 2.0 * u) * to -
           u * u * v * to_slope;
  }
  T derivative(double u) const {
    const double v = 1.0 - u;
    return 6.0 * u * v * (to - from) + v * (1.0 - 3.0 * u) * from_slope + u * (3.0 * u - 2.0) * to_slope;
  }
};

}  // namespace

DeviceMechanics deviceMechanics(const std::string& name) {
  deviceLimits(name);  // refuses unknown names
  const auto* found = std::find_if(std::begin(kMechanics), std::end(kMechanics),
                                   [&](const NamedMechanics& device) { return name == device.name; });
  return found->mechanics;
}

void VirtualDeviceConfig::validate() const {
  const std::string owner = kOwner;
  limits.validate(owner);
  checkRange(owner + ": mass_kg", mass_kg, 0.005, 5.0);
  checkRange(owner + ": damping_n_s_m", damping_n_s_m, 0.0, 100.0);
  checkRange(owner + ": friction_n", friction_n, 0.0, 10.0);
  checkRange(owner + ": step_s", step_s, 1e-5, 1e-3);
  checkRange(owner + ": hand_stiffness_n_m", hand_stiffness_n_m, 1.0, mass_kg / (step_s * step_s));
  checkRange(owner + ": hand_damping_n_s_m", hand_damping_n_s_m, 0.0, 100.0);
  checkRange(owner + ": position_resolution_m", position_resolution_m, 0.0, 0.001);
  if (!isFinite(workspace_centre_m))
    throw SceneError(owner + ": workspace_centre_m is not finite; give three numbers");
  if (way_points.empty())
    throw SceneError(owner + ": the script has no way-point; give at least one");
  for (std::size_t i = 0; i < way_points.size(); ++i)
    checkWayPoint(*this, i);
}

VirtualDevice::VirtualDevice(const VirtualDeviceConfig& config) : config_((config.validate(), config)) {
  Quaternion orientation = Quaternion::Identity();
  for (WayPoint& point : config_.way_points) {
    orientation = point.orientation.value_or(orientation).normalized();
    point.orientation = orientation;
  }
  position_m_ = config_.way_points.front().position_m;
}

void VirtualDevice::setServoForce(const Vector3& force_n) {
  const double norm = force_n.norm();
  servo_step_ = steps_;
  if (!std::isfinite(norm)) {
    servo_force_n_.setZero();
  } else {
    servo_force_n_ = norm > config_.limits.max_force_n ? Vector3(config_.limits.max_force_n / norm * force_n) : force_n;
  }
}

Vector3 VirtualDevice::renderedForce_n() const {
  const bool timed_out = double(steps_ - servo_step_) * config_.step_s > kServoTimeout_s + 0.5 * config_.step_s;
  return timed_out ? Vector3(Vector3::Zero()) : servo_force_n_;
}

// The last way-point whose time has come; the first one before that.
std::size_t VirtualDevice::wayPointAt(double time_s) const {
  const auto& points = config_.way_points;
  const auto next = std::upper_bound(points.begin(), points.end(), time_s,
                                     [](double t, const WayPoint& point) { return t < point.time_s; });
  return next == points.begin() ? 0 : std::size_t(next - points.begin()) - 1;
}

bool VirtualDevice::passes(std::size_t way_point) const {
  const auto& points = config_.way_points;
  return points[way_point].pass && way_point > 0 && way_point + 1 < points.size();
}

// The slope of the parabola through a way-point and its neighbours; zero where the hand rests.
Vector3 VirtualDevice::velocityAt(std::size_t way_point) const {
  if (!passes(way_point))
    return Vector3::Zero();
  const WayPoint* point = &config_.way_points[way_point];
  const double before_s = point[0].time_s - point[-1].time_s;
  const double after_s = point[1].time_s - point[0].time_s;
  const Vector3 before = (point[0].position_m - point[-1].position_m) / before_s;
  const Vector3 after = (point[1].position_m - point[0].position_m) / after_s;
  return (after_s * before + before_s * after) / (before_s + after_s);
}

// Between two way-points, at least one of which the hand passes.
VirtualDevice::Wanted VirtualDevice::passingBetween(std::size_t i, double u) const {
  const WayPoint& from = config_.way_points[i];
  const WayPoint& to = config_.way_points[i + 1];
  const double duration = to.time_s - from.time_s;
  const Hermite<Vector3> way{from.position_m, to.position_m, duration * velocityAt(i), duration * velocityAt(i + 1)};
  const Hermite<double> turn{0.0, 1.0, passes(i) ? 1.0 : 0.0, passes(i + 1) ? 1.0 : 0.0};
  return {way.value(u), way.derivative(u) / duration, from.orientation->slerp(turn.value(u), *to.orientation)};
}

// Minimum jerk from rest to rest: s(u) = 10 u^3 - 15 u^4 + 6 u^5 (Flash and Hogan, 1985).
VirtualDevice::Wanted VirtualDevice::wantedAt(double time_s) const {
  const std::size_t i = wayPointAt(time_s);
  const WayPoint& from = config_.way_points[i];
  if (i + 1 == config_.way_points.size() || (time_s <= from.time_s && !passes(i)))
    return {from.position_m, Vector3::Zero(), *from.orientation};
  const WayPoint& to = config_.way_points[i + 1];
  const double duration = to.time_s - from.time_s;
  const double u = (time_s - from.time_s) / duration;
  if (passes(i) || passes(i + 1))
    return passingBetween(i, u);
  const double s = u * u * u * (10.0 + u * (6.0 * u - 15.0));
  const double ds = 30.0 * u * u * (1.0 - u) * (1.0 - u) / duration;
  const Vector3 way = to.position_m - from.position_m;
  return {from.position_m + s * way, ds * way, from.orientation->slerp(s, *to.orientation)};
}

void VirtualDevice::setGrip(double stiffness_n_m, double damping_n_s_m) {
  assert(stiffness_n_m >= 0.0 && stiffness_n_m <= config_.mass_kg / (config_.step_s * config_.step_s));
  assert(damping_n_s_m >= 0.0);
  config_.hand_stiffness_n_m = stiffness_n_m;
  config_.hand_damping_n_s_m = damping_n_s_m;
}

// Friction takes at most the momentum that there is: below that the device sticks.
Vector3 VirtualDevice::velocityAfter(const Vector3& force_n) const {
  const double inverse_mass = config_.step_s / config_.mass_kg;
  const double damping = config_.damping_n_s_m + config_.hand_damping_n_s_m;
  const Vector3 free = (velocity_m_s_ + inverse_mass * force_n) / (1.0 + inverse_mass * damping);
  if (config_.friction_n == 0.0)
    return free;
  const double lost_m_s = inverse_mass * config_.friction_n / (1.0 + inverse_mass * damping);
  const double speed = free.norm();
  return speed <= lost_m_s ? Vector3(Vector3::Zero()) : Vector3((1.0 - lost_m_s / speed) * free);
}

void VirtualDevice::step() {
  const Wanted wanted = wantedAt(time_s() + config_.step_s);
  const Vector3 motor_n = renderedForce_n();
  const Vector3 hand_n =
      config_.hand_stiffness_n_m * (wanted.position_m - position_m_) + config_.hand_damping_n_s_m * wanted.velocity_m_s;
  const Vector3 before_m = position_m_;
  velocity_m_s_ = velocityAfter(hand_n + motor_n);
  const Vector3 damped_n = hand_n - config_.hand_damping_n_s_m * velocity_m_s_;
  position_m_ += config_.step_s * velocity_m_s_;
  stayInWorkspace();
  add(damped_n.dot(position_m_ - before_m), hand_work_);
  add(motor_n.dot(position_m_ - before_m), motor_work_);
  ++steps_;
}

void VirtualDevice::stayInWorkspace() {
  const Vector3 from_centre = position_m_ - config_.workspace_centre_m;
  const double distance = from_centre.norm();
  if (distance <= config_.limits.workspace_radius_m)
    return;
  const Vector3 outward = from_centre / distance;
  position_m_ = config_.workspace_centre_m + config_.limits.workspace_radius_m * outward;
  velocity_m_s_ -= std::max(0.0, velocity_m_s_.dot(outward)) * outward;
}

Pose VirtualDevice::pose() const {
  Pose pose;
  pose.position_m = position_m_;
  const double resolution = config_.position_resolution_m;
  if (resolution > 0.0) {
    for (double& x : pose.position_m)
      x = resolution * std::round(x / resolution);
  }
  pose.orientation = wantedAt(time_s()).orientation;
  return pose;
}

Buttons VirtualDevice::buttons() const {
  const std::size_t i = wayPointAt(time_s());
  return time_s() < config_.way_points[i].time_s ? Buttons() : config_.way_points[i].buttons;
}

Vector3 VirtualDevice::handForce_n() const {
  const Wanted wanted = wantedAt(time_s());
  return config_.hand_stiffness_n_m * (position_m_ - wanted.position_m) +
         config_.hand_damping_n_s_m * (velocity_m_s_ - wanted.velocity_m_s);
}

}  // namespace soft_volume::core
