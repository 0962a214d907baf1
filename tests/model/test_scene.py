"""Scenes and sensors: how they print, whiskers per base, units, errors."""

# pyright: reportArgumentType=false
import jax
import jax.numpy as jnp
import pytest

import jaxwhisker as jw
from jaxwhisker._model.scene import MOST_CONTACTS, moves_along_x, units

PARABOLA = jw.Parabola(0.2)
ROOF = [(-0.4, 0.2), (0.0, 0.4), (0.4, 0.2), (0.4, 0.9), (-0.4, 0.9)]


def arc(s):
    return 0.1 + s


@pytest.mark.parametrize(
    ("scene", "text"),
    [
        (
            jw.Scene(jw.Whisker(), PARABOLA, jw.Support.fbfbr(70.0, 0.2)),
            "FBFBR: 2 whiskers, 3 springs, parabola q = 0.2",
        ),
        (jw.Scene(jw.Whisker(0.5), jw.Circle(0.2, 3.0)), "clamped: 1 whisker, circle q = 0.2, r = 3, L = 0.5"),
        (
            jw.Scene(jw.Whisker(intrinsic_curvature=arc), PARABOLA, rod=jw.Shooting(steps=12)),
            "clamped: 1 whisker, parabola q = 0.2, kappa0 = arc(s), shooting, 12 steps",
        ),
        (
            jw.Scene(jw.Whisker(bending_stiffness=arc, intrinsic_curvature=0.3), PARABOLA, motion=jw.Rotation()),
            "clamped: 1 whisker, parabola q = 0.2, EI = arc(s), kappa0 = 0.3, rotation",
        ),
        (
            jw.Scene(jw.Whisker(1.0, 2.0), PARABOLA, rod=jw.ClosedForm()),
            "clamped: 1 whisker, parabola q = 0.2, EI = 2, closed form",
        ),
    ],
)
def test_a_scene_prints_itself(scene, text):
    assert str(scene) == repr(scene)
    assert str(scene) == text


def test_a_traced_scene_prints_itself():
    printed = []
    jax.jit(lambda q: printed.append(str(jw.Scene(jw.Whisker(), jw.Parabola(q)))))(0.2)
    assert printed == ["clamped: 1 whisker, parabola q = ?"]


def test_one_whisker_serves_all_bases():
    short, long = jw.Whisker(0.9), jw.Whisker(1.1)
    assert jw.Scene(short, PARABOLA, jw.Support.fbfb(70.0)).whiskers == (short, short)
    assert jw.Scene((short, long), PARABOLA, jw.Support.fbfb(70.0)).whiskers == (short, long)


def test_a_sensor_is_a_scene_without_its_object():
    scene = jw.Scene(jw.Whisker(0.9), PARABOLA, jw.Support.fb(70.0), motion=jw.Translation(1))
    sensor = jw.Sensor.of(scene)
    assert sensor.whiskers == scene.whiskers
    assert str(sensor.before(PARABOLA)) == str(scene)


def test_units_are_those_of_the_first_whisker():
    scene = jw.Scene((jw.Whisker(2.0, 24.0), jw.Whisker()), PARABOLA, jw.Support.fbfb(70.0))
    assert units(scene) == (2.0, 6.0, 12.0, 2.0)
    turning = jw.Scene(jw.Whisker(2.0, 24.0), PARABOLA, motion=jw.Rotation())
    assert units(turning).control == 1.0


