"""What the tests of the running graph share: nodes as child processes, listeners that can be waited for, lockstep.

Nothing here depends on how fast the machine is: tests wait for conditions, with a limit that only a failure reaches.
"""

import os
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
import time
import unittest
import warnings

import rosgraph
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point
from soft_volume.msg import GridTopology, JournalEntry, Scene, SimulationJournal, ToolCut, ToolForce, Volume
from soft_volume.srv import RestoreCheckpoint, SaveCheckpoint, StepSimulation
from std_srvs.srv import SetBool, Trigger

import phantom

LIMIT_S = 30.0

# Without a queue publish() returns when the message is on its way, which lockstep needs. rospy warns of it.
warnings.filterwarnings('ignore', message='.*queue_size.*')


def wait_until(condition, what, limit_s=LIMIT_S):
  """Polls until `condition()` is true and returns its value; fails with `what` after the limit."""
  end = time.monotonic() + limit_s
  while time.monotonic() < end:
    value = condition()
    if value:
      return value
    time.sleep(0.01)
  raise AssertionError('after %.0f s: still no %s' % (limit_s, what))


def dying_with_us(signal_name):
  """What a command starts with to get a signal when this process dies, whatever of: a test leaves nothing running."""
  return ['setpriv', '--pdeathsig', signal_name]


class Node:
  """A node of the package in a process of its own."""

  def __init__(self, program, name, parameters, folder, environment=None, keys=False):
    self.name = name
    self._log = os.path.join(folder, '%s-%d.log' % (name, time.monotonic_ns()))
    command = dying_with_us('KILL') + [os.path.join(os.environ['SOFT_VOLUME_TEST_BIN'], program), '__name:=' + name]
    command += ['_%s:=%s' % (key, value) for key, value in parameters.items()]
    with open(self._log, 'w') as log:
      self.process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT,
                                      stdin=subprocess.PIPE if keys else subprocess.DEVNULL,
                                      env=dict(os.environ, OMP_WAIT_POLICY='passive', **(environment or {})))

  def type(self, keys):
    """Keys of the node's terminal; only of one that was started with `keys`."""
    self.process.stdin.write(keys.encode())
    self.process.stdin.flush()

  def output(self):
    with open(self._log, errors='replace') as log:
      return log.read()

  def alive(self):
    return self.process.poll() is None

  def kill(self):
    self.process.kill()
    self.process.wait()

  def stop(self):
    """Ends the node as a user would; returns its exit code."""
    if self.alive():
      self.process.send_signal(signal.SIGINT)
    try:
      return self.process.wait(timeout=15)
    except subprocess.TimeoutExpired:
      self.kill()
      return None


class Listener:
  """Keeps the messages of a topic."""

  def __init__(self, topic, message_type, keep=2000):
    self.topic = topic
    self._keep = keep
    self._messages = []
    self._condition = threading.Condition()
    self._subscriber = rospy.Subscriber(topic, message_type, self._hear, queue_size=1000, tcp_nodelay=True)

  def _hear(self, message):
    with self._condition:
      self._messages.append((rospy.get_time(), message))
      del self._messages[:-self._keep]
      self._condition.notify_all()

  @property
  def messages(self):
    with self._condition:
      return [message for _, message in self._messages]

  @property
  def timed(self):
    """Pairs of the ROS time at which a message was heard, and the message."""
    with self._condition:
      return list(self._messages)

  def clear(self):
    with self._condition:
      self._messages.clear()

  def wait(self, condition=lambda message: True, what='message', limit_s=LIMIT_S):
    """The first message kept, or to come, that meets the condition."""
    end = time.monotonic() + limit_s
    seen = 0
    with self._condition:
      while True:
        for _, message in self._messages:
          if condition(message):
            return message
        left = end - time.monotonic()
        if left <= 0:
          raise AssertionError('after %.0f s: no %s on %s, which had %d messages' %
                               (limit_s, what, self.topic, len(self._messages)))
        self._condition.wait(min(left, 0.5))

  def connect(self):
    """Waits for the publisher, so that nothing is missed that it sends from now on."""
    wait_until(lambda: self._subscriber.get_num_connections() > 0, 'publisher of ' + self.topic)

  def close(self):
    self._subscriber.unregister()


