#!/usr/bin/env python3
"""Replaces the generated parts of doc/rendering.md by the results of scripts/measure_rendering.

Usage: rendering_page.py RESULTS PAGE

RESULTS holds tradeoff/rendering.md and .png, and benchmark/benchmark.json. In PAGE everything between the comments
'begin NAME' and 'end NAME' is replaced; the plot goes to images/rendering beside PAGE. Tables of a grid that was not
measured, because its data are missing, stay as they are. Nothing is written when a result or a part of the page is
missing.

Exit code: 0 when every number is reached, 1 when one is not, 2 when the page cannot be made.
"""
import os
import sys

import benchmark_report
from page import goals, machine, number, read_json, run, table, tradeoff_section

IMAGES = [("tradeoff/rendering.png", "tradeoff.png")]

FIN = "render/blunt_fin"
STAGES = ("transform_ms", "bucket_ms", "slice_ms", "render_ms")
# Table 5.1 of the dissertation in milliseconds: view, slices, the four stages, and polygons.
DISSERTATION = [("straight", 50, (37.5, 189.9, 141.6, 434.7), 59241), ("angle", 50, (37.1, 212.2, 228.5, 327.4), 45371),
                ("straight", 100, (37.7, 191.2, 267.1, 660.1), 120900),
                ("angle", 100, (37.1, 206.4, 210.6, 653.0), 90784)]
VARIANTS = [("gl", "gl"), ("native", "native"), ("native, exact boundary", "native_boundary")]


def of_grid(make, medians, prefix):
    """A part, or None where its grid was not measured."""
    return make(medians) if any(name.startswith(prefix) for name in medians.rows) else None


# ------------------------------------------------------------------------------------------------- Table 5.1, the ratios

def stage_row(view, slices, who, stages, polygons):
    return [view, slices, who, *(number(ms) for ms in stages), number(sum(stages)), f"{polygons:,.0f}"]


def table_5_1(medians):
    rows = []
    for view, slices, stages, polygons in DISSERTATION:
        rows.append(stage_row(view, slices, "dissertation", stages, polygons))
        for title, variant in VARIANTS:
            case = f"{FIN}/haze/{view}/{slices}/{variant}"
            if case in medians.rows:
                rows.append(stage_row(view, slices, title, [medians.counter(case, stage) for stage in STAGES],
                                      medians.counter(case, "polygons")))
    return table(["view", "slices", "", "transform, ms", "bucket", "slice", "render", "total", "polygons"], rows)


def error_and_time(medians, case):
    if case not in medians.rows:
        return ["", ""]
    return [number(medians.error(case), 2), number(medians.time(case) / 1e3)]


def frames(medians, grid):
    """Error and time of every view and number of slices of a grid."""
    cases = sorted({(function, view, int(slices)) for _, name_grid, function, view, slices, variant in
                    (name.split("/") for name in medians.rows if name.startswith("render/") and name.count("/") == 5)
                    if name_grid == grid and variant == "native"})
    rows = []
    for function, view, slices in cases:
        case = f"render/{grid}/{function}/{view}/{slices}/"
        rows.append([function, view, slices,
                     *(cell for _, variant in VARIANTS for cell in error_and_time(medians, case + variant))])
    header = ["transfer function", "view", "slices"]
    for title, _ in VARIANTS:
        header += [f"{title}: error", "ms"]
    return table(header, rows)


def options(medians):
    """What each option costs, against plain native slices of the same case."""
    titles = [("native_boundary", "exact boundary"), ("native_adaptive", "adaptive"), ("native_shaded", "light"),
              ("native_noskip", "nothing skipped"), ("incremental", "update of a tenth of the image")]
    cases = sorted({name.rsplit("/", 1)[0] for name in medians.rows if name.endswith("/incremental")})
    rows = []
    for case in cases:
        plain = medians.time(case + "/native")
        ratios = [number(medians.time(f"{case}/{variant}") / plain) if f"{case}/{variant}" in medians.rows else ""
                  for variant, _ in titles]
        rows.append([*case.split("/")[1:], number(plain / 1e3), *ratios])
    return table(["grid", "transfer function", "view", "slices", "plain, ms", *(title for _, title in titles)], rows)


def exact(medians):
    rows = [[*name.split("/")[1:4], number(medians.time(name) / 1e3)] for name in sorted(medians.rows)
            if name.endswith("/all/exact")]
    return table(["grid", "transfer function", "view", "ms"], rows)


def linear(medians):
    rows = []
    for name in sorted((n for n in medians.rows if n.startswith("render/linear/")), key=lambda n: int(n.split("/")[2])):
        cells, polygons = medians.counter(name, "grid_cells"), medians.counter(name, "polygons")
        before = medians.counter(name, "transform_ms") + medians.counter(name, "bucket_ms")
        memory = medians.rows.get(name.replace("linear", "memory"), {}).get("peak_rss_bytes")
        rows.append([f"{cells:,.0f}", f"{medians.counter(name, 'slices'):.0f}", f"{polygons:,.0f}",
                     number(1e6 * before / cells), number(1e6 * medians.counter(name, "slice_ms") / polygons),
                     number(medians.time(name) / 1e3), "" if memory is None else f"{memory / 2**20:.0f} MiB"])
    return table(["cells", "slices", "polygons", "transform and bucket, ns a cell", "slice, ns a polygon", "frame, ms",
                  "peak memory"], rows)


# ---------------------------------------------------------------------------------------------------------------- page

def make_parts(results):
    """The text of every generated part, and whether all numbers are reached."""
    with open(os.path.join(results, "tradeoff", "rendering.md"), encoding="utf-8") as file:
        tradeoff = file.read()
    benchmark = read_json(os.path.join(results, "benchmark", "benchmark.json"))
    medians = benchmark_report.Medians(benchmark)
    parts = {"machine": machine(benchmark["context"]), "options": options(medians), "exact": exact(medians),
             "linear": linear(medians), "table_5_1": of_grid(table_5_1, medians, FIN)}
    for grid in ("blunt_fin", "mri_lattice", "curvilinear"):
        parts[grid] = of_grid(lambda m, grid=grid: frames(m, grid), medians, f"render/{grid}/")
    for name, title in [("choose", "What to choose"), ("scenes", "The scenes"), ("lookup", "Look-up"),
                        ("adaptive", "Adaptive or regular"), ("boundary", "Exact boundary"),
                        ("size", "Size of the image"), ("update", "Incremental or full")]:
        parts[name] = tradeoff_section(tradeoff, title)
    parts["goals"], reached = goals(medians)
    return parts, reached


if __name__ == "__main__":
    sys.exit(run(__doc__, "scripts/measure_rendering", make_parts, IMAGES, "rendering"))
