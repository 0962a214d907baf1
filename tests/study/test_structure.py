"""The structure of a study's scenes: what may differ between points, and the hash of the scenes."""

# pyright: reportArgumentType=false

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._study.parameters import parameters_of
from jaxwhisker._study.structure import fingerprint, layout_of_scenes, sampled

BALL = jw.Sphere(0.5, (0.0, 0.9, 0.1))
POINTS = {"stiffness": np.array([0.0, 40.0, 70.0, -1.0])}


def parameters(build):
    return parameters_of(build, POINTS, {}, ())


def build(stiffness):
    return jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(stiffness))


def of_softness(stiffness):
    return build(1 / (1 / stiffness))  # ZeroDivisionError at the first point


def hashed(build):
    return fingerprint(build, sampled(parameters(build)))


def test_points_that_raise_any_error_are_left_out():
    layout = layout_of_scenes(of_softness, parameters(of_softness))
    assert (layout.whiskers, layout.springs, layout.control_kind, layout.onwards) == (1, ("0-1",), "length", -1)
    assert layout.dimensionless


def test_a_scene_with_a_varying_length_is_not_dimensionless():
    def long(stiffness):
        return jw.Scene(jw.Whisker(stiffness), jw.Parabola(0.2))

    assert not layout_of_scenes(long, parameters(long)).dimensionless


def test_a_rotation_has_an_angle_as_its_control():
    def turned(stiffness):
        return jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(stiffness), motion=jw.Rotation(direction=-1))

    layout = layout_of_scenes(turned, parameters(turned))
    assert (layout.control_kind, layout.onwards) == ("angle", -1)


def test_the_hash_is_that_of_the_scenes_and_not_of_the_code():
    constant = 0.2

    def same(stiffness):
        return jw.Scene(jw.Whisker(), jw.Parabola(constant), jw.Support.fb(2 * stiffness / 2))

    assert hashed(build) == hashed(same)


def test_other_scenes_have_another_hash():
    whisker, profile, support = jw.Whisker(), jw.Parabola(0.2), jw.Support.fb
    others = [
        lambda stiffness: build(1.01 * stiffness),
        lambda stiffness: build(jnp.where(stiffness > 50, 60.0, stiffness)),
        lambda stiffness: jw.Scene(whisker, jw.Parabola(0.3), support(stiffness)),
        lambda stiffness: jw.Scene(whisker, profile, support(stiffness), rod=jw.ClosedForm()),
        lambda stiffness: jw.Scene(whisker, profile, support(stiffness), motion=jw.Translation(+1)),
        lambda stiffness: jw.Scene(whisker, profile, jw.Support((jw.Spring((0, 1), stiffness),))),
    ]
    hashes = [hashed(build), *map(hashed, others)]
    assert len(set(hashes)) == len(hashes)


def test_functions_along_the_whisker_are_hashed_by_their_values():
    def tapered(slope):
        def scene(stiffness):
            return jw.Scene(jw.Whisker(1.0, lambda s: 1 - slope * s), jw.Parabola(0.2), jw.Support.fb(stiffness))

        return fingerprint(scene, [{"stiffness": 70.0}])

    assert tapered(0.5) == tapered(0.5) != tapered(0.6)


