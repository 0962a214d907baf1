"""Friction of whiskers with several contacts: stored scans, scans with one contact, laws, derivatives, energies."""

# pyright: reportArgumentType=false, reportOptionalSubscript=false

import dataclasses
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from random_several import checked, drawn
from scenes import all_ok
from several_cases import CASES, scene_of

SLIPPING = {
    c["name"]: c
    for c in json.loads((Path(__file__).parents[1] / "data" / "several_contacts_slipping.json").read_text())["cases"]
}
EXACT = 1e-8  # of the peak, and of controls: stored scans have nine decimals
SAME = 1e-9  # relative to the peak: accuracy of scans in the plane and of scans with several contacts
SLOPES = 1e-7  # relative: derivatives of such scans
SOLVED = 1e-7  # laws of scans: a hundred times their accuracy
BALANCED = 3e-8  # of the work: sixteen points in each panel, and segments of twelve steps
AGREES = 1e-12  # the same program, and one compiled around it
COEFFICIENTS = 0.1, 0.8
TO_AND_FRO = np.concatenate(
    [np.linspace(a, b, 16, endpoint=False) for a, b in ((0.5, -0.3), (-0.3, -0.15), (-0.15, -0.35), (-0.35, 0.1))]
)


def circle(distance=0.5, radius=0.2, friction=0.3, contacts=2):
    """A clamped whisker before a circle; with another circle out of reach, so that all scenes share programs."""
    near, far = jw.Circle(distance, radius), jw.Circle(3.0, 0.1)
    return jw.Scene(jw.Whisker(), (near, far) if contacts > 1 else near, friction=friction, contacts=contacts)


def with_a_turn(control):
    """A control that goes on for a short way and turns back, for the programs of `TO_AND_FRO`."""
    return np.append(control, [control[-1] - 1e-3, control[-1]])


def reactions(scene, control=TO_AND_FRO):
    result = jw.scan(scene, control)
    return jnp.stack([result.fx[:, 0], result.fy[:, 0], result.mz[:, 0]])


@pytest.mark.parametrize("name", SLIPPING)
def test_contacts_that_slip_are_exact(name):
    case = SLIPPING[name]
    scene = dataclasses.replace(scene_of(CASES[name]), friction=case["mu"])
    result = jw.scan(scene, with_a_turn(case["control"]))
    assert all_ok(result)
    for field in ("fx", "fy", "mz"):
        expected = np.asarray(case[field])
        found = getattr(result, field)[:-2]
        np.testing.assert_allclose(found, expected, rtol=0, atol=EXACT * np.max(np.abs(expected)))
    for k, contacts in enumerate(case["contacts"]):
        rows = [row for row in contacts[::-1] if row[2] > EXACT]
        for place, (_, number, force, arc, x, y) in enumerate(rows):
            own = [getattr(result, f"contact_{name}")[k, 0, place] for name in ("force", "arc", "x", "y")]
            np.testing.assert_allclose(own, (force, arc, x, y), rtol=EXACT, atol=EXACT)
            assert result.contact_object is None or result.contact_object[k, 0, place] == number
            assert abs(result.slip[k, 0, place]) == 1
    end = min(case["control"])  # beyond it, the drive turns back
    expected = [(kind, u) for kind, u in case["events"] if u > end and kind != "loss"]
    found = [(event.kind.name, event.control) for event in result.events if event.control > end]
    assert [kind for kind, _ in found] == [kind for kind, _ in expected]
    np.testing.assert_allclose([u for _, u in found], [u for _, u in expected], rtol=0, atol=EXACT)


@pytest.mark.parametrize(
    ("numbers", "control"),
    [
        ((0.5, 0.2, 0.3), TO_AND_FRO),
        ((0.85, 0.3, 0.3), np.concatenate([np.linspace(0.6, -0.4, 21), np.linspace(-0.35, 0.6, 20)])),
        ((0.5, 0.2, 0.8), with_a_turn(np.linspace(0.5, -1.6, 31))),
        ((0.5, 0.2, 0.0), TO_AND_FRO),
    ],
    ids=["to and fro", "tip", "sweep", "no coefficient"],
)
def test_one_contact_behaves_as_in_a_scene_with_one_contact(numbers, control):
    one, several = (jw.scan(circle(*numbers, contacts=contacts), control) for contacts in (1, 2))
    assert all_ok(one) and all_ok(several)
    for field in ("fx", "fy", "mz"):
        expected = np.asarray(getattr(one, field))
        np.testing.assert_allclose(getattr(several, field), expected, rtol=0, atol=SAME * np.max(np.abs(expected)))
    for field in ("slip", "normal_force", "friction_force"):
        expected = np.asarray(getattr(one, field))
        size = max(1.0, np.max(np.abs(expected)))
        np.testing.assert_allclose(getattr(several, field)[..., 0], expected, rtol=0, atol=10 * SAME * size)
    # With several contacts there is no event at the lowest point.
    expected = [event for event in one.events if event.kind != jw.EventKind.vertex]
    assert [event.kind for event in several.events] == [event.kind for event in expected]
    controls = [event.control for event in expected]
    np.testing.assert_allclose([event.control for event in several.events], controls, rtol=0, atol=EXACT)


