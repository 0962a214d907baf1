"""Scans with Coulomb friction: against exact states by elliptic integrals, and by laws."""

import json
from functools import cache, partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxwhisker as jw
from scenes import all_ok

CASES = json.loads((Path(__file__).parent.parent / "data/friction.json").read_text())["cases"]
COLUMNS = {"base_x": 1, "fx": 2, "fy": 3, "mz": 4, "contact_force": 5, "contact_slope": 6, "contact_arc": 7}
SIGNAL = 1e-8  # relative to the peak
ROUNDING = 5.1e-11  # of the reference's control, which counts with the slope of the signal
EVENT = 1e-8
STEP = 1e-5  # of differences
DIFFERENCE = 1e-6  # error of central differences, relative to 1 + the derivative
LIMIT = 1e-9  # for friction that vanishes
ROLLING = 1e-9  # slip of a contact that sticks
SAME = 1e-9  # for scenes that are mirror images
SUPPORTS = {"clamped": jw.Support.clamped, "FB": lambda: jw.Support.fb(70.0), "FBFBR": lambda: jw.Support.fbfbr(70.0)}

by_name = pytest.mark.parametrize("case", CASES, ids=[case["name"] for case in CASES])


def scene(case):
    spring, profile = case["spring"], case["profile"]
    support = jw.Support.clamped() if spring is None else jw.Support.fb(spring["stiffness"], spring["rest_length"])
    return jw.Scene(jw.Whisker(), jw.Parabola(profile["distance"], profile["a"]), support, friction=case["friction"])


def table(rows):
    """Rows of the reference without the phase."""
    return np.array([row[:1] + row[2:] for row in rows])


def check(case, result, exact, first=0):
    peaks = np.max(np.abs(table(case["forward"])), axis=0)
    for name, column in COLUMNS.items():
        ours = np.asarray(getattr(result, name))[first:, 0]
        slopes = np.abs(np.gradient(ours, np.asarray(result.control)[first:]))
        allowed = SIGNAL * peaks[column] + ROUNDING * (1 + np.nan_to_num(slopes, nan=np.inf, posinf=np.inf))
        assert np.all(np.abs(ours - exact[:, column]) < allowed), name


@by_name
def test_the_way_out_is_exact(case):
    exact = table(case["forward"])
    if case["spring"] is not None:
        exact = exact[:-1]  # the last state lies beyond the fold, where it is not stable any more
    result = jw.scan(scene(case), exact[:, 0])
    assert all_ok(result)
    check(case, result, exact)
    assert np.all(result.slip == -1)
    assert [jw.Phase(p).name for p in np.asarray(result.phase)[:, 0]] == [r[1] for r in case["forward"][: len(exact)]]


@by_name
def test_a_contact_sticks_where_the_drive_turns_and_then_slips_back(case):
    for turn in case["turns"]:
        stick, back = table(turn["stick"]), table(turn["back"])
        control = np.concatenate([[0.9, turn["turn_at"]], stick[:, 0], back[:, 0]])
        result = jw.scan(scene(case), control)
        assert all_ok(result)
        check(case, result, np.concatenate([stick, back]), first=2)
        slip = np.asarray(result.slip)[2:, 0]
        assert np.all(slip[: len(stick) - 1] == 0) and np.all(slip[len(stick) + 1 :] == 1)
        (sticks,), (slips, *_) = result.events.of(jw.EventKind.stick), result.events.of(jw.EventKind.slip)
        assert sticks.control == turn["turn_at"] and abs(slips.control - turn["slips_at"]) < EVENT


def reversing(p, support):
    """A scan that turns twice, with parameters q, a, mu and the position of the first turn."""
    q, a, mu, turn = p
    control = np.concatenate(
        [np.linspace(0.9, -0.1, 8), [-0.0995, -0.099, -0.098], np.linspace(-0.09, 0.3, 6), np.linspace(0.2, -1.1, 9)]
    )
    control = jnp.asarray(control).at[7].add(turn)
    return jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(q, a), SUPPORTS[support](), friction=mu), control)


P = jnp.array([0.2, 1.0, 0.3, 0.0])


@cache
def reversed_scan(support):
    return reversing(P, support)


