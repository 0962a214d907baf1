"""Slips where a path leaves an event: which one is changed first, first leans, and what must grow on the way on."""

from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._equilibrium.friction import LIGHT
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._path.slips import LEAN_NOISE, RATE_NOISE, LeavingContacts, corrected_slips, first_leans, lead_of

LIMIT = 0.3
ROUNDING = 1e-14
OF_LEAN = jnp.array([[False, True, False], [False, False, True]])  # the second contact is at a corner


def corrected(slip, *, tried=0, rests=(False, False), falls=False, limit=LIMIT, **motion: Any):
    """Whether a contact breaks a law, and the slips after that."""
    slip = jnp.array(slip)
    usual = {
        "force": [1.0, 1.0],
        "lean": [0.1, -0.1],
        "lean_rate": [0.0, 0.0],
        "slip_rate": [1.0, 1.0],
        "sticks": slip == 0,
        "slips_either_way": [True, True],
        "light": [False, False],
    }
    contacts = LeavingContacts(slip, *(jnp.asarray(motion.get(name, value)) for name, value in usual.items()))
    wrong, slips = corrected_slips(
        contacts, jnp.asarray(limit), jnp.asarray(falls), jnp.asarray(tried), jnp.array(rests)
    )
    return bool(wrong), slips.tolist()


def test_the_first_contact_that_breaks_a_law_is_changed():
    assert corrected((1, -1)) == (False, [1, -1])
    assert corrected((1, -1), slip_rate=[-2 * RATE_NOISE, -1.0]) == (True, [0, -1])
    assert corrected((1, -1), slip_rate=[-RATE_NOISE / 2, -1.0]) == (True, [1, 0])
    leans: dict[str, Any] = {"lean": [LIMIT, -LIMIT], "lean_rate": [1.0, -1.0]}
    assert corrected((0, 0), **leans) == (True, [1, 0])
    assert corrected((0, 0), **leans, rests=(True, False)) == (True, [0, -1])
    assert corrected((0, 0), lean=[LIMIT, -LIMIT], lean_rate=[-1.0, 1.0]) == (False, [0, 0])
    # Without friction nothing sticks.
    assert corrected((1, -1), slip_rate=[-1.0, 1.0], limit=0.0) == (True, [-1, -1])


def test_a_contact_without_force_may_slip_either_way_but_a_tip_in_an_inner_corner_may_not():
    new: dict[str, Any] = {"force": [LIGHT / 2, 1.0]}
    assert corrected((-1, 1), **new, falls=True) == (True, [1, 1])
    assert corrected((-1, 1), **new, falls=True, slips_either_way=[False, True]) == (False, [-1, 1])
    assert corrected((-1, 1), **new, slip_rate=[-1.0, 1.0], tried=1) == (True, [0, 1])


@pytest.mark.parametrize(("light", "slips"), [(True, [1, 0]), (False, [0, 0])])
def test_a_contact_that_sticks_from_its_first_touch_has_a_lean_that_friction_allows(light, slips):
    beyond = LIMIT + 2 * LEAN_NOISE
    assert corrected((0, 0), lean=[beyond, 0.0], light=[light, False]) == (light, slips)


def test_the_first_lean_combines_paths_with_both_slips():
    # Along the present path, which slips towards -x, and along that tried before, towards +x: forces and rates of slip.
    force, other_force, rate, other_rate = 0.8, 0.5, 0.2, -0.3
    tangent, other = (
        Point(jnp.zeros((2, 3)).at[:, 0].set(f).at[:, 1].set(r / 0.5), jnp.asarray(-1.0))
        for f, r in ((force, rate), (other_force, other_rate))
    )
    by_contact = jnp.zeros((2, 3)).at[:, 1].set(0.5)
    known, leans = first_leans(by_contact, jnp.array([-1, 1]), jnp.asarray(LIMIT), jnp.asarray(-1.0), tangent, other)
    # Of both forces, of which each leans by the limit, in the proportion in which the contact does not slip.
    share = -rate / other_rate
    for k, slip in enumerate((-1, 1)):
        across = slip * np.sin(LIMIT) * (force - share * other_force)
        along = np.cos(LIMIT) * (force + share * other_force)
        assert known[k]
        np.testing.assert_allclose(leans[k], np.arctan2(across, along), rtol=ROUNDING)
    assert np.all(np.abs(leans) < LIMIT)


def test_what_must_grow_where_slips_change():
    arriving = Point(jnp.arange(1.0, 7.0).reshape(2, 3), jnp.asarray(-2.0))
    by_contact = jnp.array([[0.0, 0.5, 1.0], [0.0, 0.25, -1.0]])

    def lead(slip, *, changes=(True, True), light=(False, False), rest=False):
        march = SimpleNamespace(
            state=SimpleNamespace(friction=SimpleNamespace(slip=jnp.array(slip))),
            pending=SimpleNamespace(arriving=arriving),
        )
        return lead_of(march, jnp.array(changes), jnp.array([1, -1]), jnp.array(light), OF_LEAN, by_contact, rest=rest)

    # Contacts that begin to slip slip on; leans of those that stick move back from their limits.
    np.testing.assert_array_equal(lead((-1, 1)).z, [[0, -0.5, -1], [0, 0.25, -1]])
    np.testing.assert_array_equal(lead((0, 0)).z, [[0, -1, 0], [0, 0, 1]])
    # Where the force is too small for its lean to be known, the force grows.
    np.testing.assert_array_equal(lead((0, 0), light=(True, False)).z, [[1, 0, 0], [0, 0, 1]])
    np.testing.assert_array_equal(lead((0, 0), changes=(False, True)).z, [[0, 0, 0], [0, 0, 1]])
    assert lead((0, 0)).u == 0
    # Slips that come to rest keep their lean at first; all else goes on as before.
    rests = lead((0, -1), changes=(True, False), rest=True)
    np.testing.assert_array_equal(rests.z, arriving.z.at[0, 1].set(0.0))
    assert rests.u == arriving.u
