#!/usr/bin/python3
"""Does to a running graph what happens to graphs, and measures what it costs. A part of scripts/faults and of the test
fault_graph_test, in the ROS environment of a build; starts masters of its own.
"""

import argparse
import collections
import ctypes
import glob
import json
import os
import shutil
import signal
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
import time
import xmlrpc.client

import yaml

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
sys.path.insert(0, os.path.join(ROOT, 'test', 'ros'))
import phantom  # noqa: E402  the small scene of the tests

NODES = ('simulation', 'tool', 'device', 'renderer', 'recorder')
PUSH_N = 0.03  # a force that says that hand, tool and simulation are connected; soft, for busy machines
LIMIT_S = 60.0
RECOVERY_LIMIT_S = 15.0
MASTER_LIMIT_S = 5.0
NETWORK_LIMIT_S = 10.0
REST_GAP_S = 1.0  # longest silence of what a fault does not concern
RECORDER_GAP_S = 2.5  # its status comes once a second
LOST_LIMIT_S = 1.0
TISSUE_LIMIT_S = 0.1  # of simulated time; the journal is written every 0.02 s
MEMORY_LIMIT_MIB = 20.0  # of growth over a fault
RECORDER_MEMORY_LIMIT_MIB = 200.0  # it takes up what came while its disk or the master was away
WINDOW_S = 3.0
Seen = collections.namedtuple('Seen', 'time what session step value')


class Failure(Exception):
  pass


# What ends a part of the run; the figures from before stay.
BROKEN = (Failure, OSError, subprocess.SubprocessError, xmlrpc.client.Error)


def wait_until(condition, what, limit_s=LIMIT_S):
  """Polls; returns the value of `condition` once it is true."""
  end = time.monotonic() + limit_s
  while time.monotonic() < end:
    value = condition()
    if value:
      return value
    time.sleep(0.02)
  raise Failure('after %.0f s: still no %s' % (limit_s, what))


# ------------------------------------------------------------------------------------------------------------ processes


class Process:
  """A child that ends with us, in a network namespace if one is named."""

  def __init__(self, command, log, environment, namespace=None):
    prefix = ['ip', 'netns', 'exec', namespace] if namespace else []
    self.log = log
    with open(log, 'ab') as out:
      self._process = subprocess.Popen(prefix + ['setpriv', '--pdeathsig', 'TERM', '--'] + command, stdout=out,
                                       stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, start_new_session=True,
                                       env=dict(os.environ, **environment))

  @property
  def pid(self):
    return self._process.pid

  def alive(self):
    return self._process.poll() is None

  def kill(self):
    """The process and its children, as a power switch would."""
    os.killpg(self._process.pid, signal.SIGKILL)
    self._process.wait()

  def stop(self, limit_s=30):
    if self.alive():
      self._process.send_signal(signal.SIGINT)
    try:
      return self._process.wait(timeout=limit_s)
    except subprocess.TimeoutExpired:
      self.kill()
      return None


def memory_mib(pid):
  try:
    with open('/proc/%d/status' % pid) as status:
      return next(int(line.split()[1]) / 1024.0 for line in status if line.startswith('VmRSS'))
  except (OSError, StopIteration):
    return None


class Master:
  """roscore, run separately."""

  def __init__(self, folder, address='127.0.0.1', namespace=None):
    with socket.socket() as probe:
      probe.bind(('127.0.0.1', 0))
      self.port = probe.getsockname()[1]
    self._folder = folder
    self._namespace = namespace
    self.uri = 'http://%s:%d' % (address, self.port)
    self.environment = {'ROS_MASTER_URI': self.uri, 'ROS_IP': address}
    self.start()

  def start(self):
    self._process = Process(['roscore', '-p', str(self.port)], os.path.join(self._folder, 'roscore.log'),
                            self.environment, self._namespace)
    wait_until(lambda: self.online() and self.node_uri('/rosout'), 'roscore')

  def kill(self):
    """All of it at once: roscore's children are in sessions of their own."""
    children = [self.api().getPid('/faults')[2], self.pid('rosout')]
    self._process.kill()
    for pid in children:
      os.kill(pid, signal.SIGKILL)

  def stop(self):
    self._process.stop()

  def api(self):
    return xmlrpc.client.ServerProxy(self.uri)

  def online(self):
    try:
      return self.api().getPid('/faults')[0] == 1
    except OSError:
      return False

  def node_uri(self, node):
    code, _, uri = self.api().lookupNode('/faults', node)
    return uri if code == 1 else None

  def pid(self, node):
    """Of a node that runs; None while it does not."""
    try:
      uri = self.node_uri('/' + node)
      return xmlrpc.client.ServerProxy(uri).getPid('/faults')[2] if uri else None
    except OSError:
      return None

  def registrations(self, nodes):
    state = self.api().getSystemState('/faults')[2]
    return {(kind, name, node) for kind, entries in enumerate(state) for name, having in entries for node in having
            if node.strip('/') in nodes}

  def parameters(self, nodes):
    return {node: self.api().getParam('/faults', '/' + node) for node in nodes}


