"""Springs on shafts: their numbers and places in the dimensionless problem, and unloaded whiskers that they bend."""

# pyright: reportArgumentType=false, reportCallIssue=false, reportOptionalMemberAccess=false
import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from functions import Stiffening
from handmade import SI
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.attach import _unbent, _weakened, attached, with_unloaded
from jaxwhisker._equilibrium.dimensionless import sections
from jaxwhisker._equilibrium.shaft_springs import AXIAL
from jaxwhisker._model.motion import Translation
from jaxwhisker._model.scene import units_of
from scenes import follicle
from shafts import points

ROUNDING = 1e-13
INTEGRATED = 1e-9  # of a rod's steps, and of what is solved for with it
LENGTH, BENDING = SI
CURVED = jw.Whisker(LENGTH, BENDING, intrinsic_curvature=8.0)
MOUNTS = jw.Mount(0.01, -0.005, 0.2), jw.Mount(0.03, 0.0, -0.1)


def on_shafts(*springs, whisker=CURVED, **options):
    """The dimensionless springs on the shafts of such whiskers."""
    support = jw.Support(springs, **options)
    section = sections((whisker,) * support.whiskers, LENGTH, BENDING)
    return attached(support, section, units_of(whisker, Translation()))


def place(whisker, at):
    """Position and direction of a point of an unloaded whisker, which is straight below its base, on the drive."""
    mount = MOUNTS[whisker - 1]
    return points(mount.x, mount.y, np.pi / 2 + mount.angle, 8.0 if at > 0 else 0.0, at)


SPRINGS = (
    jw.Spring((0, 1), 70.0, 0.01),  # holds the base
    jw.Spring((0, 1), 3.0, 0.012, at=0.02),
    jw.Spring((0, 1), 2e-3, -0.3, "phi", at=0.035),
    jw.Spring((0, 2), Stiffening(0.0, 8e5), 0.001, "y", at=0.01, one_sided="compression"),
    jw.Spring((0, 1), 5.0, -0.015, "axial", at=-0.01, one_sided="tension"),
    jw.Spring((0, 2), Stiffening(0.0, 2e-4), 0.4, "phi", at=0.03),
    jw.Spring((0, 2), 1.5, 0.02, "axial", at=0.04, anchor=(0.004, -0.02)),
)


@pytest.fixture(scope="module")
def springs():
    return on_shafts(*SPRINGS, mount=MOUNTS)


def test_places_run_from_the_tip_to_the_base_and_ranks_tell_whose_they_are(springs):
    at = springs.held_by.springs.at * LENGTH
    np.testing.assert_allclose(at, [[0.035, 0.02, 0.0, -0.01], [0.04, 0.03, 0.01, 0.0]], atol=ROUNDING)
    # The place at the base has no spring.
    np.testing.assert_array_equal(springs.held_by.springs.share, [[1, 1, 0, 1], [1, 1, 1, 0]])
    # In the order of the support.
    for k, expected in enumerate(([0.02, 0.035, -0.01], [0.01, 0.03, 0.04])):
        np.testing.assert_allclose(at[k, springs.ranks[k, :3]], expected, atol=ROUNDING)
    assert springs.couplings is None and springs.held_by.tissue is None and springs.blank.shape == (2, 3)


def test_springs_are_measured_by_the_first_whisker(springs):
    force, moment = BENDING / LENGTH**2, BENDING / LENGTH
    each = springs.held_by.springs
    stiffness = [[2e-3 / moment, 3.0 * LENGTH / force, 0, 5.0 * LENGTH / force], [1.5 * LENGTH / force, 0, 0, 0]]
    np.testing.assert_allclose(each.stiffness, stiffness, rtol=ROUNDING)
    rest_length = [[-0.3, 0.012 / LENGTH, 0, 0.015 / LENGTH], [0.02 / LENGTH, 0.4, 0.001 / LENGTH, 0]]
    np.testing.assert_allclose(each.rest_length, rest_length, rtol=ROUNDING)
    assert each.axis.tolist() == [[2, 0, 0, AXIAL], [AXIAL, 2, 1, 0]]
    assert each.one_sided.tolist() == [[0, 0, 0, 1], [0, 0, -1, 0]]
    # Laws are numbered in the order of the support; number 0 is the linear one.
    assert each.law.tolist() == [[0, 0, 0, 0], [0, 2, 1, 0]]
    along, turning = springs.laws
    np.testing.assert_allclose(along(0.3), 8e5 * (0.3 * LENGTH) ** 3 / force, rtol=ROUNDING)
    np.testing.assert_allclose(turning(0.3), 2e-4 * 0.3**3 / moment, rtol=ROUNDING)


