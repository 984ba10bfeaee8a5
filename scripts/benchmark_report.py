#!/usr/bin/env python3
"""Prints what a run of soft_volume_benchmark says: the medians, and how they compare with the numbers to reach.

Usage: benchmark_report.py BENCHMARK.json

Exit code: 0 when every number is reached, 1 when one is not, 2 when the file cannot be read.
"""
import json
import re
import sys

FIN = "render/blunt_fin/"
MRI = "render/mri_lattice/"
LINEAR = "render/linear/"
AXES = ("straight", "top")  # views along an axis of the grid, which is curved along x
STEP = "simulation/step/"
ACTIVE = "simulation/active_500_of/"
UNUSED = "simulation/unused/32768/"
SMALL, LARGE = str(16**3), str(128**3)


class Medians:
    """Median time in microseconds and counters by case. Raises KeyError for a case that did not run."""

    def __init__(self, results):
        self.rows, self.failures = {}, {}
        for row in results["benchmarks"]:
            if row.get("error_occurred"):
                self.failures[row["run_name"]] = row["error_message"]
            elif row.get("aggregate_name", "median") == "median":  # one repetition alone has no aggregates
                self.rows[re.sub("/process_time/real_time|/iterations:.*", "", row["run_name"])] = row

    def time(self, name):
        """Of the thread for one thread, so that other programs matter less; of the clock for several."""
        row = self.rows[name]
        return row["real_time"] if "_threads" in name or name.startswith("render/") else row["cpu_time"]

    def error(self, name):
        """RMSE against the exact image in 8-bit levels."""
        return self.rows[name]["error_levels"]

    def matching(self, pattern):
        """Matches of all names that fit; KeyError where there is none."""
        found = [match for match in (re.fullmatch(pattern, name) for name in self.rows) if match]
        if not found:
            raise KeyError(pattern)
        return found

    def having_both(self, pattern, variant, other):
        """Names of cases that ran as both variants; KeyError where there is none."""
        names = [match[1] for match in self.matching(f"({pattern})/{variant}") if f"{match[1]}/{other}" in self.rows]
        if not names:
            raise KeyError(pattern)
        return names

    def wall(self, name):
        return self.rows[name]["real_time"]

    def counter(self, name, counter):
        return self.rows[name][counter]


def step_ratio(slow, fast):
    return lambda m: m.time(STEP + slow) / m.time(STEP + fast)


def guard_overhead(size, variant):
    return lambda m: m.time(STEP + size + "/" + variant) / m.time(STEP + size + "/" + variant + "_unguarded") - 1.0


def unused_cost(feature):
    return lambda m: m.time(UNUSED + feature) / m.time(UNUSED + "nothing") - 1.0


def frame_ratio(slow, fast):
    return lambda m: m.time(slow) / m.time(fast)


def least_frame_ratio(pattern, slow, fast):
    """Over all cases `pattern` that ran both ways: how much longer the slow one takes."""
    def measure(m):
        return min(m.time(f"{name}/{slow}") / m.time(f"{name}/{fast}") for name in m.having_both(pattern, slow, fast))
    return measure


def largest_error(pattern):
    return lambda m: max(m.error(match[0]) for match in m.matching(pattern))


def error_beyond_gl(m):
    """How much larger native's error is than gl's at the same number of slices, at most."""
    names = m.having_both("render/blunt_fin/.*", "native", "gl")
    return max(m.error(f"{name}/native") - m.error(f"{name}/gl") for name in names)


def error_of_more_slices(variant):
    """How much an error grows when the slices are doubled, at most."""
    def measure(m):
        growth = []
        for match in m.matching(rf"(render/.*/)(\d+)(/{variant})"):
            twice = match[1] + str(2 * int(match[2])) + match[3]
            if twice in m.rows:
                growth.append(m.error(twice) - m.error(match[0]))
        return max(growth)
    return measure


def per_unit_growth(stages, unit):
    """Time of the stages per cell or polygon on a million cells over that on fewer, at most."""
    def cost(m, name):
        return sum(m.counter(name, stage) for stage in stages) / m.counter(name, unit)

    def measure(m):
        most = LINEAR + "1000000/native"
        return max(cost(m, most) / cost(m, LINEAR + cells + "/native") for cells in ("40000", "200000"))
    return measure


def polygons_off(view, slices, expected):
    return lambda m: abs(m.counter(f"{FIN}haze/{view}/{slices}/native", "polygons") / expected - 1.0)


