#!/usr/bin/python3
"""Drivers that are not CRTK's: omni_msgs through adapter_node, mice and keyboards through teleop_node, and what the
virtual device says as a driver."""

import math
import threading
import time

import numpy
import rospy
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from rospy.msg import AnyMsg
from sensor_msgs.msg import Joy

import drivers
import graph
import phantom

HALF = math.sqrt(0.5)


def vector(v):
  return numpy.array([v.x, v.y, v.z])


class DriverTest(graph.GraphTest):

  def startDriver(self, program, device, **options):
    return self.start(program, device=drivers.device_file(device), **options)


class AdapterTest(DriverTest):
  """The test is the driver on one side and the tool on the other."""

  def setUp(self):
    super().setUp()
    self.adapter = self.startDriver('adapter_node', 'omni')
    self.poses = self.listen('omni/measured_cp', PoseStamped)
    self.twists = self.listen('omni/measured_cv', TwistStamped)
    self.forces = self.listen('phantom/force_feedback', drivers.OmniFeedback, keep=100000)
    self.poses.connect()
    self.twists.connect()
    self.forces.connect()

  def say(self):
    state = drivers.OmniState()
    state.header.stamp = rospy.Time(1234, 567)
    state.pose.position.x, state.pose.position.y, state.pose.position.z = 10.0, -20.0, 30.0
    state.pose.orientation.w = 1.0
    state.velocity.y = 500.0
    self.sayAs(state)

  def sayAs(self, message):
    """Publishes a state of any type, once per test: a subscriber stays with the type that it heard first."""
    self.publisher('phantom/state', type(message)).publish(message)

  def push(self, *force):
    message = WrenchStamped()
    message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = force
    self.servo.publish(message)

  def testMillimetresBecomeMetres(self):
    self.say()
    pose = self.poses.wait()
    numpy.testing.assert_allclose(vector(pose.pose.position), [0.01, -0.02, 0.03], atol=1e-15)
    self.assertEqual(pose.header.stamp, rospy.Time(1234, 567))
    self.assertEqual(pose.header.frame_id, 'omni_base')
    # Its orientations are in the frame with y up, its positions in that with z up.
    self.assertAlmostEqual(pose.pose.orientation.x, HALF)
    self.assertAlmostEqual(pose.pose.orientation.w, HALF)
    numpy.testing.assert_allclose(vector(self.twists.wait().twist.linear), [0.0, 0.5, 0.0], atol=1e-15)

  def testButtonEventsBecomeAJoy(self):
    buttons = self.listen('omni/joy', Joy)
    events = self.publisher('phantom/button', drivers.OmniButtonEvent)
    events.publish(drivers.OmniButtonEvent(1, 0))
    buttons.wait(lambda j: tuple(j.buttons) == (1, 0), 'grey button')
    events.publish(drivers.OmniButtonEvent(0, 1))
    buttons.wait(lambda j: tuple(j.buttons) == (0, 1), 'white button')

  def testForcesLoseTheirHeaderAndNothingElse(self):
    self.servo = self.publisher('omni/servo_cf', WrenchStamped)
    self.say()
    self.poses.wait()
    self.push(0.5, -1.0, 2.0)
    feedback = self.forces.wait(lambda f: vector(f.force).any(), 'force')
    numpy.testing.assert_array_equal(vector(feedback.force), [0.5, -1.0, 2.0])
    # A driver that locks does so where the device is, in its own units.
    numpy.testing.assert_array_equal(vector(feedback.position), [10.0, -20.0, 30.0])

  def testAToolThatDiesTakesItsForceAlong(self):
    self.servo = self.publisher('omni/servo_cf', WrenchStamped)
    self.push(0.0, 0.0, 2.0)
    self.forces.wait(lambda f: f.force.z == 2.0, 'force')
    self.forces.wait(lambda f: f.force.z == 0.0, 'zero force without a tool')
    falling = [f.force.z for f in self.forces.messages]
    self.assertEqual(falling, sorted(falling, reverse=True))

  def testWhenItIsStoppedTheDriverIsLeftWithoutAForce(self):
    self.servo = self.publisher('omni/servo_cf', WrenchStamped)
    self.push(0.0, 0.0, 2.0)
    self.forces.wait(lambda f: f.force.z == 2.0, 'force')
    pushing = threading.Event()
    pusher = threading.Thread(target=lambda: [self.push(0.0, 0.0, 2.0) or time.sleep(0.002)
                                              for _ in iter(pushing.is_set, True)])
    pusher.start()
    self.assertEqual(self.adapter.stop(), 0)
    pushing.set()
    pusher.join()
    self._killed.add(self.adapter)
    graph.wait_until(lambda: self.forces.messages[-1].force.z == 0.0, 'zero force at the end')

  def testAForceThatIsNotFiniteIsNone(self):
    self.servo = self.publisher('omni/servo_cf', WrenchStamped)
    self.push(math.nan, 0.0, 0.0)
    self.assertFalse(vector(self.forces.wait().force).any())
    self.wait_for_warning('adapter', 'omni/servo_cf', 'not finite')

  def testOtherMessagesAreRefused(self):
    other = drivers.message_class('omni_msgs/OmniState', 'std_msgs/Header header\nfloat64 pose\n')
    self.sayAs(other())
    self.wait_for_warning('adapter', 'phantom/state', "no number 'pose.position.x'")
    self.assertEqual(self.poses.messages, [])

  def testFieldsAreFoundByNameWhateverStandsAroundThem(self):
    later = drivers.message_class('omni_msgs/OmniState',
                                  'string maker\ngeometry_msgs/Vector3 velocity\ngeometry_msgs/Pose pose\n'
                                  'float64[] joints\nstd_msgs/Header header\n')
    state = later(maker='somebody', joints=[1.0, 2.0, 3.0])
    state.header.stamp = rospy.Time(5)
    state.pose.position.x = 70.0
    self.sayAs(state)
    self.assertAlmostEqual(self.poses.wait().pose.position.x, 0.07)


