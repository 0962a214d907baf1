"""Deflection of one clamped whisker under given forces in space."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.implicit import solution_of
from jaxwhisker._base.leaves import safe_placeholder
from jaxwhisker._base.load_path import follow
from jaxwhisker._base.program import Program
from jaxwhisker._base.rotation import matrix_of
from jaxwhisker._model.loads import PointForce, SpaceForce
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._path.path import Status
from jaxwhisker._rod.space import curvature
from jaxwhisker._space.loaded import ROD_STEPS, LoadedInSpace, checks_of, loaded_in_space, misfit, walked

ACCURACY = 1e-8  # largest accepted error of the base's rotation and position, by comparison with twice as many steps
UNEVEN_ACCURACY = 1e-4  # of whiskers with functions of arc length

Forces = tuple[PointForce | SpaceForce, ...]


class SpaceDeflection(eqx.Module):
    """A whisker deflected in space: support reaction, and its shape at arc lengths s from the base.

    Values are in the units of the whisker. All of them are NaN unless `status` is `Status.ok`. In the plane, the
    curvature about d2 is the opposite of that of a Deflection, since d2 points along -z.

    Examples:
        >>> bent = jw.deflect(jw.Whisker(), jw.SpaceForce(-1.0, 0.0, 0.5))
        >>> print(bent.status == jw.Status.ok, bent.rotation.shape)
        True (101, 3, 3)
    """

    fx: Float[Array, ""]  # support reaction on the whisker: force along +x
    fy: Float[Array, ""]  # force along +y
    fz: Float[Array, ""]  # force along +z
    mx: Float[Array, ""]  # moment at the base about x, force times length
    my: Float[Array, ""]  # moment about y
    mz: Float[Array, ""]  # moment about z, as in the plane
    s: Float[Array, " points"]  # arc length from the base
    x: Float[Array, " points"]  # position, a length
    y: Float[Array, " points"]
    z: Float[Array, " points"]
    rotation: Float[Array, "points 3 3"]  # columns d1, d2 and tangent; at the base x, -z and y
    curvature: Float[Array, "points 3"]  # about d1 and d2, and twist, 1/length
    status: Int[Array, ""]  # Status.ok, .unstable, .inexact or .invalid
    whisker: Whisker
    loads: Forces


def deflect_in_space(
    whisker: Whisker, loads: tuple, support: Support, gravity: tuple | None, points: int
) -> SpaceDeflection:
    """Deflect a clamped whisker in space; see `deflect`, which checks the types of the arguments.

    Raises:
        ValueError: if a load is not a dead force, or the whisker is not clamped upright at the origin.
    """
    if gravity is not None:
        checks.fail("gravity", "absent for a whisker in space: distributed loads act in the plane only", gravity)
    for load in loads:
        if not isinstance(load, PointForce | SpaceForce):
            checks.fail("loads", "forces in space: moments and line loads act in the plane only", repr(load))
        if isinstance(load, PointForce) and load.follower:
            checks.fail("loads", "dead loads in space: followers act in the plane only", repr(load))
    if support != Support.clamped():
        checks.fail("support", "an upright clamp in space: springs and mounts act in the plane only", repr(support))
    whisker, loads = jax.tree.map(checks.as_float, (whisker, loads))
    return SpaceDeflection(**_deflect(whisker.without_masses(), loads, points), whisker=whisker, loads=loads)


def _solution(whisker: Whisker, loads: Forces) -> tuple[Array, Int[Array, ""]]:
    """Unknowns and status."""
    rods = loaded_in_space(whisker, loads)
    path = follow(lambda top, share: misfit(top, rods, share), jnp.zeros(3), rods.load)
    found = checks_of(rods, path.unknowns, path.share)
    valid = whisker.valid() & checks.all_finite((rods.force, rods.position, rods.section))
    valid &= jnp.all((rods.position > 0) & (rods.position <= 1))
    by_steps = ACCURACY if rods.section.uniform else UNEVEN_ACCURACY
    exact = (found.residual < ACCURACY) & (found.by_steps < by_steps) & ((path.share == 1) | path.lost)
    status = jnp.where(exact, jnp.where(found.stable & ~path.lost, Status.ok, Status.unstable), Status.inexact)
    return path.unknowns, jnp.where(valid, status, Status.invalid)


@Program
def _deflect(whisker: Whisker, loads: Forces, points: int) -> dict[str, Array]:
    top, status = _solution(*jax.lax.stop_gradient((whisker, loads)))
    ok = status == Status.ok
    whisker, loads = safe_placeholder((whisker, loads), ok)
    rods = loaded_in_space(whisker, loads)
    top = solution_of(misfit, jnp.where(ok, top, 0.0), rods)
    values = _shape(rods, top, whisker, points)
    return {name: jnp.where(ok, value, jnp.nan) for name, value in values.items()} | {"status": status}


def _shape(rods: LoadedInSpace, top: Array, whisker: Whisker, points: int) -> dict[str, Array]:
    """Reaction and shape at `points` points on each stretch between forces."""
    length, stiffness = whisker.length, whisker.base_stiffness
    found = walked(top, rods, 1.0, np.linspace(0.0, 1.0, points), -(-ROD_STEPS // (points - 1)))
    # The last point of each stretch is the first one of the next.
    kept = [k for k in range(found.s.size) if k % points != points - 1 or k == found.s.size - 1][::-1]
    s, states, loads = jax.tree.map(lambda leaf: leaf[jnp.array(kept)], (found.s, found.states, found.loads))
    along = jax.vmap(lambda state, load, s: jnp.stack(curvature(state, load, rods.section, s)))(states, loads, s)
    base = found.end[0]
    force, moment = (jnp.stack(part) for part in (found.load.force, found.load.moment_at(base)))
    reaction = [*(-force * stiffness / length**2), *(-moment * stiffness / length)]
    place = [(r - own) * length for r, own in zip(states[0], base, strict=True)]
    return {
        **dict(zip(("fx", "fy", "fz", "mx", "my", "mz"), reaction, strict=True)),
        "s": s * length,
        **dict(zip(("x", "y", "z"), place, strict=True)),
        "rotation": matrix_of(states[1]),
        "curvature": along / length,
    }
