"""Tactile images: signals over drive position and lateral offset, and the heights of the object at the same places."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._base.types import Control
from jaxwhisker._model.drives import LinearDrive
from jaxwhisker._model.motion import Translation
from jaxwhisker._model.space_scene import SpaceScene
from jaxwhisker._model.surface import AbstractSurface, Point
from jaxwhisker._scan.quantities import unit_in_words
from jaxwhisker._scan.space import problem_now
from jaxwhisker._space.problem import SpaceProblem
from jaxwhisker._space.stance import bases_at_rest
from jaxwhisker._study.parameters import parameters_of
from jaxwhisker._study.structure import layout_of_scenes
from jaxwhisker._study.study import OPTIONS, study

if TYPE_CHECKING:
    import xarray as xr

FAR = 8.0  # lengths of the first whisker: height above the bases up to which the object is searched for
HALVINGS = 55  # of that range: to rounding


@with_own_settings
def tactile_image(
    build: Callable[..., SpaceScene], *, control: Control | None = None, **arguments: Any
) -> "xr.Dataset":
    """Scan an object in space along parallel lines: images of the signals and of the object.

        def build(offset):
            drive = jw.LinearDrive(direction=(1.0, 0.0, 0.0), origin=(0.0, 0.0, offset))
            return jw.Scene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.0)), motion=drive)

        data = jw.tactile_image(build, offset=np.linspace(-0.6, 0.6, 25), control=np.linspace(-1.2, 1.2, 97))

    Args:
        build: makes a scene in space from a lateral offset, a length, under any name. Its drive moves along a line.
        control: drive positions, shape (steps,), as in `study`.
        **arguments: the values of the offset under its name, and options of `study`: outputs, channels, derivatives,
            store, client, memory, progress.

    Returns:
        The Dataset of `study` with the dimensions of the offset, `control` and `whisker`, and another variable,
        `object_height`: y of the lowest point of the object straight above each unloaded base. It is NaN where there is
        none up to 8 lengths above the base, and where the base is inside the object.

    Raises:
        ValueError: if `build` does not return scenes in space whose motion is a Translation or a LinearDrive, if
            `arguments` do not have the values of one parameter of `build`, or if an argument of `study` is wrong;
            raised before any scan.
        ImportError: if a package is missing: `pip install jaxwhisker[study]`.

    After Merker, Steigenberger, Marangoni and Behn (Sensors 2021, 21, 1572).
    """
    checks.float64_mode()
    for name in ("points", "summary"):
        if name in arguments:
            raise ValueError(f"`{name}` must be left out: an image has a value at each offset and drive position.")
    offsets = {name: values for name, values in arguments.items() if name not in OPTIONS}
    if len(offsets) != 1:
        raise ValueError(
            "`arguments` must have the values of one parameter of `build`, such as offset=np.linspace(-0.4, 0.4, 41), "
            f"got {', '.join(offsets) or 'none'}."
        )
    layout = layout_of_scenes(build, parameters_of(build, None, offsets, OPTIONS))
    ((name, values),) = offsets.items()

    def at(value: Any, positions: Any) -> Float[Array, "steps whiskers"]:
        return _heights(problem_now(_checked(build(**{name: value}))), positions)

    jax.eval_shape(at, jnp.zeros(()), jnp.zeros(1))  # raises the errors of scenes
    data = study(build, control=control, **arguments)
    heights = jax.vmap(partial(at, positions=jnp.asarray(data.control.values)))(jnp.asarray(values, dtype=float))
    length = {"units": unit_in_words("length", layout.dimensionless)}
    described = {"long_name": "height of the object"} | length
    return data.assign_coords({
        name: (name, np.asarray(values, dtype=float), data[name].attrs | length),
        "whisker": ("whisker", np.arange(1, layout.whiskers + 1), {"long_name": "number of the whisker", "units": "1"}),
    }).assign(object_height=((name, "control", "whisker"), np.asarray(heights), described))  # fmt: skip


def _checked(scene: Any) -> SpaceScene:
    if not isinstance(scene, SpaceScene):
        checks.fail("build", "a function that returns scenes in space", f"one of a scene in the plane: {scene}")
    if not isinstance(scene.motion, (Translation, LinearDrive)):
        allowed = "a function that returns scenes whose motion is a Translation or a LinearDrive"
        checks.fail("build", allowed, f"one whose motion is {scene.motion}")
    for one in scene.objects:
        if not one.is_convex:
            checks.fail("build", "a function that returns scenes with convex objects", f"one with a {one}")
    return scene


@Program
def _heights(problem: SpaceProblem, control: Float[Array, " steps"]) -> Float[Array, "steps whiskers"]:
    """Height of the lowest point of the object straight above each unloaded base, a length of the scene."""

    def at(u):
        def lowest(base: Point) -> Float[Array, ""]:
            return jnp.nanmin(problem.surface.of_each(lambda one: _lowest(one, base)))

        return jax.vmap(lowest)(bases_at_rest(problem, u).position)

    heights = jax.vmap(at)(control / problem.unit.control)
    return jnp.where(problem.valid, problem.unit.length * heights, jnp.nan)


def _lowest(surface: AbstractSurface, base: Point) -> Float[Array, ""]:
    """Height of the lowest point of a convex object straight above a point; NaN if there is none."""

    def last(holds: Callable, low, high):
        """Up to which height between two a condition holds."""

        def halve(_, ends):
            middle = (ends[0] + ends[1]) / 2
            goes_on = holds(base.at[1].set(middle))
            return jnp.where(goes_on, middle, ends[0]), jnp.where(goes_on, ends[1], middle)

        return jax.lax.fori_loop(0, HALVINGS, halve, (low, high))[1]

    deepest = last(lambda x: surface.gradient(x)[1] < 0, base[1], base[1] + FAR)
    height = last(lambda x: surface.level(x) > 0, base[1], deepest)
    above = (surface.level(base) > 0) & (surface.level(base.at[1].set(deepest)) < 0)
    return jnp.where(above, height, jnp.nan)
