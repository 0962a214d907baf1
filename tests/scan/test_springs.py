"""Walks along a whisker past a spring and a foundation against scipy; lengths of springs of bases in closed form."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

import jaxwhisker as jw
from jaxwhisker._model.motion import Pose
from jaxwhisker._rod import rod
from jaxwhisker._scan.springs import (
    at_arcs,
    at_base,
    held,
    holds,
    load_beyond,
    moment_at,
    on_shafts,
    outwards,
    shaft_energy,
    spring_length,
    spring_lengths,
    spring_tangents,
    suspension,
)
from scenes import follicle

ROD = 1e-9  # of rods that scipy integrates to 1e-12
EXACT = 1e-13
ENERGY = 1e-8
STEPS = 3
WHISKER = jw.Whisker(1.2, 1.7)
AXIAL = jw.Spring((0, 1), 20.0, 0.2, axis="axial", at=0.4, anchor=(-0.25, 0.3))
TISSUE = jw.Foundation(0.1, 0.25, 30.0, 0.02)
SUPPORT = jw.Support((AXIAL,), foundation=TISSUE)
SCENE = jw.Scene(WHISKER, jw.Parabola(0.3), SUPPORT)
BASE, REACTION, CONTROL = np.array([0.13, 0.0, 0.05]), np.array([-0.6, 0.9, 0.8]), 0.1
S = np.array([0.0, 0.05, 0.2, 0.4, 0.7, 0.9])


def lengths(scene, base, control):
    return spring_length(suspension(scene), base, jnp.asarray(control))[: len(scene.support.springs)]


def by_scipy(*, springs):
    """States x, y, angle, load and energies of rod and foundation, at the arc lengths S."""
    x, y, angle = BASE
    fx, fy, mz = REACTION
    values = np.array([x, y, np.pi / 2 + angle, -fx, -fy, -mz - x * fy + y * fx, 0.0])
    rows, s = [], 0.0

    def rate(s, values, on):
        x, y, phi, fx, fy, about, _ = values
        strain = x - CONTROL - float(TISSUE.rest_length)
        push = -30.0 * strain if on else 0.0
        moment = about - x * fy + y * fx
        energy = moment**2 / (2 * 1.7) + (30.0 * strain**2 / 2 if on else 0.0)
        return [np.cos(phi), np.sin(phi), moment / 1.7, -push, 0.0, y * push, energy]

    for stop in (0.1, 0.25, 0.4, 0.9):
        on = springs and s == 0.1
        path = solve_ivp(rate, (s, stop), values, args=(on,), rtol=1e-12, atol=1e-13, dense_output=True)
        inside = S[(s <= S) & (stop > S)]
        rows += list(path.sol(inside).T) if inside.size else []
        values, s = path.y[:, -1], stop
        if stop == 0.4 and springs:
            away = values[:2] - [CONTROL - 0.25, 0.3]
            push = -20.0 * (np.hypot(*away) - 0.2) * away / np.hypot(*away)
            values[3:6] -= *push, values[0] * push[1] - values[1] * push[0]
    return np.array([*rows, values]).T


@jax.jit
def walked():
    base, reaction, arc = Pose(*jnp.asarray(BASE)), tuple(jnp.asarray(REACTION)), jnp.asarray(S[-1])
    by = holds(SCENE)
    assert by is not None
    (own,), _ = held(by, SCENE.whiskers, jnp.asarray(CONTROL), None)
    each = Pose(*(jnp.asarray(v)[None] for v in BASE)), tuple(jnp.asarray(v)[None] for v in REACTION)
    return {
        "plain": jnp.stack(outwards(WHISKER, base, reaction, arc, count=10)),
        "held": jnp.stack(outwards(WHISKER, base, reaction, arc, own, count=19)),
        "at": jnp.stack(at_arcs(WHISKER, base, reaction, jnp.asarray(S[1:]))),
        "beyond": load_beyond(WHISKER, base, reaction, own),
        "energy": shaft_energy(WHISKER, base, reaction, arc, own),
        "moment": moment_at(WHISKER, base, reaction, jnp.asarray([0.0, 0.2, 0.7]), own),
        "springs": on_shafts(by, SCENE.whiskers, *each, jnp.asarray(CONTROL)),
        "lengths": spring_length(
            suspension(SCENE), tuple(map(jnp.asarray, (*each[0], *each[1]))), jnp.asarray(CONTROL)
        ),
    }


def test_without_springs_the_load_of_the_base_bends_the_whole_whisker():
    found, exact = walked(), by_scipy(springs=False)
    np.testing.assert_allclose(found["at"], exact[:2, 1:], atol=1e-6)
    x, y, _, sin = found["plain"]
    assert x[0] == BASE[0] and y[0] == BASE[1]
    np.testing.assert_allclose([x[-1], y[-1], sin[-1]], [*exact[:2, -1], np.sin(exact[2, -1])], atol=ROD)


def test_springs_and_tissue_change_the_load_along_the_shaft():
    found, exact = walked(), by_scipy(springs=True)
    x, y, cos, sin = found["held"]
    index = np.rint(S / 0.05).astype(int)
    for one, other in zip((x, y, cos, sin), (*exact[:2], np.cos(exact[2]), np.sin(exact[2])), strict=True):
        np.testing.assert_allclose(np.asarray(one)[index], other, atol=1e-8)
    load = found["beyond"]
    np.testing.assert_allclose([load.force_x, load.force_y, load.moment], exact[3:6, -1], atol=1e-8)
    at_points = exact[5] - exact[0] * exact[4] + exact[1] * exact[3]
    np.testing.assert_allclose(found["moment"], at_points[[0, 2, 4]], atol=1e-8)
    assert abs(float(found["moment"][0]) + REACTION[2]) < EXACT
    np.testing.assert_allclose(found["energy"], exact[6, -1], atol=ENERGY)


def test_an_axial_spring_goes_from_its_anchor_to_the_shaft():
    found, exact = walked(), by_scipy(springs=True)
    (spring,) = found["springs"]
    np.testing.assert_allclose([spring.anchor_x, spring.anchor_y], [CONTROL - 0.25, 0.3], atol=EXACT)
    at = exact[:2, 3]
    np.testing.assert_allclose([spring.x, spring.y], at, atol=ROD)
    np.testing.assert_allclose(spring.length, np.hypot(*(at - [CONTROL - 0.25, 0.3])), atol=ROD)
    np.testing.assert_array_equal(found["lengths"], [spring.length])


def test_the_load_at_the_base_balances_the_reaction():
    start, load = at_base(Pose(*map(jnp.asarray, BASE)), tuple(REACTION))
    x, y, cos, sin = map(float, start)
    np.testing.assert_allclose([x, y, np.arctan2(sin, cos) - np.pi / 2], BASE, atol=EXACT)
    np.testing.assert_allclose(np.array([load.force_x, load.force_y]), -REACTION[:2], atol=EXACT)
    assert abs(float(rod.moment(x, y, load)) + REACTION[2]) < EXACT


def test_lengths_of_the_springs_of_a_base_are_measured_in_the_frame_of_the_drive():
    turn, motion = 0.4, jw.Rotation((0.3, -0.2), 0.4)
    support = follicle(x=70.0, y=200.0, phi=5.0, mount=(0.05, 0.02, 0.1))
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), support, motion=motion)
    frame = [np.asarray(v, dtype=float) for v in motion.pose(turn)]
    away = np.array([0.11, -0.03, 0.25])  # from the mount, in the frame of the drive
    x, y = away[:2] + np.array([0.05, 0.02])
    cos, sin = np.cos(frame[2]), np.sin(frame[2])
    base = frame[0] + x * cos - y * sin, frame[1] + x * sin + y * cos, frame[2] + 0.1 + away[2]
    found = jax.jit(lambda base: spring_length(suspension(scene), base, jnp.asarray(turn)))(
        tuple(jnp.array([v]) for v in base)
    )
    np.testing.assert_allclose(found, away, atol=EXACT)
    assert frame[2] != 0


def test_lengths_of_springs_along_x():
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fbfbr(70.0))
    found = jax.jit(lambda x: spring_length(suspension(scene), (x, 0 * x, 0 * x), jnp.asarray(0.3)))(
        jnp.array([0.5, 0.9])
    )
    ends = np.array([0.3, 0.5, 0.9])
    expected = [ends[spring.between[1]] - ends[spring.between[0]] for spring in scene.support.springs]
    np.testing.assert_allclose(found, expected, atol=EXACT)


def turning(count=1):
    """A turning base; with many whiskers, more numbers than slopes are worth."""
    motion = jw.Rotation((0.3, -0.2), 0.4)
    if count == 1:
        return jw.Scene(
            jw.Whisker(), jw.Parabola(0.2), follicle(70.0, 200.0, 5.0, mount=(0.05, 0.02, 0.1)), motion=motion
        )
    springs = tuple(jw.Spring((0, k), 70.0, 0.2 * k) for k in range(1, count + 1))
    return jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support(springs), motion=motion)


def test_tangents_of_spring_lengths_are_those_of_jax():
    some, rng = suspension(turning()), np.random.default_rng(1)
    bases = tuple(jnp.asarray(rng.normal(size=(STEPS, 1))) for _ in range(3))
    control = jnp.asarray(rng.normal(size=STEPS))
    numbers, rest = eqx.partition(some, eqx.is_inexact_array)
    numbers = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype=float), numbers)
    some = eqx.combine(numbers, rest)
    dots = jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=leaf.shape)), (numbers, bases, control))

    @jax.jit
    def by_jax(*dots):
        def lengths(numbers, bases, control):
            return spring_lengths(eqx.combine(numbers, rest), bases, control)

        return jax.jvp(lengths, (numbers, bases, control), dots)[1]

    np.testing.assert_allclose(spring_tangents((some, bases, control), dots, None), by_jax(*dots), atol=EXACT)
    # What has no tangent stays where it is.
    none, (_, y, _) = jax.tree.map(lambda _: None, numbers), dots[1]
    still, zero, _ = jax.tree.map(jnp.zeros_like, (numbers, y, control))
    found = spring_tangents((some, bases, control), (none, (None, y, None), None), None)
    np.testing.assert_allclose(found, by_jax(still, (zero, y, zero), zero[:, 0]), atol=EXACT)
    assert np.any(found != 0)


def test_scenes_of_many_numbers_are_left_to_jax():
    many = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype=float) if isinstance(leaf, float) else leaf, turning(40))
    bases = (jnp.zeros((STEPS, 40)),) * 3
    none = jax.tree.map(lambda _: None, eqx.filter(many, eqx.is_inexact_array))
    assert spring_tangents((many, bases, jnp.zeros(STEPS)), (none, (None,) * 3, None), None) is NotImplemented
