#!/usr/bin/python3
"""The simulation node alone: lockstep, services, deltas, and what it does with input that it cannot use."""

import rospy
from geometry_msgs.msg import Point
from soft_volume.msg import GridState, JournalEntry, SimulationCheckpoint, SimulationStats, ToolGrip, Volume
from soft_volume.srv import SetIntegrator, StepSimulation
from std_srvs.srv import Trigger

import graph
import phantom

NAN = float('nan')


class LockstepTest(graph.GraphTest):

  def setUp(self):
    super().setUp()
    self.simulation = graph.Simulation(self)
    self.simulation.open_inputs()

  def pushAndStep(self, disturb=lambda step: None):
    """180 steps with a push at step 10 and a cut at step 50; `disturb` is called between them. Returns the hash."""
    self.simulation.push(sequence=10, apply_at_step=10)
    self.simulation.cut(sequence=10, apply_at_step=50)
    for step in range(20, 181, 20):
      journal = self.simulation.step(20)
      self.assertEqual(journal.step, step)
      disturb(step)
    return journal.state_hash

  def testTheSameInputsGiveTheSameState(self):
    at_rest = self.simulation.step(1).state_hash
    self.simulation.reset()
    first = self.pushAndStep()
    self.simulation.reset()
    second = self.pushAndStep()
    self.assertEqual(first, second)
    self.assertNotEqual(first, at_rest)
    self.assertEqual([(e.topic, e.step) for e in self.simulation.applied()], [('tool/force', 9), ('tool/cut', 49)])

  def testInputThatCannotBeUsedChangesNothing(self):
    undisturbed = self.pushAndStep()
    self.simulation.reset()
    bad_forces = [
        ('not finite', dict(force__x=NAN)),
        ('not finite', dict(point__z=float('inf'))),
        ('max_tool_force_n', dict(force__z=1e38)),
        ('computed on revision 77', dict(revision=77)),
        ('another session', dict(session=1)),
        ("no tool 'chisel'", dict(tool_id='chisel')),
        ('footprint radius', dict(footprint_radius=-0.01)),
        ('footprint radius', dict(footprint_radius=NAN)),
        ('hold_steps', dict(hold_steps=0)),
        ('no tissue', dict(point__x=5.0)),
        ('not newer than 10', dict(sequence=10)),
        ('not newer than 10', dict(sequence=3)),
    ]
    bad_cuts = [
        ('not finite', dict(quads__2__y=NAN)),
        ('far outside', dict(quads__2__y=1e38)),
        ('four points per quad', dict(quads=[])),
        ('another session', dict(session=self.simulation.session + 1)),
        ('not newer than 10', dict(sequence=9)),
    ]
    # A tool lags behind while it cuts, but not by 130 steps.
    bad_after_the_cut = [('computed on revision 1', dict(revision=1, step=30))]
    sent = []

    def disturb(step):
      # At 40 the push was applied and the cut was not; at 60 both were.
      if step == 40:
        for reason, changes in bad_forces:
          self.simulation.push(**dict(dict(sequence=99), **changes))
          sent.append(reason)
      if step == 60:
        for reason, changes in bad_cuts:
          if changes.get('quads') == []:
            reason = 'quads'
          self.simulation.cut(**dict(dict(sequence=99), **changes))
          sent.append(reason)
        self.simulation.push(sequence=99, apply_at_step=60)  # has passed
        sent.append('has passed')
      if step == 160:
        for reason, changes in bad_after_the_cut:
          self.simulation.push(sequence=99, **changes)
          sent.append(reason)

    disturbed = self.pushAndStep(disturb)
    self.assertEqual(disturbed, undisturbed)
    refused = self.simulation.refused()
    reasons = sorted(e.reason for e in refused)
    self.assertEqual(len(refused), len(sent), reasons)
    for reason in sent:
      self.assertTrue(any(reason in r for r in reasons), '%s is not in %s' % (reason, reasons))
    for entry in refused:
      self.assertTrue(entry.payload and entry.hash)
    self.assertEqual(len(self.simulation.applied()), 2)
    self.wait_for_warning('simulation', 'tool/force: ')

  def grip(self, **changes):
    message = ToolGrip(session=self.simulation.session, revision=1, tool_id='probe', sequence=1, closed=True,
                       hold_steps=400, radius=0.009)
    message.point = message.pose.position = Point(0.047, 0.047, phantom.TOP_Z_M)
    message.pose.orientation.w = 1.0
    for field, value in changes.items():
      setattr(message, field, value)
    return message

  def testJawsLiftTissue(self):
    grips = self.publisher('tool/grip', ToolGrip)
    states = self.listen('grid/state', GridState)
    states.connect()
    grips.publish(self.grip(apply_at_step=1))
    lifted = self.grip(sequence=2, apply_at_step=2)
    lifted.pose.position = Point(0.047, 0.047, phantom.TOP_Z_M + 0.006)
    grips.publish(lifted)
    self.simulation.step(300)
    state = states.wait(lambda s: s.step == 300, 'state of the lift')
    self.assertAlmostEqual(self.displacement(states, state), 0.006, delta=1e-4)
    grips.publish(self.grip(sequence=3, closed=False))
    self.simulation.step(1500)
    self.assertEqual([e.outcome for e in self.simulation.entries()], 3 * [JournalEntry.APPLIED])
    state = states.wait(lambda s: s.step == 1800, 'state after the release')
    self.assertLess(self.displacement(states, state), 2e-4)

  def testIncompleteQuadsAndGripsAreRefused(self):
    grips = self.publisher('tool/grip', ToolGrip)
    self.simulation.cut(sequence=1, quads=[Point(0.04, 0.04, 0.06)] * 3)
    grips.publish(self.grip(radius=NAN))
    self.simulation.step(1)
    self.assertEqual(sorted((e.topic, e.outcome) for e in self.simulation.entries()),
                     [('tool/cut', JournalEntry.REFUSED), ('tool/grip', JournalEntry.REFUSED)])
    self.assertIn('four points', ' '.join(e.reason for e in self.simulation.refused()))
    self.wait_for_warning('simulation', 'tool/cut', 'four points')
    self.wait_for_warning('simulation', 'tool/grip', 'grip radius')

  def testTheIntegratorCanBeChangedDuringARun(self):
    states, stats = self.listen('grid/state', GridState), self.listen('simulation/stats', SimulationStats)
    states.connect()
    self.simulation.push(sequence=1, apply_at_step=1)
    self.simulation.step(100)
    before = states.wait(lambda s: s.step == 100, 'state').simulation_time
    self.assertAlmostEqual(before, 0.1)
    response = self.call('simulation/set_integrator', SetIntegrator, 'backward_euler', 0.01)
    self.assertTrue(response.success, response.message)
    self.assertEqual(response.dt, 0.01)
    now = stats.wait(lambda s: s.integrator == 'backward_euler', 'stats')
    self.assertEqual((now.dt, now.transients_physical, now.precision), (0.01, True, 'float'))
    self.assertLess(now.dt_limit, 0.01)
    self.simulation.step(10)
    self.assertAlmostEqual(states.wait(lambda s: s.step == 110, 'state').simulation_time, 0.2)

    for integrator, dt, reason in (('magic', 0.0, 'runge_kutta_4'), ('symplectic_euler', 0.01, 'stability limit'),
                                   ('runge_kutta_4', NAN, 'time step')):
      response = self.call('simulation/set_integrator', SetIntegrator, integrator, dt)
      self.assertFalse(response.success)
      self.assertIn(reason, response.message)
      self.assertEqual(response.dt, 0.01)
    response = self.call('simulation/set_integrator', SetIntegrator, 'symplectic_euler', 0.0)
    self.assertTrue(response.success, response.message)
    self.assertLess(response.dt, now.dt_limit)
    self.simulation.step(1)
    entries = [e for j in self.simulation.journals.messages for e in j.entries if e.topic == 'simulation/set_integrator']
    self.assertEqual([e.outcome for e in entries],
                     [JournalEntry.APPLIED] + 3 * [JournalEntry.REFUSED] + [JournalEntry.APPLIED])

  def testAForceExpires(self):
    states = self.listen('grid/state', GridState)
    states.connect()
    self.simulation.push(sequence=1, apply_at_step=1, hold_steps=50)
    self.simulation.step(50)
    self.simulation.step(1000)
    state = states.wait(lambda s: s.step == 1050, 'state at step 1050')
    pushed = states.wait(lambda s: s.step == 50, 'state at step 50')
    deep = min(p.z for p in pushed.positions)
    self.assertGreater(self.displacement(states, pushed), 0.001, deep)
    self.assertLess(self.displacement(states, state), 0.1 * self.displacement(states, pushed))

  def displacement(self, states, state):
    """Largest vertical distance from rest. A state without key frame only has what moved since the one before it."""
    topology = self.simulation.topologies.wait(lambda t: t.session == state.session and t.revision == state.revision)
    rest = topology.rest_positions
    frames = [m for m in states.messages if m.session == state.session and m.key_frame and m.step <= state.step]
    positions = list(frames[-1].positions if frames else rest)
    if not state.key_frame:
      for v, p in zip(state.vertex_ids, state.positions):
        positions[v] = p
    return max(abs(p.z - r.z) for p, r in zip(positions, rest))

  def testCheckpointsContinueBitForBit(self):
    self.simulation.push(sequence=10, apply_at_step=10)
    self.simulation.cut(sequence=10, apply_at_step=50)
    self.simulation.step(100)
    self.simulation.waitForRevision(2)
    checkpoint = self.simulation.save()
    saved_session = self.simulation.session
    self.assertEqual((checkpoint.step, checkpoint.revision, checkpoint.session), (100, 2, saved_session))
    # The push is in effect until step 310 and then expires.
    expected = [self.simulation.step(150).state_hash, self.simulation.step(150).state_hash]

    response = self.simulation.restore(checkpoint)
    self.assertTrue(response.success, response.message)
    self.assertNotEqual(self.simulation.session, saved_session)
    self.assertEqual(self.simulation.topologies.messages[-1].revision, 2)
    again = [self.simulation.step(150), self.simulation.step(150)]
    self.assertEqual([j.state_hash for j in again], expected)
    self.assertEqual(again[-1].step, 400)
    # The restored session remembers which numbers it had accepted.
    self.simulation.push(sequence=10)
    self.simulation.step(1)
    self.assertIn('not newer than 10', self.simulation.refused()[-1].reason)

  def testDamagedCheckpointsAreRefused(self):
    self.simulation.push(sequence=1, apply_at_step=5)
    self.simulation.cut(sequence=1, apply_at_step=15)
    self.simulation.step(20)
    self.simulation.waitForRevision(2)
    session = self.simulation.session
    state_hash = self.simulation.step(1).state_hash
    damages = [
        ('another scene', lambda c: setattr(c, 'scene_hash', 1)),
        ('another volume', lambda c: setattr(c, 'volume_hash', 1)),
        ('displacements', lambda c: setattr(c, 'displacements', c.displacements[:-1])),
        ('', lambda c: setattr(c, 'displacements', c.displacements[:-3])),
        ('', lambda c: setattr(c, 'velocities', (NAN,) + c.velocities[1:])),
        ('', lambda c: setattr(c, 'lifetimes', c.lifetimes[1:])),
        ('another lattice', lambda c: setattr(c.incisions, 'cells', c.incisions.cells[8:])),
        ('at its corner', lambda c: setattr(c.incisions, 'cells', (10**9,) + c.incisions.cells[1:])),
        ('rest stretch', lambda c: setattr(c.incisions, 'rest_stretch', (0.0,) + c.incisions.rest_stretch[1:])),
        ('sequence', lambda c: setattr(c, 'sequences', c.sequences + (1,))),
        ('', lambda c: setattr(c.forces[0], 'vertices', (10**9,) + c.forces[0].vertices[1:])),
        ('', lambda c: setattr(c.forces[0], 'weights', c.forces[0].weights[1:])),
        ('', lambda c: setattr(c.forces[0].force, 'x', NAN)),
    ]
    for reason, damage in damages:
      checkpoint = self.simulation.save()
      damage(checkpoint)
      response = self.simulation.restore(checkpoint)
      self.assertFalse(response.success, reason)
      self.assertIn(reason, response.message)
      self.assertNotEqual(response.message, '')
    self.assertEqual(self.simulation.scenes.messages[-1].session, session)
    self.assertEqual(self.simulation.save().state_hash, state_hash)
    self.wait_for_warning('simulation', 'restore_checkpoint')

  def testResetStartsANewSessionAndPublishesEverything(self):
    states = self.listen('grid/state', GridState)
    volumes = self.listen('volume', Volume)
    states.connect()
    at_rest = self.simulation.journals
    old = self.simulation.session
    volumes.wait(lambda v: v.session == old, 'volume')
    first = self.simulation.step(1).state_hash
    self.simulation.push(sequence=7, apply_at_step=0)
    self.simulation.cut(sequence=7, apply_at_step=0)
    self.simulation.push(sequence=8, apply_at_step=500)  # is waiting when the reset comes, and must not come through
    self.assertNotEqual(self.simulation.step(50).state_hash, first)
    self.simulation.waitForRevision(2)

    new = self.simulation.reset()
    self.assertNotEqual(new, old)
    volumes.wait(lambda v: v.session == new, 'volume of the new session')
    key_frame = states.wait(lambda s: s.session == new, 'state of the new session')
    self.assertEqual((key_frame.key_frame, key_frame.step, key_frame.revision), (True, 0, 1))
    self.assertEqual(len(key_frame.positions), phantom.VERTICES)
    at_rest.wait(lambda j: j.session == new, 'journal of the new session')
    self.assertEqual(self.simulation.step(1).state_hash, first)
    self.assertEqual(self.simulation.step(599).state_hash, first)
    self.assertEqual(self.simulation.entries(), [])
    # Stamps go on: a reset is no jump back in time.
    stamps = [s.header.stamp for s in states.messages]
    self.assertEqual(stamps, sorted(stamps))

  def testTheJournalHasNoGaps(self):
    self.simulation.push(sequence=1, apply_at_step=33)
    for steps in (7, 13, 45):
      self.simulation.step(steps)
    journals = [j for j in self.simulation.journals.messages if j.session == self.simulation.session]
    for before, after in zip(journals, journals[1:]):
      self.assertEqual(after.first_step, before.last_step)
    self.assertEqual(journals[-1].last_step, 65)
    entries = [e for j in journals for e in j.entries]
    self.assertEqual([e.order for e in entries], list(range(entries[0].order, entries[0].order + len(entries))))


