"""Contacts before known objects: fits, the choice between hypotheses, and coupled whiskers."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._inverse.inverse_chain import depth_in
from jaxwhisker._inverse.points import PointStatus
from jaxwhisker._model.objects import Objects

CHANNELS = ("fx", "fy", "mz")
OWN = 1e-9  # places from signals of the scan itself
DIFFERENCE = 1e-6
SLOPE = 1e-5
OBJECTS = jw.Circle(0.5, 0.2), jw.Circle(0.25, 0.12, position=-0.55)


def test_depth_in_a_circle():
    circle = Objects((jw.Circle(0.5, 0.2),)).in_unit(1.0).objects[0]
    x, y = jnp.array([0.0, 0.3]), jnp.array([0.55, 0.7])
    assert depth_in(circle, 0.0, 0.0, 1.5, x, y) == pytest.approx(0.05, abs=1e-12)


@pytest.fixture(scope="module")
def coupled():
    """Two whiskers that a spring couples, in contact with two objects one after the other."""
    control = np.linspace(0.3, -1.2, 31)
    scene = jw.Scene(jw.Whisker(), OBJECTS, jw.Support.fbfbr(70.0), contacts=2)
    return jw.scan(scene, control)


def test_contacts_of_coupled_whiskers(coupled):
    points = jw.reconstruct(coupled, coupled.scene, objects=OBJECTS)
    touching = np.any(np.asarray(coupled.phase) > 0, axis=-1)
    ok = np.asarray(points.status) == PointStatus.ok
    assert np.mean(ok[touching]) > 0.9
    used = ok[..., None] & (np.asarray(coupled.phase) > 0)
    off = np.abs(np.asarray(points.x) - np.asarray(coupled.contact_x))
    assert np.max(off[used]) < OWN
    off = np.abs(np.asarray(points.base_x) - np.asarray(coupled.base_x))
    assert np.max(off) < OWN


def test_noise_of_one_whisker_moves_contacts_of_the_other(coupled):
    """Errors are those of differences: the reaction of the second whisker moves the base of the first one."""
    k = int(np.flatnonzero(np.all(np.any(np.asarray(coupled.phase) > 0, axis=-1), axis=1))[3])
    arrays = {"control": np.asarray(coupled.control)[k : k + 1]}
    arrays |= {c: np.asarray(getattr(coupled, c))[k : k + 1] for c in CHANNELS}
    size, small = 1e-3, 1e-6
    noise = {"fx": np.array([[small, size]]), "fy": np.full((1, 2), small), "mz": np.full((1, 2), small)}

    def at(fx):
        return jw.reconstruct(arrays | {"fx": fx}, coupled.scene, sigma=noise, objects=OBJECTS)

    step = DIFFERENCE * np.array([[0.0, 1.0]])
    high, low = at(arrays["fx"] + step), at(arrays["fx"] - step)
    slope = np.asarray(high.x - low.x)[0, 0] / (2 * DIFFERENCE)
    found = np.asarray(at(arrays["fx"]).standard_error)[0, 0, :, 0]
    used = np.isfinite(slope)
    assert used.any() and np.all(np.abs(slope[used]) > 0)
    np.testing.assert_allclose(found[used], np.abs(slope[used]) * size, rtol=1e-3)