class TypeTest(DriverTest):
  """What the nodes announce is what a driver's own messages are."""

  def assertAnnounces(self, topic, name):
    listener = self.listen(topic, AnyMsg)
    type_name, md5, definition = drivers.announced(listener)
    self.unlisten(listener)  # listeners of one process share their class
    self.assertEqual((type_name, md5), (name, drivers.checksum(name)))
    # Who has not got the package either can make the type from the definition.
    text = definition.split('=' * 80)[0]
    self.assertEqual(drivers.message_class(name, text)._md5sum, md5)

  def startDevice(self, device):
    return self.startDriver('device_node', device, scene=phantom.write_scene(self.folder))

  def testOmni(self):
    self.startDriver('adapter_node', 'omni')
    self.startDevice('omni')
    self.assertAnnounces('phantom/state', 'omni_msgs/OmniState')
    self.assertAnnounces('phantom/button', 'omni_msgs/OmniButtonEvent')
    servo = self.publisher('omni/servo_cf', WrenchStamped)
    feedback = self.listen('phantom/force_feedback', AnyMsg)
    feedback.connect()
    servo.publish(WrenchStamped())
    self.assertAnnounces('phantom/force_feedback', 'omni_msgs/OmniFeedback')

  def testOperatingState(self):
    self.startDevice('sensable_phantom')
    self.assertAnnounces('arm/operating_state', 'crtk_msgs/operating_state')
    states = self.listen('arm/operating_state', drivers.OperatingState)
    self.assertEqual(states.wait().state, 'ENABLED')
    commands = self.publisher('arm/state_command', drivers.StringStamped)
    commands.publish(drivers.StringStamped(string='disable'))
    states.wait(lambda s: s.state == 'DISABLED', 'DISABLED')
    commands.publish(drivers.StringStamped(string='dance'))
    self.wait_for_warning('device', 'state_command', "'dance'")
    commands.publish(drivers.StringStamped(string='enable'))
    states.wait(lambda s: s is states.messages[-1] and s.state == 'ENABLED', 'ENABLED')