def blunt_fin_goals():
    goals = []
    for view in ("straight", "angle"):
        for slices in (50, 100):
            case = f"{FIN}haze/{view}/{slices}/"
            name = f"blunt fin, haze, {view}, {slices} slices"
            goals.append((f"{name}: gl / native", frame_ratio(case + "gl", case + "native"), 5.0, True, ""))
            goals.append((f"{name}: gl / native with exact boundary",
                          frame_ratio(case + "gl", case + "native_boundary"), 3.0, True, ""))
    for function in ("peaks", "opaque"):
        goals.append((f"blunt fin, {function}, 50 and 100 slices, least: gl / native",
                      least_frame_ratio(f"{FIN}{function}/(?:straight|angle)/(?:50|100)", "gl", "native"), 5.0, True, ""))
    return goals


# What is measured, how, the bound, whether it is a lower bound, and the unit (% for fractions).
GOALS = blunt_fin_goals() + [
    ("blunt fin, haze, 100 slices, any direction: largest error, exact boundary",
     largest_error(FIN + "haze/.*/100/native_boundary"), 0.5, False, "levels"),
    ("blunt fin, haze, 50 slices along an axis: largest error, native",
     largest_error(f"{FIN}haze/(?:{'|'.join(AXES)})/50/native"), 0.4, False, "levels"),
    ("blunt fin, peaks, 200 slices: largest error, exact boundary",
     largest_error(FIN + "peaks/.*/200/native_boundary"), 4.0, False, "levels"),
    ("blunt fin, same slices: error of native - error of gl, at most", error_beyond_gl, 0.0, False, "levels"),
    ("twice the slices: error grows by at most, native", error_of_more_slices("native"), 0.1, False, "levels"),
    ("twice the slices: error grows by at most, exact boundary", error_of_more_slices("native_boundary"), 0.1, False,
     "levels"),
    ("blunt fin, peaks: time without skipping / with",
     least_frame_ratio(FIN + "peaks/.*", "native_noskip", "native"), 4.0, True, ""),
    ("MRI lattice, haze, 125 slices, least: gl / native",
     least_frame_ratio(MRI + "haze/.*/125", "gl", "native"), 2.5, True, ""),
    ("MRI lattice, peaks, 125 slices, least: gl / native",
     least_frame_ratio(MRI + "peaks/.*/125", "gl", "native"), 5.0, True, ""),
    ("MRI lattice, a touch: least part of the image that is drawn",
     lambda m: min(m.counter(match[0], "updated_part") for match in m.matching(MRI + ".*/incremental")), 0.08, True,
     "%"),
    ("MRI lattice, haze, a touch: time of the update / full redraw, at most",
     lambda m: 1.0 / least_frame_ratio(MRI + "haze/.*", "native", "incremental")(m), 0.2, False, ""),
    ("MRI lattice, peaks, a touch: time of the update / full redraw, at most",
     lambda m: 1.0 / least_frame_ratio(MRI + "peaks/.*", "native", "incremental")(m), 0.2, False, ""),
    ("a million cells / fewer: transform and bucket time a cell",
     per_unit_growth(("transform_ms", "bucket_ms"), "grid_cells"), 1.5, False, ""),
    ("a million cells / fewer: slice time a polygon", per_unit_growth(("slice_ms",), "polygons"), 1.5, False, ""),
    ("a million cells: peak memory of the process",
     lambda m: m.counter("render/memory/1000000/native", "peak_rss_bytes") / 2**30, 1.0, False, "GiB"),
    ("blunt fin, straight, 50 slices: polygons off 1,209 a slice", polygons_off("straight", 50, 50 * 1209), 0.0, False,
     "%"),
    ("blunt fin, angle, 50 slices: polygons off 45,463", polygons_off("angle", 50, 45463), 0.003, False, "%"),
    ("blunt fin, angle, 100 slices: polygons off 90,980", polygons_off("angle", 100, 90980), 0.003, False, "%"),
    ("3,200 cells: oracle / float, both guarded", step_ratio("3200/oracle", "3200/float"), 8.0, True, ""),
    ("32^3 cells: oracle / float, both guarded", step_ratio("32768/oracle", "32768/float"), 8.0, True, ""),
    ("3,200 cells: guarded float step", lambda m: m.time(STEP + "3200/float") / 1e3, 0.3, False, "ms"),
    ("32^3 cells: guarded float step", lambda m: m.time(STEP + "32768/float") / 1e3, 2.5, False, "ms"),
    ("3,200 cells: cost of the guard, float", guard_overhead("3200", "float"), 0.40, False, "%"),
    ("32^3 cells: cost of the guard, float", guard_overhead("32768", "float"), 0.40, False, "%"),
    ("3,200 cells, nu = 0.45: cost of the guard, float", guard_overhead("3200", "float_nu_0.45"), 0.40, False, "%"),
    ("32^3 cells, nu = 0.45: cost of the guard, float", guard_overhead("32768", "float_nu_0.45"), 0.40, False, "%"),
    ("64^3 cells: one core / two cores",
     lambda m: m.wall(STEP + "262144/float") / m.wall(STEP + "262144/float_2_threads"), 1.6, True, ""),
    ("64^3 cells, nu = 0.45: one core / two cores",
     lambda m: m.wall(STEP + "262144/float_nu_0.45") / m.wall(STEP + "262144/float_nu_0.45_2_threads"), 1.6, True, ""),
    ("512 active cells, neighbourhood: 128^3 / 16^3",
     lambda m: m.time(ACTIVE + LARGE + "/neighbourhood") / m.time(ACTIVE + SMALL + "/neighbourhood"), 1.15, False, ""),
    ("512 active cells, growth: 128^3 / 16^3",
     lambda m: m.time(ACTIVE + LARGE + "/growth") / m.time(ACTIVE + SMALL + "/growth"), 1.15, False, ""),
    ("32^3 cells: memory a vertex, float, nu = 0.45",
     lambda m: m.counter("simulation/memory/32768/float_nu_0.45", "bytes_per_vertex"), 600.0, False, "bytes"),
    ("32^3 cells: memory a vertex, double, nu = 0.45",
     lambda m: m.counter("simulation/memory/32768/double_nu_0.45", "bytes_per_vertex"), 600.0, False, "bytes"),
    ("haptic tick, patch of 500 cells: slowest kind's median",
     lambda m: max(m.counter(match[0], "median_us") for match in m.matching("tool/tick/500/.*")), 50.0, False, "us"),
    ("unused volume energy: cost", unused_cost("volume_energy"), 0.01, False, "%"),
    ("unused second integrator: cost", unused_cost("second_integrator"), 0.01, False, "%"),
]


