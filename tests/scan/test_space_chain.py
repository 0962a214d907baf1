"""Scans in space with several contacts: derivatives of signals and events, fields of results."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
import pegs

# Of an exact chain in the plane, by the height of the second peg: two step sizes agree to 1e-8.
CONTROL = -0.7
SLOPES = {"fx": 79.67374057, "fy": -160.37439927, "mz": -31.8823991}
SLOPES_OF_EVENTS = {"touch": -0.95842987, "release": -1.44014324}
EXACT = 3e-7  # relative error


def observed(height):
    """Reactions with two contacts, and controls of the last touch and release."""
    objects = jw.Cylinder(0.2, (0.0, 0.7, 0.0)), jw.Cylinder(0.12, (-0.55, height, 0.0))
    result = jw.scan(jw.Scene(jw.Whisker(), objects, contacts=2), jnp.array([0.3, CONTROL, -0.76]))
    kind = result.events.kind
    places = [
        jnp.argmax(jnp.where(kind == k, jnp.arange(kind.size), -1)) for k in (jw.EventKind.touch, jw.EventKind.release)
    ]
    controls = [result.events.control[place] for place in places]
    return jnp.stack([*(getattr(result, name)[1, 0] for name in SLOPES), *controls])


@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev])
def test_derivatives_are_exact(mode):
    slopes = mode(observed)(0.37)
    np.testing.assert_allclose(slopes, [*SLOPES.values(), *SLOPES_OF_EVENTS.values()], rtol=EXACT)


def test_fields_of_contacts_have_an_axis_from_the_tip_to_the_base():
    result = pegs.scan()
    steps = result.control.size
    for name in ("contact_force", "contact_arc", "contact_x", "contact_y", "contact_z", "phase", "contact_object"):
        assert getattr(result, name).shape == (steps, 1, 2), name
    assert result.fx.shape == (steps, 1)
    arcs = np.asarray(result.contact_arc)[np.all(np.asarray(result.phase) > 0, axis=2)]
    assert arcs.shape[0] >= 3 and np.all(arcs[:, 0] > arcs[:, 1])
    data = result.to_xarray()
    assert data["contact_z"].dims == ("control", "whisker", "contact")
    assert data["fx"].dims == ("control", "whisker")
