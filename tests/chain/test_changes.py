"""Changes: what contacts become where a margin vanishes."""

# pyright: reportArgumentType=false, reportOptionalMemberAccess=false
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._chain.changes import KINDS, changed_contacts
from jaxwhisker._chain.march_state import AT_STOP, HIGH, LEAN, LOW, PHASE, RELEASE, TOUCH
from jaxwhisker._equilibrium.contact import PARAMETER, SLACK, Phase
from jaxwhisker._path.path import STOP, EventKind
from several_engine import march_at, problem, trial_at, with_contacts


def changed(number, rows, limit=0.0):
    known = with_contacts(2)
    march = march_at(known)
    target = march.target._replace(
        number=jnp.asarray(number), whiskers=jnp.array(rows), limit=jnp.full(known.state.phase.shape, limit)
    )
    march = march.replace(target=target)
    return known, changed_contacts(problem(), march, trial_at(march, known.z))


def test_every_margin_has_its_kind_of_event():
    assert sorted(KINDS) == [TOUCH, RELEASE, PHASE, LOW, HIGH, LEAN, AT_STOP]
    assert KINDS[AT_STOP] == STOP and KINDS[LEAN] == EventKind.slip


def test_a_released_contact_is_gone():
    known, (z, state, kind) = changed(RELEASE, [True, False])
    assert int(kind) == EventKind.release
    np.testing.assert_array_equal(z[0], known.z[1])
    assert state.phase.tolist() == [int(known.state.phase[1]), Phase.free]


@pytest.mark.parametrize("phase", [Phase.tangential, Phase.tip])
def test_a_contact_changes_its_phase_with_no_slack(phase):
    known = with_contacts(2)
    state = known.state._replace(phase=known.state.phase.at[0].set(int(phase)))
    march = march_at(known._replace(state=state))
    target = march.target._replace(
        number=jnp.asarray(PHASE), whiskers=jnp.array([True, False]), limit=jnp.zeros(state.phase.shape)
    )
    march = march.replace(target=target)
    z, after, kind = changed_contacts(problem(), march, trial_at(march, known.z))
    tip = phase == Phase.tip
    assert int(kind) == (EventKind.tip_to_tangential if tip else EventKind.tangential_to_tip)
    assert int(after.phase[0]) == (Phase.tangential if tip else Phase.tip)
    assert float(z[0, SLACK]) == 0 and float(z[0, PARAMETER]) == float(known.z[0, PARAMETER])
