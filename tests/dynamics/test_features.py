"""Gaps between bent whiskers and corners and faces, and how contacts pass from one to the other."""

# pyright: reportArgumentType=false
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from jaxwhisker._chain.gaps import Candidate
from jaxwhisker._chain.polygons import corner_signs
from jaxwhisker._chain.shaft import WholeShaft
from jaxwhisker._dynamics.features import (
    ends_of,
    gap_on,
    next_piece,
    slips_off,
    stretches_of,
    wedged,
    with_tips_at_faces,
)
from jaxwhisker._dynamics.gap import Posed, gap_at
from jaxwhisker._dynamics.legendre import basis
from jaxwhisker._dynamics.outline import outline
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.objects import Objects

BOX, CIRCLE = jw.Box(distance=0.5, width=0.4, height=0.3), jw.Circle(0.3, 0.2, position=2.0)
PROFILE: Any = outline(Objects((BOX, CIRCLE)).in_unit(1.0))
LEFT, BOTTOM, RIGHT = 2, 3, 4  # pieces: the lower corners, and the face between them
BASIS = basis(6)
EXACT = 1e-12


def arc_of_circle(x, curvature, lean=0.0):
    """A whisker of constant curvature with its base at (x, 0), and a function from arc lengths to points."""
    angles = np.pi / 2 + lean + curvature * BASIS.points

    def point(s):
        start = np.pi / 2 + lean
        return np.array([
            x + (np.sin(start + curvature * s) - np.sin(start)) / curvature,
            (np.cos(start) - np.cos(start + curvature * s)) / curvature,
        ])  # fmt: skip

    return Posed(BASIS, PROFILE, jnp.asarray(1.0), jnp.array([x, 0.0]), jnp.asarray(angles)), point


def ends(piece):
    low, high = PROFILE.ends_on(jnp.asarray(piece))
    return float(low), float(high)


def test_a_corner_has_the_normal_of_the_whisker():
    posed, point = arc_of_circle(0.21, 0.3)
    arc = 0.52
    gap = gap_on(posed, jnp.asarray(RIGHT), arc, jnp.asarray(0.0))
    angle = np.pi / 2 + 0.3 * arc
    normal, along = np.array([np.sin(angle), -np.cos(angle)]), np.array([np.cos(angle), np.sin(angle)])
    apart = point(arc) - [0.2, 0.5]
    np.testing.assert_allclose(gap.normal, normal, atol=1e-6)
    np.testing.assert_allclose(gap.distance, apart @ normal, atol=1e-6)
    np.testing.assert_allclose(gap.end, -apart @ along, atol=1e-6)
    # The parameter tells the slope of the whisker there.
    np.testing.assert_allclose(gap.foot - ends(RIGHT)[0], angle, atol=1e-6)
    assert gap.at_tip < 0


def test_a_face_has_its_own_normal_at_the_tip_and_on_the_shaft():
    posed, point = arc_of_circle(0.0, 0.2, lean=0.1)
    at = ends(BOTTOM)[0] + 0.25
    tip = gap_on(posed, jnp.asarray(BOTTOM), 1.0, jnp.asarray(at))
    x, y = point(1.0)
    np.testing.assert_allclose(tip.distance, 0.5 - y, atol=1e-6)
    np.testing.assert_allclose(tip.foot, x - 0.05, atol=1e-6)
    assert tip.end == 0 and tip.at_tip > 0
    np.testing.assert_allclose(tip.normal, [0.0, -1.0], atol=EXACT)
    np.testing.assert_allclose([tip.object.x, tip.object.y], [0.05, 0.5], atol=EXACT)
    # A whisker that turns over lies on the face where it is parallel to it.
    over, point = arc_of_circle(0.5, 2.5)
    top = np.pi / 2 / 2.5
    shaft = gap_on(over, jnp.asarray(BOTTOM), top, jnp.asarray(at))
    np.testing.assert_allclose([shaft.end, shaft.distance], [0.0, 0.5 - point(top)[1]], atol=1e-4)


def test_gradients_of_gaps():
    posed, _ = arc_of_circle(0.21, 0.3)
    place = jnp.asarray(0.5), jnp.asarray(ends(RIGHT)[0] + 1.6)
    # At the foot of the corner, where moving along the whisker changes nothing.
    at = jax.jacfwd(lambda arc: gap_on(posed, jnp.asarray(RIGHT), arc, place[1]).end)
    arc = place[0]
    for _ in range(4):
        arc -= gap_on(posed, jnp.asarray(RIGHT), arc, place[1]).end / at(arc)
    for piece in map(jnp.asarray, (RIGHT, BOTTOM)):
        rate = jax.grad(lambda angle, piece=piece: gap_on(posed._replace(angle=angle), piece, arc, place[1]).distance)
        across = gap_on(posed, piece, arc, place[1]).across
        np.testing.assert_allclose(rate(posed.angle), across, atol=1e-5)


