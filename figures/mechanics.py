"""Draw the figures of docs/mechanics.md: frame and signs, phases, spring networks, snaps.

python figures/mechanics.py
"""

from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Arc

import jaxwhisker as jw
from jaxwhisker import plot
from jaxwhisker._study.critical import steepest
from jaxwhisker.plot import COLOURS

DOCS = Path(__file__).parents[1] / "docs"
INK, SOFT = "#333333", "#888888"
FORCE, REACTION = COLOURS[1], COLOURS[2]
OBJECT = jw.Parabola(0.2)
ROD = jw.ClosedForm()


def scanned(stiffness: float, control: np.ndarray) -> jw.Result:
    support = jw.Support.fb(stiffness, 0.2) if np.isfinite(stiffness) else jw.Support.clamped()
    return jw.scan(jw.Scene(jw.Whisker(), OBJECT, support, rod=ROD), control)


def arrow(ax, tail, head, colour, width=1.6) -> None:
    style = {"arrowstyle": "-|>", "color": colour, "linewidth": width, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", xy=head, xytext=tail, arrowprops=style, zorder=6)


def spring(ax, start: float, end: float, height: float) -> None:
    turns = np.r_[0.0, 0.2, 0.2 + 0.6 * (np.arange(10) + 0.5) / 10, 0.8, 1.0]
    swing = np.r_[0.0, 0.0, np.tile([1.0, -1.0], 5), 0.0, 0.0]
    ax.plot(start + turns * (end - start), height + 0.025 * swing, color=INK, linewidth=0.9, zorder=1)


def bare(ax, window) -> None:
    ax.set_aspect("equal")
    ax.set(xlim=window[:2], ylim=window[2:])
    ax.axis("off")


def draw_frame() -> None:
    """One whisker in tangential contact, with the symbols of all quantities."""
    at = 0.12
    result = scanned(70.0, np.array([0.6, at]))
    line = jw.shapes(result, at=[at])
    x, y = np.asarray(line.x)[0, 0], np.asarray(line.y)[0, 0]
    x0, alpha = float(result.base_x[1, 0]), float(result.contact_slope[1, 0])
    xi, eta = float(result.contact_x[1, 0]), float(result.contact_y[1, 0])
    canvas = Figure(figsize=(7.2, 5.04))
    ax = canvas.add_axes((0, 0, 1, 1))
    plot.profile(OBJECT, ax=ax)
    arrow(ax, (-0.62, 0), (1.18, 0), SOFT, 0.8)
    arrow(ax, (0, -0.12), (0, 1.1), SOFT, 0.8)
    ax.text(1.19, -0.005, "$x$", color=SOFT, va="center")
    ax.text(0, 1.12, "$y$", color=SOFT, ha="center")
    ax.annotate("", xy=(0, 0.2), xytext=(0, 0), arrowprops={"arrowstyle": "<->", "color": INK, "linewidth": 0.8})
    ax.text(-0.03, 0.1, "$q$", ha="right", va="center")
    ax.text(-0.2, 0.78, "object", color=SOFT, ha="center")
    ax.plot(x, y, color=COLOURS[0], linewidth=2.4, zorder=4)
    ax.plot(x0, 0, "o", color=COLOURS[0], markersize=6, zorder=5)
    ax.text(x[-1] + 0.07, y[-1] - 0.05, "whisker,\n$s = 0$ at the base,\n$s = L$ at the tip", color=COLOURS[0],
            fontsize=9, va="center")  # fmt: skip
    spring(ax, at, x0, 0.0)
    ax.plot(at, 0, "s", color=INK, markersize=9, zorder=5)
    ax.text(at, -0.06, "drive $u$", ha="center", va="top")
    ax.text((at + x0) / 2, 0.05, r"$c,\ \lambda$", ha="center")
    ax.text(x0 + 0.01, -0.06, "base $(x_0, 0)$", ha="left", va="top")
    arrow(ax, (at - 0.1, -0.17), (at - 0.36, -0.17), INK, 1.2)
    ax.text(at - 0.37, -0.175, "scan ", ha="right", va="center")
    # The contact: point, slope, force.
    ax.plot(xi, eta, "o", color=FORCE, markersize=4.5, zorder=7)
    ax.text(xi - 0.03, eta + 0.045, r"$(\xi, \eta)$", color=INK, ha="right")
    ax.plot([xi, xi + 0.3], [eta, eta], color=SOFT, linewidth=0.8, linestyle=":")
    tangent = 0.36 * np.array([np.cos(alpha), np.sin(alpha)])
    ax.plot([xi, xi + tangent[0]], [eta, eta + tangent[1]], color=SOFT, linewidth=0.8, linestyle=":")
    ax.add_patch(Arc((xi, eta), 0.4, 0.4, theta1=0, theta2=np.degrees(alpha), color=INK, linewidth=0.9))
    ax.text(xi + 0.215, eta + 0.045, r"$\alpha$")
    normal = np.array([np.sin(alpha), -np.cos(alpha)])
    arrow(ax, (xi, eta), tuple(np.array([xi, eta]) + 0.26 * normal), FORCE)
    ax.text(xi + 0.26 * normal[0] + 0.02, eta + 0.26 * normal[1] - 0.01, r"$f$", color=FORCE, fontsize=12)
    # Direction of the whisker near the base.
    k = int(0.16 * len(x))
    direction = np.arctan2(y[k + 1] - y[k], x[k + 1] - x[k])
    ax.plot([x[k], x[k] + 0.17], [y[k]] * 2, color=SOFT, linewidth=0.8, linestyle=":")
    ax.plot([x[k], x[k] + 0.2 * np.cos(direction)], [y[k], y[k] + 0.2 * np.sin(direction)], color=SOFT,
            linewidth=0.8, linestyle=":")  # fmt: skip
    ax.add_patch(Arc((x[k], y[k]), 0.2, 0.2, theta1=0, theta2=np.degrees(direction), color=INK, linewidth=0.9))
    ax.text(x[k] + 0.11, y[k] + 0.05, r"$\varphi$")
    # Positive directions of the support reactions.
    corner = np.array([0.98, 0.21])
    ax.plot(*corner, "o", color=REACTION, markersize=4)
    for step, name, shift in (((0.16, 0), "$f_x$", (0.02, -0.012)), ((0, 0.16), "$f_y$", (-0.02, 0.02))):
        arrow(ax, tuple(corner), tuple(corner + step), REACTION)
        x, y = corner + step + shift
        ax.text(x, y, name, color=REACTION)
    turn = {"arrowstyle": "-|>", "color": REACTION, "linewidth": 1.4, "connectionstyle": "arc3,rad=0.9"}
    start, end, label = (tuple(corner + np.array(by)) for by in ((0.075, -0.03), (-0.03, 0.075), (0.09, 0.07)))
    ax.annotate("", xy=end, xytext=start, arrowprops=turn, zorder=6)
    ax.text(label[0], label[1], "$m_z$", color=REACTION)
    ax.text(corner[0], corner[1] - 0.06, "support reactions on the\nwhisker, positive directions",
            color=REACTION, fontsize=8.5, ha="center", va="top")  # fmt: skip
    bare(ax, (-0.7, 1.32, -0.25, 1.164))
    canvas.savefig(DOCS / "mechanics_frame.png", dpi=150)


def draw_phases() -> None:
    """The three phases: free, tip contact, tangential contact."""
    controls = np.array([0.8, 0.45, 0.0])
    result = scanned(70.0, controls)
    canvas = Figure(figsize=(7.2, 2.9))
    names = (
        ("free", "$f = 0$"),
        ("tip contact", r"$s_1 = L,\quad \varphi(L) \geq \alpha$"),
        ("tangential contact", r"$s_1 < L,\quad \varphi(s_1) = \alpha$"),
    )
    for k, (at, (name, equation)) in enumerate(zip(controls, names, strict=True)):
        ax = canvas.add_axes((k / 3, 0, 1 / 3, 1))
        line = jw.shapes(result, at=[at])
        x, y = np.asarray(line.x)[0, 0], np.asarray(line.y)[0, 0]
        plot.profile(OBJECT, ax=ax)
        ax.axhline(0, color=SOFT, linewidth=0.6)
        ax.plot(x, y, color=COLOURS[0], linewidth=2.2, zorder=4)
        ax.plot(x[0], 0, "o", color=COLOURS[0], markersize=5, zorder=5)
        spring(ax, at, float(x[0]), 0.0)
        ax.plot(at, 0, "s", color=INK, markersize=7, zorder=5)
        if k:
            alpha = float(result.contact_slope[k, 0])
            point = np.array([float(result.contact_x[k, 0]), float(result.contact_y[k, 0])])
            ax.plot(*point, "o", color=FORCE, markersize=4, zorder=7)
            arrow(ax, tuple(point), tuple(point + 0.2 * np.array([np.sin(alpha), -np.cos(alpha)])), FORCE)
        ax.text(0.42, -0.14, f"{name}\n{equation}", ha="center", va="top", fontsize=9.5)
        bare(ax, (-0.22, 1.12, -0.38, 1.1))
    canvas.savefig(DOCS / "mechanics_phases.png", dpi=150)


NETWORKS = {
    "FB": ((0, 1),),
    "FBFB": ((0, 1), (1, 2)),
    "FBFBR": ((0, 1), (1, 2), (0, 2)),
    "FBFBFBR": ((0, 1), (1, 2), (2, 3), (0, 2), (0, 3)),
}


def draw_springs() -> None:
    """The spring networks of the thesis."""
    canvas = Figure(figsize=(7.2, 4.3))
    axs = canvas.subplots(2, 2, gridspec_kw={"left": 0, "right": 1, "top": 1, "bottom": 0, "wspace": 0, "hspace": 0})
    for ax, (name, network) in zip(axs.flat, NETWORKS.items(), strict=True):
        nodes = 0.42 * np.arange(max(b for _, b in network) + 1)
        ax.axhline(0, color=SOFT, linewidth=0.6)
        for k in range(1, len(nodes)):
            ax.plot([nodes[k]] * 2, [0, 0.42], color=COLOURS[k - 1], linewidth=2.2)
            ax.plot(nodes[k], 0, "o", color=COLOURS[k - 1], markersize=6, zorder=5)
            ax.text(nodes[k] + 0.03, 0.36, str(k), color=COLOURS[k - 1])
        ax.plot(0, 0, "s", color=INK, markersize=9, zorder=5)
        ax.text(-0.04, 0.07, "drive 0", ha="center")
        below = 0
        for number, (first, second) in enumerate(network, 1):
            height = 0.0
            if second - first > 1:
                below += 1
                height = -0.17 * below
                for node in (first, second):
                    ax.plot([nodes[node]] * 2, [0, height], color=INK, linewidth=0.8)
            spring(ax, nodes[first], nodes[second], height)
            middle = (nodes[first] + nodes[second]) / 2
            ax.text(middle, height + 0.045, rf"$c_{number},\ \lambda_{number}$", ha="center", fontsize=9)
        ax.text(nodes.mean(), 0.53, name, ha="center", fontsize=12)
        room = (1.75 - nodes[-1]) / 2
        bare(ax, (-room, nodes[-1] + room, -0.45, 0.65))
    canvas.savefig(DOCS / "mechanics_springs.png", dpi=150)


SOFTER = 25.0


def draw_fold() -> None:
    """Equilibria at a snap: force of the clamped whisker over base position, and the line of the spring."""
    far = np.linspace(0.95, -1.3, 3000)
    clamped = scanned(np.inf, far)
    touching = np.asarray(clamped.contact_force)[:, 0] > 0
    x0, force = np.asarray(clamped.base_x)[touching, 0], -np.asarray(clamped.fx)[touching, 0]
    soft = scanned(SOFTER, np.linspace(0.9, -1.7, 2000))
    snaps = {event.kind: event for event in soft.events if event.kind.name.startswith("snap")}
    canvas = Figure(figsize=(7.2, 3.7), layout="constrained")
    axs = canvas.subplots(1, 2)
    for ax, kind, title in zip(
        axs,
        (jw.EventKind.snap_through, jw.EventKind.snap_off),
        ("snap-through", "snap-off"),
        strict=True,
    ):
        event = snaps[kind]
        before, after = ((float(s.base_x[0]), -float(s.fx[0])) for s in (event.before, event.after))
        ax.plot(x0, force, color=COLOURS[0], linewidth=1.8, label="object on whisker")
        ax.plot([x0[-1]] * 2, [force[-1], 0], color=COLOURS[0], linewidth=1, linestyle=":")
        for shift, style in ((0.0, "-"), (0.12, "--")):
            line = np.array([-1.6, 1.0])
            label = f"spring, $c = {SOFTER:g}$" if not shift else "spring, earlier"
            ax.plot(line, SOFTER * (line - event.control - 0.2 - shift), color=COLOURS[1], linewidth=1.2,
                    linestyle=style, label=label)  # fmt: skip
        ax.plot(*before, "o", color="black", markersize=6, zorder=5)
        ax.plot(*after, "o", markerfacecolor="white", markeredgecolor="black", markersize=6, zorder=5)
        bend = {"arrowstyle": "-|>", "color": "black", "linewidth": 1.1, "shrinkA": 5, "shrinkB": 5}
        ax.annotate("", xy=after, xytext=before, arrowprops=bend | {"connectionstyle": "arc3,rad=-0.25"})
        ax.axhline(0, color=SOFT, linewidth=0.6)
        ax.set(xlim=(-1.5, 1.0), ylim=(-9, 9), xlabel="position of the base $x_0/L$", ylabel=r"$F_x\,L^2/EI$")
        ax.set_title(title, fontsize=9)
        ax.grid(alpha=0.3)
    axs[1].legend(fontsize=8, frameon=False, loc="lower right")
    canvas.savefig(DOCS / "mechanics_fold.png", dpi=150)
    print({kind.name: (event.control, float(event.before.base_x[0]), float(event.after.base_x[0]))
           for kind, event in snaps.items()})  # fmt: skip
    print(steepest(jw.Whisker(), OBJECT))


def main() -> None:
    draw_frame()
    draw_phases()
    draw_springs()
    draw_fold()


if __name__ == "__main__":
    main()