# ---------------------------------------------------------------------------------------------------------- observation


def observe(path):
  """The observer's program: one line for each message heard, with the time at which it came."""
  import rospy
  from soft_volume.msg import GridState, RecorderStatus, SimulationJournal, ToolState
  rospy.init_node('observer', anonymous=True, disable_signals=True)
  out = open(path, 'a', buffering=1)
  lock = threading.Lock()

  def hear(what, session=lambda m: 0, step=lambda m: 0, value=lambda m: 0):
    def write(message):
      line = '%.4f %s %d %d %s\n' % (time.monotonic(), what, session(message), step(message), value(message))
      with lock:
        out.write(line)

    return write

  run = dict(session=lambda m: m.session, step=lambda m: m.step)
  subscribe = lambda topic, kind, what, **fields: rospy.Subscriber(topic, kind, hear(what, **fields), queue_size=10000,
                                                                   tcp_nodelay=True)
  subscribe('grid/state', GridState, 'grid', **run)
  subscribe('simulation/journal', SimulationJournal, 'journal', value=lambda m: m.state_hash, **run)
  subscribe('tool/state', ToolState, 'tool', value=lambda m: m.device_force.z, **run)
  subscribe('top/image_raw', rospy.AnyMsg, 'image')
  subscribe('recorder/status', RecorderStatus, 'recorder', value=lambda m: m.messages if m.recording else 0)
  while os.getppid() != 1:
    time.sleep(0.2)


class Observer:
  """What an observer has heard so far."""

  def __init__(self, folder, environment, namespace=None):
    self._path = tempfile.mktemp(dir=folder, suffix='.observed')
    open(self._path, 'w').close()
    self._process = Process([os.path.abspath(__file__), '--observe', self._path],
                            os.path.join(folder, 'observer.log'), environment, namespace)
    self._file = open(self._path)
    self._rest = ''
    self.all = []

  def update(self):
    text = self._rest + self._file.read()
    lines = text.split('\n')
    self._rest = lines.pop()
    for line in lines:
      t, what, session, step, value = line.split()
      self.all.append(Seen(float(t), what, int(session), int(step), float(value) if what == 'tool' else int(value)))
    return self.all

  def since(self, start, what):
    """From the newest ones back: there are many."""
    found = []
    for seen in reversed(self.update()):
      if seen.time < start:
        break
      if seen.what == what:
        found.append(seen)
    return found[::-1]

  def first(self, start, what, condition=lambda seen: True):
    return next((seen for seen in self.since(start, what) if condition(seen)), None)

  def longest_gap(self, start, end, what):
    times = [start] + [seen.time for seen in self.since(start, what) if seen.time <= end] + [end]
    return max(b - a for a, b in zip(times, times[1:]))

  def close(self):
    self._process.kill()
    self._file.close()


# --------------------------------------------------------------------------------------------------------------- faults


class Graph:
  """A graph on this host: roscore, the launch file that starts dead nodes again, and an observer."""

  def __init__(self, programs, folder, scene):
    self.folder = folder
    self._programs = programs
    self.bag = os.path.join(folder, 'faults.bag')
    self.master = Master(folder)
    self.launch = Process(
        ['roslaunch', '--wait', '-p', str(self.master.port), 'soft_volume', 'demo.launch', 'respawn:=true',
         'scene:=' + scene, 'simulated_time:=false', 'start_paused:=true', 'bag:=' + self.bag,
         'resume_file:=' + folder + '/run.resume'],
        os.path.join(folder, 'launch.log'), self.master.environment)
    self.observer = Observer(folder, self.master.environment)
    # Nothing moves before all are there, so that the recording has the beginning.
    wait_until(lambda: self.observer.first(0, 'recorder', lambda s: s.value > 0), 'recorder')
    wait_until(lambda: self.listens('/simulation/journal', '/recorder'), 'recorder of the journal')
    time.sleep(1.0)
    start_simulation(self.master)
    self.wait_for_all(time.monotonic())
    time.sleep(WINDOW_S)

  def wait_for_all(self, start):
    wait_until(lambda: self.observer.first(start, 'tool', lambda s: s.value > PUSH_N), 'push')
    wait_until(lambda: self.observer.first(start, 'image'), 'image')
    wait_until(lambda: self.observer.first(start, 'recorder', lambda s: s.value > 0), 'recorder')

  def listens(self, topic, node):
    return node in dict(self.master.api().getSystemState('/faults')[2][1]).get(topic, [])

  def pids(self):
    return {node: wait_until(lambda n=node: self.master.pid(n), node) for node in NODES}

  def memory(self):
    return {node: memory_mib(pid) for node, pid in self.pids().items()}

  def new_observer(self):
    """Of a new master, which does not know the old one."""
    self.observer.close()
    self.observer = Observer(self.folder, self.master.environment)

  def stop(self):
    self.observer.close()
    self.launch.stop(60)
    self.master.stop()


