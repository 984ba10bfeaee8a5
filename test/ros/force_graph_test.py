#!/usr/bin/python3
"""How true a felt force is, through device, tool and simulation: a slow press of 3 x 3 vertices of a homogeneous block."""

import os

import numpy
from soft_volume.msg import GridState, ToolState

import graph
import phantom

SPACING_M = 0.008
FOOTPRINT_M = 1.98 * SPACING_M  # 3 x 3 vertices of the top
TIP_M = 0.002  # small, so that a sphere that rests on the dent's flanks tells of the dent
MIDDLE = numpy.array([0.047, 0.047, phantom.TOP_Z_M])
MOST_ERROR = 0.05
PRESS_S = 12.0


def pressScene():
  """A hand that goes 24 mm below the surface within twelve seconds."""
  scene = phantom.scene()
  scene['materials'][0].update(youngs_modulus_pa=8000, poisson_ratio=0.45)
  scene['simulation'].update(active_set='all', substeps=True)
  scene['tools'][0].update(tip_radius_m=TIP_M, footprint_radius_m=FOOTPRINT_M, stiffness_n_m=400)
  free, deep = (MIDDLE + [0, 0, TIP_M + z] for z in (0.004, -0.024))
  scene['device'].update(hand_stiffness_n_m=1000, hand_damping_n_s_m=10)
  scene['device']['way_points'] = [{
      'time_s': t, 'position_m': [float(x) for x in p]
  } for t, p in ((0.0, free), (1.0, free), (1.0 + PRESS_S, deep), (600.0, deep))]
  return scene


class ForceTest(graph.GraphTest):

  def pressed(self):
    """Force, depth of the surface under the proxy, depth of the device and the coupling's stiffness while it presses."""
    states = self.listen('tool/state', ToolState, keep=1000000)
    tool, device = self.start('tool_node'), self.start('device_node', scene=self.folder + '/block.yaml')
    deep_m = MIDDLE[2] + TIP_M - 0.012
    states.wait(lambda s: s.in_contact and s.pose.position.z < deep_m, 'device 12 mm deep', limit_s=90.0)
    self.stop(device)
    self.stop(tool)
    samples = [(s.device_force.z, MIDDLE[2] + TIP_M - s.proxy.position.z, MIDDLE[2] + TIP_M - s.pose.position.z,
                s.coupling_stiffness)
               for s in states.messages
               if s.in_contact and not (s.pose_stale or s.slew_limited or s.tripped)]
    return numpy.array(samples)

  def stop(self, node):
    self.assertEqual(node.stop(), 0)
    self._nodes.remove(node)

  def latticeDepth(self, force_n):
    """Of the middle of the top when the same force is laid upon the lattice, without device and tool."""
    grid = self.listen('grid/state', GridState)
    rest = self.simulation.topologies.messages[-1].rest_positions
    vertex = int(numpy.argmin([abs(p.x - MIDDLE[0]) + abs(p.y - MIDDLE[1]) + abs(p.z - MIDDLE[2]) for p in rest]))
    depth_m = 0.0
    for _ in range(2):  # the footprint lies on the deformed surface
      self.sequence += 1
      self.simulation.push(self.sequence, hold_steps=10000, footprint_radius=FOOTPRINT_M, force__z=-force_n,
                           point__x=MIDDLE[0], point__y=MIDDLE[1], point__z=MIDDLE[2] - depth_m)
      self.simulation.step(1500)
      heights = [dict(zip(s.vertex_ids, s.positions))[vertex].z for s in grid.messages[-20:] if vertex in s.vertex_ids]
      self.assertLess(abs(heights[-1] - heights[-2]), 1e-6)
      depth_m = MIDDLE[2] - heights[-1]
    self.unlisten(grid)
    return depth_m

  def testForceAgainstDepthIsThatOfTheLattice(self):
    # Of one value, so that the surface is where the top's vertices are.
    phantom.write_volume(os.path.join(self.folder, 'block.mha'), (100, 100))
    phantom.write_volume(os.path.join(self.folder, 'labels.mha'), phantom.LABELS)
    self.simulation = graph.Simulation(self, pressScene(), start_paused='false', real_time_factor=1.0)
    samples = self.pressed()
    self.simulation.pause(True)
    self.simulation.open_inputs()
    self.simulation.reset()
    self.sequence = 0
    strongest_n = samples[:, 0].max()
    self.assertGreater(strongest_n, 0.05)  # a busy machine is late, and the coupling soft then
    for share in (0.3, 0.6, 0.9):
      force_n = share * strongest_n
      near = samples[numpy.abs(samples[:, 0] - force_n) < 0.02 * strongest_n]
      self.assertGreater(len(near), 20)
      middle_n = numpy.median(near[:, 0])
      depth_m = self.latticeDepth(middle_n) * near[:, 0] / middle_n
      # The stiffness falls when the machine is late: each sample with its own.
      series_m = depth_m + near[:, 0] / near[:, 3]
      surface, device = numpy.median(near[:, 1] / depth_m), numpy.median(near[:, 2] / series_m)
      print('%.3f N: surface %.4f as deep as the lattice, device %.4f as deep as lattice and coupling in series' %
            (middle_n, surface, device))
      self.assertLess(abs(surface - 1.0), MOST_ERROR)
      self.assertLess(abs(device - 1.0), MOST_ERROR)


if __name__ == '__main__':
  graph.run('force_graph_test')
