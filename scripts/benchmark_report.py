#!/usr/bin/env python3
"""Prints what a run of soft_volume_benchmark says: the medians, and how they compare with the numbers to reach.

Usage: benchmark_report.py BENCHMARK.json

Exit code: 0 when every number is reached, 1 when one is not, 2 when the file cannot be read.
"""
import json
import sys

STEP = "simulation/step/"
ACTIVE = "simulation/active_500_of/"
UNUSED = "simulation/unused/32768/"
SMALL, LARGE = str(16**3), str(128**3)


class Medians:
    """Median time in microseconds and counters by case. Raises KeyError for a case that did not run."""

    def __init__(self, results):
        self.rows = {}
        for row in results["benchmarks"]:
            if row.get("aggregate_name") == "median":
                self.rows[row["run_name"]] = row

    def time(self, name):
        """Of the thread for one thread, so that other programs matter less; of the clock for several."""
        row = self.rows[name]
        return row["real_time"] if "_threads" in name else row["cpu_time"]

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


# What is measured, how, the bound, whether it is a lower bound, and the unit (% for fractions).
GOALS = [
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
    ("unused volume energy: cost", unused_cost("volume_energy"), 0.01, False, "%"),
    ("unused second integrator: cost", unused_cost("second_integrator"), 0.01, False, "%"),
]


def text(value, unit):
    return f"{100.0 * value:.1f} %" if unit == "%" else f"{value:.3g} {unit}".strip()


def print_goals(medians):
    """Returns whether every number that could be computed is reached."""
    print("| what | measured | to reach | |\n|---|---|---|---|")
    reached = True
    for what, measure, bound, at_least, unit in GOALS:
        try:
            value = measure(medians)
        except KeyError:
            continue
        good = value >= bound if at_least else value <= bound
        reached = reached and good
        sign = ">=" if at_least else "<="
        print(f"| {what} | {text(value, unit)} | {sign} {text(bound, unit)} | {'yes' if good else '**no**'} |")
    return reached


def print_medians(medians):
    print("\n| case | median, us | bytes a vertex |\n|---|---|---|")
    for name, row in medians.rows.items():
        memory = row.get("bytes_per_vertex")
        print(f"| `{name}` | {medians.time(name):.4g} | {'' if memory is None else f'{memory:.0f}'} |")


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
