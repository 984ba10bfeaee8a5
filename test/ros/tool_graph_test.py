#!/usr/bin/python3
"""Simulation, tool and device with simulated time: forces, dead devices, unusable poses."""

import math

import numpy
import rospy
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from sensor_msgs.msg import Joy
from soft_volume.msg import GridState, SimulationStats, ToolCut, ToolForce, ToolState
from std_srvs.srv import Trigger

import graph
import phantom

# A tenth of real time: 50 ms of a device are half a second of this machine, whatever else it does.
SLOW = dict(start_paused='false', publish_clock='true', real_time_factor=0.1)


def vector(v):
  return numpy.array([v.x, v.y, v.z])


class ToolTest(graph.GraphTest):

  def setUp(self):
    super().setUp()
    self.servo = self.listen('servo_cf', WrenchStamped, keep=100000)
    self.forces = self.listen('tool/force', ToolForce, keep=100000)
    self.states = self.listen('tool/state', ToolState, keep=100000)

  def startSimulation(self, scene=None, **parameters):
    self.simulation = graph.Simulation(self, scene, **dict(SLOW, **parameters))
    self.tool = self.start('tool_node')

  def startDevice(self):
    self.device = self.start('device_node', scene=self.folder + '/block.yaml')

  def waitForPush(self, force_n=0.3):
    self.servo.wait(lambda s: vector(s.wrench.force)[2] > force_n, 'push of %g N' % force_n)

  def waitForZero(self, since_s, limit_s):
    """Waits until the force on the device is zero; returns the ROS time that it took since `since_s`."""

    def zero():
      after = [(t, s) for t, s in self.servo.timed if t > since_s]
      return next((t for t, s in after if not vector(s.wrench.force).any()), None)

    return graph.wait_until(zero, 'zero force on the device', limit_s) - since_s


class ScriptedHandTest(ToolTest):

  def testTheForceOnTheDeviceOpposesThePush(self):
    self.startSimulation()
    grid = self.listen('grid/state', GridState)
    poses = self.listen('measured_cp', PoseStamped, keep=100000)
    twists = self.listen('measured_cv', TwistStamped, keep=100000)
    buttons = self.listen('joy', Joy, keep=100000)
    self.startDevice()
    self.waitForPush()
    pushed = self.forces.wait(lambda f: f.force.z < -0.3, 'push of the tissue').step
    state = grid.wait(lambda s: s.step > pushed and not s.key_frame, 'state under the push')
    # The hand went down and pushes down still: its velocity was never up by more than noise.
    self.assertLess(min(t.twist.linear.z for t in twists.messages), -0.01)
    graph.wait_until(lambda: len(self.answered()) > 50, 'forces on the tissue and on the device')
    forces = {f.header.stamp: vector(f.force) for f in self.forces.messages}
    servos = {s.header.stamp: vector(s.wrench.force) for s in self.servo.messages}
    both = sorted(set(forces) & set(servos))
    push = numpy.array([0.0, 0.0, -1.0])
    for stamp in both:
      # Newton's third law, and never with the push.
      numpy.testing.assert_allclose(forces[stamp], -servos[stamp], atol=1e-12)
      self.assertLessEqual(servos[stamp].dot(push), 0.0)
    self.assertLess(max(numpy.linalg.norm(f) for f in servos.values()), 3.3 + 1e-9)
    # The tissue gave way.
    rest = self.simulation.topologies.messages[-1].rest_positions
    moves = [p.z - rest[v].z for v, p in zip(state.vertex_ids, state.positions)]
    self.assertLess(min(moves), -0.001)
    self.assertLess(max(moves), -0.3 * min(moves))
    # What the simulation was told, it applied.
    graph.wait_until(lambda: len(self.simulation.applied()) > 50, 'applied forces')
    self.assertEqual([e.reason for e in self.simulation.refused()], [])
    # One tick per millisecond of simulated time, none lost, in one frame.
    stamps = numpy.array([p.header.stamp.to_nsec() for p in poses.messages])
    self.assertTrue((numpy.diff(stamps) == 1000000).all())
    self.assertEqual({p.header.frame_id for p in poses.messages}, {'volume'})
    self.assertEqual({len(j.buttons) for j in buttons.messages}, {8})

  def answered(self):
    """Stamps of poses that gave a force on the tissue and on the device."""
    return {f.header.stamp for f in self.forces.messages} & {s.header.stamp for s in self.servo.messages}

  def testADeadDeviceGoesToZeroForceAndTheTissueRecovers(self):
    self.startSimulation()
    stats = self.listen('simulation/stats', SimulationStats)
    poses = self.listen('measured_cp', PoseStamped)
    self.startDevice()
    self.waitForPush()
    self.kill(self.device)
    last_pose_s = poses.messages[-1].header.stamp.to_sec()
    self.assertLess(self.waitForZero(last_pose_s, 20.0), 0.05)
    self.wait_for_warning('tool', 'no pose')
    # It stays at zero, the tissue is told once, and it comes back.
    end = self.forces.wait(lambda f: f is self.forces.messages[-1] and not vector(f.force).any(),
                           'zero force on the tissue at the end')
    pushed = max(s.max_displacement for s in stats.messages)
    self.assertGreater(pushed, 0.0005)
    stats.wait(lambda s: s is stats.messages[-1] and s.max_displacement < 0.3 * pushed, 'recovery')
    self.assertFalse(vector(self.servo.messages[-1].wrench.force).any())
    self.assertEqual(self.forces.messages[-1].sequence, end.sequence)
    # The simulation, which waits for tools that are late, does not wait for one without a device.
    stats.wait(lambda s: s is stats.messages[-1] and s.real_time_factor > 0.08, 'simulation at its speed')
    # A new device starts at zero and ramps in.
    self.servo.clear()
    self.startDevice()
    self.waitForPush()
    first = next(s for s in self.servo.messages if vector(s.wrench.force).any())
    self.assertLess(numpy.linalg.norm(vector(first.wrench.force)), 0.05)

  def testADeadToolStopsPushing(self):
    self.startSimulation()
    stats = self.listen('simulation/stats', SimulationStats)
    self.startDevice()
    self.waitForPush()
    pushed = stats.wait(lambda s: s.max_displacement > 0.0005, 'push').max_displacement
    self.kill(self.tool)
    stats.wait(lambda s: s is stats.messages[-1] and s.max_displacement < 0.3 * pushed, 'recovery')
    # Nobody sent a zero: the force expired by its hold_steps.
    self.assertTrue(vector(self.forces.messages[-1].force).any())
    self.tool = self.start('tool_node')
    self.servo.clear()
    self.waitForPush()

  def testADeadSimulationGoesToZeroForceThoughTimeStandsStill(self):
    self.startSimulation()
    self.startDevice()
    self.waitForPush()
    self.kill(self.simulation.node)
    self.servo.clear()
    self.servo.wait(lambda s: not vector(s.wrench.force).any(), 'zero force', limit_s=10.0)

  def testToolAndDeviceFollowAReset(self):
    self.startSimulation()
    self.startDevice()
    self.waitForPush()
    session = self.simulation.reset()
    self.servo.clear()
    self.states.wait(lambda s: s.session == session, 'tool in the new session')
    self.waitForPush()
    # The force starts at zero again in the new session.
    first = self.forces.wait(lambda f: f.session == session, 'force in the new session')
    self.assertLess(numpy.linalg.norm(vector(first.force)), 0.05)
    graph.wait_until(lambda: [e for e in self.simulation.applied() if e.topic == 'tool/force'], 'applied force')