class ServicesTest(graph.GraphTest):

  def testPauseAndStep(self):
    simulation = graph.Simulation(self, start_paused='false')
    states = self.listen('grid/state', GridState)
    states.wait(lambda s: s.step > 50, 'state after 50 steps')
    response = self.call('simulation/step', StepSimulation, 5)
    self.assertFalse(response.success)
    self.assertIn('pause it first', response.message)

    simulation.pause(True)
    before = simulation.save().step
    rospy.rostime.wallsleep(0.2)
    self.assertEqual(simulation.save().step, before)
    self.assertEqual(simulation.step(17).step, before + 17)
    for steps in (0, 1000001):
      response = self.call('simulation/step', StepSimulation, steps)
      self.assertFalse(response.success)
      self.assertIn('[1, 1000000]', response.message)
    stats = self.listen('simulation/stats', SimulationStats)
    stats.wait(lambda s: s.paused and s.step == before + 17, 'stats of the pause')

    simulation.pause(False)
    states.wait(lambda s: s.step > before + 100, 'state after the pause')

  def testALateReceiverGetsAKeyFrame(self):
    # Key frames come by themselves once a minute only, and nobody has listened so far.
    simulation = graph.Simulation(self, start_paused='false', real_time_factor=1)
    stats = self.listen('simulation/stats', SimulationStats)
    stats.wait(lambda s: s.step > 100, 'progress')
    states = self.listen('grid/state', GridState)
    key_frame = states.wait(lambda s: s.key_frame, 'key frame', limit_s=10)
    # Among the first ones, however busy the machine; by itself it would be one in 3000.
    self.assertLess([s.step for s in states.messages].index(key_frame.step), 50)
    self.assertEqual(len(key_frame.positions), phantom.VERTICES)
    self.assertEqual(key_frame.base_step, key_frame.step)
    delta = states.wait(lambda s: s.step > key_frame.step + 50, 'delta')
    self.assertFalse(delta.key_frame)
    self.assertEqual(delta.base_step, key_frame.step)
    self.assertEqual(list(delta.positions), [])  # nothing moved

    states.clear()
    self.assertTrue(self.call('simulation/request_key_frame', Trigger).success)
    states.wait(lambda s: s.key_frame and s.step > key_frame.step, 'key frame that was asked for')
    del simulation

  def testALateReceiverOfAPausedSimulationGetsAKeyFrame(self):
    simulation = graph.Simulation(self)
    simulation.step(30)
    states = self.listen('grid/state', GridState)
    self.assertEqual(states.wait(lambda s: s.key_frame, 'key frame').step, 30)

  def testItStopsAfterTheStatedTime(self):
    simulation = graph.Simulation(self, stop_after_s=0.5)
    stats = self.listen('simulation/stats', SimulationStats)
    stats.wait(what='stats')
    simulation.pause(False)
    self.assertEqual(self.finish(simulation.node), 0)
    self.assertIn('the run is complete', simulation.node.output())
    stats.wait(lambda s: abs(s.simulation_time - 0.5) < 1e-9, 'stats of the end')
    self.assertAlmostEqual(max(s.simulation_time for s in stats.messages), 0.5)

  def testNumbersOfThreadsAgree(self):
    hashes = []
    for threads in (1, 2):
      simulation = graph.Simulation(self, threads=threads)
      simulation.open_inputs()
      simulation.push(sequence=1, apply_at_step=1)
      simulation.cut(sequence=1, apply_at_step=40)
      hashes.append(simulation.step(80).state_hash)
      self.assertEqual(len(simulation.applied()), 2)
      self.assertEqual(simulation.node.stop(), 0)
      self.kill(simulation.node)
      self.closeAll()
    self.assertEqual(hashes[0], hashes[1])

  def closeAll(self):
    for listener in list(self._listeners):
      self.unlisten(listener)
    while self._publishers:
      self._publishers.pop().unregister()


if __name__ == '__main__':
  graph.run('simulation_graph_test')
