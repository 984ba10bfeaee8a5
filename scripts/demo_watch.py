#!/usr/bin/python3
"""Waits until the demo's graph is complete, lets the paused simulation go, and shows how far it is until it ends.

A part of scripts/demo, in its ROS environment. Exits with 1 when a process ends too early or nothing moves.
"""

import argparse
import os
import sys
import time

import rosgraph
import rospy
import yaml
from std_srvs.srv import SetBool

from soft_volume.msg import RecorderStatus, RenderStats, Scene, SimulationStats

TOPICS = ["/scene", "/volume", "/grid/topology", "/grid/state", "/simulation/journal", "/simulation/stats",
          "/tool/force", "/tool/cut", "/tool/state", "/measured_cp", "/measured_cv", "/joy", "/servo_cf", "/render/stats"]
# Links that have to stand before the first step, beside those to the recorder.
LINKS = [("/tool/force", "/simulation"), ("/tool/state", "/simulation"), ("/measured_cp", "/tool"),
         ("/servo_cf", "/device"), ("/grid/state", "/renderer"), ("/scene", "/renderer"), ("/grid/patch", "/tool")]
START_LIMIT_S = 120.0
STALL_LIMIT_S = 60.0


class Failure(Exception):
    pass


def alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as stat:
            return stat.read().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


class Watch:
    def __init__(self, options):
        self.options = options
        self.master = rosgraph.Master(rospy.get_name())
        self.newest = {}
        self.begin = time.monotonic()
        self.printed = 0.0
        for topic, kind in (("scene", Scene), ("simulation/stats", SimulationStats), ("render/stats", RenderStats),
                            ("recorder/status", RecorderStatus)):
            rospy.Subscriber(topic, kind, self.hear, topic)

    def hear(self, message, topic):
        self.newest[topic] = message

    def check_alive(self):
        if not alive(self.options.recorder):
            raise Failure("the recorder ended")
        status = self.newest.get("recorder/status")
        if status is not None and not status.recording:
            raise Failure("the recorder stopped: " + status.stop_reason)

    def missing(self):
        """What the graph still lacks, as text; empty when it is complete."""
        publishers, subscribers, _ = self.master.getSystemState()
        publishers, subscribers = dict(publishers), dict(subscribers)
        scene = self.newest.get("scene")
        if scene is None:
            return "the simulation"
        cameras = yaml.safe_load(scene.yaml)["rendering"]["cameras"]
        for topic in TOPICS + [f"/{camera['name']}/image_raw" for camera in cameras]:
            if topic not in publishers:
                return "a publisher of " + topic
            if "/recorder" not in subscribers.get(topic, []):
                return "the recorder's subscription to " + topic
        for topic, node in LINKS:
            if node not in subscribers.get(topic, []):
                return f"{node}'s subscription to {topic}"
        return "" if "recorder/status" in self.newest else "the recorder"

    def wait_until_complete(self):
        while True:
            self.check_alive()
            if not alive(self.options.launch):
                raise Failure("a node ended")
            missing = self.missing()
            if not missing:
                break
            if time.monotonic() - self.begin > START_LIMIT_S:
                raise Failure(f"still missing after {START_LIMIT_S:.0f} s: {missing}")
            time.sleep(0.3)
        time.sleep(1.5)  # the master knows of a link a little before its connection stands

    def let_go(self):
        rospy.wait_for_service("simulation/pause", 10.0)
        if not rospy.ServiceProxy("simulation/pause", SetBool)(False).success:
            raise Failure("the simulation does not leave its pause")
        self.begin = time.monotonic()

    def time_done(self):
        stats = self.newest.get("simulation/stats")
        return 0.0 if stats is None else stats.simulation_time

    def show(self, done):
        now = time.monotonic()
        terminal = sys.stdout.isatty()
        if done <= 0.0 or now - self.printed < (0.5 if terminal else 5.0):
            return
        self.printed = now
        left = (now - self.begin) * (self.options.seconds - done) / done
        render = self.newest.get("render/stats")
        stats = self.newest["simulation/stats"]
        text = (f"  {done:5.1f} of {self.options.seconds:g} s simulated, about {left:3.0f} s left; "
                f"{stats.max_displacement * 1000:4.1f} mm, {render.frames_published if render else 0} frames")
        print(f"\r{text:<78}" if terminal else text, end="" if terminal else "\n", flush=True)

    def follow(self):
        last, moved = 0.0, time.monotonic()
        while alive(self.options.launch):
            self.check_alive()
            done = self.time_done()
            if done > last:
                last, moved = done, time.monotonic()
            elif time.monotonic() - moved > STALL_LIMIT_S:
                raise Failure(f"nothing moved for {STALL_LIMIT_S:.0f} s")
            self.show(done)
            time.sleep(0.2)
        if sys.stdout.isatty():
            print()
        if self.time_done() < self.options.seconds - 1e-6:
            raise Failure(f"the simulation ended after {self.time_done():.2f} of {self.options.seconds:g} s")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, required=True, help="simulated seconds until the end")
    parser.add_argument("--recorder", type=int, required=True, metavar="PID")
    parser.add_argument("--launch", type=int, required=True, metavar="PID")
    options = parser.parse_args()
    os.environ.pop("ROS_NAMESPACE", None)
    rospy.init_node("demo_watch", disable_signals=True)
    try:
        watch = Watch(options)
        watch.wait_until_complete()
        watch.let_go()
        watch.follow()
    except (Failure, rospy.ROSException, rospy.ServiceException, rosgraph.MasterException, OSError) as error:
        print(f"demo: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # rospy's threads wait for a master that may be gone