class GraphTest(unittest.TestCase):
  """A test with nodes. Every node that it started must live to the end and then stop cleanly, unless it was killed."""

  def setUp(self):
    self.folder = tempfile.mkdtemp(dir=os.environ['SOFT_VOLUME_TEST_FOLDER'])
    self._nodes = []
    self._killed = set()
    self._listeners = []
    self._publishers = []
    # From the start: a warning is shown in one period only.
    self._diagnostics = self.listen('/diagnostics', DiagnosticArray)

  def tearDown(self):
    dead = [node for node in self._nodes if node not in self._killed and not node.alive()]
    codes = {node: node.stop() for node in reversed(self._nodes) if node not in self._killed}
    for thing in self._listeners:
      thing.close()
    for thing in self._publishers:
      thing.unregister()
    for name in {node.name for node in self._nodes}:
      if rospy.has_param('/' + name):
        rospy.delete_param('/' + name)
    outputs = '\n'.join('--- %s\n%s' % (node.name, node.output()) for node in self._nodes)
    shutil.rmtree(self.folder, ignore_errors=True)
    if self._failed():
      print(outputs)
    self.assertEqual([node.name for node in dead], [], 'nodes that died:\n' + outputs)
    self.assertEqual([node.name for node, code in codes.items() if code != 0], [],
                     'nodes that did not stop cleanly:\n' + outputs)

  def _failed(self):
    result = self._outcome.result
    return any(test is self for test, _ in result.failures + result.errors)

  def start(self, program, name=None, environment=None, keys=False, **parameters):
    name = name or program.replace('_node', '')
    if rospy.has_param('/' + name):  # of a node before
      rospy.delete_param('/' + name)
    node = Node(program, name, parameters, self.folder, environment, keys)
    self._nodes.append(node)
    return node

  def kill(self, node):
    """kill -9, from which nothing recovers."""
    self._killed.add(node)
    node.kill()

  def finish(self, node):
    """Waits for a node that is to end by itself; returns its exit code."""
    self._killed.add(node)
    return node.process.wait(timeout=LIMIT_S)

  def listen(self, topic, message_type, **options):
    listener = Listener(topic, message_type, **options)
    self._listeners.append(listener)
    return listener

  def unlisten(self, listener):
    self._listeners.remove(listener)
    listener.close()

  def publisher(self, topic, message_type):
    """A publisher that sends before publish() returns, connected to its receivers: nodes, and this test if it listens."""
    publisher = rospy.Publisher(topic, message_type, queue_size=None, tcp_nodelay=True)
    self._publishers.append(publisher)
    self.wait_for_receivers(publisher, topic)
    return publisher

  @staticmethod
  def wait_for_receivers(publisher, topic):
    """The master knows a subscriber before its connection stands."""
    wait_until(lambda: 0 < len(subscribers(topic)) <= publisher.get_num_connections(), 'subscriber of ' + topic)

  def call(self, service, service_type, *arguments):
    rospy.wait_for_service(service, timeout=LIMIT_S)
    return rospy.ServiceProxy(service, service_type)(*arguments)

  def wait_for_status(self, node, condition, what):
    """Waits for a status of a node in diagnostics, which come once a second, that meets the condition."""
    self._diagnostics.wait(
        lambda array: any(node in status.name and condition(status) for status in array.status),
        'status of %s with %s' % (node, what))

  def wait_for_warning(self, node, *parts):
    """Waits for a warning of a node whose summary holds all `parts`."""
    self.wait_for_status(node, lambda status: is_warning(status) and all(p in status.message for p in parts),
                         'a warning of ' + ', '.join(parts))

  def warned(self, node, *parts):
    """Whether a warning of a node whose summary holds all `parts` has come."""
    return any(
        node in status.name and is_warning(status) and all(p in status.message for p in parts)
        for array in self._diagnostics.messages for status in array.status)

  def wait_for_refusals(self, node, topic, count, reason):
    """Waits until a node has refused so many messages of a topic, has warned of it, and the last reason holds `reason`."""
    refused, last = 'refused on ' + topic, 'last reason on ' + topic

    def refuses(status):
      values = {v.key: v.value for v in status.values}
      return values.get(refused) == str(count) and reason in values[last]

    self.wait_for_warning(node, topic)
    self.wait_for_status(node, refuses, '%d messages of %s refused, the last with "%s"' % (count, topic, reason))


def subscribers(topic):
  """Names of the nodes that listen to a topic, as the master knows them."""
  listeners = dict(rosgraph.Master(rospy.get_name()).getSystemState()[1])
  return listeners.get(rospy.resolve_name(topic), [])


def is_warning(status):
  return status.level in (1, b'\x01')