@pytest.mark.parametrize("support", ["clamped", "FBFBR"])
def test_states_obey_the_laws_of_friction(support):
    result = reversed_scan(support)
    assert all_ok(result)
    touching, slip = np.asarray(result.phase) > 0, np.asarray(result.slip)
    normal, along, force = (np.asarray(v) for v in (result.normal_force, result.friction_force, result.contact_force))
    np.testing.assert_allclose(np.hypot(normal, along), force, atol=LIMIT)
    assert np.all(normal >= 0) and np.all(np.abs(along) <= 0.3 * normal + LIMIT)
    slips = touching & (slip != 0)
    np.testing.assert_allclose(along[slips], (-0.3 * slip * normal)[slips], atol=LIMIT)
    # The reactions balance the contact force, which has these parts along the object's normal and tangent.
    alpha = np.asarray(result.contact_slope)
    np.testing.assert_allclose(result.fx, -normal * np.sin(alpha) - along * np.cos(alpha), atol=LIMIT)
    np.testing.assert_allclose(result.fy, normal * np.cos(alpha) - along * np.sin(alpha), atol=LIMIT)
    # A contact moves along the object in the direction of slip; a contact that sticks moves as the whisker rolls.
    x, arc = np.asarray(result.contact_x), np.asarray(result.contact_arc)
    for k in range(len(x) - 1):
        for i in range(x.shape[1]):
            if not (touching[k, i] and touching[k + 1, i]) or slip[k, i] != slip[k + 1, i]:
                continue
            t = np.linspace(x[k, i], x[k + 1, i], 2001)
            moved = np.sign(t[-1] - t[0]) * np.sum(np.hypot(np.diff(t), np.diff(t**2))) - (arc[k + 1, i] - arc[k, i])
            assert abs(moved) < 1e-7 if slip[k, i] == 0 else moved * slip[k, i] > 0, (k, i)
    assert {-1, 0, 1} <= set(slip[touching].tolist())


@pytest.mark.parametrize("support", ["clamped", "FBFBR"])
def test_derivatives_remember_where_contacts_began_to_stick(support):
    def values(p):
        result = reversing(p, support)
        return jnp.concatenate([result.fx.ravel(), result.mz.ravel(), result.events.control[:12]])

    slopes = np.asarray(jax.jacfwd(values)(P))
    known = np.isfinite(np.asarray(values(P)))
    for k in range(4):
        difference = (values(P.at[k].add(STEP)) - values(P.at[k].add(-STEP))) / (2 * STEP)
        error = np.abs(np.asarray(difference) - slopes[:, k]) / (1 + np.abs(slopes[:, k]))
        assert np.max(error[known]) < DIFFERENCE, k
    # While a contact sticks, the state depends on where the drive turned; on the way back it does not.
    fx = slopes[:26, 3]
    slip = np.asarray(reversed_scan(support).slip)[:, 0]
    assert np.any(np.abs(fx[8:17][slip[8:17] == 0]) > 1)
    backwards = np.asarray(jax.jacrev(lambda p: values(p)[:26])(P))
    np.testing.assert_allclose(backwards, slopes[:26], atol=1e-7 * np.max(np.abs(slopes[:26])))


@pytest.mark.parametrize("support", SUPPORTS)
def test_friction_that_vanishes_changes_nothing(support):
    smooth = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2), SUPPORTS[support]()))
    for mu, limit in ((0.0, LIMIT), (1e-12, LIMIT)):
        rough = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2), SUPPORTS[support](), friction=mu), smooth.control)
        for name in ("fx", "fy", "mz", "base_x", "contact_arc"):
            here, there = np.asarray(getattr(rough, name)), np.asarray(getattr(smooth, name))
            near_snap = np.min(np.abs(np.asarray(smooth.control)[:, None] - [e.control for e in smooth.events]), axis=1)
            far = near_snap > 1e-4
            np.testing.assert_allclose(here[far], there[far], atol=limit * np.max(np.abs(there)), err_msg=name)


def curved(friction):
    return jw.Scene(jw.Whisker(intrinsic_curvature=0.5), jw.Circle(0.2, 0.5), jw.Support.fb(70.0), friction=friction)


def test_a_curved_whisker_rocks_on_the_object():
    # It first slips up the object, comes to rest while the drive goes on, and then slips down.
    control = jnp.linspace(0.47, -0.2, 41)
    result = jw.scan(curved(0.3), control)
    assert all_ok(result)
    kinds = [e.kind.name for e in result.events]
    assert kinds == ["stick", "slip"]
    stick, slip = (e.control for e in result.events)
    slips = np.asarray(result.slip)[:, 0]
    np.testing.assert_array_equal(slips, np.where(control > stick, 1, np.where(control > slip, 0, -1)))
    arc_on_object = 0.5 * np.asarray(result.contact_slope)[:, 0]
    way = np.diff(arc_on_object - np.asarray(result.contact_arc)[:, 0])
    same = slips[1:] == slips[:-1]
    assert np.all((way * slips[1:])[same & (slips[1:] != 0)] > 0)
    # There the slip has come to rest: the rate of the way is zero, and so is that of the friction after it.
    near = jw.scan(curved(0.3), stick + jnp.array([2e-4, 1e-4, 0.0, -1e-4, -2e-4]))
    way = 0.5 * np.asarray(near.contact_slope)[:, 0] - np.asarray(near.contact_arc)[:, 0]
    assert abs(way[2] - way[1]) < abs(way[1] - way[0]) and abs(way[-1] - way[2]) < ROLLING


