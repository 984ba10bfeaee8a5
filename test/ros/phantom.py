"""A small analytic scene: a soft block with coloured columns, its bottom held, a probe, two cameras.

The block fills [7, 87] x [7, 87] x [7, 71] mm of the volume frame, 10 x 10 x 8 cells of 8 mm. Its outer voxels reach
into the cells around, so the lattice has one more on every side.
"""

import copy
import os

import numpy
import yaml

SPACING_M = 0.002
DIMS = (48, 48, 44)
BLOCK_MIN_M = numpy.array([0.007, 0.007, 0.007])
BLOCK_MAX_M = numpy.array([0.087, 0.087, 0.071])
TOP_Z_M = BLOCK_MAX_M[2]
VERTICES = 13 * 13 * 11
THRESHOLD = 50
LABELS = (7, 300)


def _block(column_values):
  """Voxels of the block: columns of 16 mm with two values, 0 around it."""
  nx, ny, nz = DIMS
  k, j, i = numpy.mgrid[0:nz, 0:ny, 0:nx]
  inside = (i >= 4) & (i < 44) & (j >= 4) & (j < 44) & (k >= 4) & (k < 36)
  return numpy.where(inside, numpy.asarray(column_values)[(i // 8 + j // 8) % 2], 0).astype('<i2')


def write_volume(path, column_values=(100, 140)):
  """Writes the block as a MetaImage."""
  header = [
      'ObjectType = Image', 'NDims = 3', 'BinaryData = True', 'BinaryDataByteOrderMSB = False',
      'CompressedData = False', 'TransformMatrix = 1 0 0 0 1 0 0 0 1', 'Offset = 0 0 0', 'ElementSpacing = 2 2 2',
      'DimSize = %d %d %d' % DIMS, 'ElementType = MET_SHORT', 'ElementDataFile = LOCAL', ''
  ]
  with open(path, 'wb') as file:
    file.write('\n'.join(header).encode())
    file.write(_block(column_values).tobytes())


_SCENE = {
    'format': 1,
    'name': 'block',
    'volume': {'file': 'block.mha'},
    'materials': [{
        'name': 'tissue', 'intensity': [THRESHOLD, 1000], 'density_kg_m3': 1000, 'youngs_modulus_pa': 6000,
        'damping_ratio': 0.5
    }],
    'lattice': {'spacing_m': 0.008, 'fixed_regions_m': [{'min': [-0.01, -0.01, -0.01], 'max': [0.1, 0.1, 0.008]}]},
    'simulation': {'dt_s': 0.001, 'activation_radius_m': 0.02, 'lifetime_s': 3.0, 'max_tool_force_n': 20},
    'incision': {'rest_fraction': 0.7},
    'output': {
        'state_rate_hz': 50, 'patch_rate_hz': 250, 'key_frame_interval_s': 60, 'checkpoint_interval_s': 3600
    },
    'rendering': {
        'transfer_function': {
            'unit_distance_m': 0.001,
            'points': [[50, 0.9, 0.3, 0.2, 0.0], [90, 0.9, 0.3, 0.2, 0.9], [150, 0.2, 0.4, 0.9, 0.95]]
        },
        'slices': 40,
        'shading': 0.7,
        'rate_hz': 20,
        'cameras': [{
            'name': 'top', 'width': 160, 'height': 120, 'eye_m': [0.047, 0.047, 0.30],
            'target_m': [0.047, 0.047, 0.04], 'up': [0, 1, 0], 'vertical_fov_rad': 0.5
        }, {
            'name': 'side', 'width': 128, 'height': 96, 'eye_m': [0.047, -0.25, 0.06],
            'target_m': [0.047, 0.047, 0.04], 'up': [0, 0, 1], 'vertical_fov_rad': 0.4
        }],
    },
    'tools': [{
        'id': 'probe', 'kind': 'probe', 'tissue_threshold': THRESHOLD, 'tip_radius_m': 0.006,
        'footprint_radius_m': 0.012, 'patch_radius_m': 0.03, 'hold_steps': 50
    }],
    'device': {
        'model': 'touch',
        'workspace_centre_m': [0.047, 0.047, 0.071],
        # Down onto the middle of the top face within 0.2 s, 10 mm deep, and there it stays.
        'way_points': [{'time_s': 0.0, 'position_m': [0.047, 0.047, 0.080]},
                       {'time_s': 0.2, 'position_m': [0.047, 0.047, 0.066]},
                       {'time_s': 600.0, 'position_m': [0.047, 0.047, 0.066]}]
    }
}


def scene():
  """A fresh copy of the scene, to be changed at will."""
  return copy.deepcopy(_SCENE)


def write_scene(folder, content=None, name='block.yaml'):
  """Writes volume, labels and scene into `folder`; returns the path of the scene."""
  volume = os.path.join(folder, 'block.mha')
  if not os.path.exists(volume):
    write_volume(volume)
    write_volume(os.path.join(folder, 'labels.mha'), LABELS)
  path = os.path.join(folder, name)
  with open(path, 'w') as file:
    yaml.safe_dump(content or scene(), file, sort_keys=False)
  return path