def start_simulation(master, namespace=None):
  prefix = ['ip', 'netns', 'exec', namespace] if namespace else []
  subprocess.run(prefix + ['rosservice', 'call', '--wait', '/simulation/pause', 'false'], check=True, timeout=LIMIT_S,
                 capture_output=True, env=dict(os.environ, **master.environment))


def result(fault, **figures):
  return dict(fault=fault, **figures)


def rest_gaps(observer, start, end, concerned):
  """Longest silences of what a fault does not concern."""
  return {what: round(observer.longest_gap(start, end, what), 3) for what in ('grid', 'tool', 'image')
          if what not in concerned}


def judge(figures):
  """Adds whether it was survived, and why not."""
  limit = figures.get('recovery_limit_s', RECOVERY_LIMIT_S)
  reasons = []
  if figures.get('recovery_s', 0.0) > limit:
    reasons.append('it took longer than %g s' % limit)
  for what, gap_s in figures.get('longest_silence_s', {}).items():
    if gap_s > REST_GAP_S:
      reasons.append('%s was silent for %.1f s' % (what, gap_s))
  if figures.get('longest_silence_of_recorder_s', 0.0) > RECORDER_GAP_S:
    reasons.append('the recorder stood still for %.1f s' % figures['longest_silence_of_recorder_s'])
  if figures.get('tissue_lost_s', 0.0) > TISSUE_LIMIT_S:
    reasons.append('tissue states of %.3f s were lost' % figures['tissue_lost_s'])
  if not figures.get('same_bits', True):
    reasons.append('the resumed run is not the journaled one' if figures['same_bits'] is False else
                   'no journaled state was heard before and after, so they cannot be compared')
  if figures.get('recording_lost_s', 0.0) > LOST_LIMIT_S:
    reasons.append('%.1f s of the recording were lost' % figures['recording_lost_s'])
  for node, (before, after) in figures.get('memory_mib', {}).items():
    if before and after and after - before > (RECORDER_MEMORY_LIMIT_MIB if node == 'recorder' else MEMORY_LIMIT_MIB):
      reasons.append('%s grew by %.0f MiB' % (node, after - before))
  figures['survived'] = not reasons
  figures['reasons'] = reasons
  return figures


def memory_change(before, after, without=()):
  return {node: (before[node] and round(before[node], 1), after[node] and round(after[node], 1)) for node in before
          if node not in without}


# What is silent for a while when a node is killed.
CONCERNS = {'simulation': ('grid', 'image'), 'tool': ('tool',), 'device': (), 'renderer': ('image',), 'recorder': ()}


def works_again(graph, node, start):
  """What says that a node that was killed at `start` is back in its place."""
  observer = graph.observer
  if node == 'simulation':
    session = observer.update() and next((s.session for s in observer.all if s.what == 'grid' and s.time > start - 1), 0)
    return observer.first(start, 'tool', lambda s: s.session > session and s.value > PUSH_N)
  if node == 'tool':
    return observer.first(start + 0.05, 'tool', lambda s: s.value > PUSH_N)
  if node == 'device':
    silent = observer.first(start, 'tool', lambda s: s.value == 0.0)
    return silent and observer.first(silent.time, 'tool', lambda s: s.value > PUSH_N)
  if node == 'renderer':
    return observer.first(start + 0.05, 'image')
  return observer.first(start + 0.05, 'recorder', lambda s: s.value > 0)


def tissue_loss(observed, start):
  """Simulated time between the last state that was seen and the one that a killed simulation went on with, and whether
  the first step that both journaled is the same state; None when there is none."""
  journals = [s for s in observed if s.what == 'journal']
  last_session = max(s.session for s in journals if s.time < start)
  old = {s.step: s.value for s in journals if s.session == last_session}
  new = [s for s in journals if s.session > last_session]
  last_state = max(s.step for s in observed if s.what == 'grid' and s.session == last_session)
  same = next((old[s.step] == s.value for s in new if s.step in old), None)
  return max(0.0, (last_state - new[0].step) * 1e-3), same


def wait_for_journal(observer):
  """The next one is 20 ms away then: a kill right between its file and its listeners leaves nothing to compare."""
  start = time.monotonic()
  while not observer.first(start, 'journal'):
    if time.monotonic() > start + LIMIT_S:
      raise Failure('after %.0f s: still no journal' % LIMIT_S)
    time.sleep(0.001)


def kill_node(graph, node):
  before, pid = graph.memory(), graph.master.pid(node)
  others = {n: p for n, p in graph.pids().items() if n != node}
  if node == 'simulation':
    wait_for_journal(graph.observer)
  start, wall = time.monotonic(), time.time()
  os.kill(pid, signal.SIGKILL)
  back = wait_until(lambda: works_again(graph, node, start), '%s at work after it was killed' % node)
  time.sleep(1.0)
  end = time.monotonic()
  figures = result('kill ' + node, recovery_s=round(back.time - start, 2), killed_at=wall,
                   longest_silence_s=rest_gaps(graph.observer, start, end, CONCERNS[node]),
                   memory_mib=memory_change(before, graph.memory(), without=(node,)))
  if node == 'simulation':
    lost, figures['same_bits'] = tissue_loss(graph.observer.update(), start)
    figures['tissue_lost_s'] = round(lost, 3)
  if any(graph.master.pid(n) != p for n, p in others.items()):
    raise Failure('another node died with the %s' % node)
  return judge(figures)


