"""Places at which whiskers are close to objects: the least gaps, beside contacts, as far as there is room."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base import checks
from jaxwhisker._dynamics.motion_state import Touching, angles_of
from jaxwhisker._dynamics.moving import Damping, system_of
from jaxwhisker._dynamics.places import NEAR, Touched, from_the_tip, places_of

RADIUS, X = 0.05, 0.1
HEIGHTS, GAPS = (0.3, 0.6, 0.9), (0.02, 0.005, 0.01)  # circles to the left of an upright whisker
EXACT = 1e-9
CIRCLES = tuple(
    jw.Circle(height - RADIUS, RADIUS, position=X - RADIUS - gap) for height, gap in zip(HEIGHTS, GAPS, strict=True)
)


@pytest.fixture(scope="module")
def found():
    """Places of an upright whisker with these contacts."""
    none, scene = jnp.zeros(()), jw.Scene(jw.Whisker(mass_per_length=1.0), CIRCLES, contacts=2)
    damping = Damping(none, none, (none, none, none))

    @jax.jit
    def places(scene, x, arc, piece, touches):
        system = system_of(scene, damping, 4)
        base = jnp.stack([x, 0.0 * x, 0.0 * x])
        angle = angles_of(system, jnp.zeros((1, 4)), base[None])[0]
        assert system.profile is not None
        contacts = Touched(arc, jnp.zeros(2), piece, touches, touches & False)
        return places_of(system, system.rods.length[0], base, angle, contacts)

    def call(x=X, arc=(0.0, 0.0), piece=(0, 0), touches=(False, False)):
        own = jnp.array(arc), jnp.array(piece), jnp.array(touches)
        return places(jax.tree.map(checks.as_float, scene), jnp.asarray(x), *own)

    return call


def test_places_are_where_gaps_are_least(found):
    places = found()
    np.testing.assert_allclose(places.arc, [0.6, 0.9], atol=EXACT)
    assert places.piece.tolist() == [1, 2] and not places.away.any()
    np.testing.assert_allclose([places.distance, places.without], [0.005, 0.02], atol=EXACT)


def test_contacts_keep_their_places(found):
    places = found(arc=(0.1, 0.6), piece=(0, 1), touches=(False, True))
    np.testing.assert_allclose(places.arc, [0.9, 0.6], atol=EXACT)
    np.testing.assert_allclose(places.without, 0.02, atol=EXACT)
    full = found(arc=(0.9, 0.6), piece=(2, 1), touches=(True, True))
    np.testing.assert_allclose(full.without, 0.02, atol=EXACT)


def test_far_from_objects_there_are_no_places(found):
    places = found(X + NEAR)
    assert places.away.all()
    np.testing.assert_allclose(places.distance, 0.005 + NEAR, atol=EXACT)
    inside = found(X - 0.011)
    assert not inside.away.any() and inside.distance < 0
    np.testing.assert_allclose(inside.arc, [0.6, 0.9], atol=EXACT)


def test_fields_are_ordered_from_the_tip():
    touches = jnp.array([[[False, True, True]], [[True, False, False]]])
    arc = jnp.array([[[0.9, 0.2, 0.7]], [[0.3, 0.9, 0.8]]])
    none = jnp.zeros(())
    touching = Touching(arc, arc, none, none, none, touches, none, none, none)  # pyright: ignore[reportArgumentType]
    ordered = from_the_tip(touching, {"arc": arc, "phase": jnp.array([[[1, 2, 3]], [[4, 5, 6]]])})
    assert ordered["arc"].tolist() == [[[0.7, 0.2, 0.0]], [[0.3, 0.0, 0.0]]]
    assert ordered["phase"].tolist() == [[[3, 2, 0]], [[4, 0, 0]]]
