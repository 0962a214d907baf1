"""Tangent rules of a scan's programs: spring lengths against JAX, tangents of steps, numbers that are too many."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from jaxwhisker._base.slopes import along_each
from jaxwhisker._scan.slopes import spring_tangents
from jaxwhisker._scan.springs import spring_lengths, suspension
from scenes import follicle

EXACT = 1e-13
STEPS = 3


def scene(count=1):
    """A turning base; with many whiskers, more numbers than slopes are worth."""
    motion = jw.Rotation((0.3, -0.2), 0.4)
    if count == 1:
        return jw.Scene(
            jw.Whisker(), jw.Parabola(0.2), follicle(70.0, 200.0, 5.0, mount=(0.05, 0.02, 0.1)), motion=motion
        )
    springs = tuple(jw.Spring((0, k), 70.0, 0.2 * k) for k in range(1, count + 1))
    return jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support(springs), motion=motion)


def test_tangents_of_a_step_depend_on_shared_numbers_and_its_own():
    rng = np.random.default_rng(0)
    slopes = {"a": jnp.asarray(rng.normal(size=(STEPS, 2, 6))), "none": None}
    shared = [jnp.asarray(rng.normal(size=(1, 2))), jnp.asarray(0.7)]
    own = [jnp.asarray(rng.normal(size=(STEPS, 2))), jnp.asarray(rng.normal(size=STEPS))]
    found = along_each(slopes, shared, own)["a"]
    for k in range(STEPS):
        direction = np.concatenate([np.ravel(shared[0]), [0.7], own[0][k], [own[1][k]]])
        np.testing.assert_allclose(found[k], slopes["a"][k] @ direction, atol=EXACT)
    np.testing.assert_allclose(along_each({"a": slopes["a"][..., 3:]}, [], own)["a"].shape, (STEPS, 2))


def test_a_step_does_not_see_tangents_that_it_does_not_depend_on():
    """After a snap with friction, contacts at rest have none, but a whisker that has come free since has."""
    slopes = {"a": jnp.array([[[2.0, 0.0]], [[2.0, 3.0]]])}
    found = along_each(slopes, [jnp.asarray(0.5)], [jnp.full(2, jnp.nan)])["a"]
    np.testing.assert_array_equal(found, [[1.0], [jnp.nan]])


def test_tangents_of_spring_lengths_are_those_of_jax():
    some, rng = suspension(scene()), np.random.default_rng(1)
    bases = tuple(jnp.asarray(rng.normal(size=(STEPS, 1))) for _ in range(3))
    control = jnp.asarray(rng.normal(size=STEPS))
    numbers, rest = eqx.partition(some, eqx.is_inexact_array)
    numbers = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype=float), numbers)
    some = eqx.combine(numbers, rest)
    dots = jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=leaf.shape)), (numbers, bases, control))

    @jax.jit
    def by_jax(*dots):
        def lengths(numbers, bases, control):
            return spring_lengths(eqx.combine(numbers, rest), bases, control)

        return jax.jvp(lengths, (numbers, bases, control), dots)[1]

    np.testing.assert_allclose(spring_tangents((some, bases, control), dots, None), by_jax(*dots), atol=EXACT)
    # What has no tangent stays where it is.
    none, (_, y, _) = jax.tree.map(lambda _: None, numbers), dots[1]
    still, zero, _ = jax.tree.map(jnp.zeros_like, (numbers, y, control))
    found = spring_tangents((some, bases, control), (none, (None, y, None), None), None)
    np.testing.assert_allclose(found, by_jax(still, (zero, y, zero), zero[:, 0]), atol=EXACT)
    assert np.any(found != 0)


def test_scenes_of_many_numbers_are_left_to_jax():
    many = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype=float) if isinstance(leaf, float) else leaf, scene(40))
    bases = (jnp.zeros((STEPS, 40)),) * 3
    none = jax.tree.map(lambda _: None, eqx.filter(many, eqx.is_inexact_array))
    assert spring_tangents((many, bases, jnp.zeros(STEPS)), (none, (None,) * 3, None), None) is NotImplemented
