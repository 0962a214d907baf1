"""Constructors with names are written where they make the same part."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._file.named import named_call, same
from jaxwhisker._model.along import LinearTaper, RoundSection
from scene_cases import planar

CONE = {"length": 0.05, "youngs_modulus": 3e9, "base_diameter": 2e-4, "tip_diameter": 1e-5}
PARTS = {
    "conical": (jw.Whisker.conical(**CONE, density=1300.0, intrinsic_curvature=2.0), CONE | {"density": 1300.0}),
    "from_material": (
        jw.Whisker.from_material(0.05, 3e9, jw.Polynomial([2e-4, -1e-4], 0.05)),
        {"length": 0.05, "youngs_modulus": 3e9},
    ),
    "fb": (jw.Support.fb(70.0, 0.2), {"stiffness": 70.0, "rest_length": 0.2}),
    "fbfb": (jw.Support.fbfb((60.0, jnp.inf), 0.2), {"stiffness": (60.0, jnp.inf), "rest_length": 0.2}),
    "fbfbr": (jw.Support.fbfbr(70.0, 0.1), {"stiffness": 70.0, "rest_length": 0.1}),
    "fbfbfbr": (
        jw.Support.fbfbfbr((1.0, 2.0, 3.0, 4.0, 5.0), (0.1, 0.2, 0.3, 0.4, 0.5)),
        {"stiffness": (1.0, 2.0, 3.0, 4.0, 5.0), "rest_length": (0.1, 0.2, 0.3, 0.4, 0.5)},
    ),
    "follicle": (
        jw.Support.follicle(9.0, phi=2.0, mount=jw.Mount(0.1)),
        {"x": 9.0, "phi": 2.0, "mount": jw.Mount(0.1)},
    ),
}


@pytest.mark.parametrize("name", PARTS)
def test_parts_have_the_name_of_their_constructor(name):
    part, arguments = PARTS[name]
    found = named_call(part)
    assert found is not None
    kind, given = found
    assert kind.name == name and {key: given[key] for key in arguments} == arguments
    assert same(kind.make(**given), part)


@pytest.mark.parametrize(
    "part",
    [
        jw.Whisker(),
        jw.Whisker(1.0, lambda s: 2.0 - s),
        jw.Whisker(0.05, jw.Whisker.conical(**CONE).bending_stiffness, tip_mass=1e-6),
        jw.Whisker.conical(**CONE, poisson_ratio=0.2),
        jw.Whisker(1.0, RoundSection(1.0, LinearTaper(0.5, 0.1, 1.0))),
        jw.Support(),
        jw.Support.simony(),
        jw.Support((jw.Spring((0, 1), compliance=0.1),)),
        pytest.param(jw.Support((jw.Spring((0, 1), 5.0),), jw.Mount(0.1)), marks=pytest.mark.unchecked),
        jw.Support((jw.Spring((0, 1), lambda e: 5.0 * e, at=0.1),)),
        jw.Support((jw.Spring((0, 1), 5.0, 0.1, axis="y"),)),
        jw.Circle(0.3, 0.5),
    ],
)
def test_other_parts_have_none(part):
    assert named_call(part) is None


def test_other_scenes_are_not_the_same():
    assert not same(planar(jw.Circle(0.3, 0.5)), planar(jw.Circle(0.3, np.nextafter(0.5, 1.0))))
    assert not same(planar(jw.Circle(0.3, 0.5)), planar(jw.Circle(0.3, 0.5), motion=jw.Translation(1)))
    assert not same(planar(jw.Circle(0.3, 0.5, 0.0)), planar(jw.Circle(0.3, 0.5, -0.0)))
    assert same(jax.tree.map(jnp.asarray, planar(jw.Circle(0.3, 0.5))).profile.radius, 0.5)