def restart_master(graph, away_s):
  before, memory = graph.master.registrations(NODES), graph.memory()
  parameters = graph.master.parameters(NODES)
  time.sleep(2.0)
  start = time.monotonic()
  graph.master.kill()
  time.sleep(away_s)
  graph.master.start()
  back = time.monotonic()
  wait_until(lambda: before <= graph.master.registrations(NODES), 'registrations as before')
  registered = time.monotonic()
  wait_until(lambda: graph.master.parameters(NODES) == parameters, 'parameters as before')
  gaps = rest_gaps(graph.observer, start, registered, ())
  recorder_s = graph.observer.longest_gap(start, registered, 'recorder')
  graph.new_observer()
  graph.wait_for_all(registered)  # for one that comes later
  return judge(result('roscore restarted after %g s' % away_s, recovery_s=round(registered - back, 2),
                      recovery_limit_s=MASTER_LIMIT_S, longest_silence_s=gaps, registrations=len(before),
                      longest_silence_of_recorder_s=round(recorder_s, 2),
                      memory_mib=memory_change(memory, graph.memory())))


def slow_renderer(graph, duration_s):
  """Gives it a tenth of its time."""
  before, pid = graph.memory(), graph.master.pid('renderer')
  start = time.monotonic()
  try:
    while time.monotonic() < start + duration_s:
      os.kill(pid, signal.SIGSTOP)
      time.sleep(0.09)
      os.kill(pid, signal.SIGCONT)
      time.sleep(0.01)
  finally:
    os.kill(pid, signal.SIGCONT)
  end = time.monotonic()
  images = len(graph.observer.since(start, 'image'))
  back = wait_until(lambda: graph.observer.first(end, 'image'), 'image')
  return judge(result('renderer 10 times too slow for %g s' % duration_s, recovery_s=round(back.time - end, 2),
                      images=images, longest_silence_s=rest_gaps(graph.observer, start, end, ('image',)),
                      memory_mib=memory_change(before, graph.memory())))


class SilentSubscriber:
  """Asks for a topic as a node does, and never reads what comes."""

  def __init__(self, master, topic):
    api = master.api()
    state = dict(api.getSystemState('/faults')[2][0])
    publisher = xmlrpc.client.ServerProxy(master.node_uri(state[topic][0]))
    kinds = dict(api.getTopicTypes('/faults')[2])
    _, _, (_, host, port) = publisher.requestTopic('/never_reads', topic, [['TCPROS']])
    self._socket = socket.create_connection((host, port))
    self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65536)
    fields = dict(callerid='/never_reads', topic=topic, type=kinds[topic], md5sum='*', tcp_nodelay='1')
    header = b''.join(struct.pack('<I', len(f)) + f for f in (('%s=%s' % i).encode() for i in fields.items()))
    self._socket.sendall(struct.pack('<I', len(header)) + header)

  def close(self):
    self._socket.close()


def silent_subscriber(graph, duration_s):
  before = graph.memory()
  topics = ('/grid/state', '/grid/topology', '/volume', '/tool/state', '/simulation/journal', '/top/image_raw')
  start = time.monotonic()
  subscribers = [SilentSubscriber(graph.master, topic) for topic in topics]
  time.sleep(duration_s)
  after, end = graph.memory(), time.monotonic()
  for subscriber in subscribers:
    subscriber.close()
  time.sleep(1.0)
  return judge(result('a subscriber of %d topics that never reads for %g s' % (len(topics), duration_s), recovery_s=0.0,
                      longest_silence_s=rest_gaps(graph.observer, start, end, ()),
                      memory_mib=memory_change(before, after)))


# -------------------------------------------------------------------------------------------------------------- network


