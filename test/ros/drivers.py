"""Messages of drivers' packages that are not installed here, made from their definitions as a driver has them."""

import os

import genmsg
import genmsg.gentools
import genmsg.msg_loader
import genpy.dynamic
import rospkg

DEVICES = os.path.join(rospkg.RosPack().get_path('soft_volume'), 'config', 'devices')

# As the drivers' packages write them, comments and all.
_TEXTS = {
    'omni_msgs/OmniState': '''std_msgs/Header         header

bool                    locked

bool                    close_gripper

geometry_msgs/Pose      pose        # meters

geometry_msgs/Vector3   current     # Amperes

geometry_msgs/Vector3   velocity    # meters/s
''',
    'omni_msgs/OmniFeedback': '''# This is the force as estimated from the applied torques as well as the
# current end effector position of the robot arm
geometry_msgs/Vector3  force
geometry_msgs/Vector3  position
''',
    'omni_msgs/OmniButtonEvent': 'int32 grey_button\nint32 white_button\n',
    'crtk_msgs/operating_state': '''#
# Standard states include DISABLED, ENABLED, PAUSED and FAULT
#
Header  header
string  state
bool    is_homed
bool    is_busy
''',
    'crtk_msgs/StringStamped': 'std_msgs/Header header\nstring\t        string\n',
}


def _load(name, text):
  """genmsg's view of a type: its checksum, and its full text with the types in it."""
  context = genmsg.MsgContext.create_default()
  paths = {p: [os.path.join(rospkg.RosPack().get_path(p), 'msg')] for p in ('std_msgs', 'geometry_msgs')}
  spec = genmsg.msg_loader.load_msg_from_string(context, text, name)
  genmsg.msg_loader.load_depends(context, spec, paths)
  return genmsg.gentools.compute_md5(context, spec), genmsg.gentools.compute_full_text(context, spec)


def checksum(name):
  return _load(name, _TEXTS[name])[0]


def message_class(name, text=None):
  """A class of messages as genpy would have generated it from the text."""
  _, full = _load(name, text or _TEXTS[name])
  return genpy.dynamic.generate_dynamic(name, full)[name]


OmniState = message_class('omni_msgs/OmniState')
OmniFeedback = message_class('omni_msgs/OmniFeedback')
OmniButtonEvent = message_class('omni_msgs/OmniButtonEvent')
OperatingState = message_class('crtk_msgs/operating_state')
StringStamped = message_class('crtk_msgs/StringStamped')


def device_file(name):
  return os.path.join(DEVICES, name + '.yaml')


def announced(listener):
  """Name, checksum and definition by which the publisher of an AnyMsg listener announces its messages."""
  header = listener.wait()._connection_header
  return header['type'], header['md5sum'], header['message_definition']

