"""Touches of an array's whiskers, against scans of single whiskers and made Datasets."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false

import jax
import numpy as np
import pytest
import xarray as xr

import jaxwhisker as jw
from jaxwhisker._scan.array_results import touch_table

SAME = 1e-12  # relative to the largest: the same operations, in another order
CONTROL = np.linspace(-0.6, 1.0, 33)
BALL = jw.Sphere(0.3, (-0.5, 0.8, 0.05))
ARRAY = jw.Array({
    "name": ["front", "middle", "back"],
    "x": [0.0, 0.3, 3.0],
    "length": [0.8, 1.0, 1.2],
    "protraction": [0.0, -0.1, -0.2],
})  # fmt: skip


@pytest.fixture(scope="module")
def data():
    return ARRAY.scan(BALL, CONTROL)


def test_touches_are_those_of_single_whiskers(data):
    table = ARRAY.touches(data)
    assert list(table.index) == ["front", "middle", "back"] and table.index.name == "whisker"
    assert list(table) == ["first_touch", "release", "peak_force", "peak_control", "status"]
    for name in ("front", "middle"):
        alone, row = jw.scan(ARRAY.scene(name, BALL), CONTROL), table.loc[name]
        (touch,) = alone.events.of(jw.EventKind.touch)
        assert row.first_touch == pytest.approx(touch.control, abs=SAME)
        force = np.asarray(alone.contact_force)[:, 0]
        assert row.peak_force == pytest.approx(force.max()) and row.peak_control == CONTROL[np.argmax(force)]
        ends = alone.events.of(jw.EventKind.release)
        assert np.isnan(row.release) if not ends else row.release == pytest.approx(ends[-1].control, abs=SAME)
    assert np.isfinite(table.release["front"]) and np.isnan(table.release["middle"])
    assert np.isnan(table.loc["back", ["first_touch", "release", "peak_control"]].astype(float)).all()
    assert table.peak_force["back"] == 0.0
    assert list(table.status) == ["ok"] * 3
    units = {"first_touch": "rad", "release": "rad", "peak_force": "N", "peak_control": "rad"}
    assert table.attrs["units"] == units


def test_touches_of_a_batch_of_results_are_those_of_the_scan(data):
    results = jax.vmap(lambda scene: jw.scan(scene, CONTROL))(ARRAY.scenes(BALL))
    assert ARRAY.touches(ARRAY.dataset(results)).equals(ARRAY.touches(data))


def made(phase, events=(), status=None, force=None):
    """A Dataset of one whisker: contact phases, and events as (control, phase before, phase after, force before)."""
    steps = len(phase)
    at, before, after, pushed = (np.array([event[k] for event in events], dtype=float) for k in range(4))
    rows = {
        "status": np.zeros(steps, int) if status is None else status,
        "contact_force": 1.0 * np.array(phase) if force is None else force,
        "event_control": at,
        "before_contact_force": pushed,
    }
    whole = rows | {"phase": np.array(phase), "before_phase": before.astype(int), "after_phase": after.astype(int)}
    dims = {name: "event" if name[:5] in ("event", "befor", "after") else "control" for name in whole}
    variables = {name: (("whisker", dims[name]), np.asarray(values)[None]) for name, values in whole.items()}
    found = xr.Dataset(variables, {"control": np.arange(float(steps)), "whisker": ["one"]})
    found.control.attrs["units"], found.contact_force.attrs["units"] = "m", "N"
    return found


NAN, LOST = np.nan, int(jw.Status.lost)
CASES = {
    "none": (made([0, 0, 0]), (NAN, NAN, 0.0, NAN, "ok")),
    "from the start": (made([1, 1, 0], [(1.5, 1, 0, 0.0)]), (0.0, 1.5, 1.0, 0.0, "ok")),
    "to the end": (made([0, 1, 2], [(0.5, 0, 1, 0.0), (1.5, 1, 2, 1.2)]), (0.5, NAN, 2.0, 2.0, "ok")),
    "twice": (
        made([0, 1, 0, 1, 0], [(0.5, 0, 1, 0.0), (1.5, 1, 0, 0.0), (2.5, 0, 1, 0.0), (3.5, 1, 0, 0.0)]),
        (0.5, 3.5, 1.0, 1.0, "ok"),
    ),
    "twice, to the end": (
        made([0, 1, 0, 1], [(0.5, 0, 1, 0.0), (1.5, 1, 0, 0.0), (2.5, 0, 1, 0.0)]),
        (0.5, NAN, 1.0, 1.0, "ok"),
    ),
    "a snap with the largest force": (
        made([0, 1, 0], [(0.5, 0, 1, 0.0), (1.25, 1, 0, 3.0)]),
        (0.5, 1.25, 3.0, 1.25, "ok"),
    ),
    "between two steps": (made([0, 0], [(0.25, 0, 1, 0.0), (0.5, 1, 0, 0.1)]), (0.25, 0.5, 0.1, 0.5, "ok")),
    "lost in contact": (
        made([0, 1, 0], [(0.5, 0, 1, 0.0)], [0, 0, LOST], [0.0, 2.0, NAN]),
        (0.5, NAN, 2.0, 1.0, "lost"),
    ),
    "lost at once": (made([0, 0], status=[LOST, LOST], force=[NAN, NAN]), (NAN, NAN, 0.0, NAN, "lost")),
}


@pytest.mark.parametrize("case", CASES)
def test_touches_of(case):
    one, expected = CASES[case]
    (row,) = touch_table(["one"], one).itertuples(index=False)
    np.testing.assert_array_equal(row[:4], expected[:4])
    assert row.status == expected[4]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda data: data.fx, "`data` must be a Dataset of `Array.scan`, got one without status"),
        (lambda data: data.drop_vars("phase"), "one without phase"),
        (lambda data: data.assign(status=data.status[0]), "one without a status per whisker"),
        (lambda data: data.isel(whisker=[1, 0, 2]), "whiskers front, middle, back, got middle, front, back"),
    ],
    ids=["no Dataset", "a variable is missing", "of one scene", "other whiskers"],
)
def test_other_data_are_refused(change, words, data):
    with pytest.raises(ValueError, match=words):
        ARRAY.touches(change(data))
