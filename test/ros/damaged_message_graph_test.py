#!/usr/bin/python3
"""Damaged messages on the wire into every node: random bytes, cut messages, counts that nothing could hold, wrong MD5 sums.
The nodes live on, take no memory for it, count what they refused, and work as before."""

import io
import os
import random
import struct
import subprocess
import sys
import time

import rospy
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from sensor_msgs.msg import Joy
from soft_volume.msg import GridPatch, GridState, GridTopology, RecorderStatus, Scene, ToolCut, ToolForce, ToolGrip
from soft_volume.msg import ToolState, Volume

import drivers
import graph

ROUNDS = int(os.environ.get('SOFT_VOLUME_FUZZ_ROUNDS', '40'))  # damaged messages to each topic
MOST_GROWTH_KB = 100000
HUGE = (0xffffffff, 0x7fffffff, 0x10000000, 100000000)

# Topic, type, and the nodes that hear it and count what they refuse.
INPUTS = (('tool/force', ToolForce, ['simulation']), ('tool/cut', ToolCut, ['simulation']),
          ('tool/grip', ToolGrip, ['simulation']), ('tool/state', ToolState, ['simulation']),
          ('scene', Scene, ['tool', 'renderer']), ('volume', Volume, ['tool', 'renderer']),
          ('grid/topology', GridTopology, ['tool', 'renderer']), ('grid/state', GridState, ['renderer']),
          ('grid/patch', GridPatch, ['tool']), ('measured_cp', PoseStamped, ['tool']),
          ('measured_cv', TwistStamped, ['tool']), ('servo_cf', WrenchStamped, ['device']))


def raw(message_type, bad_md5=False):
  """A class of messages whose bytes are given."""

  class Raw(rospy.AnyMsg):
    _type = message_type._type
    _md5sum = '0123456789abcdef' * 2 if bad_md5 else message_type._md5sum
    _full_text = message_type._full_text
    _has_header = False

    def serialize(self, buff):
      buff.write(self._buff)

  return Raw


class AnyListener:
  """Keeps the bytes of the newest message. Of a topic that is listened to with its type, rospy gives messages anew."""

  def __init__(self, topic):
    self.heard = []
    self._subscriber = rospy.Subscriber(topic, rospy.AnyMsg, self._hear)

  def _hear(self, message):
    self.heard = [message._buff if isinstance(message, rospy.AnyMsg) else serialized(message)]

  def close(self):
    self._subscriber.unregister()


def memory_kb(node):
  with open('/proc/%d/status' % node.process.pid) as status:
    return next(int(line.split()[1]) for line in status if line.startswith('VmHWM'))


class DamagedMessageTest(graph.GraphTest):

  def setUp(self):
    super().setUp()
    self.random = random.Random(7)
    self.whole = {}

  def damaged(self, topic):
    whole = bytearray(self.whole[topic])
    way = self.random.randrange(4)
    if way == 0:
      return bytes(self.random.randrange(256) for _ in range(self.random.randrange(300)))
    if way == 1 or len(whole) < 8:
      return bytes(whole[:self.random.randrange(len(whole))])
    for _ in range(1 if way == 2 else 4):
      struct.pack_into('<I', whole, self.random.randrange(min(len(whole), 2000) - 4), self.random.choice(HUGE))
    return bytes(whole)

  def send(self, topic, kind):
    publisher = self.publisher('/' + topic, raw(kind))
    for number in range(ROUNDS):
      message = raw(kind)()
      # The first one is refused for certain: it ends within its header.
      message._buff = b'\x01\x00' if number == 0 else self.damaged(topic)
      publisher.publish(message)
    self._publishers.remove(publisher)
    publisher.unregister()

  def waitForRefusal(self, node, topic):
    self.wait_for_status(node, lambda s: any(v.key == 'refused on ' + topic and int(v.value) > 0 for v in s.values),
                         'messages of %s refused' % topic)

  def checkAlive(self, nodes, before):
    for name, node in nodes.items():
      self.assertTrue(node.alive(), name)
      growth = memory_kb(node) - before[name]
      print('%s: %d kB more at most' % (name, growth))
      self.assertLess(growth, MOST_GROWTH_KB, name)


