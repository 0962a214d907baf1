"""Free whiskers bent by springs on their shafts: arcs between torsion springs, and a rod integrated from the spring."""

# pyright: reportArgumentType=false, reportCallIssue=false
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from independent_shaft import along

import jaxwhisker as jw
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium import bent
from jaxwhisker._equilibrium.contact import Sprung, WhiskerAtObject
from jaxwhisker._equilibrium.shaft_springs import AXIAL, Attachments, ShaftSprings
from jaxwhisker._equilibrium.touch import POINTS
from jaxwhisker._model.motion import Frame
from shafts import points

ROUNDING = 1e-13
SOLVED = 1e-9  # of the rods' steps, and of the contact
LENGTH, AT = 1.2, np.array([0.7, 0.3, 0.0])  # springs from the tip to the base
S = np.linspace(0.0, LENGTH, POINTS)
PHI = 2  # axis of torsion springs
DRIVE, MOUNT = (0.1, -0.2, 0.3), (0.16, -0.17, 0.15)  # position and angle in the scene; the mount is that of the base
BEFORE, POSE = np.array([0.05, -0.02, 0.1]), np.array([0.2, 0.03, -0.25])  # of the base, from its mount


def in_scene(frame, pose):
    """Position and direction in the scene of what has a pose (x, y, angle to the upright) in a frame."""
    (x, y, angle), (right, up, turn) = frame, pose
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([x + right * cos - up * sin, y + right * sin + up * cos, np.pi / 2 + angle + turn])


def in_frame(frame, state):
    """Its inverse."""
    x, y, angle = frame
    right, up, cos, sin = state[0] - x, state[1] - y, np.cos(angle), np.sin(angle)
    return np.array([right * cos + up * sin, up * cos - right * sin, state[2] - np.pi / 2 - angle])


def springs(axis, stiffness, rest_length=0.0, anchor=(0.0, 0.0, 0.0)):
    each = AT, *anchor, stiffness, rest_length, axis, 0.0, 0, 1.0
    return ShaftSprings(*(jnp.asarray(np.broadcast_to(value, AT.shape)) for value in each))


@Program
def solved(body, unloaded, moved, pose):
    """Contact of the free whisker, its derivative by the pose of the base, and the outline."""
    contact, change = jax.jvp(lambda pose: bent.free_contact(body, unloaded, moved, pose), (pose,), (jnp.ones(3),))
    return contact, change, bent.outline_of(body, contact)


def free(held_by, bending_stiffness, unloaded, moved, pose, friction_angle=None):
    """The free whisker."""
    drive, mount = (Frame(*map(jnp.asarray, (x, y, np.cos(turn), np.sin(turn)))) for x, y, turn in (DRIVE, MOUNT))
    still = jax.tree.map(jnp.zeros_like, drive)
    held = Sprung(Attachments(held_by), drive, still, jnp.zeros((3, 3)), jnp.zeros(3), jnp.asarray(0.0))
    numbers = jnp.asarray(LENGTH), jnp.asarray(bending_stiffness)
    body = WhiskerAtObject(*numbers, jw.Parabola(0.2), jw.Shooting(), None, mount, still, friction_angle, sprung=held)
    return solved(body, *map(jnp.asarray, (unloaded, moved, pose)))


def check(found, x, y, phi):
    """Compare with positions and directions of the whisker, in the scene, at arc lengths S."""
    contact, change, outline = found
    np.testing.assert_allclose(contact, in_frame(DRIVE, (x[-1], y[-1], phi[-1])), rtol=0, atol=SOLVED)
    np.testing.assert_array_equal(change, 0.0)
    # The outline is that of the whisker with its base upright at the origin.
    right, up, turn = in_frame((x[0], y[0], phi[0] - np.pi / 2), (x, y, phi))
    np.testing.assert_allclose([outline.x, outline.y], [right, up], rtol=0, atol=SOLVED)
    np.testing.assert_allclose([outline.cos, outline.sin], [-np.sin(turn), np.cos(turn)], rtol=0, atol=SOLVED)


def arcs(pose, stiffness, rest_length, bending_stiffness):
    """The whisker with torsion springs: arcs of constant curvature between them, and straight above."""
    state, (upper, lower, _) = in_scene(MOUNT, pose), AT
    # Below each spring, the moment is that of all springs above. The angles at the upper and the lower spring are that
    # of the base and, of the curvatures above and below the lower spring, this matrix times these.
    turned = np.array([[upper - lower, lower], [0.0, lower]])
    moments = np.array([[1.0, 0.0], [1.0, 1.0]]) * stiffness[:2]
    ahead = np.pi / 2 + DRIVE[2] + rest_length[:2] - state[2]
    above, below = np.linalg.solve(bending_stiffness * np.eye(2) + moments @ turned, moments @ ahead)
    whisker = np.zeros((3, S.size))
    for start, stop, curvature in ((0.0, lower, below), (lower, upper, above), (upper, LENGTH, 0.0)):
        whisker = np.where(start <= S, points(*state, curvature, S - start), whisker)
        state = points(*state, curvature, stop - start)
    return whisker


STIFFNESS, REST_LENGTH, BENDING = np.array([4.0, 2.5, 7.0]), np.array([-0.6, 0.8, 0.3]), 1.6


@pytest.mark.parametrize("stiffness", [STIFFNESS, 0 * STIFFNESS], ids=["stiff", "without stiffness"])
def test_torsion_springs_bend_a_whisker_into_arcs(stiffness):
    before, exact = (arcs(pose, stiffness, REST_LENGTH, BENDING) for pose in (BEFORE, POSE))
    unloaded = in_frame(DRIVE, before[:, -1])
    check(free(springs(PHI, stiffness, REST_LENGTH), BENDING, unloaded, POSE - BEFORE, POSE), *exact)


def test_the_force_of_an_axial_spring_bends_the_shaft_below_it():
    # The rod is integrated from the spring down: its base is where it arrives. The anchor is in the force's direction.
    end, force, stiffness, rest_length = np.array([0.1, 0.5, 1.9]), np.array([1.0, 0.4]), 5.0, 0.1
    moment, size = end[0] * force[1] - end[1] * force[0], np.hypot(*force)
    shaft = along(end[:, None] + 0 * S, np.array([*force, moment])[:, None], S - AT[0])
    exact = np.where(AT[0] <= S, points(*end, 0.0, S - AT[0]), shaft)
    anchor = in_frame(DRIVE, (*(end[:2] + (rest_length + size / stiffness) * force / size), 0.0))
    held_by = springs(AXIAL, np.array([stiffness, 0.0, 0.0]), rest_length, anchor)
    x, y, phi = exact[:, 0]
    straight = in_frame(DRIVE, points(x, y, phi, 0.0, LENGTH))
    check(free(held_by, 1.0, straight, np.zeros(3), in_frame(MOUNT, exact[:, 0])), *exact)


def test_friction_changes_no_free_whisker():
    exact = arcs(POSE, STIFFNESS, REST_LENGTH, BENDING)
    held_by, tip = springs(PHI, STIFFNESS, REST_LENGTH), in_frame(DRIVE, exact[:, -1])
    check(free(held_by, BENDING, tip, np.zeros(3), POSE, jnp.asarray(0.2)), *exact)
