#!/usr/bin/python3
"""Simulation and renderer: what the images show, who gets them, and what the renderer does with damaged input."""

import copy
import io
import struct

import dynamic_reconfigure.client
import numpy
import PIL.Image
import rospy
from geometry_msgs.msg import Point32, PoseStamped
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from soft_volume.msg import GridState, GridTopology, RenderStats, Scene, Volume

import graph
import phantom


def pixels(image):
  return numpy.frombuffer(image.data, numpy.uint8).reshape(image.height, image.width, 3)


def depths(image):
  return numpy.frombuffer(image.data, numpy.float32).reshape(image.height, image.width)


def rotation(q):
  """Matrix of a unit quaternion."""
  x, y, z, w = q.x, q.y, q.z, q.w
  return numpy.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                      [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                      [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


def project(points, pose, info):
  """Pixel coordinates of points in the volume frame, by the camera's own pose and CameraInfo."""
  eye = numpy.array([pose.position.x, pose.position.y, pose.position.z])
  p = (numpy.asarray(points) - eye) @ rotation(pose.orientation)
  k = numpy.array(info.K).reshape(3, 3)
  uvw = p @ k.T
  return uvw[:, :2] / uvw[:, 2:]


def corners(low, high):
  return [[(low, high)[a][0], (low, high)[b][1], (low, high)[c][2]] for a in (0, 1) for b in (0, 1) for c in (0, 1)]


class RenderingTest(graph.GraphTest):

  def setUp(self):
    super().setUp()
    scene = phantom.scene()
    # So that a push leaves most of the block alone: growth lets all of it move a little, as real tissue does.
    scene['simulation'].update(active_set='neighbourhood', activation_radius_m=0.01)
    self.simulation = graph.Simulation(self, scene)
    self.renderer = self.start('renderer_node')
    self.stats = self.listen('render/stats', RenderStats)
    self.stats.connect()

  def watch(self, camera='top'):
    return self.listen(camera + '/image_raw', Image)

  def lookAgain(self, camera='top'):
    """A picture that was drawn after now, for a new audience."""
    images = self.watch(camera)
    image = images.wait(what='image')
    self.unlisten(images)
    return image

  def testTheImageChangesOnlyWhereTheGridMoved(self):
    self.simulation.open_inputs()
    images = self.watch()
    depth = self.listen('top/depth', Image)
    infos = self.listen('top/camera_info', CameraInfo)
    states = self.listen('grid/state', GridState)
    states.connect()
    info = infos.wait(what='camera info')
    before = pixels(images.wait(what='image at rest'))
    depth_before = depths(depth.wait(what='depth at rest'))
    self.simulation.push(sequence=1, apply_at_step=1, point__x=0.019, point__y=0.019, footprint_radius=0.01)
    self.simulation.step(200)
    state = states.wait(lambda s: s.step == 200 and not s.key_frame, 'state after the push')
    after = pixels(images.wait(lambda i: i.header.stamp == state.header.stamp, 'image after the push'))
    depth_after = depths(depth.wait(lambda i: i.header.stamp == state.header.stamp, 'depth after the push'))

    # A vertex that moved changes its cells and, as light is interpolated between vertices, the cells around those.
    two_cells = 2 * 0.008
    low = numpy.array([state.moved_min.x, state.moved_min.y, state.moved_min.z]) - two_cells
    high = numpy.array([state.moved_max.x, state.moved_max.y, state.moved_max.z]) + two_cells
    pose = self.stats.wait(lambda s: s.camera == 'top' and s.step == 200, 'render stats').pose
    uv = project(corners(low, high), pose, info)
    left, upper = numpy.floor(uv.min(axis=0)).astype(int) - 2
    right, lower = numpy.ceil(uv.max(axis=0)).astype(int) + 3
    near = numpy.zeros(before.shape[:2], bool)
    near[max(upper, 0):lower, max(left, 0):right] = True

    tissue = (before != before[0, 0]).any(axis=2)
    self.assertGreater(tissue.sum(), 2000)
    self.assertGreater((tissue & ~near).sum(), 0.25 * tissue.sum(), 'the push must leave tissue alone')
    changed = (before != after).any(axis=2)
    self.assertGreater((changed & near).sum(), 100)
    self.assertEqual((changed & ~near).sum(), 0)
    same_depth = (depth_before == depth_after) | (numpy.isnan(depth_before) & numpy.isnan(depth_after))
    self.assertTrue(same_depth[~near].all())
    # The dent is farther from the camera, by about as much as the vertices below it went down.
    centre = project([[0.019, 0.019, phantom.TOP_Z_M]], pose, info)[0].round().astype(int)
    dent = depth_after[centre[1], centre[0]] - depth_before[centre[1], centre[0]]
    went_down = max(phantom.TOP_Z_M - p.z for v, p in self.moved(state) if abs(self.rest(v).z - phantom.TOP_Z_M) < 1e-4)
    self.assertGreater(went_down, 0.001)
    self.assertGreater(dent, 0.5 * went_down)
    self.assertLess(dent, 1.5 * went_down)

  def moved(self, state):
    return zip(state.vertex_ids, state.positions)

  def rest(self, vertex):
    return self.simulation.topologies.messages[-1].rest_positions[vertex]

  def reconfigure(self, **values):
    """Changes options of the renderer; returns what is in force then."""
    if not hasattr(self, '_client'):
      self._client = dynamic_reconfigure.client.Client('renderer', timeout=graph.LIMIT_S)
    self._since = len(self.stats.messages)
    return self._client.update_configuration(values)

  def statsOfANewRenderer(self):
    """Its first frames may come before this test hears their statistics, so it is asked for pictures until it does."""

    def look():
      self.lookAgain()
      return self.stats.messages

    return graph.wait_until(look, 'render stats of the new renderer')[0]

  def nextStats(self, condition=lambda stats: True, camera='top', since=None):
    """The first render stats after the last reconfiguration, or after the first `since`, that meet the condition."""
    old = self._since if since is None else since
    return graph.wait_until(
        lambda: next((s for s in self.stats.messages[old:] if s.camera == camera and condition(s)), None), 'render stats')

  def testEveryFrameIsAsIfAllOfItHadBeenDrawn(self):
    """What an incremental frame keeps from the frame before is what a full redraw of the same state has there."""
    self.simulation.open_inputs()
    images = self.watch()
    images.wait(what='image')
    drawn_in_part = 0
    for n in range(10):
      if n == 6:
        self.simulation.cut(sequence=1)
      self.simulation.push(sequence=n + 1, point__x=0.02 + 0.004 * n, footprint_radius=0.01, hold_steps=40)
      step = self.simulation.step(50).step
      # In the order in which they come: the state in part, all of it, and nothing new of it.
      part = self.stats.wait(lambda s: s.camera == 'top' and s.step == step, 'frame of step %d' % step)
      self.reconfigure(incremental=False)
      full = self.stats.wait(lambda s: s.step == step and area(s) == 160 * 120, 'full redraw of step %d' % step)
      self.assertEqual(full.image_hash, part.image_hash, 'step %d' % step)
      before = full.frames_published
      self.reconfigure(incremental=True)
      self.stats.wait(lambda s: s.camera == 'top' and s.frames_published > before, 'frame after the full redraw')
      if part is not full and area(part) < 160 * 120:
        drawn_in_part += 1
        self.assertGreater(area(part), 0)
    self.assertGreater(drawn_in_part, 5)

  def testOptionsChangeWhileItRuns(self):
    scene = self.simulation.scenes.wait(what='scene')
    images = self.watch()
    first = self.stats.wait(what='frame')
    self.assertEqual((first.backend, first.settings, first.coarseness), ('native', '', 1))
    rendering = phantom.scene()['rendering']
    config = self.reconfigure()
    self.assertEqual((config.slices, config.shading, config.rate_hz), (rendering['slices'], rendering['shading'], 20.0))
    hashes = {first.image_hash}
    changes = [('slices', 160), ('shading', 0.3), ('specular', 0.9), ('step_m', 0.01), ('jitter', True),
               ('clip_planes', '[[0, 1, 0, 0.047]]'), ('background', '[1, 0.5, 0]'), ('transfer_function', 'viridis'),
               ('exact_boundary', True)]
    for key, value in changes:
      self.reconfigure(**{key: value})
      changed = self.nextStats(lambda s: key + ':' in s.settings and s.image_hash not in hashes)
      hashes.add(changed.image_hash)
    self.assertLess(changed.slices, first.slices)
    images.wait(lambda i: (pixels(i)[0, 0] == (255, 128, 0)).all(), 'image with the new background')
    for backend in ('gl', 'exact', 'native'):
      self.reconfigure(backend=backend, exact_boundary=False)
      stats = self.nextStats(lambda s: s.backend == backend)
      self.assertEqual(area(stats), 160 * 120)
    # A renderer that starts again has the scene's values: the node writes no parameters. A picture is drawn for a new
    # audience, and who listens twice in one process is one audience: so the first listener leaves.
    self.unlisten(images)
    self.kill(self.renderer)
    self.stats.clear()
    self.renderer = self.start('renderer_node')
    again = self.statsOfANewRenderer()
    self.assertEqual((again.image_hash, again.settings), (first.image_hash, ''))
    self.assertEqual(scene.yaml, self.simulation.scenes.messages[-1].yaml)

  def testOptionsThatCannotBeUsedChangeNothing(self):
    self.watch()
    first = self.stats.wait(what='frame')
    before = self.reconfigure()
    bad = [dict(slices=0), dict(slices=5000), dict(shading=1.5), dict(shading=float('nan')), dict(backend='magic'),
           dict(clip_planes='[[0, 0, 0, 1]]'), dict(clip_planes='1'), dict(background='red'), dict(rate_hz=0.0),
           dict(transfer_function='rainbow'), dict(transfer_function='/no/such/file.yaml')]
    for values in bad:
      self.assertEqual(self.reconfigure(**values), before, values)
    self.wait_for_refusals('renderer', 'parameters', len(bad), '/no/such/file.yaml')
    self.assertEqual(self.stats.messages[-1].image_hash, first.image_hash)
    self.assertEqual(self.stats.messages[-1].settings, '')

  def testParametersReplaceTheScene(self):
    self.kill(self.renderer)
    rospy.set_param('/tuned/clip_planes', [[0, 0, 1, 0.05]])
    rospy.set_param('/tuned/shading', 0)
    command = dict(name='tuned', slices='17', backend='exact', transfer_function='ct_bone', threads='1')
    tuned = graph.Node('renderer_node', command.pop('name'), command, self.folder)
    self._nodes.append(tuned)
    stats = self.statsOfANewRenderer()
    self.assertEqual(stats.backend, 'exact')
    for text in ('slices: 17', 'shading: 0\n', '[0, 0, 1, 0.05]', 'backend: "exact"', 'rate_hz: 20'):
      self.assertIn(text, stats.settings)
    self.assertNotIn('slices: 40', stats.settings)
    for parameters, reason in ((dict(slices='0'), 'slices is 0; it must be within [1, 4096]'),
                               (dict(backend='vulkan'), 'native'), (dict(threads='-1'), 'threads')):
      refused = self.start('renderer_node', name='refused', **parameters)
      self.assertEqual(self.finish(refused), 1)
      self.assertIn(reason, refused.output())

  def testAChangeOfViewMayBeRefinedStepByStep(self):
    self.watch()
    complete = self.stats.wait(what='frame')
    self.reconfigure(progressive=True)
    self.assertEqual(self.nextStats(lambda s: 'progressive: true' in s.settings).image_hash, complete.image_hash)
    views = self.publisher('top/view', PoseStamped)
    view = PoseStamped()
    view.pose = copy.deepcopy(complete.pose)
    view.pose.position.y += 0.01
    first = len(self.stats.messages)
    views.publish(view)
    last = self.nextStats(lambda s: s.pose.position.y == view.pose.position.y and not s.refining, since=first)
    frames = [s for s in self.stats.messages[first:] if s.pose.position.y == view.pose.position.y]
    self.assertEqual([s.coarseness for s in frames], [8, 4, 2, 1])
    self.assertEqual([s.refining for s in frames], [1, 1, 1, 0])
    self.assertEqual([s.slices for s in frames], sorted(s.slices for s in frames))
    self.assertLess(frames[0].slices, 0.2 * last.slices)
    rospy.rostime.wallsleep(0.3)
    self.assertIs(self.stats.messages[-1], last, 'nothing follows the complete frame')
    # The end is what it is without refining.
    self.reconfigure(progressive=False)
    self.assertEqual(self.nextStats(lambda s: 'progressive: false' in s.settings).image_hash, last.image_hash)

  def testACameraThatCannotBeDrawnIsSkippedWithItsReason(self):
    """OpenGL may be missing; the native back end needs none."""
    self.kill(self.renderer)
    self.renderer = self.start('renderer_node', environment={'MESA_GL_VERSION_OVERRIDE': '2.1'}, backend='gl')
    images = self.watch()
    self.wait_for_status('renderer', lambda s: s.level in (2, b'\x02') and 'OpenGL' in s.message, 'an error of OpenGL')
    self.assertEqual((images.messages, self.stats.messages), ([], []))
    self.reconfigure(backend='native')
    images.wait(what='image of the native back end')
    self.wait_for_status('renderer', lambda s: s.level in (0, b'\x00'), 'no error')

  def testLabelsAreThoseOfTheSurface(self):
    scene = phantom.scene()
    scene['volume']['labels'] = 'labels.mha'
    self.simulation.node.stop()
    self._killed.add(self.simulation.node)
    self.simulation = graph.Simulation(self, scene)
    labels = self.listen('top/labels', Image)
    image = labels.wait(what='label image')
    self.assertEqual((image.encoding, image.step, len(image.data)), ('mono16', 2 * 160, 2 * 160 * 120))
    values = numpy.frombuffer(image.data, numpy.uint16).reshape(image.height, image.width)
    depth = depths(self.listen('top/depth', Image).wait(what='depth'))
    beside = labels.wait(lambda i: i is not image, 'labels beside depth')
    self.assertEqual(beside.data, image.data)
    # Labels are there where depth is.
    self.assertEqual(set(numpy.unique(values)), {0, *phantom.LABELS})
    self.assertTrue(((values != 0) == ~numpy.isnan(depth)).mean() > 0.99)
    # In the middle of every whole column of the top face.
    info = self.listen('top/camera_info', CameraInfo).wait(what='camera info')
    pose = self.stats.wait(lambda s: s.camera == 'top' and s.session == self.simulation.session, 'stats').pose
    for i in range(1, 5):
      for j in range(1, 5):
        u, v = project([[0.016 * i + 0.007, 0.016 * j + 0.007, phantom.TOP_Z_M]], pose, info)[0].round().astype(int)
        self.assertEqual(values[v, u], phantom.LABELS[(i + j) % 2], (i, j))

  def testACameraMayBeParallel(self):
    scene = phantom.scene()
    top = scene['rendering']['cameras'][0]
    del top['vertical_fov_rad']
    top.update(projection='parallel', view_height_m=0.12)
    self.simulation.node.stop()
    self._killed.add(self.simulation.node)
    self.simulation = graph.Simulation(self, scene)
    images, infos = self.watch(), self.listen('top/camera_info', CameraInfo)
    image = images.wait(what='image')
    info = infos.wait(what='camera info')
    self.assertEqual(list(info.P), [1000, 0, 0, 79.5, 0, 1000, 0, 59.5, 0, 0, 0, 1])
    # 80 mm of block at 1000 pixels per metre, whatever its depth.
    rows, columns = numpy.nonzero((pixels(image) != pixels(image)[0, 0]).any(axis=2))
    self.assertAlmostEqual(columns.max() - columns.min() + 1, 80, delta=2)
    self.assertAlmostEqual(rows.max() - rows.min() + 1, 80, delta=2)

  def testEveryCameraHasItsOwnPicture(self):
    expected = {c['name']: c for c in phantom.scene()['rendering']['cameras']}
    raw = {}
    for name, camera in expected.items():
      images, infos = self.watch(name), self.listen(name + '/camera_info', CameraInfo)
      image = images.wait(what='image')
      info = infos.wait(lambda i: i.header.stamp == image.header.stamp, 'camera info with the stamp of the image')
      focal = 0.5 * camera['height'] / numpy.tan(0.5 * camera['vertical_fov_rad'])
      k = [focal, 0, 0.5 * (camera['width'] - 1), 0, focal, 0.5 * (camera['height'] - 1), 0, 0, 1]
      numpy.testing.assert_allclose(info.K, k, rtol=1e-12)
      numpy.testing.assert_allclose(numpy.array(info.P).reshape(3, 4)[:, :3].ravel(), k, rtol=1e-12)
      self.assertEqual(list(info.R), [1, 0, 0, 0, 1, 0, 0, 0, 1])
      self.assertEqual((info.width, info.height), (camera['width'], camera['height']))
      self.assertEqual((image.width, image.height), (camera['width'], camera['height']))
      self.assertEqual((image.encoding, image.step, len(image.data)),
                       ('rgb8', 3 * image.width, 3 * image.width * image.height))
      self.assertEqual(image.header.frame_id, name + '_optical_frame')
      self.assertEqual(info.header.frame_id, image.header.frame_id)
      raw[name] = pixels(image)
      self.assertTrue(raw[name].any())
    self.assertNotEqual(raw['top'].shape, raw['side'].shape)
    # From above the block is as wide as high, from the side it is not.
    self.assertAlmostEqual(self.aspect(raw['top']), 1.0, delta=0.1)
    self.assertGreater(self.aspect(raw['side']), 1.1)

  def aspect(self, image):
    rows, columns = numpy.nonzero(image.any(axis=2))
    return (columns.max() - columns.min() + 1) / (rows.max() - rows.min() + 1)

  def testNothingIsRenderedForNobody(self):
    for _ in range(5):
      self.simulation.step(100)
    rospy.rostime.wallsleep(0.5)
    self.assertEqual(self.stats.messages, [])
    infos = self.listen('side/camera_info', CameraInfo)
    infos.wait(what='camera info')
    self.stats.wait(what='render stats')
    self.assertEqual({s.camera for s in self.stats.messages}, {'side'})

  def testTheCompressedImageIsAJpegOfTheImage(self):
    images, compressed = self.watch(), self.listen('top/image_raw/compressed', CompressedImage)
    jpeg = compressed.wait(what='compressed image')
    raw = images.wait(lambda i: i.header.stamp == jpeg.header.stamp, 'raw image')
    self.assertIn('jpeg', jpeg.format)
    self.assertEqual(jpeg.header.frame_id, raw.header.frame_id)
    picture = PIL.Image.open(io.BytesIO(bytes(jpeg.data)))
    self.assertEqual((picture.format, picture.size), ('JPEG', (raw.width, raw.height)))
    difference = numpy.asarray(picture.convert('RGB')).astype(int) - pixels(raw)
    self.assertLess(numpy.sqrt((difference**2).mean()), 10.0)

  def testDepthIsThatOfTheFace(self):
    depth = depths(self.listen('top/depth', Image).wait(what='depth'))
    image = pixels(self.watch().wait(what='image'))
    self.assertTrue(numpy.isnan(depth[:5]).all())
    self.assertTrue((image[:5] == image[0, 0]).all())
    # The face is at TOP_Z_M, the camera at 0.30 m. The voxels' border is half a voxel wide, and a slice is 2 mm.
    middle = depth[50:70, 70:90]
    true_depth = 0.30 - phantom.TOP_Z_M
    self.assertGreater(middle.min(), true_depth - 0.5 * phantom.SPACING_M)
    self.assertLess(middle.max(), true_depth + phantom.SPACING_M + 0.096 / 40)
    # Depth is along z and not along the ray: the same all over the face.
    visible = ~numpy.isnan(depth)
    on_face = visible & (depth < true_depth + 0.006)
    self.assertGreater(on_face.sum(), 3000)
    self.assertLess(numpy.ptp(depth[on_face]), 0.006)

  def testTheViewMovesTheCamera(self):
    images = self.watch()
    before = pixels(images.wait(what='image'))
    views = self.publisher('top/view', PoseStamped)
    nan = PoseStamped()
    nan.pose.position.x = float('nan')
    nan.pose.orientation.w = 1.0
    for view in (nan, PoseStamped()):  # the second one has a quaternion of zeros
      views.publish(view)
    self.wait_for_warning('renderer', 'top/view', 'quaternion')
    view = PoseStamped()
    view.pose = copy.deepcopy(self.stats.wait(what='render stats').pose)
    view.pose.position.x += 0.02
    views.publish(view)
    stats = self.stats.wait(lambda s: s.pose.position.x == view.pose.position.x, 'picture from the new view')
    image = images.wait(lambda i: (pixels(i) != before).any(), 'other picture')
    self.assertEqual(stats.step, 0)
    moved = numpy.nonzero(before.any(axis=2))[1].mean() - numpy.nonzero(pixels(image).any(axis=2))[1].mean()
    self.assertGreater(abs(moved), 5.0)

  def testAKilledRendererStartsAgain(self):
    self.simulation.open_inputs()
    self.simulation.push(sequence=1, apply_at_step=1)
    self.simulation.step(200)
    first = self.lookAgain()
    self.kill(self.renderer)
    self.renderer = self.start('renderer_node')
    second = self.lookAgain()
    self.assertEqual(second.header.stamp, first.header.stamp)
    self.assertTrue((pixels(first) == pixels(second)).all())

  def testTheRendererFollowsAResetAndACut(self):
    self.simulation.open_inputs()
    images = self.watch()
    at_rest = pixels(images.wait(what='image'))
    self.simulation.cut(sequence=1)
    self.simulation.step(300)
    cut = self.stats.wait(lambda s: s.step == 300 and s.revision == 2, 'picture of the cut')
    image = images.wait(lambda i: i.header.stamp == cut.header.stamp, 'picture of the cut')
    self.assertGreater((pixels(image) != at_rest).any(axis=2).sum(), 20)
    session = self.simulation.reset()
    fresh = self.stats.wait(lambda s: s.session == session, 'picture of the new session')
    self.assertEqual((fresh.step, fresh.revision), (0, 1))
    images.wait(lambda i: i is images.messages[-1] and (pixels(i) == at_rest).all(), 'the picture at rest again')

  def testDamagedInputChangesNothing(self):
    before = self.lookAgain()
    key_frames = self.listen('grid/state', GridState)
    good = key_frames.wait(lambda s: s.key_frame, 'key frame')
    self.refuses('grid/state', good, [
        dict(vertex_count=7),
        dict(positions=good.positions[1:]),
        dict(key_frame=False, vertex_ids=[5, 5], positions=good.positions[:2]),
        dict(key_frame=False, vertex_ids=[10**6], positions=good.positions[:1]),
        dict(positions=[nanPoint()] + good.positions[1:]),
        dict(revision=0, step=10),
    ], 'revision 0 where the topology has 1')
    topology = self.simulation.topologies.messages[0]
    self.refuses('grid/topology', topology, [
        dict(delta=True),
        dict(connectivity=(10**6,) + topology.connectivity[1:]),
        dict(connectivity=topology.connectivity[1:]),
        dict(cell_types=b'\x07' + topology.cell_types[1:]),
        dict(face_neighbours=(10**6,) + topology.face_neighbours[1:]),
        dict(rest_positions=[nanPoint()] + topology.rest_positions[1:]),
        dict(vertex_count=3),
    ], 'do not have vertex_count and cell_count entries')
    volume = self.listen('volume', Volume).wait(what='volume')
    self.refuses('volume', volume, [
        dict(data=volume.data[2:]),
        dict(dims=[2**31, 1, 1]),
        dict(dims=[2**31 - 1, 2**31 - 1, 2**31 - 1]),
        dict(spacing=[0.0, 1.0, 1.0]),
        dict(scalar_type=99),
        dict(hash=1),
    ], 'does not have the stated hash')
    scene = self.simulation.scenes.messages[0]
    self.refuses('scene', scene, [dict(yaml=scene.yaml + '\nmatarials: 1\n')], 'matarials')

    after = self.lookAgain()
    self.assertTrue((pixels(before) == pixels(after)).all())
    # The statistics of a frame come after its images.
    self.stats.wait(lambda s: s.frames_rejected >= 20, 'statistics of the last picture')
    self.assertEqual(self.stats.messages[-1].frames_rejected, 20)

  def testMessagesThatCannotBeReadCostNothing(self):
    """Cut off, or with the claim of a length that the rest of the message does not have."""
    before = self.lookAgain()
    volume = self.listen('volume', Volume).wait(what='volume')
    state = self.listen('grid/state', GridState).wait(lambda s: s.key_frame, 'key frame')
    topology = self.simulation.topologies.messages[0]
    # What stands in front of an array's length, and the length.
    places = {
        'volume': (volume, struct.pack('<BI', volume.scalar_type, len(volume.data))),
        'grid/topology': (topology, struct.pack('<5I', topology.vertex_count, topology.cell_count, 0, 0,
                                                topology.vertex_count)),
        'grid/state': (state, struct.pack('<3I', state.vertex_count, 0, state.vertex_count)),
    }
    for topic, (good, place) in places.items():
      content = serialized(good)
      self.assertEqual(content.count(place), 1, topic)
      publisher = self.publisher(topic, type(good))
      for damaged in (content[:-1], content[:10], content.replace(place, place[:-4] + b'\xff\xff\xff\xff')):
        publisher.publish(unreadable(good, damaged))
      self.wait_for_refusals('renderer', topic, 3, 'is damaged')
    self.assertTrue((pixels(before) == pixels(self.lookAgain())).all())
    # The claims were of 4 GiB.
    with open('/proc/%d/status' % self.renderer.process.pid) as status:
      peak_kib = next(int(line.split()[1]) for line in status if line.startswith('VmHWM'))
    self.assertLess(peak_kib, 1024 * 1024)

  def testAStateWithoutItsTopologyIsReported(self):
    before = self.lookAgain()
    good = self.listen('grid/state', GridState).wait(lambda s: s.key_frame, 'key frame')
    states = self.publisher('grid/state', GridState)
    for changes, reason in ((dict(revision=9), 'revision 9 does not come'), (dict(session=5), 'of session 5')):
      # Topics are not ordered among each other, so the renderer first waits for the topology.
      def warned():
        states.publish(changed(good, changes))
        rospy.rostime.wallsleep(0.2)
        return self.warned('renderer', 'grid/state', reason)

      graph.wait_until(warned, 'warning that ' + reason)
    self.assertTrue((pixels(before) == pixels(self.lookAgain())).all())

  def refuses(self, topic, good, damages, last_reason):
    publisher = self.publisher(topic, type(good))
    for damage in damages:
      publisher.publish(changed(good, damage))
    self.wait_for_refusals('renderer', topic, len(damages), last_reason)


def area(stats):
  return stats.updated_width * stats.updated_height


def serialized(message):
  buffer = io.BytesIO()
  message.serialize(buffer)
  return buffer.getvalue()


def unreadable(message, content):
  """A message of this type whose bytes on the wire are `content`."""

  class Unreadable(type(message)):

    def serialize(self, buffer):
      buffer.write(content)

  return Unreadable()


def changed(message, changes):
  result = copy.deepcopy(message)
  for field, value in changes.items():
    setattr(result, field, value)
  return result


def nanPoint():
  return Point32(float('nan'), 0, 0)


if __name__ == '__main__':
  graph.run('rendering_graph_test')
