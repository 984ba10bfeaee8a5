#!/usr/bin/python3
"""A simulation that is killed and started again goes on with its last journaled state, bit for bit."""

import os

import rospy
from rosgraph_msgs.msg import Clock
from soft_volume.msg import Scene, SimulationCheckpoint, SimulationJournal, ToolState

import graph
import phantom

STEPS = 100


class ResumeTest(graph.GraphTest):

  def setUp(self):
    super().setUp()
    self.file = os.path.join(self.folder, 'run.resume')

  def start_kept(self, **parameters):
    return graph.Simulation(self, resume_file=self.file, **parameters)

  def press_and_cut(self, simulation):
    """Ends in step 2 * STEPS, with a force in effect."""
    simulation.open_inputs()
    simulation.push(1)
    simulation.step(STEPS)
    simulation.cut(2)
    simulation.push(3, hold_steps=1000)
    journal = simulation.step(STEPS)
    self.assertEqual(len(simulation.applied()), 3)
    return journal

  def reference(self):
    """The hash of the state after 4 * STEPS of a simulation that nobody killed."""
    simulation = graph.Simulation(self)
    self.press_and_cut(simulation)
    journal = simulation.step(2 * STEPS)
    self.finish_cleanly(simulation)
    return journal.state_hash

  def finish_cleanly(self, simulation):
    self._nodes.remove(simulation.node)
    self.assertEqual(simulation.node.stop(), 0)

  def test_it_goes_on_bit_for_bit_and_says_so(self):
    expected = self.reference()
    killed = self.start_kept()
    before = self.press_and_cut(killed)
    self.kill(killed.node)
    self.unlisten(killed.scenes)
    journals = self.listen('simulation/journal', SimulationJournal)
    simulation = self.start_kept()
    first = journals.wait(lambda j: j.session == simulation.session, 'journal of the new session')
    self.assertNotEqual(simulation.session, before.session)
    self.assertEqual((first.step, first.state_hash), (before.step, before.state_hash))
    restored, resumed = first.entries[:2]
    self.assertEqual((restored.topic, resumed.topic), ('simulation/restore_checkpoint', 'simulation/resume'))
    self.assertIn('session %d, step %d' % (before.session, before.step), resumed.reason)
    self.assertEqual(simulation.revision, before.revision)
    self.wait_for_status('simulation', lambda s: any(v.key == 'resumed from' for v in s.values), 'where it went on')
    # Paused as it was, and the force is still held.
    self.assertEqual(simulation.step(2 * STEPS).state_hash, expected)
    self.finish_cleanly(simulation)
    self.assertEqual([name for name in os.listdir(self.folder) if 'resume' in name and not name.endswith('.log')], [])

  def test_it_goes_on_again_and_again(self):
    expected = self.reference()
    simulation = self.start_kept()
    self.press_and_cut(simulation)
    for _ in range(2):
      self.kill(simulation.node)
      simulation = self.start_kept()
      journal = simulation.step(STEPS)
    self.assertEqual((journal.step, journal.state_hash), (4 * STEPS, expected))

  def test_a_running_one_loses_a_journal_interval(self):
    rospy.set_param('/use_sim_time', False)
    simulation = self.start_kept(start_paused='false', real_time_factor=1.0, publish_clock='true')
    clocks = self.listen('/clock', Clock, keep=100000)
    simulation.journals.wait(lambda j: j.step > 2300, 'a while')
    self.kill(simulation.node)
    last, time = simulation.journals.messages[-1], clocks.messages[-1].clock
    clocks.clear()
    scenes = self.listen('scene', Scene)
    simulation = self.start_kept(start_paused='false', real_time_factor=1.0, publish_clock='true')
    scene = scenes.wait(lambda s: s.session == simulation.session, 'scene')
    self.assertGreaterEqual(scene.step, last.step)
    self.assertLess(scene.step, last.step + 200)
    clocks.wait(what='clock')
    self.assertGreaterEqual(clocks.messages[0].clock, time)  # it never goes back
    self.assertLess((clocks.messages[0].clock - time).to_sec(), 0.2)

  def test_another_scene_begins_from_rest_and_says_so(self):
    killed = self.start_kept()
    self.press_and_cut(killed)
    self.kill(killed.node)
    scene = phantom.scene()
    scene['materials'][0]['youngs_modulus_pa'] *= 1.01
    checkpoints = self.listen('simulation/checkpoint', SimulationCheckpoint)
    simulation = self.start_kept(scene=scene)
    checkpoint = checkpoints.wait(lambda c: c.session == simulation.session, 'checkpoint')
    self.assertEqual(checkpoint.step, 0)
    self.wait_for_warning('simulation', 'belongs to another scene', 'starts from rest')
    self.assertTrue(os.path.exists(self.file + '.refused'))

  def test_a_damaged_file_begins_from_rest_and_says_so(self):
    with open(self.file, 'wb') as file:
      file.write(b'soft_volume resume file 1, but not really' * 100)
    simulation = self.start_kept()
    self.assertEqual(simulation.step(1).step, 1)
    self.wait_for_warning('simulation', 'not written by this version', 'starts from rest')

  def test_the_tool_finds_the_resumed_session(self):
    states = self.listen('tool/state', ToolState, keep=100000)
    scene = phantom.scene()
    running = dict(scene=scene, start_paused='false', real_time_factor=1.0)
    simulation = self.start_kept(**running)
    self.start('tool_node')
    self.start('device_node', scene=self.folder + '/block.yaml')
    presses = lambda s: s.session == simulation.session and s.device_force.z > 0.1
    states.wait(presses, 'push', limit_s=60.0)
    self.kill(simulation.node)
    step = simulation.journals.messages[-1].step
    simulation = self.start_kept(**running)
    pressed = states.wait(presses, 'push on the resumed tissue', limit_s=60.0)
    self.assertGreater(pressed.step, step)


if __name__ == '__main__':
  graph.run('resume_graph_test')