class Hosts:
  """Two network namespaces, each with an address, on a switch in a third one."""

  ADDRESSES = ('10.77.31.1', '10.77.31.2')

  def __init__(self):
    self._tag = 'sv%d' % (os.getpid() % 100000)
    self.names = [self._tag + 'a', self._tag + 'b']
    self._switch = self._tag + 's'
    for name in self.names + [self._switch]:
      self._ip('netns', 'add', name)
      self._ip('-n', name, 'link', 'set', 'lo', 'up')
    self._ip('-n', self._switch, 'link', 'add', 'switch', 'type', 'bridge')
    self._ip('-n', self._switch, 'link', 'set', 'switch', 'up')
    for n, name in enumerate(self.names):
      port = 'port%d' % n
      self._ip('-n', name, 'link', 'add', 'eth0', 'type', 'veth', 'peer', 'name', port, 'netns', self._switch)
      self._ip('-n', name, 'addr', 'add', self.ADDRESSES[n] + '/24', 'dev', 'eth0')
      self._ip('-n', name, 'link', 'set', 'eth0', 'up')
      self._ip('-n', self._switch, 'link', 'set', port, 'master', 'switch', 'up')

  def _ip(self, *arguments):
    subprocess.run(('ip',) + arguments, check=True, capture_output=True)

  def set_link(self, up):
    """Pulls the second host's cable."""
    self._ip('-n', self._switch, 'link', 'set', 'port1', 'up' if up else 'down')

  def close(self):
    for name in self.names + [self._switch]:
      subprocess.run(['ip', 'netns', 'del', name], capture_output=True)

  @staticmethod
  def missing():
    """Why it cannot be tried here; None when it can."""
    if os.geteuid() != 0:
      return 'network namespaces need root'
    if shutil.which('ip') is None:
      return 'network namespaces need iproute2'
    name = 'sv%dt' % (os.getpid() % 100000)
    if subprocess.run(['ip', 'netns', 'add', name], capture_output=True).returncode != 0:
      return 'this system allows no network namespaces'
    subprocess.run(['ip', 'netns', 'del', name], capture_output=True)
    return None


def enter(namespace):
  """Moves this thread into a network namespace; returns what leaves it again."""
  libc = ctypes.CDLL(None, use_errno=True)
  home = os.open('/proc/thread-self/ns/net', os.O_RDONLY)
  there = os.open('/run/netns/' + namespace, os.O_RDONLY)
  if libc.setns(there, 0) != 0:
    raise Failure('the network namespace cannot be entered: ' + os.strerror(ctypes.get_errno()))
  os.close(there)
  return lambda: (libc.setns(home, 0), os.close(home))


def start_split_graph(programs, folder, scene, hosts):
  """Master, simulation and recorder on the first host; hand, tool and renderer on the second. Returns processes."""
  master = Master(folder, hosts.ADDRESSES[0], hosts.names[0])
  environments = [{'ROS_MASTER_URI': master.uri, 'ROS_IP': address} for address in hosts.ADDRESSES]

  def start(host, program, **parameters):
    command = [os.path.join(programs, program + '_node'), '__name:=' + program]
    command += ['_%s:=%s' % p for p in parameters.items()]
    return Process(command, os.path.join(folder, program + '.log'), environments[host], hosts.names[host])

  api = master.api()
  api.setParam('/faults', '/use_sim_time', False)
  processes = {
      'recorder': start(0, 'recorder', file=os.path.join(folder, 'network.bag')),
      'simulation': start(0, 'simulation', scene=scene, start_paused='true'),
      'renderer': start(1, 'renderer'),
      'tool': start(1, 'tool'),
      'device': start(1, 'device', scene=scene)
  }
  observers = [Observer(folder, environments[n], hosts.names[n]) for n in (0, 1)]
  wait_until(lambda: observers[0].first(0, 'recorder', lambda s: s.value > 0), 'recorder')
  wait_until(lambda: '/recorder' in dict(api.getSystemState('/faults')[2][1]).get('/simulation/journal', []),
             'recorder of the journal')
  time.sleep(1.0)
  start_simulation(master, hosts.names[0])
  return master, processes, observers


def link_outage(hosts, processes, observers, outage_s):
  """Both sides are observed at home: the observers have no part in what crosses the link."""
  here, there = observers
  before = {node: memory_mib(process.pid) for node, process in processes.items()}
  hosts.set_link(False)
  start = time.monotonic()
  time.sleep(outage_s)
  end = time.monotonic()
  gaps = {'grid at home': here.longest_gap(start, end, 'grid'), 'tool at home': there.longest_gap(start, end, 'tool')}
  felt = [s for s in there.since(end - 0.5, 'tool') if s.value != 0.0]
  hosts.set_link(True)
  # A force needs patches from there and the hand here; an image of a new step needs states.
  step = here.since(end - 1.0, 'grid')[-1].step
  push = wait_until(lambda: there.first(end, 'tool', lambda s: s.step >= step and s.value > PUSH_N), 'push')
  image = wait_until(lambda: there.first(end + 0.2, 'image'), 'image')
  time.sleep(2.0)
  if outage_s > 2.0 and felt:
    raise Failure('the hand felt a force without patches')
  return judge(result('link down for %g s' % outage_s, recovery_s=round(max(push.time, image.time) - end, 2),
                      recovery_limit_s=NETWORK_LIMIT_S, began=time.time() - (time.monotonic() - start),
                      ended=time.time() - (time.monotonic() - end),
                      longest_silence_s={what: round(gap, 3) for what, gap in gaps.items()},
                      memory_mib=memory_change(before, {n: memory_mib(p.pid) for n, p in processes.items()})))


