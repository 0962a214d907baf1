"""Invariants of every scan: balance, symmetry, units, limits of the network."""

import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxwhisker as jw
from scenes import all_ok, event_list, model

BALANCE = 1e-9  # of forces and moments, relative to the largest
SAME = 1e-9  # two computations of the same scan
UNITS = 1e-12  # scenes are made dimensionless before anything is computed
STIFF = 1e-9  # a stiffness of 1e12 against infinity: forces stay below 1e3

CONTROL = np.linspace(0.9, -2.2, 240)
few = settings(max_examples=6)
stiffness = st.floats(10.0, 1e4)
networks = st.tuples(stiffness, stiffness, stiffness, st.floats(0.1, 0.8), st.floats(0.3, 3.0), st.floats(0.0, 0.4))


def fbfbr(values):
    c1, c2, c3, q, a, rest = values
    return jw.Scene(jw.Whisker(), jw.Parabola(q, a), jw.Support.fbfbr([c1, c2, c3], rest))


@few
@given(networks)
def test_every_whisker_and_every_base_is_in_balance(values):
    scene = fbfbr(values)
    result = jw.scan(scene, CONTROL)
    assert all_ok(result)
    touching = np.asarray(result.phase) != jw.Phase.free
    assert touching.any()
    f, alpha = np.asarray(result.contact_force), np.asarray(result.contact_slope)
    size = max(1.0, np.max(f))
    np.testing.assert_allclose(result.fx, -f * np.sin(alpha), atol=BALANCE * size)
    np.testing.assert_allclose(result.fy, f * np.cos(alpha), atol=BALANCE * size)
    # Moments about the base: mz balances the contact force.
    arm_x, arm_y = np.asarray(result.contact_x - result.base_x), np.asarray(result.contact_y)
    moment = result.mz + arm_x * (-np.asarray(result.fy)) - arm_y * (-np.asarray(result.fx))
    np.testing.assert_allclose(np.where(touching, moment, 0), 0, atol=BALANCE * size)
    # The springs on each base carry the reaction on its whisker.
    tension = np.stack(
        [(result.spring_length[:, k] - s.rest_length) / s.softness for k, s in enumerate(scene.support.springs)],
        axis=1,
    )
    c1, c2, c3 = tension.T
    np.testing.assert_allclose(-c1 + c2, result.fx[:, 0], atol=BALANCE * size * 10)
    np.testing.assert_allclose(-c2 - c3, result.fx[:, 1], atol=BALANCE * size * 10)
    # The contact point lies on the object, and the contact arc within the whisker.
    _, _, _, q, a, _ = values
    on_object = q + a * np.asarray(result.contact_x) ** 2
    np.testing.assert_allclose(np.where(touching, result.contact_y - on_object, 0), 0, atol=SAME)
    assert np.all(np.asarray(result.contact_arc) <= 1 + SAME)


@few
@given(networks, st.floats(-3.0, 3.0))
def test_a_shift_along_x_shifts_everything(values, shift):
    c1, c2, c3, q, a, rest = values
    moved = jw.Scene(jw.Whisker(), jw.Parabola(q, a, position=shift), jw.Support.fbfbr([c1, c2, c3], rest))
    here, there = jw.scan(fbfbr(values), CONTROL), jw.scan(moved, CONTROL + shift)
    for name in ("fx", "fy", "mz", "contact_arc"):
        np.testing.assert_allclose(getattr(here, name), getattr(there, name), atol=SAME * 1e2)
    np.testing.assert_allclose(np.asarray(here.base_x) + shift, there.base_x, atol=SAME)
    assert [e[:2] for e in event_list(here)] == [e[:2] for e in event_list(there)]


@few
@given(networks)
def test_units_drop_out(values):
    c1, c2, c3, q, a, rest = values
    length, bending = 37.5, 4.2e4  # mm, N mm^2
    unit = bending / length**3
    si = jw.Scene(
        jw.Whisker(length, bending),
        jw.Parabola(q * length, a / length),
        jw.Support.fbfbr([c1 * unit, c2 * unit, c3 * unit], rest * length),
    )
    one, other = jw.scan(fbfbr(values), CONTROL), jw.scan(si, CONTROL * length)
    force, moment = bending / length**2, bending / length
    for name, size in (("fx", force), ("fy", force), ("mz", moment), ("base_x", length), ("contact_arc", length)):
        a_, b_ = np.asarray(getattr(one, name)), np.asarray(getattr(other, name)) / size
        # Rounding of the input is amplified by the condition number, which is large only near a fold.
        assert np.median(np.abs(a_ - b_)) <= UNITS * max(1, np.max(np.abs(a_)))
        np.testing.assert_allclose(a_, b_, atol=1e-8 * max(1, np.max(np.abs(a_))))


