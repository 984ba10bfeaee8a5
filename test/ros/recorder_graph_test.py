#!/usr/bin/python3
"""The recorder node: what it records of a run replays bit for bit, however the recorder ends."""

import json
import os
import signal
import subprocess
import unittest

import rosbag
import rosgraph
import rospy
import yaml
from soft_volume.msg import RecorderEvent, RecorderStatus, Scene

import graph


class RecorderTest(graph.GraphTest):

  def setUp(self):
    super().setUp()
    self.bag = os.path.join(self.folder, 'run.bag')

  def startRecorder(self, **parameters):
    recorder = self.start('recorder_node', file=self.bag, **parameters)
    self.status = self.listen('recorder/status', RecorderStatus)
    self.status.wait(lambda s: s.recording and s.file == self.bag, 'recording')
    return recorder

  @staticmethod
  def listeners(topic):
    return dict(rosgraph.Master(rospy.get_name()).getSystemState()[1]).get(topic, [])

  def startSimulation(self, **parameters):
    simulation = graph.Simulation(self, **parameters)
    simulation.open_inputs()
    for topic in ('simulation/journal', 'grid/state', 'tool/force', 'tool/cut'):
      graph.wait_until(lambda: '/recorder' in self.listeners('/' + topic), 'recorder of ' + topic)
    simulation.waitForReceivers()
    # The master knows a subscriber before its connections stand.
    recorded = self.status.messages[-1].messages
    simulation.step(1)
    self.status.wait(lambda s: s.messages > recorded and s.step == 1, 'recorded journal')
    return simulation

  def replay(self, bag, code=0):
    result = os.path.join(self.folder, 'result.json')
    program = os.path.join(os.environ['SOFT_VOLUME_TEST_BIN'], 'soft_volume_replay')
    done = subprocess.run([program, bag, '--check', '--json', result], stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                          universal_newlines=True, timeout=120)
    self.assertEqual(done.returncode, code, done.stdout)
    with open(result) as file:
      return json.load(file)

  def recordRun(self, ending):
    recorder = self.startRecorder()
    simulation = self.startSimulation()
    simulation.push(sequence=1)
    simulation.step(100)
    simulation.push(sequence=2, force__x=float('nan'))
    simulation.cut(sequence=1)
    simulation.step(100)
    simulation.reset()
    simulation.push(sequence=1)
    simulation.step(50)
    self.status.wait(lambda s: s.session == simulation.session and s.step == 50, 'recording of the second session')
    os.kill(recorder.process.pid, ending)
    self.assertEqual(self.finish(recorder), 0, recorder.output())
    self.assertFalse(os.path.exists(self.bag + '.active'))
    result = self.replay(self.bag)
    self.assertTrue(result['identical'])
    self.assertEqual(result['sessions'], 2)
    self.assertEqual(result['steps'], 251)
    self.assertEqual(result['inputs_refused'], 1)
    self.assertEqual(result['inputs_not_recorded'], 0)
    self.assertGreater(result['states'], 3)
    self.assertGreaterEqual(result['topologies'], 3)

  def testARunThatEndsWithSigintReplays(self):
    self.recordRun(signal.SIGINT)

  def testARunThatEndsWithSigtermReplays(self):
    self.recordRun(signal.SIGTERM)

  def testAKilledRecorderLosesLessThanASecond(self):
    recorder = self.startRecorder()
    simulation = self.startSimulation(real_time_factor=1)
    simulation.pause(False)
    simulation.journals.wait(lambda j: j.step > 2500, 'running simulation')
    last = simulation.journals.messages[-1].step
    self.kill(recorder)
    subprocess.check_call(['rosbag', 'reindex', '-q', '-f', self.bag + '.active'])
    result = self.replay(self.bag + '.active')
    self.assertTrue(result['identical'])
    # One step is a millisecond, and the simulation runs in real time or slower.
    self.assertGreater(result['steps'], last - 1000)

  def testEveryPartOfASplitRecordingReplays(self):
    recorder = self.start('recorder_node', file=self.bag, split_mib=1, compression='none')
    self.status = self.listen('recorder/status', RecorderStatus)
    self.status.wait(lambda s: s.recording and s.file.endswith('run_0.bag'), 'recording')
    simulation = self.startSimulation()
    simulation.pause(False)
    self.status.wait(lambda s: s.parts >= 3, 'three parts', limit_s=60.0)
    simulation.pause(True)
    recorder.process.send_signal(signal.SIGINT)
    self.assertEqual(self.finish(recorder), 0, recorder.output())
    self.assertFalse(os.path.exists(self.bag))
    last = self.status.messages[-1]
    self.assertEqual(last.dropped, 0)
    steps = 0
    for part in range(last.parts + 1):
      result = self.replay(os.path.join(self.folder, 'run_%d.bag' % part))
      self.assertTrue(result['identical'])
      self.assertGreater(result['states'], 0)
      steps += result['steps']
    self.assertGreaterEqual(steps, last.step)

  def testTheBagTellsWhatHappened(self):
    recorder = self.startRecorder()
    simulation = self.startSimulation(real_time_factor=1)
    simulation.pause(False)
    simulation.journals.wait(lambda j: j.step > 1500, 'running simulation')
    self.kill(simulation.node)
    self.status.wait(lambda s: self.told(RecorderEvent.SILENCE), 'silence')
    self.unlisten(simulation.journals)
    again = graph.Simulation(self, start_paused='false', real_time_factor=1)
    again.journals.wait(lambda j: j.step > 500, 'simulation that runs again')
    self.status.wait(lambda s: self.told(RecorderEvent.RETURN), 'return')
    recorder.process.send_signal(signal.SIGINT)
    self.assertEqual(self.finish(recorder), 0, recorder.output())
    notes = '\n'.join(self.replay(self.bag)['notes'])
    for words in ('/simulation: sends nothing any more: ', '/simulation: sends again after ',
                  '/simulation: was restarted, or the network was out', 'began from rest',
                  'after a restart of the simulation', 'the recording ended: signal 2'):
      self.assertIn(words, notes)

  def told(self, kind):
    return any(event.kind == kind for status in self.status.messages for event in status.events)

  def testItSaysWhatMadeTheRecording(self):
    recorder = self.startRecorder()
    self.startSimulation()
    recorder.process.send_signal(signal.SIGINT)
    self.assertEqual(self.finish(recorder), 0, recorder.output())
    with rosbag.Bag(self.bag) as bag:
      infos = [message for _, message, _ in bag.read_messages(['/recorder/info'])]
      topics = bag.get_type_and_topic_info().topics
    self.assertIn('/recorder/status', topics)
    self.assertIn('/rosout', topics)
    info = infos[-1]
    self.assertEqual(dict(zip(info.types, info.definitions))['soft_volume/Scene'], Scene._md5sum)
    self.assertIn('block.yaml', ' '.join(info.files))
    self.assertEqual(len(info.files), len(info.file_hashes))
    self.assertIn('simulation', yaml.safe_load(info.parameters))
    self.assertTrue(info.package_version and info.ros_version and info.compiler)

  @unittest.skipUnless(os.geteuid() == 0, 'only root can mount a small file system')
  def testItSaysThatTheDiskIsFull(self):
    disk = os.path.join(self.folder, 'disk')
    os.mkdir(disk)
    subprocess.check_call(['mount', '-t', 'tmpfs', '-o', 'size=6m', 'none', disk])
    try:
      self.bag = os.path.join(disk, 'run.bag')
      recorder = self.startRecorder(reserve_mib=3, compression='none')
      # As fast as it can, it might fill the reserve within a chunk; in real time it takes half a minute.
      simulation = self.startSimulation(real_time_factor=20)
      simulation.pause(False)
      self.wait_for_status('recorder', lambda s: s.level in (2, b'\x02') and 'less than the reserve' in s.message,
                           'an error that names the full disk')
      self.status.wait(lambda s: not s.recording and 'less than the reserve' in s.stop_reason, 'stop')
      simulation.pause(True)
      recorder.process.send_signal(signal.SIGINT)
      self.assertEqual(self.finish(recorder), 1, recorder.output())
      result = self.replay(self.bag)
      self.assertTrue(result['identical'])
      self.assertIn('less than the reserve', ' '.join(result['notes']))
    finally:
      subprocess.call(['umount', '-l', disk])

  def testItStartsNotWithoutSpace(self):
    recorder = self.start('recorder_node', file=self.bag, reserve_mib=2**30)
    self.assertEqual(self.finish(recorder), 1)
    self.assertIn('less than the reserve', recorder.output())

  def testItNamesABadParameter(self):
    recorder = self.start('recorder_node', file=self.bag, compression='zip')
    self.assertEqual(self.finish(recorder), 1)
    self.assertIn('must be lz4 or none', recorder.output())


if __name__ == '__main__':
  graph.run('recorder_graph_test')
