"""Whiskers with a weight: laws that share no code with the package, given loads, buckling, energy, derivatives."""

# pyright: reportArgumentType=false, reportCallIssue=false

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

import jaxwhisker as jw
from jaxwhisker._scan.state import state_of
from scenes import all_ok, event_list

CIRCLE = jw.Circle(0.3, 0.5)
CONTROL = np.linspace(0.9, -1.2, 43)
SOUND = 2e-8  # largest residual of a law, relative to the forces: rods have 16 steps up to the contact
SAME = 1e-9  # the same equilibria, computed in another way
BALANCED = 1e-8  # of the largest work
DIFFERENCE, DIFFERENCES = 1e-4, 1e-6  # step of central differences, and their error
BUCKLES = 7.8373  # w L^3 / EI of a column that buckles under its own weight (Greenhill 1881)
SHORT = 1e-9  # part of a pointed whisker at its tip, without stiffness, that is not integrated


def cone(**options):
    """A cone, with the mass of one."""
    return jw.Whisker(
        1.0, lambda s: (1 - 0.7 * s) ** 4, mass_per_length=lambda s: (1 - 0.7 * s) ** 2, tip_mass=0.05, **options
    )


SCENES = {
    "clamped": jw.Scene(jw.Whisker(mass_per_length=1.0), CIRCLE, gravity=(0.0, -1.0)),
    "FB": jw.Scene(jw.Whisker(mass_per_length=1.0, tip_mass=0.2), CIRCLE, jw.Support.fb(70.0), gravity=(0.8, 1.5)),
    "friction": jw.Scene(
        jw.Whisker(mass_per_length=1.0), CIRCLE, jw.Support.fb(70.0), friction=0.3, gravity=(-0.5, -1.0)
    ),
    "curved cone": jw.Scene(cone(intrinsic_curvature=-0.4), CIRCLE, gravity=(0.3, -0.5)),
    "on a follicle": jw.Scene(
        jw.Whisker(mass_per_length=1.0),
        CIRCLE,
        jw.Support((jw.Spring((0, 1), 300.0, at=0.0), jw.Spring((0, 1), 500.0, at=-0.15)), free=("phi",)),
        gravity=(0.4, -1.0),
    ),
}
SOME = ("clamped",)
MORE = [name for name in SCENES if name not in SOME]


@cache
def scanned(name):
    return jw.scan(SCENES[name], CONTROL)


def test_of_nothing_is_nothing():
    """Whiskers without weight, by the equations of those that have one, and by the closed form."""
    weightless = jw.scan(jw.Scene(jw.Whisker(mass_per_length=1.0), CIRCLE, gravity=(0.0, 0.0)), CONTROL)
    plain = jw.scan(jw.Scene(jw.Whisker(), CIRCLE, rod=jw.ClosedForm()), CONTROL)
    for name in ("fx", "fy", "mz", "contact_arc", "contact_x"):
        np.testing.assert_allclose(getattr(weightless, name), getattr(plain, name), atol=10 * SAME, err_msg=name)
    for (kind, whiskers, u), own in zip(event_list(weightless), event_list(plain), strict=True):
        assert (kind, whiskers) == own[:2] and u == pytest.approx(own[2], abs=SAME)


