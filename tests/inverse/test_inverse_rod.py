"""One whisker from its reaction to its contact: every state is recovered, in both phases, and its derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._inverse.inverse_rod import PlaneObservation
from jaxwhisker._inverse.nearest import PhaseCandidate, nearest_state

STATE = 1e-10
DIFFERENCE = 1e-6


def observation(reaction, weight=1.0, side=1.0, angle=0.0, twist=0.0):
    return PlaneObservation(
        jnp.asarray(reaction),
        weight * jnp.ones(3),
        jnp.asarray(angle),
        jnp.asarray(twist),
        jnp.asarray(side),
        jnp.asarray(1.0),
        jnp.asarray(1.0),
        None,
    )


@jax.jit
def estimate(observed):
    return nearest_state(observed)


@jax.jit
def reaction_of(z, tip, observed):
    return observed.state(z, PhaseCandidate(tip, jnp.zeros(()))).reaction


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("pose", [(0.0, 0.0), (0.2, -0.05)])
@pytest.mark.parametrize(
    ("force", "beyond", "tip"), [(1.5, 0.3, True), (0.05, 1.2, True), (6.0, 0.3, False), (18.0, 0.56, False)]
)
def test_states_are_recovered(force, beyond, tip, pose, side):
    angle, twist = pose
    z = jnp.array([force, beyond])
    reaction = reaction_of(z, jnp.asarray(tip), observation(np.zeros(3), side=side, angle=angle, twist=twist))
    assert np.sign(reaction[2]) == side
    near = estimate(observation(reaction, 1e6, side, angle, twist))
    assert bool(near.ok) and bool(near.phase.tip) == tip
    np.testing.assert_allclose(near.y, z, rtol=STATE)
    assert float(near.chi2) < STATE and float(near.doubt) < STATE


def test_tangential_contact_of_a_straight_whisker():
    # mz^2 = 2 EI fy, whatever the force.
    for force in (3.0, 9.0, 20.0):
        _, fy, mz = reaction_of(jnp.array([force, 0.4]), jnp.asarray(False), observation(np.zeros(3)))
        assert float(mz) ** 2 == pytest.approx(2 * float(fy), rel=1e-12)


@pytest.mark.parametrize("tip", [True, False])
def test_derivatives_with_respect_to_the_reaction(tip):
    empty = observation(np.zeros(3))
    side = float(jnp.sign(reaction_of(jnp.array([4.0, 0.3]), jnp.asarray(tip), empty)[2]))
    # Off every possible state, as noise has it.
    reaction = reaction_of(jnp.array([4.0, 0.3]), jnp.asarray(tip), empty) + jnp.array([0.01, -0.02, 0.01])

    @jax.jit
    def z(reaction):
        return nearest_state(observation(reaction, 10.0, side)).y

    by = jax.jacfwd(z)(reaction)
    for k, step in enumerate(DIFFERENCE * np.eye(3)):
        np.testing.assert_allclose(by[:, k], (z(reaction + step) - z(reaction - step)) / (2 * DIFFERENCE), atol=1e-6)
