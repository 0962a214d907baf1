"""Transitions of the march: margins, and where a scan right across the object ends."""

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._space.contact import FORCE, SLACK, UNKNOWNS
from jaxwhisker._space.free import Nearest
from jaxwhisker._space.stance import SpaceStance
from jaxwhisker._space.transitions import (
    AT_STOP,
    GRIP,
    LOSS,
    PASSED,
    PHASE,
    RELEASE,
    TOUCH,
    TOUCHING,
    margins_of,
)

FREE, TIP, TANGENTIAL = (int(phase) for phase in (Phase.free, Phase.tip, Phase.tangential))


def margins(phase, force=0.0, slack=0.0, distance=1.0, grip=None, onwards=0.5):
    z = jnp.zeros((1, UNKNOWNS)).at[0, FORCE].set(force).at[0, SLACK].set(slack)
    nearest, good = Nearest(jnp.array([distance]), z, jnp.array([TIP])), jnp.asarray(True)
    one, grip = jnp.asarray(1.0), None if grip is None else jnp.array([grip])
    stance = SpaceStance(jnp.array([phase == FREE]), nearest, jnp.array([distance]), one, good, one, good, grip, good)
    return np.asarray(margins_of(jnp.array([phase]), z, stance, jnp.asarray(0.25), jnp.asarray(onwards)))[:, 0]


def test_free_whiskers_may_only_touch():
    found = margins(FREE, distance=0.3)
    assert found[TOUCH] == 0.3 + TOUCHING and np.all(np.isinf(found[[RELEASE, PHASE]])) and found[AT_STOP] == 0.25


def test_contacts_end_without_force_and_change_their_phase_without_slack():
    tip, shaft = margins(TIP, force=2.0, slack=-0.1), margins(TANGENTIAL, force=2.0, slack=0.3)
    assert tip[RELEASE] == shaft[RELEASE] == 2.0
    assert tip[PHASE] == 0.1 and shaft[PHASE] == 0.3
    assert np.isinf(tip[TOUCH]) and np.isinf(shaft[TOUCH])


def test_only_contacts_with_friction_may_stick_or_slip():
    assert margins(TIP).size == 4
    assert margins(TIP, grip=0.2)[GRIP] == 0.2


def test_with_friction_stability_is_lost_where_the_drive_turns():
    assert margins(TIP, grip=0.2, onwards=0.1)[LOSS] == 0.1
    assert np.isinf(margins(FREE, grip=0.2, onwards=-0.1)[LOSS])


def test_a_default_scan_ends_shortly_after_the_release():
    scene = jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.2)), motion=jw.LinearDrive((-1.0, 0.0, 0.0)))
    result = jw.scan(scene)
    (release,) = result.events.of(jw.EventKind.release)
    assert 0 < float(result.control[-1]) - release.control < PASSED
