"""Write the tables of the documentation from the stored results.

python benchmarks/report.py

Every block between `<!-- table: NAME -->` and `<!-- end -->` in README.md and docs/*.md is replaced.
"""

import math
import re
from functools import partial
from pathlib import Path

import numpy as np

from common import read, table, without

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
OURS = ("jaxwhisker, integrated", "jaxwhisker, closed form")
UNCHANGED = 1e-3  # relative change below which two peaks count as equal: the drive moves in steps of 0.001


def environment(name: str) -> str:
    """Machine, versions and date of a results file, in one sentence."""
    e = read(name)["environment"]
    libraries = ", ".join(f"{key} {e[key]}" for key in ("jax", "diffrax", "optimistix"))
    return f"{e['processor']}, {e['cores']} cores; Python {e['python']}, {libraries}; {e['date']}."


def whole(name: str, *hidden: str) -> str:
    """All rows of a results file without its hidden columns, and the environment."""
    return f"{table([without(row, *hidden) for row in read(name)['rows']])}\n\n{environment(name)}"


# Run time and accuracy


def work_precision() -> str:
    """Every method at every setting and batch size."""
    kept = []
    for row in read("work_precision")["rows"]:
        kept.append({
            "method": row["method"],
            "setting": row["setting"],
            "object": row["object"],
            "batch": row["batch"],
            "us per equilibrium": row["us per equilibrium"],
            "quartiles": f"{row['lower quartile']:.3g} to {row['upper quartile']:.3g}",
            "error": row["error"],
            "event error": row["event error"],
            "compile, s": row["compile, s"],
            "first call, s": row["first call, s"],
            "failed": f"{row['failed']:.0%}" if row["failed"] else None,
        })  # fmt: skip
    return f"{table(kept)}\n\n{environment('work_precision')}"


def thesis_time(error: float) -> float:
    """Time per equilibrium of the thesis's algorithm at a given error, in us.

    Interpolated between its tolerances; outside their range, the nearest one counts.
    """
    thesis = [row for row in read("work_precision")["rows"] if "thesis" in row["method"]]
    errors, times = (np.log([row[key] for row in thesis]) for key in ("error", "us per equilibrium"))
    order = np.argsort(errors)
    return float(np.exp(np.interp(np.log(error), errors[order], times[order])))


def speed_up() -> str:
    """Speed-up over the thesis's algorithm at the same error."""
    rows, kept = read("work_precision")["rows"], []
    most = max(row["batch"] for row in rows)
    for row in rows:
        if row["method"] in OURS and row["object"] == "parabola" and row["batch"] in (1, most):
            kept.append({
                "method": row["method"],
                "setting": row["setting"],
                "batch": row["batch"],
                "error": row["error"],
                "us per equilibrium": row["us per equilibrium"],
                "thesis's algorithm at that error, us": thesis_time(row["error"]),
                "speed-up": thesis_time(row["error"]) / row["us per equilibrium"],
            })  # fmt: skip
    return table(kept)


def space_precision() -> str:
    """Every method in space, and how much longer the fastest setting of scipy takes that is as accurate.

    Where none is, its most accurate setting counts.
    """
    e, rows, kept = read("space_precision")["environment"], read("space_precision")["rows"], []
    for row in rows:
        others = [one for one in rows if one["whisker"] == row["whisker"] and "scipy" in one["method"]]
        smallest = min(one["error"] for one in others)
        same = [one["us per equilibrium"] for one in others if one["error"] <= max(row["error"], smallest)]
        kept.append({
            "whisker": row["whisker"],
            "method": row["method"],
            "setting": row["setting"],
            "batch": row["batch"],
            "error": row["error"],
            "us per equilibrium": row["us per equilibrium"],
            "quartiles": f"{row['lower quartile']:.3g} to {row['upper quartile']:.3g}",
            "speed-up over scipy": min(same) / row["us per equilibrium"] if row["method"] == "jaxwhisker" else None,
            "first call, s": row["first call, s"],
            "failed": f"{row['failed']:.0%}" if row["failed"] else None,
        })  # fmt: skip
    others = ", ".join(f"{name} {e[name]}" for name in ("scipy", "mujoco", "pyelastica"))
    return f"{table(kept)}\n\n{environment('space_precision')[:-1]}; {others}; load {e['load']}."


