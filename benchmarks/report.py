"""Tables and figures of the documentation, made from the results that the benchmarks have stored.

python benchmarks/report.py

A table stands between `<!-- table: NAME -->` and `<!-- end -->` in README.md or docs/*.md and is written anew.
"""

import math
import re
from pathlib import Path

import matplotlib as mpl

mpl.use("agg")

import matplotlib.pyplot as plt
import numpy as np

from common import read, table

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
OURS = ("jaxwhisker, integrated", "jaxwhisker, closed form")
STYLE = {  # Okabe and Ito's colours
    "jaxwhisker, integrated": ("#0072B2", "o"),
    "jaxwhisker, closed form": ("#D55E00", "D"),
    "diffrax and optimistix": ("#009E73", "s"),
    "scipy: fsolve, solve_ivp (thesis)": ("#000000", "^"),
    "scipy: solve_bvp": ("#999999", "v"),
    "MuJoCo: hinge chain": ("#CC79A7", "P"),
    "PyElastica": ("#E69F00", "X"),
}


def environment(name: str) -> str:
    """Machine, versions and date of a results file, in a sentence."""
    e = read(name)["environment"]
    libraries = ", ".join(f"{key} {e[key]}" for key in ("jax", "diffrax", "optimistix"))
    return f"{e['processor']}, {e['cores']} cores; Python {e['python']}, {libraries}; {e['date']}."


def work_precision() -> str:
    rows = read("work_precision")["rows"]
    kept = []
    for row in rows:
        kept.append({
            "method": row["method"],
            "setting": row["setting"],
            "object": row["object"],
            "batch": row["batch"],
            "us per equilibrium": row["us per equilibrium"],
            "quartiles": f"{row['lower quartile']:.3g} to {row['upper quartile']:.3g}",
            "error": row["error"],
            "events": row["error of events"],
            "compile, s": row["compile, s"],
            "first call, s": row["first call, s"],
            "no result": f"{row['failed']:.0%}" if row["failed"] else None,
        })  # fmt: skip
    return f"{table(kept)}\n\n{environment('work_precision')}"


def port(error: float) -> float:
    """us per equilibrium of the thesis's algorithm at an error: between its tolerances, or the nearest one."""
    thesis = [row for row in read("work_precision")["rows"] if "thesis" in row["method"]]
    errors, times = (np.log([row[key] for row in thesis]) for key in ("error", "us per equilibrium"))
    order = np.argsort(errors)
    return float(np.exp(np.interp(np.log(error), errors[order], times[order])))


def speed_up() -> str:
    """How many times faster than the thesis's algorithm, at the same error."""
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
                "the port at that error, us": port(row["error"]),
                "times faster": port(row["error"]) / row["us per equilibrium"],
            })  # fmt: skip
    return table(kept)


def in_short() -> str:
    """The README's table: both kinds of rods, beside each other."""
    kinds = {"integrated": "splitting of order 6, 8 steps", "closed form": "elliptic functions"}
    rows = [row for row in read("work_precision")["rows"] if row["object"] == "parabola"]
    found = {(kind, row["batch"]): row for kind, name in kinds.items() for row in rows if row["setting"] == name}
    most = max(batch for _, batch in found)
    extreme = read("extremes")["rows"]
    cold = {(row["model"], row["compilation cache"]): row for row in read("cold_start")["rows"]}
    rungs = {row["scene"]: row for row in read("ladder")["rows"]}

    def line(name, of):
        return {"AMD EPYC": name, **{"closed form" if k != "integrated" else "integrated rods": of(k) for k in kinds}}

    def faster(kind):
        row = found[kind, most]
        return f"{port(row['error']) / row['us per equilibrium']:,.0f} times faster"

    def worst(kind):
        own = [row for row in extreme if row["rods"] == kind]
        return f"{max(row['error'] for row in own):.0e}"

    starts = "{:.0f} s / {:.0f} s".format(
        *(cold["FB", cache]["import to first result, s"] for cache in ("empty", "warm"))
    )
    costs = " / ".join(f"{rungs[name]['us per step']:.1f}" for name in list(rungs)[1:5])
    return table([
        line("error of fx, fy, mz over a scan, relative to the peak", lambda kind: f"{found[kind, 1]['error']:.0e}"),
        line("error of events' positions, in lengths", lambda kind: f"{found[kind, 1]['error of events']:.0e}"),
        line("an equilibrium of one scan", lambda kind: f"{found[kind, 1]['us per equilibrium']:.1f} us"),
        line(f"... of a batch of {most} scans", lambda kind: f"{found[kind, most]['us per equilibrium']:.1f} us"),
        line("... beside the thesis's algorithm in scipy, at the same error", faster),
        line(f"{len(extreme) // 2} extreme cases: how far a state that says ok misses any law", worst),
        {"AMD EPYC": "us per step: FB / FBFB / FBFBR / FBFBFBR, batch of 32", "integrated rods": costs},
        {"AMD EPYC": "import to first result, compilation cache empty / filled", "integrated rods": starts},
    ])  # fmt: skip