@pytest.mark.parametrize(
    ("support", "motion", "along_x"),
    [
        (jw.Support.clamped(), jw.Translation(), True),
        (jw.Support.fb(70.0), jw.Translation(1), True),
        (jw.Support.fb(70.0), jw.Rotation(), False),
        (jw.Support.follicle(x=70.0, phi=3.0), jw.Translation(), False),
        (jw.Support(mount=jw.Mount()), jw.Translation(), False),
    ],
)
def test_only_upright_bases_move_along_x_alone(support, motion, along_x):
    assert moves_along_x(jw.Scene(jw.Whisker(), PARABOLA, support, motion=motion)) == along_x


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: jw.Scene(1.0, PARABOLA), "`whisker` must be a Whisker or a tuple of them, got 1.0"),
        (
            lambda: jw.Scene(jw.Whisker(), 0.2),
            "`profile` must be a Parabola, .* or Tilted, or a tuple of these, got 0.2",
        ),
        (lambda: jw.Scene(jw.Whisker(), PARABOLA, 70.0), "`support` must be a Support, got 70.0"),
        (
            lambda: jw.Scene(jw.Whisker(), PARABOLA, rod="exact"),
            r"`rod` must be Shooting\(\) or ClosedForm\(\), got 'exact'",
        ),
        (
            lambda: jw.Scene(jw.Whisker(), PARABOLA, motion="turn"),
            "`motion` must be a Translation, Rotation or Motion, got",
        ),
        (
            lambda: jw.Scene((jw.Whisker(), jw.Whisker()), PARABOLA, jw.Support.fb(70.0)),
            r"`whisker` must be one Whisker or one per base \(1 in FB\), got a tuple of 2",
        ),
        (
            lambda: jw.Scene(jw.Whisker(intrinsic_curvature=0.1), PARABOLA, rod=jw.ClosedForm()),
            r"`rod` must be Shooting\(\) for whiskers that are curved or not uniform, got ClosedForm\(\)",
        ),
        (
            lambda: jw.Scene(jw.Whisker(bending_stiffness=lambda s: 1 - s / 2), PARABOLA, rod=jw.ClosedForm()),
            r"`rod` must be Shooting\(\) for whiskers that are curved or not uniform",
        ),
    ],
)
def test_wrong_scenes(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"contacts": 0}, "`contacts` must be a positive int, got 0"),
        ({"contacts": 2.0}, "`contacts` must be a positive int, got 2.0"),
        ({"contacts": MOST_CONTACTS + 1}, f"`contacts` must be at most {MOST_CONTACTS}, got {MOST_CONTACTS + 1}"),
        (
            {"support": jw.Support((jw.Spring((0, 1), 70.0, 0.2), jw.Spring((0, 1), 5.0, 0.2, axis="axial", at=0.1)))},
            "`support` must be without springs or foundations on shafts for several contacts, got",
        ),
        ({"rod": jw.ClosedForm()}, r"`rod` must be Shooting\(\) for several contacts, got closed form"),
        ({"profile": jw.Cut(PARABOLA, right=0.3)}, "`profile` must be of smooth objects, polygons and boxes, got"),
        (
            {"profile": (PARABOLA, jw.Tilted(jw.Box(0.3, 0.8, 0.5), 0.3))},
            "`profile` must be of smooth objects, polygons and boxes, got",
        ),
        ({"detect": "crossing"}, "`detect` must be without \"crossing\" for several contacts, got .'crossing',."),
    ],
)
def test_wrong_scenes_with_several_contacts(changes, message):
    known = {"whisker": jw.Whisker(), "profile": PARABOLA, "contacts": 2}
    assert jw.Scene(**known).contacts == 2
    with pytest.raises(ValueError, match=message):
        jw.Scene(**(known | changes))


@pytest.mark.parametrize("profile", [jw.Pipe(0.65, height=0.4), jw.Polygon(ROOF)])
def test_hollow_objects_need_several_contacts(profile):
    allowed = "at least 2 for a hollow object, or one with inner corners"
    with pytest.raises(ValueError, match=f"`contacts` must be {allowed}, got 1"):
        jw.Scene(jw.Whisker(), profile)
    assert "up to 2 contacts" in str(jw.Scene(jw.Whisker(), profile, contacts=2))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"contacts": 0}, "`contacts` must be a positive int, got 0"),
        ({"contacts": MOST_CONTACTS + 1}, f"`contacts` must be at most {MOST_CONTACTS}, got {MOST_CONTACTS + 1}"),
        ({"friction": 0.3}, "`friction` must be None for several contacts in space, got 0.3"),
        ({"rod": jw.ClosedForm()}, "`rod` must be Shooting\\(\\) for several contacts, got"),
        ({"gravity": (0.0, -9.81, 0.0)}, "`gravity` must be None for several contacts, got"),
    ],
)
def test_several_contacts_in_space_refuse_what_they_do_not_model(changes, message):
    known = {"whisker": jw.Whisker(), "surface": jw.Sphere(1.0, (0.0, 5.0, 0.0)), "contacts": 2}
    assert jw.Scene(**known).contacts == 2
    assert "up to 2 contacts" in str(jw.Scene(**known))
    with pytest.raises(ValueError, match=message):
        jw.Scene(**(known | changes))


def test_a_graph_that_is_not_strictly_convex_above_the_bases_is_rejected_before_compiling():
    for profile in (jw.Graph(lambda x: 1.0 - x**2), jw.Graph(lambda x: x**2 - 0.1)):
        with pytest.raises(ValueError, match="`profile` must be strictly convex with its lowest point above the bases"):
            jw.scan(jw.Scene(jw.Whisker(), profile))
    assert jw.Scene(jw.Whisker(), jw.Graph(lambda x: 0.1 + jnp.cosh(x))).profile.valid()
