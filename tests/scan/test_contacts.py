"""Whiskers with several contacts: their centre lines, and functions that know one contact only."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._scan.channels import example_of
from jaxwhisker._scan.contacts import has_several, of_whisker, past_contacts
from several import BOTH, CONTROL, circles, scanned, with_one_contact

EXACT = 1e-9  # of lengths and moments: the integration outwards and the scan's own integration


def test_a_centre_line_passes_all_contacts():
    result = scanned()
    state = jax.tree.map(lambda leaf: leaf[BOTH[1]], jw.State(**_fields(result)))
    at = of_whisker(state, 0)
    s = jnp.sort(jnp.concatenate([at.contact_arc, jnp.linspace(0.0, 1.0, 40)]))
    (x, y, cos, sin), moment = past_contacts(result.scene.whiskers[0], at, s)
    for contact in range(2):
        k = int(jnp.argmin(jnp.abs(s - at.contact_arc[contact])))
        np.testing.assert_allclose([x[k], y[k]], [at.contact_x[contact], at.contact_y[contact]], atol=EXACT)
        np.testing.assert_allclose(jnp.arctan2(sin[k], cos[k]), at.contact_slope[contact], atol=EXACT)
    np.testing.assert_allclose(moment[0], -at.mz, atol=EXACT)
    beyond = s >= at.contact_arc[0]
    np.testing.assert_allclose(moment[beyond], 0.0, atol=EXACT)


def _fields(result):
    return {name: getattr(result, name) for name in jw.State.__dataclass_fields__}


def test_lines_end_with_the_outermost_contact_and_the_tip():
    result = scanned()
    lines = jw.shapes(result, points=40)
    assert lines.x.shape == (CONTROL.size, 1, 40)
    touching = np.asarray(result.phase)[:, 0, 0] != jw.Phase.free
    np.testing.assert_allclose(lines.x[touching, 0, -2], result.contact_x[touching, 0, 0], atol=EXACT)
    np.testing.assert_allclose(lines.y[touching, 0, -2], result.contact_y[touching, 0, 0], atol=EXACT)
    np.testing.assert_allclose(lines.y[~touching, 0, -1], 1.0, atol=EXACT)


def test_a_single_contact_bends_the_whisker_as_if_it_could_have_no_other():
    result, points = scanned(), 32
    one = np.asarray(result.phase)[:, 0, 1] == jw.Phase.free
    lines, others = jw.shapes(result, points=points), jw.shapes(with_one_contact(result), points=points)
    np.testing.assert_allclose(lines.x[one], others.x[one], atol=EXACT)
    assert np.max(np.abs(lines.x[BOTH] - others.x[BOTH])) > 0.01  # without the second contact


def test_several_contacts_show_in_the_shape_of_fields():
    result: Any = scanned()
    assert has_several(result) and not has_several(with_one_contact(result))
    example = example_of(result.scene)
    assert example.contact_object is not None  # pyright: ignore
    assert [np.shape(getattr(example, name))[1:] for name in ("fx", "phase", "contact_x", "contact_object")] == [
        (1,),
        (1, 2),
        (1, 2),
        (1, 2),
    ]


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("result", lambda result: jw.lateral_stability(result)),
        ("result", lambda result: jw.lateral_loss(result)),
        ("at", lambda result: jw.modes(result, 2)),
        ("start", lambda result: jw.simulate(heavy(), lambda t: 0.3 - 0.1 * t, duration=1.0, start=result)),
        ("measured", lambda result: jw.reconstruct(result, jw.Sensor.of(result.scene))),
        ("measured", lambda result: jw.reconstruct(result.to_xarray(), jw.Sensor.of(result.scene))),
        ("sensor", lambda result: jw.fit_contour(jw.to_dataframe(result), result.scene)),
        ("measured", lambda result: jw.fit_contour(result, jw.Sensor.of(result.scene))),
    ],
)
def test_what_knows_one_contact_only_says_so(name, call):
    with pytest.raises(ValueError, match=f"`{name}` must be one whose whiskers .* one contact each, .* contacts=2"):
        call(scanned())


def heavy():
    return jw.Scene(jw.Whisker(mass_per_length=1.0), circles(contacts=1).profile)


def test_a_sensor_scans_with_several_contacts():
    sensor = jw.Sensor.of(circles())
    assert sensor.before(circles().profile).contacts == 1
    assert sensor.before(circles().profile, contacts=2).contacts == 2
