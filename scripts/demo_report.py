#!/usr/bin/python3
"""Makes pictures, video, contact sheet and summary from a demo's bag and its replay. A part of scripts/demo.

Reads DIR/demo.bag and DIR/replay.json; writes DIR/frames/CAMERA_STEP.png, DIR/demo.mp4, DIR/contact_sheet.png and
DIR/summary.json. Exits with 1 when the replay was not identical, when it did not compare every published frame with a
full redraw of the same state, or when something could not be made.
"""

import argparse
import hashlib
import json
import math
import os
import statistics
import subprocess
import sys

import rosbag
from PIL import Image, ImageDraw, ImageFont

FONT = "/usr/share/fonts/truetype/dejavu/DejaVuSans.ttf"
VIDEO_RATE_HZ = 10
PAUSE_S = 0.5  # a longer pause parts two strokes, or two pokes


class Failure(Exception):
    pass


class Frame:
    """An image of the bag, kept as a file once it is written."""

    def __init__(self, message, camera, stats):
        self.time_s = message.header.stamp.to_sec()
        self.camera = camera
        self.step, self.revision = (stats.step, stats.revision) if stats else (0, 0)
        self.size = (message.width, message.height)
        self.path = None
        self.digest = hashlib.sha256(bytes(message.data)).digest()

    def rgb(self):
        return Image.open(self.path).convert("RGB")


def write_frames(bag, folder, stats):
    """Writes every image; `stats` maps (camera, stamp) to the render/stats of it."""
    os.makedirs(folder, exist_ok=True)
    topics = [topic for topic in bag.get_type_and_topic_info().topics if topic.endswith("/image_raw")]
    total = sum(bag.get_message_count(topic) for topic in topics)
    frames = []
    for topic, message, _ in bag.read_messages(topics=topics):
        camera = topic.rsplit("/", 2)[-2]
        if message.encoding != "rgb8" or len(message.data) != 3 * message.width * message.height:
            raise Failure(f"{topic} has an image that is not rgb8")
        frame = Frame(message, camera, stats.get((camera, message.header.stamp)))
        frame.path = os.path.join(folder, f"{camera}_{frame.step:08d}.png")
        Image.frombytes("RGB", frame.size, bytes(message.data)).save(frame.path, compress_level=3)
        frames.append(frame)
        show("frames", len(frames), total)
    return sorted(frames, key=lambda frame: (frame.camera, frame.time_s))


def show(what, done, total):
    if sys.stdout.isatty():
        print(f"\r  {what}: {done} of {total}   ", end="\n" if done == total else "", flush=True)
    elif done == total:
        print(f"  {what}: {done}", flush=True)


def write_video(frames, path):
    """At the speed of simulated time: every picture of the video shows the newest frame of its moment."""
    width, height = frames[0].size
    command = ["ffmpeg", "-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}",
               "-r", str(VIDEO_RATE_HZ), "-i", "-", "-c:v", "libx264", "-crf", "20",
               "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p", path]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as ffmpeg:
        count = 1 + int((frames[-1].time_s - frames[0].time_s) * VIDEO_RATE_HZ)
        shown, pixels = 0, frames[0].rgb().tobytes()
        for n in range(count):
            moment = frames[0].time_s + n / VIDEO_RATE_HZ + 1e-6
            newest = shown
            while newest + 1 < len(frames) and frames[newest + 1].time_s <= moment:
                newest += 1
            if newest != shown:
                shown, pixels = newest, frames[newest].rgb().tobytes()
            ffmpeg.stdin.write(pixels)
        ffmpeg.stdin.close()
    if ffmpeg.returncode != 0:
        raise Failure("ffmpeg could not make the video")


class Run:
    """What the messages of a bag say about the run; times are stamps, in simulated seconds."""

    def __init__(self, bag):
        self.stats = self.messages(bag, "/simulation/stats")
        self.render_stats = self.messages(bag, "/render/stats")
        cuts = self.messages(bag, "/tool/cut")
        blades = {m.tool_id for m in cuts}
        # A blade that is only lifted cuts nothing.
        self.strokes = episodes([m.header.stamp.to_sec() for m in cuts if m.quads])
        self.forces = [(m.header.stamp.to_sec(), math.hypot(m.force.x, m.force.y, m.force.z), m.tool_id)
                       for m in self.messages(bag, "/tool/force")]
        self.pokes = episodes([time_s for time_s, force_n, tool in self.forces if force_n > 0.0 and tool not in blades])
        if not self.stats:
            raise Failure("the bag has no simulation/stats")

    @staticmethod
    def messages(bag, topic):
        return [message for _, message, _ in bag.read_messages(topics=[topic])]

    def real_time_factor(self):
        """Simulated time over wall time, of the time in which the simulation ran."""
        simulated = wall = 0.0
        for before, after in zip(self.stats, self.stats[1:]):
            if after.real_time_factor > 0.0 and not before.paused:
                simulated += after.simulation_time - before.simulation_time
                wall += (after.simulation_time - before.simulation_time) / after.real_time_factor
        return simulated / wall if wall > 0.0 else 0.0

    def hardest_time_s(self, poke):
        """When the tool pushed most."""
        begin_s, end_s = poke
        return max((force_n, time_s) for time_s, force_n, _ in self.forces if begin_s <= time_s <= end_s)[1]