def test_the_mirror_image_scanned_from_the_left_is_the_mirrored_scan():
    # A scan from the right to the left and back: the way back is the mirror image of the way out.
    out = np.linspace(1.0, -2.0, 301)
    there = jw.scan(model("clamped"), out)
    back = jw.scan(model("clamped"), np.concatenate([[1.0, -2.0], -out]))
    assert all_ok(there) and all_ok(back)
    mirrored = {"fx": -1, "fy": 1, "mz": -1, "contact_force": 1, "contact_slope": -1, "contact_arc": 1}
    for name, sign in mirrored.items():
        values = np.asarray(getattr(there, name))
        assert np.max(np.abs(values)) > 0.5
        np.testing.assert_allclose(np.asarray(getattr(back, name))[2:], sign * values, atol=SAME * 1e2)


def test_uncoupled_whiskers_are_single_ones():
    springs = (jw.Spring((0, 1), 70.0, 0.2), jw.Spring((0, 2), 40.0, 0.5))
    both = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support(springs)), CONTROL)
    for i, spring in enumerate(springs):
        alone = jw.scan(
            jw.Scene(
                jw.Whisker(), jw.Parabola(0.2), jw.Support((jw.Spring((0, 1), spring.stiffness, spring.rest_length),))
            ),
            CONTROL,
        )
        for name in ("fx", "fy", "mz", "base_x", "contact_arc"):
            np.testing.assert_allclose(getattr(both, name)[:, i], getattr(alone, name)[:, 0], atol=SAME * 1e2)


def test_twins_touch_and_slip_together():
    springs = (jw.Spring((0, 1), 70.0, 0.2), jw.Spring((0, 2), 70.0, 0.2))
    twins = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support(springs)))
    alone = jw.scan(model("FB"))
    assert all_ok(twins)
    np.testing.assert_allclose(
        twins.events.of(jw.EventKind.snap_off)[0].control, event_list(alone)[-1][2], atol=SAME * 10
    )
    assert twins.phase[-1].sum() == 0


def test_very_stiff_is_rigid():
    for name in ("FB", "FBFBR"):
        stiff, rigid = jw.scan(model(name, 1e12), CONTROL), jw.scan(model(name, jnp.inf), CONTROL)
        assert all_ok(rigid)
        for field in ("fx", "fy", "mz", "base_x"):
            np.testing.assert_allclose(getattr(stiff, field), getattr(rigid, field), atol=STIFF)
    clamped = jw.scan(model("clamped"), CONTROL + 0.2)
    rigid = jw.scan(model("FB", jnp.inf), CONTROL)
    np.testing.assert_allclose(clamped.fx, rigid.fx, atol=SAME)


def test_a_rigid_link_moves_two_bases_as_one():
    result = jw.scan(model("FBFB", [70.0, jnp.inf]), CONTROL)
    assert all_ok(result)
    np.testing.assert_allclose(result.spring_length[:, 1], 0.2, atol=1e-12)
    together = np.asarray(result.fx).sum(axis=1)
    np.testing.assert_allclose(-70.0 * (np.asarray(result.spring_length)[:, 0] - 0.2), together, atol=1e-9)


def test_different_whiskers_in_one_scene():
    pair = (jw.Whisker(1.0, 1.0), jw.Whisker(0.8, 2.0))
    springs = (jw.Spring((0, 1), 90.0, 0.2), jw.Spring((0, 2), 60.0, 0.4))
    both = jw.scan(jw.Scene(pair, jw.Parabola(0.2), jw.Support(springs)), CONTROL)
    assert all_ok(both)
    for i, (whisker, s) in enumerate(zip(pair, springs, strict=True)):
        alone = jw.scan(
            jw.Scene(whisker, jw.Parabola(0.2), jw.Support((jw.Spring((0, 1), s.stiffness, s.rest_length),))), CONTROL
        )
        np.testing.assert_allclose(both.mz[:, i], alone.mz[:, 0], atol=SAME * 1e2)
