"""Free whiskers that springs on their shafts may bend: their tips, and their outlines."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxwhisker._base.linear_algebra import solve
from jaxwhisker._equilibrium import contact
from jaxwhisker._equilibrium.contact import BaseEquations, Phase, WhiskerAtObject, material_of, start_of
from jaxwhisker._equilibrium.friction import Friction, slipping_from
from jaxwhisker._equilibrium.shaft_springs import walk
from jaxwhisker._equilibrium.touch import POINTS, Outline

STEPS = 12  # of Newton's method at most; three suffice if the base has not moved far
ACCURACY = 1e-9  # of the tip; convergence is quadratic


def free_contact(
    body: WhiskerAtObject, unloaded: Float[Array, "3"], moved: Float[Array, " axes"], pose: Float[Array, " axes"]
) -> Float[Array, "3"]:
    """The contact (see contact.py) of a free whisker whose base has given coordinates; without derivatives.

    Args:
        body: the whisker.
        unloaded: its contact before any contact with the object.
        moved: change of the base's coordinates since then.
        pose: coordinates of the base.
    """
    body, unloaded, moved, pose = jax.lax.stop_gradient((body, unloaded, moved, pose))
    wanted = jnp.concatenate([pose, jnp.zeros(3 - pose.size)])

    def own(values: BaseEquations) -> Float[Array, "3 *more"]:
        return jnp.stack([values.x, values.y, values.turn])

    def newton(carry):
        z, _, count = carry
        at = contact.linearise(body, z, *_free(body), rates=body.rod)
        step = solve(own(at.by_contact), (wanted - own(at.value))[:, None])[:, 0]
        return z + step, jnp.max(jnp.abs(step)), count + 1

    def searching(carry):
        _, size, count = carry
        return (size > ACCURACY) & (count < STEPS)

    start = unloaded.at[: pose.size].add(moved)
    return jax.lax.while_loop(searching, newton, (start, jnp.asarray(jnp.inf), jnp.asarray(0)))[0]


def _free(body: WhiskerAtObject) -> tuple[Int[Array, ""], Float[Array, ""], Friction | None]:
    """Phase, side and friction of a free whisker."""
    side = jnp.ones_like(body.length)
    return jnp.asarray(int(Phase.free)), side, None if body.friction_angle is None else slipping_from(side)


def outline_of(body: WhiskerAtObject, z: Float[Array, " numbers"]) -> Outline:
    """The outline of a free whisker with this contact; without derivatives."""
    body, z = jax.lax.stop_gradient((body, z))
    assert body.sprung is not None
    start, load, _ = start_of(body, z, *_free(body))
    places, points = body.sprung.held_by.with_places(body.length * jnp.linspace(1.0, 0.0, POINTS))
    walked = walk(start, load, body.length, material_of(body), places, body.laws, body.sprung.drive, steps=1)
    x, y, cos, sin = (values[points[::-1]] for values in walked.passed)
    right, up, across, ahead = x - x[0], y - y[0], cos[0], sin[0]
    return Outline(
        right * ahead - up * across,
        right * across + up * ahead,
        cos * ahead - sin * across,
        cos * across + sin * ahead,
    )
