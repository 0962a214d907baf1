"""The exact state of a whisker at two pegs, as the equations see it."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import pegs
from engine import dimensionless
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._space.contact import FORCE
from jaxwhisker._space.free import contact_at

PHASE = jnp.full(2, int(Phase.tangential))


def problem() -> Any:
    """The dimensionless problem of the pegs along z."""
    return dimensionless(pegs.scene(pegs.ALONG_Z))


def contacts() -> jax.Array:
    """The contacts of the exact state, from the tip; the first directors of the whisker lie in the plane."""
    rows = []
    for k, peg in enumerate(pegs.scene(pegs.ALONG_Z).objects):
        point = np.array([pegs.CONTACTS["contact_x"][k], pegs.CONTACTS["contact_y"][k], 0.0])
        out = (point - np.array(peg.point)) / float(peg.radius)
        tangent = np.array([-out[1], out[0], 0.0])
        side, beyond = np.cross([0.0, 0.0, -1.0], tangent), 1 - pegs.CONTACTS["contact_arc"][k]
        row = contact_at(*map(jnp.asarray, (point, out, tangent, side, beyond)))
        rows.append(row.at[FORCE].set(pegs.CONTACTS["contact_force"][k]))
    return jnp.stack(rows)
