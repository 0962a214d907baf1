"""Elements of a vibrating whisker: fields against exact and perturbed lines, quadratic forms against quadrature."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxwhisker._dynamics.elements import (
    NODES,
    ORDER,
    POINTS,
    VALUES,
    WEIGHTS,
    bending,
    fields,
    interpolated,
    node_arcs,
    quadratic,
)

ROUNDING = 1e-12
DIFFERENCE = 1e-9  # of central differences with a step of 1e-5
ENDS = np.array([0.3, 0.3, 1.0, 1.2])  # the second element has no length
STARTS = np.array([0.0, 0.3, 0.3, 1.0])
COUNT = len(ENDS) * ORDER


def angle(s):
    """A smooth angle along the whisker."""
    return 1.4 + 0.5 * s - 0.4 * s**3


def on_elements(function):
    return np.stack([function(start + (end - start) * POINTS) for start, end in zip(STARTS, ENDS, strict=True)])


def end_of(coordinates):
    """Position and angle at the tip for these coordinates: the change of the angle, and then its direction, summed."""
    lengths, turned = ENDS - STARTS, coordinates[-1]
    at = np.array(coordinates[-3:-1])
    for k, length in enumerate(lengths):
        own = np.polynomial.Legendre(np.zeros(1), domain=[0, 1])
        for j, a in enumerate(coordinates[k * ORDER : (k + 1) * ORDER]):
            own += np.sqrt(2 * j + 1) * a * np.sqrt(length) * np.polynomial.Legendre.basis(j, domain=[0, 1])
        running = own.integ(lbnd=0)
        phi = angle(STARTS[k] + length * POINTS) + turned + running(POINTS)
        at += length * WEIGHTS @ np.stack([np.cos(phi), np.sin(phi)], axis=1)
        turned += running(1.0)
    return np.append(at, turned)


def moves():
    lengths, arcs = node_arcs(jnp.asarray(ENDS))
    np.testing.assert_allclose(arcs, on_elements(lambda s: s), atol=ROUNDING)
    np.testing.assert_allclose(lengths, ENDS - STARTS, atol=ROUNDING)
    return jax.jit(fields)(lengths, jnp.cos(angle(arcs)), jnp.sin(angle(arcs)))


def test_fields_are_the_derivatives_of_the_line_by_its_coordinates():
    found = moves()
    for k in [0, 1, 5, ORDER, 2 * ORDER, 2 * ORDER + 3, COUNT - ORDER, COUNT - ORDER + 1, COUNT, COUNT + 1, COUNT + 2]:
        change = 1e-5 * np.eye(COUNT + 3)[k]
        difference = (end_of(change) - end_of(-change)) / 2e-5
        np.testing.assert_allclose(found.ends[-1, :, k], difference, atol=DIFFERENCE, err_msg=str(k))
    # An element without length moves nothing.
    np.testing.assert_allclose(found.at[..., ORDER : 2 * ORDER], 0, atol=ROUNDING)


def test_fields_are_continuous_and_begin_at_the_base():
    found = moves()
    rng = np.random.default_rng(0)
    mode = np.concatenate([rng.normal(size=COUNT) / (1 + np.arange(COUNT) % ORDER) ** 4, [0.2, -0.3, 0.5]])
    mode[ORDER : 2 * ORDER] = 0
    along, ends = np.asarray(found.at @ mode), np.asarray(found.ends @ mode)
    at = jnp.array([0.0, 1e-9, 0.3 - 1e-9, 0.3 + 1e-9, 1.0 - 1e-9, 1.0 + 1e-9, 1.2])
    values = interpolated(jnp.asarray(along), jnp.asarray(ENDS), at)
    expected = np.stack([mode[-3:], mode[-3:], ends[0], ends[1], ends[2], ends[2], ends[3]])
    np.testing.assert_allclose(values, expected, atol=1e-7)
    # Far from the base, a rigid rotation moves what is right of it upwards.
    turned = found.ends[:, :, -1]
    phi = angle(on_elements(lambda s: s))
    way = np.cumsum((ENDS - STARTS) * (WEIGHTS @ np.stack([np.cos(phi), np.sin(phi)], axis=-1)).T, axis=1)
    np.testing.assert_allclose(turned, np.stack([-way[1], way[0], np.ones(4)], axis=1), atol=ROUNDING)


def test_polynomials_are_interpolated_exactly_on_each_element():
    each = [np.polynomial.Polynomial(np.random.default_rng(k).normal(size=NODES)) for k in range(2)]
    values = jnp.asarray(np.stack([on_elements(one) for one in each], axis=-1)).at[3].add(1.0)
    s = np.array([0.0, 0.2, 0.3, 0.7, 1.0, 1.1, 1.2])
    expected = np.stack([one(s) for one in each], axis=-1) + (s > 1)[:, None]
    np.testing.assert_allclose(interpolated(values, jnp.asarray(ENDS), jnp.asarray(s)), expected, atol=1e-10)


def test_bending_energy_is_that_of_the_change_of_curvature():
    rng = np.random.default_rng(1)
    mode, stiffness = rng.normal(size=COUNT), on_elements(lambda s: 2.0 - s)
    form = np.asarray(bending(jnp.asarray(stiffness)))
    np.testing.assert_allclose(form, form.T, atol=ROUNDING)
    curvature = np.reshape(mode, (-1, ORDER)) @ VALUES[:, :ORDER].T  # times the square root of the length
    np.testing.assert_allclose(mode @ form @ mode, np.sum(WEIGHTS * stiffness * curvature**2), rtol=ROUNDING)
    # The polynomials are orthonormal: of a uniform whisker, all coordinates have the same stiffness.
    np.testing.assert_allclose(bending(jnp.full((4, NODES), 3.0)), 3.0 * np.eye(COUNT), atol=ROUNDING)


def test_quadratic_forms_sum_squares_with_weights():
    rng = np.random.default_rng(2)
    left, weight, mode = rng.normal(size=(2, 5, 3, 4)), rng.normal(size=(2, 5, 3)), rng.normal(size=4)
    form = quadratic(jnp.asarray(left), jnp.asarray(weight))
    np.testing.assert_allclose(mode @ form @ mode, np.sum(weight * (left @ mode) ** 2), rtol=ROUNDING)
    np.testing.assert_allclose(form, form.T, atol=ROUNDING)
