"""Several surfaces as one: a point belongs to the nearest object, planes before all of them, derivatives."""

# pyright: reportArgumentType=false

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._model.surfaces import Surfaces, as_one_surface

EACH = (
    jw.Cylinder(0.2, (0.0, 0.8, 0.0), (0.0, 0.3, 1.0)),
    jw.Capsule(0.1, (1.0, 0.5, 0.0), (1.0, 1.5, 0.2)),
    jw.Ellipsoid((0.3, 0.2, 0.4), (-1.0, 0.9, 0.1)).rotated((0.3, 0.2, -0.4)),
    jw.Capsule(0.05, (2.0, 0.5, 0.0), (2.0, 1.5, 0.2)),
)
EXACT = 1e-14
# On the surfaces, to first order: each about its own object.
POINTS = np.array([[0.2, 0.75, 0.05], [0.9, 1.0, 0.1], [-1.0, 0.75, 0.2], [1.95, 0.8, 0.05]])


@jax.jit
def known(points):
    surface = Surfaces(EACH).in_unit(jnp.asarray(1.0))

    def at(x):
        steps = surface.steps_to_joint(x, jnp.array([0.0, 0.1, 0.0]))
        local = surface.level(x), surface.gradient(x), surface.hessian(x), surface.off(x), steps
        return local, surface.ball_before(x), surface.object_of(x), surface.of_each(lambda one: one.off(x))

    return jax.vmap(at)(points)


@jax.jit
def alone(points):
    def at(one, x):
        local = (
            one.level(x),
            one.gradient(x),
            one.hessian(x),
            one.off(x),
            one.steps_to_joint(x, jnp.array([0.0, 0.1, 0.0])),
        )
        return local, one.ball_before(x)

    return [[at(one.in_unit(jnp.asarray(1.0)), x) for x in points] for one in EACH]


def test_a_point_belongs_to_the_nearest_object():
    local, planes, numbers, offs = known(POINTS)
    each = alone(POINTS)
    np.testing.assert_array_equal(numbers, [0, 1, 2, 3])
    for k in range(4):
        for own, other in zip(local, each[k][k][0], strict=True):
            np.testing.assert_allclose(own[k], other, rtol=EXACT, atol=EXACT)
        np.testing.assert_allclose(offs[k], [each[j][k][0][3] for j in range(4)], atol=EXACT)
        nearest = np.argmin([each[j][k][1][0] for j in range(4)])
        for own, other in zip(planes, each[nearest][k][1], strict=True):
            np.testing.assert_allclose(own[k], other, atol=EXACT)


def test_derivatives_are_those_of_the_object_that_a_point_belongs_to():
    def off(radius, capsule, x):
        surface = Surfaces(
            (jw.Cylinder(radius, (0.0, 0.8, 0.0)), jw.Capsule(capsule, (1.0, 0.5, 0.0), (1.0, 1.5, 0.2)))
        )
        return surface.in_unit(jnp.asarray(1.0)).off(x)

    both = jax.jit(jax.vmap(lambda x: (jax.grad(off, (0, 1))(0.2, 0.1, x), jax.jacfwd(off, (0, 1))(0.2, 0.1, x))))
    for by_radius, by_capsule in both(jnp.asarray(POINTS[:2])):
        assert by_radius[0] < -0.9 and by_capsule[0] == 0
        assert by_radius[1] == 0 and by_capsule[1] < -0.9


def test_several_objects_are_one_surface_in_any_unit():
    surface = Surfaces(EACH)
    assert surface.objects == EACH and EACH[0].objects == (EACH[0],)
    assert str(surface) == "; ".join(map(str, EACH))
    x = jnp.asarray(POINTS[2])
    np.testing.assert_allclose(surface.in_unit(2.0).off(x / 2), surface.off(x) / 2, rtol=1e-12)
    np.testing.assert_allclose(surface.interior_point(), np.mean([one.interior_point() for one in EACH], axis=0))
    assert surface.thickness() == min(float(one.thickness()) for one in EACH)


@pytest.mark.parametrize("radius", [0.1, -0.1, np.nan])
def test_validity_is_that_of_all(radius):
    valid = jax.jit(lambda r: Surfaces((EACH[0], jw.Sphere(r, (3.0, 0.0, 0.0)))).valid())
    assert bool(valid(radius)) == (radius > 0)


def test_tuples_of_surfaces_become_one():
    assert as_one_surface(EACH[:1]) is EACH[0]
    assert as_one_surface((Surfaces(EACH[:2]), EACH[2])).objects == EACH[:3]
    mixed = (EACH[0], jw.Circle(0.2, 0.3))
    assert as_one_surface(mixed) is mixed and as_one_surface(()) == ()