def network_faults(programs, folder, scene, outages_s):
  missing = Hosts.missing()
  if missing:
    print('network: skipped, because %s' % missing, flush=True)
    return [result('link down', skipped=missing, survived=True, reasons=[])]
  hosts = Hosts()
  leave = enter(hosts.names[0])
  results, processes, observers, master = [], {}, [], None
  try:
    master, processes, observers = start_split_graph(programs, folder, scene, hosts)
    for observer in observers:
      wait_until(lambda o=observer: o.first(0, 'tool', lambda s: s.value > PUSH_N), 'push')
      wait_until(lambda o=observer: o.first(0, 'image'), 'image')
    time.sleep(WINDOW_S)
    for outage_s in outages_s:
      results.append(link_outage(hosts, processes, observers, outage_s))
      tell(results[-1])
    for node in ('renderer', 'tool', 'device', 'simulation', 'recorder'):
      processes[node].stop()
    across(folder, results)
  except BROKEN as failure:
    results.append(tellEach(broken_off(results, failure)))
  finally:
    for process in list(processes.values()):
      process.stop()
    for observer in observers:
      observer.close()
    if master:
      master.stop()
    leave()
    hosts.close()
  return results


def across(folder, results):
  """How soon the recorder had again what crosses the link, and what it recorded meanwhile of what does not."""
  import rosbag
  times = collections.defaultdict(list)
  with rosbag.Bag(os.path.join(folder, 'network.bag')) as bag:
    for topic, _, t in bag.read_messages(topics=['/tool/state', '/grid/state', '/top/image_raw'], raw=True):
      times[topic].append(t.to_sec())
  for figures in results:
    after = {topic: min((t for t in times[topic] if t > figures['ended'] + 0.05), default=float('inf'))
             for topic in ('/tool/state', '/top/image_raw')}
    figures['recorder_has_all_again_s'] = round(max(after.values()) - figures['ended'], 2)
    inside = [t for t in times['/grid/state'] if figures['began'] <= t <= figures['ended']]
    edges = [figures['began']] + inside + [figures['ended']]
    figures['recording_lost_s'] = round(max(b - a for a, b in zip(edges, edges[1:])), 3)
    figures['recovery_s'] = max(figures['recovery_s'], figures['recorder_has_all_again_s'])
    judge(figures)


# ---------------------------------------------------------------------------------------------------------- recordings


def bags_of(folder):
  return sorted(glob.glob(os.path.join(folder, '*.bag')) + glob.glob(os.path.join(folder, '*.interrupted*')))


def readable(path):
  """Brings back the index of a bag whose recorder was killed; returns the bag's path."""
  if '.interrupted' not in path:
    return path
  copy = path.replace('.bag.interrupted', '_interrupted') + '.bag'
  shutil.copy(path, copy)
  subprocess.run(['rosbag', 'reindex', '-q', copy], check=True, capture_output=True)
  return copy


def last_message(path):
  import rosbag
  with rosbag.Bag(path) as bag:
    return bag.get_end_time()


def replay(programs, path):
  run = subprocess.run([os.path.join(programs, 'soft_volume_replay'), path, '--check'], capture_output=True, text=True)
  return run.returncode, (run.stdout + run.stderr)


def check_recordings(programs, folder, results):
  """What each kill of the recorder cost, and whether every bag replays bit for bit."""
  bags = [readable(path) for path in bags_of(folder)]
  ends = sorted(last_message(path) for path in bags)
  for figures in results:
    if figures['fault'] == 'kill recorder':
      figures['recording_lost_s'] = round(min(abs(figures['killed_at'] - end) for end in ends), 3)
      judge(figures)
  codes = {os.path.basename(path): replay(programs, path) for path in bags}
  for name, (code, output) in codes.items():
    if code != 0:
      print('%s: soft_volume_replay ended with %d\n%s' % (name, code, output[-3000:]))
  bad = [name for name, (code, _) in codes.items() if code != 0]
  return dict(fault='replay of all %d recordings' % len(bags), survived=not bad, reasons=['%s differs' % b for b in bad])


# ----------------------------------------------------------------------------------------------------------------- soak


def soak_scene(folder, seconds):
  """The demo's scene, its hand beginning anew when it has come to the end, for so long. It cuts in the first round only:
  every cut adds pieces, which are memory for good."""
  path = os.path.join(ROOT, 'config', 'scenes', 'ct_head.yaml')
  with open(path) as file:
    scene = yaml.safe_load(file)
  way = scene['device']['way_points']
  length_s = way[-1]['time_s'] + 1.0
  rounds = int(seconds / length_s) + 1
  again = [{key: value for key, value in point.items() if key != 'buttons'} for point in way]
  scene['device']['way_points'] = [dict(point, time_s=point['time_s'] + n * length_s) for n in range(rounds)
                                   for point in (again if n else way)]
  target = os.path.join(folder, 'soak.yaml')
  with open(target, 'w') as file:
    yaml.safe_dump(scene, file, sort_keys=False)
  return target


