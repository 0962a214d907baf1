"""Stability: the network against dense eigenvalues, whiskers across their clamped fold, slopes of the loads."""

import equinox as eqx
import exact
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxwhisker as jw
from engine import dimensionless
from exact_contacts import branch, contacts, fb_control, scene
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.newton import newton_step
from jaxwhisker._equilibrium.point import Point, at_control
from jaxwhisker._equilibrium.stability import is_stable, load_slopes, network_is_stable, on_stable_branch

SLOPE = 1e-8  # relative, of the clamped force's slope: a derivative of Chebyshev series that are good to 1e-12
SYMMETRIC = 1e-10  # relative to the largest slope
UNDECIDED = 1e-6  # eigenvalues this near to zero are neither

BETWEEN = ((0, 1), (1, 2), (2, 3), (0, 2), (0, 3))


@Program
def linearised(problem, z, phase, side, u):
    """Everything that stability is judged by, at a contact."""
    state = ContactState(phase, side)
    at = newton_step(problem, state, at_control(u, z), Point(z, u)).condensed
    return at, load_slopes(problem, state, at), on_stable_branch(problem, state, at.by_x), is_stable(problem, state, at)


def fb(p, stiffness=70.0, side=1.0):
    """FB at a contact of the clamped branch, on the near or on the far side."""
    at = contacts(p)
    z = jnp.asarray(at.z * [1.0, side, 1.0])
    return linearised(
        dimensionless(scene(jw.Support.fb(stiffness))), z, jnp.asarray(at.phase), jnp.full(1, side), jnp.asarray(0.0)
    )


@pytest.mark.parametrize("rigid", [(), (0,), (1, 3)], ids=["soft", "one rigid spring", "a rigid loop"])
def test_a_network_is_stable_where_its_stiffness_exceeds_the_slopes(rigid):
    rng = np.random.default_rng(7)
    stiffness = np.exp(rng.uniform(np.log(3.0), np.log(300.0), (40, 5)))
    stiffness[:, rigid] = np.inf
    slopes = rng.uniform(-20.0, 60.0, (40, 3))
    rest_length = [0.2, 0.2, 0.2, 0.4, 0.6]
    problem = dimensionless(scene(jw.Support.fbfbfbr(70.0, rest_length)))

    @Program
    @jax.vmap
    def stable(stiffness, slopes):
        flexibility = jw.Support.named("FBFBFBR", stiffness, rest_length).flexibility()
        return network_is_stable(eqx.tree_at(lambda p: p.flexibility, problem, flexibility), slopes[:, None, None])

    least = []
    for own, slope in zip(stiffness, slopes, strict=True):
        keys = ("between", "stiffness", "rest_length")
        springs = [dict(zip(keys, values, strict=True)) for values in zip(BETWEEN, own, rest_length, strict=True)]
        network = exact._Network(springs)  # K of the motions that rigid springs allow
        hessian = network.stiffness - network.tie.T @ (slope[:, None] * network.tie)
        least.append(np.linalg.eigvalsh(hessian).min(initial=np.inf))
    expected = np.array(least) > 0
    assert np.min(np.abs(least)) > UNDECIDED
    assert 5 < np.sum(expected) < 35  # both outcomes
    assert np.array_equal(stable(jnp.asarray(stiffness), jnp.asarray(slopes)), expected)


def test_without_springs_nothing_but_the_whisker_can_lose_stability():
    clamped = dimensionless(scene(jw.Support.clamped()))
    assert network_is_stable(clamped, jnp.full((1, 1, 1), 1e9))


@pytest.mark.parametrize("p", [0.2, 0.6, 1.3, 2.6])
def test_the_slope_of_the_load_is_that_of_the_clamped_force(p):
    _, slope, _, _ = fb(p)
    _, _, dx, dforce = branch().piece(p)(p)
    np.testing.assert_allclose(slope[0, 0, 0], dforce / dx, rtol=SLOPE)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_clamped_branch_ends_at_its_fold(side):
    fold = branch().fold
    for p, stable in ((0.1, True), (fold - 1e-3, True), (fold + 1e-3, False)):
        at, _, own, whole = fb(p, 1e5, side)
        assert own.tolist() == [stable]
        assert bool(whole) == stable
        assert (at.by_x[0] * side < 0) == stable
    at, *_ = fb(fold, side=side)
    assert abs(at.by_x[0]) < 1e-7  # the root of a function whose value is known to 1e-12 and whose slope is near 1


def test_a_spring_loses_stability_where_it_is_no_stiffer_than_the_clamped_force():
    # Between these parameters, before the vertex, the slope of the clamped force grows from 9 to 25.
    def excess(p):
        _, _, dx, dforce = branch().piece(p)(p)
        return float(dforce / dx - 20.0)

    lost = float(brentq(excess, 0.67, 0.77, xtol=1e-14))  # pyright: ignore[reportArgumentType]
    for p, stable in ((lost - 1e-4, True), (lost + 1e-4, False)):
        _, slope, own, whole = fb(p, 20.0)
        assert own.all() and bool(whole) == stable, slope
    # There the drive turns back: its control has an extremum.
    controls = [fb_control(lost + step, 20.0) for step in (-1e-3, 0.0, 1e-3)]
    assert controls[0] > controls[1] < controls[2]


def test_free_whiskers_are_stable():
    problem, none = dimensionless(scene(jw.Support.fb(70.0))), jnp.zeros((1, 3))
    _, slope, _, stable = linearised(problem, none, jnp.zeros(1, int), jnp.ones(1), jnp.asarray(2.0))
    assert Phase.free == 0 and stable
    assert np.all(slope == 0)


def test_slopes_in_the_plane_are_symmetric():
    problem = dimensionless(scene(jw.Support.follicle(x=70.0, y=500.0, phi=20.0, mount=jw.Mount(0.1, 0.0, 0.2))))
    for force, slope, slack in ((3.0, 0.4, 0.2), (1.2, -0.7, -0.3)):
        phase = Phase.tangential if slack > 0 else Phase.tip
        z = jnp.array([[force, slope, slack]])
        _, slopes, _, _ = linearised(problem, z, jnp.array([int(phase)]), jnp.ones(1), jnp.asarray(0.3))
        size = np.max(np.abs(slopes))
        assert size > 1
        np.testing.assert_allclose(slopes[0], slopes[0].T, atol=SYMMETRIC * size)


def test_the_stability_of_coupled_shafts_is_judged_without_lapack():
    # Two batches in LAPACK at the same time would wait for each other forever.
    bases = jw.Spring((0, 1), 70.0, 0.2), jw.Spring((1, 2), 70.0, 0.2)
    support = jw.Support((*bases, jw.Spring((1, 2), 10.0, 0.2, axis="axial", at=(0.3, 0.3))))
    problem = dimensionless(jw.Scene(jw.Whisker(), jw.Parabola(0.2), support))
    z = jnp.ones((2, 3 + support.shaft_loads))
    lowered = jax.jit(linearised.function).lower(problem, z, jnp.ones(2, int), jnp.ones(2), jnp.asarray(0.0))
    assert "lapack" not in lowered.as_text()
