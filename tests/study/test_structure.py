"""The structure of a study's scenes: what may differ between points, and the hash of the scenes."""

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from jaxwhisker._study.parameters import parameters_of
from jaxwhisker._study.structure import fingerprint, layout_of_scenes, sampled

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
