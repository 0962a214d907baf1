"""The weight of a whisker: its parts against numbers, and the part beyond a contact against SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_bvp

import jaxwhisker as jw
from jaxwhisker._equilibrium.weight import valid_gravity, weights_of
from jaxwhisker._model.scene import Units
from jaxwhisker._rod import rod
from scenes import check_derivatives

ROUNDING = 1e-13
SOLVED = 1e-9  # of SciPy's collocation
INTEGRATED = 1e-8  # of a rod with 8 steps, relative to the load
DIFFERENCES = 1e-7

LENGTH, STIFFNESS = 2.0, 3.0
GRAVITY = 0.7, -1.5
UNIT = Units(*map(jnp.asarray, (LENGTH, STIFFNESS / LENGTH**2, STIFFNESS / LENGTH, LENGTH)))


def mass(s):
    """Falls to a tenth at the tip, and jumps at 1.2."""
    return jnp.where(s < 1.2, 1.0 - 0.3 * s, 0.5 - 0.2 * s)


WHISKER = jw.Whisker(LENGTH, STIFFNESS, mass_per_length=mass, breaks=(1.2,), tip_mass=0.2)


def own(whisker=WHISKER, gravity=GRAVITY):
    """Weight and section of one whisker."""
    weight = jax.tree.map(lambda leaf: leaf[0], weights_of((whisker,), gravity, UNIT))
    return weight, whisker.section(UNIT.length, UNIT.moment * UNIT.length, heavy=True)


def test_weights_between_places_are_integrals():
    weight, section = own()
    x, y = weight.between(section, jnp.asarray(0.1), jnp.asarray(0.95))
    total = (1.2 - 0.2) - 0.15 * (1.2**2 - 0.2**2) + 0.5 * (1.9 - 1.2) - 0.1 * (1.9**2 - 1.2**2)
    np.testing.assert_allclose((x * UNIT.force, y * UNIT.force), np.multiply(GRAVITY, total), rtol=ROUNDING)


@pytest.mark.parametrize(("gravity", "angle"), [(GRAVITY, 0.4), ((0.0, -30.0), 0.1), ((0.0, 40.0), -0.2)])
def test_the_part_beyond_a_contact_is_a_cantilever(gravity, angle):
    weight, section = own(gravity=gravity)
    at, x, y = 0.8 / LENGTH, 0.2, -0.1
    start = tuple(map(jnp.asarray, (x, y, np.cos(angle), np.sin(angle))))
    load = weight.beyond(start, jnp.asarray(at), jnp.asarray(1.0), section, steps=8)

    # The unknowns of SciPy are those of a rod in the scene's units: place, angle, load of what is beyond, moment.
    gx, gy = gravity

    def rates(s, values):
        _, _, phi, fx, fy, turn = values
        own = np.asarray(jax.vmap(mass)(jnp.asarray(s)))
        return np.stack([
            np.cos(phi), np.sin(phi), turn / STIFFNESS, -own * gx, -own * gy, np.sin(phi) * fx - np.cos(phi) * fy
        ])  # fmt: skip

    def rates_of_parts(t, values):
        """Both parts, before and behind the jump, on the interval from 0 to 1."""
        first, second = rates(0.8 + 0.4 * t - 1e-12, values[:6]), rates(1.2 + 0.8 * t, values[6:])
        return np.concatenate([0.4 * first, 0.8 * second])

    def ends(start, end):
        tip = end[9:] - (0.2 * gx, 0.2 * gy, 0.0)
        return np.concatenate([start[:3] - (x * LENGTH, y * LENGTH, angle), end[:6] - start[6:], tip])

    t = np.linspace(0.0, 1.0, 41)
    guess = np.zeros((12, t.size))
    guess[[2, 8]] = angle
    found = solve_bvp(rates_of_parts, ends, t, guess, tol=SOLVED, max_nodes=100_000)
    assert found.success
    fx, fy, turn = found.sol(0.0)[3:6]
    expected = fx / UNIT.force, fy / UNIT.force, turn / UNIT.moment
    about = rod.moment(x, y, load)
    size = np.abs(expected).max()
    np.testing.assert_allclose((load.force_x, load.force_y, about), expected, atol=10 * SOLVED * size)

    s = at + (1 - at) * jnp.linspace(0.0, 1.0, 17)
    (line_x, line_y, cos, sin), loads = weight.line(start, load, s, section)
    end = found.sol(1.0)[6:9]
    tip = line_x[-1] * LENGTH, line_y[-1] * LENGTH, np.arctan2(sin[-1], cos[-1])
    np.testing.assert_allclose(tip, end, atol=10 * SOLVED * size)
    assert abs(jnp.asarray(rod.moment(line_x, line_y, loads))[-1]) < INTEGRATED * size


@pytest.mark.parametrize("tip_mass", [None, 0.2])
def test_beyond_the_tip_is_its_mass(tip_mass):
    weight, section = own(jw.Whisker(LENGTH, STIFFNESS, mass_per_length=1.0, tip_mass=tip_mass))
    start = tuple(map(jnp.asarray, (0.1, 0.2, 0.6, 0.8)))
    load = weight.beyond(start, jnp.asarray(1.0), jnp.asarray(1.0), section, steps=8)
    force = np.multiply(GRAVITY, tip_mass or 0.0)
    np.testing.assert_allclose(np.multiply((load.force_x, load.force_y), UNIT.force), force, atol=ROUNDING)
    np.testing.assert_allclose(load.moment, 0.1 * load.force_y - 0.2 * load.force_x, atol=ROUNDING)


def test_a_load_has_derivatives():
    def load(p):
        x, angle, at, gravity_x, gravity_y, tip = p
        whisker = jw.Whisker(LENGTH, STIFFNESS, mass_per_length=mass, breaks=(1.2,), tip_mass=tip)
        weight, section = own(whisker, (gravity_x, gravity_y))
        start = x, x, jnp.cos(angle), jnp.sin(angle)
        load = weight.beyond(start, at, jnp.asarray(1.0), section, steps=8)
        return jnp.stack([load.force_x, load.force_y, load.moment])

    p = jnp.array([0.2, 0.4, 0.45, 0.7, -1.5, 0.2])
    check_derivatives(load, p, seed=1, differences=DIFFERENCES, visible=1e-3, jit=True)


def test_what_is_not_found_is_nan():
    weight, section = own(gravity=(0.0, jnp.nan))
    start = tuple(map(jnp.asarray, (0.0, 0.0, 1.0, 0.0)))
    load = weight.beyond(start, jnp.asarray(0.4), jnp.asarray(1.0), section, steps=8)
    assert np.isnan(load.moment)


def test_gravity_is_finite():
    assert valid_gravity(None) and valid_gravity((0.0, -9.81))
    assert not valid_gravity((jnp.inf, 0.0)) and not valid_gravity((0.0, jnp.nan))
    assert weights_of((WHISKER,), None, UNIT) is None
