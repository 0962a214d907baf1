"""The measurement model of filters against scans, batches, contacts that end, and states without equilibrium."""

# pyright: reportArgumentType=false

import importlib.util
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._inverse.measurement import ContactUnknowns
from jaxwhisker._rod import space_end

EXACT = 1e-9  # both are solved to 1e-10
SLOPES = 1e-6  # relative; central differences of scans, with a step of 1e-4
CONTROL = np.array([1.0, 0.4, 0.2])
AT = np.array([0.0, 1.1])


def peg(x, y):
    """A straight whisker beside a ball."""
    return jw.SpaceScene(jw.Whisker(), jw.Sphere(0.3, (x, y, 0.1)), rod=jw.ClosedForm())


def sprung(x, y):
    hair = jw.Whisker(intrinsic_curvature=-0.1, lateral_curvature=0.2, torsion_ratio=0.7)
    springs = jw.Support.follicle(x=30.0, z=20.0, phi=5.0)
    return jw.SpaceScene(hair, jw.Sphere(0.3, (x, y, 0.1)), springs)


def scanned(build, at, control=CONTROL):
    result = jw.scan(build(*map(float, at)), control)
    assert result.status[-1] == jw.Status.ok
    return np.concatenate([result.force[-1], result.moment[-1]], axis=-1)


@pytest.fixture(scope="module")
def model():
    return jw.MeasurementModel(peg, ("x", "y"))


@pytest.fixture(scope="module")
def contact(model):
    return model.contact(AT, CONTROL)


@pytest.mark.parametrize("build", [peg, sprung])
def test_signals_and_derivatives_are_those_of_scans(build):
    own = jw.MeasurementModel(build, ("x", "y"))
    # At (0.05, 1.0) the contact is on the shaft, and at AT it is at the tip.
    start, moved = own.contact(AT, CONTROL), np.array([0.05, 1.0])
    found = own(moved, CONTROL[-1], start)
    assert found.status == jw.Status.ok
    assert start.phase[0] == jw.Phase.tip and found.contact.phase[0] == jw.Phase.tangential
    np.testing.assert_allclose(found.signals, scanned(build, moved), atol=EXACT)
    steps = 1e-4 * np.eye(2)
    expected = [(scanned(build, moved + h) - scanned(build, moved - h)) / 2e-4 for h in steps]
    size = np.max(np.abs(expected))
    np.testing.assert_allclose(found.jacobian, np.stack(expected, axis=-1), atol=SLOPES * size)


def test_derivatives_by_the_whisker_and_by_nothing():
    """Rods are differentiated if a parameter changes them; what no parameter changes has no tangents."""

    def hair(curvature, unused):
        del unused
        return jw.SpaceScene(jw.Whisker(intrinsic_curvature=curvature), jw.Sphere(0.3, (0.0, 1.1, 0.1)))

    own, at = jw.MeasurementModel(hair, ("curvature", "unused")), np.array([-0.1, 3.0])
    found = own(at, CONTROL[-1], own.contact(at, CONTROL))
    step = np.array([1e-4, 0.0])
    expected = (scanned(hair, at + step) - scanned(hair, at - step)) / 2e-4
    np.testing.assert_allclose(found.jacobian[..., 0], expected, atol=SLOPES * np.max(np.abs(expected)))
    assert np.all(found.jacobian[..., 1] == 0)
    idle = jw.MeasurementModel(lambda unused: hair(-0.1, unused), ("unused",))
    assert np.all(idle([3.0], CONTROL[-1], own.contact(at, CONTROL)).jacobian == 0)


def test_rods_that_no_parameter_changes_are_integrated_once(monkeypatch):
    contact = ContactUnknowns(np.zeros((1, 11)), np.zeros(1, dtype=int))
    calls, end = [], space_end._end
    monkeypatch.setattr(space_end, "_end", lambda *args: calls.append(args) or end(*args))

    def hair(x, curvature=-0.1):
        return jw.SpaceScene(jw.Whisker(intrinsic_curvature=curvature), jw.Sphere(0.3, (x, 1.1, 0.1)))

    jax.make_jaxpr(jw.MeasurementModel(hair, ("x",))._measured)(np.zeros(1), 0.2, contact)
    assert not calls
    jax.make_jaxpr(jw.MeasurementModel(hair, ("x", "curvature"))._measured)(np.zeros(2), 0.2, contact)
    assert calls


