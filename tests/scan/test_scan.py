"""The scan rejects scenes that are not valid before it compiles anything."""

import equinox as eqx
import jax.numpy as jnp
import pytest

import jaxwhisker as jw
from scenes import model


def test_a_scene_changed_to_an_invalid_one_is_rejected_as_a_whole():
    scene = eqx.tree_at(lambda s: s.support.springs[0].stiffness, model("FB"), jnp.asarray(-1.0))
    with pytest.raises(
        ValueError, match="`scene` must have parameters that its constructors accept, got FB: 1 whisker"
    ):
        jw.scan(scene)
