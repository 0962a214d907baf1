"""Draw the figures of docs/several_contacts.md: python figures/several_contacts.py

Writes docs/several_contacts_groove.png and several_contacts_texture.png.
"""

from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot

import jaxwhisker as jw
from jaxwhisker.plot import COLOURS

DOCS = Path(__file__).parents[1] / "docs"
GROOVE = (0.15, 0.2, 0.5, 0.8)
STATES = (0.75, 0.18, -0.1, -0.45), (-0.6, -1.03, -1.06, -1.25, -1.38)  # drive positions: on the way in and out
TEXTURES = (0.1, 0.2, 0.4)  # wavelengths
STEEPNESS, DISTANCE, BEND = 0.2, 0.4, 0.5
CONTROL = np.linspace(1.2, -1.6, 2801)


class Waves(eqx.Module):
    """A wave on a parabola, with a valley at x = 0. The object is above it."""

    distance: float
    depth: float  # of the valleys
    wavelength: float
    bend: float

    def __call__(self, x):
        valley = (1 + jnp.cos(2 * jnp.pi * x / self.wavelength)) / 2
        return self.distance + self.depth * valley + self.bend * x**2


def build(distance: float, depth: float, wavelength: float, bend: float) -> jw.Scene:
    """The scene of the page."""
    return jw.Scene(jw.Whisker(), jw.Graph(Waves(distance, depth, wavelength, bend)), contacts=2)


def texture(wavelength: float) -> jw.Scene:
    """A texture, whose waves are as steep at any wavelength."""
    return build(DISTANCE, STEEPNESS * wavelength, wavelength, BEND)


def draw() -> None:
    """Draw all figures."""
    groove()
    textures()


def contacts_over(ax, result: jw.Result, quantity: str) -> None:
    """A quantity of both contacts over the drive position, one colour each; numbers of contacts change at gaps."""
    control, phase = np.asarray(result.control), np.asarray(result.phase)[:, 0]
    changes = np.append(False, np.any(np.diff(phase > 0, axis=0), axis=1))
    for k, name in enumerate(("outermost contact", "second contact")):
        values = np.where(phase[:, k] > 0, np.asarray(getattr(result, quantity))[:, 0, k], np.nan)
        ax.plot(control, np.where(changes, np.nan, values), color=COLOURS[k], linewidth=1.4, label=name)


def mark_snaps(ax, result: jw.Result) -> None:
    """Moments before and after all jumps."""
    snaps = result.events.of(jw.EventKind.snap_through) + result.events.of(jw.EventKind.snap_off)
    for k, event in enumerate(snaps):
        both = [float(side.mz[0]) for side in (event.before, event.after)]
        ax.plot([event.control] * 2, both, color="black", linewidth=0.8, linestyle=":")
        ax.plot(event.control, both[0], "ko", markersize=4, label=None if k else "before a jump")
        ax.plot(event.control, both[1], "wo", markeredgecolor="black", markersize=4, label=None if k else "after it")


def groove() -> None:
    """States of a whisker across a groove; the moment at its base, and the contact forces."""
    figure = pyplot.figure(figsize=(9, 7.6), layout="constrained")
    result = jw.scan(build(*GROOVE))
    grid = figure.add_gridspec(3, 2, height_ratios=(1.5, 1, 1))
    for k, states in enumerate(STATES):
        ax = figure.add_subplot(grid[0, k])
        jw.plot.shapes(result, states, ax=ax)
        ax.set(xlim=(-1.5, 1.15), ylim=(-0.1, 1.05))
    control = np.asarray(result.control)
    middle = figure.add_subplot(grid[1, :])
    middle.plot(control, np.asarray(result.mz)[:, 0], color="0.2", linewidth=1.4)
    mark_snaps(middle, result)
    middle.set(ylabel="$m_z L / EI$")
    below = figure.add_subplot(grid[2, :], sharex=middle)
    contacts_over(below, result, "contact_force")
    below.set(xlabel="drive position $u / L$", ylabel="$f L^2 / EI$", xlim=(1.0, -1.6))
    two = (np.asarray(result.phase)[:, 0] > 0).all(axis=1)
    for ax in (middle, below):
        ax.fill_between(
            control, 0, 1, where=two, transform=ax.get_xaxis_transform(), color="0.9", linewidth=0, zorder=0
        )
        ax.legend(fontsize=8)
    figure.savefig(DOCS / "several_contacts_groove.png", dpi=110)


def textures() -> None:
    """The places of contacts on a texture, and the moment for several wavelengths."""
    figure, axs = pyplot.subplots(len(TEXTURES), 2, figsize=(10, 7.5), sharex=True, layout="constrained")
    for wavelength, (left, right) in zip(TEXTURES, axs, strict=True):
        result = jw.scan(texture(wavelength), CONTROL)
        for crest in np.arange(-20, 20) + 0.5:
            left.axhline(crest * wavelength, color="0.85", linewidth=0.8, zorder=0)
        contacts_over(left, result, "contact_x")
        left.set(ylim=(-1.0, 1.15), ylabel="contact $x / L$")
        right.plot(np.asarray(result.control), np.asarray(result.mz)[:, 0], color="0.2", linewidth=1.2)
        mark_snaps(right, result)
        right.set(ylabel="$m_z L / EI$")
        for ax in (left, right):
            ax.set_title(f"wavelength {wavelength} L", fontsize=10)
    axs[0, 0].legend(fontsize=8)
    axs[0, 0].set_xlim(1.2, -1.6)
    for ax in axs[-1]:
        ax.set_xlabel("drive position $u / L$")
    figure.savefig(DOCS / "several_contacts_texture.png", dpi=110)


if __name__ == "__main__":
    draw()