def growth() -> str:
    rows = [row for row in read("growth")["rows"] if "to FB" not in row]
    drop = ("failed",)
    return f"{table([{k: v for k, v in row.items() if k not in drop} for row in rows])}\n\n{environment('growth')}"


def models() -> str:
    rows = [row for row in read("growth")["rows"] if "to FB" in row]
    kept = [
        {
            "model": row["size"],
            "rods": row["grows"].removeprefix("model, "),
            **{k: row[k] for k in ("batch", "steps", "us per step", "to FB", "compile, s", "memory, MB")},
        }
        for row in rows
    ]
    return table(kept)


def ladder() -> str:
    return f"{table(read('ladder')['rows'])}\n\n{environment('ladder')}"


def cold_start() -> str:
    return f"{table(read('cold_start')['rows'])}\n\n{environment('cold_start')}"


def roofline() -> str:
    return f"{table(read('roofline')['rows'])}\n\n{environment('roofline')}"


def extremes() -> str:
    return f"{table(read('extremes')['rows'])}\n\n{environment('extremes')}"


def soak() -> str:
    return f"{table(read('soak')['rows'])}\n\n{environment('soak')}"


def settings() -> str:
    rows = [row for row in read("settings")["rows"] if row["rest"] == 0]
    hidden = ("axis", "rest", "curve")
    return f"{table([{k: v for k, v in row.items() if k not in hidden} for row in rows])}\n\n{environment('settings')}"


def claims() -> str:
    """What becomes of the thesis's claims about one whisker, with the largest change of any peak."""
    rows = read("settings")["rows"]
    peaks = ("peak fx", "peak fy", "peak mz")
    kept = []
    for setting in dict.fromkeys(row["setting"] for row in rows):
        own = [row for row in rows if row["setting"] == setting]
        plain, shifted = [row for row in own if row["rest"] == 0], own[-1]
        rigid = plain[-1]
        same = next(row for row in plain if row["stiffness"] == shifted["stiffness"])
        softest = max(abs(plain[0][peak] / rigid[peak] - 1) for peak in peaks)
        moved = max(abs(shifted[peak] / same[peak] - 1) for peak in peaks)
        later = abs(plain[0]["peak mz at"]) > abs(rigid["peak mz at"])
        kept.append({
            "setting": setting,
            "softest": plain[0]["stiffness"],
            "stiffness leaves maxima unchanged": "yes" if softest < SAME else f"no: {softest:.0%}",
            "... and narrows the moment": f"{'yes' if plain[0]['width of mz'] < rigid['width of mz'] else 'no'}: "
            f"{plain[0]['width of mz'] / rigid['width of mz'] - 1:+.0%}",
            "... and shifts its peak onwards": "yes" if later else "no",
            "a rest length only shifts": "yes" if moved < SAME else f"no: {moved:.0%}",
        })  # fmt: skip
    return table(kept)


def soak_supports() -> str:
    return f"{table(read('soak_supports')['rows'])}\n\n{environment('soak_supports')}"


SAME = 1e-3  # peaks on a grid of steps of 0.001


def identify_guesses() -> str:
    return f"{table(read('identify_guesses')['rows'])}\n\n{environment('identify_guesses')}"


def identify_noise() -> str:
    return f"{table(read('identify_noise')['rows'])}\n\n{environment('identify_noise')}"