def is_other(method: str) -> bool:
    """Whether a row is about another simulator of motion than `simulate`, or another method of integration."""
    return method != "jaxwhisker" and "check" not in method


def enough(rows: list[dict], error: float) -> list[dict]:
    """Rows of one case whose error is not larger.

    Errors below twice the difference between two references count as equal.
    """
    known = next(row["error"] for row in rows if "check" in row["method"])
    return [row for row in rows if "check" not in row["method"] and row["error"] <= max(error, 2 * known)]


def motion_time(case: str, error: float) -> dict:
    """The fastest setting of `simulate` whose error in this case is not larger."""
    rows = enough([row for row in read("motion")["rows"] if row["case"] == case], error)
    return min((row for row in rows if row["method"] == "jaxwhisker"), key=lambda row: row["time, s"])


def motion_best() -> str:
    """The smallest error of each simulator of motion beside the fastest setting of `simulate` that reaches it."""
    rows, kept = read("motion")["rows"], []
    for case, method in dict.fromkeys((row["case"], row["method"]) for row in rows if is_other(row["method"])):
        own = [row for row in rows if row["case"] == case and (row["method"] == method or "check" in row["method"])]
        smallest = min(row["error"] for row in own if row["method"] == method)
        row = min(enough(own, smallest), key=lambda row: row["time, s"])
        ours = motion_time(case, row["error"])
        kept.append({
            "case": case,
            "smallest error of": f"{method}, {row['setting']}",
            "error": row["error"],
            "time, s": row["time, s"],
            "`simulate`": ours["setting"],
            "its error": ours["error"],
            "its time, s": ours["time, s"],
            "ratio": row["time, s"] / ours["time, s"],
        })  # fmt: skip
    return table(kept)


def motion() -> str:
    """Every simulator of motion at every setting, and checks of the reference."""
    e, kept = read("motion")["environment"], []
    for row in read("motion")["rows"]:
        other = is_other(row["method"])
        kept.append({
            "case": row["case"],
            "method": row["method"],
            "setting": row["setting"],
            "time, s": row["time, s"],
            "first call, s": row["first call, s"],
            "error": row["error"],
            "time / that of `simulate` at this error": (
                row["time, s"] / motion_time(row["case"], row["error"])["time, s"] if other else None
            ),
            "mz, means of 0.2 T": row["error of means"],
            "mz, largest": row["largest"],
            "fx": row["fx"],
            "fy": row["fy"],
        })  # fmt: skip
    others = ", ".join(f"{name} {e[name]}" for name in ("mujoco", "pyelastica", "numba"))
    return f"{table(kept)}\n\n{environment('motion')[:-1]}; {others}."


def several_precision() -> str:
    """Every method past two circles at every setting."""
    e, rows, kept = read("several_precision")["environment"], read("several_precision")["rows"], []
    for row in rows:
        kept.append({
            "method": row["method"],
            "setting": row["setting"],
            "batch": row["batch"],
            "positions": row["positions"],
            "ms per equilibrium": row["ms per equilibrium"],
            "quartiles": f"{row['lower quartile']:.3g} to {row['upper quartile']:.3g}",
            "s per scan": row["s per scan"],
            "mz": row["mz"],
            "fx": row["fx"],
            "mz, two contacts": row["mz, two contacts"],
            "fx, two contacts": row["fx, two contacts"],
            "jump": row["jump"],
            "first call, s": row["first call, s"],
            "failed": f"{row['failed']:.0%}" if row["failed"] else None,
        })  # fmt: skip
    others = ", ".join(f"{name} {e[name]}" for name in ("scipy", "mujoco", "exudyn", "pyelastica"))
    return f"{table(kept)}\n\n{environment('several_precision')[:-1]}; {others}; load {e['load']}."


