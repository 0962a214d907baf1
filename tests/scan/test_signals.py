"""Signals of exact contacts, their units, and the residual of what is no equilibrium."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from exact_contacts import contacts, fbfb_at
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._scan.signals import beyond_phase, signals
from jaxwhisker._scan.state import OPTIONAL

EXACT = 1e-10  # closed forms against closed forms; their moduli are found by bisection
PAIR = (1.3, 0.1)  # a tangential contact behind the vertex, a tip contact before it
LENGTH, BENDING_STIFFNESS = 0.05, 2.4e-5
FORCE = BENDING_STIFFNESS / LENGTH**2

of_contacts = Program(signals)


def in_si(scene):
    """The same scene in SI units."""
    springs = tuple(
        jw.Spring(s.between, float(s.stiffness) * FORCE / LENGTH, float(s.rest_length) * LENGTH)
        for s in scene.support.springs
    )
    profile = jw.Parabola(float(scene.profile.distance) * LENGTH, 1 / LENGTH)
    return jw.Scene(jw.Whisker(LENGTH, BENDING_STIFFNESS), profile, jw.Support(springs), scene.rod)


@pytest.fixture(scope="module")
def at():
    return contacts(*PAIR)


@pytest.fixture(scope="module")
def judge(at):
    """State and residual of these contacts, some of them changed."""
    problem = dimensionless(fbfb_at(*PAIR))

    def judge(z=at.z, u=0.0, phase=at.phase):
        state = ContactState(jnp.asarray(phase), jnp.ones(2))
        return of_contacts(problem, jnp.asarray(z), jnp.asarray(u), state)

    return judge


def test_signals_of_exact_contacts(at, judge):
    state, residual, _ = judge()
    assert residual < EXACT
    slope = at.z[:, 1]
    arc = np.where(at.phase == Phase.tip, 1.0, 1 - at.z[:, 2])
    expected = {
        "base_x": at.base_x,
        "base_y": 0.0,
        "base_angle": 0.0,
        "fx": -at.force_x,
        "fy": at.z[:, 0] * np.cos(slope),
        "mz": at.mz,
        "contact_force": at.z[:, 0],
        "contact_slope": slope,
        "contact_arc": arc,
        "contact_x": np.tan(slope) / 2,
        "contact_y": 0.2 + np.tan(slope) ** 2 / 4,
        "phase": at.phase,
    }
    assert set(expected) == set(jw.State.__dataclass_fields__) - set(OPTIONAL)
    for name, value in expected.items():
        np.testing.assert_allclose(getattr(state, name), value, rtol=EXACT, atol=EXACT, err_msg=name)


def test_signals_have_the_units_of_the_scene(at, judge):
    plain, *_ = judge()
    state = ContactState(jnp.asarray(at.phase), jnp.ones(2))
    state, residual, _ = of_contacts(dimensionless(in_si(fbfb_at(*PAIR))), jnp.asarray(at.z), jnp.asarray(0.0), state)
    assert residual < EXACT
    lengths = ("base_x", "base_y", "contact_arc", "contact_x", "contact_y")
    sizes = {
        **dict.fromkeys(lengths, LENGTH),
        **dict.fromkeys(("fx", "fy", "contact_force"), FORCE),
        "mz": FORCE * LENGTH,
    }
    for name in set(jw.State.__dataclass_fields__) - set(OPTIONAL):
        size = sizes.get(name, 1.0)
        np.testing.assert_allclose(
            getattr(state, name) / size, getattr(plain, name), rtol=EXACT, atol=EXACT, err_msg=name
        )


def test_a_free_whisker_has_no_signals_and_hangs_on_its_spring(at, judge):
    z = np.where(np.arange(2)[:, None] == 1, 0.0, at.z)
    state, *_ = judge(z, phase=np.array([at.phase[0], 0]))
    for name in ("fx", "fy", "mz", "contact_force", "contact_slope", "contact_arc", "contact_x", "contact_y"):
        assert getattr(state, name)[1] == 0, name
        assert getattr(state, name)[0] != 0, name
    # Without its load both springs carry what is left, that of the first whisker.
    moved = at.force_x[1] * np.array([1 / 70.0, 1 / 70.0 + 1 / 40.0])
    np.testing.assert_allclose(state.base_x[1], at.base_x[1] - moved[1], atol=EXACT)


@pytest.mark.parametrize(
    ("change", "residual"),
    [
        ({"u": 0.01}, 0.01 / 1.01),  # relative to the drive's position
        ({"phase": np.array([2, 2])}, None),  # tip contact taken for tangential contact: the slack has the wrong sign
        ({"phase": np.array([1, 1])}, None),
    ],
    ids=["control", "tangential", "tip"],
)
def test_what_is_no_equilibrium_has_a_residual(judge, change, residual):
    _, found, _ = judge(**change)
    if residual is None:
        assert found > 1e-2
    else:
        np.testing.assert_allclose(found, residual, rtol=1e-9)


def test_the_object_only_pushes():
    # A contact that has just begun: a small force either way bends the whisker by less than the force itself.
    pair, force = (1.3, 1e-9), 1e-3
    at, problem = contacts(*pair), dimensionless(fbfb_at(*pair))
    state = ContactState(jnp.asarray(at.phase), jnp.ones(2))
    pushing, pulling = (
        of_contacts(problem, jnp.asarray(at.z).at[1, 0].set(sign * force), jnp.asarray(0.0), state)[1]
        for sign in (1.0, -1.0)
    )
    assert pushing < 0.9 * force
    assert pulling == force


def test_the_slack_has_the_sign_of_its_phase():
    phase = jnp.array([Phase.tip, Phase.tip, Phase.tangential, Phase.tangential, Phase.tip])
    force, slack = jnp.array([1.0, 1.0, 1.0, 1.0, -0.3]), jnp.array([-0.1, 0.1, 0.1, -0.2, -0.4])
    np.testing.assert_allclose(beyond_phase(phase, force, slack), [-0.1, 0.1, -0.1, 0.2, 0.3])
