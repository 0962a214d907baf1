"""Drives in space against scipy's rotations and the motions of the plane; derivatives, transformations, errors."""

# pyright: reportArgumentType=false
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.spatial.transform import Rotation

import jaxwhisker as jw
from jaxwhisker._model.drives import (
    UPRIGHT,
    LinearDrive,
    Placement,
    PoseDrive,
    RotaryDrive,
    WhiskDrive,
    mount_in_space,
    placement_of,
)

EXACT = 1e-14  # of poses of order 1


class Wave(eqx.Module):
    """A motion along a line that also moves aside and turns."""

    rise: float
    turn: float

    def __call__(self, u):
        return (1.2 - u, 0.0, self.rise * jnp.sin(u)), jnp.array([0.1, -0.3, 1.0]) * self.turn * u


DRIVES = [
    LinearDrive((-3.0, 0.0, 4.0), (0.2, 0.1, -0.3)),
    RotaryDrive((1.0, 2.0, -0.5), (0.1, -0.4, 0.3)),
    WhiskDrive(0.2, -0.4, 0.3, 0.22, (0.0, -0.1, 0.05)),
    PoseDrive(Wave(0.3, 0.7), 0.0, 2.4),
]
CONTROLS = (-0.7, 0.0, 1.1)


def check(placement, position, rotation):
    np.testing.assert_allclose(placement.position, position, atol=EXACT)
    np.testing.assert_allclose(placement.rotation, rotation.as_matrix(), atol=EXACT)


@pytest.mark.parametrize("u", CONTROLS)
def test_placements_are_those_of_scipy(u):
    linear, rotary, whisk, wave = (drive.placement(u) for drive in DRIVES)
    check(linear, [0.2 - 0.6 * u, 0.1, -0.3 + 0.8 * u], Rotation.identity())
    axis, pivot = np.array([1.0, 2.0, -0.5]), np.array([0.1, -0.4, 0.3])
    turn = Rotation.from_rotvec(u * axis / np.linalg.norm(axis))
    check(rotary, pivot - turn.apply(pivot), turn)
    # Capital letters: each rotation is about the axes that the ones before have turned.
    turn, pivot = Rotation.from_euler("ZXY", [u, 0.2 + 0.3 * u, -0.4 + 0.22 * u]), np.array([0.0, -0.1, 0.05])
    check(whisk, pivot - turn.apply(pivot), turn)
    check(wave, [1.2 - u, 0.0, 0.3 * np.sin(u)], Rotation.from_rotvec(np.array([0.1, -0.3, 1.0]) * 0.7 * u))


def test_a_pivot_stays_where_it_is():
    for drive in DRIVES[1:3]:
        placement = drive.placement(0.8)
        np.testing.assert_allclose(
            placement.position + placement.rotation @ jnp.array(drive.pivot), drive.pivot, atol=EXACT
        )


@pytest.mark.parametrize("u", CONTROLS)
def test_roll_turns_an_upright_whisker_about_its_root(u):
    elevation, roll = 0.3, -0.8
    turned = WhiskDrive(elevation, roll).placement(u).rotation @ UPRIGHT
    about_root = Rotation.from_rotvec([0.0, 0.0, roll]).as_matrix()
    tilted = Rotation.from_rotvec([0.0, 0.0, u]) * Rotation.from_rotvec([elevation, 0.0, 0.0])
    np.testing.assert_allclose(turned, tilted.as_matrix() @ UPRIGHT @ about_root, atol=EXACT)


