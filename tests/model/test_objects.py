"""Several objects as one profile: numbers of pieces, each object's own points and derivatives, validity."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._model.objects import Objects, OneOf, as_one

EACH = (jw.Parabola(0.3), jw.Box(0.25, 0.4, 0.5, -3.0), jw.Circle(0.2, 0.5, 4.0))
# The box has the pieces edge, face, edge, face, ..., beginning and ending with a corner.
OBJECTS = Objects(EACH)
BREAKS = len(EACH[1].breaks())


def test_pieces_are_numbered_through_all_objects():
    assert OBJECTS.first_pieces() == (0, 1, 2 + BREAKS)
    pieces = jnp.arange(3 + BREAKS)
    owners, (low, high), breaks = jax.jit(
        lambda pieces: (OBJECTS.object_of(pieces), OBJECTS.ends_on(pieces), EACH[1].breaks())
    )(pieces)
    np.testing.assert_array_equal(owners, [0, *[1] * (BREAKS + 1), 2])
    assert OBJECTS.object_of(None) is None and OBJECTS.has_pieces and OBJECTS.has_edges
    assert not Objects(EACH[::2]).has_edges
    np.testing.assert_array_equal(low, [-np.inf, -np.inf, *breaks, -np.inf])
    np.testing.assert_array_equal(high, [np.inf, *breaks, np.inf, np.inf])


@jax.jit
def at(piece, parameter):
    """Point, derivative in both modes, and convexity at a parameter of a piece."""
    both = OBJECTS.in_unit(1.0)

    def point(parameter):
        return jnp.stack(both.point_on(piece, parameter))

    return point(parameter), jax.jacfwd(point)(parameter), jax.jacrev(point)(parameter)


@jax.jit
def alone(parameter):
    one, box, circle = (each.in_unit(1.0) for each in EACH)
    return (
        jnp.stack(one.point(parameter)),
        [jnp.stack(box.point_on(jnp.asarray(piece), parameter)) for piece in range(box.breaks().size + 1)],
        jnp.stack(circle.point(parameter)),
    )


# Slope angles of a parabola end at a right angle, parameters of the box do not.
@pytest.mark.parametrize("parameter", [0.4, 1e3])
def test_a_piece_has_the_points_and_derivatives_of_its_own_object(parameter):
    one, box, circle = alone(parameter)
    slopes = jax.jit(jax.jacfwd(alone))(parameter)
    expected = [one, *box, circle]
    expected_slopes = [slopes[0], *slopes[1], slopes[2]]
    for piece, (point, slope) in enumerate(zip(expected, expected_slopes, strict=True)):
        found = at(jnp.asarray(piece), parameter)
        for value, own in zip(found, (point, slope, slope), strict=True):
            np.testing.assert_allclose(value, own, rtol=1e-12, atol=1e-12)
            assert np.isfinite(value).all()


def test_an_object_that_is_not_convex_concerns_its_own_pieces():
    wavy = jw.Graph(lambda x: 0.2 + x**2 - 0.5 * x**4, extent=0.9)  # not convex beyond 1 / sqrt(3)
    both = Objects((jw.Circle(0.3, 0.2, 4.0), wavy)).in_unit(1.0)
    assert jax.jit(jax.vmap(both.convex_on, (0, None)))(jnp.arange(2), 0.7).tolist() == [True, False]


def test_the_curve_of_one_of_several_smooth_objects():
    both = Objects(EACH[::2]).in_unit(2.0)
    assert both.on(None) is both
    own = both.on(jnp.asarray(1))
    assert isinstance(own, OneOf)
    np.testing.assert_allclose(own.point(jnp.asarray(0.3)), EACH[2].in_unit(2.0).point(jnp.asarray(0.3)), rtol=1e-14)
    assert jax.jit(lambda at: own.speed(at))(0.3) == pytest.approx(0.5 / 2.0)  # of a circle: its radius


def test_the_vertex_is_that_of_the_lowest_object():
    np.testing.assert_array_equal(OBJECTS.vertex(), [4.0, 0.2])
    by_distance = jax.grad(lambda q: Objects((jw.Parabola(q), EACH[2])).vertex()[1])
    assert by_distance(0.1) == 1.0 and by_distance(0.3) == 0.0


def test_objects_are_valid_if_each_of_them_is():
    rows = jnp.array([[0.3, 0.2], [-0.3, 0.2], [0.3, np.nan], [0.3, 0.0]])
    valid = jax.jit(jax.vmap(lambda row: Objects((jw.Parabola(row[0]), jw.Circle(row[1], 0.5))).valid()))(rows)
    assert valid.tolist() == [True, False, False, False]


def test_a_tuple_of_profiles_becomes_one_profile():
    one, box, circle = EACH
    assert as_one(one) is one and as_one((one,)) is one
    assert as_one(()) == () and as_one((one, 3.0)) == (one, 3.0) and as_one(None) is None
    several = as_one((one, as_one((box, circle))))
    assert isinstance(several, Objects) and several.each == EACH
    assert str(several) == "; ".join(map(str, EACH))
