"""Derivatives of equilibria in space with several contacts, and of events between them."""

import jax
import jax.numpy as jnp
import numpy as np

import pegs
from jaxwhisker._space.contact import SLACK
from jaxwhisker._space_chain.implicit import solved
from pegs_engine import PHASE, contacts, problem

APART = 0.02  # of the control, from the exact state to one on each side
ARCS = np.array([[0.9021012645, 0.3260244677], [0.9341054147, 0.3385434449]])  # of the contacts of these
CHORD = 0.02  # relative error of a slope by a chord


@jax.jit
def slopes(problem, u):
    """Derivatives of the arc lengths from the base to the contacts by the control, in both modes."""

    def arcs(u):
        return problem.length[0] - solved(problem, contacts(), u, PHASE)[:, SLACK]

    return jax.jacfwd(arcs)(u), jax.jacrev(arcs)(u)


def test_contacts_move_with_the_drive_as_between_exact_states():
    forward, reverse = slopes(problem(), jnp.asarray(pegs.CONTROL))
    np.testing.assert_allclose(reverse, forward, rtol=1e-10)
    np.testing.assert_allclose(forward, (ARCS[1] - ARCS[0]) / (-2 * APART), rtol=CHORD)
