#!/usr/bin/env python3
"""Replaces the generated parts of doc/simulation.md by the results of scripts/measure_simulation.

Usage: simulation_page.py RESULTS PAGE

RESULTS holds validate.json, plots/, tradeoff/simulation.md and .png, and benchmark/benchmark.json. In PAGE everything
between the comments 'begin NAME' and 'end NAME' is replaced; plots go to images/simulation beside PAGE. Nothing is
written when a result or a part of the page is missing.

Exit code: 0 when every bound holds and every number is reached, 1 when one is not, 2 when the page cannot be made.
"""
import os
import re
import sys

import benchmark_report
from page import PageError, goals, machine, number, percent, read_json, run, table, tradeoff_section

# Plots that the page shows, by their place in the results. One that a skipped suite did not draw stays as it is.
IMAGES = [("tradeoff/simulation.png", "tradeoff.png"), ("plots/cantilever_error.png", "cantilever_error.png"),
          ("plots/truth_cube_10mm.png", "truth_cube_10mm.png"), ("plots/free_vibration.png", "free_vibration.png"),
          ("plots/extremes_deformations.png", "extremes_deformations.png")]

MEMORY_CASES = [("float", "float"), ("float, nu 0.45", "float_nu_0.45"), ("double", "double"),
                ("double, nu 0.45", "double_nu_0.45")]
STEP_VARIANTS = [("oracle", "oracle"), ("float", "float"), ("float, no guard", "float_unguarded"),
                 ("float, nu 0.45", "float_nu_0.45"), ("double", "double"),
                 ("float, folding everywhere", "float_violent"), ("float, 2 threads", "float_2_threads")]


# -------------------------------------------------------------------------------------------------------- known answers

class Validation:
    """The rows of soft_volume_validate."""

    def __init__(self, path):
        results = read_json(path)
        self.rows, self.skipped = results["rows"], results["skipped"]

    def matching(self, suite, pattern):
        """Rows whose case matches from its start, with the match."""
        for row in self.rows:
            match = re.match(pattern, row["case"])
            if row["suite"] == suite and match:
                yield row, match

    @property
    def failed(self):
        return [row for row in self.rows if not row["pass"]]


def summary(validation):
    bounded = [row for row in validation.rows if row["bound"] is not None]
    text = f"{len(validation.rows)} numbers, {len(bounded)} of them with a bound, {len(validation.failed)} beyond it."
    for row in validation.failed:
        text += f"\n- **Beyond its bound:** {row['suite']}, {row['case']}: {number(row['error'])} instead of " \
                f"at most {number(row['bound'])}"
    for skipped in validation.skipped:
        text += f"\n- **Skipped:** {skipped}"
    return text


def patch(validation):
    worst = {}
    for row, match in validation.matching("patch", r"nu ([\d.]+), .*: (E|nu|G)\b"):
        worst.setdefault(match[1], {"E": 0.0, "nu": 0.0, "G": 0.0})
        worst[match[1]][match[2]] = max(worst[match[1]][match[2]], row["error"])
    return table(["nu", "E off by at most", "nu", "G"],
                 [[nu, *(number(error, 2) for error in errors.values())] for nu, errors in worst.items()])


def cantilever(validation):
    by_cells = {}
    for row, match in validation.matching("cantilever", r"(end load|own weight), (\d+) across: of Timo"):
        by_cells.setdefault(match[2], {})[match[1]] = row["value"]
    return table(["cells across", "end load: deflection / Timoshenko's", "own weight"],
                 [[cells, number(of.get("end load")), number(of.get("own weight"))] for cells, of in by_cells.items()])


def with_bound(rows):
    return [[match[1], number(row["value"], 4), number(row["reference"], 4), percent(row["error"]),
             percent(row["bound"]), verdict(row)] for row, match in rows]


def verdict(row):
    return "" if row["bound"] is None else "yes" if row["pass"] else "**no**"


def elastica(validation):
    return table(["load", "tip deflection / L", "elastica", "off by", "bound", "holds"],
                 with_bound(validation.matching("cantilever", r"elastica, (.*, \d+ across): tip")))


def half_space(validation):
    return table(["case", "centre, um", "exact", "off by", "bound", "holds"],
                 with_bound(validation.matching("half_space", r"(.*): centre")))


def truth_cube(validation):
    rows = [[match[1], match[2], f"{row['value']:.2f}", f"{row['reference']:.2f}"]
            for row, match in validation.matching("truth_cube", r"(h .*), state (\d): RMS")]
    return table(["lattice", "state", "RMS of 245 beads, mm", "of a linear guess"], rows)


def free_vibration(validation):
    by_rule = {}
    for row, match in validation.matching("free_vibration", r"bar 8x2x2, (\w+): (period|energy left of)"):
        by_rule.setdefault(match[1], {})[match[2]] = row
    return table(["integrator", "error of the period", "energy left"],
                 [[f"`{rule}`", number(rows["period"]["error"], 2), number(rows["energy left of"]["value"], 6)]
                  for rule, rows in by_rule.items()])