SOLID = jw.Parabola(0.2)
CONSTRUCTORS = {
    "conical": (
        lambda **given: jw.Whisker.conical(**given),
        {
            "length": 0.06,
            "youngs_modulus": 4e10,
            "base_diameter": 4e-4,
            "tip_diameter": 2e-4,
            "intrinsic_curvature": 2.0,
        }
        | {"density": 7e3, "poisson_ratio": 0.3},
    ),
    "from_material": (
        lambda **given: jw.Whisker.from_material(**given),
        {"length": 0.06, "youngs_modulus": 4e10, "diameter": 4e-4, "density": 7e3},
    ),
    "rat": (lambda **given: jw.Whisker.rat("C", 2, **given), {"length": 0.03, "youngs_modulus": 3e9, "parabola": 9.0}),
    "Whisker": (
        lambda **given: jw.Whisker(**given),
        {"length": 1.0, "bending_stiffness": 1.0, "intrinsic_curvature": 0.2, "mass_per_length": 1.0, "tip_mass": 0.1},
    ),
    "Parabola": (lambda **given: jw.Parabola(**given), {"distance": 0.2, "a": 1.0, "position": 0.0}),
    "Circle": (lambda **given: jw.Circle(**given), {"distance": 0.2, "radius": 1.0, "position": 0.0}),
    "Ellipse": (lambda **given: jw.Ellipse(**given), {"distance": 0.2, "a": 1.0, "b": 0.5, "position": 0.0}),
    "Box": (lambda **given: jw.Box(**given), {"distance": 0.2, "width": 1.0, "height": 0.5}),
    "Polygon": (
        lambda x, y: jw.Polygon(jnp.stack([jnp.asarray([-1.0, 0.8]), jnp.stack([x, y]), jnp.asarray([1.0, 0.8])])),
        {"x": 0.0, "y": 0.2},
    ),
    "Contour": (lambda r, d: jw.Contour(d, jnp.log(jnp.stack([r, r, r])), (-1.0, 0.0, 1.0)), {"r": 1.0, "d": 0.2}),
    "Tilted": (lambda angle: jw.Tilted(jw.Parabola(0.2), angle), {"angle": 0.1}),
    "Sphere": (lambda r, y: jw.Sphere(r, (0.0, y, 0.1)), {"r": 0.5, "y": 0.9}),
    "Ellipsoid": (lambda a, y: jw.Ellipsoid((a, 0.3, 0.2), (0.0, y, 0.1)), {"a": 0.5, "y": 0.9}),
    "Cylinder": (lambda r, z: jw.Cylinder(r, (0.0, 0.9, 0.0), (z, 0.0, 1.0)), {"r": 0.5, "z": 0.1}),
    "Capsule": (lambda r, z: jw.Capsule(r, (0.0, 0.9, 0.0), (z, 0.9, 1.0)), {"r": 0.5, "z": 0.1}),
    "RoundedBox": (lambda r, x: jw.RoundedBox((x, 0.5, 0.4), r, (0.0, 0.9, 0.1)), {"r": 0.1, "x": 0.6}),
    "Torus": (lambda r, y: jw.Torus(0.4, r, (0.0, y, 0.1), (0.0, 1.0, 0.2)), {"r": 0.1, "y": 0.9}),
    "Plane": (lambda x, y: jw.Plane((x, 0.0, 0.0), (1.0, y, 0.0)), {"x": -0.5, "y": -0.3}),
    "Paraboloid": (lambda a, b: jw.Paraboloid(0.3, a, b), {"a": 0.5, "b": 0.7}),
    "Extruded": (lambda q: jw.Extruded(jw.Parabola(q)), {"q": 0.3}),
    "Revolved": (lambda q: jw.Revolved(jw.Parabola(q)), {"q": 0.3}),
    "rotated": (lambda a: jw.Sphere(0.5, (0.0, 0.9, 0.0)).rotated((a, 0.0, 0.0)).moved((a, 0.0, 0.0)), {"a": 0.1}),
    "fb": (lambda **given: jw.Support.fb(**given), {"stiffness": 70.0, "rest_length": 0.2}),
    "follicle": (lambda **given: jw.Support.follicle(**given), {"x": 70.0, "y": 90.0, "phi": 3.0}),
    "mount": (lambda x, angle: jw.Support(mount=jw.Mount(x, angle=angle)), {"x": 0.1, "angle": 0.1}),
    "LinearDrive": (lambda x, z: jw.LinearDrive((x, 0.0, 0.1), (0.0, 0.0, z)), {"x": -1.0, "z": 0.1}),
}
IN_SPACE = (
    *("Sphere", "Ellipsoid", "Cylinder", "Capsule", "RoundedBox", "Torus", "Plane", "Paraboloid", "Extruded"),
    *("Revolved", "rotated", "LinearDrive"),
)


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind, (_, given) in CONSTRUCTORS.items() for name in given]
)
def test_every_parameter_of_every_constructor_may_be_that_of_a_study(kind, name):
    construct, given = CONSTRUCTORS[kind]

    def build(value):
        part = construct(**(given | {name: value}))
        parts = {"whisker": jw.Whisker(), "profile": SOLID} | ({"profile": BALL} if kind in IN_SPACE else {})
        if isinstance(part, jw.Whisker):
            parts["whisker"] = part
        elif isinstance(part, jw.Support):
            parts["support"] = part
        elif kind == "LinearDrive":
            parts["motion"] = part
        else:
            parts["profile"] = part
        return jw.Scene(**parts)

    values = given[name] * np.array([1.0, 1.01]) if given[name] else np.array([0.0, 0.01])
    found = parameters_of(build, {"value": values}, {}, ())
    assert layout_of_scenes(build, found).whiskers == 1
