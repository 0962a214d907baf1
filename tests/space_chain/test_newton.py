"""Newton steps of whiskers in space with several contacts."""

import jax
import jax.numpy as jnp
import numpy as np

import pegs
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point, at_control
from jaxwhisker._space.contact import SLACK
from jaxwhisker._space_chain.newton import newton_step, phases_in_flow, plain, residuals
from pegs_engine import PHASE, contacts, problem

EXACT = 1e-8
OFF = 1e-3  # by which numbers of contacts are changed


@jax.jit
def improved(problem, z, phase):
    step = newton_step(problem, phase, at_control(pegs.CONTROL, z), plain(z), Point(z, jnp.asarray(pegs.CONTROL)))
    better = z + step.step.z
    return better, residuals(problem, better, pegs.CONTROL, phase, better)[0], step


def test_newtons_method_converges_quadratically_to_an_exact_state():
    exact = contacts()
    off = exact.at[:, :9].add(OFF * jnp.asarray(np.random.default_rng(1).uniform(-1, 1, (2, 9))))
    first, _, step = improved(problem(), off, PHASE)
    second, missed, _ = improved(problem(), first, PHASE)
    third, missed, _ = improved(problem(), second, PHASE)
    assert jnp.max(jnp.abs(first - exact)) < 1000 * OFF**2
    np.testing.assert_allclose(third, exact, atol=EXACT)
    np.testing.assert_allclose(missed, 0.0, atol=1e-12)
    assert step.sound
    # The tangent of the path: the drive moves by one.
    assert float(step.tangent.u) == 1.0


def test_a_free_whisker_stays_as_it_is():
    z = jnp.zeros((2, 11))
    step = improved(problem(), z, jnp.zeros(2, int))[2]
    np.testing.assert_array_equal(step.step.z, 0.0)
    assert step.sound


def test_only_the_outermost_contact_changes_its_phase_in_a_flow():
    z = contacts().at[0, SLACK].set(-0.1)
    assert phases_in_flow(z, PHASE).tolist() == [Phase.tip, Phase.tangential]
    assert phases_in_flow(contacts(), PHASE).tolist() == [Phase.tangential, Phase.tangential]
    assert phases_in_flow(z, jnp.zeros(2, int)).tolist() == [Phase.free, Phase.free]
