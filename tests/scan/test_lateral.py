"""Lateral stability: exact losses of stability of whiskers in space, closed forms, derivatives."""

import dataclasses
import json
from functools import partial
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._scan import lateral

EXACT = 1e-8  # the reference gives ten digits; a drive position in it is known to about this
SPECTRAL = 1e-8  # relative error of the stiffness by polynomials of degree 16
DIFFERENCES = 1e-6  # error of central differences with steps of 1e-5
ROWS = json.loads((Path(__file__).parents[1] / "data" / "lateral.json").read_text("utf-8"))
CIRCLE = jw.Circle(distance=0.3, radius=1.0)
CONTROL = np.linspace(1.2, -1.2, 121)


def springs(x, y):
    return jw.Support((jw.Spring((0, 1), x, axis="x"), jw.Spring((0, 1), y, axis="y")))


# By the names of the reference: the support in the plane, the lateral curvature of the object, and what holds the base.
CASES = {
    "sphere clamped": (jw.Support(), 1.0, {}),
    "sphere springs 30,300,8": (springs(30.0, 300.0), 1.0, {"lateral_stiffness": 8.0}),
    "sphere springs 10,100,40": (springs(10.0, 100.0), 1.0, {"lateral_stiffness": 40.0}),
    "ellipsoid 1,1,0.6": (jw.Support(), 1 / 0.6**2, {}),
    "ellipsoid 1,1,2": (jw.Support(), 1 / 2**2, {}),
    "ellipsoid 1,1,4": (jw.Support(), 1 / 4**2, {}),
    "ellipsoid 1,1,2 springs 20,200,15": (springs(20.0, 200.0), 1 / 2**2, {"lateral_stiffness": 15.0}),
    "cylinder springs 20,200,15": (springs(20.0, 200.0), 0.0, {"lateral_stiffness": 15.0}),
    "cylinder clamped": (jw.Support(), 0.0, {}),
    "ellipsoid 1,1,2 rotational x only (tilt) 6": (jw.Support(), 1 / 2**2, {"tilt_stiffness": 6.0}),
}


def scanned(support, whisker=None, profile: jw.AbstractProfile = CIRCLE, control: np.ndarray | None = CONTROL):
    return jw.scan(jw.Scene(jw.Whisker() if whisker is None else whisker, profile, support), control)


def first_loss(margin):
    """The last step before the first loss of stability."""
    margin = np.asarray(margin)[:, 0]
    return int(np.flatnonzero((margin[:-1] > 0) & (margin[1:] < 0))[0])


@pytest.mark.parametrize("row", ROWS, ids=[row["name"] for row in ROWS])
def test_stability_is_lost_where_whiskers_in_space_lose_it(row):
    support, curvature, held = CASES[row["name"]]
    result = scanned(support)
    loss = jw.lateral_loss(result, curvature, **held)
    np.testing.assert_allclose(loss, [-row["drive"]], atol=EXACT)
    # Between the same two steps, and with the stiffness of the reference.
    stability = jw.lateral_stability(result, curvature, **held)
    step = first_loss(stability.margin)
    assert CONTROL[step] >= loss[0] >= CONTROL[step + 1]
    way = np.where(np.arange(CONTROL.size) > step, -row["drive"], CONTROL)
    there = jw.lateral_stability(scanned(support, control=way), curvature, **held)
    # The stiffness changes by about 10 per length of the drive, in whose last digit the reference is uncertain.
    np.testing.assert_allclose(there.stiffness[-1, 0], row["k_lat"], atol=20 * EXACT)
    np.testing.assert_allclose(there.softening[-1, 0], row["f_kappa_z"], atol=20 * EXACT)


@pytest.mark.parametrize("held", [{}, {"c": 8.0}, {"k": 6.0}, {"c": 3.0, "k": 2.0}], ids=str)
def test_the_second_variation_of_a_straight_whisker_is_that_of_springs_in_series(held):
    result = scanned(jw.Support())
    given = lateral._checked(result.scene, 0.0, held.get("c", np.inf), held.get("k", np.inf), 0.7)
    touching, whisker = np.asarray(result.phase)[:, 0] > 0, result.scene.whiskers[0]
    at = lateral.Contact(*(getattr(result, name)[:, 0] for name in lateral.Contact._fields))
    exact, spectral = (
        jax.vmap(partial(way, whisker, lateral=given))(at) for way in (lateral._of_straight, lateral._of_curved)
    )
    assert touching.sum() > 80
    np.testing.assert_array_equal(exact[1][touching], spectral[1][touching])
    assert np.any(exact[1][touching])
    error = np.abs(exact[0] - spectral[0]) / (1 + np.abs(exact[0]))
    assert np.max(error[touching]) < SPECTRAL