def several_at_error() -> str:
    """Time per equilibrium past two circles, in ms, of the fastest setting within given errors, and smallest errors."""
    rows, kept = read("several_precision")["rows"], []
    for method, batch, positions in dict.fromkeys((row["method"], row["batch"], row["positions"]) for row in rows):
        own = [row for row in rows if (row["method"], row["batch"], row["positions"]) == (method, batch, positions)]
        line = {"method": method, "batch": batch, "positions": positions}
        for signal, within in (("mz", 1e-2), ("mz", 1e-3), ("mz", 1e-4), ("fx", 1e-2), ("fx", 1e-3)):
            times = [row["ms per equilibrium"] for row in own if row[signal] <= within]
            line[f"{signal} within {within:.0e}"] = min(times, default=None)
        kept.append(line | {f"smallest error of {signal}": min(row[signal] for row in own) for signal in ("mz", "fx")})
    return table(kept)


def in_short() -> str:
    """The README's table: integrated rods beside the closed form."""
    settings = {"integrated": "splitting of order 6, 8 steps", "closed form": "elliptic functions"}
    rows = [row for row in read("work_precision")["rows"] if row["object"] == "parabola"]
    fastest = {(kind, row["batch"]): row for kind, name in settings.items() for row in rows if row["setting"] == name}
    most = max(batch for _, batch in fastest)
    extreme = read("extremes")["rows"]
    first = next(row for row in read("cold_start")["rows"] if row["task"] == "FB, first scan")
    steps = [row["us per step"] for row in read("ladder")["rows"][1:5]]

    def line(name, integrated, closed_form=None):
        return {"AMD EPYC": name, "integrated rods": integrated, "closed form": closed_form}

    def both(name, value):
        return line(name, *map(value, settings))

    def speed(kind):
        row = fastest[kind, most]
        return f"{thesis_time(row['error']) / row['us per equilibrium']:,.0f} times faster"

    def worst(kind):
        return f"{max(row['error'] for row in extreme if row['rods'] == kind):.0e}"

    starts = " / ".join(f"{first[f'{cache}, s']:.0f} s" for cache in ("empty", "filled"))
    return table([
        both("error of fx, fy, mz over a scan, relative to the peak", lambda kind: f"{fastest[kind, 1]['error']:.0e}"),
        both("error of event positions, in L", lambda kind: f"{fastest[kind, 1]['event error']:.0e}"),
        both("time per equilibrium, one scan", lambda kind: f"{fastest[kind, 1]['us per equilibrium']:.1f} us"),
        both(
            f"time per equilibrium, batch of {most} scans",
            lambda kind: f"{fastest[kind, most]['us per equilibrium']:.1f} us",
        ),
        both("the same, compared with the thesis's algorithm in scipy at the same error", speed),
        both(f"{len(extreme) // 2} extreme cases: largest residual of any equation in states marked ok", worst),
        line("us per step of FB / FBFB / FBFBR / FBFBFBR, batch of 32", " / ".join(f"{t:.1f}" for t in steps)),
        line("start of the process to first result, cache empty / filled", starts),
    ])  # fmt: skip


def models() -> str:
    """Cost of each model relative to FB."""
    columns = ("model", "rods", "batch", "steps", "us per step", "relative to FB", "compile, s", "memory, MB")
    return table([{column: row[column] for column in columns} for row in read("models")["rows"]])


# Supports


def settings() -> str:
    """Peaks, widths and first snap for every support."""
    rows = [without(row, "axis", "rest", "curve") for row in read("settings")["rows"] if row["rest"] == 0]
    return f"{table(rows)}\n\n{environment('settings')}"


def claims() -> str:
    """Which of the thesis's claims about one whisker hold for other supports; numbers are the largest change of a peak.

    The last row of each setting has a rest length or angle; all others have none.
    """
    rows = read("settings")["rows"]
    peaks = ("peak fx", "peak fy", "peak mz")

    def change(row, other):
        return max(abs(row[peak] / other[peak] - 1) for peak in peaks)

    def unchanged(size):
        return "yes" if size < UNCHANGED else f"no: {size:.0%}"

    kept = []
    for setting in dict.fromkeys(row["setting"] for row in rows):
        *plain, shifted = [row for row in rows if row["setting"] == setting]
        softest, rigid = plain[0], plain[-1]
        same = next(row for row in plain if row["stiffness"] == shifted["stiffness"])
        narrower = softest["width of mz"] / rigid["width of mz"] - 1
        kept.append({
            "setting": setting,
            "softest spring": softest["stiffness"],
            "stiffness leaves maxima unchanged": unchanged(change(softest, rigid)),
            "a softer spring narrows mz": f"{'yes' if narrower < 0 else 'no'}: {narrower:+.0%}",
            "a softer spring delays the peak of mz": (
                "yes" if abs(softest["peak mz at"]) > abs(rigid["peak mz at"]) else "no"
            ),
            "a rest length only shifts": unchanged(change(shifted, same)),
        })  # fmt: skip
    return table(kept)