def scalpelScene():
  """A hand that draws a scalpel along a curve through the block, 10 mm deep, and lets the button go in the tissue."""
  scene = phantom.scene()
  scene['materials'][0]['cut_resistance_j_m2'] = 30.0
  scene['tools'][0].update(id='scalpel', kind='scalpel', tip_radius_m=0.001, blade_length_m=0.025)
  z = float(phantom.TOP_Z_M) - 0.01
  points = [(0.0, 0.047, 0.000, False), (0.4, 0.050, 0.020, True), (0.8, 0.052, 0.040, True), (1.2, 0.050, 0.060, False)]
  scene['device']['way_points'] = [{
      'time_s': t, 'position_m': [x, y, z], 'pass': on, 'buttons': [0]
  } for t, x, y, on in points] + [{'time_s': 1.3, 'position_m': [0.050, 0.060, z]}]
  return scene


class ScalpelTest(ToolTest):

  def testAStrokeIsOneSurfaceThatIsLiftedOnce(self):
    self.startSimulation(scalpelScene())
    cuts = self.listen('tool/cut', ToolCut, keep=100000)
    self.startDevice()
    end = cuts.wait(lambda c: c.lifted, 'end of the stroke', limit_s=60.0)
    strokes = [c for c in cuts.messages if c.sequence <= end.sequence]
    self.assertEqual([c.lifted for c in strokes], [False] * (len(strokes) - 1) + [True])
    self.assertEqual(len(end.quads), 0)
    points = [vector(p) for c in strokes for p in c.quads]
    quads = [points[n:n + 4] for n in range(0, len(points), 4)]
    self.assertGreater(len(quads), 40)
    for before, after in zip(quads, quads[1:]):
      numpy.testing.assert_array_equal(before[3], after[0])
      numpy.testing.assert_array_equal(before[2], after[1])
    last = ('tool/cut', end.sequence)
    graph.wait_until(lambda: last in [(e.topic, e.sequence) for e in self.simulation.applied()], 'applied end')
    self.assertEqual([e.reason for e in self.simulation.refused() if e.topic == 'tool/cut'], [])
    self.assertGreater(self.simulation.revision, 3)
    # The tissue resists: 30 J/m^2 over 10 mm of blade and more, against the motion.
    strongest = max((vector(s.wrench.force) for s in self.servo.messages), key=numpy.linalg.norm)
    self.assertGreater(numpy.linalg.norm(strongest), 0.15)
    self.assertLess(strongest[1], -0.8 * numpy.linalg.norm(strongest))


