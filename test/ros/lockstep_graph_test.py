#!/usr/bin/python3
"""The motion of a recorded device, played into live nodes: bit for bit in lockstep, nearly so without."""

import json
import os
import subprocess
import time
import xmlrpc.client

import rosbag
import rosgraph
import rospy
from geometry_msgs.msg import PoseStamped, TwistStamped
from sensor_msgs.msg import Joy
from soft_volume.msg import JournalEntry, RecorderStatus, SimulationJournal, ToolCut, ToolForce, ToolState
from std_srvs.srv import SetBool

import graph
import phantom

START_S = 100.0
LENGTH_S = 1.6
SWAP = (0.80, 0.85)  # the button is held
CUT = (0.95, 1.45)
INPUTS = {'tool/force': ToolForce, 'tool/cut': ToolCut}


def scene():
  """The block with a probe and a scalpel."""
  content = phantom.scene()
  scalpel = dict(content['tools'][0], id='scalpel', kind='scalpel', blade_length_m=0.03, cut_button=0)
  content['tools'].append(scalpel)
  content['device']['swap_button'] = 1
  return content


WAY = ((0.0, 0.047, 0.047, 0.080), (0.2, 0.047, 0.047, 0.065), (0.6, 0.057, 0.050, 0.065), (0.75, 0.055, 0.045, 0.085),
       (0.95, 0.047, 0.030, 0.065), (1.45, 0.047, 0.055, 0.065), (1.6, 0.047, 0.055, 0.085))


def place(t):
  """The hand: presses with the probe and slides, lifts, and draws the scalpel through the block."""
  after = next(n for n, point in enumerate(WAY) if n > 0 and t <= point[0])
  (t0, *a), (t1, *b) = WAY[after - 1], WAY[after]
  return [p + (q - p) * (t - t0) / (t1 - t0) for p, q in zip(a, b)]


def write_device(path):
  """A bag of a device alone. Topics are out of order among each other, as transports may deliver them."""
  with rosbag.Bag(path, 'w') as bag:
    before = place(0.0)
    for n in range(int(LENGTH_S * 1000)):
      t = 0.001 * n
      stamp = rospy.Time.from_sec(START_S) + rospy.Duration(nsecs=1000000 * n)
      pose, twist, joy = PoseStamped(), TwistStamped(), Joy(buttons=[0] * 8)
      now = place(t)
      pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = now
      pose.pose.orientation.w = 1.0
      twist.twist.linear.x, twist.twist.linear.y, twist.twist.linear.z = [(a - b) / 0.001 for a, b in zip(now, before)]
      joy.buttons[0] = int(CUT[0] <= t < CUT[1])
      joy.buttons[1] = int(SWAP[0] <= t < SWAP[1])
      before = now
      for late_s, topic, message in ((0.0, 'measured_cp', pose), (0.004, 'measured_cv', twist), (0.007, 'joy', joy)):
        message.header.stamp, message.header.frame_id = stamp, 'volume'
        bag.write('/' + topic, message, stamp + rospy.Duration.from_sec(late_s))


def journal(path):
  """Entries until the lockstep ended, without what names the session, and the state hashes by step until then."""
  entries, hashes = [], {}
  with rosbag.Bag(path) as bag:
    for _, message, _ in bag.read_messages(topics=['/simulation/journal']):
      for entry in message.entries:
        if entry.topic == 'lockstep':
          return entries, hashes
        if entry.topic in INPUTS:
          entries.append((entry.step, entry.topic, entry.outcome, entry.reason) + input_of(entry))
      hashes[message.step] = message.state_hash
  return entries, hashes


def input_of(entry):
  message = INPUTS[entry.topic]().deserialize(bytes(entry.payload))
  message.session = 0
  return message.tool_id, message.header.stamp.to_nsec(), str(message)


def connections(node, publisher='/player'):
  """Topics that a node gets from the player or another one, over connections that stand."""
  master = rosgraph.Master(rospy.get_name())
  try:
    uri = master.lookupNode(publisher)
  except rosgraph.MasterError:
    return set()
  links = xmlrpc.client.ServerProxy(master.lookupNode(node)).getBusInfo(rospy.get_name())[2]
  return {link[4] for link in links if link[1] == uri and link[2] == 'i' and link[5]}


