"""Moments, followers, distributed loads and weight in space: scipy, the plane, circles, columns, derivatives."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rod_by_collocation
from scipy.optimize import root

import jaxwhisker as jw
from functions import Linear

SCIPY = 1e-8  # of the collocation method and of deflections
PLANE = 1e-12  # two ways to compute the same, relative to values of about 1
EXACT = 1e-11  # rods with solutions in closed form
NEAR = 1e-3  # share by which loads are below or above those of buckling
SLOPE = 1e-6  # of central differences of solutions that are solved to 1e-10
MODES = 1e-10  # forward against reverse


class Cone(eqx.Module):
    """Bending stiffness of a cone."""

    taper: jax.Array | float

    def __call__(self, s):
        return (1 - self.taper * s) ** 4


class Growing(eqx.Module):
    """A load per length that grows with the square of the arc length."""

    rate: jax.Array | float

    def __call__(self, s):
        return self.rate * s**2


GENERAL = jw.Whisker(1.0, Cone(0.3), 0.6, torsion_ratio=0.7, lateral_curvature=0.4, twist=1.5)
UPRIGHT = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # [d1 d2 d3] at the base
FORCE, MOMENT = np.array([-0.4, 0.5, 0.3]), np.array([0.2, -0.5, 0.3])


@pytest.mark.parametrize("follower", [False, True])
def test_a_conical_twisted_whisker_under_all_loads_agrees_with_scipy(follower):
    loads = jw.SpaceForce(*FORCE, follower=follower), jw.SpaceMoment(*MOMENT, follower=follower)
    bent = jw.deflect(GENERAL, *loads, jw.LineLoad(-0.3, Growing(-1.2), z=Growing(0.8)))
    assert bent.status == jw.Status.ok

    def at_tip(axes):
        turn = axes @ UPRIGHT.T if follower else np.eye(3)
        return turn @ FORCE, turn @ MOMENT

    def density(s):
        return np.array([-0.3 + 0 * s, -1.2 * s**2, 0.8 * s**2])

    base, tip = rod_by_collocation.solved(Cone(0.3), 0.7, [0.4, -0.6, 1.5], density, at_tip)
    np.testing.assert_allclose([bent.x[-1], bent.y[-1], bent.z[-1]], tip[:3], atol=SCIPY)
    np.testing.assert_allclose(bent.rotation[-1], rod_by_collocation.matrix(tip[3:7]), atol=SCIPY)
    reaction = [bent.fx, bent.fy, bent.fz, bent.mx, bent.my, bent.mz]
    np.testing.assert_allclose(reaction, -base[7:], atol=SCIPY)


HEAVY = jw.Whisker(1.2, 0.8, Linear(0.4, -0.9), mass_per_length=0.5, tip_mass=0.3)
POINTS = jw.PointForce(3.0, 0.9, follower=True, direction=2.0), jw.PointMoment(-2.0, 0.4), jw.PointMoment(1.3)
CASES = {
    "points": ((*POINTS, jw.PointForce(1.0, 0.7)), None),
    "distributed": ((jw.LineLoad(-1.0, Growing(-2.0), 0.2, 0.7), jw.PointMoment(0.4)), (-0.7, -1.1)),
}


@pytest.mark.parametrize("case", CASES)
def test_loads_in_the_plane_deflect_as_in_the_plane(case):
    loads, gravity = CASES[case]
    flat = jw.deflect(HEAVY, *loads, gravity=gravity)
    bent = jw.deflect(HEAVY, *loads, jw.SpaceForce(0.0, 0.0, 0.0, 0.5), gravity=gravity)
    assert flat.status == bent.status == jw.Status.ok
    for name in ("fx", "fy", "mz"):
        np.testing.assert_allclose(getattr(bent, name), getattr(flat, name), atol=PLANE)
    for name in ("fz", "mx", "my", "z"):
        np.testing.assert_allclose(getattr(bent, name), 0.0, atol=PLANE)
    np.testing.assert_allclose([bent.x[-1], bent.y[-1]], [flat.x[-1], flat.y[-1]], atol=PLANE)
    assert abs(bent.x[-1]) > 0.1
    if gravity is not None:
        kinds = [type(load).__name__ for load in bent.loads]
        assert kinds == ["LineLoad", "PointMoment", "SpaceForce", "LineLoad", "SpaceForce"]


@pytest.mark.parametrize("follower", [False, True])
def test_a_moment_across_bends_circles(follower):
    """Of up to two turns, about an axis between x and z."""

    @jax.jit
    @jax.vmap
    def of(moment):
        whisker, across = jw.Whisker(torsion_ratio=0.8), (0.6 * moment, 0.0, 0.8 * moment)
        return jw.deflect(whisker, jw.SpaceMoment(*across, follower=follower))

    moment = np.array([[1.0], [2 * np.pi], [13.0]])
    bent = of(moment[:, 0])
    assert bent.status.tolist() == [jw.Status.ok] * 3
    side, up = (1 - np.cos(moment * bent.s)) / moment, np.sin(moment * bent.s) / moment
    # A moment about z bends the whisker towards -x, and one about x towards z.
    np.testing.assert_allclose(np.stack([bent.x, bent.y, bent.z]), [-0.8 * side, up, 0.6 * side], atol=EXACT)
    inside = np.asarray(bent.curvature)[:, :-1]  # there is no moment beyond the tip
    expected = np.broadcast_to(moment[:, :, None] * np.array([0.6, -0.8, 0.0]), inside.shape)
    np.testing.assert_allclose(inside, expected, atol=EXACT)
    across = moment[:, 0] * np.array([[0.6], [0.0], [0.8]])
    np.testing.assert_allclose([bent.mx, bent.my, bent.mz], -across, atol=EXACT)


@pytest.mark.parametrize("follower", [False, True])
def test_a_moment_along_twists_the_whisker_several_times(follower):
    length, stiffness, ratio, moment, place = 2.0, 3.0, 0.7, 12.0, 1.5
    whisker = jw.Whisker(length, stiffness, torsion_ratio=ratio)
    bent = jw.deflect(whisker, jw.SpaceMoment(0.0, moment, 0.0, place, follower))
    assert bent.status == jw.Status.ok
    twist = moment / (ratio * stiffness)
    angle = twist * np.minimum(bent.s, place)
    assert angle[-1] > 2 * np.pi
    np.testing.assert_allclose(bent.rotation[:, 0, 0], np.cos(angle), atol=EXACT)
    np.testing.assert_allclose(bent.rotation[:, 2, 0], -np.sin(angle), atol=EXACT)
    np.testing.assert_allclose(bent.y, bent.s, atol=EXACT)
    np.testing.assert_allclose(np.asarray(bent.curvature)[np.asarray(bent.s) < place, 2], twist, atol=EXACT)


def test_moments_and_forces_along_the_whisker_balance():
    loads = (
        jw.SpaceForce(-0.5, 0.3, 0.4, 0.6, follower=True),
        jw.SpaceMoment(0.3, -0.2, 0.1, 0.6, follower=True),
        jw.SpaceMoment(0.1, 0.4, -0.3, 0.3),
    )
    bent = jw.deflect(GENERAL, *loads)
    k = int(np.flatnonzero(np.isclose(bent.s, 0.6))[0])
    turn = np.asarray(bent.rotation[k]) @ UPRIGHT.T
    place = np.array([bent.x[k], bent.y[k], bent.z[k]])
    force, moment = turn @ [-0.5, 0.3, 0.4], turn @ [0.3, -0.2, 0.1] + [0.1, 0.4, -0.3]
    np.testing.assert_allclose([bent.fx, bent.fy, bent.fz], -force, atol=PLANE)
    np.testing.assert_allclose([bent.mx, bent.my, bent.mz], -moment - np.cross(place, force), atol=PLANE)
    assert np.max(np.abs(turn - np.eye(3))) > 0.3


def test_gravity_in_all_directions():
    straight = jw.Whisker(1.2, 0.8, mass_per_length=0.5, tip_mass=0.3)
    bent = jw.deflect(straight, gravity=(-0.7, 0.2, 0.4))
    mass = 1.2 * 0.5 + 0.3
    np.testing.assert_allclose([bent.fx, bent.fy, bent.fz], -mass * np.array([-0.7, 0.2, 0.4]), atol=PLANE)
    # The same weight, turned about the whisker, turns the deflection.
    flat = jw.deflect(straight, gravity=(-np.hypot(0.7, 0.4), 0.2))
    np.testing.assert_allclose(np.hypot(bent.x[-1], bent.z[-1]), -flat.x[-1], atol=PLANE)
    np.testing.assert_allclose(bent.z[-1] / bent.x[-1], -4 / 7, atol=PLANE)


SIDES = np.array([1 - NEAR, 1 + NEAR])  # of the load of buckling
EITHER = [jw.Status.ok, jw.Status.unstable]


def of_shared_thrust(follower):
    """Load at which a thrust buckles a whisker whose share `follower` follows the tip; the rest is dead.

    The bend t'' = -q (t - follower t(1)) with t(0) = t'(1) = 0 is there if cos k = -follower / dead, q = k^2. With a
    damping in proportion to stiffness, disturbances grow as exp(r time), and q is the load over 1 + r. They grow if
    the real part of 1/q is more than 1/load.
    """
    k = np.arccos(complex(-follower / (1 - follower)))
    return 1 / (1 / k**2).real


def test_followers_buckle_a_whisker_as_in_closed_form():
    """With more than half of the thrust, no straight whisker has a neighbour: bends oscillate while they grow."""
    shares = np.array([0.2, 0.4, 0.6, 0.8])
    loads = np.array([of_shared_thrust(share) for share in shares])[:, None] * SIDES
    assert loads[0, 0] < 10 < 30 < loads[-1, 0]

    @jax.jit
    @jax.vmap
    def status(share, load):
        along = jw.SpaceForce(0.0, -share * load, 0.0, follower=True)
        return jw.deflect(jw.Whisker(), along, jw.SpaceForce(0.0, (share - 1) * load, 0.0), points=3).status

    assert jax.vmap(status, (None, 1), 1)(shares, loads).tolist() == [EITHER] * 4


def of_twisted_column(torque):
    """Thrust at which a whisker buckles that carries a torque as well.

    The bend t'' - i M t' + P t = 0 with t(0) = 0 and t'(1) = i M t(1) of a dead torque is a sum of exp(i a s) with
    a^2 = M a + P, and a1 exp(i a2) = a2 exp(i a1). M and P are divided by 1 + r as above. A torque that follows the
    tip has the same loads.
    """

    def equations(v):
        thrust, q = v[0], complex(v[1], v[2])
        middle, apart = q * torque / 2, np.sqrt((q * torque / 2) ** 2 + q * thrust)
        bend = np.exp(2j * apart) * (middle - apart) - (middle + apart)
        return [bend.real, bend.imag, (1 / q).real - 1]

    found = root(equations, [2.4, 1.0, -torque / 5], tol=1e-13)
    assert found.success
    return found.x[0]


def test_a_twisted_column_buckles_as_in_closed_form():
    torques = np.array([0.0, 0.5, 2.0])
    loads = np.array([of_twisted_column(torque) for torque in torques])[:, None] * SIDES
    np.testing.assert_allclose(loads[0], np.pi**2 / 4 * SIDES)

    @jax.jit
    @jax.vmap
    def status(dead, follower, thrust):
        twists = jw.SpaceMoment(0.0, dead, 0.0), jw.SpaceMoment(0.0, follower, 0.0, follower=True)
        return jw.deflect(jw.Whisker(), jw.SpaceForce(0.0, -thrust, 0.0), *twists, points=3).status

    none = np.zeros(3)
    dead, follower = np.concatenate([torques, none]), np.concatenate([none, torques])
    found = jax.vmap(status, (None, None, 1), 1)(dead, follower, np.concatenate([loads, loads]))
    assert found.tolist() == [EITHER] * 6


def test_heavy_columns_buckle_at_greenhills_load():
    weights = jnp.array([7.83, 7.84])  # 7.8373
    status = jax.vmap(lambda w: jw.deflect(jw.Whisker(), jw.LineLoad(y=-w, z=0.0), points=2).status)(weights)
    assert status.tolist() == [jw.Status.ok, jw.Status.unstable]


def test_a_thrust_that_follows_the_tip_never_buckles_a_whisker_statically():
    loads = jnp.array([5.0, 50.0, 200.0])
    thrust = jax.vmap(lambda p: jw.deflect(jw.Whisker(), jw.SpaceForce(0.0, -p, 0.0, follower=True), points=2).status)
    assert thrust(loads).tolist() == [jw.Status.ok] * 3


def parameters(p):
    whisker = jw.Whisker(p[0], p[1], 0.6, torsion_ratio=p[2], lateral_curvature=0.4, mass_per_length=p[3], tip_mass=0.2)
    loads = (
        jw.SpaceForce(p[4], 0.3, p[5], position=p[6], follower=True),
        jw.SpaceMoment(p[7], p[8], 0.2, follower=True),
        jw.SpaceMoment(0.1, p[9], p[10], position=0.5),
        jw.LineLoad(Growing(p[11]), 0.2, p[12], p[13], z=p[14]),
    )
    bent = jw.deflect(whisker, *loads, gravity=(0.1, p[15], -0.3), points=3)
    shape = [bent.x[-1], bent.z[-1], bent.rotation[-1, 0, 0], bent.curvature[1, 2], bent.y[4]]
    return jnp.stack([bent.fz, bent.mx, bent.my, bent.mz, *shape])


AT = jnp.array([1.1, 0.4, 0.7, 0.3, -0.5, 0.4, 0.8, 0.1, 0.2, -0.2, 0.1, 0.5, 0.2, 0.9, -0.3, -0.4])


def test_derivatives_in_both_modes_under_jit_and_vmap():
    weights, way = jnp.arange(1.0, 10.0), jnp.cos(jnp.arange(AT.size))

    def all_of(p):
        value, along = jax.linearize(parameters, p)
        return value, along(way), jax.linear_transpose(along, p)(weights)[0]

    step = 1e-4
    values, forward, reverse = jax.jit(jax.vmap(all_of))(jnp.stack([AT, AT + step * way, AT - step * way]))
    np.testing.assert_allclose(forward[0], (values[1] - values[2]) / (2 * step), atol=SLOPE)
    np.testing.assert_allclose(reverse @ way, forward @ weights, rtol=MODES)
    assert np.all(np.abs(reverse[0]) > 0.01)  # every number matters
    np.testing.assert_allclose(values[0], parameters(AT), atol=PLANE)


def test_traced_loads_beyond_the_tip_are_invalid():
    @jax.jit
    @jax.vmap
    def status(stop):
        return jw.deflect(jw.Whisker(), jw.LineLoad(0.1, stop=stop, z=0.1), points=2).status

    stops = jnp.array([0.5, 1.5, 0.0])
    assert status(stops).tolist() == [jw.Status.ok, jw.Status.invalid, jw.Status.invalid]


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: jw.deflect(HEAVY, gravity=(1.0, 2.0, 3.0, 4.0)), "`gravity` must be a pair of numbers"),  # pyright: ignore
        (lambda: jw.deflect(HEAVY, gravity=(1.0, 2.0, np.nan)), r"`gravity\[2\]` must be a finite number"),
        (lambda: jw.deflect(jw.Whisker(), gravity=(0.0, 0.0, 1.0)), "`mass_per_length` must be given"),
        (lambda: jw.deflect(jw.Whisker(), jw.SpaceMoment(0.1, 0.0, 0.0, 1.5)), "`position` must be at most the length"),
        (lambda: jw.deflect(jw.Whisker(), jw.LineLoad(z=1.0, stop=1.5)), "`stop` must be at most the length"),
        (
            lambda: jw.deflect(HEAVY, jw.SpaceMoment(1.0, 0.0, 0.0), support=jw.Support.fb(70.0)),  # pyright: ignore
            "`support` must be an upright clamp in space",
        ),
    ],
)
def test_errors(make, message):
    with pytest.raises(ValueError, match=message):
        make()
