#pragma once

#include <memory>

#include "small_scene.h"
#include "soft_volume/messages/conversions.h"

namespace soft_volume {

constexpr std::uint64_t kSession = 77;

inline std::unique_ptr<core::Session> makeSession(std::uint64_t id = kSession, bool with_labels = false) {
  const auto volume = core::smallVolume();
  return std::make_unique<core::Session>(core::smallScene(), volume, with_labels ? volume : nullptr, id, 1);
}

/// A push down onto the middle of the small scene's block.
inline ToolForce pushMessage(std::uint64_t sequence) {
  ToolForce message;
  message.session = kSession;
  message.revision = 1;
  message.tool_id = "probe";
  message.sequence = sequence;
  message.hold_steps = 20;
  message.force.x = 0.02;
  message.force.z = -0.3;
  message.point.x = message.point.y = 0.024;
  message.point.z = 0.031;
  message.footprint_radius = 0.016;
  return message;
}

/// A vertical blade that sweeps through the middle of the block.
inline ToolCut cutMessage(std::uint64_t sequence) {
  ToolCut message;
  message.session = kSession;
  message.revision = 1;
  message.tool_id = "scalpel";
  message.sequence = sequence;
  const double x = 0.0235;
  for (const core::Vector3& p : {core::Vector3(x, 0.01, 0.012), core::Vector3(x, 0.01, 0.05),
                                 core::Vector3(x, 0.04, 0.05), core::Vector3(x, 0.04, 0.012)}) {
    message.quads.push_back(toPoint(p));
  }
  return message;
}

/// Jaws that close on the middle of the block's top.
inline ToolGrip gripMessage(std::uint64_t sequence) {
  ToolGrip message;
  message.session = kSession;
  message.revision = 1;
  message.tool_id = "probe";
  message.sequence = sequence;
  message.hold_steps = 30;
  message.closed = 1;
  message.point = toPoint({0.024, 0.024, 0.031});
  message.radius = 0.009;
  message.pose = toPose({core::Vector3(0.024, 0.024, 0.031), core::Quaternion(0.8, 0.0, 0.6, 0.0)});
  return message;
}

/// A session that was pushed and cut, with a force and a grip in effect, in its second time step.
inline std::unique_ptr<core::Session> makeUsedSession() {
  auto session = makeSession();
  session->apply(fromMessage(pushMessage(5)));
  for (int n = 0; n < 10; ++n)
    session->step();
  session->apply(fromMessage(cutMessage(6)));
  session->apply(fromMessage(gripMessage(7)));
  session->apply(core::IntegratorCommand{core::Integrator::kRungeKutta4, 0.0005});
  for (int n = 0; n < 5; ++n)
    session->step();
  return session;
}

}  // namespace soft_volume
