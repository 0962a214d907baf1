"""The weight of a whisker in space: its parts against numbers, and the part beyond a contact against SciPy."""

# pyright: reportArgumentType=false, reportCallIssue=false

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxwhisker as jw
from jaxwhisker._model.scene import Units
from jaxwhisker._space.section import space_section
from jaxwhisker._space.weight import newton_step, total_weights, weight_of_one, weights_in_space
from scenes import check_derivatives

ROUNDING = 1e-13
INTEGRATED = 1e-8  # of a rod with 16 steps, relative to the load
DIFFERENCES = 1e-7

LENGTH, STIFFNESS = 2.0, 3.0
GRAVITY = 0.7, -1.5, 0.4
UNIT = Units(*map(jnp.asarray, (LENGTH, STIFFNESS / LENGTH**2, STIFFNESS / LENGTH, LENGTH)))


def mass(s):
    """Falls to a tenth at the tip, and jumps at 1.2."""
    return jnp.where(s < 1.2, 1.0 - 0.3 * s, 0.5 - 0.2 * s)


WHISKER = jw.Whisker(LENGTH, STIFFNESS, mass_per_length=mass, breaks=(1.2,), tip_mass=0.2, torsion_ratio=0.7)
TOTAL = 1.2 - 0.15 * 1.2**2 + 0.5 * 0.8 - 0.1 * (2.0**2 - 1.2**2) + 0.2


def own(whisker=WHISKER, gravity=GRAVITY):
    """Weight and section of one whisker."""
    weight = jax.tree.map(lambda leaf: leaf[0], weights_in_space((whisker,), gravity, UNIT))
    return weight, space_section(whisker, UNIT.length, UNIT.moment * UNIT.length, heavy=True)


def turned(angles):
    """A state at a place, with a rotation."""
    a, b = angles
    (c, s), (d, e) = ((jnp.cos(x), jnp.sin(x)) for x in (a, b))
    q = c * d, s * d, c * e, -s * e
    return tuple(map(jnp.asarray, (0.2, -0.1, 0.3))), q


def test_weights_are_integrals_of_masses():
    weight, section = own()
    force = weight.total(section, jnp.asarray(0.0), jnp.asarray(1.0)) * UNIT.force
    np.testing.assert_allclose(force, np.multiply(GRAVITY, TOTAL), rtol=ROUNDING)
    np.testing.assert_allclose(total_weights((WHISKER,), GRAVITY)[0], np.multiply(GRAVITY, TOTAL), rtol=ROUNDING)
    one = weight_of_one(WHISKER, GRAVITY)
    np.testing.assert_allclose(one.along, GRAVITY, rtol=ROUNDING)
    assert one.tip_mass == 0.2 and weights_in_space((WHISKER,), None, UNIT) is None
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(one.seen_in(quarter).along, quarter.T @ GRAVITY, atol=ROUNDING)


@pytest.mark.parametrize(
    ("gravity", "angles"), [(GRAVITY, (0.4, 0.1)), ((0.0, -30.0, 1.0), (-0.7, 0.0)), ((9.0, 3.0, -9.0), (0.1, 0.5))]
)
def test_the_part_beyond_a_contact_is_a_cantilever(gravity, angles):
    """Integrated by SciPy from the contact on, it arrives at its tip without a moment."""
    weight, section = own(gravity=gravity)
    start, at = turned(angles), 0.8
    load = weight.beyond(start, jnp.asarray(at / LENGTH), jnp.asarray(1.0), section)
    r, q = np.array(start[0]), np.array(start[1])
    force, about_origin = (np.array(part) for part in (load.force, load.moment))
    moment = (about_origin + np.cross(force, r)) * UNIT.moment

    def directors(q):
        w, x, y, z = q / np.linalg.norm(q)
        return np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ])  # fmt: skip

    def rates(s, y):
        d = y[:9].reshape(3, 3)
        k = d.T @ y[12:] / (STIFFNESS * np.array([1.0, 1.0, 0.7]))
        hat = np.array([[0.0, -k[2], k[1]], [k[2], 0.0, -k[0]], [-k[1], k[0], 0.0]])
        own = 1.0 - 0.3 * s if s < 1.2 else 0.5 - 0.2 * s
        return np.concatenate([(d @ hat).ravel(), -own * np.array(gravity), -np.cross(d[:, 2], y[9:12])])

    y = np.concatenate([directors(q).ravel(), force * UNIT.force, moment])
    for ends in ((at, 1.2), (1.2, LENGTH)):
        y = solve_ivp(rates, ends, y, method="DOP853", rtol=1e-12, atol=1e-12, max_step=0.1).y[:, -1]
    size = np.linalg.norm(np.array(force) * UNIT.force)
    np.testing.assert_allclose(y[12:] / size, 0.0, atol=INTEGRATED)
    np.testing.assert_allclose(y[9:12], 0.2 * np.array(gravity), atol=INTEGRATED * size)


def test_the_load_has_derivatives_in_both_modes():
    def load(p):
        whisker = jw.Whisker(LENGTH, STIFFNESS, mass_per_length=p[0], tip_mass=p[1])
        weight, section = own(whisker, (p[2], p[3], p[4]))
        found = weight.beyond(turned((0.3, p[6])), p[5], jnp.asarray(1.0), section)
        return jnp.stack([*found.force, *found.moment])

    p = jnp.array([1.0, 0.2, 0.5, -1.0, 0.3, 0.4, 0.2])
    check_derivatives(load, p, seed=1, differences=DIFFERENCES, visible=1e-3, jit=True)


def test_lines_follow_a_whisker_to_its_tip():
    weight, section = own()
    start, s = turned((0.4, 0.1)), np.linspace(0.4, 1.0, 9)
    load = weight.beyond(start, jnp.asarray(0.4), jnp.asarray(1.0), section)
    ((x, _, _), _), loads = weight.line(start, load, jnp.asarray(s), section)
    assert x.shape == s.shape and float(x[0]) == 0.2
    tip = np.array([part[-1] for part in loads.force]) * UNIT.force
    np.testing.assert_allclose(tip, 0.2 * np.array(GRAVITY), atol=INTEGRATED)


def test_newton_steps_solve_linear_equations_at_once():
    matrix, right = jnp.array([[2.0, 0.3, 0.1], [0.0, 1.0, -0.4], [0.5, 0.0, 3.0]]), jnp.array([1.0, 2.0, 3.0])
    step = newton_step(lambda x: jnp.sum(matrix * x, axis=1) - right, jnp.ones(3))
    np.testing.assert_allclose(matrix @ (1 + step), right, rtol=ROUNDING)