class UnusablePoseTest(ToolTest):
  """The test is the device, and the clock: it steps the simulation and sends a pose for every millisecond."""

  def setUp(self):
    super().setUp()
    self.startSimulation(start_paused='true')
    self.poses = self.publisher('measured_cp', PoseStamped)
    self.depth_m = 0.004
    self.time = self.simulation.step(1).header.stamp
    self.assertReturns()

  def hold(self, ticks, z=None, change=lambda pose: None):
    """Holds the tip below the top face for so many milliseconds, each of which the tool answers."""
    for _ in range(ticks):
      self.time += rospy.Duration.from_sec(0.001)
      pose = PoseStamped()
      pose.header.stamp, pose.header.frame_id = self.time, 'volume'
      pose.pose.position.x = pose.pose.position.y = 0.047
      pose.pose.position.z = phantom.TOP_Z_M - self.depth_m if z is None else z
      pose.pose.orientation.w = 1.0
      change(pose)
      self.poses.publish(pose)
      self.simulation.step(1)

  def force(self):
    """Force on the device at the newest time that the tool has answered."""
    newest_s = self.time.to_sec() - 1e-6
    answer = self.servo.wait(lambda s: s is self.servo.messages[-1] and s.header.stamp.to_sec() >= newest_s,
                             'answer of the tool')
    return numpy.linalg.norm(vector(answer.wrench.force))

  def waitForState(self, condition, what):
    """The tool's state is another topic than its force."""
    return self.states.wait(lambda s: s is self.states.messages[-1] and condition(s), what)

  def assertFalls(self, *reason):
    """The force goes to zero though simulated time stands still, which is the harder case."""
    self.servo.wait(lambda s: s is self.servo.messages[-1] and not vector(s.wrench.force).any(), 'zero force')
    self.wait_for_warning('tool', *reason)
    self.assertTrue(self.tool.alive())
    self.assertTrue(self.simulation.node.alive())

  def assertReturns(self):
    """A stall of this machine takes the force to zero too, so the ramp may have to begin again."""
    for _ in range(30):
      self.hold(100)
      if self.force() > 0.2:
        return
    self.fail('the force does not come back')

  def testAPoseThatStops(self):
    self.assertFalls('no pose')
    self.waitForState(lambda s: s.pose_stale, 'stale pose')
    self.assertReturns()

  def testAZeroStampIsNoPose(self):
    self.hold(100, change=lambda pose: setattr(pose.header, 'stamp', rospy.Time()))
    self.assertFalls('no pose')
    self.assertReturns()

  def testAPoseThatIsNotFinite(self):
    self.hold(60, change=lambda pose: setattr(pose.pose.position, 'x', math.nan))
    self.assertEqual(self.force(), 0.0)
    self.wait_for_warning('tool', 'not finite')
    self.waitForState(lambda s: s.pose_stale, 'stale pose')
    self.assertReturns()

  def testAQuaternionOfZeros(self):
    self.hold(60, change=lambda pose: setattr(pose.pose.orientation, 'w', 0.0))
    self.assertEqual(self.force(), 0.0)
    self.wait_for_warning('tool', 'quaternion')
    self.assertReturns()

  def testAPoseInAnotherFrame(self):
    self.hold(60, change=lambda pose: setattr(pose.header, 'frame_id', 'base'))
    self.assertFalls("'base'")
    self.assertReturns()

  def testAPoseThatJumps(self):
    self.hold(1, z=phantom.TOP_Z_M + 0.05)
    self.hold(60)
    self.assertEqual(self.force(), 0.0)
    self.waitForState(lambda s: s.tripped and 'speed limit' in s.trip_reason, 'trip by the speed limit')
    self.wait_for_warning('tool', 'speed limit')
    self.hold(400)  # it stays at zero until somebody has looked
    self.assertEqual(self.force(), 0.0)
    self.assertTrue(self.call('tool/reset', Trigger).success)
    self.assertReturns()

  def testAVelocityThatIsNotFinite(self):
    velocities = self.publisher('measured_cv', TwistStamped)
    twist = TwistStamped()
    twist.header.stamp = self.time
    twist.twist.linear.x = math.inf
    velocities.publish(twist)
    self.wait_for_warning('tool', 'measured_cv', 'not finite')
    self.assertReturns()


if __name__ == '__main__':
  graph.run('tool_graph_test', simulated_time=True)
