"""Cut profiles: their ends and derivatives by them, lowest points, mirror images, convexity, arguments."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw

EXACT = 1e-12
SAME = 1e-9  # points that are found by bisection


def test_the_arc_between_the_ends_is_that_of_the_profile():
    profile = jw.Tilted(jw.Ellipse(0.2, 0.5, 0.9), 0.2)

    @jax.jit
    def points(cut):
        low, high = cut.breaks()
        share = jnp.linspace(0.0, 1.0, 5)
        parameter = low + (high - low) * share
        return jax.vmap(cut.point)(parameter), jax.vmap(profile.point)(parameter)

    cut, whole = points(jw.Cut(profile, -0.2, 0.3))
    np.testing.assert_allclose(cut, whole, atol=EXACT)
    np.testing.assert_allclose(cut.x[jnp.array([0, -1])], [-0.2, 0.3], atol=SAME)


def test_derivatives_by_an_end_are_those_of_the_parabola():
    def ends(left, right, a):
        # The parameter of a parabola is its slope angle.
        return jw.Cut(jw.Parabola(0.2, a), left, right).breaks()

    at = (-0.3, 0.5, 1.5)

    def closed(left, right, a):
        return jnp.arctan(2 * a * jnp.stack([left, right]))

    def derivatives(function):
        reverse = jax.jacrev(function, argnums=(0, 1, 2))
        return jax.jit(lambda *at: (function(*at), reverse(*at), jax.jacfwd(reverse, argnums=1)(*at)))(*at)

    for one, other in zip(*(jax.tree.leaves(derivatives(f)) for f in (ends, closed)), strict=True):
        np.testing.assert_allclose(one, other, atol=EXACT)


def test_the_lowest_point_may_be_an_edge_that_turns_until_it_is_horizontal():
    @jax.jit
    @jax.vmap
    def lowest(left, right):
        cut = jw.Cut(jw.Parabola(0.2), left, right)
        small = cut.in_unit(10.0)
        return [(jnp.stack(each.vertex()), each.point(each.lowest())) for each in (cut, small)]

    x = np.array([0.1, -0.3, 0.0])
    for unit, (vertex, at) in zip(
        (1.0, 10.0), lowest(np.array([0.1, -0.5, -0.5]), np.array([0.5, -0.3, 0.4])), strict=True
    ):
        np.testing.assert_allclose(unit * vertex, np.stack([x, 0.2 + x**2], axis=1), atol=SAME)
        np.testing.assert_allclose(
            np.array([unit * at.x, at.cos, at.sin]), np.stack([x, np.ones(3), np.zeros(3)]), atol=SAME
        )


def test_first_touches_from_both_sides_are_mirror_images():
    one, other = (jw.Cut(jw.Parabola(0.2), *ends).in_unit(1.0) for ends in ((None, 0.4), (-0.4, None)))
    for height, piece in ((0.3, 1), (0.9, 2)):
        touch, mirrored = one.first_touch(height, 1.0), other.first_touch(height, -1.0)
        assert touch.piece == piece and mirrored.piece == 2 - piece
        np.testing.assert_allclose(
            [touch.x, touch.y, touch.parameter], [-mirrored.x, mirrored.y, -mirrored.parameter], atol=SAME
        )
        # A side that is not cut is touched at the height of the tip.
        far = one.first_touch(height, -1.0)
        assert far.piece == 1
        np.testing.assert_allclose([far.x, far.y], [-np.sqrt(height - 0.2), height], atol=SAME)


def test_edges_are_convex_wherever_the_arc_is_not():
    wavy = jw.Graph(lambda x: 0.2 + x**2 - 0.5 * x**4, extent=0.9)  # not convex beyond 1 / sqrt(3)
    cut = jw.Cut(wavy, right=0.7)
    convex = jax.jit(lambda: jax.vmap(cut.convex)(jnp.append(cut.breaks()[1] + jnp.array([-0.01, 0.01]), 0.5)))
    assert convex().tolist() == [False, True, True]


def test_traced_ends_are_valid_where_the_constructor_accepts_them():
    rows = jnp.array([[-0.3, 0.2], [0.2, -0.3], [-0.6, 0.2], [np.nan, 0.2], [-0.3, 0.499]])
    valid = jax.jit(jax.vmap(lambda row: jw.Cut(jw.Circle(0.2, 0.5), row[0], row[1]).valid()))(rows)
    assert valid.tolist() == [True, False, False, False, True]


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((jw.Parabola(0.2),), "`right` must be a number, at least if `left` is None"),
        ((jw.Parabola(0.2), 0.3, 0.1), "`right` must be greater than `left`"),
        ((jw.Circle(0.2, 0.5), -0.6), "`left` must be an x at which the profile .* has a point, got -0.6"),
        ((jw.Box(0.3, 0.8, 0.5), -0.1), "`profile` must be a smooth profile"),
        ((0.2, -0.1), "`profile` must be a smooth profile"),
        ((jw.Parabola(0.2), np.inf), "`left` must be a finite number"),
    ],
)
def test_wrong_cuts_are_rejected(arguments, message):
    with pytest.raises(ValueError, match=message):
        jw.Cut(*arguments)


def test_texts():
    assert str(jw.Cut(jw.Parabola(0.2), right=0.5)) == "parabola q = 0.2, cut to x < 0.5"
    assert str(jw.Cut(jw.Parabola(0.2), -0.3)) == "parabola q = 0.2, cut to -0.3 < x"
