"""Residuals of the equations of equilibrium, as functions that can be differentiated by everything they depend on.

Newton's method linearises by itself (newton.py); derivatives of results follow from these residuals.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._space.contact import ROLL, TRACTION, SpaceBase, Traction, base_of, in_drive, on_surface
from jaxwhisker._space.newton import Phases
from jaxwhisker._space.problem import Contacts, SpaceProblem, of_each


def residuals(
    problem: SpaceProblem, z: Contacts, u: Scalar, phase: Phases, free: Contacts
) -> tuple[Contacts, Float[Array, "whiskers 6"], SpaceBase]:
    """Residuals of all equations, (whiskers, 11), coordinates of the bases, and the bases themselves.

    The last two residuals of a contact are its tractions, which vanish without friction. `free` are the values of free
    whiskers.
    """
    drive, rows, rates = problem.drive(u), problem.rows, problem.rod.for_rates()
    traction = None if problem.friction is None else Traction(problem.friction, jnp.asarray(False))

    def one(body, z, phase):
        base = base_of(body, problem.surface, problem.rod, z, phase, traction, rates)
        return base, in_drive(base, drive, body.mount, z[ROLL]), on_surface(problem.surface, z)

    base, inside, surface = of_each(problem, one, z, phase)
    touching = (phase != Phase.free)[:, None]
    pose, load = inside.pose, jnp.where(touching, inside.load, problem.on_free)
    rest = jnp.zeros_like(pose)
    if problem.springs is not None:
        rest = rest.at[:, :rows].set(problem.springs.offset + problem.displacement(load[:, :rows]))
    wrong = jnp.where(inside.upright, 0.0, jnp.inf)[:, None]
    own = jnp.concatenate([pose - rest, surface + jax.lax.stop_gradient(wrong), z[:, TRACTION]], axis=1)
    return jnp.where(touching, own, z - free), jnp.where(touching, pose, rest), base
