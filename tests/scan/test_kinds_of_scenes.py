"""Kinds of scenes: how many programs scans of scenes with every feature need. Only shapes are computed here."""

from collections import Counter
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base import checks
from jaxwhisker._base.program import _split
from jaxwhisker._equilibrium.dimensionless import problem_of
from jaxwhisker._model.canonical import canonical
from jaxwhisker._model.scene import moves_along_x
from jaxwhisker._plane.continuation import ContinuationInPlane
from jaxwhisker._scan.detect import kinds_of
from jaxwhisker._scan.route import route_of
from jaxwhisker._scan.springs import suspension
from scenes import cone, model

PARABOLA, CIRCLE, BESIDE = jw.Parabola(0.2), jw.Circle(0.2, 0.5), jw.Circle(0.3, 0.2, position=-1.0)
FB, FBFB, CLAMPED = jw.Support.fb(70.0, 0.2), jw.Support.fbfb(70.0, 0.2), jw.Support.clamped()
FROM_LEFT, TURN = jw.Translation(direction=1), jw.Rotation(pivot=(0.0, -0.5), radius=0.5)
BACK = np.array([1.2, 0.0, 1.0])
ZIGZAG = np.array([1.2, *[0.0, 0.3] * 5])
BASE, SHAFT = jw.Spring((0, 1), 70.0), [jw.Spring((0, 1), 30.0, at=at) for at in (0.1, 0.2)]
BETWEEN = jw.Spring((0, 1), 70.0), jw.Spring((1, 2), 70.0), jw.Spring((1, 2), 30.0, at=(0.1, 0.1))
ALL_AXES = jw.Support.follicle(x=100.0, y=100.0, phi=5.0)
# Lower corners, from left to right.
TRIANGLE = [(-0.5, 0.6), (0.0, 0.2), (0.5, 0.6)]
HEXAGON = [(-0.5, 0.6), (-0.3, 0.3), (0.0, 0.2), (0.3, 0.3), (0.5, 0.6), (0.0, 0.9)]


def scene(profile: Any = PARABOLA, support=FB, whisker: Any = None, **options):
    return jw.Scene(whisker or jw.Whisker(), profile, support, **options)


def scenes():
    """A scene for each feature and for numbers that once led to programs of their own; with a control if it turns."""
    box, bent = jw.Box(0.2, 0.5, 0.4), jw.Whisker(intrinsic_curvature=0.3)
    along_shaft = jw.Support((BASE, *SHAFT[:1])), jw.Support((BASE, *SHAFT)), jw.Support(BETWEEN)
    smooth = {
        "FB": scene(),
        "clamped": scene(support=CLAMPED),
        "circle": scene(CIRCLE),
        "ellipse": scene(jw.Ellipse(0.2, 0.5, 0.3)),
        "from the left": scene(motion=FROM_LEFT),
        "circle from the left": scene(CIRCLE, motion=FROM_LEFT),
        "tuple of one": scene(whisker=(jw.Whisker(),)),
        "FBFB": scene(support=FBFB),
        "FBFBR, circle": scene(CIRCLE, support=jw.Support.fbfbr(70.0, 0.2)),
        "FBFB, crossing": scene(support=FBFB, detect=("crossing",)),
        "FBFBFBR": model("FBFBFBR"),
        "there and back": (scene(), BACK),
        "to and fro": (scene(), ZIGZAG),
        "closed form": scene(rod=jw.ClosedForm()),
    }
    friction = {
        "friction": scene(friction=0.3),
        "friction, clamped": scene(support=CLAMPED, friction=0.3),
        "friction, circle": scene(CIRCLE, friction=0.3),
        "friction, clamped, ellipse": scene(jw.Ellipse(0.2, 0.5, 0.3), CLAMPED, friction=0.3),
        "friction, FBFB": scene(support=FBFB, friction=0.3),
        "friction, there and back": (scene(friction=0.3), BACK),
    }
    objects = {
        "box": scene(box),
        "box, FBFB": scene(box, FBFB),
        "triangle": scene(jw.Polygon(TRIANGLE)),
        "hexagon": scene(jw.Polygon(HEXAGON)),
        "cut parabola": scene(jw.Cut(PARABOLA, left=-0.3, right=0.3)),
        "contour of 9 knots": scene(jw.Contour.like(PARABOLA, np.linspace(-0.8, 0.8, 9))),
        "contour of 12 knots": scene(jw.Contour.like(PARABOLA, np.linspace(-0.8, 0.8, 12))),
        "tilted parabola": scene(jw.Tilted(PARABOLA, 0.2)),
        "tilted circle": scene(jw.Tilted(CIRCLE, 0.2)),
        "parabola and circle": scene((PARABOLA, BESIDE)),
        "two circles": scene((CIRCLE, BESIDE)),
        "box and circle": scene((box, BESIDE)),
    }
    others = {
        "conical": scene(whisker=cone(0.3)),
        "curved": scene(whisker=bent),
        "curved, circle": scene(CIRCLE, whisker=bent),
        "curved and conical": scene(whisker=cone(0.3, curvature=(0.1, 0.2))),
        "follicle": scene(support=ALL_AXES),
        "follicle, circle": scene(CIRCLE, support=ALL_AXES),
        "torsion": scene(support=jw.Support.follicle(phi=5.0)),
        "rotation": scene(support=CLAMPED, motion=TURN),
        "rotation, FB": scene(motion=TURN),
        "spring on the shaft": scene(support=along_shaft[0]),
        "two springs on the shaft": scene(support=along_shaft[1]),
        "spring between shafts": scene(support=along_shaft[2]),
    }
    return smooth | friction | objects | others