def test_without_any_friction_slips_turn_back_at_once():
    control = jnp.linspace(0.47, -0.2, 41)
    result, plain = jw.scan(curved(0.0), control), jw.scan(curved(None), control)
    assert all_ok(result) and set(np.asarray(result.slip)[:, 0].tolist()) == {-1, 1}
    for name in COLUMNS:
        np.testing.assert_allclose(getattr(result, name), getattr(plain, name), atol=LIMIT)


def hooked(curvature=0.58, friction=0.77, distance=0.48, stiffness=31.7):
    """A whisker that is curved towards the object, on which its tip sticks from the first touch."""
    whisker = jw.Whisker(1.0, 1.0, intrinsic_curvature=curvature)
    return jw.Scene(whisker, jw.Parabola(distance), jw.Support.fb(stiffness, 0.0), friction=friction)


HOOKED_CONTROL = jnp.linspace(0.97, -1.0, 41)


def test_a_hooked_whisker_sticks_from_its_first_touch():
    result = jw.scan(hooked(), HOOKED_CONTROL)
    assert all_ok(result)
    touch, stick, slip, snap, rest = list(result.events)[:5]
    kinds = [jw.EventKind.touch, jw.EventKind.stick, jw.EventKind.slip, jw.EventKind.snap_through, jw.EventKind.stick]
    assert [e.kind for e in (touch, stick, slip, snap, rest)] == kinds
    assert abs(touch.control - stick.control) < EVENT
    control, sticks = np.asarray(HOOKED_CONTROL), np.asarray(result.slip)[:, 0] == 0
    first = (control < touch.control) & (control > slip.control)
    assert np.all(sticks[first])
    # The tip stays where it touched, and the force within the cone of friction.
    for name in ("contact_x", "contact_y"):
        np.testing.assert_allclose(
            np.asarray(getattr(result, name))[first], getattr(touch.after, name)[0], atol=ROLLING
        )
    normal, along = np.asarray(result.normal_force), np.asarray(result.friction_force)
    assert np.all((np.abs(along) < 0.77 * normal)[first])
    # The support's reactions alone bend the whisker so that it ends there, with no moment left.
    for k in np.flatnonzero(first):
        x, y, _, moment = tip_of(0.58, result.base_x[k, 0], result.fx[k, 0], result.fy[k, 0], result.mz[k, 0])
        assert np.hypot(x - result.contact_x[k, 0], y - result.contact_y[k, 0]) < SIGNAL and abs(moment) < SIGNAL


def tip_of(curvature, base_x, fx, fy, mz):
    """Position, angle and moment at the tip of a rod that starts upright with this reaction of its support."""

    def rates(_, state):
        x, y, angle = state
        bend = -mz - fx * y + fy * (x - base_x)
        return np.cos(angle), np.sin(angle), bend + curvature

    x, y, angle = solve_ivp(rates, (0, 1), (base_x, 0, np.pi / 2), method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    return x, y, angle, -mz - fx * y + fy * (x - base_x)


def test_derivatives_where_a_contact_sticks_from_its_touch_and_where_it_comes_to_rest():
    def values(p):
        result = jw.scan(hooked(*p), HOOKED_CONTROL)
        return jnp.concatenate([result.fx[:, 0], result.mz[:, 0], result.events.control[:8]])

    p = jnp.array([0.58, 0.77, 0.48, 31.7])
    slopes = jax.jacfwd(values)(p)
    for k, size in enumerate((1.0, 1.0, 1.0, 30.0)):
        step = STEP * size * jnp.eye(4)[k]
        differences = (values(p + step) - values(p - step)) / (2 * STEP * size)
        np.testing.assert_allclose(slopes[:, k], differences, atol=DIFFERENCE, rtol=DIFFERENCE)


def test_whiskers_that_stick_cannot_be_wound_around_the_object():
    # The tip sticks to the left flank, and the drive goes back until the shaft lies against the vertex.
    support = jw.Support.fb(11702.0, 0.344)
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.01124, 2.6207), support, jw.ClosedForm(), friction=0.8586)
    control = jnp.array([0.5, -0.16907, 0.00869, -1.33126, -0.02964])
    result = jw.scan(scene, control)
    assert result.status.tolist() == [*[jw.Status.ok] * 4, jw.Status.second_contact]