def reconstruct() -> str:
    return f"{table(read('reconstruct')['rows'])}\n\n{environment('reconstruct')}"


KNOWN = (  # of the subsets in known_subsets: those that the page shows
    (),
    ("position",),
    ("rest length", "position"),
    ("stiffness", "rest length", "position"),
    ("distance", "shape", "position"),
)


def told(value, percent: bool = True) -> str | None:
    """A standard error in a table."""
    if value is None:
        return None
    if math.isnan(value):
        return "not told"
    return f"{value:.2%}" if percent else f"{1e3 * value:.2f}"


def known_subsets() -> str:
    """What is told of the rest if some of it is known; lengths in thousandths."""
    rows, kept = read("known_subsets")["rows"], []
    found = {(row["scene"], row["shape"], tuple(row["known"])): row for row in rows}
    for scene in dict.fromkeys(row["scene"] for row in rows):
        for known in KNOWN:
            row = found[scene, "parabola", (*known, "whisker")]
            free = found.get((scene, "any", (*known, "whisker")), {})
            counted = (row.get("shifts"), "shift"), (row.get("pre-strains"), "strain")
            apart = [f"{n} x {what}" for n, what in counted if n]
            kept.append({
                "scene": scene,
                "known": ", ".join(known) or "nothing",
                "sought": ", ".join(row["sought"]),
                "told": f"{row['rank']} of {row['number']}",
                "condition": f"{row['condition']:.0f}" if row["rank"] == row["number"] else "infinite",
                "stiffness": told(row["stiffness"]),
                "q": told(row["distance"]),
                "a": told(row["shape told"]),
                "base 1": told(row.get("place of base 1"), False),
                "spacing": told(row.get("spacing of bases"), False),
                "any shape: stiffness": told(free.get("stiffness")),
                "contour": told(free.get("contour"), False),
                "not told": ", ".join(apart) or None,
            })  # fmt: skip
    return table(kept)


def known_errors() -> str:
    """How wrong the contour gets by the worst of each kind, and from which error on the best hidden one is noticed."""
    rows = read("known_errors")["rows"]
    kinds = {"c": "a stiffness", "l": "a rest length", "EI": "EI", "L": "L", "angle": "angle"}
    looks = ("noticed in points from", "noticed between whiskers from", "noticed in a fit from")

    def own(scene, kind):
        return [row for row in rows if row["scene"] == scene and kind in (row["parameter"], row["parameter"][0])]

    def size(worst):
        full, rate = ([1e3 * worst[f"{size}, {how}"] for size in ("mean", "max")] for how in ("full", "derivative"))
        name = f"{worst['parameter']}: " if worst["parameter"][1:].isdigit() else ""
        return name + "{:.2f} / {:.2f} ({:.2f} / {:.2f})".format(*full, *rate)

    def noticed(found):
        each = [[row.get(look) for row in found] for look in looks]
        return " / ".join("-" if None in values else f"{max(values):.2g}" for values in each)

    sizes, seen = [], []
    for kind, words in kinds.items():
        unit = "deg" if kind == "angle" else "%"
        scenes = {scene: own(scene, kind) for scene in dict.fromkeys(row["scene"] for row in rows)}
        worst = {scene: max(found, key=lambda row: row["max, full"]) for scene, found in scenes.items()}
        sizes.append({"wrong": f"{words}, by 1 {unit}"} | {scene: size(row) for scene, row in worst.items()})
        seen.append({"noticed": f"{words}, {unit}"} | {scene: noticed(found) for scene, found in scenes.items()})
    return f"{table(sizes)}\n\n{table(seen)}"


def known_buys() -> str:
    """Standard errors over scene and stiffness; of the contour in thousandths of a length."""
    kept = [
        {
            "scene": row["scene"],
            "c": row["stiffness"],
            "signals": row["channels"],
            "worst stiffness": told(row["worst stiffness"]),
            "first": told(row["first stiffness"]),
            "q": told(row["q"]),
            "a": told(row["a"]),
            "any shape: worst stiffness": told(row["worst stiffness, any shape"]),
            "q, any shape": told(row["q, any shape"]),
            "contour": told(row["contour"], False),
        }
        for row in read("known_buys")["rows"]
        if row["stiffness"] != 200  # only in the figure
    ]
    return f"{table(kept)}\n\n{environment('known_buys')}"


