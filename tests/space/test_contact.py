"""One whisker in contact: its base by an independent rod, frames, tractions."""

# pyright: reportArgumentType=false, reportCallIssue=false

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rod_in_space

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._space.contact import GRAZING, LIGHT, SpaceWhisker, Traction, base_of, frame_of, on_surface, spread

EXACT = 1e-10  # of the rod, which is integrated to 1e-12
CENTRE, RADIUS = np.array([0.0, 1.3, 0.2]), 1.0
TIP, TANGENTIAL = jnp.asarray(int(Phase.tip)), jnp.asarray(int(Phase.tangential))
FORCES = Traction(None, jnp.asarray(True))  # tractions are forces


def problem(**whisker):
    scene = jw.SpaceScene(jw.Whisker(**whisker), jw.Sphere(RADIUS, tuple(map(float, CENTRE))))
    return dimensionless(scene)


def body(of):
    """The only whisker of a problem."""
    return jax.tree.map(lambda leaf: leaf[0], SpaceWhisker(of.length, of.bending_stiffness, of.section, of.mount))


STRAIGHT, CURVED = problem(), problem(intrinsic_curvature=0.7, twist=0.4, torsion_ratio=0.8)


def contact(slack, force=1.4, roll=0.0, traction=(0.0, 0.0)):
    """A contact on the sphere, with a direction across its normal."""
    out = np.array([0.6, -0.7, 0.2]) / np.linalg.norm([0.6, -0.7, 0.2])
    ahead = np.cross(out, [0.3, 0.2, 0.9])
    return jnp.array([force, roll, slack, *(CENTRE + RADIUS * out), *(ahead / np.linalg.norm(ahead)), *traction])


def directors(z, chi, roll):
    """The body frame at the contact: tangent towards the tip, at the angle chi into the object."""
    ahead, across, out = np.asarray(frame_of(STRAIGHT.surface, z)).T
    tangent = np.cos(chi) * ahead - np.sin(chi) * out
    first = np.cos(roll) * np.cross(across, tangent) + np.sin(roll) * across
    return np.stack([first, np.cross(tangent, first), tangent], axis=1)


@pytest.mark.parametrize(("slack", "phase"), [(-0.3, TIP), (0.25, TANGENTIAL)])
@pytest.mark.parametrize(("of", "roll", "traction"), [(CURVED, 0.8, (0.0, 0.0)), (CURVED, 0.8, (0.3, -0.5))])
def test_the_base_is_that_of_an_independent_rod(of, roll, slack, phase, traction):
    z = contact(slack, roll=roll, traction=traction)
    base = base_of(body(of), of.surface, of.rod, z, phase, FORCES)
    ahead, across, out = np.asarray(frame_of(of.surface, z)).T
    force = 1.4 * out + traction[0] * ahead + traction[1] * across
    arc = 1.0 - max(slack, 0.0)
    start = directors(z, max(-slack, 0.0), roll)
    r, rotation = rod_in_space.end(force, arc, start, lambda s: 1.0, 0.8, lambda s: np.array([0.0, -0.7, 0.4]))
    np.testing.assert_allclose(base.position, np.asarray(z[3:6]) + r, atol=EXACT)
    np.testing.assert_allclose(base.rotation, rotation, atol=EXACT)
    np.testing.assert_allclose(base.force, force, atol=EXACT)
    np.testing.assert_allclose(base.moment, np.cross(-r, force), atol=EXACT)


def test_straight_whiskers_are_computed_in_their_plane():
    z = contact(-0.2)
    base = base_of(body(STRAIGHT), STRAIGHT.surface, STRAIGHT.rod, z, TIP, None)
    force = 1.4 * np.asarray(frame_of(STRAIGHT.surface, z))[:, 2]
    r, rotation = rod_in_space.end(force, 1.0, directors(z, 0.2, 0.0), lambda s: 1.0, 0.7, lambda s: np.zeros(3))
    assert base.rotation is None
    np.testing.assert_allclose(base.position, np.asarray(z[3:6]) + r, atol=EXACT)
    np.testing.assert_allclose(base.tangent, rotation[:, 2], atol=EXACT)


def test_a_contact_whose_normal_force_vanishes_keeps_its_traction():
    """Whiskers that slide come free where their normal force vanishes, however large the traction is."""
    sides = [
        base_of(body(STRAIGHT), STRAIGHT.surface, STRAIGHT.rod, contact(-0.3, f, traction=(0.2, 1.5)), TIP, FORCES)
        for f in (0.99 * LIGHT, 1.01 * LIGHT, -LIGHT)
    ]
    for base in sides[1:]:
        np.testing.assert_allclose(base.position, sides[0].position, atol=10 * LIGHT)
        np.testing.assert_allclose(np.linalg.norm(base.force), np.hypot(0.2, 1.5), atol=10 * LIGHT)


def test_points_of_the_surface_and_directions_across_its_normal_have_no_residual():
    z = contact(-0.3)
    np.testing.assert_allclose(on_surface(STRAIGHT.surface, z), 0.0, atol=1e-14)
    assert abs(on_surface(STRAIGHT.surface, z.at[4].add(0.1))[0]) > 0.01
    assert abs(on_surface(STRAIGHT.surface, z.at[6].add(0.1))[2]) > 0.01


def test_a_straight_shaft_parts_from_a_sphere_as_its_curvature_says_and_a_tip_at_once():
    # A tip that hardly points into the object counts as the end of a tangential shaft.
    for slack, phase in ((0.2, TANGENTIAL), (-0.5 * GRAZING, TIP)):
        np.testing.assert_allclose(spread(body(STRAIGHT), STRAIGHT.surface, contact(slack), phase), 1 / RADIUS)
    assert spread(body(STRAIGHT), STRAIGHT.surface, contact(-0.2), TIP) == np.inf


def test_a_shaft_that_curves_towards_the_object_more_than_it_touches_it_twice():
    bent = problem(intrinsic_curvature=1.5)
    spreads = [float(spread(body(bent), bent.surface, contact(0.2, roll=roll), TANGENTIAL)) for roll in (0.0, np.pi)]
    np.testing.assert_allclose(sorted(spreads), [1.0 - 1.5, 1.0 + 1.5])