def episodes(times_s):
    """(begin, end) of what happened without a pause of PAUSE_S."""
    found = []
    for time_s in times_s:
        if found and time_s - found[-1][1] < PAUSE_S:
            found[-1][1] = time_s
        else:
            found.append([time_s, time_s])
    return found


def nearest(frames, time_s):
    return min(frames, key=lambda frame: abs(frame.time_s - time_s))


def last_until(frames, time_s):
    return max((frame for frame in frames if frame.time_s <= time_s), key=lambda frame: frame.time_s, default=frames[0])


def choose_moments(run, frames):
    """(caption, frame) of what happened, in order; a run that ends early has fewer."""
    strokes = [stroke for stroke in run.strokes if cuts(stroke, frames)]
    events = sorted([(poke, True) for poke in run.pokes] + [(stroke, False) for stroke in strokes])
    starts_s = [event[0] for event, _ in events] + [math.inf]
    moments = [("before", last_until(frames, starts_s[0]))]
    for n, ((begin_s, end_s), is_poke) in enumerate(events):
        if is_poke:
            moments.append(("poked", nearest(frames, run.hardest_time_s((begin_s, end_s)))))
        else:
            moments.append(("cut", during_cut([frame for frame in frames if begin_s <= frame.time_s <= end_s] or frames)))
        if frames[-1].time_s > end_s:
            moments.append(("released" if is_poke else "opened", last_until(frames, starts_s[n + 1])))
    return moments


def cuts(stroke, frames):
    """Whether a stroke met tissue: a blade on its way to it sends sweeps, too."""
    begin_s, end_s = stroke
    after = next((frame for frame in frames if frame.time_s >= end_s), frames[-1])
    return after.revision > last_until(frames, begin_s).revision


def during_cut(frames):
    """Every cut that meets tissue makes a new revision of the grid: the frame with three quarters of them."""
    wanted = frames[0].revision + 0.75 * (frames[-1].revision - frames[0].revision)
    return min(frames, key=lambda frame: abs(frame.revision - wanted))