def test_an_upright_whisker_has_the_directors_of_the_standard_clamp():
    np.testing.assert_array_equal(UPRIGHT.T, [[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    # Elevation tilts it towards +z, protraction towards -x.
    assert (WhiskDrive(elevation=0.1).placement(0.0).rotation @ UPRIGHT)[2, 2] > 0
    assert (WhiskDrive().placement(0.1).rotation @ UPRIGHT)[0, 2] < 0


@pytest.mark.parametrize(
    "motion",
    [
        jw.Translation(),
        jw.Rotation((0.1, -0.5), 0.4),
        jw.Motion(lambda u: (1.2 - u, 0.03 * u, 0.2 * u), start=0.0, stop=2.6),
    ],
    ids=str,
)
@pytest.mark.parametrize("u", CONTROLS)
def test_motions_in_the_plane_turn_about_z(motion, u):
    x, y, angle = motion.pose(u)
    check(placement_of(motion, u), [x, y, 0.0], Rotation.from_rotvec([0.0, 0.0, float(angle)]))


def test_motions_in_space_have_their_own_placement():
    for drive in DRIVES:
        for ours, own in zip(placement_of(drive, 0.3), drive.placement(0.3), strict=True):
            np.testing.assert_array_equal(ours, own)


def test_the_rotations_of_plane_and_space_agree():
    plane, space = jw.Rotation((0.1, -0.5), 0.5), RotaryDrive((0.0, 0.0, 2.0), (0.0, -0.5, 0.0))
    np.testing.assert_allclose(space.placement(0.4).position[0], plane.pose(0.4).x - 0.1, atol=EXACT)
    np.testing.assert_allclose(space.placement(0.4).position[1], plane.pose(0.4).y, atol=EXACT)


def test_a_frame_in_a_frame():
    outer, inner = DRIVES[1].placement(0.4), DRIVES[2].placement(-0.9)
    both, point = outer.containing(inner), jnp.array([0.3, -0.2, 0.5])
    step = inner.position + inner.rotation @ point
    np.testing.assert_allclose(
        both.position + both.rotation @ point, outer.position + outer.rotation @ step, atol=EXACT
    )


def test_mounts_in_space_hold_the_directors_of_the_root():
    upright = mount_in_space(jw.Mount(0.1, 0.2))
    np.testing.assert_allclose(upright.position, [0.1, 0.2, 0.0], atol=EXACT)
    np.testing.assert_allclose(upright.rotation, UPRIGHT, atol=EXACT)
    placement = mount_in_space(jw.Mount(0.1, 0.2, 0.3, z=-0.4, elevation=0.5, roll=-0.6))
    np.testing.assert_allclose(placement.position, [0.1, 0.2, -0.4], atol=EXACT)
    tilted = Rotation.from_rotvec([0.0, 0.0, 0.3]) * Rotation.from_rotvec([0.5, 0.0, 0.0])
    about_root = Rotation.from_rotvec([0.0, 0.0, -0.6]).as_matrix()
    np.testing.assert_allclose(placement.rotation, tilted.as_matrix() @ UPRIGHT @ about_root, atol=EXACT)
    # The angle is that of the plane: the tangent leans towards -x.
    tangent = mount_in_space(jw.Mount(angle=0.3)).rotation[:, 2]
    np.testing.assert_allclose(tangent, [-np.sin(0.3), np.cos(0.3), 0.0], atol=EXACT)


def test_ends_units_and_directions():
    linear, rotary, whisk, wave = DRIVES
    assert linear.ends is None and linear.onwards == 1 and linear.unit(0.05) == 0.05
    for drive in (rotary, whisk):
        assert drive.ends == (-np.pi / 2, np.pi / 2) and drive.onwards == 1 and drive.unit(0.05) == 1.0
    back = WhiskDrive(start=0.9, stop=-0.5)
    assert back.ends == (0.9, -0.5) and back.onwards == -1
    assert wave.ends == (0.0, 2.4) and wave.onwards == 1 and float(wave.unit(0.05)) == 2.4


def test_texts_name_the_motion():
    along = "translation along (-3, 0, 4) from (0.2, 0.1, -0.3)"
    expected = [along, "rotation about (1, 2, -0.5)", "whisking", "motion Wave(u)"]
    assert list(map(str, DRIVES)) == expected


@pytest.mark.parametrize("drive", DRIVES, ids=str)
def test_derivatives_by_control_and_all_numbers(drive):
    numbers, rest = eqx.partition(drive, eqx.is_inexact_array_like)

    @jax.jit
    def placement(numbers, control):
        return eqx.combine(numbers, rest).placement(control)

    for control in (0.0, 0.6):
        check_grads(placement, (numbers, control), order=2, modes=("fwd", "rev"), atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("drive", DRIVES, ids=str)
def test_batches_are_those_of_single_controls(drive):
    together = jax.jit(jax.vmap(drive.placement))(jnp.array(CONTROLS))
    for k, control in enumerate(CONTROLS):
        for batch, single in zip(together, drive.placement(control), strict=True):
            np.testing.assert_allclose(batch[k], single, atol=EXACT)


def test_placements_are_tuples_of_arrays():
    placement = placement_of(jw.Translation(), 0.5)
    assert isinstance(placement, Placement)
    assert placement.position.shape == (3,) and placement.rotation.shape == (3, 3)


def test_traced_parameters_out_of_their_domain_are_invalid():
    @jax.jit
    def valid(x, angle):
        drives = LinearDrive((x, 0.0, 0.0)), RotaryDrive((x, 0.0, 0.0)), WhiskDrive(angle)
        return jnp.stack([drive.valid() for drive in drives])

    assert valid(1.0, 0.2).all()
    np.testing.assert_array_equal(valid(0.0, 0.2), [False, False, True])
    assert not valid(jnp.nan, jnp.inf).any()
    assert eqx.filter_jit(lambda drive: drive.valid())(DRIVES[3])


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: LinearDrive((1.0, 0.0)), r"`direction` must be a tuple of three numbers, got \(1.0, 0.0\)"),
        (lambda: LinearDrive((0.0, 0.0, 0)), r"`direction` must be a vector that is not zero, got \(0.0, 0.0, 0\)"),
        (lambda: LinearDrive((1.0, 0.0, 0.0), 0.0), "`origin` must be a tuple of three numbers, got 0.0"),
        (lambda: RotaryDrive((0.0, 0.0, 0.0)), "`axis` must be a vector that is not zero"),
        (lambda: RotaryDrive((0.0, 0.0, 1.0), (0.0, np.nan, 0.0)), r"`pivot\[1\]` must be a finite number, got nan"),
        (lambda: RotaryDrive((0.0, 0.0, 1.0), stop=-np.pi / 2), "`stop` must be different from `start`, got -1.57"),
        (lambda: WhiskDrive("a"), "`elevation` must be a finite number, got 'a'"),
        (lambda: WhiskDrive(roll_rate=np.inf), "`roll_rate` must be a finite number, got inf"),
        (lambda: WhiskDrive(start=np.inf), "`start` must be a finite number, got inf"),
        (
            lambda: PoseDrive(3.0, 0.0, 1.0),
            r"`function` must be a function .* \(\(x, y, z\), \(rotation_x, .*, got 3.0",
        ),
        (lambda: PoseDrive(lambda u: u, 0.0, 1.0), "`function` must be .*, got <lambda>, which returns an array of sh"),
        (lambda: PoseDrive(lambda u: (u, u, u), 0.0, 1.0), "`function` must be .*, got <lambda>, which returns 3 val"),
        (lambda: PoseDrive(lambda u: ((u, u), (u, u, u, u)), 0.0, 1.0), "`function` must be .*, which returns 2 val"),
        (
            lambda: PoseDrive(lambda u, v: u, 0.0, 1.0),
            r"`function` must be .* with one number .*, got <lambda>\(u, v\)",
        ),
        (
            lambda: PoseDrive(lambda u: ((float(u), 0.0, 0.0), (0.0, 0.0, 0.0)), 0.0, 1.0),
            "`function` must be a function that JAX can trace, got <lambda>",
        ),
        (lambda: PoseDrive(Wave(0.1, 0.1), 1.0, 1.0), "`stop` must be different from `start`, got 1.0 for both"),
        (lambda: jw.Sensor(jw.Whisker(), motion=WhiskDrive()), "`motion` must be a Translation, Rotation or Motion"),
    ],
)
def test_wrong_drives(make, message):
    with pytest.raises(ValueError, match=message):
        make()
