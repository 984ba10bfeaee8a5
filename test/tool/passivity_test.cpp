#include "soft_volume/tool/passivity.h"

#include <gtest/gtest.h>

#include <algorithm>

namespace soft_volume::core {
namespace {

constexpr double kPeriod = 0.001;
constexpr int kSubsteps = 50;
constexpr double kMass = 0.045;
constexpr double kPull = 1.0;  // N, constant, towards the wall

/// A mass without any damping that falls onto a sampled spring at z = 0, which may move; forces come `delay` ticks
/// late.
struct FallingMass {
  double stiffness_n_m = 66.0;
  double max_damping_n_s_m = 0.2;  // of the controller
  int delay = 1;

  double z = 0.005;
  double v = 0.0;
  double wall_z = 0.0;
  double wall_speed = 0.0;
  double time_s = 0.0;
  std::array<double, 8> coming{};
  PassivityControl control{delay * kPeriod};
  double motor_work_j = 0.0;  // on the device

  void restart() { control = PassivityControl(delay * kPeriod); }
  double energy() const { return 0.5 * kMass * v * v + kPull * z; }
  void tick() {
    time_s += kPeriod;
    wall_z += kPeriod * wall_speed;
    const double stretch = std::max(0.0, wall_z - z);
    const Vector3 speed(0.0, 0.0, v - wall_speed);
    double force = 0.0;
    if (stretch > 0.0)
      force = std::max(0.0, stiffness_n_m * stretch - control.damping(speed, max_damping_n_s_m) * speed.z());
    PassivityControl::Tick tick;
    tick.time_s = tick.measured_s = time_s;
    tick.device_m.z() = z;
    tick.stretch_m.z() = stretch;
    tick.surface_velocity_m_s.z() = wall_speed;
    tick.stiffness_n_m = stretch > 0.0 ? stiffness_n_m : 0.0;
    tick.force_n.z() = force;
    control.observe(tick);
    coming[std::size_t(delay)] = force;
    fall(coming[0]);
    std::rotate(coming.begin(), coming.begin() + 1, coming.end());
  }
  void fall(double force) {
    const double dt = kPeriod / kSubsteps;
    for (int n = 0; n < kSubsteps; ++n) {
      const double half = v + 0.5 * dt * (force - kPull) / kMass;
      z += dt * half;
      v = half + 0.5 * dt * (force - kPull) / kMass;
      motor_work_j += force * dt * half;
    }
  }
};

TEST(PassivityControlTest, ASampledSpringMakesEnergyAndTheControllerTakesItOut) {
  for (const int delay : {0, 1, 2}) {
    FallingMass free;
    free.max_damping_n_s_m = 0.0;
    FallingMass held;
    held.max_damping_n_s_m = 0.5;
    for (FallingMass* mass : {&free, &held}) {
      mass->delay = delay;
      mass->restart();
    }
    const double start = free.energy();
    double most = 0.0;
    for (int n = 0; n < 3000; ++n) {
      free.tick();
      held.tick();
      most = std::max(most, held.energy());
    }
    EXPECT_GT(free.energy(), 1.2 * start) << delay;
    EXPECT_LT(most, 1.06 * start) << delay;
  }
}

TEST(PassivityControlTest, SeesTheEnergyThatTheMotorsMake) {
  FallingMass mass;
  mass.max_damping_n_s_m = 0.0;
  mass.restart();
  while (mass.z > 0.0)
    mass.tick();
  while (mass.z <= 0.0)  // one bounce, over within some tens of milliseconds
    mass.tick();
  for (int n = 0; n < 2; ++n)
    mass.tick();  // forces under way
  EXPECT_GT(mass.motor_work_j, 1e-4);
  EXPECT_NEAR(mass.control.energy(), mass.motor_work_j, 0.15 * mass.motor_work_j);
}

TEST(PassivityControlTest, WhatTissueReleasesIsNotTakenForMadeEnergy) {
  FallingMass mass;
  mass.restart();
  // At rest on the spring; then the wall comes up and lifts the mass.
  mass.z = -kPull / mass.stiffness_n_m;
  mass.coming.fill(kPull);
  for (int n = 0; n < 200; ++n)
    mass.tick();
  const double before = mass.motor_work_j;
  mass.wall_speed = 0.05;
  for (int n = 0; n < 400; ++n)
    mass.tick();
  const double released = mass.motor_work_j - before;
  EXPECT_GT(released, 0.015);  // 1 N over 20 mm
  EXPECT_LT(std::abs(mass.control.energy()), 0.02 * released);
}

TEST(PassivityControlTest, LossesDoNotPayForWhatComesLater) {
  PassivityControl control(0.0);
  PassivityControl::Tick tick;
  tick.stiffness_n_m = 100.0;
  tick.stretch_m.z() = 0.01;
  tick.force_n.z() = 1.0;
  for (int n = 0; n < 200; ++n) {  // dragged under friction: the device works, the spring keeps its length
    tick.time_s = tick.measured_s = n * kPeriod;
    tick.device_m.z() = -n * 1e-4;
    control.observe(tick);
  }
  EXPECT_LT(control.energy(), -1e-3);
  EXPECT_EQ(control.damping(Vector3(0.0, 0.0, 0.1), 1.0), 0.0);
  for (int n = 200; n < 600; ++n) {
    tick.time_s = tick.measured_s = n * kPeriod;
    control.observe(tick);
  }
  EXPECT_GT(control.energy(), -1e-5);
}

TEST(PassivityControlTest, AGapInTimeStartsItOver) {
  PassivityControl control(0.0);
  PassivityControl::Tick tick;
  tick.force_n.z() = 1.0;
  control.observe(tick);
  tick.time_s = tick.measured_s = 5.0;
  tick.device_m.z() = 1.0;
  control.observe(tick);
  EXPECT_EQ(control.energy(), 0.0);
}

}  // namespace
}  // namespace soft_volume::core
