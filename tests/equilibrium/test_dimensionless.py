"""From scenes to problems: programs that scenes share, units, sections, angles, numbers that are not allowed."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from exact_contacts import scene
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.dimensionless import _turned, outlines, problem_of, sections
from jaxwhisker._equilibrium.problem import AlongX, InPlane
from jaxwhisker._model.along import LinearTaper
from jaxwhisker._rod.rod import Section
from scenes import cone

ROUNDING = 1e-13  # the same numbers by other operations
TABLE = 1e-9  # position of a circular arc in an outline


def spring(first, second, stiffness=70.0, rest_length=0.2):
    return jw.Spring((first, second), stiffness, rest_length)


def shape(scene):
    """What a program is compiled for: structure, shapes and dtypes."""
    abstract = eqx.filter_eval_shape(problem_of, jax.tree.map(lambda leaf: jnp.asarray(leaf, float), scene))
    return jax.tree.structure(abstract), [(leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(abstract)]


def test_all_networks_of_two_whiskers_along_x_share_one_program():
    networks = [
        jw.Support.fbfb(70.0),
        jw.Support.fbfbr([70.0, jnp.inf, 5.0]),
        jw.Support((spring(0, 2), spring(2, 1, 30.0, -0.2))),
        jw.Support((spring(0, 1), spring(0, 2))),
    ]
    first, *others = [shape(scene(network)) for network in networks]
    assert all(other == first for other in others)
    for different in (jw.Support.fb(70.0), jw.Support.clamped(), jw.Support.fbfbfbr(70.0)):
        assert shape(scene(different)) != first


@pytest.mark.parametrize(
    ("support", "motion", "kind"),
    [
        (jw.Support.clamped(), jw.Translation(), AlongX),
        (jw.Support.fbfb(70.0), jw.Translation(1), AlongX),
        (jw.Support.follicle(x=70.0), jw.Translation(), AlongX),
        (jw.Support.follicle(x=70.0, mount=jw.Mount()), jw.Translation(), InPlane),
        (jw.Support.follicle(phi=5.0), jw.Translation(), InPlane),
        (jw.Support.fb(70.0), jw.Rotation((0.0, -0.5), 0.5), InPlane),
    ],
)
def test_bases_move_along_x_only_where_nothing_else_can_move_them(support, motion, kind):
    problem = eqx.filter_eval_shape(problem_of, scene(support, motion=motion))
    assert type(problem) is kind
    assert problem.axes == (1 if kind is AlongX else 3)


def test_a_scene_in_si_units_is_the_same_problem():
    length, bending_stiffness = 0.05, 2.4e-5
    force = bending_stiffness / length**2
    metres = jw.Scene(
        (jw.Whisker(length, bending_stiffness), jw.Whisker(0.9 * length, 2 * bending_stiffness)),
        jw.Parabola(0.2 * length, 1 / length, 0.3 * length),
        jw.Support.fbfb([70.0 * force / length, 30.0 * force / length], [0.2 * length, 0.1 * length]),
    )
    plain = jw.Scene(
        (jw.Whisker(), jw.Whisker(0.9, 2.0)), jw.Parabola(0.2, 1.0, 0.3), jw.Support.fbfb([70.0, 30.0], [0.2, 0.1])
    )
    one, other = dimensionless(metres), dimensionless(plain)
    np.testing.assert_allclose(one.unit, (length, force, force * length, length), rtol=ROUNDING)
    np.testing.assert_allclose(other.unit, 1.0, rtol=ROUNDING)
    leaves = [jax.tree.leaves(eqx.tree_at(lambda p: p.unit, problem, other.unit)) for problem in (one, other)]
    for a, b in zip(*leaves, strict=True):
        np.testing.assert_allclose(a, b, rtol=ROUNDING, atol=ROUNDING)


def test_an_invalid_scene_has_finite_numbers():
    good = scene(jw.Support.fb(70.0))
    bad = eqx.tree_at(lambda s: (s.profile.distance, s.support.springs[0].stiffness), good, (-0.2, jnp.nan))
    assert bool(dimensionless(good).valid)
    problem = dimensionless(bad)
    assert not bool(problem.valid)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(problem))


@pytest.mark.parametrize(("friction", "valid"), [(0.3, True), (0.0, True), (-0.1, False), (np.nan, False)])
def test_the_friction_angle_is_that_of_the_coefficient(friction, valid):
    rough = scene(jw.Support.fb(70.0), friction=0.2)
    problem = dimensionless(eqx.tree_at(lambda s: s.friction, rough, jnp.asarray(friction)))
    assert bool(problem.valid) == valid
    if valid:
        np.testing.assert_allclose(problem.friction_angle, np.arctan(friction), rtol=ROUNDING)


def test_stiffnesses_in_a_turned_frame_store_the_same_energy():
    stiffness, displacement = np.array([3.0, 5.0, 0.7]), np.array([0.2, -0.4, 0.3])
    angle = 0.6
    turned = np.asarray(Program(_turned)(jnp.asarray(angle), jnp.asarray(stiffness)))
    cos, sin = np.cos(angle), np.sin(angle)
    # The drive's coordinates of a displacement in a frame at this angle to it.
    in_drive = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]) @ displacement
    np.testing.assert_allclose(displacement @ turned @ displacement, np.sum(stiffness * in_drive**2), rtol=ROUNDING)
    np.testing.assert_allclose(turned, turned.T, atol=ROUNDING)
    np.testing.assert_allclose(np.linalg.eigvalsh(turned), np.sort(stiffness), rtol=ROUNDING)


def test_sections_are_stacked_if_they_differ_in_numbers_only():
    uniform, first, second = jw.Whisker(), cone(0.5, stiffness=2.0), cone(0.25, length=0.8)
    curved = jw.Whisker(intrinsic_curvature=LinearTaper(0.3, 0.9, 1.0))
    assert sections((uniform, jw.Whisker(0.9)), 1.0, 1.0) is None
    both = sections((first, second), 2.0, 4.0)
    assert isinstance(both, Section)
    # Lengths in units of 2 and stiffnesses in units of 4. The stiffness of round sections goes with the fourth power.
    s = jnp.array([0.0, 0.2, 0.4])
    values = Program(lambda own, s: jax.vmap(lambda one: jax.vmap(one.stiffness)(s))(own))(both, s)
    thickness = 1 - np.outer([0.5, 0.75 / 0.8], 2.0 * np.asarray(s))
    np.testing.assert_allclose(values, np.array([[2.0], [1.0]]) / 4.0 * thickness**4, rtol=ROUNDING)
    each = sections((uniform, curved), 1.0, 1.0)
    assert isinstance(each, tuple) and [own.intrinsic_curvature is None for own in each] == [True, False]


def test_outlines_of_straight_and_curved_whiskers():
    curvature = 0.6
    straight, curved = jw.Whisker(1.2), jw.Whisker(0.8, intrinsic_curvature=LinearTaper(curvature, curvature, 0.8))
    lengths = jnp.array([1.2, 0.8])

    @Program
    def drawn():
        return outlines((straight, curved), lengths, sections((straight, curved), 1.0, 1.0))

    found = drawn()
    ends = np.stack([values[:, -1] for values in found])
    turn = curvature * 0.8
    arc = [(np.cos(turn) - 1) / curvature, np.sin(turn) / curvature, -np.sin(turn), np.cos(turn)]
    np.testing.assert_allclose(ends, np.stack([[0.0, 1.2, 0.0, 1.0], arc], axis=1), atol=TABLE)
    np.testing.assert_allclose(
        np.stack([values[:, 0] for values in found]).T, [[0.0, 0.0, 0.0, 1.0]] * 2, atol=ROUNDING
    )