def slope(samples):
  """MiB per 10,000 steps over the second half, by least squares."""
  half = samples[len(samples) // 2:]
  steps, values = [s for s, _ in half], [v for _, v in half]
  mean_s, mean_v = statistics.mean(steps), statistics.mean(values)
  spread = sum((s - mean_s)**2 for s in steps)
  return 1e4 * sum((s - mean_s) * (v - mean_v) for s, v in zip(steps, values)) / spread if spread else 0.0


def soak(programs, folder, steps):
  master = Master(folder)
  master.api().setParam('/faults', '/use_sim_time', True)
  # dt is not known before the scene is read; 1 ms or less.
  scene = soak_scene(folder, seconds=1.1e-3 * steps)
  bag = os.path.join(folder, 'soak.bag')

  def start(program, **parameters):
    command = [os.path.join(programs, program + '_node'), '__name:=' + program]
    return Process(command + ['_%s:=%s' % p for p in parameters.items()], os.path.join(folder, program + '.log'),
                   dict(master.environment, OMP_WAIT_POLICY='passive'))

  processes = {
      'recorder': start('recorder', file=bag),
      'simulation': start('simulation', scene=scene, publish_clock='true', real_time_factor='1',
                          start_paused='true', resume_file=os.path.join(folder, 'soak.resume')),
      'renderer': start('renderer'),
      'tool': start('tool'),
      'device': start('device', scene=scene)
  }
  observer = Observer(folder, master.environment)
  samples = {node: [] for node in processes}
  begin = moved = time.monotonic()
  told = 0
  try:
    for node in processes:
      wait_until(lambda n=node: master.pid(n), node, limit_s=120)
    time.sleep(5.0)  # without /clock nothing moves that would tell that they are connected
    start_simulation(master)
    reached, pressed, ticks = 0, 0, 0
    while reached < steps:
      time.sleep(2.0)
      heard = observer.update()
      newest = [s.step for s in heard if s.what == 'grid']
      if not newest and time.monotonic() - moved > 60.0:
        raise Failure('the simulation stands still at step %d' % reached)
      if newest:
        reached, moved = newest[-1], time.monotonic()
      forces = [s.value for s in heard if s.what == 'tool']
      pressed, ticks = pressed + sum(abs(f) > 0.0 for f in forces), ticks + len(forces)
      heard.clear()
      for node, process in processes.items():
        if not process.alive():
          raise Failure('%s died at step %d' % (node, reached))
        samples[node].append((reached, memory_mib(process.pid)))
      if time.monotonic() - told > 30:
        told = time.monotonic()
        left_s = (told - begin) * (steps / max(1, reached) - 1.0)
        print('  step %d of %d, %.0f s left' % (reached, steps, left_s), flush=True)
    wall_s = time.monotonic() - begin
  finally:
    for node in ('device', 'tool', 'renderer', 'simulation', 'recorder'):
      processes[node].stop(120)
    observer.close()
    master.stop()
  growth = {node: round(slope(values), 3) for node, values in samples.items()}
  figures = result('soak of %d steps' % reached, steps=reached, wall_s=round(wall_s, 1), growth_mib_per_10000_steps=growth,
                   share_of_ticks_with_force=round(pressed / max(1, ticks), 3),
                   bag_mib=round(sum(map(os.path.getsize, bags_of(folder))) / 2.0**20, 1),
                   memory_mib={n: (round(v[len(v) // 4][1], 1), round(v[-1][1], 1)) for n, v in samples.items()})
  judge(figures)
  for node, mib in growth.items():
    # The index of a bag stays in memory until it is closed: some 100 bytes for each message.
    if mib > (3.0 if node == 'recorder' else 1.0):
      figures['survived'] = False
      figures['reasons'].append('%s grows by %.2f MiB per 10,000 steps' % (node, mib))
  if figures['share_of_ticks_with_force'] < 0.05:
    figures['survived'] = False
    figures['reasons'].append('the hand hardly touched the tissue')
  figures['samples_mib'] = {n: [(s, round(m, 1)) for s, m in v[::max(1, len(v) // 50)]] for n, v in samples.items()}
  return figures


# --------------------------------------------------------------------------------------------------------------- report


def tell(figures):
  words = 'survived' if figures['survived'] else 'FAILED: ' + '; '.join(figures['reasons'])
  if 'skipped' in figures:
    words = 'skipped: ' + figures['skipped']
  elif 'recovery_s' in figures:
    words += ', back after %.1f s' % figures['recovery_s']
  print('%-55s %s' % (figures['fault'], words), flush=True)


def cell(figures, key, form='%.2f'):
  return form % figures[key] if key in figures else ''


def table(results):
  rows = ['| fault | survived | back after [s] | recording lost [s] | tissue lost [s] | longest silence of the rest [s] | '
          'largest growth [MiB] |', '|---|---|---|---|---|---|---|']
  for figures in results:
    growth = [b - a for a, b in figures.get('memory_mib', {}).values() if a and b]
    silences = figures.get('longest_silence_s', {}).values()
    rows.append('| %s | %s | %s | %s | %s | %s | %s |' %
                (figures['fault'], 'skipped' if 'skipped' in figures else 'yes' if figures['survived'] else 'NO',
                 cell(figures, 'recovery_s'), cell(figures, 'recording_lost_s'), cell(figures, 'tissue_lost_s', '%.3f'),
                 '%.2f' % max(silences) if silences else '', '%.1f' % max(growth) if growth else ''))
  return '\n'.join(rows) + '\n'


def summary(results):
  tried = [f for f in results if 'skipped' not in f]
  lost = [f['recording_lost_s'] for f in tried if 'recording_lost_s' in f]
  return dict(tried=len(tried), survived=sum(f['survived'] for f in tried), skipped=len(results) - len(tried),
              most_recording_lost_s=max(lost, default=0.0),
              most_tissue_lost_s=max((f.get('tissue_lost_s', 0.0) for f in tried), default=0.0),
              longest_recovery_s=max((f.get('recovery_s', 0.0) for f in tried), default=0.0))


def broken_off(results, failure):
  after = results[-1]['fault'] if results else 'the start'
  return dict(fault='after ' + after, survived=False, reasons=[str(failure) or type(failure).__name__])


def part(name, figures):
  """Figures of a part of the run, also of one that could not even begin."""
  try:
    return figures()
  except BROKEN as failure:
    return [tellEach(dict(broken_off([], failure), fault=name))]


def faults_of_one_host(options, folder, scene):
  """Yields figures."""
  graph = Graph(options.programs, folder, scene)
  results = []
  try:
    if 'kill' in options.only:
      for _ in range(options.rounds):
        results += [tellEach(kill_node(graph, node)) for node in NODES]
    if 'master' in options.only:
      results += [tellEach(restart_master(graph, away_s)) for away_s in ([2.0] if options.short else [0.5, 5.0, 30.0])]
    if 'slow' in options.only:
      results.append(tellEach(slow_renderer(graph, 5.0 if options.short else 30.0)))
    if 'silent' in options.only:
      results.append(tellEach(silent_subscriber(graph, 5.0 if options.short else 60.0)))
  except BROKEN as failure:
    results.append(tellEach(broken_off(results, failure)))
  finally:
    graph.stop()
  results.append(tellEach(check_recordings(options.programs, folder, results)))
  return results


def tellEach(figures):
  tell(figures)
  return figures


def deep_scene():
  """The tests' scene with a hand that presses so deep that the force is felt on a busy machine, too."""
  scene = phantom.scene()
  for point in scene['device']['way_points'][1:]:
    point['position_m'][2] = 0.055
  return scene


def run(options):
  os.makedirs(options.out, exist_ok=True)
  folder = tempfile.mkdtemp(dir=options.out, prefix='run')
  folders = {name: os.path.join(folder, name) for name in ('graph', 'network', 'soak')}
  for path in folders.values():
    os.mkdir(path)
  scene = phantom.write_scene(folder, deep_scene())
  results = []
  if {'kill', 'master', 'slow', 'silent'} & set(options.only):
    results += part('faults of one host', lambda: faults_of_one_host(options, folders['graph'], scene))
  if 'network' in options.only:
    outages_s = [10.0] if options.short else [3.0, 10.0, 30.0]
    results += part('link down', lambda: network_faults(options.programs, folders['network'], scene, outages_s))
  if 'soak' in options.only:
    results += part('soak', lambda: [tellEach(soak(options.programs, folders['soak'], options.soak_steps))])
  return results, folder


def parse_arguments():
  parser = argparse.ArgumentParser(description=__doc__)
  parser.add_argument('--programs', help='folder of the nodes')
  parser.add_argument('--out', help='folder for the figures')
  parser.add_argument('--short', action='store_true')
  parser.add_argument('--rounds', type=int)
  parser.add_argument('--soak-steps', type=int, default=100000)
  parser.add_argument('--only', nargs='*')
  parser.add_argument('--observe', help=argparse.SUPPRESS)
  options = parser.parse_args()
  options.rounds = options.rounds or (1 if options.short else 3)
  names = ['kill', 'master', 'slow', 'silent', 'network'] + ([] if options.short else ['soak'])
  unknown = set(options.only or []) - set(names + ['soak'])
  if unknown:
    parser.error('there is no fault %s; there are: %s' % (', '.join(unknown), ', '.join(names)))
  options.only = options.only or names
  return options


def main():
  options = parse_arguments()
  if options.observe:
    observe(options.observe)
    return 0
  results, folder = run(options)
  figures = dict(summary=summary(results), faults=results)
  with open(os.path.join(options.out, 'faults.json'), 'w') as file:
    json.dump(figures, file, indent=2)
  with open(os.path.join(options.out, 'faults.md'), 'w') as file:
    file.write(table(results))
  survived = all(f['survived'] for f in results)
  if survived:
    shutil.rmtree(folder)
  else:
    print('logs and bags: %s' % folder)
  print(table(results))
  print('%(tried)d faults tried, %(survived)d survived, %(skipped)d skipped; at most %(most_recording_lost_s).2f s of '
        'recording and %(most_tissue_lost_s).3f s of tissue lost' % figures['summary'])
  return 0 if survived else 1


if __name__ == '__main__':
  sys.exit(main())
