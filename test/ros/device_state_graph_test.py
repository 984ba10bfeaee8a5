#!/usr/bin/python3
"""When a device of a file gets no force: disabled, not homed, clutched, without a tool."""

import numpy
import rospy
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import Joy

import drivers
import graph
from device_graph_test import DeviceTest, vector, wrench_force


class StateTest(DeviceTest):
  """Forces flow only while the driver says that it is enabled and homed."""

  def setUp(self):
    super().setUp()
    self.forces = self.listen('arm/servo_cf', WrenchStamped, keep=100000)

  def force(self):
    return numpy.linalg.norm(wrench_force(self.newest(self.forces)))

  def assertFallsWithin(self, limit_s, act):
    """Zero within so much simulated time, on the device and on the tissue, and it stays there."""
    before_s = rospy.get_time()
    act()
    graph.wait_until(lambda: self.force() == 0.0, 'zero force')
    self.assertLess(rospy.get_time() - before_s, limit_s)
    rospy.sleep(0.3)
    self.assertEqual(self.force(), 0.0)
    graph.wait_until(lambda: not vector(self.newest(self.pushes).force).any(), 'zero force on the tissue')

  def assertReturns(self):
    graph.wait_until(lambda: self.force() > 0.1, 'force')

  def testDisabledMeansNoForce(self):
    self.startAll('sensable_phantom')
    commands = self.publisher('arm/state_command', drivers.StringStamped)
    self.assertReturns()
    # 25 ms to ramp, and the way of the command there and of the state back.
    self.assertFallsWithin(0.1, lambda: commands.publish(drivers.StringStamped(string='disable')))
    self.wait_for_status('tool', lambda s: 'DISABLED' in s.message or any('DISABLED' in v.value for v in s.values),
                         'the reason')
    commands.publish(drivers.StringStamped(string='enable'))
    self.assertReturns()

  def testNotHomedMeansNoForce(self):
    self.startAll('sensable_phantom')
    states = self.publisher('arm/operating_state', drivers.OperatingState)
    self.assertReturns()
    self.assertFallsWithin(0.1, lambda: states.publish(drivers.OperatingState(state='ENABLED', is_homed=False)))
    states.publish(drivers.OperatingState(state='ENABLED', is_homed=True))
    self.assertReturns()

  def testTheClutchLetsGoOfTheTissue(self):
    self.forces = self.listen('MTMR/body/servo_cf', WrenchStamped, keep=100000)
    self.startAll('dvrk_mtm')
    pedal = self.publisher('footpedals/clutch', Joy)
    self.assertReturns()
    self.assertFallsWithin(0.1, lambda: pedal.publish(Joy(buttons=[1])))
    pedal.publish(Joy(buttons=[0]))
    self.assertReturns()

  def testAToolThatIsStoppedLeavesNoForce(self):
    self.startAll('sensable_phantom')
    self.assertReturns()
    self.assertEqual(self.tool.stop(), 0)
    self._killed.add(self.tool)
    graph.wait_until(lambda: self.force() == 0.0, 'zero force at the end')


if __name__ == '__main__':
  graph.run('device_state_graph_test', simulated_time=True)
