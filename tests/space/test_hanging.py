"""Free whiskers with a weight: deflections, tilting bases, and buckling loads."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base.rotation import rotation_matrix
from jaxwhisker._model.drives import UPRIGHT
from jaxwhisker._space.hanging import Hanging, hung
from jaxwhisker._space.section import space_section
from jaxwhisker._space.weight import weight_of_one
from scenes import check_derivatives

SAME = 1e-9  # the same equilibrium, computed in another way
DIFFERENCES = 1e-7
PLACES = jnp.linspace(0.0, 1.0, 5)
NONE = jnp.zeros(3)


def free(gravity=(0.3, -1.0, 0.4), compliance=None, rest=NONE, **masses):
    whisker = jw.Whisker(**({"mass_per_length": 1.0, "tip_mass": 0.2} | masses))
    section = space_section(whisker, 1.0, 1.0, heavy=True)
    return Hanging(weight_of_one(whisker, gravity), jnp.ones(()), section, jnp.asarray(UPRIGHT), compliance, rest)


def test_clamped_whiskers_hang_as_they_deflect():
    found, whisker = hung(free(), PLACES), jw.Whisker(mass_per_length=1.0, tip_mass=0.2)
    bent = jw.deflect(whisker, gravity=(0.3, -1.0, 0.4), points=5)
    np.testing.assert_allclose(found.load, [-getattr(bent, n) for n in ("fx", "fy", "fz", "mx", "my", "mz")], atol=SAME)
    place = np.asarray(found.position) @ UPRIGHT.T
    np.testing.assert_allclose(place, np.stack([bent.x, bent.y, bent.z], axis=1), atol=SAME)
    np.testing.assert_allclose(UPRIGHT @ np.asarray(found.rotation), bent.rotation, atol=SAME)
    assert found.stable


def test_a_base_tilts_until_its_springs_balance_the_weight():
    compliance, rest = jnp.array([0.2, 0.1, 0.3]), jnp.array([0.1, -0.2, 0.05])
    tilting = free(compliance=compliance, rest=rest)
    found = hung(tilting, PLACES)
    turn = rest + compliance * found.load[3:]
    np.testing.assert_allclose(found.load, tilting.load(turn), atol=SAME)
    assert found.stable and np.max(np.abs(compliance * found.load[3:])) > 0.01
    # As clamped where the base has turned to.
    clamped = hung(free()._replace(mount=rotation_matrix(turn) @ UPRIGHT), PLACES)
    np.testing.assert_allclose(found.position, clamped.position, atol=SAME)
    np.testing.assert_allclose(found.load[:3], clamped.load[:3], atol=SAME)


@pytest.mark.parametrize(("lightest", "masses"), [(7.8373, {"tip_mass": 0.0}), (2.4674, {"mass_per_length": 1e-9})])
def test_columns_buckle(lightest, masses):
    """Under their own weight at 7.8373 EI/L^2 (Greenhill 1881), and under that of a tip at pi^2 / 4 (Euler)."""
    of = {"mass_per_length": 1.0, "tip_mass": 1.0} | masses
    for share in (0.999, 1.001):
        found = hung(free((0.0, -share * lightest, 0.0), **of), PLACES)
        assert bool(found.stable) == (share < 1)


def test_columns_buckle_earlier_on_springs():
    """With the torsional stiffness EI/L, x tan x = 1 at x^2 = P L^2 / EI."""
    for share in (0.999, 1.001):
        gravity = 0.0, -share * 0.740174, 0.0
        found = hung(free(gravity, jnp.ones(3), mass_per_length=1e-9, tip_mass=1.0), PLACES)
        assert bool(found.stable) == (share < 1)


def test_the_load_has_derivatives_in_both_modes():
    def load(p):
        gravity, compliance, rest = (p[0], p[1], p[2]), jnp.stack([p[3], p[4], p[3]]), jnp.stack([p[5], p[4], p[5]])
        return hung(free(gravity, compliance, rest, mass_per_length=p[6], tip_mass=p[7]), PLACES).load

    p = jnp.array([0.3, -1.0, 0.4, 0.2, 0.1, 0.05, 1.0, 0.2])
    check_derivatives(load, p, seed=1, differences=DIFFERENCES, visible=1e-3, jit=True)