def broken_laws(scene, at):
    """Violations of the laws of one whisker in one state, whose shaft no spring holds above its base.

    The rod is integrated from the base, under its reaction. At the contact, the force on it becomes the weight beyond.
    """
    (whisker,), (gx, gy) = scene.whiskers, scene.gravity
    length, tip = float(whisker.length), 0.0 if whisker.tip_mass is None else float(whisker.tip_mass)
    stiffness, mass, own = (jax.jit(part) for part in (whisker.stiffness_at, whisker.mass_at, whisker.curvature_at))

    def rates(s, values):
        _, _, phi, fx, fy, turn = values
        bend = turn / float(stiffness(s)) + float(own(s))
        weight = float(mass(s))
        return [np.cos(phi), np.sin(phi), bend, -weight * gx, -weight * gy, np.sin(phi) * fx - np.cos(phi) * fy]

    def onwards(start, end, values):
        return solve_ivp(rates, (start, end), values, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]

    reaction = [-float(getattr(at, name)[0]) for name in ("fx", "fy", "mz")]
    base = [float(at.base_x[0]), float(at.base_y[0]), np.pi / 2 + float(at.base_angle[0]), *reaction]
    touches = int(at.phase[0]) != jw.Phase.free
    arc = float(at.contact_arc[0]) if touches else length
    end, laws = onwards(0.0, arc, base), {}
    beyond = quad(lambda s: float(mass(s)), arc, length)[0] + tip
    force = end[3:5] - np.multiply(scene.gravity, beyond)
    if touches:
        laws["contact"] = np.hypot(end[0] - at.contact_x[0], end[1] - at.contact_y[0])
        laws["force"] = np.hypot(*force) - float(at.contact_force[0])
        out = np.array([at.contact_x[0], at.contact_y[0] - 0.3 - 0.5]) / 0.5  # normal of the circle
        laws["object"] = np.hypot(*out) - 1
        if scene.friction is None:
            laws["normal"] = force[0] * out[1] - force[1] * out[0]
        if int(at.phase[0]) == jw.Phase.tangential:
            laws["tangent"] = np.cos(end[2]) * out[0] + np.sin(end[2]) * out[1]
    else:
        laws["no force"] = np.hypot(*force)
    end[3:5] = np.multiply(scene.gravity, beyond)
    laws["tip"] = onwards(arc, length - SHORT, end)[5]
    size = max(1.0, float(at.contact_force[0]))
    return {name: abs(value) / size for name, value in laws.items()}


@pytest.mark.parametrize("name", [*SOME, *MORE])
def test_states_obey_the_laws(name):
    result = scanned(name)
    assert all_ok(result)
    phases = np.asarray(result.phase)[:, 0]
    assert {int(jw.Phase.free), int(jw.Phase.tangential)} <= set(phases.tolist())
    broken = {}
    for k in range(0, CONTROL.size, 3):
        at = jax.tree.map(lambda leaf, k=k: np.asarray(leaf)[k], state_of(result))
        found = broken_laws(SCENES[name], at)
        broken |= {law: max(value, broken.get(law, 0.0)) for law, value in found.items()}
    assert {law for law, value in broken.items() if not value < SOUND} == set(), broken


def test_states_are_deflections_under_the_contact_force_and_the_weight():
    scene, result = SCENES["clamped"], scanned("clamped")
    for k in (12, 20):
        slope, force, arc = (getattr(result, name)[k, 0] for name in ("contact_slope", "contact_force", "contact_arc"))
        bent = jw.deflect(
            scene.whiskers[0], jw.PointForce(force, arc, direction=slope - np.pi / 2), gravity=scene.gravity
        )
        for name in ("fx", "fy", "mz"):
            np.testing.assert_allclose(getattr(bent, name), getattr(result, name)[k, 0], atol=1e-7, err_msg=name)
        line = jw.shapes(result, CONTROL[[k]])
        tip = float(line.x[0, 0, -1] - result.base_x[k, 0]), float(line.y[0, 0, -1])
        np.testing.assert_allclose(tip, (bent.x[-1], bent.y[-1]), atol=1e-7)
        at = np.array([0.0, 0.3, float(arc) * 0.9, float(arc) + 0.5 * (1 - float(arc)), 1.0])
        curvature = np.interp(at, bent.s, bent.curvature)
        np.testing.assert_allclose(jw.bending(result, at).curvature[k, 0], curvature, atol=2e-3)


def test_a_column_buckles_under_its_own_weight():
    statuses = []
    for factor in (0.999, 1.001):
        heavy = jw.Scene(jw.Whisker(mass_per_length=1.0), CIRCLE, gravity=(0.0, -factor * BUCKLES))
        statuses.append(int(jw.scan(heavy, CONTROL).status[0]))
    assert statuses[0] == jw.Status.ok and statuses[1] != jw.Status.ok


@pytest.mark.parametrize("name", ["clamped", "FB", "on a follicle", "friction"])
def test_the_energy_balances(name):
    """The work of the drive goes into bending, springs, weights and heat."""
    scene = SCENES[name]
    energies = jw.energy_balance(jw.scan(scene, CONTROL[:36]))
    work = np.abs(energies.work).max()
    assert work > 0.1 and np.abs(energies.residual).max() < BALANCED * work
    if scene.friction is None:
        np.testing.assert_array_equal(energies.heat, 0.0)


