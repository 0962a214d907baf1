"""Derivatives of the controls of events, in both modes, against exact ones."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from several_cases import CASES, changed, number_at, scene_of

DERIVATIVE = 1e-6  # two step sizes of the stored ones agree to 1e-8
MODES = 1e-9  # forward against reverse mode, relative to the sum of sizes
FOUND = 1e-6  # distance of an event from the stored control


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if case["derivatives"]])
def test_derivatives_of_events(name):
    case = CASES[name]
    rows = [row for row in case["derivatives"] if "event" in row]
    paths = list({str(row["parameter"]): row["parameter"] for row in rows}.values())
    control = jnp.array([case["start"], case["control"][-1]])

    def controls(values):
        return jw.scan(scene_of(changed(case, paths, values)), control).events.control[: len(case["events"])]

    p = jnp.array([number_at(case, path) for path in paths])
    value, along = jax.linearize(controls, p)
    each = np.stack([np.asarray(along(unit)) for unit in jnp.eye(p.size)])
    for row in rows:
        k, at = paths.index(row["parameter"]), int(np.argmin(np.abs(np.asarray(value) - row["control"])))
        assert abs(float(value[at]) - row["control"]) < FOUND
        assert abs(each[k, at] - row["d_control"]) < DERIVATIVE * max(1.0, abs(row["d_control"])), row
    weights = jnp.asarray(np.random.default_rng(5).normal(size=value.shape))
    (pulled,) = jax.linear_transpose(along, p)(weights)
    pushed, sizes = each @ np.asarray(weights), np.abs(each) @ np.abs(np.asarray(weights))
    assert np.all(np.abs(pulled - pushed) < MODES * np.maximum(sizes, 1.0))