class DamagedDriverTest(DamagedMessageTest):
  """The nodes that stand between drivers and the tool."""

  def sendAll(self, node, inputs):
    before = {node.name: memory_kb(node)}
    for topic, kind in inputs:
      self.whole[topic] = serialized(kind())
      self.send(topic, kind)
    for topic, _ in inputs:
      self.waitForRefusal(node.name, topic)
    self.checkAlive({node.name: node}, before)

  def testTheAdapterOfAnOmniLivesOn(self):
    adapter = self.start('adapter_node', device=drivers.device_file('omni'))
    poses = self.listen('omni/measured_cp', PoseStamped)
    poses.connect()
    self.sendAll(adapter, (('phantom/state', drivers.OmniState), ('phantom/button', drivers.OmniButtonEvent),
                           ('omni/servo_cf', WrenchStamped)))
    state = drivers.OmniState()
    state.pose.orientation.w = 1.0
    state.pose.position.x = 12.0
    publisher = self.publisher('phantom/state', drivers.OmniState)
    publisher.publish(state)
    poses.wait(lambda p: abs(p.pose.position.x) + abs(p.pose.position.y) + abs(p.pose.position.z) > 0, 'pose')

  def testTeleoperationLivesOn(self):
    teleop = self.start('teleop_node', device=drivers.device_file('spacenav'))
    poses = self.listen('mouse/measured_cp', PoseStamped)
    poses.connect()
    self.sendAll(teleop, (('spacenav/joy', Joy),))
    poses.clear()
    poses.wait(what='pose')


class DamagedGraphTest(DamagedMessageTest):

  def setUp(self):
    super().setUp()
    self.states = self.listen('grid/state', GridState)
    self.tools = self.listen('tool/state', ToolState)
    self.simulation = graph.Simulation(self, start_paused='false', real_time_factor=1.0)
    scene = self.folder + '/block.yaml'
    self.nodes = {'simulation': self.simulation.node, 'tool': self.start('tool_node'),
                  'device': self.start('device_node', scene=scene), 'renderer': self.start('renderer_node'),
                  'recorder': self.start('recorder_node', file=os.path.join(self.folder, 'run.bag'))}
    self.recorded = self.listen('recorder/status', RecorderStatus)
    self.recorded.wait(lambda s: s.step > 0, 'recording')
    self.tools.wait(what='tool')

  def takeWhole(self):
    """A message of each topic as it was sent, or an empty one of its type."""
    listeners = [(topic, kind, AnyListener(topic)) for topic, kind, _ in INPUTS]
    time.sleep(1.5)
    for topic, kind, listener in listeners:
      heard = listener.heard
      self.whole[topic] = heard[-1] if heard else serialized(kind())
      listener.close()

  def testNodesLiveOnAndCount(self):
    self.takeWhole()
    before = {name: memory_kb(node) for name, node in self.nodes.items()}
    for topic, kind, _ in INPUTS:
      self.send(topic, kind)
    for topic, _, nodes in INPUTS:
      for node in nodes:
        self.waitForRefusal(node, topic)
    self.checkAlive(self.nodes, before)
    self.checkWork()

  def testNodesLiveOnWithPublishersOfAnotherVersion(self):
    # Of processes of their own, which may be refused.
    for topic, _, _ in INPUTS:
      subprocess.run([sys.executable, os.path.abspath(__file__), 'impostor', topic], timeout=30, check=True,
                     stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    self.checkWork()

  def checkWork(self):
    """A new session, because a message that was damaged may have been a valid one."""
    session = self.simulation.reset()
    self.states.wait(lambda s: s.session == session and s.step > 100, 'states of a new session')
    self.recorded.wait(lambda s: s.session == session and s.recording and s.step > 100, 'recording of a new session')
    for name, node in self.nodes.items():
      self.assertTrue(node.alive(), name)


def serialized(message):
  buff = io.BytesIO()
  message.serialize(buff)
  return buff.getvalue()


def impostor(topic):
  """Publishes a topic with another MD5 sum for a while."""
  kind = next(kind for name, kind, _ in INPUTS if name == topic)
  rospy.init_node('impostor', anonymous=True, disable_signals=True)
  publisher = rospy.Publisher('/' + topic, raw(kind, bad_md5=True), queue_size=10, latch=True)
  message = raw(kind)()
  message._buff = b'\0' * 100
  for _ in range(10):
    publisher.publish(message)
    time.sleep(0.05)
  rospy.signal_shutdown('done')


if __name__ == '__main__':
  if len(sys.argv) > 2 and sys.argv[1] == 'impostor':
    impostor(sys.argv[2])
  else:
    graph.run('damaged_message_graph_test')