def shape_of(*args):
    return _split(args)[0]


def programs(one, control=None):
    """The programs of a scan, its events and its detection: their names and the shapes of their arguments."""
    stops, kinds = 2 if control is None else route_of(control).stops.shape[0], kinds_of(one)
    one, capacity = jax.tree.map(checks.as_float, one), []

    def traced(one):
        problem = problem_of(one)
        capacity.append(ContinuationInPlane(problem).capacity(stops))
        return problem

    problem = shape_of(eqx.filter_eval_shape(traced, one))
    path = problem, capacity[0]
    found = {"problem": shape_of(canonical(one)), "path": (problem, stops), "states": path, "events": path}
    if kinds:
        found["detection"] = path, kinds
    if not moves_along_x(one):  # otherwise they are differences, which only derivatives need a program for
        found["spring lengths"] = shape_of(suspension(one))
    return found


@pytest.fixture(scope="module")
def found():
    every = {name: one if isinstance(one, tuple) else (one,) for name, one in scenes().items()}
    return {name: programs(*one) for name, one in every.items()}


def test_scenes_that_differ_in_numbers_share_all_programs_but_the_first(found):
    groups = [
        *(("FB", "clamped", "circle", "ellipse", "from the left", "circle from the left", "tuple of one"),),
        *(("friction", "friction, clamped", "friction, circle", "friction, clamped, ellipse"),),
        *(("FBFB", "FBFBR, circle", "FBFB, crossing"), ("follicle", "follicle, circle", "torsion")),
        *(("tilted parabola", "tilted circle"), ("parabola and circle", "two circles"), ("rotation", "rotation, FB")),
    ]
    for first, *others in groups:
        for other in others:
            for name in ("path", "states", "events"):
                assert found[first][name] == found[other][name], (first, other, name)


def test_the_number_of_programs_of_all_features(found):
    # docs/waiting.md shows these numbers. Fewer are better; think twice before you add one.
    counted = Counter(name for name, _ in {(name, shape) for each in found.values() for name, shape in each.items()})
    assert len(found) == 44
    assert dict(counted) == {
        "problem": 23,
        "path": 24,
        "states": 24,
        "events": 24,
        "detection": 11,
        "spring lengths": 5,
    }


def test_scenes_that_differ_in_equations_do_not_share_their_paths(found):
    names = ("FB", "FBFB", "there and back", "closed form", "friction", "box", "conical", "curved", "follicle")
    assert len({found[name]["path"] for name in names}) == len(names)
