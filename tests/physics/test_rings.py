"""Rings and concave surfaces in space, and whiskers with two contacts with one object: exact scans, laws."""

from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
import pegs
from several_cases import CASES, Wave

EXACT = 2e-8  # errors of rods with eight steps a segment
SOLVED = 1e-7  # the same, seen from the other end
EVENTS = 1e-8
DIFFERENCES = 1e-5  # central differences
CIRCLES, TUBE = np.array([[0.0, 0.7], [-0.55, 0.37]]), 0.12  # in which the plane of the whisker cuts a ring
CONTROL = np.linspace(0.3, -0.9, 61)


def ring(lean=0.0, tube=TUBE):
    """The ring, leaning out of the plane."""
    across = CIRCLES[1] - CIRCLES[0]
    centre, axis = CIRCLES.mean(axis=0), np.array([-across[1], across[0]]) / np.linalg.norm(across)
    return jw.Torus(np.linalg.norm(across) / 2, tube, (*centre, 0.0), (*axis, lean))


def events_of(result):
    events = result.events
    count = int(events.count)
    return [(jw.EventKind(int(k)), float(u)) for k, u in zip(events.kind[:count], events.control[:count], strict=True)]


def touching(result):
    """Numbers of contacts at the steps, of steps that are not ok -1."""
    count = np.sum(np.asarray(result.phase)[:, 0] != 0, axis=1)
    return np.where(np.asarray(result.status) == 0, count, -1)


@cache
def across() -> Any:
    """The scan of a straight whisker past a ring whose axis lies in its plane."""
    return jw.scan(jw.Scene(jw.Whisker(), ring(), contacts=2), CONTROL)


def test_a_ring_cut_by_the_plane_of_the_whisker_is_two_circles():
    """Numbers of the scan of the circles in the plane; the next test compares all of them."""
    result = across()
    at = int(np.argmin(np.abs(CONTROL + 0.66)))
    for name, expected in (("fx", -7.961603523), ("fy", 10.8170808763), ("mz", 4.6512537829)):
        np.testing.assert_allclose(getattr(result, name)[at, 0], expected, atol=EXACT)
    np.testing.assert_allclose(result.contact_arc[at, 0], [0.9651449023, 0.3417900926], atol=EXACT)
    touch, second, to_tip, release, loss = events_of(result)
    found = (touch, second, to_tip, release)
    np.testing.assert_allclose([u for _, u in found], [0.12, -0.5679534591, -0.7022754883, -0.7054731318], atol=EVENTS)
    # Out of the plane, the whisker is no longer stable at the end of the second circle.
    assert loss[0] == jw.EventKind.bifurcation
    for name in ("fz", "mx", "my", "contact_z"):
        np.testing.assert_allclose(getattr(result, name)[np.asarray(result.status) == 0], 0.0, atol=1e-12)


def test_all_states_at_a_ring_in_the_plane_are_those_at_the_circles():
    result = across()
    circles = tuple(jw.Circle(float(y) - TUBE, TUBE, float(x)) for x, y in CIRCLES)
    plane = jw.scan(jw.Scene(jw.Whisker(), circles, contacts=2), CONTROL)
    ok = np.asarray(result.status) == 0
    assert np.sum(ok) == 57 and np.sum(touching(result) == 2) == 7
    for name in ("fx", "fy", "mz", "contact_force", "contact_arc", "contact_x", "contact_y", "phase"):
        np.testing.assert_allclose(getattr(result, name)[ok], getattr(plane, name)[ok], atol=EXACT)
    for (kind, control), (other, expected) in zip(events_of(result)[:-1], events_of(plane), strict=True):
        assert kind == other and control == pytest.approx(expected, abs=EVENTS)


def test_states_at_a_leaning_ring_satisfy_all_laws():
    result = jw.scan(jw.Scene(jw.Whisker(), ring(0.4), contacts=2), CONTROL)
    assert np.sum(touching(result) == 2) >= 3
    for step in np.flatnonzero(touching(result) > 0)[::3]:
        violations = pegs.violations(result, step)
        assert max(violations.values()) < SOLVED, (step, violations)


def test_with_room_for_one_contact_a_scan_ends_at_the_second_one():
    one, two = jw.scan(jw.Scene(jw.Whisker(), ring()), CONTROL), across()
    first = np.flatnonzero(touching(two) == 2)[0]
    np.testing.assert_array_equal(np.asarray(one.status), np.where(np.arange(61) < first, 0, jw.Status.second_contact))
    np.testing.assert_allclose(one.mz[:first], two.mz[:first], atol=EXACT)


