"""Scenes in space: the kind of the object decides, and what is only available in the plane is rejected."""

import pytest

import jaxwhisker as jw

BALL = jw.Sphere(1.0, (0.0, 1.3, 0.2))


@pytest.mark.parametrize("given", [{"profile": BALL}, {"surface": BALL}])
def test_a_scene_with_a_surface_is_one_in_space(given):
    scene = jw.Scene(jw.Whisker(), **given)
    assert isinstance(scene, jw.SpaceScene) and not isinstance(scene, jw.Scene)
    assert str(scene) == "clamped: 1 whisker, sphere r = 1, centre (0, 1.3, 0.2)"
    assert isinstance(jw.Scene(jw.Whisker(), jw.Circle(0.3, 1.0)), jw.Scene)


def test_friction_in_space_is_a_number_that_is_not_negative():
    scene = jw.Scene(jw.Whisker(), BALL, friction=0.3)
    assert scene.friction == 0.3 and "friction 0.3" in str(scene)
    assert jw.Scene(jw.Whisker(), BALL).friction is None
    assert jw.Scene(jw.Whisker(), BALL, friction=0.0).friction == 0.0


@pytest.mark.unchecked
@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf"), "rough"])
def test_other_friction_is_rejected(value):
    with pytest.raises(ValueError, match="`friction` must be"):
        jw.Scene(jw.Whisker(), BALL, friction=value)


def test_a_scene_moves_as_in_the_plane_by_default():
    scene = jw.Scene(jw.Whisker(), BALL)
    assert isinstance(scene.motion, jw.Translation) and scene.motion.onwards == -1


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("whisker", {"whisker": (jw.Whisker(), jw.Whisker())}),
        ("at", {"support": jw.Support((jw.Spring((0, 1), 70.0, at=0.1),))}),
        ("rod", {"rod": jw.ClosedForm(), "whisker": jw.Whisker(intrinsic_curvature=0.5)}),
        ("rod", {"rod": jw.ClosedForm(), "support": jw.Support.follicle(phi=3.0)}),
    ],
)
def test_what_is_not_available_in_space_is_named(name, change):
    with pytest.raises(ValueError, match=f"`{name}`"):
        jw.SpaceScene(**({"whisker": jw.Whisker(), "surface": BALL} | change))


@pytest.mark.parametrize(
    ("whisker", "support", "rolls"),
    [
        (jw.Whisker(), jw.Support.follicle(x=50.0, z=20.0), False),
        (jw.Whisker(lateral_curvature=0.3), jw.Support(), True),
        (jw.Whisker(), jw.Support.follicle(phi_y=3.0), True),
    ],
)
def test_torsion_plays_a_part_for_curved_whiskers_and_turning_bases(whisker, support, rolls):
    assert jw.SpaceScene(whisker, BALL, support).rolls == rolls


def test_the_closed_form_computes_uniform_straight_whiskers():
    control = [-1.2, -0.4, 0.2]
    drive = jw.LinearDrive((-1.0, 0.0, 0.0))
    exact, integrated = (
        jw.scan(jw.SpaceScene(jw.Whisker(), BALL, rod=rod, motion=drive), control).force
        for rod in (jw.ClosedForm(), jw.Shooting())
    )
    assert abs(exact - integrated).max() < RODS


RODS = 1e-8  # error of integrated rods, for forces of about 5