class Simulation:
  """A simulation node, by default paused, and what is needed to drive it in lockstep."""

  def __init__(self, test, scene=None, **parameters):
    self._test = test
    settings = dict(start_paused='true', real_time_factor=0)
    settings.update(parameters)
    self.node = test.start('simulation_node', scene=phantom.write_scene(test.folder, scene), **settings)
    # Once it is up: rospy now and then misses what a publisher latches while both are being connected.
    rospy.wait_for_service('simulation/step', timeout=LIMIT_S)
    self.scenes = test.listen('scene', Scene)
    self.topologies = test.listen('grid/topology', GridTopology)
    self.journals = test.listen('simulation/journal', SimulationJournal, keep=100000)
    self.scenes.wait(what='scene')
    self.topologies.wait(what='topology')
    self.journals.connect()

  @property
  def session(self):
    return self.scenes.messages[-1].session

  @property
  def revision(self):
    """The newest that has come: for what waits for another one, waitForRevision()."""
    return self.topologies.messages[-1].revision

  def waitForRevision(self, revision):
    """Topics are not ordered among each other: the journal of a cut may come before its topology."""
    self.topologies.wait(lambda t: t.session == self.session and t.revision == revision, 'revision %d' % revision)

  def open_inputs(self):
    self._force = self._test.publisher('tool/force', ToolForce)
    self._cut = self._test.publisher('tool/cut', ToolCut)

  def waitForReceivers(self):
    """Of the inputs, among them those that have come since they were opened."""
    self._test.wait_for_receivers(self._force, 'tool/force')
    self._test.wait_for_receivers(self._cut, 'tool/cut')

  def step(self, steps):
    """Steps a paused simulation and returns the journal of the end, whose state_hash is that of the state."""
    response = self._test.call('simulation/step', StepSimulation, steps)
    self._test.assertTrue(response.success, response.message)
    return self.journals.wait(lambda j: j.step == response.step and j.session == self.session, 'journal')

  def pause(self, paused):
    response = self._test.call('simulation/pause', SetBool, paused)
    self._test.assertTrue(response.success)

  def reset(self):
    """A new session; returns its number."""
    old = self.session
    self._test.assertTrue(self._test.call('simulation/reset', Trigger).success)
    self.scenes.wait(lambda s: s.session != old and s is self.scenes.messages[-1], 'new scene')
    self.topologies.wait(lambda t: t.session == self.session, 'topology of the new session')
    return self.session

  def save(self):
    response = self._test.call('simulation/save_checkpoint', SaveCheckpoint)
    self._test.assertTrue(response.success)
    return response.checkpoint

  def restore(self, checkpoint):
    """Returns the response; after success the new session is known."""
    old = self.session
    response = self._test.call('simulation/restore_checkpoint', RestoreCheckpoint, checkpoint)
    if response.success:
      self.scenes.wait(lambda s: s.session != old and s is self.scenes.messages[-1], 'new scene')
      self.topologies.wait(lambda t: t.session == self.session, 'topology of the new session')
    return response

  def push(self, sequence, apply_at_step=0, **changes):
    """Sends a force of 0.4 N down onto a corner of the block's top face, unless `changes` say otherwise."""
    message = ToolForce(session=self.session, revision=self.revision, step=1, tool_id='probe', sequence=sequence,
                        apply_at_step=apply_at_step, hold_steps=300, footprint_radius=0.012)
    message.force.z = -0.4
    message.point.x, message.point.y, message.point.z = 0.027, 0.027, phantom.TOP_Z_M
    self._change(message, changes)
    self._force.publish(message)

  def cut(self, sequence, apply_at_step=0, **changes):
    """Sends a sweep of 30 mm along the middle of the block's top face, 15 mm deep."""
    message = ToolCut(session=self.session, revision=self.revision, step=1, tool_id='probe', sequence=sequence,
                      apply_at_step=apply_at_step)
    for y, z in ((0.03, 0.055), (0.03, 0.085), (0.06, 0.085), (0.06, 0.055)):
      message.quads.append(Point(0.047, y, z))
    self._change(message, changes)
    self._cut.publish(message)

  def entries(self, outcome=None):
    """Journal entries of this session that are inputs of tools, in order."""
    return [
        entry for journal in self.journals.messages if journal.session == self.session for entry in journal.entries
        if entry.topic.startswith('tool/') and outcome in (None, entry.outcome)
    ]

  def refused(self):
    return self.entries(JournalEntry.REFUSED)

  def applied(self):
    return self.entries(JournalEntry.APPLIED)

  @staticmethod
  def _change(message, changes):
    for path, value in changes.items():
      target = message
      *parents, field = path.split('__')
      for parent in parents:
        target = target[int(parent)] if parent.isdigit() else getattr(target, parent)
      setattr(target, field, value)


class Master:
  """A master of the test's own, which can be killed and started again at the same address."""

  def __init__(self):
    self._port = free_port()
    self.uri = 'http://127.0.0.1:%d' % self._port
    self.start()

  def start(self):
    environment = dict(os.environ, ROS_MASTER_URI=self.uri)
    self._process = subprocess.Popen(
        dying_with_us('TERM') + ['rosmaster', '--core', '-p', str(self._port)], stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL, env=environment)
    wait_until(lambda: rosgraph.is_master_online(self.uri), 'master')

  def kill(self):
    self._process.kill()
    self._process.wait()

  def registrations(self, nodes):
    """Triples of a kind, a topic or service, and a node, for the nodes of these names."""
    state = rosgraph.Master('/test', self.uri).getSystemState()
    return {(kind, name, node) for kind, entries in enumerate(state) for name, having in entries for node in having
            if node.strip('/') in nodes}


def free_port():
  with socket.socket() as probe:
    probe.bind(('127.0.0.1', 0))
    return probe.getsockname()[1]


master = None  # one of the test's own, where it has to restart it; the module of the tests is not that of the program


def run(name, simulated_time=False):
  """Runs all tests of the program `name`, which is the caller."""
  import rostest
  rospy.set_param('/use_sim_time', simulated_time)
  rospy.init_node(name, anonymous=True)
  rostest.rosrun('soft_volume', name, name)