def test_no_snap_gains_energy():
    # With the second contact neglected, the whisker would snap to a state of much higher energy.
    support = jw.Support.fb(11702.0, 0.344)
    make = partial(jw.Scene, jw.Whisker(), jw.Parabola(0.01124, 2.6207), support, jw.ClosedForm(), friction=0.8586)
    result = jw.scan(make(detect=()), jnp.array([0.5, -0.16907, 0.00869, -1.33126, -0.02964]))
    assert result.status.tolist() == [*[jw.Status.ok] * 4, jw.Status.unsettled]
    energies = [
        (jw.stored_energy(result.scene, e.before), jw.stored_energy(result.scene, e.after)) for e in result.events
    ]
    assert all(after <= (1 + SAME) * before for before, after in energies)


def test_mirrored_scenes_give_mirrored_signals():
    control = np.concatenate([np.linspace(0.85, -0.2, 9), np.linspace(-0.15, 0.4, 12)])
    right = jw.scan(jw.Scene(jw.Whisker(), jw.Circle(0.3, 0.6), friction=0.4), control)
    left = jw.scan(jw.Scene(jw.Whisker(), jw.Circle(0.3, 0.6), motion=jw.Translation(1), friction=0.4), -control)
    assert all_ok(right) and all_ok(left)
    for name, sign in (("fx", -1), ("fy", 1), ("mz", -1), ("contact_slope", -1), ("friction_force", -1), ("slip", -1)):
        here, there = np.asarray(getattr(right, name)), np.asarray(getattr(left, name))
        np.testing.assert_allclose(there, sign * here, atol=SAME * np.max(np.abs(here)), err_msg=name)
    assert {-1, 0, 1} <= set(np.asarray(right.slip).ravel().tolist())


def test_results_do_not_depend_on_the_steps_of_the_drive():
    turns = np.array([0.9, -0.1, 0.3, -1.1])
    legs = [np.linspace(a, b, n) for a, b, n in zip(turns[:-1], turns[1:], (30, 17, 40), strict=True)]
    make = lambda: jw.Scene(jw.Whisker(), jw.Parabola(0.2), friction=0.3)  # noqa: E731
    few, many = jw.scan(make(), turns), jw.scan(make(), np.concatenate(legs))
    assert [e.kind for e in few.events] == [e.kind for e in many.events]
    np.testing.assert_allclose([e.control for e in few.events], [e.control for e in many.events], atol=LIMIT)
    np.testing.assert_allclose(few.fx[1], many.fx[29], atol=1e-8)


def test_a_batch_with_a_hopeless_scene():
    def peak(mu):
        result = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2), friction=mu), np.linspace(0.9, -1.0, 12))
        return jnp.max(result.mz), jnp.max(result.status)

    mus = np.array([0.0, -0.1, 0.3, np.nan])
    peaks, status = jax.vmap(peak)(jnp.asarray(mus))
    assert np.isnan(peaks).tolist() == [False, True, False, True]
    assert status.tolist() == [jw.Status.ok, jw.Status.invalid, jw.Status.ok, jw.Status.invalid]
    alone, _ = peak(0.3)
    np.testing.assert_allclose(peaks[2], alone, rtol=LIMIT)


@pytest.mark.unchecked
@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf, "rough"])
def test_friction_must_be_a_number_that_is_not_negative(value):
    with pytest.raises(ValueError, match="`friction`"):
        jw.Scene(jw.Whisker(), jw.Parabola(0.2), friction=value)


def test_without_friction_there_are_no_fields_of_friction():
    result = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2)), np.linspace(0.9, 0.5, 4))
    assert result.slip is None and result.normal_force is None and result.friction_force is None
    assert result.events.before.slip is None


def test_batches_of_derivatives_are_those_of_single_scans():
    def signal(p):
        return reversing(p, "clamped").mz[:, 0]

    slopes = jax.vmap(jax.jacfwd(signal))(jnp.stack([P, P.at[2].set(0.4)]))
    np.testing.assert_allclose(slopes[0], jax.jacfwd(signal)(P), rtol=LIMIT, atol=LIMIT)
    assert np.max(np.abs(slopes[1] - slopes[0])) > 0.1
