"""States: what is left of a result, poses of bases, the material of a whisker."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from handmade import SI, handmade_scan
from jaxwhisker._rod.rod import Section
from jaxwhisker._scan.channels import example_of
from jaxwhisker._scan.state import OPTIONAL, SpaceState, State, base_of, material, state_of
from scenes import cone


def test_the_state_of_a_result_has_nothing_else():
    result = handmade_scan(*SI, failed=1)
    state = state_of(result)
    assert type(state) is State
    for name in State.__dataclass_fields__:
        if name in OPTIONAL:
            assert getattr(state, name) is None
        else:
            np.testing.assert_array_equal(getattr(state, name), getattr(result, name))


def test_the_state_of_a_result_in_space_has_nothing_else():
    scene = jw.Scene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.2)))
    result: Any = example_of(scene)
    state = state_of(result)
    assert type(state) is SpaceState
    for name in SpaceState.__dataclass_fields__:
        assert np.shape(getattr(state, name)) == np.shape(getattr(result, name))


def test_poses_of_bases():
    numbers = iter(np.arange(12.0).reshape(12, 1))
    names = [name for name in State.__dataclass_fields__ if name not in (*OPTIONAL, "phase")]
    fields: dict[str, Any] = {name: jnp.asarray(next(numbers)) for name in names} | {"phase": jnp.zeros(1, int)}
    assert names[:3] == ["base_x", "base_y", "base_angle"]
    np.testing.assert_array_equal(np.array(base_of(State(**fields))), [[0.0], [1.0], [2.0]])


def test_the_material_is_in_the_units_of_the_whisker():
    assert material(jw.Whisker(*SI)) == SI[1]
    whisker = cone(0.5, length=SI[0], stiffness=SI[1], curvature=(3.0, 7.0))
    section = material(whisker)
    assert isinstance(section, Section)
    share = np.array([0.0, 0.3, 1.0])
    both = jax.jit(jax.vmap(lambda s: (section.stiffness(s), section.curvature(s))))(share * SI[0])
    np.testing.assert_allclose(both, [SI[1] * (1 - share / 2) ** 4, 3.0 + 4.0 * share], rtol=1e-12)
