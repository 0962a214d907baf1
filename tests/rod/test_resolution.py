"""Estimates of how well steps resolve a rod, against quadrature by scipy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from jaxwhisker._rod.resolution import LOADED, _integrals, bending_error, relative_error
from jaxwhisker._rod.rod import Section

RESOLVED = 1e-9  # integrals with 64 steps
ROUNDING = 1e-13
LENGTH = 1.3
NOWHERE = np.array(2.0)  # a break beyond the rod


def stiffness(s):
    """Falls to a fifth within a tenth of the rod."""
    return 0.6 - 0.4 * jnp.tanh((s - 0.7) / 0.06)


def curvature(s):
    return 0.3 + 0.5 * s - s**3


def jump(s):
    return jnp.where(s < 0.41, 1.0, 0.2)


@jax.jit
def estimates(steep, at, scale):
    """Errors of bending and of a density with 8 steps, for a steep function or a jump, a break and a unit of mass."""

    def along(s):
        return jnp.where(steep, stiffness(s), jump(s))

    bent = Section(along, lambda s: jnp.where(steep, curvature(s), 0.0), 1.0, 1.0, breaks=at[None])
    dense = Section(1.0, lambda s: scale * along(s), 1.0, 1.0, breaks=at[None])
    return bending_error(LENGTH, bent, 8), relative_error(LENGTH, dense, 8)


def integrals(arc):
    """Turn and displacement by intrinsic curvature and by a unit force at this arc length, as `_integrals`."""

    def integral(function):
        return quad(function, 0.0, arc, points=[p for p in (0.6, 0.7, 0.8) if p < arc], epsabs=1e-12, limit=200)[0]

    def soft(s):
        return (arc - s) / float(0.6 - 0.4 * np.tanh((s - 0.7) / 0.06))

    rows = [[integral(lambda s, f=f, n=n: f(s) * ((arc - s) / arc) ** n) for f in (curvature, soft)] for n in (0, 1)]
    return np.array(rows, dtype=float)


@jax.jit
def computed(arc):
    section = Section(stiffness, curvature, 1.0, 1.0)
    return [_integrals(arc, section, steps) for steps in (8, 64)]


def test_integrals_are_those_of_the_curvature_and_its_lever():
    for arc in (LENGTH, 0.5):
        np.testing.assert_allclose(computed(arc)[1], integrals(arc), atol=RESOLVED)


def test_the_estimate_is_the_error_of_the_steps():
    wrong = []
    for share in LOADED:
        exact = integrals(share * LENGTH)
        off = np.abs(computed(share * LENGTH)[0] - exact)
        wrong.append(np.max(off / [1.0, exact[0, 1]]))
    assert estimates(True, NOWHERE, 1.0)[0] == pytest.approx(max(wrong), rel=0.1)


def test_a_jump_is_resolved_by_a_break_only():
    plain, broken = (estimates(False, at, 1.0) for at in (NOWHERE, np.array(0.41)))
    assert min(plain) > 1e-3 and max(broken) < ROUNDING


def test_the_error_of_a_density_is_relative():
    (_, one), (_, small) = (estimates(True, NOWHERE, scale) for scale in (1.0, 1e-4))
    assert one == pytest.approx(float(small), rel=1e-6)
    mass = quad(stiffness, 0.0, LENGTH, points=[0.6, 0.7, 0.8], epsabs=1e-12)[0]
    first = quad(lambda s: float(stiffness(s)) * (LENGTH - s) / LENGTH, 0.0, LENGTH, points=[0.6, 0.7, 0.8])[0]
    dense = Section(1.0, stiffness, 1.0, 1.0)
    coarse = np.array(jax.jit(lambda: _integrals(LENGTH, dense, 8)[:, 0])())
    assert one == pytest.approx(np.max(np.abs(coarse - [mass, first])) / mass, rel=0.1)