def test_springs_begin_where_the_unloaded_whisker_is_or_at_their_anchors(springs):
    each = springs.held_by.springs
    x, y, phi = np.array([place(1, 0.035), place(1, 0.02), place(1, -0.01), place(2, 0.03), place(2, 0.01)]).T
    has = np.array([[1, 1, 0, 1], [0, 1, 1, 0]], bool)
    np.testing.assert_allclose(each.anchor_x[has], x / LENGTH, atol=INTEGRATED)
    np.testing.assert_allclose(each.anchor_y[has], y / LENGTH, atol=INTEGRATED)
    np.testing.assert_allclose(each.anchor_angle[has], phi - np.pi / 2, atol=INTEGRATED)
    np.testing.assert_allclose([each.anchor_x[1, 0], each.anchor_y[1, 0]], np.array([0.004, -0.02]) / LENGTH)


def test_a_foundation_has_places_at_its_ends():
    tissue = jw.Foundation(0.004, 0.02, 2000.0, 0.001)
    straight = jw.Whisker(LENGTH, BENDING)
    found = on_shafts(SPRINGS[0], whisker=straight, mount=MOUNTS[:1], foundation=tissue)
    at, held_by = np.array([0.02, 0.004, 0.0]), found.held_by
    np.testing.assert_allclose(held_by.springs.at, at[None] / LENGTH, atol=ROUNDING)
    assert not held_by.springs.share.any()
    # Stiffness per length, in EI/L^4.
    expected = [0.004 / LENGTH, 0.02 / LENGTH, 2000.0 * LENGTH**4 / BENDING, 0.001 / LENGTH]
    expected += [0.01 / LENGTH, -0.005 / LENGTH, np.cos(0.2), np.sin(0.2)]
    np.testing.assert_allclose(np.ravel(held_by.tissue), expected, rtol=ROUNDING)


def test_supports_without_springs_on_shafts():
    assert on_shafts(SPRINGS[0]) is None


def between(first, second, *at):
    return jw.Spring((first, second), 4.0, 0.02, at=at)


def test_loads_of_springs_between_shafts_follow_the_contact_of_the_second_whisker():
    row = jw.Spring((0, 1), 70.0, 0.01), jw.Spring((0, 2), 70.0, 0.02)
    coupling = between(1, 2, 0.03, 0.04), between(1, 2, 0.01, 0.02), between(2, 1, 0.005, 0.015)
    springs = on_shafts(*row, *coupling, whisker=jw.Whisker(LENGTH, BENDING))
    assert springs.blank.shape == (2, 9)
    couplings, at = springs.couplings, springs.held_by.springs.at * LENGTH
    places = [np.asarray(at)[end.whisker, end.place] for end in (couplings.first, couplings.second)]
    np.testing.assert_allclose(places, [[0.03, 0.01, 0.005], [0.04, 0.02, 0.015]], atol=ROUNDING)
    assert couplings.first.whisker.tolist() == [0, 0, 1] and couplings.second.whisker.tolist() == [1, 1, 0]
    row, column = np.divmod(couplings.columns, 9)
    assert row.tolist() == [[1] * 3, [1] * 3, [0] * 3]
    assert column.tolist() == [[3, 4, 5], [6, 7, 8], [3, 4, 5]]
    # They act through these loads only.
    assert not springs.held_by.springs.share.any() and couplings.spring.share.tolist() == [1.0] * 3
    half = _weakened(springs, 0.5, 1.0)
    assert half.couplings.spring.share.tolist() == [0.5] * 3
    np.testing.assert_array_equal(half.couplings.spring.stiffness, couplings.spring.stiffness)


