"""Lengths of steps: before objects, where curvatures change, and before losses; folds and bifurcations."""

# pyright: reportArgumentType=false
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._space.contact import POINT, UNKNOWNS
from jaxwhisker._space.step_length import FOLD, LOSS_BRACKET, branches, longest_step, step_to_loss

pytestmark = pytest.mark.unchecked  # stand-ins have only the fields that are used
EXACT = 1e-12
CAPSULE = jw.Capsule(0.2, (0.0, 0.9, -1.0), (0.0, 0.9, 1.0))


def longest(phase, way=(0.0, 0.0, 0.5), surface=CAPSULE, rate=0.5, speed=2.0, advance=0.3):
    """The longest step of a whisker below the middle of an object, whose contact moves this way."""
    problem = dimensionless(jw.SpaceScene(jw.Whisker(), surface))
    z = jnp.zeros((1, UNKNOWNS)).at[0, POINT].set(np.array([0.0, 0.7, 0.0]))
    tangent = Point(jnp.zeros_like(z).at[0, POINT].set(np.array(way)), jnp.asarray(rate))
    state = jnp.array([int(phase)])
    stance = SimpleNamespace(speed=speed, advance=jnp.array([advance]), free=state == Phase.free)
    march = SimpleNamespace(phase=state, point=Point(z, jnp.zeros(())), tangent=tangent)
    return float(longest_step(problem, march, stance))


def test_free_whiskers_do_not_pass_through_the_object():
    np.testing.assert_allclose(longest(Phase.free), 0.3 / (2.0 * 0.5), rtol=EXACT)


def test_contacts_stop_where_the_curvature_begins_to_change():
    np.testing.assert_allclose(longest(Phase.tangential), (1.0 - 0.1 * 0.2) / 0.5, rtol=EXACT)
    assert longest(Phase.tangential, way=(0.5, 0.0, 0.0)) > 1e9
    assert longest(Phase.tangential, surface=jw.Sphere(0.2, (0.0, 0.9, 0.0))) == np.inf


@pytest.mark.parametrize(
    ("before", "after", "forks"),
    [(0.5, 0.4, True), (0.5, -0.5, False), (FOLD / 2, FOLD / 3, False), (-0.5, -0.4, True), (-0.5, 0.5, False)],
)
def test_at_a_fold_the_control_turns_back_or_rests(before, after, forks):
    march, trial = (SimpleNamespace(tangent=Point(jnp.zeros((1, 3)), jnp.asarray(rate))) for rate in (before, after))
    assert bool(branches(march, trial)) is forks


def test_false_position_leads_to_a_loss():
    def step(size, unstable_size, unstable_at):
        sizes = {"size": size, "unstable_size": unstable_size, "unstable_at": unstable_at}
        return float(step_to_loss(SimpleNamespace(**{k: jnp.asarray(v) for k, v in sizes.items()})))

    assert step(3.0, -1.0, 0.4) == pytest.approx(0.3)
    assert step(1e-9, -1.0, 0.4) == pytest.approx(0.02 * 0.4)
    assert step(1.0, jnp.nan, 0.4) == pytest.approx(0.5 * 0.4)
    assert step(3.0, -1.0, LOSS_BRACKET / 2) == LOSS_BRACKET / 2