class MouseTest(DriverTest):

  def setUp(self):
    super().setUp()
    self.startDriver('teleop_node', 'spacenav')
    self.poses = self.listen('mouse/measured_cp', PoseStamped)
    self.twists = self.listen('mouse/measured_cv', TwistStamped)
    self.mouse = self.publisher('spacenav/joy', Joy)

  def deflect(self, axes, time_s):
    end = time.monotonic() + time_s
    while time.monotonic() < end:
      self.mouse.publish(Joy(axes=axes, buttons=[0, 0]))
      time.sleep(0.01)

  def position(self):
    return vector(self.poses.wait(lambda p: p is self.poses.messages[-1]).pose.position)

  def testItsDeflectionIsASpeed(self):
    before = self.poses.wait()
    self.assertEqual(before.header.frame_id, 'mouse_base')
    self.deflect([0.0, 1.0, 0.0, 0.0, 0.0, 0.0], 1.0)
    moved = self.position() - vector(before.pose.position)
    self.assertGreater(moved[1], 0.02)
    self.assertLess(moved[1], 0.1 + 1e-9)  # the end of the workspace
    numpy.testing.assert_allclose(moved[[0, 2]], 0.0, atol=1e-12)
    self.assertLessEqual(max(numpy.linalg.norm(vector(t.twist.linear)) for t in self.twists.messages), 0.08 + 1e-9)

  def testWhenItFallsSilentTheToolStops(self):
    self.deflect([0.0, 0.0, -1.0, 0.0, 0.0, 0.0], 0.3)
    graph.wait_until(lambda: not vector(self.twists.messages[-1].twist.linear).round(5).any(), 'rest')
    still = self.position()
    time.sleep(0.3)
    numpy.testing.assert_allclose(self.position(), still, atol=1e-5)

  def testAMouseWithTooFewAxes(self):
    self.deflect([1.0, 1.0], 0.2)
    numpy.testing.assert_array_equal(self.position(), 0.0)


class KeyboardTest(DriverTest):

  def setUp(self):
    super().setUp()
    self.teleop = self.startDriver('teleop_node', 'keyboard', keys=True)
    self.poses = self.listen('keyboard/measured_cp', PoseStamped)
    self.buttons = self.listen('keyboard/joy', Joy)
    self.poses.wait()

  def position(self):
    return vector(self.poses.messages[-1].pose.position)

  def testKeysMoveTheTool(self):
    self.assertIn('left, right', self.teleop.output())
    self.teleop.type('d')
    graph.wait_until(lambda: self.position()[0] > 0.001, 'motion to the right')
    self.teleop.type('a' * 3)
    graph.wait_until(lambda: self.position()[0] < 0.004, 'motion to the left')
    numpy.testing.assert_allclose(self.position()[1:], 0.0, atol=1e-12)

  def testSpaceAndTabAreButtons(self):
    self.teleop.type(' ')
    self.buttons.wait(lambda j: tuple(j.buttons) == (1, 0), 'button 0')
    self.teleop.type(' \t')
    self.buttons.wait(lambda j: tuple(j.buttons) == (0, 1), 'button 1')
    self.buttons.wait(lambda j: j is self.buttons.messages[-1] and tuple(j.buttons) == (0, 0), 'no button')

  def testWithoutATerminalItStaysWhereItIs(self):
    self.teleop.process.stdin.close()
    time.sleep(0.2)
    self.assertTrue(self.teleop.alive())
    numpy.testing.assert_array_equal(self.position(), 0.0)


class LeavingTest(DriverTest):

  def testWhoIsNotNeededLeaves(self):
    for program, device in (('adapter_node', 'virtual'), ('teleop_node', 'virtual'), ('teleop_node', 'omni'),
                            ('adapter_node', 'keyboard')):
      node = self.startDriver(program, device)
      self.assertEqual(self.finish(node), 0, node.output())

  def testFilesThatCannotBeUsed(self):
    for program in ('adapter_node', 'teleop_node'):
      node = self.start(program)
      self.assertEqual(self.finish(node), 1)
      self.assertIn('/device is missing', node.output())
      node = self.start(program, device='/nowhere.yaml')
      self.assertEqual(self.finish(node), 1)
      self.assertIn('config/devices', node.output())


if __name__ == '__main__':
  graph.run('driver_graph_test')