@pytest.mark.parametrize(("curvature", "position"), [(0.6, -0.242), (-0.6, -1.063), (0.0, -0.501)])
def test_intrinsic_curvature_moves_the_loss(curvature, position):
    # Independent values, by shooting and the second variation in space, to three digits: a tip that leads, one that
    # trails and a straight one.
    whisker = jw.Whisker(intrinsic_curvature=curvature) if curvature else jw.Whisker()
    control = np.linspace(1.2, -1.1, 461)  # the tip that trails slips off soon after it is lost
    result = scanned(jw.Support(), whisker, jw.Circle(distance=0.3, radius=0.9), control)
    np.testing.assert_allclose(jw.lateral_loss(result, torsion_ratio=2 / 3), [position], atol=5e-4)


@pytest.mark.parametrize("curvature", [None, 0.4])
def test_losses_do_not_depend_on_units(curvature):
    # A whisker of 2 mm with EI = 3e-9 N m^2, curved or straight, on springs across the plane.
    length, stiffness = 2e-3, 3e-9

    def loss(length, stiffness):
        bent = None if curvature is None else curvature / length
        whisker = jw.Whisker(length=length, bending_stiffness=stiffness, intrinsic_curvature=bent)
        profile = jw.Circle(0.3 * length, length)
        held = {"lateral_stiffness": 9.0 * stiffness / length**3, "tilt_stiffness": 7.0 * stiffness / length}
        result = scanned(jw.Support(), whisker, profile, CONTROL * length)
        return jw.lateral_loss(result, 0.25 / length, **held) / length

    np.testing.assert_allclose(loss(length, stiffness), loss(1.0, 1.0), rtol=1e-9)


def test_a_whisker_that_is_laterally_flat_is_lost_at_the_vertex():
    # Whatever its taper, the support and the profile: the force must push the contact back.
    whisker = jw.Whisker(bending_stiffness=lambda s: (1 - 0.6 * s) ** 4)
    for profile in (CIRCLE, jw.Parabola(0.3), jw.Ellipse(0.3, 0.8, 0.5)):
        result = scanned(jw.Support.fb(70.0), whisker, profile)
        (vertex,) = result.events.of(jw.EventKind.vertex)
        np.testing.assert_allclose(jw.lateral_loss(result), [vertex.control], atol=1e-9)


def test_an_object_of_revolution_is_lost_on_the_axis():
    # A whisker parallel to the axis slides around it: the curvature along the parallel is sin(alpha) / radius.
    class Parallel(eqx.Module):
        """Lateral curvature of the paraboloid y = 0.3 + x^2, at a contact point."""

        def __call__(self, x, y):
            return 2 / jnp.sqrt(1 + 4 * x**2)

    result = scanned(jw.Support(), profile=jw.Parabola(0.3), control=np.linspace(0.9, -0.8, 86))
    np.testing.assert_allclose(jw.lateral_loss(result, Parallel()), [0.0], atol=1e-9)


def test_a_plain_function_of_the_contact_point_is_a_curvature():
    result = scanned(jw.Support())
    given = jw.lateral_loss(result, 0.25)
    np.testing.assert_array_equal(jw.lateral_loss(result, lambda x, y: 0.25 + 0.0 * x * y), given)


@pytest.mark.parametrize("tilt_stiffness", [np.inf, 7.0])
def test_a_level_face_has_the_stiffness_of_nearly_level_ones(tilt_stiffness):
    # The force has no part across the base; the formula of springs in series holds beside it.
    rho, h, along, c = 0.5, 0.4, -5.0, 20.0
    scene = jw.Scene(jw.Whisker(), CIRCLE, jw.Support())
    given = lateral._checked(scene, 0.0, c, tilt_stiffness, 0.7)

    def stiffness(across):
        at = lateral.Contact(0.0, 0.0, 0.0, -across, -along, rho * along - h * across, rho, h, 0.9)
        return float(lateral._of_straight(scene.whiskers[0], jax.tree.map(jnp.asarray, at), given)[0])

    def series(across):
        a = h - rho * along / across
        return 1 / (rho / across + 1 / c + a**2 / (tilt_stiffness + along * a))

    near = [series(1e-6), series(-1e-6)]
    np.testing.assert_allclose([stiffness(1e-6), stiffness(-1e-6)], near, rtol=1e-8)
    np.testing.assert_allclose(stiffness(0.0), np.mean(near), atol=1e-9)


def test_free_whiskers_are_stable_and_failed_steps_are_nan():
    result = scanned(jw.Support())
    stability = jw.lateral_stability(result, 0.5)
    free = np.asarray(result.phase) == 0
    assert free.any() and np.all(stability.margin[free] == np.inf) and np.all(stability.softening[free] == 0)
    touching = np.asarray(stability.margin)[~free]
    assert np.all(np.isfinite(touching[:20]) | (touching[:20] == -np.inf)) and touching[5] > 0
    failed = eqx.tree_at(lambda one: one.base_x, result, result.base_x.at[3].set(jnp.nan))
    assert np.isnan(jw.lateral_stability(failed).margin[3]).all()