def text(value, unit):
    return f"{100.0 * value:.1f} %" if unit == "%" else f"{value:.3g} {unit}".strip()


def print_goals(medians):
    """Returns whether every case ran and every number that could be computed is reached."""
    print("| what | measured | to reach | |\n|---|---|---|---|")
    reached = True
    for what, measure, bound, at_least, unit in GOALS:
        try:
            value = measure(medians)
        except (KeyError, ValueError):  # ValueError: max() of nothing
            continue
        good = value >= bound if at_least else value <= bound
        reached = reached and good
        sign = ">=" if at_least else "<="
        print(f"| {what} | {text(value, unit)} | {sign} {text(bound, unit)} | {'yes' if good else '**no**'} |")
    for name, message in medians.failures.items():
        print(f"\n**Failed:** `{name}`: {message}")
    return reached and not medians.failures


def print_medians(medians):
    print("\n| case | median, us | bytes a vertex | error, levels |\n|---|---|---|---|")
    for name, row in medians.rows.items():
        memory, error = row.get("bytes_per_vertex"), row.get("error_levels")
        print(f"| `{name}` | {medians.time(name):.4g} | {'' if memory is None else f'{memory:.0f}'} | "
              f"{'' if error is None else f'{error:.3g}'} |")


def print_memory(medians, case="simulation/memory/32768/float_nu_0.45"):
    row = medians.rows.get(case)
    if row is None:
        return
    print(f"\nWhat holds memory in `{case}`:\n\n| what | bytes |\n|---|---|")
    for counter, value in row.items():
        if counter.startswith("bytes: "):
            print(f"| {counter[7:]} | {value:.0f} |")


def main():
    if len(sys.argv) != 2 or sys.argv[1] in ("-h", "--help"):
        print(__doc__.strip())
        return 0 if sys.argv[1:] in (["-h"], ["--help"]) else 2
    try:
        with open(sys.argv[1], encoding="utf-8") as file:
            results = json.load(file)
        medians = Medians(results)
    except (OSError, ValueError, KeyError) as error:
        print(f"{sys.argv[1]}: not a result of soft_volume_benchmark: {error}", file=sys.stderr)
        return 2
    context = results["context"]
    print(f"{context.get('processor')}, {context['num_cpus']} cores, load {context.get('load_avg')}; "
          f"{context.get('compiler')}; {context.get('build')}\n")
    reached = print_goals(medians)
    print_medians(medians)
    print_memory(medians)
    return 0 if reached else 1


if __name__ == "__main__":
    sys.exit(main())