def test_results_have_derivatives_by_gravity_and_masses():
    control = CONTROL[12:26]

    def signals(p):
        gx, gy, mass, tip = p
        whisker = jw.Whisker(mass_per_length=mass, tip_mass=tip)
        result = jw.scan(jw.Scene(whisker, CIRCLE, gravity=(gx, gy)), control)
        return jnp.stack([result.fx[:, 0], result.fy[:, 0], result.mz[:, 0], result.contact_arc[:, 0]])

    p = jnp.array([0.3, -1.0, 1.0, 0.1])
    forward = jax.jacfwd(signals)(p)
    np.testing.assert_allclose(jax.jacrev(signals)(p), forward, atol=SAME)
    steps = DIFFERENCE * jnp.eye(4)
    differences = jnp.stack([(signals(p + h) - signals(p - h)) / (2 * DIFFERENCE) for h in steps], axis=-1)
    np.testing.assert_allclose(forward, differences, atol=DIFFERENCES)
    # A batch: an element that is not valid is NaN, and its neighbour does not notice.
    batch = jax.jit(jax.vmap(signals))(jnp.stack([p, p.at[1].set(jnp.inf)]))
    np.testing.assert_allclose(batch[0], signals(p), atol=SAME)
    assert np.isnan(batch[1]).all()


def test_networks_sink_together():
    """Two whiskers in a row: the spring between them feels both weights."""
    whisker = jw.Whisker(mass_per_length=1.0)
    result = jw.scan(jw.Scene(whisker, CIRCLE, jw.Support.fbfb(70.0, 0.5), gravity=(0.5, -1.0)), CONTROL)
    assert all_ok(result)
    assert (np.asarray(result.phase).max(axis=0) > 0).all()
    # Before any contact, each base carries the weight of its whisker, and the springs between carry their sum.
    np.testing.assert_allclose(result.fx[0], [-0.5, -0.5], atol=SAME)
    np.testing.assert_allclose(result.fy[0], [1.0, 1.0], atol=SAME)


def test_what_does_not_know_weights_says_so():
    whisker, scene = jw.Whisker(mass_per_length=1.0), SCENES["clamped"]
    for options, text in (
        ({"gravity": (0.0, np.nan)}, r"`gravity\[1\]` must be a finite number, got nan"),
        ({"gravity": -9.81}, "`gravity` must be a pair of numbers, got -9.81"),
        ({"gravity": (0.0, -1.0), "rod": jw.ClosedForm()}, r"`rod` must be Shooting\(\) for whiskers with a weight"),
        ({"gravity": (0.0, -1.0), "contacts": 2}, r"`gravity` must be None for several contacts, got \(0.0, -1.0\)"),
        ({"gravity": (0.0, -1.0), "motion": jw.Rotation((0.0, 0.0))}, "`motion` must be a Translation for whiskers"),
    ):
        with pytest.raises(ValueError, match=text):
            jw.Scene(whisker, CIRCLE, **options)
    with pytest.raises(ValueError, match="`mass_per_length` must be given for whiskers with a weight, got None"):
        jw.Scene(jw.Whisker(), CIRCLE, gravity=(0.0, -1.0))
    with pytest.raises(ValueError, match="`gravity` must be a tuple of three numbers"):
        jw.Scene(whisker, jw.Sphere(0.5, (0.0, 1.0, 0.0)), gravity=(0.0, -1.0))
    result = scanned("clamped")
    for call, text in (
        (lambda: jw.simulate(scene, lambda t: 0.9 - t, 1.0), "`scene` must be one without gravity for a simulation"),
        (lambda: jw.modes(result), "`at` must be one without gravity"),
        (lambda: jw.lateral_stability(result), "`result` must be that of a scene without gravity"),
        (lambda: jw.Sensor.of(scene), "`scene` must be without gravity"),
        (lambda: jw.reconstruct(result, scene), "without gravity"),
        (lambda: jw.stored_energy(scene, result.events.before), "`control` must be given for states of a scene with"),
    ):
        with pytest.raises(ValueError, match=text):
            call()


def test_it_is_a_part_of_texts_files_and_code(tmp_path):
    scene = SCENES["clamped"]
    assert str(scene) == "clamped: 1 whisker, circle q = 0.3, r = 0.5, gravity (0, -1)"
    jw.save_scene(scene, tmp_path / "scene.toml")
    assert jw.load_scene(tmp_path / "scene.toml") == scene