def test_smooth_objects_have_the_gaps_of_one_contact():
    posed, _ = arc_of_circle(1.9, 0.3)
    parameter = PROFILE.shift[1] + 0.1
    piece = PROFILE.first_pieces()[1]
    ours, theirs = gap_on(posed, jnp.asarray(piece), 0.4, parameter), gap_at(posed, 0.4, parameter)
    for own, other in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        np.testing.assert_allclose(own, other, atol=EXACT)


def test_contacts_pass_corners_and_slip_off():
    low, high = ends(BOTTOM)
    parameters = jnp.array([low - 0.01, low + 0.01, high + 0.01])
    assert next_piece(PROFILE, jnp.full(3, BOTTOM), parameters).tolist() == [LEFT, BOTTOM, RIGHT]
    tips, shafts = (slips_off(PROFILE, jnp.full(3, BOTTOM), jnp.full(3, arc), parameters) for arc in (1.0, 0.8))
    assert tips.tolist() == [True, False, True] and not shafts.any()
    corners = slips_off(PROFILE, jnp.full(2, LEFT), jnp.array([0.999, 1.001]), jnp.full(2, ends(LEFT)[0] + 0.1))
    assert corners.tolist() == [False, True]


NOTCH: Any = outline(Objects((jw.Polygon([(-0.5, 0.5), (0.0, 0.8), (0.5, 0.5), (0.0, 1.4)]), CIRCLE)).in_unit(1.0))


def test_inner_corners_separate_stretches_and_end_no_face():
    (inner,) = np.flatnonzero(corner_signs(NOTCH) < 0)
    pieces, circle = int(NOTCH.first_pieces()[1]), int(stretches_of(NOTCH)[-1])
    stretches = np.asarray(stretches_of(NOTCH))
    assert len(set(stretches[:inner])) == len(set(stretches[inner:pieces])) == 1
    assert stretches[0] < stretches[inner] < circle
    # The faces on both sides go on inside the object.
    low, high = ends_of(NOTCH, jnp.array([inner - 1, inner + 1]))
    assert np.isfinite(low).tolist() == [True, False] and np.isfinite(high).tolist() == [False, True]
    beyond = high[1] + 0.1
    assert next_piece(NOTCH, jnp.array([inner - 1, inner + 1]), jnp.stack([beyond, beyond])).tolist() == [
        inner - 1,
        inner + 2,
    ]


def test_two_contacts_hold_a_tip_in_an_inner_corner():
    (inner,) = np.flatnonzero(corner_signs(NOTCH) < 0)
    faces = jnp.array([inner - 1, inner + 1])

    def held(piece, arc, presses):
        return wedged(NOTCH, piece, jnp.array(arc), jnp.array(presses)).tolist()

    assert held(faces, [1.0, 1.0], [True, True]) == [True, True]
    assert held(faces, [1.0, 1.0], [True, False]) == [False, False]
    assert held(faces, [1.0, 0.7], [True, True]) == [False, False]
    assert held(faces[:1].repeat(2), [1.0, 1.0], [True, True]) == [False, False]


def test_a_tip_meets_one_face_of_each_stretch():
    # An upright whisker under the inner corner, with its tip 0.1 below it.
    shaft = straight_shaft(x=0.01, tip=0.7)
    none = jnp.full(1, jnp.inf), jnp.zeros((1, 3)), jnp.full(1, int(Phase.tip)), jnp.ones(1), jnp.zeros(1, int)
    found = with_tips_at_faces(NOTCH, Candidate(*none), shaft)
    near = np.isfinite(found.gap)
    (inner,) = np.flatnonzero(corner_signs(NOTCH) < 0)
    assert set(np.asarray(found.piece)[near].tolist()) == {inner - 1, inner + 1}
    across = np.array([0.5, 0.3]) / np.hypot(0.5, 0.3)  # along the face on the left
    apart = np.array([0.01, 0.7]) - [0.0, 0.8]
    left = apart @ [across[1], -across[0]]
    right = apart @ [-across[1], -across[0]]
    gaps = dict(zip(np.asarray(found.piece)[near].tolist(), np.asarray(found.gap)[near].tolist(), strict=True))
    np.testing.assert_allclose([gaps[inner - 1], gaps[inner + 1]], [left, right], atol=EXACT)


def straight_shaft(x, tip):
    """An upright shaft without contacts."""
    beyond = jnp.stack([jnp.linspace(0.0, 0.5, 5)] * 3)
    none = jnp.zeros_like(beyond)
    number = jnp.full(3, -1)
    return WholeShaft(beyond, x + none, tip - beyond, none, none + 1, none, number, number)
