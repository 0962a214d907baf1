"""Where coarse rods come to rest, against stored exact states after jumps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._chain.coarse_rods import ends_of_shares, links_of, poses_of
from jaxwhisker._chain.newton import evaluate
from jaxwhisker._chain.rod_flow import flow, landing_of, rods_of
from jaxwhisker._chain.stance import shafts_of
from jaxwhisker._equilibrium.contact import Phase, of_each
from several_cases import CASES
from several_engine import of_event, problem, with_contacts

PLACE = 0.02  # lengths: two links
FORCE = 0.2  # relative to the largest force: the rods rest behind the jump, where forces have changed
SHAPE = 2e-4  # lengths: links have the angle at their middle, and 60 of them are off by their length squared
BEHIND = 3e-3  # distance behind a loss of stability


def rest(problem, u, z, state, behind):
    """The contacts of rods at rest, from the shape of this state."""
    load = evaluate(problem, z, u, state).load
    rods = rods_of(problem, u, shafts_of(problem, u, problem.rest, z, state), load, None)
    end = flow(problem, u, u - behind, rods, jnp.asarray(True))
    return end, landing_of(problem, u - behind, end)


def compare(landing, contacts):
    """Compare a landing with stored contacts."""
    assert bool(landing.settled) and not bool(landing.too_many)
    assert int(jnp.sum(landing.state.touches)) == len(contacts)
    for (f, p, slack), phase, contact in zip(landing.z, landing.state.phase, contacts[::-1], strict=False):
        _, _, kind, force, arc, x, _ = contact
        assert int(phase) == kind
        assert abs(float(f) - force) < FORCE * max(c[3] for c in contacts)
        assert abs(float(p) - x) < PLACE
        if kind == Phase.tangential:
            assert abs(1 - float(slack) - arc) < PLACE


@pytest.mark.parametrize("count", [1, 2])
def test_rods_stay_in_a_stable_state(count):
    case = CASES["wavy"]
    own = with_contacts(count)
    _, landing = jax.jit(rest)(problem(), *own, jnp.asarray(0.0))
    compare(landing, case["contacts"][case["control"].index(float(own.u))])


@pytest.mark.parametrize("number", range(6))
def test_rods_fall_into_the_state_after_a_jump(number):
    event = [event for event in CASES["wavy"]["events"] if "after" in event][number]
    end, landing = jax.jit(rest)(problem(), *of_event(event), jnp.asarray(BEHIND))
    compare(landing, event["after"]["contacts"])
    assert bool(end.rests)


def test_nothing_flows_unless_it_begins():
    u, z, state = with_contacts(1)

    def still(problem, u, z, state):
        load = evaluate(problem, z, u, state).load
        rods = rods_of(problem, u, shafts_of(problem, u, problem.rest, z, state), load, None)
        return rods, flow(problem, u, u, rods, jnp.asarray(False))

    before, after = jax.jit(still)(problem(), u, z, state)
    np.testing.assert_array_equal(before.angle, after.angle)
    assert int(after.steps) == 0


def test_rods_begin_with_the_shape_of_the_shaft():
    u, z, state = with_contacts(2)

    def ends(problem, u, z, state):
        shafts = shafts_of(problem, u, problem.rest, z, state)
        rods = rods_of(problem, u, shafts, evaluate(problem, z, u, state).load, None)
        own = of_each(problem.bodies(u), links_of)
        each = jax.vmap(ends_of_shares)(own, rods.angle, poses_of(problem, rods.springs))
        return each[0, -1], jnp.stack([shafts.x[0, 0, 0], shafts.y[0, 0, 0]])

    tip, expected = jax.jit(ends)(problem(), u, z, state)
    np.testing.assert_allclose(tip, expected, rtol=0, atol=SHAPE)