def test_contacts_that_stick_have_derivatives():
    # Where contacts stick depends on the turns of the drive, and on earlier slips.
    def of(numbers, contacts):
        distance, radius, friction, turn = numbers
        control = jnp.asarray(TO_AND_FRO).at[16].add(turn)
        return reactions(circle(distance, radius, friction, contacts), control)

    at, way = jnp.array([0.5, 0.2, 0.3, 0.0]), jnp.array([0.3, -0.7, 0.5, 0.8])
    (_, expected), (_, found) = (jax.jvp(lambda numbers, k=k: of(numbers, k), (at,), (way,)) for k in (1, 2))
    assert np.max(np.abs(expected)) > 1
    np.testing.assert_allclose(found, expected, rtol=0, atol=SLOPES * np.max(np.abs(expected)))
    weights = jnp.asarray(np.random.default_rng(0).normal(size=expected.shape))
    back = jax.grad(lambda numbers: jnp.sum(weights * of(numbers, 2)))(at)
    np.testing.assert_allclose(back @ way, jnp.sum(weights * found), rtol=SLOPES)


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        ("roof, straight, clamped", (0, 12, 1)),
        ("box, straight, FB", (1, 8, 3)),
        # A tip on a flank comes to rest under a large force: its lean has a maximum there, which is its limit.
        ("polygon, straight, clamped", (2, 10, 0)),
    ],
    ids=["roof", "box", "polygon"],
)
def test_contacts_obey_the_laws_of_friction_at_corners_and_on_the_way_back(kind, seed):
    one = drawn(kind, np.random.default_rng(seed), friction=COEFFICIENTS)
    result = jw.scan(one.scene, one.control)
    assert all_ok(result), result
    kinds = [event.kind for event in result.events]
    assert jw.EventKind.edge in kinds and jw.EventKind.stick in kinds
    for law, control, _, value in checked(one, result):
        assert value < SOLVED, (law, control)


@pytest.mark.parametrize(
    ("kind", "seed", "most"),
    [
        # Coarse rods swung to and fro where they slip.
        ("three circles, straight, clamped", (0, 2, 1), 0.8),
        # Contacts come to rest, and can move on slowly in no way.
        ("two ellipses, curved, FB", (0, 3, 0), 0.8),
        # A contact that has come to rest leans too much at once.
        ("wave, curved, FB", (1, 6, 8), 0.5),
        # A tip slips off under a large force: coarse rods that are off by some thousandths came to rest beside it. It
        # slips into an inner corner.
        ("roof, straight, clamped", (2, 12, 0), 0.5),
    ],
    ids=["rods that swing", "no slow way", "too much at once", "into an inner corner"],
)
def test_jumps_with_friction_end_where_all_laws_hold(kind, seed, most):
    one = drawn(kind, np.random.default_rng(seed), friction=(0.1, most))
    result = jw.scan(one.scene, one.control)
    assert all_ok(result), result
    for law, control, _, value in checked(one, result):
        assert value < SOLVED, (law, control)


def test_a_corner_that_becomes_a_side_does_not_touch_it_before():
    # The touch of the side is a double root there, and was found on the other side of the corner.
    rng = np.random.default_rng((1, 9, 11))
    one = drawn("two boxes, curved, clamped", rng, friction=(0.1, 0.5), turns=False)
    result = jw.scan(one.scene, one.control)
    assert all_ok(result), result
    for law, control, _, value in checked(one, result):
        assert value < SOLVED, (law, control)


def test_the_force_along_a_straight_part_between_contacts_that_stick_is_not_determined():
    one = drawn("wave, straight, clamped", np.random.default_rng((2, 5, 1)), friction=COEFFICIENTS)
    result = jw.scan(one.scene, one.control)
    status = np.asarray(result.status)
    ends = int(np.argmax(status != jw.Status.ok))
    assert ends > 0 and set(status[ends:].tolist()) == {int(jw.Status.undetermined)}
    assert np.all(np.isnan(np.asarray(result.mz)[ends:]))
    assert np.sum(np.asarray(result.phase)[ends - 1] > 0) == 2


def test_batches_and_compiled_scans_are_those_of_single_scans():
    expected = reactions(circle())
    batch = jax.vmap(lambda radius: reactions(circle(radius=radius)))(jnp.array([0.2, 0.25]))
    np.testing.assert_array_equal(batch[0], expected)
    assert np.all(np.isfinite(batch))
    compiled = jax.jit(lambda radius: reactions(circle(radius=radius)))(0.2)
    np.testing.assert_allclose(compiled, expected, rtol=0, atol=AGREES * np.max(np.abs(expected)))


def test_friction_turns_work_into_heat():
    result = jw.scan(circle(), TO_AND_FRO)
    balance = jw.energy_balance(result)
    most = np.max(np.abs(balance.work))
    assert np.max(np.abs(balance.residual)) < BALANCED * most
    heat = np.asarray(balance.heat)[:, 0]
    assert np.all(np.diff(heat) > -BALANCED * most) and heat[-1] > 0.1 * most


def test_tables_and_datasets_have_friction_of_each_contact():
    result = jw.scan(circle(), TO_AND_FRO)
    data = result.to_xarray()
    for name in ("slip", "normal_force", "friction_force"):
        assert data[name].dims == ("control", "whisker", "contact")
        np.testing.assert_array_equal(data[name], getattr(result, name))
    table = jw.to_dataframe(result)
    assert {"slip_1_1", "slip_1_2", "normal_force_1_1", "friction_force_1_2"} <= set(table.columns)
    np.testing.assert_array_equal(table["slip_1_1"], result.slip[:, 0, 0])
