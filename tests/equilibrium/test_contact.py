"""One whisker in contact: exact states, balance, symmetry, both phases, the base's frame."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from exact_contacts import DISTANCE, contacts
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium import contact
from jaxwhisker._equilibrium.contact import Phase, WhiskerAtObject, of_each
from jaxwhisker._model.motion import Frame
from jaxwhisker._rod.elastica import AbstractRod, ClosedForm, Shooting
from jaxwhisker._rod.rod import Section

EXACT = 1e-10  # closed forms against closed forms; their moduli are found by bisection
BALANCE = 1e-14  # one product against a sum of two
SHOOTING = 1e-9  # promised of the integrated rod, in position and direction
DIFFERENCE = 1e-7  # relative, of central differences with step STEP
STEP = 1e-5

PARABOLA, CLOSED = jw.Parabola(DISTANCE), ClosedForm()
P = (
    0.05,
    0.25,
    0.6,
    1.4,
    2.5,
)  # along the clamped branch: tip, tangential and tip contacts, before and behind the vertex
TIP, TANGENTIAL = jnp.asarray(int(Phase.tip)), jnp.asarray(int(Phase.tangential))

VALUES = contact.Base._fields[:-2]  # the last two are None without springs on the shaft


def body(rod: AbstractRod = CLOSED, position=0.0):
    one = jnp.asarray(1.0)
    return WhiskerAtObject(one, one, jw.Parabola(DISTANCE, 1.0, jnp.asarray(position)), rod)


@Program
def bases(body, z, phase, side):
    """Bases of many contacts of one whisker."""
    return jax.vmap(lambda *own: contact.base(body, *own))(z, phase, side)


@pytest.fixture(scope="module")
def exactly():
    return contacts(*P)


@pytest.fixture(scope="module")
def ours(exactly):
    return bases(body(), jnp.asarray(exactly.z), jnp.asarray(exactly.phase), jnp.ones(len(P)))


def test_exact_contacts_have_their_bases_upright_where_they_are(exactly, ours):
    assert {int(phase) for phase in exactly.phase} == {Phase.tip, Phase.tangential}
    np.testing.assert_allclose(ours.x, exactly.base_x, atol=EXACT)
    for name, value in (("y", 0.0), ("cos", 0.0), ("sin", 1.0)):
        np.testing.assert_allclose(getattr(ours, name), value, atol=EXACT)
    np.testing.assert_allclose(ours.force_x, exactly.force_x, rtol=EXACT)
    np.testing.assert_allclose(-ours.bend, exactly.mz, rtol=EXACT)


def test_the_moment_at_the_base_is_that_of_the_contact_force(ours):
    arm_x, arm_y = ours.contact_x - ours.x, ours.contact_y - ours.y
    moment = arm_x * ours.force_y - arm_y * ours.force_x
    np.testing.assert_allclose(ours.bend, moment, atol=BALANCE * 100)  # forces up to 20


def test_the_contact_force_is_normal_to_the_object(exactly, ours):
    force, slope = exactly.z[:, 0], exactly.z[:, 1]
    np.testing.assert_allclose(np.hypot(ours.force_x, ours.force_y), force, rtol=BALANCE)
    np.testing.assert_allclose(ours.force_x * np.cos(slope) + ours.force_y * np.sin(slope), 0.0, atol=BALANCE * 100)
    assert np.all(ours.force_y < 0)  # the object lies above
    np.testing.assert_allclose(ours.contact_y, DISTANCE + ours.contact_x**2, rtol=BALANCE)


def test_a_whisker_on_the_far_side_is_the_mirror_image(exactly):
    z, phase, one = jnp.asarray(exactly.z), jnp.asarray(exactly.phase), jnp.ones(len(P))
    right = bases(body(position=0.3), z, phase, one)
    left = bases(body(position=-0.3), z * jnp.array([1.0, -1.0, 1.0]), phase, -one)
    odd = {"x", "cos", "force_x", "bend", "slope_sin", "contact_x"}
    for name in VALUES:
        sign = -1.0 if name in odd else 1.0
        np.testing.assert_allclose(getattr(left, name), sign * getattr(right, name), atol=EXACT, err_msg=name)


def test_closed_form_and_integrated_rod_agree(exactly, ours):
    shot = bases(body(Shooting()), jnp.asarray(exactly.z), jnp.asarray(exactly.phase), jnp.ones(len(P)))
    for name in VALUES:
        size = max(1.0, float(np.max(np.abs(getattr(ours, name)))))
        np.testing.assert_allclose(getattr(shot, name), getattr(ours, name), atol=SHOOTING * size, err_msg=name)


def test_both_phases_meet_at_zero_slack():
    z, phases = jnp.array([[1.07, 0.9, 0.0], [1.07, 0.9, 0.0]]), jnp.stack([TIP, TANGENTIAL])
    both = bases(body(), z, phases, jnp.ones(2))
    for values in both[: len(VALUES)]:
        assert values[0] == values[1]
    # On its two sides slack is an angle and an arc length: the same force then bends other whiskers.
    beyond = bases(body(), z.at[:, 2].set([-0.1, 0.1]), phases, jnp.ones(2))
    assert abs(beyond.x[0] - beyond.x[1]) > 1e-3
    assert contact.arc(body(), jnp.asarray(0.1), TANGENTIAL) == 0.9
    assert contact.arc(body(), jnp.asarray(-0.1), TIP) == 1.0


def frame_at(u):
    """A frame that moves and turns."""
    return Frame(0.8 * u, 0.1 + 0.3 * u, jnp.cos(0.2 + 0.5 * u), jnp.sin(0.2 + 0.5 * u))


def test_a_base_in_its_frame(ours):
    one = jax.tree.map(lambda leaf: leaf[0], ours)
    frame = frame_at(0.4)
    inside = contact.in_base_frame(body()._replace(frame=frame), one)
    assert inside.force_y is not None and inside.moment is not None
    # Lengths do not depend on the frame; the upright whisker is turned back by the frame's angle.
    np.testing.assert_allclose(np.hypot(inside.x, inside.y), np.hypot(one.x - frame.x, one.y - frame.y), rtol=EXACT)
    np.testing.assert_allclose(np.hypot(inside.force_x, inside.force_y), np.hypot(one.force_x, one.force_y), rtol=EXACT)
    assert abs(inside.turn + 0.4) < EXACT
    back = (
        inside.x * frame.cos - inside.y * frame.sin + frame.x,
        inside.force_x * frame.sin + inside.force_y * frame.cos,
    )
    np.testing.assert_allclose(back, (one.x, one.force_y), atol=EXACT)
    assert inside.moment == one.bend and inside.slope_sin == one.slope_sin
    upright = contact.in_base_frame(body(), one)
    assert upright.force_y is None and upright.moment is None
    assert (upright.x, upright.y, upright.turn) == (one.x, one.y, -one.cos)


def test_gradients_are_those_of_central_differences(exactly):
    _, rate = jax.jvp(frame_at, (0.4,), (1.0,))
    z, rod = jnp.asarray(exactly.z[1]), CLOSED
    phase = jnp.asarray(exactly.phase[1])

    @Program
    def equations(z, u):
        return contact.equations(body()._replace(frame=frame_at(u)), z, phase, 1.0)

    here = body()._replace(frame=frame_at(0.4), frame_rate=rate)
    value, gradient, by_control, _ = Program(lambda z: contact.linearise(here, z, phase, 1.0, rates=rod))(z)
    steps = [(STEP * e, 0.0) for e in jnp.eye(3)] + [(jnp.zeros(3), STEP)]
    differences = [
        jax.tree.map(lambda a, b: (a - b) / (2 * STEP), equations(z + dz, 0.4 + du), equations(z - dz, 0.4 - du))
        for dz, du in steps
    ]
    for name in value._fields[:-1]:  # without springs on the shaft, there are no places
        np.testing.assert_allclose(getattr(value, name), getattr(equations(z, 0.4), name), rtol=EXACT, atol=EXACT)
        expected = [getattr(difference, name) for difference in differences]
        size = DIFFERENCE * (1 + np.max(np.abs(expected)))
        np.testing.assert_allclose(getattr(gradient, name), expected[:3], atol=size, err_msg=name)
        np.testing.assert_allclose(getattr(by_control, name), expected[3], atol=size, err_msg=name)
    upright = jax.eval_shape(lambda z: contact.linearise(body(), z, phase, 1.0, rates=rod), z)
    assert upright.by_u is None  # along x there is no frame to move


def test_whiskers_of_different_kinds_are_computed_one_by_one(exactly):
    one = jnp.asarray(1.0)
    section = Section(1.0, 0.3, one, one, one)
    stacked = jax.tree.map(lambda leaf: jnp.stack([jnp.asarray(leaf)] * 2), section)
    bodies = WhiskerAtObject(jnp.array([1.0, 0.9]), jnp.ones(2), PARABOLA, Shooting(4), stacked)
    args = jnp.asarray(exactly.z[:2]), jnp.asarray(exactly.phase[:2]), jnp.array([1.0, -1.0])
    batch = Program(lambda bodies, *args: of_each(bodies, contact.base, *args))
    together, apart = batch(bodies, *args), batch(bodies._replace(section=(section, section)), *args)
    for name in VALUES:
        np.testing.assert_allclose(getattr(apart, name), getattr(together, name), atol=EXACT, err_msg=name)
    # On the far side, the whisker is the mirror image of one that is curved the other way.
    straightened = bodies._replace(section=(section, Section(1.0, -0.3, one, one, one)))
    mirrored = batch(straightened, args[0].at[1, 1].multiply(-1.0), args[1], jnp.ones(2))
    assert abs(mirrored.x[1] + apart.x[1]) < EXACT
    assert abs(mirrored.bend[1] + apart.bend[1]) < EXACT
