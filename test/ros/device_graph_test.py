#!/usr/bin/python3
"""A device of every style, from its file to the force on its motors: direction, frame and unit.

The scene's hand presses down onto the block, and its first camera looks down at it: the force on the device points to
the user, whatever its driver calls that direction.
"""

import numpy
import rospy
from geometry_msgs.msg import PoseStamped, WrenchStamped
from sensor_msgs.msg import Joy
from soft_volume.msg import ToolForce, ToolState

import drivers
import graph

# A tenth of real time: 50 ms of a device are half a second of this machine, whatever else it does.
SLOW = dict(start_paused='false', publish_clock='true', real_time_factor=0.1)


def vector(v):
  return numpy.array([v.x, v.y, v.z])


class DeviceTest(graph.GraphTest):

  def startAll(self, device, *others):
    self.simulation = graph.Simulation(self, **SLOW)
    file = drivers.device_file(device)
    self.pushes = self.listen('tool/force', ToolForce, keep=100000)
    self.states = self.listen('tool/state', ToolState, keep=100000)
    for program in others:
      self.start(program, device=file)
    self.tool = self.start('tool_node', device=file)
    self.device = self.start('device_node', scene=self.folder + '/block.yaml', device=file)

  def newest(self, listener):
    return listener.wait(lambda m: m is listener.messages[-1])

  def waitForForce(self, force_of, listener, at_least_n=0.12):
    listener.wait(lambda m: numpy.linalg.norm(force_of(m)) > at_least_n, 'force of %g N' % at_least_n)

  def assertFelt(self, listener, force_of, direction):
    """The force on the device points to where the user is, and is what the tissue is pushed with."""
    self.waitForForce(force_of, listener)
    rospy.sleep(0.5)  # of simulated time: until the press is at rest
    felt_n = force_of(self.newest(listener))
    pushed_n = vector(self.newest(self.pushes).force)
    self.assertGreater(numpy.dot(felt_n, direction), 0.97 * numpy.linalg.norm(felt_n), felt_n)
    self.assertLess(pushed_n[2], -0.08)
    self.assertAlmostEqual(numpy.linalg.norm(felt_n), numpy.linalg.norm(pushed_n), delta=0.03)
    self.assertTrue(self.newest(self.states).in_contact)


def wrench_force(message):
  return vector(message.wrench.force)


class CrtkTest(DeviceTest):

  def check(self, device, pose_topic, force_topic, frame, away, per_metre=1.0, felt=None):
    """`away` is the direction away from the user in the base frame, `felt` that of the force if in another frame."""
    poses = self.listen(pose_topic, PoseStamped, keep=100000)
    forces = self.listen(force_topic, WrenchStamped, keep=100000)
    self.startAll(device)
    away = numpy.array(away)
    self.assertFelt(forces, wrench_force, -away if felt is None else numpy.array(felt))
    pose = self.newest(poses)
    self.assertEqual(pose.header.frame_id, frame)
    # From 9 mm before the middle of the workspace to some millimetres beyond it.
    way_m = [numpy.dot(vector(p.pose.position), away) * per_metre for p in poses.messages]
    self.assertAlmostEqual(way_m[0], -0.009, delta=0.0005)
    self.assertGreater(way_m[-1], 0.0005)
    self.assertLess(way_m[-1], 0.0055)

  def testVirtual(self):
    self.check('virtual', 'device/measured_cp', 'device/servo_cf', 'device_base', [0, 0, -1])

  def testSensablePhantom(self):
    self.check('sensable_phantom', 'arm/measured_cp', 'arm/servo_cf', 'base', [0, 0, -1])

  def testForceDimension(self):
    self.check('force_dimension', 'omega/measured_cp', 'omega/body/servo_cf', 'omega_base', [-1, 0, 0])

  def testFalconWhoseTipMovesTwiceAsFar(self):
    self.check('falcon', 'falcon/measured_cp', 'falcon/body/servo_cf', 'falcon_base', [-1, 0, 0], per_metre=2.0)

  def testMasterOfADaVinciThatTakesForcesInItsGrippersFrame(self):
    # The shaft stands upright, and the gripper's z axis points along it away from the hand.
    self.check('dvrk_mtm', 'MTMR/measured_cp', 'MTMR/body/servo_cf', '', [0, 0, 1], felt=[0, 0, -1])


class OtherStylesTest(DeviceTest):

  def testOmni(self):
    states = self.listen('phantom/state', drivers.OmniState, keep=100000)
    forces = self.listen('phantom/force_feedback', drivers.OmniFeedback, keep=100000)
    self.startAll('omni', 'adapter_node')
    self.assertFelt(forces, lambda m: vector(m.force), numpy.array([0.0, -1.0, 0.0]))
    self.assertAlmostEqual(states.messages[0].pose.position.y, -9.0, delta=0.5)  # millimetres

  def testAMouseHasNoMotorsButPushes(self):
    joys = self.listen('spacenav/joy', Joy, keep=100000)
    self.startAll('spacenav', 'teleop_node')
    self.pushes.wait(lambda f: f.force.z < -0.15, 'push of the tissue')
    self.assertGreater(max(j.axes[0] for j in joys.messages), 0.05)  # forward is away from the user
    self.assertFalse(any(topic == '/servo_cf' for topic, _ in rospy.get_published_topics()))


if __name__ == '__main__':
  graph.run('device_graph_test', simulated_time=True)