def test_a_step_at_the_very_touch_is_no_loss():
    # The default control has steps there, whose forces are rounding errors of either sign.
    result = scanned(jw.Support.fb(70.0), control=None)
    touch = int(np.argmax(np.asarray(result.phase)[:, 0] > 0))
    forces = [getattr(result, name).at[touch].set(1e-17) for name in ("fx", "contact_force")]
    result = eqx.tree_at(lambda one: [one.fx, one.contact_force], result, forces)
    assert jw.lateral_stability(result).margin[touch] == np.inf
    (vertex,) = result.events.of(jw.EventKind.vertex)
    np.testing.assert_allclose(jw.lateral_loss(result), [vertex.control], atol=1e-9)
    # A bending beam with its tip held: 3 EI / L^3.
    first = int(np.argmax(np.isfinite(jw.lateral_stability(result).stiffness[:, 0])))
    np.testing.assert_allclose(jw.lateral_stability(result).stiffness[first, 0], 3.0, atol=1e-2)


def test_a_loss_that_no_step_contains_is_nan():
    result = scanned(jw.Support(), control=np.linspace(1.2, 0.1, 56))
    assert np.isnan(jw.lateral_loss(result)).all()
    # Each whisker has a loss of its own.
    pair = jw.Scene(jw.Whisker(), CIRCLE, jw.Support((jw.Spring((0, 1), 1e6), jw.Spring((0, 2), 1e6, rest_length=0.4))))
    losses = jw.lateral_loss(jw.scan(pair, CONTROL))
    np.testing.assert_allclose(losses[0] - losses[1], 0.4, atol=1e-4)


def test_derivatives_of_the_loss_agree_with_differences_in_both_modes():
    def loss(numbers):
        distance, stiffness, curvature = numbers
        scene = jw.Scene(jw.Whisker(), jw.Circle(distance, 1.0), jw.Support.fb(stiffness))
        return jw.lateral_loss(jw.scan(scene, CONTROL), curvature)[0]

    at, steps = jnp.array([0.3, 60.0, 0.25]), (1e-5, 1e-3, 1e-5)
    differences = []
    for k, h in enumerate(steps):
        differences.append((loss(at.at[k].add(h)) - loss(at.at[k].add(-h))) / (2 * h))
    assert np.all(np.abs(differences) > 1e-5)
    for slopes in (jax.jacfwd(loss)(at), jax.jacrev(loss)(at)):
        np.testing.assert_allclose(slopes, differences, atol=DIFFERENCES)


def test_margins_work_in_batches_and_under_jit():
    result = scanned(jw.Support.fb(70.0))

    def margin(curvature):
        return jw.lateral_stability(result, curvature, lateral_stiffness=9.0).margin

    curvatures = jnp.array([0.0, 0.5])
    batch = jax.vmap(margin)(curvatures)
    for k in range(2):
        alone = margin(curvatures[k])
        np.testing.assert_allclose(batch[k], alone, rtol=1e-12)
        np.testing.assert_allclose(jax.jit(margin)(curvatures[k]), alone, rtol=1e-12)
    # The margin falls by the contact force per curvature.
    touching = np.isfinite(alone)
    slope = jax.jacfwd(margin)(0.5)
    np.testing.assert_allclose(slope[touching], -result.contact_force[touching], rtol=1e-12)


@pytest.mark.parametrize(
    ("more", "named"),
    [
        ({"lateral_stiffness": 0.0}, "lateral_stiffness"),
        ({"tilt_stiffness": -1.0}, "tilt_stiffness"),
        ({"torsion_ratio": np.inf}, "torsion_ratio"),
        ({"lateral_curvature": "flat"}, "lateral_curvature"),
        ({"lateral_curvature": np.nan}, "lateral_curvature"),
        ({"lateral_curvature": lambda x: x}, "lateral_curvature"),
        ({"lateral_curvature": lambda x, y: (x, y)}, "lateral_curvature"),
    ],
)
@pytest.mark.unchecked
def test_errors_name_the_argument(more, named):
    result = scanned(jw.Support())
    for function in (jw.lateral_stability, jw.lateral_loss):
        with pytest.raises(ValueError, match=f"`{named}`"):
            function(result, **more)


@pytest.mark.unchecked
def test_springs_on_shafts_have_no_lateral_stiffness():
    sprung = jw.Support((jw.Spring((0, 1), 50.0), jw.Spring((0, 1), 50.0, at=0.2)))
    # The scene decides: the states of a clamped whisker will do.
    result = dataclasses.replace(scanned(jw.Support()), scene=jw.Scene(jw.Whisker(), CIRCLE, sprung))
    with pytest.raises(ValueError, match="on shafts"):
        jw.lateral_stability(result)
    with pytest.raises(ValueError, match="`result`"):
        jw.lateral_stability(result.scene)  # pyright: ignore[reportArgumentType]