# Inverse problems

KNOWN = (  # rows of known_subsets that the page shows
    (),
    ("position",),
    ("rest length", "position"),
    ("stiffness", "rest length", "position"),
    ("distance", "shape", "position"),
)
DETECTED = ("detected in points from", "detected between whiskers from", "detected in a fit from")


def percent(error: float | None) -> str | None:
    """Format a relative standard error."""
    if error is None:
        return None
    return "not identifiable" if math.isnan(error) else f"{error:.2%}"


def thousandths(error: float | None) -> str | None:
    """Format the standard error of a length in 10^-3 L."""
    if error is None:
        return None
    return "not identifiable" if math.isnan(error) else f"{1e3 * error:.2f}"


def known_subsets() -> str:
    """What is identifiable, and standard errors, when some parameters are known: three tables."""
    rows, counted, errors, contours = read("known_subsets")["rows"], [], [], []
    by_case = {(row["scene"], row["shape"], tuple(row["known"])): row for row in rows}
    for scene in dict.fromkeys(row["scene"] for row in rows):
        for known in KNOWN:
            row = by_case[scene, "parabola", (*known, "whisker")]
            free = by_case.get((scene, "any", (*known, "whisker")), {})
            lost = (row["shifts"], "shift"), (row["pre-strains"], "strain")
            case = {"scene": scene, "known": ", ".join(known) or "nothing"}
            counted.append(case | {
                "unknown": ", ".join(row["unknown"]),
                "identifiable": f"{row['rank']} of {row['number']}",
                "condition": f"{row['condition']:.0f}" if row["rank"] == row["number"] else "infinite",
                "not identifiable": ", ".join(f"{n} x {kind}" for n, kind in lost if n) or None,
            })  # fmt: skip
            errors.append(case | {
                "stiffness": percent(row["stiffness"]),
                "q": percent(row["distance"]),
                "a": percent(row["curvature"]),
            })  # fmt: skip
            contours.append(case | {
                "base 1": thousandths(row["position of base 1"]),
                "spacing": thousandths(row["spacing of bases"]),
                "any shape: stiffness": percent(free.get("stiffness")),
                "contour": thousandths(free.get("contour")),
            })  # fmt: skip
    return "\n\n".join(map(table, (counted, errors, contours)))


def known_errors() -> str:
    """Contour error caused by a wrong parameter, and the error of the parameter that is detected.

    The first table shows the parameter of each kind that matters most; the second, the one that is hardest to detect.
    """
    rows = read("known_errors")["rows"]
    kinds = {"c": "a stiffness", "l": "a rest length", "EI": "EI", "L": "L", "angle": "angle"}

    def of_kind(scene, kind):
        return [row for row in rows if row["scene"] == scene and kind in (row["parameter"], row["parameter"][0])]

    def size(worst):
        full, rate = ([1e3 * worst[f"{size}, {how}"] for size in ("mean", "max")] for how in ("full", "derivative"))
        name = f"{worst['parameter']}: " if worst["parameter"][1:].isdigit() else ""
        return name + "{:.2f} / {:.2f} ({:.2f} / {:.2f})".format(*full, *rate)

    def detected(group):
        each = [[row[check] for row in group] for check in DETECTED]
        return " / ".join("-" if None in values else f"{max(values):.2g}" for values in each)

    sizes, thresholds = [], []
    for kind, words in kinds.items():
        unit = "deg" if kind == "angle" else "%"
        scenes = {scene: of_kind(scene, kind) for scene in dict.fromkeys(row["scene"] for row in rows)}
        worst = {scene: max(group, key=lambda row: row["max, full"]) for scene, group in scenes.items()}
        sizes.append({"wrong by 1 % or 1 deg": words} | {scene: size(row) for scene, row in worst.items()})
        thresholds.append({"detected from": f"{words}, {unit}"} | {s: detected(group) for s, group in scenes.items()})
    return f"{table(sizes)}\n\n{table(thresholds)}"


