"""Several contacts of one whisker in space: an exact scan in the plane, and laws of states out of it."""

import jax
import numpy as np
import pytest

import jaxwhisker as jw
import pegs

SOLVED = 1e-7  # errors of rods with eight steps a segment, seen from the other end


def events_of(result):
    events = result.events
    count = int(events.count)
    return [(jw.EventKind(int(k)), float(u)) for k, u in zip(events.kind[:count], events.control[:count], strict=True)]


def test_pegs_along_z_are_circles_in_the_plane():
    result = pegs.scan()
    at = int(np.argmin(np.abs(np.asarray(result.control) - pegs.CONTROL)))
    for name, value in pegs.REACTION.items():
        np.testing.assert_allclose(getattr(result, name)[at, 0], value, atol=pegs.EXACT)
    for name, values in pegs.CONTACTS.items():
        np.testing.assert_allclose(getattr(result, name)[at, 0], values, atol=pegs.EXACT)
    assert result.contact_object[at, 0].tolist() == [1, 2]
    for name in ("fz", "mx", "my", "contact_z"):
        np.testing.assert_allclose(getattr(result, name)[np.asarray(result.status) == 0], 0.0, atol=1e-12)
    found: dict[str, float] = {kind.name: u for kind, u in reversed(events_of(result)) if u < 0.1}
    for name, control in pegs.EVENTS.items():
        assert found[name] == pytest.approx(control, abs=1e-8)


def test_states_out_of_the_plane_satisfy_all_laws():
    result = pegs.scan(pegs.TILTED)
    touching = np.sum(np.asarray(result.phase)[:, 0] != 0, axis=1)
    steps = np.flatnonzero((np.asarray(result.status) == 0) & (touching > 0))
    assert np.sum(touching[steps] == 2) >= 3
    assert jw.EventKind.snap_through in [kind for kind, _ in events_of(result)]
    for step in steps[::2]:
        assert max(pegs.violations(result, step).values()) < SOLVED, (step, pegs.violations(result, step))


@pytest.mark.parametrize("kind", ["sprung", "curved"])
def test_other_whiskers_satisfy_all_laws(kind):
    whiskers = {"curved": jw.Whisker(intrinsic_curvature=-0.3, torsion_ratio=0.7)}
    support = jw.Support.follicle(100.0, 100.0, 20.0) if kind == "sprung" else jw.Support()
    scene = pegs.scene(whisker=whiskers.get(kind), support=support)
    result = jw.scan(scene, np.linspace(0.3, -0.9, 61))
    touching = np.sum(np.asarray(result.phase)[:, 0] != 0, axis=1)
    assert np.sum(touching == 2) >= 2
    for step in np.flatnonzero((np.asarray(result.status) == 0) & (touching > 0))[::2]:
        assert max(pegs.violations(result, step).values()) < SOLVED


def test_a_third_contact_ends_a_scan_that_has_room_for_two():
    places = ((0.0, 0.6), (-0.3, 0.42), (-0.55, 0.25))
    scene = jw.Scene(jw.Whisker(), tuple(jw.Cylinder(0.1, (x, q + 0.1, 0.0)) for x, q in places), contacts=2)
    result = jw.scan(scene, np.array([0.3, -0.6, -0.63, -0.66]))
    assert [jw.Status(int(s)) for s in result.status] == [jw.Status.ok] * 3 + [jw.Status.too_many_contacts]


def test_compiled_scans_and_batches_are_those_of_single_scans():
    control = np.linspace(0.3, -0.7, 11)

    def reactions(tilt):
        result = jw.scan(pegs.scene(((tilt, 0.1, 1.0), (-0.3, 0.0, 1.0))), control)
        return result.fx, result.mz, result.contact_force

    one, compiled = reactions(0.2), jax.jit(reactions)(0.2)
    batch = jax.vmap(reactions)(np.array([0.1, 0.2]))
    for own, jitted, lanes in zip(one, compiled, batch, strict=True):
        np.testing.assert_allclose(jitted, own, atol=1e-10)
        np.testing.assert_allclose(lanes[1], own, atol=1e-10)
