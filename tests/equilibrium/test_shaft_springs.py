"""Springs and tissue on one shaft: laws of single springs, and rods past all of them against SciPy."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxwhisker as jw
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium import shaft_springs
from jaxwhisker._equilibrium.shaft_springs import AXIAL, Attachments, ShaftSprings, Tissue
from jaxwhisker._model.motion import Frame
from jaxwhisker._rod.rod import Load

ROUNDING = 1e-13
INTEGRATED = 1e-8  # of the rod with 8 steps from one spring to the next, and of the reference
DIFFERENCE = 1e-8  # of central differences

AXES = (0, 1, 2, AXIAL)
TURN = 0.3
DRIVE = Frame(*map(jnp.asarray, (0.1, -0.2, np.cos(TURN), np.sin(TURN))))


def spring(at=0.4, anchor=(0.3, 0.1, 0.2), stiffness=3.0, rest=0.1, axis=0, one_sided=0.0, law=0, share=1.0):
    return ShaftSprings(*map(jnp.asarray, (at, *anchor, stiffness, rest, axis, one_sided, law, share)))


def stacked(springs):
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *springs)


class Cubic(eqx.Module):
    """A law of tension."""

    stiffness: float

    def __call__(self, extension):
        return self.stiffness * extension**3


def test_tensions_follow_their_laws():
    # Rest length 0.1: lengths at which springs are longer and shorter than that.
    cases = [
        (spring(), 0.3, 0.6),
        (spring(), -0.3, -1.2),
        (spring(one_sided=1.0), 0.3, 0.6),
        (spring(one_sided=1.0), -0.3, 0.0),
        (spring(one_sided=-1.0), 0.3, 0.0),
        (spring(one_sided=-1.0), -0.3, -1.2),
        (spring(share=0.25), 0.3, 0.15),
        (spring(law=1), 0.3, 5.0 * 0.2**3),
        (spring(law=2), -0.3, -7.0 * 0.4**3),
        (spring(law=2, one_sided=1.0, share=0.5), 0.3, 3.5 * 0.2**3),
    ]
    springs, lengths, expected = zip(*cases, strict=True)
    laws = Cubic(5.0), Cubic(7.0)
    tension = Program(
        lambda springs, at: jax.vmap(lambda *own: shaft_springs.tension_of(own[0], laws, own[1]))(springs, at)
    )
    np.testing.assert_allclose(tension(stacked(springs), jnp.array(lengths)), expected, atol=ROUNDING)


def length(state, axis, at=0.4, anchor=(0.3, 0.1, 0.2)):
    """Length of a spring, from the pose (x, y, phi) of the whisker in the scene."""
    x, y, phi = state
    x, y = x + min(at, 0.0) * np.cos(phi) - 0.1, y + min(at, 0.0) * np.sin(phi) + 0.2
    cos, sin = np.cos(TURN), np.sin(TURN)
    pose = np.array([x * cos + y * sin, y * cos - x * sin, phi - np.pi / 2 - TURN]) - anchor
    return np.hypot(*pose[:2]) if axis == AXIAL else pose[axis]


@pytest.mark.parametrize("at", [0.4, 0.0, -0.3])
def test_loads_are_slopes_of_the_stored_energy(at):
    state, step = np.array([0.7, 0.9, 1.4]), 1e-6
    springs = stacked([spring(at, axis=axis) for axis in AXES])
    rod = tuple(jnp.asarray(v) for v in (state[0], state[1], np.cos(state[2]), np.sin(state[2])))
    before = Load(*map(jnp.asarray, (0.2, -0.1, 0.4)))
    (lengths, *_), past = on_the_way(springs, rod, before)
    for k, axis in enumerate(AXES):
        np.testing.assert_allclose(lengths[k], length(state, axis, at), atol=ROUNDING)
        energies = [
            [3.0 * (length(state + s * np.eye(3)[i], axis, at) - 0.1) ** 2 / 2 for s in (-step, step)] for i in range(3)
        ]
        force_x, force_y, turn = (-(up - down) / (2 * step) for down, up in energies)
        added = [past.force_x[k] - 0.2, past.force_y[k] + 0.1, past.moment[k] - 0.4]
        # A load's moment is that about the origin of the scene.
        expected = force_x, force_y, turn + state[0] * force_y - state[1] * force_x
        np.testing.assert_allclose(added, expected, atol=10 * DIFFERENCE)


@Program
def on_the_way(springs, rod, before):
    """Lengths of springs and their slopes, and the load on the rod behind each."""

    def one(own):
        return shaft_springs.stretched(own, rod, DRIVE), shaft_springs.past(before, own, (), rod, DRIVE, 1.0)

    return jax.vmap(one)(springs)


# Down from the tip: an axial spring, tissue from 0.75 to 0.3, a spring along x, one at the base and one below it.
TISSUE = Tissue(*map(jnp.asarray, (0.3, 0.75, 4.0, 0.05, 0.05, 0.1, np.cos(0.1), np.sin(0.1))))
SPRINGS = [
    spring(0.9, axis=AXIAL),
    spring(0.75, share=0.0),
    spring(0.5, stiffness=1.5),
    spring(0.3, share=0.0),
    spring(0.0, axis=2, stiffness=0.8),
    spring(-0.2, axis=1, stiffness=2.0),
]
TIP, ARC, BENDING = (-0.3, 0.8, 2.1), 1.1, 1.4
given = np.random.default_rng(2).normal(size=(6, 3)) * np.array([1.0, 1.0, 0, 0, 1.0, 1.0])[:, None] * 0.3


def on_the_way_from_the_tip(held, stiffness):
    x, y, phi = map(jnp.asarray, TIP)
    start = x, y, jnp.cos(phi), jnp.sin(phi)
    load = Load(jnp.asarray(0.3), jnp.asarray(-0.2), -0.3 * y - 0.2 * x)
    return start, load, jnp.asarray(ARC), stiffness, held, (), DRIVE


@Program
def walked(held, stiffness):
    return shaft_springs.walk(*on_the_way_from_the_tip(held, stiffness), steps=8)


@Program
def at_base(held, stiffness):
    method = jw.Shooting(8)
    return shaft_springs.base_of_walk(*on_the_way_from_the_tip(held, stiffness), method, method)


def reference(with_given):
    """State and load at the base of the same rod, and the load above the springs there."""
    state, s = np.array(TIP), ARC
    x, y, _ = TIP
    load, above = np.array([0.3, -0.2, -0.3 * y - 0.2 * x]), np.zeros(0)
    cos, sin = np.cos(TURN), np.sin(TURN)
    line_cos, line_sin = np.cos(0.1), np.sin(0.1)

    def towards_base(s, values, on):
        x, y, phi, *load = values
        bend = (load[2] - x * load[1] + y * load[0]) / BENDING
        # Tissue pushes across the straight line of the unloaded whisker.
        across = (x - 0.1) * cos + (y + 0.2) * sin - 0.05 + s * line_sin
        along = (y + 0.2) * cos - (x - 0.1) * sin - 0.1 - s * line_cos
        push = -on * 4.0 * (across * line_cos + along * line_sin - 0.05)
        fx, fy = push * (line_cos * cos - line_sin * sin), push * (line_cos * sin + line_sin * cos)
        return [np.cos(phi), np.sin(phi), bend, -fx, -fy, -(x * fy - y * fx)]

    for own, extra in zip(SPRINGS, given, strict=True):
        stop = max(float(own.at), 0.0)
        if stop < s:
            on = 0.3 < (s + stop) / 2 < 0.75
            run = solve_ivp(towards_base, (s, stop), [*state, *load], args=(on,), rtol=1e-11, atol=1e-12)
            state, load = run.y[:3, -1], run.y[3:, -1]
        if stop == 0 and above.size == 0:
            above = load
        axis, at, step = int(own.axis), float(own.at), 1e-5
        tension = float(own.stiffness * own.share) * (length(state, axis, at) - 0.1)
        slopes = [(length(state + d, axis, at) - length(state - d, axis, at)) / (2 * step) for d in step * np.eye(3)]
        fx, fy, turn = -tension * np.array(slopes)
        x, y = state[:2]
        if with_given:
            more_x, more_y = extra[0] * cos - extra[1] * sin, extra[0] * sin + extra[1] * cos
            below = min(at, 0.0)
            fx, fy = fx + more_x, fy + more_y
            turn += extra[2] + below * (np.cos(state[2]) * more_y - np.sin(state[2]) * more_x)
        load, s = load + np.array([fx, fy, turn + x * fy - y * fx]), stop
    return state, load, above


@pytest.mark.parametrize("with_given", [False, True])
def test_a_rod_past_all_springs(with_given):
    held = Attachments(stacked(SPRINGS), TISSUE, jnp.asarray(given * with_given))
    found = walked(held, jnp.asarray(BENDING))
    _, _, carried, _ = at_base(held, jnp.asarray(BENDING))
    state, load, above = reference(with_given)
    x, y, cos, sin = found.end
    np.testing.assert_allclose([x, y, cos, sin], [*state[:2], np.cos(state[2]), np.sin(state[2])], atol=INTEGRATED)
    for got, expected in ((found.load, load), (carried, above)):
        np.testing.assert_allclose([got.force_x, got.force_y, got.moment], expected, atol=10 * INTEGRATED)
    # The last places are at the base, or below it: nothing lies between them.
    np.testing.assert_array_equal(np.stack(found.passed)[:, -2:], np.stack([found.end] * 2, axis=1))


@Program
def walked_past_more(held, at, stiffness):
    more, places = held.with_places(at)
    return more, places, held.top, walked.function(more, stiffness)


def test_places_without_springs_change_nothing():
    held, at = Attachments(stacked(SPRINGS), TISSUE, jnp.asarray(given)), np.array([0.6, 1.0, 0.0])
    more, places, top, other = walked_past_more(held, jnp.asarray(at), jnp.asarray(BENDING))
    np.testing.assert_array_equal(np.asarray(more.springs.at)[places], at)
    assert np.all(np.diff(more.springs.at) <= 0) and top == 0.9
    np.testing.assert_array_equal(np.asarray(more.springs.share)[places], 0.0)
    np.testing.assert_array_equal(np.delete(np.asarray(more.given), places, axis=0), given)
    plain = walked(held, jnp.asarray(BENDING))
    np.testing.assert_allclose(np.stack(other.end), np.stack(plain.end), atol=INTEGRATED)
    np.testing.assert_allclose(other.load.moment, plain.load.moment, atol=10 * INTEGRATED)


def test_weakened_springs_pull_with_a_share_of_their_tension():
    held = Attachments(stacked(SPRINGS), TISSUE)
    half = held.weakened(jnp.asarray(0.5))
    np.testing.assert_array_equal(half.springs.share, 0.5 * np.asarray(held.springs.share))
    assert half.tissue is not None and half.tissue.stiffness == 2.0
    assert half.springs.stiffness is held.springs.stiffness
    assert Attachments(held.springs).weakened(jnp.asarray(0.5)).tissue is None


def test_the_base_is_computed_by_one_method_and_its_derivatives_by_another():
    # In reverse mode, see the scans in tests/physics/test_shaft_springs.py.
    springs, coarse, fine = stacked(SPRINGS[::2]), jw.Shooting(1), jw.Shooting(8)
    # A spring at the base moves off it on one side only.
    direction, step = np.array([[0.3, -0.5, 0.0], [0.4, 0.2, -0.6]]), 1e-5

    def base(numbers, method, for_rates):
        x, y, phi = map(jnp.asarray, TIP)
        held = Attachments(springs._replace(at=numbers[0], stiffness=numbers[1]))
        start, load = (x, y, jnp.cos(phi), jnp.sin(phi)), Load(*map(jnp.asarray, (0.3, -0.2, 0.1)))
        walk = start, load, jnp.asarray(ARC), jnp.asarray(BENDING), held, (), DRIVE
        end, total, _, _ = shaft_springs.base_of_walk(*walk, method, for_rates)
        return jnp.stack([*end, jnp.asarray(total.moment)])

    @Program
    def computed(numbers):
        mixed = jax.jvp(lambda at: base(at, coarse, fine), (numbers,), (jnp.asarray(direction),))
        return *mixed, base(numbers, coarse, coarse), base(numbers, fine, fine)

    numbers = np.stack([springs.at, springs.stiffness])
    here, ahead, behind = (computed(jnp.asarray(numbers + s * direction)) for s in (0.0, step, -step))
    value, rate, by_coarse, by_fine = here
    np.testing.assert_allclose(value, by_coarse, atol=ROUNDING)
    assert np.max(np.abs(by_coarse - by_fine)) > 100 * ROUNDING
    np.testing.assert_allclose(rate, (ahead[3] - behind[3]) / (2 * step), atol=10 * DIFFERENCE)
