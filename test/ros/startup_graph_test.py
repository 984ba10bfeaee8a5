#!/usr/bin/python3
"""How nodes start, or say why they do not: launch files, nodelets, wrong parameters, wrong files."""

import glob
import os
import signal
import subprocess

import rospkg
import rospy
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import Image
from soft_volume.msg import GridState, RenderStats, SimulationStats, ToolForce
from std_srvs.srv import SetBool

import graph
import phantom


class RefusalTest(graph.GraphTest):
  """A node that cannot do its work ends with exit code 1 and a reason that names the place and the remedy."""

  def refuses(self, program, *reasons, environment=None, **parameters):
    node = self.start(program, environment=environment, **parameters)
    self.assertEqual(self.finish(node), 1, node.output())
    for reason in reasons:
      self.assertIn(reason, node.output())

  def scene(self, change=lambda scene: None):
    content = phantom.scene()
    change(content)
    return phantom.write_scene(self.folder, content)

  def testNoSceneParameter(self):
    self.refuses('simulation_node', '/simulation/scene is missing', 'the scene file')
    self.refuses('device_node', '/device/scene is missing', 'the scene file')

  def testASceneThatIsNotThere(self):
    for program in ('simulation_node', 'device_node'):
      self.refuses(program, '/nowhere.yaml', 'cannot be read', scene='/nowhere.yaml')

  def testParametersOutOfRange(self):
    scene = self.scene()
    self.refuses('simulation_node', '/simulation/threads is 0', '[1, 256]', scene=scene, threads=0)
    self.refuses('simulation_node', '/simulation/real_time_factor', 'wrong type', scene=scene, real_time_factor='fast')
    self.refuses('simulation_node', '/simulation/real_time_factor is -1', scene=scene, real_time_factor=-1)
    self.refuses('tool_node', '/tool/wall_timeout_s is 99', wall_timeout_s=99)

  def testAMissingVolume(self):
    scene = self.scene(lambda s: s['volume'].update(file='missing.mha'))
    self.refuses('simulation_node', self.folder + '/missing.mha', scene=scene)

  def testATruncatedVolume(self):
    scene = self.scene()
    with open(self.folder + '/block.mha', 'r+b') as volume:
      volume.truncate(5000)
    self.refuses('simulation_node', 'block.mha', scene=scene)

  def testATypo(self):
    for program in ('simulation_node', 'device_node'):
      scene = self.scene(lambda s: s['lattice'].update(spaceing_m=0.01))
      self.refuses(program, 'block.yaml:', "spaceing_m", scene=scene)

  def testValuesThatCannotBe(self):
    for reasons, change in (
        (['spacing_m', '0.0002', ' m'], lambda s: s['lattice'].update(spacing_m=-0.008)),
        (['poisson_ratio', '0.49'], lambda s: s['materials'][0].update(poisson_ratio=0.5)),
        (['dt_s', 'stability limit'], lambda s: s['simulation'].update(dt_s=0.01)),
        (['the lattice is empty'], lambda s: s['materials'][0].update(intensity=[5000, 6000])),
    ):
      self.refuses('simulation_node', *reasons, scene=self.scene(change))

  def testAnUnsetVariableInAPath(self):
    scene = self.scene(lambda s: s['volume'].update(file='${SOFT_VOLUME_NO_SUCH_VARIABLE}/block.mha'))
    self.refuses('simulation_node', 'SOFT_VOLUME_NO_SUCH_VARIABLE', scene=scene)


class ShippedFilesTest(graph.GraphTest):

  def setUp(self):
    super().setUp()
    rospy.set_param('/use_sim_time', False)  # nobody drives the clock of a device alone
    self.package = rospkg.RosPack().get_path('soft_volume')

  def testEveryShippedSceneLoads(self):
    scenes = glob.glob(os.path.join(glob.escape(self.package), 'config/scenes/*.yaml'))
    self.assertGreater(len(scenes), 0)
    for scene in scenes:
      # The device needs all of the scene to be valid, and not the volume.
      node = self.start('device_node', scene=scene, environment={'SOFT_VOLUME_CACHE': '/nowhere'})
      poses = self.listen('measured_cp', PoseStamped)
      poses.wait(what='pose of the hand in ' + scene)
      self.unlisten(poses)
      self.assertEqual(node.stop(), 0)
      self.kill(node)


class LaunchTest(graph.GraphTest):
  """The launch file that a user starts, with nodes and with nodelets."""

  def setUp(self):
    super().setUp()
    self.roslaunch = None

  def tearDown(self):
    if self.roslaunch is not None and self.roslaunch.poll() is None:
      self.stopLaunch()
    super().tearDown()

  def launch(self, **arguments):
    # The hand is fast at a low real-time factor; a tool in the hand, two cameras, everything in one graph.
    arguments = dict(dict(scene=phantom.write_scene(self.folder), real_time_factor='0.25'), **arguments)
    command = graph.dying_with_us('TERM') + ['roslaunch', 'soft_volume', 'demo.launch']
    command += ['%s:=%s' % a for a in arguments.items()]
    self.log = open(self.folder + '/roslaunch.log', 'w+')
    self.roslaunch = subprocess.Popen(command, stdout=self.log, stderr=subprocess.STDOUT)

  def stopLaunch(self):
    self.roslaunch.send_signal(signal.SIGINT)
    try:
      code = self.roslaunch.wait(timeout=30)
    except subprocess.TimeoutExpired:
      self.roslaunch.terminate()
      self.roslaunch.wait(timeout=30)
      raise AssertionError('roslaunch did not end\n' + self.output())
    finally:
      self.log.close()
    return code

  def output(self):
    with open(self.folder + '/roslaunch.log') as log:
      return log.read()

  def checkGraph(self, **arguments):
    images, side = self.listen('top/image_raw', Image), self.listen('side/depth', Image)
    stats = self.listen('render/stats', RenderStats)
    forces, grid = self.listen('tool/force', ToolForce), self.listen('grid/state', GridState)
    self.launch(**arguments)
    try:
      images.wait(what='image', limit_s=60)
      side.wait(what='depth')
      force = forces.wait(lambda f: f.force.z < -0.2, 'push')
      moved = grid.wait(lambda s: s.session == force.session and s.step > force.step and s.positions, 'dent')
      stats.wait(lambda s: s.camera == 'top' and s.step >= moved.step, 'picture of the dent')
      stopped = self.stopLaunch()
    except AssertionError as error:
      raise AssertionError('%s\n%s' % (error, self.output()))
    self.assertEqual(stopped, 0, self.output())
    self.assertNotIn('has died', self.output())
    self.assertNotIn('escalating', self.output())

  def testNodes(self):
    self.checkGraph(nodelets='false')

  def testNodelets(self):
    self.checkGraph(nodelets='true')

  def testTheRunEndsByItself(self):
    stats = self.listen('simulation/stats', SimulationStats)
    self.launch(stop_after_s='0.5', real_time_factor='0', start_paused='true')
    stats.wait(what='stats', limit_s=60)
    self.assertTrue(self.call('simulation/pause', SetBool, False).success)
    stats.wait(lambda s: s.simulation_time >= 0.5 - 1e-9, 'end of the run', limit_s=60)
    self.assertEqual(self.roslaunch.wait(timeout=30), 0)
    self.assertIn('the run is complete', self.output())


if __name__ == '__main__':
  graph.run('startup_graph_test', simulated_time=True)
