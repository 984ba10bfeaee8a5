"""What the pages doc/simulation.md and doc/rendering.md have in common: their generated parts stand between comments
'begin NAME' and 'end NAME' and are replaced by the results of a script.
"""
import contextlib
import io
import json
import os
import re
import shutil
import sys

import benchmark_report


class PageError(Exception):
    pass


def number(value, digits=3):
    return "-" if value is None else f"{value:.{digits}g}"


def percent(fraction):
    return "-" if fraction is None else f"{100.0 * fraction:.2g} %"


def table(header, rows):
    if not rows:
        raise PageError(f"no results for the table '{header[0]}'")
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def tradeoff_section(text, title):
    """A section of what soft_volume_tradeoff wrote."""
    match = re.search(rf"^## {re.escape(title)}\n\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)
    if not match:
        raise PageError(f"the trade-off has no section '{title}'")
    text = match[1].strip()
    if re.search(r"^\|(?:---\|)+$(?!\n\|)", text, re.MULTILINE):
        raise PageError(f"the table '{title}' of the trade-off has no rows")
    return text


def goals(medians):
    """The table of benchmark_report, and whether everything is reached."""
    with contextlib.redirect_stdout(io.StringIO()) as text:
        reached = benchmark_report.print_goals(medians)
    return text.getvalue().strip(), reached


def machine(context):
    build = " ".join(context.get("build", "").split())
    text = (f"Measured on {context.get('processor', 'an unknown processor')}, {context['num_cpus']} cores; compiler "
            f"{context.get('compiler')}, `{build}`.")
    load = max(context.get("load_avg") or [0.0])
    if load > 2 * context["num_cpus"] + 1:  # the benchmark before it leaves some load, too
        text += (f" **Other programs ran meanwhile (load {load:.1f}): errors and counts are right, times and their ratios "
                 "are not to be trusted until this is measured again.**")
    return text


def read_json(path):
    with open(path, encoding="utf-8") as file:
        return json.load(file)


def fill(page, parts):
    """The page with its parts replaced; those that are None stay."""
    pattern = re.compile(r"(<!-- begin (\w+) -->\n)(.*?)(<!-- end \2 -->)", re.DOTALL)
    found = [match[2] for match in pattern.finditer(page)]
    marks = len(re.findall(r"<!-- (?:begin|end) ", page))
    if sorted(found) != sorted(parts) or marks != 2 * len(found):
        differences = sorted(set(found) ^ set(parts)) or "a mark without its partner, or twice"
        raise PageError(f"the marks of the page are not the parts that there are: {differences}")
    return pattern.sub(lambda m: m[0] if parts[m[2]] is None else f"{m[1]}{parts[m[2]]}\n{m[4]}", page)


def copy_images(results, images, folder):
    """`images`: names in the results, and the names that the page calls them by."""
    os.makedirs(folder, exist_ok=True)
    for image, name in images:
        source = os.path.join(results, image)
        if os.path.exists(source):
            shutil.copyfile(source, os.path.join(folder, name))
        else:
            print(f"  {image} was not drawn; the page keeps the one that it has")


def write(path, text):
    """All or nothing: the page is in use while it is written."""
    with open(path + ".new", "w", encoding="utf-8") as file:
        file.write(text)
    os.replace(path + ".new", path)


def run(usage, script, make_parts, images, image_folder):
    """The program of a page: RESULTS PAGE. `make_parts(results)` gives the parts and whether all bounds hold; returns
    the exit code."""
    if len(sys.argv) != 3 or "--help" in sys.argv or "-h" in sys.argv:
        print(usage.strip())
        return 0 if "--help" in sys.argv or "-h" in sys.argv else 2
    results, path = sys.argv[1:]
    try:
        parts, good = make_parts(results)
        with open(path, encoding="utf-8") as file:
            page = file.read()
        text = fill(page, parts)
        copy_images(results, images, os.path.join(os.path.dirname(os.path.abspath(path)), "images", image_folder))
        write(path, text)
    except (PageError, OSError, ValueError, KeyError) as error:
        print(f"{path} is as it was: {error}\n{script} makes the results", file=sys.stderr)
        return 2
    print(f"  {path}: {len(parts)} parts" + ("" if good else "; some numbers are beyond their bounds, see there"))
    return 0 if good else 1
