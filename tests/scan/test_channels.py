"""Channels from a user's function: names, columns, examples of results and results made from states."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from handmade import handmade_scan
from jaxwhisker._scan.channels import EXAMPLE_STEPS, arguments_of, columns_of, example_of, result_of, traced_channels
from jaxwhisker._scan.state import State, state_of


def test_arguments_are_those_after_the_result():
    assert arguments_of(None) == () and arguments_of(lambda result: {}) == ()
    assert arguments_of(lambda result, gain, offset=0.0: {}) == ("gain", "offset")
    assert arguments_of(functools.partial(lambda result, gain, mix: {}, mix=0.3)) == ("gain", "mix")
    for wrong in (3.0, lambda: {}, "hall"):
        with pytest.raises(ValueError, match="`channels` must be a function of the result of a scan"):
            arguments_of(wrong)


def test_several_whiskers_are_numbered_channels():
    values = np.arange(6.0).reshape(3, 2)
    columns = columns_of({"a": values, "b": values[:, 0], "c": values[:, :1], "d": [1, 2, 3]}, 3)
    assert list(columns) == ["a_1", "a_2", "b", "c", "d"]
    np.testing.assert_array_equal(np.stack(list(columns.values())), [*values.T, values[:, 0], values[:, 0], [1, 2, 3]])
    for wrong, message in [
        ({}, "mapping from names"),
        (values, "mapping from names"),
        ({"a": values.T}, r"got \(2, 3\) for a of 3 steps"),
        ({"a": values[..., None]}, r"got \(3, 2, 1\) for a"),
        ({"a": 1.0}, r"got \(\) for a"),
    ]:
        with pytest.raises(ValueError, match=f"`channels` must return .*{message}"):
            columns_of(wrong, 3)


def test_a_function_is_traced_with_values_by_name():
    scene = handmade_scan().scene

    def signals(values):
        result = example_of(scene)
        return {"force": result.fx + values["gain"], "way": values["gain"] * result.control}

    found = traced_channels(lambda result, gain: {}, signals, {"gain": 3})
    assert found.names == ("force", "way")
    columns = found.code.lower().compile()({"gain": jnp.asarray(2.0)})
    np.testing.assert_array_equal(columns["force"], [2.0] * EXAMPLE_STEPS)
    np.testing.assert_array_equal(columns["way"], [0.0] * EXAMPLE_STEPS)


FRICTION, OBJECTS = {"slip", "normal_force", "friction_force"}, {"contact_object"}


@pytest.mark.parametrize(
    ("profile", "whiskers", "options", "absent"),
    [
        (jw.Parabola(0.2), 1, {}, FRICTION | OBJECTS),
        (jw.Parabola(0.2), 2, {"friction": 0.3}, OBJECTS),
        ((jw.Parabola(0.2), jw.Circle(0.3, 0.2, -3.0)), 2, {}, FRICTION),
    ],
    ids=["one whisker", "friction", "objects"],
)
def test_an_example_has_the_fields_of_a_scan_of_its_scene(profile, whiskers, options, absent):
    scene = jw.Scene(jw.Whisker(), profile, jw.Support.fbfb(70.0) if whiskers == 2 else jw.Support.fb(70.0), **options)
    example = example_of(scene)
    fields = {name: value for name in State.__dataclass_fields__ if (value := getattr(example, name)) is not None}
    assert set(State.__dataclass_fields__) - set(fields) == absent | {"shaft_loads"}
    assert {value.shape for value in fields.values()} == {(EXAMPLE_STEPS, whiskers)}
    whole = {name for name, value in fields.items() if jnp.issubdtype(value.dtype, jnp.integer)}
    assert whole == {"phase", "slip", "contact_object"} - absent


def test_a_result_from_states_has_spring_lengths_and_failures_but_no_events():
    scanned = handmade_scan()
    base_x = jnp.array([[0.3], [np.nan]])
    state = state_of(scanned)
    state = State(**vars(state) | {"base_x": base_x})
    result = result_of(scanned.scene, state, None, jnp.asarray(scanned.control))
    np.testing.assert_allclose(result.spring_length, base_x - scanned.control[:, None], atol=1e-15)
    assert result.status.tolist() == [jw.Status.ok, jw.Status.lost]
    np.testing.assert_array_equal(result.fx, scanned.fx)
    with pytest.raises(ValueError, match="must not depend on events"):
        _ = result.events
    assert jax.tree.leaves(result) and isinstance(result, jw.Result)
