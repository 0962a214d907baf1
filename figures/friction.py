"""Draw the figures of docs/friction.md and print the table beside them: python figures/friction.py

Writes docs/friction_signals.png and friction_loop.png.
"""

from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot

import jaxwhisker as jw
from jaxwhisker.plot import COLOURS, CONTROL_AXIS, axis_label

DOCS = Path(__file__).parents[1] / "docs"
COEFFICIENTS = (0.0, 0.1, 0.3, 0.5)
SUPPORTS = {"clamped": jw.Support.clamped(), "FB, c = 70": jw.Support.fb(70.0)}
CONTROL = jnp.linspace(1.0, -1.6, 5201)
REACTIONS = ("fx", "fy", "mz")
TURN = -0.2
VERTEX = {"marker": "o", "markersize": 4, "linestyle": "none", "zorder": 5}
MARK = {"marker": "s", "markersize": 7, "linestyle": "none", "zorder": 4, "markerfacecolor": "white"}


def scan(support: jw.Support, friction: float, control) -> jw.Result:
    """Scan the parabola with q = 0.2 and a = 1."""
    return jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2), support, friction=friction or None), control)


def contact_curves(result: jw.Result) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Drive positions and signals from the touch to the snap-off, both included: a step would miss the fold's peak."""
    touch, snap_off = (result.events.of(kind)[0] for kind in (jw.EventKind.touch, jw.EventKind.snap_off))
    control = np.asarray(result.control)
    between = (control < touch.control) & (control > snap_off.control)
    values = {
        name: np.r_[0.0, np.asarray(getattr(result, name))[between, 0], getattr(snap_off.before, name)[0]]
        for name in (*REACTIONS, "contact_x")
    }
    return np.r_[touch.control, control[between], snap_off.control], values


def zero_of_fx(values: dict[str, np.ndarray], quantity: np.ndarray) -> float:
    """A quantity where fx changes its sign for the first time."""
    fx = values["fx"]
    k = int(np.flatnonzero((fx[:-1] < 0) & (fx[1:] >= 0))[0])
    return float(np.interp(0.0, fx[k : k + 2], quantity[k : k + 2]))


def print_table() -> None:
    """The table of docs/friction.md."""
    for name, support in SUPPORTS.items():
        for friction in COEFFICIENTS:
            result = scan(support, friction, CONTROL)
            _, values = contact_curves(result)
            vertex, snap_off = (result.events.of(kind)[0] for kind in (jw.EventKind.vertex, jw.EventKind.snap_off))
            forces = [values["fx"].min(), snap_off.before.fx[0], values["fy"].max(), values["mz"].max()]
            cells = [f"{value:.3f}" for value in forces]
            cells += [f"{round(zero_of_fx(values, values['contact_x']), 2) + 0.0:g}"]  # 0 rather than -0
            cells += [f"{event.control:.4f}" for event in (vertex, snap_off)]
            print("|", " | ".join([name, f"{friction:g}", *cells]), "|")


def draw_signals() -> None:
    """Reactions of FB for several coefficients, with the vertex, the mark fx = 0 and the snap-off."""
    figure, axs = pyplot.subplots(1, 3, figsize=(11, 3.7), layout="constrained")
    for friction, colour in zip(COEFFICIENTS, COLOURS, strict=False):
        result = scan(SUPPORTS["FB, c = 70"], friction, CONTROL)
        control, values = contact_curves(result)
        vertex, mark = result.events.of(jw.EventKind.vertex)[0].control, zero_of_fx(values, control)
        for ax, name in zip(axs, REACTIONS, strict=True):
            ax.plot(control, values[name], color=colour, linewidth=1.3, label=rf"$\mu$ = {friction:g}")
            ax.plot([control[-1]] * 2, [values[name][-1], 0], color=colour, linewidth=0.9, linestyle=":")
            for at, style in ((vertex, VERTEX), (mark, MARK)):
                ax.plot(at, np.interp(-at, -control, values[name]), color=colour, **style)
    for ax, name in zip(axs, REACTIONS, strict=True):
        ax.axhline(0, color="0.6", linewidth=0.6, zorder=0)
        ax.set(xlabel=CONTROL_AXIS, ylabel=axis_label(name))
        ax.grid(alpha=0.3)
    for style, label in ((VERTEX, "vertex"), (MARK, "$f_x = 0$")):
        axs[0].plot([], [], color="0.3", label=label, **style)
    axs[0].plot([], [], color="0.3", linewidth=0.9, linestyle=":", label="snap-off")
    handles, labels = axs[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=7, fontsize=8, frameon=False)
    figure.savefig(DOCS / "friction_signals.png", dpi=110)


def draw_loop() -> None:
    """The horizontal force on the way to a turn and back, with the events at which the contact sticks and slips."""
    there, back = np.linspace(0.9, TURN, 1101), np.linspace(TURN, 0.9, 1101)
    result = scan(SUPPORTS["FB, c = 70"], 0.3, jnp.asarray(np.r_[there, back[1:]]))
    control, fx = np.asarray(result.control), np.asarray(result.fx[:, 0])
    out = np.arange(control.size) < there.size
    figure, ax = pyplot.subplots(figsize=(5.6, 3.5), layout="constrained")
    without = scan(SUPPORTS["FB, c = 70"], 0.0, jnp.asarray(there))
    ax.plot(without.control, without.fx[:, 0], color="0.5", linewidth=0.9, linestyle="--", label="without friction")
    ax.plot(control[out], fx[out], color=COLOURS[0], linewidth=1.4, label=r"$\mu$ = 0.3, out")
    ax.plot(control[~out], fx[~out], color=COLOURS[1], linewidth=1.4, label=r"$\mu$ = 0.3, back")
    stick, slipping = (result.events.of(kind)[0] for kind in (jw.EventKind.stick, jw.EventKind.slip))
    for event, marker, words in ((stick, "s", "stick"), (slipping, "o", "slip")):
        ax.plot(event.control, event.after.fx[0], marker, color="0.2", markersize=5, zorder=4)
        ax.annotate(words, (event.control, event.after.fx[0]), xytext=(-7, 3), textcoords="offset points", ha="right",
                    fontsize=8)  # fmt: skip
    ax.set(xlabel=CONTROL_AXIS, ylabel=axis_label("fx"), xlim=(-0.35, 0.9))
    ax.legend(fontsize=8, frameon=False, loc="lower right")
    ax.grid(alpha=0.3)
    figure.savefig(DOCS / "friction_loop.png", dpi=110)
    print(f"area of the loop {np.trapezoid(fx, control):.4f}; {stick}; {slipping}")


def main() -> None:
    """Draw both figures and print the table."""
    print_table()
    draw_signals()
    draw_loop()


if __name__ == "__main__":
    main()