def known_networks() -> str:
    """Standard errors for each network and stiffness: those of a parabola, and those of any shape."""
    parabola, any_shape = [], []
    for row in read("known_networks")["rows"]:
        if row["stiffness"] == 200:
            continue  # only in the figure
        parabola.append({
            "scene": row["scene"],
            "c": row["stiffness"],
            "worst stiffness": percent(row["worst stiffness"]),
            "c1": percent(row["first stiffness"]),
            "q": percent(row["q"]),
            "a": percent(row["a"]),
        })  # fmt: skip
        any_shape.append({
            "scene": row["scene"],
            "c": row["stiffness"],
            "signals": row["channels"],
            "any shape: worst stiffness": percent(row["worst stiffness, any shape"]),
            "any shape: q": percent(row["q, any shape"]),
            "contour": thousandths(row["contour"]),
        })  # fmt: skip
    return f"{table(parabola)}\n\n{table(any_shape)}\n\n{environment('known_networks')}"


# Films and sliders


def known_friction() -> str:
    """Errors of contour and parameters for each assumed friction coefficient."""
    kept = [
        {"assumed friction": row["assumed"]}
        | {"contour, mean / largest": f"{row['contour, mean']:.3g} / {row['contour, largest']:.3g}"}
        | {f"{name} off by": f"{row[f'{name} off by']:+.1%}" for name in ("c", "q", "a")}
        | {"reduced chi^2": row["reduced chi^2 without noise"] + 1}
        for row in read("known_friction")["rows"]
    ]
    return f"{table(kept)}\n\n{environment('known_friction')}"


def revealed_friction() -> str:
    """Standard errors on each route of the drive, if friction is known / unknown."""
    kept = [
        {"route": row["route"], "friction": row["friction"]}
        | {name: f"{row[f'{name}, friction known']:.2%} / {row[f'{name}, unknown']:.2%}" for name in ("c", "q", "a")}
        for row in read("revealed_friction")["rows"]
    ]
    return f"{table(kept)}\n\n{environment('revealed_friction')}"


def films() -> str:
    """Time and size of films."""
    return table(read("films")["rows"])


def sliders() -> str:
    """Frames per second of each slider, and the 95th percentile of the wait for the next frame."""
    rows = []
    for row in read("sliders")["rows"]:
        dragged = {
            name: f"{row[f'{name}, frames/s']:.0f} ({row[f'{name}, 95th percentile of wait, ms']:.0f} ms)"
            for name in ("stiffness", "distance", "drive")
        }
        rows.append({"where": row["where"], "model": row["model"], "rods": row["rods"]} | dragged)
    return f"{table(rows)}\n\n{environment('sliders')}"


WHOLE = (
    *("roofline", "ladder", "cold_start", "extremes", "soak", "soak_supports", "soak_friction"),
    *("soak_shafts", "soak_curved", "soak_space", "soak_objects", "space_extremes", "cold_start_space", "space_rod"),
    *("several_contacts",),
    *("identify_guesses", "identify_noise", "reconstruct", "test_times", "test_packages"),
)
SELECTED = (in_short, work_precision, speed_up, space_precision, motion, motion_best, models, settings, claims)
SELECTED += (several_precision, several_at_error)
SELECTED += (known_subsets, known_errors, known_networks, known_friction, revealed_friction, films, sliders)
TABLES = {function.__name__: function for function in SELECTED}
TABLES |= {"growth": partial(whole, "growth", "failed")} | {name: partial(whole, name) for name in WHOLE}


def written(text: str) -> str:
    """Text of a page with its tables replaced."""

    def block(match):
        try:
            made = TABLES[match[1]]()
        except FileNotFoundError as missing:
            made = f"Not measured yet: there is no {Path(missing.filename).name}."
        return f"<!-- table: {match[1]} -->\n{made}\n<!-- end -->"

    return re.sub(r"<!-- table: (\w+) -->\n.*?<!-- end -->", block, text, flags=re.S)


def main() -> None:
    """Rewrite the tables of all pages."""
    for page in PAGES:
        page.write_text(written(page.read_text()))


if __name__ == "__main__":
    main()