class Load:
  """Keeps a core busy."""

  def __enter__(self):
    self._process = subprocess.Popen(graph.dying_with_us('KILL') + ['sh', '-c', 'while :; do :; done'])

  def __exit__(self, *_):
    self._process.kill()
    self._process.wait()


class PlayingTest(graph.GraphTest):

  def setUp(self):
    super().setUp()
    self.device = os.path.join(self.folder, 'device.bag')
    write_device(self.device)

  def path(self, name):
    return os.path.join(self.folder, name)

  def startNodes(self, bag, **parameters):
    recorder = self.start('recorder_node', file=self.path(bag))
    self.listen('recorder/status', RecorderStatus).wait(lambda s: s.recording and s.file == self.path(bag), 'recording')
    journals = self.listen('simulation/journal', SimulationJournal, keep=100000)
    simulation = self.start('simulation_node', scene=phantom.write_scene(self.folder, scene()), **parameters)
    lockstep = {k: v for k, v in parameters.items() if k == 'lockstep'}
    tool = self.start('tool_node', lockstep_timeout_s=1, **lockstep)
    rospy.wait_for_service('simulation/step', timeout=graph.LIMIT_S)
    rospy.wait_for_service('tool/reset', timeout=graph.LIMIT_S)
    for topic in ('tool/force', 'tool/cut', 'simulation/journal', 'grid/state', 'measured_cp', 'joy'):
      graph.wait_until(lambda: '/recorder' in graph.subscribers(topic), 'recorder of ' + topic)
    graph.wait_until(lambda: '/simulation' in graph.subscribers('tool/force'), 'simulation that listens')
    journals.connect()
    return journals, [tool, simulation, recorder]

  def startPlayer(self, rate):
    """A player whose listeners are connected: what it plays before is lost to them."""
    player = subprocess.Popen(graph.dying_with_us('KILL') + ['rosbag', 'play', '--quiet', '--clock', '--hz=1000', '--pause',
                                                             '--queue=10000', '--rate=%g' % rate, self.device,
                                                             '__name:=player'],
                              stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    self.addCleanup(player.wait)
    self.addCleanup(player.kill)
    for node in '/tool', '/recorder':
      graph.wait_until(lambda: {'/measured_cp', '/measured_cv', '/joy'} <= connections(node), 'connections of ' + node)
    self.assertTrue(self.call('player/pause_playback', SetBool, False).success)
    return player

  def play(self, rate):
    """Blocks until the device has been played."""
    self.assertEqual(self.startPlayer(rate).wait(timeout=60), 0)

  def stop(self, nodes):
    for node in nodes:
      self._killed.add(node)
      self.assertEqual(node.stop(), 0, node.output())

  def playInLockstep(self, bag, rate):
    journals, nodes = self.startNodes(bag, lockstep='true')
    self.play(rate)
    journals.wait(lambda j: any(e.topic == 'lockstep' for e in j.entries), 'end of the lockstep')
    self.stop(nodes)
    return journal(self.path(bag))

  def replay(self, *arguments, code=0):
    program = os.path.join(os.environ['SOFT_VOLUME_TEST_BIN'], 'soft_volume_replay')
    done = subprocess.run((program,) + arguments + ('--no-progress',), stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, universal_newlines=True, timeout=120)
    self.assertEqual(done.returncode, code, done.stdout)
    return done.stdout

  def assertSameRun(self, first, second):
    self.assertGreater(len(first[0]), 500)
    for a, b in zip(first[0], second[0]):
      self.assertEqual(a, b)
    self.assertEqual(len(first[0]), len(second[0]))
    common = sorted(set(first[1]) & set(second[1]))
    self.assertGreater(len(common), 70)
    self.assertEqual([(s, first[1][s]) for s in common], [(s, second[1][s]) for s in common])


class LockstepTest(PlayingTest):

  def testInLockstepThePlayedDeviceGivesTheSameBits(self):
    first = self.playInLockstep('first.bag', rate=1)
    self.assertEqual({e[4] for e in first[0]}, {'probe', 'scalpel'})
    self.assertEqual({e[1] for e in first[0]}, set(INPUTS))
    self.assertEqual({e[2] for e in first[0]}, {JournalEntry.APPLIED}, {e[3] for e in first[0]})
    with Load():
      second = self.playInLockstep('second.bag', rate=3)
    self.assertSameRun(first, second)
    self.replay(self.path('first.bag'), '--check')
    self.replay(self.path('first.bag'), '--resimulate', '--output', self.path('offline.bag'))
    self.assertSameRun(first, journal(self.path('offline.bag')))
    self.replay(self.path('offline.bag'), '--check')
    self.replay(self.path('first.bag'), '--resimulate', 'materials.tissue.youngs_modulus_pa=6060', '--output',
                self.path('stiffer.bag'))
    self.assertNotEqual(first[1][1000], journal(self.path('stiffer.bag'))[1][1000])

  def testWithoutLockstepItIsNearlySo(self):
    journals, nodes = self.startNodes('free.bag')
    self.play(rate=0.5)
    graph.wait_until(lambda: journals.messages and journals.messages[-1].header.stamp.to_sec() > START_S + 1.5,
                     'run until the end of the device')
    self.stop(nodes)
    result = self.path('result.json')
    self.replay(self.path('free.bag'), '--check')
    self.replay(self.path('free.bag'), '--resimulate', '--output', self.path('offline.bag'), '--json', result)
    with open(result) as file:
      quantities = {(q['key'], q['subject']): q for q in json.load(file)['comparison']['quantities']}
    # The tolerance that doc/bags.md states: when patches and forces arrive is all that differs.
    self.assertLess(quantities['positions', '']['rms'], 0.03 * phantom.scene()['lattice']['spacing_m'])
    for tool in 'probe', 'scalpel':
      self.assertLess(quantities['force', tool]['rms'], 0.1)

  def testLatchedMessagesThatComeAgainChangeNothing(self):
    states = self.listen('tool/state', ToolState, keep=100000)
    journals, nodes = self.startNodes('run.bag', lockstep='true')
    player = self.startPlayer(rate=0.2)
    states.wait(what='tick in lockstep')
    simulation = rosgraph.Master(rospy.get_name()).lookupNode('/simulation')
    for _ in range(12):  # more than the tool remembers rigs
      for publishers in [], [simulation]:
        with xmlrpc.client.ServerProxy(rosgraph.Master(rospy.get_name()).lookupNode('/tool')) as tool:
          tool.publisherUpdate('/master', '/scene', publishers)
        graph.wait_until(lambda: ('/scene' in connections('/tool', '/simulation')) == bool(publishers), 'connection')
      time.sleep(0.05)  # for the latched message
    states.clear()
    states.wait(lambda s: s.device_force.z > 0.2, 'push after the scene came again')
    self.assertFalse([e for j in journals.messages for e in j.entries if e.topic == 'lockstep' and 'left' in e.reason])
    self.assertEqual(player.wait(timeout=60), 0)  # a killed one's child would answer for the next test's
    self.stop(nodes)

  def testADeviceThatFallsSilentEndsTheLockstepAndThePush(self):
    states = self.listen('tool/state', ToolState, keep=100000)
    journals, nodes = self.startNodes('run.bag', lockstep='true')
    player = self.startPlayer(rate=1)
    states.wait(lambda s: s.device_force.z > 0.2, 'push')
    player.kill()
    player.wait()
    note = journals.wait(lambda j: any(e.topic == 'lockstep' for e in j.entries), 'end of the lockstep')
    self.assertIn('left', [e.reason for e in note.entries if e.topic == 'lockstep'][0])
    graph.wait_until(lambda: states.messages[-1].device_force.z == 0.0, 'rest of the motors')
    journals.wait(lambda j: j.step > note.step + 200, 'steps out of lockstep')
    self.wait_for_warning('tool', 'lockstep', 'silent')
    self.stop(nodes)


if __name__ == '__main__':
  graph.run('lockstep_graph_test', simulated_time=True)
