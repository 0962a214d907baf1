"""What follows where whiskers in space with several contacts lose their stability."""

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
import pegs
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._space_chain.flow import _freed
from pegs_engine import problem


def test_contacts_slide_to_an_equilibrium_at_the_same_control():
    events = pegs.scan(pegs.TILTED).events
    kinds = [jw.EventKind(int(kind)) for kind in events.kind[: int(events.count)]]
    snap = kinds.index(jw.EventKind.snap_through)
    slid = np.hypot(
        *(
            np.asarray(getattr(events.after, name) - getattr(events.before, name))[snap, 0, 0]
            for name in ("contact_x", "contact_z")
        )
    )
    assert slid > 0.05
    assert np.sum(np.asarray(events.after.phase)[snap, 0] != Phase.free) == 1
    # The contact settles in an equilibrium, which the laws of states check.
    assert np.isfinite(events.after.fx[snap, 0])


def test_whiskers_that_lose_their_last_contact_come_free():
    one, two, none = jnp.array([2, 0]), jnp.array([2, 2]), jnp.array([0, 0])
    assert [bool(_freed(problem(), *pair)[0]) for pair in ((one, none), (two, one), (none, none))] == [
        True,
        False,
        False,
    ]