BASE, TORSION, MOUNT = 70.0, 5.0, (0.1, -0.05, 0.2)
unloaded = Program(with_unloaded)


@pytest.fixture(scope="module")
def problem():
    """A whisker whose base has springs along x and in angle; L = EI = 1."""
    return dimensionless(jw.Scene(jw.Whisker(), jw.Parabola(0.2), follicle(x=BASE, phi=TORSION, mount=MOUNT)))


def on_one(stiffness, rest_length, axis, at):
    """A spring on the shaft of this whisker."""
    support = jw.Support((jw.Spring((0, 1), stiffness, rest_length, axis, at=at),), jw.Mount(*MOUNT))
    return attached(support, None, units_of(jw.Whisker(), Translation()))


def straight(x, y, angle, length=1.0):
    """The tip of a straight whisker: position and angle to the upright."""
    return x - length * np.sin(angle), y + length * np.cos(angle), angle


@pytest.mark.parametrize(("stiffness", "rest_length"), [(4.0, 0.0), (4.0, 0.9), (60.0, -2.5), (1000.0, 0.3)])
def test_a_torsion_spring_bends_the_unloaded_whisker_into_an_arc(problem, stiffness, rest_length):
    at = 0.5
    found = unloaded(problem, on_one(stiffness, rest_length, "phi", at), jnp.zeros((1, 3, 3)))
    # The same moment turns the base against its torsion spring and bends the shaft up to the spring on it.
    moment = stiffness * rest_length / (1 + stiffness / TORSION + stiffness * at)
    x, y, phi = points(MOUNT[0], MOUNT[1], np.pi / 2 + MOUNT[2] + moment / TORSION, moment, at)
    held = found.problem.attached
    assert found.found
    np.testing.assert_allclose(held.contact[0], straight(x, y, phi - np.pi / 2, 1 - at), atol=INTEGRATED)
    np.testing.assert_allclose(held.pose[0], [0.0, 0.0, moment / TORSION], atol=INTEGRATED)


def test_a_base_that_only_a_spring_on_the_shaft_holds_rests_where_the_spring_does(problem):
    # The network of the problem has a spring along x that the support does not have, and gives back its force.
    rest_length, axis = 0.1, np.array([np.cos(MOUNT[2]), -np.sin(MOUNT[2]), 0.0])
    found = unloaded(problem, on_one(30.0, rest_length, "x", 0.4), jnp.asarray(BASE * np.outer(axis, axis)[None]))
    held = found.problem.attached
    np.testing.assert_allclose(held.pose[0], rest_length * axis, atol=INTEGRATED)
    np.testing.assert_allclose(held.contact[0], straight(MOUNT[0] + rest_length, *MOUNT[1:]), atol=INTEGRATED)


def test_without_an_equilibrium_the_unloaded_whisker_is_a_blank(problem):
    springs = on_one(4.0, 0.9, "phi", 0.5)
    broken = eqx.tree_at(lambda s: s.held_by.springs.stiffness, springs, jnp.full((1, 2), jnp.nan))
    found = unloaded(problem, broken, jnp.zeros((1, 3, 3)))
    assert not found.found
    assert not found.problem.attached.contact.any() and not found.problem.attached.pose.any()


def test_the_tips_of_unbent_whiskers_turn_with_the_drive():
    scene = jw.Scene(
        jw.Whisker(), jw.Parabola(0.2), follicle(phi=TORSION, mount=MOUNT), motion=jw.Rotation((0.3, -0.5))
    )
    turning = dimensionless(scene)
    for u in (-1.2, 0.4):
        np.testing.assert_allclose(_unbent(turning, jnp.asarray(u))[0], straight(*MOUNT), atol=ROUNDING)