def films() -> str:
    return table([_only(row, "what") for row in read("showing")["rows"] if row["what"] == "film"])


def sliders() -> str:
    """Pictures a second of each slider, and within how many milliseconds the next one comes, 95 times in 100."""
    rows = []
    for row in read("showing")["rows"]:
        if row["what"] == "sliders":
            dragged = {
                name: f"{row[f'{name}, pictures/s']:.0f} ({row[f'{name}, longest wait of 95 %, ms']:.0f} ms)"
                for name in ("stiffness", "distance", "drive")
            }
            rows.append({"where": row["where"], "model": row["model"], "rods": row["rods"]} | dragged)
    return f"{table(rows)}\n\n{environment('showing')}"


def _only(row: dict, *left_out: str) -> dict:
    return {name: value for name, value in row.items() if name not in left_out}


TABLES = {
    f.__name__: f
    for f in (
        *(in_short, work_precision, speed_up, roofline, growth, models, ladder, cold_start, extremes, soak),
        *(settings, claims, soak_supports),
        *(identify_guesses, identify_noise, reconstruct, known_subsets, known_errors, known_buys),
        *(films, sliders),
    )
}


def written(text: str) -> str:
    """A page with its tables made anew."""

    def block(match):
        try:
            made = TABLES[match[1]]()
        except FileNotFoundError as missing:
            made = f"Not measured yet: there is no {Path(missing.filename).name}."
        return f"<!-- table: {match[1]} -->\n{made}\n<!-- end -->"

    return re.sub(r"<!-- table: (\w+) -->\n.*?<!-- end -->", block, text, flags=re.S)


def draw_methods(ax, batch: int | None) -> None:
    """Error over time of every method, in one batch; its largest, if None is asked for or it has none of that size."""
    rows = read("work_precision")["rows"]
    for method, (colour, marker) in STYLE.items():
        own = [row for row in rows if row["method"] == method]
        own = [row for row in own if row["object"] == ("circle" if method[:2] in ("Mu", "Py") else "parabola")]
        sizes = {row["batch"] for row in own}
        size = batch if batch in sizes else max(sizes)
        own = [row for row in own if row["batch"] == size]
        families: dict[str, list] = {}
        for row in own:
            words = row["setting"].split(", ")
            family = words[0] if method in (OURS[0], "diffrax and optimistix") else method
            families.setdefault(family + ("a" if "adaptive" in words else ""), []).append(row)
        for number, family in enumerate(families.values()):
            family.sort(key=lambda row: row["us per equilibrium"])
            x, y = [row["us per equilibrium"] for row in family], [row["error"] for row in family]
            label = None if number else method
            ax.loglog(x, y, color=colour, marker=marker, ms=4, lw=1, ls="-" if number == 0 else ":", label=label)
    ax.set_xlabel("time per equilibrium (µs)")
    ax.set_ylabel("error, relative to the peak")
    ax.grid(alpha=0.3, lw=0.5)