def indentation(validation):
    rows = []
    pattern = r"(nu [\d.]+), (\S+), (1997's fixed \S+|grown): (stiff|depth)"
    for row, match in validation.matching("indentation", pattern):
        stiffness = row["value"] if match[4] == "stiff" else row["reference"] / row["value"]
        cells = match[3].replace("1997's fixed", "a fixed neighbourhood of")
        rows.append([match[1], match[2], cells, percent(stiffness - 1.0)])
    return table(["tissue", "lattice", "cells in the solve", "too stiff by"], rows)


def extremes(validation):
    rows = []
    for row, match in validation.matching("extremes", r"(.*)"):
        if "always: runs" in match[1]:
            continue
        has_width = "least width" in match[1]
        bound = "> 0" if has_width else "" if row["bound"] is None else number(row["bound"])
        dissertation = number(row.get("dissertation")) if "dissertation" in row else ""
        rows.append([match[1], number(row["value"]), bound, dissertation, verdict(row)])
    return table(["case", "ours", "bound", "the dissertation's rule", "holds"], rows)


def always(validation):
    runs = list(validation.matching("extremes", r".*always: runs with a value"))
    bits = list(validation.matching("extremes", r".*always: runs with other bits"))
    return (f"Over all of them, runs of ours with a value that is not finite: "
            f"{sum(row['value'] for row, _ in runs):.0f}; runs whose bits differ when repeated with another number of "
            f"threads: {sum(row['value'] for row, _ in bits):.0f}.")


# -------------------------------------------------------------------------------------------------------- speed, memory

def milliseconds(medians, case):
    try:
        return number(medians.time(case) / 1e3)
    except KeyError:
        return ""


def steps(medians):
    sizes = sorted({name.split("/")[2] for name in medians.rows if name.startswith("simulation/step/")}, key=int)
    return table(["cells", *(title for title, _ in STEP_VARIANTS)],
                 [[f"{int(size):,}", *(milliseconds(medians, f"simulation/step/{size}/{v}") for _, v in STEP_VARIANTS)]
                  for size in sizes])


def integrators(medians):
    rows = []
    for name in sorted((name for name in medians.rows if name.startswith("simulation/integrator/")), key=medians.time):
        dt_us = medians.counter(name, "dt_us")
        rows.append([f"`{name.split('/')[3]}`", number(dt_us / 1e3), milliseconds(medians, name),
                     number(1e3 * medians.time(name) / dt_us)])
    return table(["integrator", "dt, ms", "ms a step", "ms per simulated second"], rows)


def memory(medians):
    prefix = max((name.rsplit("/", 1)[0] for name in medians.rows if name.startswith("simulation/memory/")),
                 key=lambda name: int(name.split("/")[2]), default="")
    cases = [(title, medians.rows[f"{prefix}/{case}"]) for title, case in MEMORY_CASES
             if f"{prefix}/{case}" in medians.rows]
    if not cases:
        raise PageError("the benchmark has no case of memory")

    def per_vertex(row, counter):
        total = sum(value for key, value in row.items() if key.startswith("bytes: "))
        return row[counter] * row["bytes_per_vertex"] / total

    counters = [key for key in cases[0][1] if key.startswith("bytes: ") and any(row[key] > 0 for _, row in cases)]
    rows = [[counter[7:], *(f"{per_vertex(row, counter):.0f}" for _, row in cases)] for counter in counters]
    rows.append(["**all**", *(f"**{row['bytes_per_vertex']:.0f}**" for _, row in cases)])
    return table([f"bytes a vertex, {int(prefix.split('/')[2]):,} cells", *(title for title, _ in cases)], rows)


# ---------------------------------------------------------------------------------------------------------------- page

def make_parts(results):
    """The text of every generated part, and whether all bounds hold."""
    validation = Validation(os.path.join(results, "validate.json"))
    with open(os.path.join(results, "tradeoff", "simulation.md"), encoding="utf-8") as file:
        tradeoff = file.read()
    benchmark = read_json(os.path.join(results, "benchmark", "benchmark.json"))
    medians = benchmark_report.Medians(benchmark)
    of_validation = [summary, patch, cantilever, elastica, half_space, free_vibration, indentation, extremes, always]
    parts = {make.__name__: make(validation) for make in of_validation}
    parts["truth_cube"] = None if any("truth_cube" in text for text in validation.skipped) else truth_cube(validation)
    for name, title in [("choose", "What to choose"), ("scene", "The scene"), ("spacing", "Lattice spacing"),
                        ("stepping", "Integrator and step"), ("active_set", "Active set"),
                        ("precision", "Float or double"), ("presets", "Presets of the scene file"),
                        ("dissertation", "The dissertation's method")]:
        parts[name] = tradeoff_section(tradeoff, title)
    parts["machine"] = machine(benchmark["context"])
    parts["goals"], reached = goals(medians)
    parts["steps"], parts["integrators"], parts["memory"] = steps(medians), integrators(medians), memory(medians)
    return parts, reached and not validation.failed


if __name__ == "__main__":
    sys.exit(run(__doc__, "scripts/measure_simulation", make_parts, IMAGES, "simulation"))
