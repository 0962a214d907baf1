"""Whiskers with a weight in space: the plane, rotated scenes, laws that share no code with the package, derivatives."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.spatial.transform import Rotation

import jaxwhisker as jw
from jaxwhisker._inverse.space import space_sensor
from jaxwhisker._scan.state import state_of
from scenes import all_ok

SAME = 1e-8  # the same equilibria by another rod
SOUND = 2e-8  # largest residual of a law, relative to the forces: rods have 16 steps up to the contact
DIFFERENCE, DIFFERENCES = 1e-4, 2e-6  # step of central differences, and their error
RADIUS, CENTRE = 0.5, np.array([0.0, 0.8, 0.0])
ALONG = jw.LinearDrive((-1.0, 0.0, 0.0))
CONTROL = np.linspace(-0.9, 0.9, 25)
BEFORE = CONTROL[CONTROL < -0.05]  # straight whiskers leave the plane at the vertex
HEAVY = jw.Whisker(mass_per_length=1.0, tip_mass=0.2)
NAMES = "fx", "fy", "fz", "mx", "my", "mz"


STRAIGHT = np.eye(3)


def peg(turn=STRAIGHT):
    """A cylinder across the way of the drive, rotated about the origin."""
    return jw.Cylinder(RADIUS, tuple(turn @ CENTRE), tuple(turn @ [0.0, 0.0, 1.0]))


def scene(gravity=(0.3, -1.0, 0.4), whisker=HEAVY, turn=(0.0, 0.0), **options):
    """A whisker, and with it everything, turned about x, and then about z."""
    matrix = Rotation.from_euler("xz", turn).as_matrix()
    support = options.pop("support", jw.Support((), jw.Mount(angle=turn[1], elevation=turn[0])))
    gravity, way = (tuple(map(float, matrix @ part)) for part in (gravity, ALONG.direction))
    return jw.Scene(whisker, peg(matrix), support, motion=jw.LinearDrive(way), gravity=gravity, **options)


def cone(**options):
    """A cone, with the mass of one."""
    return jw.Whisker(
        1.0, lambda s: (1 - 0.7 * s) ** 4, mass_per_length=lambda s: (1 - 0.7 * s) ** 2, tip_mass=0.05, **options
    )


SCENES = {
    "clamped": scene(),
    "friction": scene(friction=0.3),
    "springs": scene(support=jw.Support((jw.Spring((0, 1), 40.0), jw.Spring((0, 1), 60.0, axis="z")))),
    "tilting": scene(
        support=jw.Support(
            (jw.Spring((0, 1), 40.0), *(jw.Spring((0, 1), 6.0, axis=axis) for axis in ("phi", "phi_x", "phi_y")))
        )
    ),
    "curved cone": scene(whisker=cone(intrinsic_curvature=-0.4, lateral_curvature=0.2, twist=0.3)),
    "strip": scene(whisker=jw.Whisker(mass_per_length=1.0, lateral_ratio=3.0)),
}
SOME = ("clamped",)
MORE = [name for name in SCENES if name not in SOME]


@cache
def scanned(name, steps=BEFORE.size):
    return jw.scan(SCENES[name], CONTROL[:steps])


def in_one_plane(result, plane):
    """Compare a scan in space with one in the plane, whose control falls."""
    for name in ("fx", "fy", "mz", "contact_arc", "contact_x", "contact_y", "base_x"):
        np.testing.assert_allclose(getattr(result, name), getattr(plane, name), atol=SAME, err_msg=name)
    for name in ("fz", "mx", "my", "contact_z"):
        np.testing.assert_allclose(getattr(result, name), 0.0, atol=SAME, err_msg=name)
    assert result.phase.tolist() == plane.phase.tolist()
    count = int(plane.events.count)
    assert int(result.events.count) >= count
    assert result.events.kind[:count].tolist() == plane.events.kind[:count].tolist()
    np.testing.assert_allclose(-result.events.control[:count], plane.events.control[:count], atol=SAME)


def test_whiskers_in_a_plane_of_symmetry_are_those_of_the_plane():
    plane = jw.scan(jw.Scene(HEAVY, jw.Circle(0.3, RADIUS), gravity=(0.3, -1.0)), -BEFORE)
    result = jw.scan(scene((0.3, -1.0, 0.0)), BEFORE)
    assert all_ok(result) and np.max(result.contact_force) > 0.5
    in_one_plane(result, plane)


def test_with_friction_they_are_those_of_the_plane_up_to_the_snap():
    control = CONTROL[:16]
    plane = jw.scan(jw.Scene(HEAVY, jw.Circle(0.3, RADIUS), gravity=(0.3, -1.0), friction=0.3), -control)
    result = jw.scan(scene((0.3, -1.0, 0.0), friction=0.3), control)
    assert all_ok(result) and np.max(result.contact_force) > 0.5
    in_one_plane(result, plane)
    for name in ("friction_x", "friction_y"):
        assert np.max(np.abs(getattr(result, name))) > 0.1


def test_a_rotated_scene_has_a_rotated_result():
    result, turn = scanned("clamped"), (0.3, -0.4)
    other = jw.scan(scene(turn=turn), BEFORE)
    assert all_ok(result) and all_ok(other)
    matrix = Rotation.from_euler("xz", turn).as_matrix()
    for names in (NAMES[:3], NAMES[3:], ("contact_x", "contact_y", "contact_z"), ("base_x", "base_y", "base_z")):
        one, turned = (np.stack([getattr(r, name)[:, 0] for name in names], axis=1) for r in (result, other))
        np.testing.assert_allclose(turned, one @ matrix.T, atol=SAME, err_msg=str(names))
    np.testing.assert_allclose(other.events.control, result.events.control, atol=SAME)


def broken_laws(scene, at):
    """Violations of the laws of one whisker in one state.

    The rod is integrated from the base, under its reaction. At the contact, the force on it becomes the weight beyond.
    """
    (whisker,), gravity = scene.whiskers, np.array(scene.gravity)
    length, tip = float(whisker.length), 0.0 if whisker.tip_mass is None else float(whisker.tip_mass)
    stiffness, mass, own = (
        jax.jit(part) for part in (whisker.stiffness_at, whisker.mass_at, whisker.curvature_in_space)
    )
    lateral = 1.0 if whisker.lateral_ratio is None else whisker.lateral_ratio
    ratios = np.array([lateral, 1.0, whisker.torsion])

    def rates(s, y):
        d, force, moment = y[3:12].reshape(3, 3), y[12:15], y[15:18]
        k = np.asarray(own(s)) + d.T @ moment / (float(stiffness(s)) * ratios)
        hat = np.array([[0.0, -k[2], k[1]], [k[2], 0.0, -k[0]], [-k[1], k[0], 0.0]])
        # The moment m falls by t x F outwards.
        return [*d[:, 2], *(d @ hat).ravel(), *(-float(mass(s)) * gravity), *-np.cross(d[:, 2], force)]

    def onwards(start, end, y):
        return solve_ivp(rates, (start, end), y, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]

    vectors = [[float(getattr(at, name)[0]) for name in names] for names in (NAMES[:3], NAMES[3:])]
    base = [float(getattr(at, f"base_{axis}")[0]) for axis in "xyz"]
    y = np.concatenate([base, np.ravel(at.base_rotation[0]), *(-np.array(part) for part in vectors)])
    touches = int(at.phase[0]) != jw.Phase.free
    arc, laws = float(at.contact_arc[0]) if touches else length, {}
    end = onwards(0.0, arc, y)
    beyond = (quad(lambda s: float(mass(s)), arc, length)[0] + tip) * gravity
    force, place = end[12:15] - beyond, np.array([float(getattr(at, f"contact_{axis}")[0]) for axis in "xyz"])
    if touches:
        laws["contact"] = np.linalg.norm(end[:3] - place)
        laws["force"] = np.linalg.norm(force) - float(at.contact_force[0])
        out = (place - CENTRE) * [1.0, 1.0, 0.0] / RADIUS
        laws["object"] = np.linalg.norm(out) - 1
        if scene.friction is None:
            laws["normal"] = np.linalg.norm(np.cross(force, out))
        else:
            laws["normal force"] = force @ out - float(at.normal_force[0])
            laws["cone"] = max(0.0, np.linalg.norm(np.cross(force, out)) - scene.friction * (force @ out))
        if int(at.phase[0]) == jw.Phase.tangential:
            laws["tangent"] = end[3:12].reshape(3, 3)[:, 2] @ out
    else:
        laws["no force"] = np.linalg.norm(force)
    end[12:15] = beyond
    laws["tip"] = np.linalg.norm(onwards(arc, length, end)[15:18])
    size = max(1.0, float(at.contact_force[0]))
    return {name: abs(value) / size for name, value in laws.items()}


@pytest.mark.parametrize("name", [*SOME, *MORE])
def test_states_obey_the_laws(name):
    result = scanned(name)
    assert all_ok(result)
    phases = set(np.asarray(result.phase)[:, 0].tolist())
    assert {int(jw.Phase.free), int(jw.Phase.tangential)} <= phases
    assert np.max(np.abs(result.fz[-1])) > 0.1  # the weight pulls sideways
    broken = {}
    for k in range(0, result.control.size, 3):
        at = jax.tree.map(lambda leaf, k=k: np.asarray(leaf)[k], state_of(result))
        for law, value in broken_laws(SCENES[name], at).items():
            broken[law] = max(value, broken.get(law, 0.0))
    assert {law for law, value in broken.items() if not value < SOUND} == set(), broken


def test_states_are_deflections_under_the_contact_force_and_the_weight():
    result, gravity = scanned("clamped"), SCENES["clamped"].gravity
    k = int(np.flatnonzero(np.asarray(result.phase)[:, 0] != jw.Phase.free)[2])
    place = np.array([float(getattr(result, f"contact_{axis}")[k, 0]) for axis in "xyz"])
    push = float(result.contact_force[k, 0]) * (place - CENTRE) * [1.0, 1.0, 0.0] / RADIUS
    arc = float(result.contact_arc[k, 0])
    bent = jw.deflect(HEAVY, jw.SpaceForce(*push, arc), gravity=gravity)
    for name in NAMES:
        np.testing.assert_allclose(getattr(bent, name), getattr(result, name)[k, 0], atol=SAME, err_msg=name)
    line = jw.shapes(result, CONTROL[[k]])
    tip = [float(getattr(line, axis)[0, 0, -1] - getattr(result, f"base_{axis}")[k, 0]) for axis in "xyz"]
    np.testing.assert_allclose(tip, [bent.x[-1], bent.y[-1], bent.z[-1]], atol=SAME)
    at = np.array([0.0, 0.3, 0.5 * arc, 0.5 * (1 + arc), 1.0])
    curvature = np.stack([np.interp(at, bent.s, part) for part in np.asarray(bent.curvature).T], axis=-1)
    np.testing.assert_allclose(jw.bending(result, at).curvature[k, 0], curvature, atol=2e-3)


def test_free_whiskers_hang_as_they_deflect():
    result = scanned("clamped")
    bent = jw.deflect(HEAVY, gravity=SCENES["clamped"].gravity)
    for name in NAMES:
        np.testing.assert_allclose(getattr(result, name)[0, 0], getattr(bent, name), atol=SAME, err_msg=name)
    line = jw.shapes(result, CONTROL[[0]])
    tip = [float(getattr(line, axis)[0, 0, -1] - getattr(result, f"base_{axis}")[0, 0]) for axis in "xyz"]
    np.testing.assert_allclose(tip, [bent.x[-1], bent.y[-1], bent.z[-1]], atol=SAME)


def test_results_have_derivatives_by_gravity_and_masses():
    control = BEFORE[2::3]

    def signals(p):
        whisker = jw.Whisker(mass_per_length=p[3], tip_mass=p[4])
        result = jw.scan(scene_of(whisker, (p[0], p[1], p[2])), control)
        return jnp.concatenate([getattr(result, name)[:, 0] for name in (*NAMES, "contact_arc")])

    def scene_of(whisker, gravity):
        return jw.Scene(whisker, peg(), jw.Support((), jw.Mount()), motion=ALONG, gravity=gravity)

    p = jnp.array([0.3, -1.0, 0.4, 1.0, 0.2])
    forward = jax.jacfwd(signals)(p)
    np.testing.assert_allclose(jax.jacrev(signals)(p), forward, atol=SAME)
    steps = DIFFERENCE * jnp.eye(5)
    differences = jnp.stack([(signals(p + h) - signals(p - h)) / (2 * DIFFERENCE) for h in steps], axis=-1)
    np.testing.assert_allclose(forward, differences, atol=DIFFERENCES)
    # A batch: an element that is not valid is NaN, and its neighbour does not notice.
    batch = jax.jit(jax.vmap(signals))(jnp.stack([p, p.at[1].set(jnp.inf)]))
    np.testing.assert_allclose(batch[0], signals(p), atol=SAME)
    assert np.isnan(batch[1]).all()


def test_networks_sink_together():
    """Two whiskers in a row: the spring between them feels both weights."""
    whisker = jw.Whisker(mass_per_length=1.0)
    support = jw.Support.fbfb(70.0, 0.5)
    result = jw.scan(jw.Scene(whisker, peg(), support, motion=ALONG, gravity=(0.5, -1.0, 0.2)), BEFORE)
    assert all_ok(result)
    # Before any contact, each base carries the weight of its whisker, and the springs between carry their sum.
    for name, weight in (("fx", -0.5), ("fy", 1.0), ("fz", -0.2)):
        np.testing.assert_allclose(getattr(result, name)[0], [weight, weight], atol=SAME)
    sunk = np.asarray(result.base_x[0]) - np.asarray(
        jw.scan(jw.Scene(whisker, peg(), support, motion=ALONG), BEFORE[:2]).base_x[0]
    )
    assert np.all(np.abs(sunk) > 1e-3)


def test_a_column_that_buckles_under_its_own_weight_is_refused():
    """At w L^3 / EI = 7.8373 (Greenhill 1881)."""
    for weight, status in ((7.8, jw.Status.ok), (7.9, None)):
        heavy = scene((0.0, -weight, 0.0), jw.Whisker(mass_per_length=1.0, tip_mass=0.0))
        if status is None:
            with pytest.raises(ValueError, match="`gravity` must leave free whiskers stable"):
                jw.scan(heavy, CONTROL[:2])
        else:
            assert int(jw.scan(heavy, CONTROL[:2]).status[0]) == status


def test_what_does_not_know_weights_says_so():
    light = jw.Whisker()
    for whisker, options, text in (
        (HEAVY, {"gravity": (0.0, -1.0)}, "`gravity` must be a tuple of three numbers"),
        (HEAVY, {"gravity": (0.0, np.nan, 0.0)}, r"`gravity\[1\]` must be a finite number, got nan"),
        (light, {}, "`mass_per_length` must be given for whiskers with a weight, got None"),
        (HEAVY, {"rod": jw.ClosedForm()}, r"`rod` must be Shooting\(\) for whiskers with a weight"),
        (HEAVY, {"contacts": 2}, "`gravity` must be None for several contacts"),
        (HEAVY, {"motion": jw.RotaryDrive((0.0, 0.0, 1.0))}, "`motion` must be a LinearDrive or a Translation"),
        (
            HEAVY,
            {"support": jw.Support(tuple(jw.Spring(ends, 5.0, axis="phi") for ends in ((0, 1), (1, 2))))},
            r"`support` must be without torsion springs that connect whiskers with a weight, got one between \(1, 2\)",
        ),
    ):
        with pytest.raises(ValueError, match=text):
            jw.Scene(whisker, peg(), **({"gravity": (0.0, -1.0, 0.0)} | options))
    with pytest.raises(ValueError, match="`sensor` must be a scene without gravity"):
        space_sensor(SCENES["clamped"])


def test_it_is_a_part_of_texts_and_files(tmp_path):
    heavy = jw.Scene(HEAVY, jw.Cylinder(RADIUS, (0.0, 0.8, 0.0)), gravity=(0.3, -1.0, 0.4))
    assert "gravity (0.3, -1, 0.4)" in str(heavy)
    jw.save_scene(heavy, tmp_path / "scene.toml")
    assert jw.load_scene(tmp_path / "scene.toml") == heavy