def draw_work_precision() -> None:
    batches = sorted({row["batch"] for row in read("work_precision")["rows"]})
    down = -(-len(batches) // 2)
    fig, axs = plt.subplots(
        down, 2, figsize=(9, 1 + 3.4 * down), sharex=True, sharey=True, squeeze=False, layout="constrained"
    )
    for ax, batch in zip(axs.flat, batches, strict=False):
        draw_methods(ax, batch)
        ax.set_title("one scan" if batch == 1 else f"batch of {batch}", fontsize=10)
        ax.label_outer()
    handles, labels = axs[0, 0].get_legend_handles_labels()
    fig.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    fig.savefig(ROOT / "docs" / "work_precision.png", dpi=130)


def draw_numbers() -> None:
    """The README's figure: error against time, extreme cases, what a scene pays for."""
    fig, (left, middle, right) = plt.subplots(1, 3, figsize=(13, 4.5), layout="constrained")
    draw_methods(left, None)
    most = max(row["batch"] for row in read("work_precision")["rows"])
    left.set_title(f"error against time (ours and diffrax: batch of {most})", fontsize=9)
    fig.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=7, fontsize=7.5, frameon=False)

    rows = read("extremes")["rows"]
    groups = list(dict.fromkeys(row["case"] for row in rows))
    for kind, colour, marker in (("integrated", "#0072B2", "o"), ("closed form", "#D55E00", "D")):
        own = [row for row in rows if row["rods"] == kind]
        y = [groups.index(row["case"]) for row in own]
        middle.semilogx([max(row["error"], 1e-16) for row in own], y, marker, color=colour, ms=3.5, label=kind)
    middle.set_yticks(range(len(groups)), groups, fontsize=7)
    middle.invert_yaxis()
    middle.set_xlim(1e-16, 1e-5)
    middle.set_xlabel("largest violation of any law")
    middle.set_title("extreme cases", fontsize=9)
    middle.grid(alpha=0.3, lw=0.5)
    middle.legend(fontsize=7, frameon=False)

    rungs = [row for row in read("ladder")["rows"] if "operations" in row and "us per step" in row]
    names = [row["scene"] for row in rungs]
    right.barh(names, [row["us per step"] for row in rungs], color="#0072B2")
    right.invert_yaxis()
    right.tick_params(axis="y", labelsize=7)
    right.set_xlabel("µs per step, batch of 32")
    right.set_title("a scene pays for what it has", fontsize=9)
    fig.savefig(ROOT / "docs" / "numbers.png", dpi=110)


def draw_settings() -> None:
    """What compliance, taper, curvature and rotation do to the signals."""
    rows = [row for row in read("settings")["rows"] if row["rest"] == 0]
    fig, axs = plt.subplots(2, 4, figsize=(13, 5.6), layout="constrained", sharey="row")
    shades = ["#56B4E9", "#0072B2", "#009E73", "#000000"]
    panels = ("springs across (thesis)", "springs along", "torsion springs", "rotation, torsion")
    for column, setting in enumerate(panels):
        own = [row for row in rows if row["setting"] == setting]
        for colour, row in zip(shades, own, strict=True):
            u, _, fy, mz = (np.array(values) for values in row["curve"])
            label = "rigid" if row["stiffness"] == "inf" else f"c = {row['stiffness']:g}"
            for ax, values in zip(axs[:, column], (mz, fy), strict=True):
                ax.plot(u, np.where(values == 0, np.nan, values), color=colour, lw=1.2, label=label)
        axs[0, column].set_title(setting, fontsize=9)
        axs[0, column].legend(fontsize=7, frameon=False)
        axs[1, column].set_xlabel("angle of the drive (rad)" if "rotation" in setting else r"$u/L$")
        if "rotation" not in setting:
            axs[0, column].invert_xaxis()
            axs[1, column].invert_xaxis()
    axs[0, 0].set_ylabel(r"$m_z\,L/EI$")
    axs[1, 0].set_ylabel(r"$f_y\,L^2/EI$")
    fig.savefig(ROOT / "docs" / "supports.png", dpi=110)

    shapes = ("springs across (thesis)", "a cone 2:1, across", "curved forwards by 0.5, across",
              "curved backwards by 0.5, across")  # fmt: skip
    names = ("uniform", "cone 2:1", "curved forwards", "curved backwards")
    fig, axs = plt.subplots(1, 3, figsize=(11, 3.2), layout="constrained")
    for colour, setting, name in zip(["#000000", "#D55E00", "#0072B2", "#009E73"], shapes, names, strict=True):
        row = next(row for row in rows if row["setting"] == setting and row["stiffness"] == "inf")
        u, fx, fy, mz = (np.array(values) for values in row["curve"])
        for ax, values, label in zip(axs, (fx, fy, mz), (r"$f_x$", r"$f_y$", r"$m_z$"), strict=True):
            ax.plot(u, np.where(mz == 0, np.nan, values), color=colour, lw=1.2, label=name)
            ax.set_xlabel(r"$u/L$")
            ax.set_title(label, fontsize=9)
    for ax in axs:
        ax.invert_xaxis()
    axs[0].legend(fontsize=7, frameon=False)
    fig.savefig(ROOT / "docs" / "whiskers.png", dpi=110)


def main() -> None:
    for page in PAGES:
        page.write_text(written(page.read_text()))
    draw_work_precision()
    draw_numbers()
    draw_settings()


if __name__ == "__main__":
    main()