def write_sheet(moments, start_s, path):
    width, height = moments[0][1].size
    bar, gap = 34, 6
    font = ImageFont.truetype(FONT, 20)
    columns = min(3, len(moments))
    rows = -(-len(moments) // columns)
    sheet = Image.new("RGB", (columns * (width + gap) + gap, rows * (height + bar + gap) + gap), "white")
    draw = ImageDraw.Draw(sheet)
    for n, (caption, frame) in enumerate(moments):
        x, y = gap + (n % columns) * (width + gap), gap + (n // columns) * (height + bar + gap)
        sheet.paste(frame.rgb(), (x, y))
        draw.text((x + 4, y + height + 4), f"{caption}, {frame.time_s - start_s:.1f} s", fill="black", font=font)
    sheet.save(path)


def frames_published(run):
    """As the renderer counts them, frames of which nothing was recorded included."""
    drawn = {message.camera: message for message in run.render_stats}
    return sum(m.frames_published for m in drawn.values()), sum(m.frames_skipped for m in drawn.values())


def drawn_in_part(run):
    """Frames that the renderer made from the frame before: what the comparison with full redraws is about."""
    whole = {}
    for m in run.render_stats:
        whole[m.camera] = max(whole.get(m.camera, 0), m.updated_width * m.updated_height)
    return sum(m.updated_width * m.updated_height < whole[m.camera] for m in run.render_stats)


def not_compared(published, recorded, replay):
    """Why not every published frame is known to equal the full redraw of its state; empty when every one is."""
    compared = replay["frames"] - replay["frames_by_psnr"]
    reasons = []
    if published == 0 or compared != published:
        reasons.append(f"{published} frames were published and {compared} compared byte for byte")
    if recorded != published:
        reasons.append(f"{published} frames were published and {recorded} images recorded")
    for key, meaning in (("frames_without_image", "frames have no image"),
                         ("images_without_stats", "images have no render/stats that says what they show")):
        if replay[key] > 0:
            reasons.append(f"{replay[key]} {meaning}")
    return reasons


def summarize(run, bag, frames, replay):
    last = run.stats[-1]
    duration_s = last.simulation_time
    published, skipped = frames_published(run)
    ran = [m for m in run.stats if m.step_ms_median > 0.0]
    return {
        "seconds": duration_s,
        "sim_steps": last.step,
        "dt_s": last.dt,
        "cells": last.cells,
        "vertices": last.vertices,
        "active_cells_max": last.active_cells_max,
        "real_time_factor": round(run.real_time_factor(), 4),
        "step_ms_median": round(statistics.median(m.step_ms_median for m in ran), 4) if ran else 0.0,
        "states_published": last.states_published,
        "frames_published": published,
        "frames_skipped": skipped,
        "frames_recorded": len(frames),
        "frames_compared": replay["frames"] - replay["frames_by_psnr"],
        "frames_drawn_in_part": drawn_in_part(run),
        "frames_not_compared": not_compared(published, len(frames), replay),
        "distinct_frames": len({frame.digest for frame in frames}),
        "frame_size": list(frames[0].size),
        "slices": max(m.slices for m in run.render_stats),
        "render_ms_median": round(statistics.median(m.total_ms for m in run.render_stats), 2),
        "renderer": run.render_stats[-1].renderer,
        "max_displacement_m": last.max_displacement_ever,
        "max_tool_force_n": max((force_n for _, force_n, _ in run.forces), default=0.0),
        "cut_opening_m": last.cut_opening_max,
        "inputs_applied": last.inputs_applied,
        "inputs_refused": last.inputs_refused,
        "device_rate_hz": round(bag.get_message_count("/measured_cp") / duration_s, 1) if duration_s > 0.0 else 0.0,
        "bag_bytes": os.path.getsize(bag.filename),
        "replay_identical": bool(replay["identical"]) and not replay.get("error"),
    }


def print_summary(summary, replay, moments, folder):
    s = summary
    print(f"""
  Simulation  {s['seconds']:g} s in {s['sim_steps']} steps of {1000 * s['dt_s']:g} ms at {s['real_time_factor']:.2f} of real time;
              {s['cells']} cells, at most {s['active_cells_max']} active, {s['step_ms_median']:.2f} ms a step
  Tissue      moved by up to {1000 * s['max_displacement_m']:.1f} mm under {s['max_tool_force_n']:.2f} N; the cut opened by {1000 * s['cut_opening_m']:.1f} mm
  Frames      {s['frames_published']} drawn ({s['distinct_frames']} differ), {s['frames_skipped']} skipped; {s['slices']} slices, {s['render_ms_median']:.0f} ms each
  Compared    {s['frames_compared']} of {s['frames_published']} published frames with full redraws of the same states, byte for byte;
              {s['frames_drawn_in_part']} of them had been drawn in part
  Device      {s['device_rate_hz']:.0f} poses per simulated second
  Bag         {s['bag_bytes'] / 1e6:.0f} MB; replayed: {'identical' if s['replay_identical'] else 'NOT IDENTICAL'}

Look at:
  {os.path.join(folder, 'contact_sheet.png')}   ({', '.join(caption for caption, _ in moments)})
  {os.path.join(folder, 'demo.mp4')}
  {os.path.join(folder, 'report.html')}
  {os.path.join(folder, 'frames')}
  {os.path.join(folder, 'summary.json')}
  {os.path.join(folder, 'demo.bag')}""")
    if not s["replay_identical"]:
        print(f"\nreplay: {replay.get('error') or json.dumps(replay.get('first_difference'))}", file=sys.stderr)
    for reason in s["frames_not_compared"]:
        print(f"\nnot every frame was compared with a full redraw: {reason}", file=sys.stderr)


def report(folder):
    with open(os.path.join(folder, "replay.json"), encoding="utf-8") as file:
        replay = json.load(file)
    with rosbag.Bag(os.path.join(folder, "demo.bag")) as bag:
        run = Run(bag)
        stats = {(m.camera, m.header.stamp): m for m in run.render_stats}
        frames = write_frames(bag, os.path.join(folder, "frames"), stats)
        if not frames:
            raise Failure("the bag has no frame")
        summary = summarize(run, bag, frames, replay)
    shown = [frame for frame in frames if frame.camera == frames[0].camera]
    write_video(shown, os.path.join(folder, "demo.mp4"))
    moments = choose_moments(run, shown)
    start_s = run.stats[-1].header.stamp.to_sec() - run.stats[-1].simulation_time
    write_sheet(moments, start_s, os.path.join(folder, "contact_sheet.png"))
    with open(os.path.join(folder, "summary.json"), "w", encoding="utf-8") as file:
        json.dump(summary, file, indent=2)
        file.write("\n")
    print_summary(summary, replay, moments, folder)
    return 0 if summary["replay_identical"] and not summary["frames_not_compared"] else 1


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", metavar="DIR", help="folder with demo.bag and replay.json")
    try:
        return report(parser.parse_args().folder)
    except (Failure, OSError, ValueError, KeyError, rosbag.ROSBagException) as error:
        print(f"demo: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
