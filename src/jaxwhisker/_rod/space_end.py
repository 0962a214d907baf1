"""The rod in space between contact and base, in the frame of the contact, with derivatives.

The contact is the origin, x runs along the object and z along its outward normal, and the force on the rod acts along
z. Forward derivatives with respect to any number of parameters need only three changes of the state along the rod, due
to force, angle and roll. A longer uniform rod is the same rod with another piece at its base. If the rod is not
uniform, it has another piece at its contact, and this is a fourth change.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.quaternions import Quaternion, opposite, product, third_axis, times, total, turned
from jaxwhisker._base.types import Scalar
from jaxwhisker._rod.space import Change, SpaceLoad, SpaceSection, SpaceState, curvature, integrate, with_changes

SpaceEnd = Float[Array, "7"]  # position, and the quaternion of the rotation, at the base


def contact_rotation(chi: Scalar, gamma: Scalar) -> Quaternion:
    """Rotation of the rod at the contact.

    Args:
        chi: angle between the rod and the object, rad; positive if the tip points into the object.
        gamma: roll about the tangent, rad. At 0, d2 is the y axis.
    """
    half = chi / 2 + jnp.pi / 4
    c, s, cos, sin = jnp.cos(half), jnp.sin(half), jnp.cos(gamma / 2), jnp.sin(gamma / 2)
    return c * cos, s * sin, s * cos, c * sin


def _contact(force: Scalar, chi: Scalar, gamma: Scalar) -> tuple[SpaceState, SpaceLoad]:
    zero = jnp.zeros(())
    return ((zero, zero, zero), contact_rotation(chi, gamma)), SpaceLoad((None, None, force))


def _end(force: Scalar, arc: Scalar, chi: Scalar, gamma: Scalar, section: SpaceSection, steps: int) -> SpaceEnd:
    start, load = _contact(force, chi, gamma)
    r, q = integrate(start, arc, load, section, steps=steps, from_base=arc)
    return jnp.stack([*r, *q])


@eqx.filter_custom_jvp
def space_rod_end(
    force: Scalar, arc: Scalar, chi: Scalar, gamma: Scalar, section: SpaceSection, steps: int, rate_steps: int
) -> SpaceEnd:
    """End of the rod at its base.

    Args:
        force: force on the rod along z.
        arc: arc length from the base to the contact.
        chi: see `contact_rotation`.
        gamma: see `contact_rotation`.
        section: stiffness and intrinsic curvature.
        steps: number of steps.
        rate_steps: number of steps for derivatives.
    """
    del rate_steps
    return _end(force, arc, chi, gamma, section, steps)


@space_rod_end.def_jvp
def _(primals, tangents):
    force, arc, chi, gamma, section, steps, rate_steps = primals
    end, slopes = _end_and_slopes(force, arc, chi, gamma, section, rate_steps)
    terms = [slope * dot for slope, dot in zip(slopes, tangents, strict=False) if dot is not None]
    if jax.tree.leaves(tangents[4]):

        def by_section(section):
            return _end(force, arc, chi, gamma, section, rate_steps)

        terms.append(eqx.filter_jvp(by_section, (section,), (tangents[4],))[1])
    return end if steps == rate_steps else space_rod_end(*primals), total(*terms)


def longer(state: SpaceState, load: SpaceLoad, section: SpaceSection, s: Scalar) -> Change:
    """Change of a state towards the base, per arc length."""
    q = state[1]
    return opposite(third_axis(q)), opposite(turned(q, curvature(state, load, section, s)))


def _end_and_slopes(
    force: Scalar, arc: Scalar, chi: Scalar, gamma: Scalar, section: SpaceSection, steps: int
) -> tuple[SpaceEnd, list[SpaceEnd]]:
    """The end, and its derivatives with respect to force, arc, chi and gamma."""
    start, load = _contact(force, chi, gamma)
    zero, one = jnp.zeros(()), jnp.ones(())
    still = zero, zero, zero
    by_force, by_chi, by_gamma = (still, still), (still, (zero, one, zero)), (still, third_axis(start[1]))
    changes = [by_force, by_chi, by_gamma]
    if not section.uniform:
        changes.append(longer(start, load, section, arc))
    first = jax.tree.map(lambda *parts: jnp.stack(parts), *changes)
    by_load = SpaceLoad((None, None, jnp.eye(len(changes))[0]))
    end, last = with_changes(start, (first, by_load), arc, load, section, steps=steps, from_base=arc)
    changes = [jax.tree.map(lambda leaf, k=k: leaf[k], last) for k in range(len(changes))]
    if section.uniform:
        changes.append(longer(end, load, section, zero))
    r, q = end
    by_force, by_chi, by_gamma, by_arc = (
        jnp.stack([*r, *product((None, *times(0.5, turn)), q)]) for r, turn in changes
    )
    return jnp.stack([*r, *q]), [by_force, by_arc, by_chi, by_gamma]
