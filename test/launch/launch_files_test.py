#!/usr/bin/env python3
"""Loads every launch file as roslaunch would, without starting anything: it parses with nodes and with nodelets, every
argument says what it is for, every program and nodelet exists, and every file that it names does too.

Usage: launch_files_test.py FOLDER_WITH_LAUNCH_FILES   (in the environment of the build's setup.bash)
"""

import glob
import os
import sys
import unittest
import xml.etree.ElementTree as ElementTree

import roslaunch.config
import roslaunch.core
import roslaunch.node_args
import rospkg

FOLDER = sys.argv.pop(1)
FILES = sorted(glob.glob(os.path.join(FOLDER, "*.launch")))
# Arguments without a default, and the switches that choose between parts of a file.
GIVEN = {"bag": "/tmp/a folder/with a.bag", "played": "/tmp/a folder/with a device.bag"}
DEVICES = sorted(os.path.splitext(os.path.basename(file))[0]
                 for file in glob.glob(os.path.join(FOLDER, os.pardir, "config", "devices", "*.yaml")))
SWITCHES = {"nodelets": ("true", "false"), "device": DEVICES + ["/a folder/of mine.yaml"], "virtual": ("true", "false"),
            "respawn": ("true", "false")}


def arguments_of(file):
    return {arg.get("name"): arg for arg in ElementTree.parse(file).getroot().findall("arg")}


def variants(file):
    arguments = arguments_of(file)
    given = [f"{name}:={value}" for name, value in GIVEN.items() if name in arguments]
    yield given
    for name, values in SWITCHES.items():
        if name in arguments:
            yield from (given + [f"{name}:={value}"] for value in values)


def load(file, arguments):
    return roslaunch.config.load_config_default([(file, arguments)], None, verbose=False)


def nodelet_names():
    path = os.path.join(rospkg.RosPack().get_path("soft_volume"), "nodelets.xml")
    return {cls.get("name") for cls in ElementTree.parse(path).iter("class")}


class LaunchFiles(unittest.TestCase):
    def test_there_are_some(self):
        self.assertEqual([os.path.basename(file) for file in FILES],
                         ["demo.launch", "device.launch", "record.launch", "replay.launch",
                          "replay_device.launch"])

    def test_every_argument_says_what_it_is_for(self):
        for file in FILES:
            for name, arg in arguments_of(file).items():
                with self.subTest(file=os.path.basename(file), arg=name):
                    self.assertGreater(len(arg.get("doc") or ""), 8)

    def test_every_program_exists(self):
        for file in FILES:
            for arguments in variants(file):
                config = load(file, arguments)
                self.assertGreater(len(config.nodes), 0)
                for node in config.nodes:
                    with self.subTest(file=os.path.basename(file), arguments=arguments, node=node.name):
                        self.assertTrue(roslaunch.node_args.create_local_process_args(node, None))

    def test_every_nodelet_exists(self):
        names = nodelet_names()
        loaded = [node.args.split()[1] for node in load(os.path.join(FOLDER, "demo.launch"), ["nodelets:=true"]).nodes
                  if node.args.startswith("load ")]
        self.assertGreaterEqual(len(loaded), 4)
        for name in loaded:
            self.assertIn(name, names)

    def test_the_default_scene_exists(self):
        for file in FILES:
            for name, value in ((p.key, p.value) for p in load(file, next(variants(file))).params.values()):
                if name.endswith("/scene"):
                    self.assertTrue(os.path.isfile(value), f"{name}: {value}")

    def test_a_device_is_a_name_or_a_path(self):
        for launch in ("demo.launch", "device.launch"):
            for device in DEVICES:
                with self.subTest(launch=launch, device=device):
                    config = load(os.path.join(FOLDER, launch), ["device:=" + device])
                    for node in ("tool", "device", "adapter", "teleop"):
                        self.assertTrue(os.path.isfile(config.params[f"/{node}/device"].value))
            config = load(os.path.join(FOLDER, launch), ["device:=/a folder/of mine.yaml", "virtual:=false"])
            self.assertEqual(config.params["/tool/device"].value, "/a folder/of mine.yaml")
            self.assertNotIn("/device/device", config.params)
            self.assertEqual({node.name for node in config.nodes} & {"device"}, set())

    def test_without_a_device_nothing_stands_between(self):
        config = load(os.path.join(FOLDER, "demo.launch"), [])
        self.assertEqual({node.name for node in config.nodes}, {"simulation", "renderer", "tool", "device"})
        self.assertEqual(config.params["/tool/device"].value, "")

    def test_real_devices_run_in_real_time(self):
        for virtual in (True, False):
            config = load(os.path.join(FOLDER, "demo.launch"), [f"virtual:={str(virtual).lower()}"])
            self.assertEqual(config.params["/use_sim_time"].value, virtual)
            self.assertEqual(config.params["/simulation/publish_clock"].value, virtual)

    def test_every_node_is_started_again_where_asked(self):
        for nodelets in ("true", "false"):
            for respawn in (True, False):
                config = load(os.path.join(FOLDER, "demo.launch"),
                              [f"respawn:={respawn}", f"nodelets:={nodelets}", "device:=omni", "bag:=" + GIVEN["bag"]])
                with self.subTest(nodelets=nodelets, respawn=respawn):
                    self.assertEqual({node.respawn for node in config.nodes}, {respawn})
                    self.assertEqual(bool(config.params["/simulation/resume_file"].value), respawn)
                    self.assertEqual(config.params["/adapter/stay"].value, respawn)

    def test_recording_needs_a_file(self):
        with self.assertRaises(roslaunch.core.RLException):
            load(os.path.join(FOLDER, "record.launch"), [])

    def test_a_path_with_a_space_arrives_in_one_piece(self):
        config = load(os.path.join(FOLDER, "record.launch"), ["bag:=" + GIVEN["bag"]])
        self.assertEqual(config.params["/recorder/file"].value, GIVEN["bag"])


if __name__ == "__main__":
    unittest.main(verbosity=2)