def test_derivatives_by_a_ring_are_those_of_differences():
    """At a step with two contacts, and of the position where the second one begins."""
    control = np.linspace(0.3, -0.66, 3)

    def values(numbers):
        radius, tube, y, lean = numbers
        torus = jw.Torus(radius, tube, (-0.275, y, 0.0), (0.33, -0.55, lean))
        result: Any = jw.scan(jw.Scene(jw.Whisker(), torus, contacts=2), control)
        return jnp.stack([result.mz[2, 0], result.fz[2, 0], *result.contact_force[2, 0], result.events.control[1]])

    numbers, size = jnp.array([0.32, TUBE, 0.535, 0.1]), 1e-5
    _, forwards = jax.jvp(values, (numbers,), (jnp.array([1.0, 0.5, -0.3, 0.2]),))
    way = np.array([1.0, 0.5, -0.3, 0.2])
    differences = (np.asarray(values(numbers + size * way)) - np.asarray(values(numbers - size * way))) / (2 * size)
    np.testing.assert_allclose(forwards, differences, rtol=DIFFERENCES, atol=DIFFERENCES)
    backwards = jax.grad(lambda numbers: jnp.sum(values(numbers)))(numbers)
    np.testing.assert_allclose(jnp.sum(backwards * way), jnp.sum(forwards), rtol=1e-9)


SNAPS = {  # a ring, and what follows from the loss of stability
    "a contact pulls, and a second one pushes": (
        jw.Torus(0.545, 0.118, (0.0, 0.857, 0.209), (0.929, 0.345, -0.137)),
        ["touch", "snap_through", "release"],
    ),
    "a step beyond an unstable equilibrium, to another contact": (
        jw.Torus(0.584, 0.064, (0.0, 0.95, -0.161), (-0.28, 0.113, -0.953)),
        ["touch", "touch", "release", "snap_through", "release"],
    ),
    "the same, and the whisker comes free": (
        jw.Torus(0.293, 0.062, (0.0, 0.836, 0.151), (0.544, -0.626, -0.559)),
        ["touch", "touch", "release", "snap_off"],
    ),
}


@pytest.mark.parametrize("name", SNAPS)
def test_whiskers_that_lose_their_stability_at_a_ring_come_to_rest(name):
    """Contacts slid back, or were held to the ring although another one pushed, and scans ended `unsettled`."""
    body, kinds = SNAPS[name]
    result = jw.scan(jw.Scene(jw.Whisker(), body, contacts=2), np.linspace(0.6, -0.9, 31))
    assert np.all(np.asarray(result.status) == jw.Status.ok)
    found = events_of(result)
    assert [kind.name for kind, _ in found] == kinds
    snap = next(u for kind, u in found if kind.name.startswith("snap"))
    for step in map(int, np.flatnonzero((np.asarray(result.control) < snap) & (touching(result) > 0))):
        violations = pegs.violations(result, step)
        assert max(violations.values()) < SOLVED, (step, violations)


class Hanging(eqx.Module):
    """A wave that is the same for all z, as a level."""

    wave: Wave

    def __call__(self, x):
        return self.wave(x[0]) - x[1]


def wave_of(case):
    numbers = {name: value for name, value in case["objects"][0].items() if name not in ("kind", "position")}
    return jw.Surface(Hanging(Wave(**numbers)), (0.0, 3.0, 0.0), convex=False)


@pytest.mark.parametrize(
    ("name", "surface"),
    [("curved_ellipse", lambda case: jw.Extruded(jw.Ellipse(0.3, 0.8, 0.15))), ("groove", wave_of)],
    ids=["a curved strip on a cylinder", "a groove"],
)
def test_a_strip_before_one_object_has_two_contacts_as_in_the_plane(name, surface):
    """Exact scans of an independent chain of elastica segments; a strip that is stiff across stays in the plane."""
    case = CASES[name]
    curvature = case["whiskers"][0]["intrinsic_curvature"] or None
    whisker = jw.Whisker(intrinsic_curvature=curvature, lateral_ratio=30.0, torsion_ratio=30.0)
    result = jw.scan(jw.Scene(whisker, surface(case), contacts=2), np.array(case["control"]))
    assert np.all(np.asarray(result.status) == 0) and np.sum(touching(result) == 2) >= 1
    for field in ("fx", "fy", "mz"):
        np.testing.assert_allclose(getattr(result, field), case[field], atol=1e-7)
    events = [(kind.name, u) for kind, u in events_of(result)]
    assert [kind for kind, _ in events] == [event["kind"] for event in case["events"]]
    np.testing.assert_allclose([u for _, u in events], [event["control"] for event in case["events"]], atol=EVENTS)