def test_the_drive_may_move(model, contact):
    found = model(AT, 0.25, contact)
    np.testing.assert_allclose(found.signals, scanned(peg, AT, np.array([1.0, 0.25])), atol=EXACT)


def test_a_batch_of_particles_gives_what_each_one_gives(model, contact):
    particles = AT + 0.02 * np.random.default_rng(0).standard_normal((5, 2))
    particles[2] = 9.0, 9.0  # far from the whisker
    batch = jax.jit(jax.vmap(model, in_axes=(0, None, None)))(particles, 0.2, contact)
    assert batch.status.tolist() == [jw.Status.ok if k != 2 else jw.Status.lost for k in range(5)]
    assert np.isnan(batch.signals[2]).all() and np.isnan(batch.jacobian[2]).all()
    np.testing.assert_array_equal(batch.contact.z[2], contact.z)
    for k in (0, 1, 3, 4):
        single = model(particles[k], 0.2, contact)
        np.testing.assert_allclose(batch.signals[k], single.signals, atol=EXACT)
        np.testing.assert_allclose(batch.jacobian[k], single.jacobian, atol=EXACT)


def test_a_whisker_that_leaves_is_free_and_touches_again(model, contact):
    away = AT + np.array([0.0, 0.15])
    for part in (0.25, 0.5, 0.75, 1.0):
        left = model(AT + part * (away - AT), 0.2, contact)
        contact = left.contact
    assert left.status == jw.Status.ok and np.all(scanned(peg, away) == 0)
    assert np.all(left.signals == 0) and np.all(left.jacobian == 0)
    for part in (0.5, 0.0):
        again = model(AT + part * (away - AT), 0.2, contact)
        contact = again.contact
    np.testing.assert_allclose(again.signals, scanned(peg, AT), atol=EXACT)


def test_an_equilibrium_that_is_not_stable_is_no_measurement():
    """A straight whisker in the plane of symmetry falls to one side beyond the middle of a ball."""
    own = jw.MeasurementModel(lambda x: jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (x, 1.3, 0.0))), ("x",))
    before = own.contact([0.0], np.array([1.5, 0.1]))
    assert own([0.0], 0.02, before).status == jw.Status.ok
    beyond = own([0.0], -0.02, before)
    assert beyond.status == jw.Status.unstable and np.isnan(beyond.signals).all()


def test_parameters_outside_their_domain_are_invalid():
    own = jw.MeasurementModel(
        lambda radius: jw.SpaceScene(jw.Whisker(), jw.Sphere(radius, (0.0, 1.1, 0.1))), ("radius",)
    )
    start = own.contact([0.3], CONTROL)
    found = jax.jit(own)(jnp.array([-0.3]), 0.2, start)
    assert found.status == jw.Status.invalid and np.isnan(found.signals).all()


def test_wrong_arguments_raise_errors(model, contact):
    with pytest.raises(ValueError, match="`names` must be names of parameters"):
        jw.MeasurementModel(peg, ())
    with pytest.raises(ValueError, match="`names` must name the parameters of `build`"):
        jw.MeasurementModel(peg, ("x", "height"))
    with pytest.raises(ValueError, match=r"`parameters` must be of shape \(2,\)"):
        model([0.0], 0.2, contact)
    with pytest.raises(ValueError, match="`control` must be drive positions of which the last one is in contact"):
        model.contact(AT, np.array([1.0, 0.9]))
    rough = jw.MeasurementModel(
        lambda x: jw.SpaceScene(jw.Whisker(), jw.Sphere(0.3, (x, 1.1, 0.1)), friction=0.2), ("x",)
    )
    with pytest.raises(ValueError, match="without friction"):
        rough.contact([0.0], CONTROL)
    plane = jw.MeasurementModel(lambda q: jw.Scene(jw.Whisker(), jw.Parabola(q)), ("q",))
    with pytest.raises(ValueError, match="`build` must return a SpaceScene"):
        plane.contact([0.2], CONTROL)


def test_the_example_tracks_a_peg_better_than_a_chain_of_links():
    path = Path(__file__).parents[2] / "examples" / "track_peg.py"
    spec = importlib.util.spec_from_file_location("track_peg", path)
    assert spec is not None and spec.loader is not None
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    errors = example.errors(chains=(5,))
    assert errors["exact"] < 0.01 and errors["exact"] < 0.2 * errors["chain of 5 links"]
