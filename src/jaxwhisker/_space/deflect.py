"""Deflection of one clamped whisker under given loads in space."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.rotation import matrix_of
from jaxwhisker._equilibrium.line_loads import Gravity, weight_of
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._path.deflection import ROD_STEPS, AbstractLoadCase, deflected
from jaxwhisker._rod.space import curvature
from jaxwhisker._space.given import GivenInSpace
from jaxwhisker._space.loaded import LoadedInSpace, loaded_in_space, walked


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
    loads: GivenInSpace  # with the weight, if `gravity` is given


class SpaceLoadCase(AbstractLoadCase):
    """A whisker in space, clamped upright at the origin, and its loads."""

    whisker: Whisker
    loads: GivenInSpace

    def equations(self) -> LoadedInSpace:
        """The equations."""
        return loaded_in_space(self.whisker, self.loads)

    def valid(self, rods: LoadedInSpace) -> Bool[Array, ""]:
        """Whether all numbers are in their domains."""
        valid = self.whisker.valid() & checks.all_finite((rods.loads, rods.section))
        valid &= jnp.all((rods.loads.position > 0) & (rods.loads.position <= 1))
        for line in rods.lines:
            valid &= line.inside
        return valid

    def values(self, rods: LoadedInSpace, unknowns: Array, points: int) -> dict[str, Array]:
        """Fields of a SpaceDeflection."""
        length, stiffness = self.whisker.length, self.whisker.base_stiffness
        found = walked(unknowns, rods, 1.0, np.linspace(0.0, 1.0, points), -(-ROD_STEPS // (points - 1)))
        # The last point of each stretch is the first one of the next.
        kept = [k for k in range(found.s.size) if k % points != points - 1 or k == found.s.size - 1][::-1]
        known = found.s, found.states, found.loads
        s, states, loads = jax.tree.map(lambda leaf: jnp.take(leaf, np.array(kept), mode="clip"), known)
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


def deflect_in_space(
    whisker: Whisker, loads: GivenInSpace, support: Support, gravity: Gravity | None, points: int
) -> SpaceDeflection:
    """Deflect a clamped whisker in space; see `deflect`, which checks the other arguments.

    Raises:
        ValueError: if the whisker is not clamped upright at the origin.
    """
    if support != Support.clamped():
        checks.fail("support", "an upright clamp in space: springs and mounts act in the plane only", repr(support))
    if gravity is not None:
        loads = (*loads, *weight_of(whisker, gravity if len(gravity) == 3 else (*gravity, 0.0)))
    whisker, loads = jax.tree.map(checks.as_float, (whisker, loads))
    values = deflected(SpaceLoadCase(whisker.without_masses(), loads), points)
    return SpaceDeflection(**values, whisker=whisker, loads=loads)
