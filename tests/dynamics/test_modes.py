"""Modes: reference frequencies, beams by finite elements, contact by differentiating the energy, folds, derivatives."""

# pyright: reportArgumentType=false
import json
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from vibrating import beam, held_at, in_contact, on_corner, on_face, on_parabola, rolling_on_parabola

import jaxwhisker as jw
from jaxwhisker._base.program import compilations
from jaxwhisker._model.objects import as_one
from scenes import follicle, model

REFERENCE = json.loads((Path(__file__).parents[1] / "data" / "modes.json").read_text())
PRINTED = 1e-6  # the reference has six decimals, and the last one may be off by one
ELEMENTS = 2e-6  # relative error of the third frequency of a beam of 60 cubic elements
CHAIN = 1e-5  # relative error of extrapolated chains of n and 2 n cells, three modes
ROUNDING = 1e-9
FITTED = 1e-6  # relative error of estimates: least squares stop at 1e-7
DIFFERENCES = 1e-6  # relative error of central differences
ROD = jw.Whisker(mass_per_length=1.0)


class Power(eqx.Module):
    """A power of the diameter of a cone, relative to that at the base."""

    taper: float
    power: int = eqx.field(static=True)

    def __call__(self, s):
        return (1 - (1 - self.taper) * s) ** self.power


def heavy(scene, mass=1.0):
    """The scene with a mass per length of 1."""
    return eqx.tree_at(lambda s: s.whisker, scene, jw.Whisker(mass_per_length=mass))


@pytest.fixture(scope="module")
def scanned():
    """A scan of FB, with steps in every phase."""
    return jw.scan(heavy(model("FB")), np.array([0.9, 0.4, 0.1, -0.3, -1.1, -1.5]))


@pytest.fixture(scope="module")
def found(scanned):
    return jw.modes(scanned)


@pytest.mark.parametrize("case", REFERENCE["tapered"], ids=lambda case: str(case["taper"]))
def test_cones(case):
    cone = jw.Whisker(1.0, Power(case["taper"], 4), mass_per_length=Power(case["taper"], 2))
    np.testing.assert_allclose(jw.modes(cone).omega, case["omega"], rtol=0, atol=2 * PRINTED)


def test_a_cone_of_a_density():
    # E = 64e4 / pi and rho = 400 / pi: EI = (10 d)^4 and rho A = (10 d)^2.
    case = REFERENCE["tapered"][1]
    cone = jw.Whisker.conical(1.0, 64e4 / np.pi, 0.1, 0.1 * case["taper"], density=400 / np.pi)
    np.testing.assert_allclose(jw.modes(cone).omega, case["omega"], rtol=0, atol=PRINTED)


def test_a_pointed_cone():
    # Kirchhoff 1879: 8.719; the others are from Naguleswaran 1994.
    cone = jw.Whisker(1.0, Power(0.0, 4), mass_per_length=Power(0.0, 2))
    np.testing.assert_allclose(jw.modes(cone, 3).omega, [8.7193, 21.1457, 38.4538], atol=1e-4)


def test_torsion_springs():
    for case in REFERENCE["on_torsion_spring"]:
        omega = jw.modes(ROD, support=jw.Support.follicle(phi=case["kphi"])).omega
        np.testing.assert_allclose(omega, case["omega"], rtol=0, atol=PRINTED)


def test_a_tip_mass():
    for case in REFERENCE["with_tip_mass"]:
        omega = jw.modes(jw.Whisker(mass_per_length=1.0, tip_mass=case["tip_mass"])).omega
        np.testing.assert_allclose(omega, case["omega"], rtol=0, atol=PRINTED)


def bent(force, mass=1.0):
    return jw.deflect(jw.Whisker(mass_per_length=mass), jw.PointForce(force, direction=0.0))


def test_dead_loads():
    for case in REFERENCE["loaded"]:
        found = jw.modes(bent(case["force"][0]), 3)
        np.testing.assert_allclose(found.omega, case["omega"], rtol=0, atol=PRINTED)


def test_springs_tissue_and_base_masses():
    on_shaft = jw.Support((jw.Spring((0, 1), 50.0, at=0.5), jw.Spring((0, 1), 300.0)))
    tissue = jw.Support(foundation=jw.Foundation(0.0, 0.25, 2000.0), free=("phi",))
    laden = jw.Whisker(mass_per_length=1.0, base_mass=0.5)
    for whisker, support, expected in (
        (ROD, on_shaft, beam(60, spring=(0.5, 50.0), base=300.0)),
        (ROD, tissue, beam(60, tissue=(0.25, 2000.0), base=0.0, angle=0.0)),
        (laden, jw.Support.fb(20.0), beam(60, base=20.0, base_mass=0.5)),
    ):
        found = jw.modes(whisker, 3, support=support)
        np.testing.assert_allclose(found.omega, expected[:3], rtol=ELEMENTS)


def test_rigid_springs_are_a_clamp():
    rigid = jw.modes(ROD, support=jw.Support.fb(jnp.inf))
    np.testing.assert_allclose(rigid.omega, jw.modes(ROD).omega, rtol=ROUNDING)
    stiff = jw.modes(ROD, support=jw.Support.fb(1e12))
    np.testing.assert_allclose(stiff.omega, rigid.omega, rtol=ROUNDING)


def test_other_units():
    # omega scales with sqrt(EI / rho A) / L^2, a mode with 1 / sqrt(rho A L), its reactions with force over mode.
    def follicle(unit):
        return jw.Support.follicle(phi=10.0 * unit)

    one = jw.modes(ROD, support=follicle(1.0), base_damping=(0.0, 0.0, 0.1))
    other = jw.Whisker(0.03, 2e-8, mass_per_length=1.6e-5, tip_mass=0.0)
    rate = np.sqrt(2e-8 / 1.6e-5) / 0.03**2
    drag = 0.1 * 2e-8 / 0.03 / rate
    found = jw.modes(other, support=follicle(2e-8 / 0.03), base_damping=(0.0, 0.0, drag))
    size = 1 / np.sqrt(1.6e-5 * 0.03)
    for actual, expected in (
        (found.omega, one.omega * rate),
        (found.damping_ratio, one.damping_ratio),
        (found.shape, one.shape * size),
        (found.fx, one.fx * size * 2e-8 / 0.03**3),
        (found.mz, one.mz * size * 2e-8 / 0.03**2),
    ):
        np.testing.assert_allclose(actual, expected, rtol=1e-7, atol=1e-9 * float(np.max(np.abs(expected))))
    np.testing.assert_allclose(found.s[0, [0, -1]], [0.0, 0.03])
    np.testing.assert_allclose(found.frequency, found.omega / (2 * np.pi))


def test_shapes_have_unit_mass_and_their_inertia_is_the_reaction():
    found = jw.modes(bent(3.0), 3, points=2001)
    shape, s = np.asarray(found.shape)[:, 0], np.asarray(found.s)[0]
    products = np.trapezoid(np.einsum("kpx,lpx->klp", shape, shape), s)
    np.testing.assert_allclose(products, np.eye(3), atol=1e-5)  # the trapezoidal rule
    force = -(np.asarray(found.omega)[:, None] ** 2) * np.trapezoid(shape, s, axis=1)
    np.testing.assert_allclose(np.stack([found.fx[:, 0], found.fy[:, 0]], axis=1), force, rtol=1e-4, atol=1e-3)
    assert np.all(np.asarray(found.mz) > 0)


def check_contact(result, found, step, contact, forces, rests=False):
    """Compare the frequencies about a step, on a spring of stiffness 70, with those of a chain."""
    names = ("base_x", "fx", "fy", "mz", "contact_arc")
    base_x, fx, fy, mz, arc = (float(getattr(result, name)[step, 0]) for name in names)
    size = 32 if rests else 16  # the modes of a shaft that rests on a face are shorter
    each = [in_contact(base_x, (fx, fy, mz), arc, contact, forces, 70.0, n, rests) for n in (size, 2 * size)]
    for _, miss, slope in each:  # the oracle's chain is in equilibrium
        np.testing.assert_allclose(miss, 0, atol=1e-7)
        np.testing.assert_allclose(slope, 0, atol=1e-7)
    coarse, fine = (frequencies[:3] for frequencies, _, _ in each)
    np.testing.assert_allclose(found.omega[step, :3], (4 * fine - coarse) / 3, rtol=CHAIN)


def contact_of(result, step):
    """Force, position and slope of the contact, and the force of the object on the whisker."""
    names = ("contact_force", "contact_x", "contact_y", "contact_slope", "fx", "fy")
    force, x, y, slope, fx, fy = (float(getattr(result, name)[step, 0]) for name in names)
    return force, x, y, slope, (-fx, -fy)


def test_a_whisker_in_contact_keeps_it(scanned, found):
    for k, phase in ((1, jw.Phase.tip), (3, jw.Phase.tangential)):
        assert scanned.phase[k, 0] == phase
        force, x, *_ = contact_of(scanned, k)
        check_contact(scanned, found, k, on_parabola(0.2, x, phase == jw.Phase.tip), [force])


def test_contacts_with_friction_stick():
    scene = heavy(model("FB"))
    rough = jw.Scene(scene.whisker, scene.profile, scene.support, friction=0.3)
    result = jw.scan(rough, np.array([0.9, 0.4, 0.1, -0.3, -0.28, -1.1]))
    found = jw.modes(result)
    assert list(result.phase[1:5, 0]) == [jw.Phase.tip, *[jw.Phase.tangential] * 3]
    assert result.slip is not None and result.slip[1, 0] != 0 and result.slip[4, 0] == 0
    for k in (1, 4):
        _, x, y, _, pushes = contact_of(result, k)
        contact = held_at(x, y) if k == 1 else rolling_on_parabola(0.2, x)
        check_contact(result, found, k, contact, pushes)


def test_edges_and_straight_faces():
    polygon = jw.Polygon([(-0.45, 0.7), (-0.3, 0.35), (0.1, 0.2), (0.4, 0.35), (0.45, 0.75)])
    scene = jw.Scene(ROD, polygon, jw.Support.fb(70.0, 0.2))
    result = jw.scan(scene, np.array([0.5, -0.018, -0.191, -0.882, -1.055, -1.4]))
    found = jw.modes(result)
    np.testing.assert_allclose(found.omega[0], jw.modes(scene).omega, rtol=ROUNDING)
    assert list(result.phase[1:5, 0]) == [*[jw.Phase.tangential] * 3, jw.Phase.tip]
    for k in (1, 2, 4):
        force, x, y, slope, _ = contact_of(result, k)
        contact = on_corner(x, y) if k == 1 else on_face(x, y, slope)
        check_contact(result, found, k, contact, [force], rests=k == 2)


def test_one_of_several_objects():
    first, second = jw.Parabola(0.2, 4.0), jw.Parabola(0.3, 2.0, -3.0)
    control = np.array([0.9, 0.3, -0.3, -1.5, -2.9, -3.3])
    both, *alone = (
        jw.scan(eqx.tree_at(lambda s: s.profile, heavy(model("FB")), one), control)
        for one in (as_one((first, second)), first, second)
    )
    on = np.ravel(jnp.asarray(both.contact_object))
    assert set(on) == {0, 1, 2}
    found, *apart = (jw.modes(result) for result in (both, *alone))
    for name in ("omega", "fx", "mz"):
        on_first, on_second = (getattr(one, name) for one in apart)
        expected = np.where(on.reshape(-1, *[1] * (on_first.ndim - 1)) == 2, on_second, on_first)
        np.testing.assert_allclose(getattr(found, name), expected, rtol=1e-7, err_msg=name)
    np.testing.assert_allclose(found.omega[3], jw.modes(both.scene).omega, rtol=ROUNDING)


def turned(angle, mount=0.0, x=70.0, motion=None, start=1.0):
    """Modes about the last step of a scan that ends where the object is turned by this angle about the base."""
    profile = jw.Tilted(jw.Parabola(0.2, 1.0, 0.2), angle)
    support = follicle(x=x, y=500.0, phi=50.0, mount=(0.0, 0.0, mount))
    scene = jw.Scene(
        jw.Whisker(mass_per_length=1.0, base_mass=0.2), profile, support, motion=motion or jw.Translation()
    )
    result = jw.scan(scene, np.array([start, (start + angle) / 2, 0.0 if motion is None else angle]))
    return jw.modes(result, 3, step=2, base_damping=(1.0, 2.0, 0.1), points=5)


def test_turned_drives_and_mounts():
    # Turning everything about the base changes the directions of reactions and shapes, but nothing else.
    angle = 0.2
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    rotated = turned(angle, motion=jw.Rotation(), start=-1.2)
    # The axes of springs turn with the drive but not with the mount, where they must all be equally stiff.
    leaning = turned(angle, mount=angle, x=500.0)
    for actual, expected in ((rotated, turned(0.0)), (leaning, turned(0.0, x=500.0))):
        for name in ("omega", "damping_ratio", "mz"):
            np.testing.assert_allclose(getattr(actual, name), getattr(expected, name), rtol=1e-7, err_msg=name)
        forces = np.stack([expected.fx, expected.fy], axis=-1) @ turn
        np.testing.assert_allclose(np.stack([actual.fx, actual.fy], axis=-1), forces, rtol=1e-7)
        np.testing.assert_allclose(actual.shape, expected.shape @ turn, atol=1e-7)


def test_steps_of_a_result(scanned, found):
    free = jw.modes(scanned.scene)
    np.testing.assert_allclose(found.omega[0], free.omega, rtol=ROUNDING)
    np.testing.assert_allclose(found.shape[0], free.shape, atol=1e-7)
    one = jw.modes(scanned, step=3)
    for name in ("omega", "shape", "mz", "s", "status"):
        actual, expected = getattr(one, name), getattr(found, name)
        np.testing.assert_allclose(actual, expected if name == "s" else expected[3], rtol=1e-9, atol=1e-9)
    assert found.shape.shape == (6, 4, 1, 65, 2)


@pytest.mark.parametrize("stiffness", [np.inf, 70.0])
def test_the_lowest_frequency_vanishes_at_a_fold(stiffness):
    # omega^2 falls with the square root of the distance to the fold, in the control.
    scene = heavy(model("FB", stiffness=stiffness))
    fold = jw.scan(scene, np.array([0.9, -1.9])).events.of(jw.EventKind.snap_off)[0].control
    distance = np.array([1e-4, 1e-5, 1e-6])
    found = jw.modes(jw.scan(scene, np.concatenate([[0.9], fold + distance, [-1.9]])), 1)
    quotient = np.asarray(found.omega)[1:4, 0] ** 4 / distance
    np.testing.assert_allclose(quotient, quotient[-1], rtol=0.05)
    assert found.omega[3, 0] < 0.5 < jw.modes(scene).omega[0]


def test_a_buckled_equilibrium_is_unstable():
    def compressed(force):
        return jw.modes(jw.deflect(ROD, jw.PointForce(force, direction=-np.pi / 2)), 2)

    euler = np.pi**2 / 4
    assert 0 < compressed(0.999 * euler).omega[0] < 0.2
    unstable = compressed(1.001 * euler)
    assert unstable.status == jw.Status.unstable
    assert np.isnan(unstable.omega).all() and np.isnan(unstable.shape).all()


def test_damping_ratios():
    support = jw.Support.fb(20.0)
    found = jw.modes(ROD, support=support, mass_damping=0.1, stiffness_damping=0.01, base_damping=2.0)
    base = np.asarray(found.shape)[:, 0, 0, 0]
    expected = (0.1 / found.omega + 0.01 * found.omega + 2.0 * base**2 / found.omega) / 2
    np.testing.assert_allclose(found.damping_ratio, expected, rtol=1e-6)


def measured(parameters):
    """Frequencies, shapes and reactions of scans, by distance, bending stiffness and tip mass."""
    distance, stiffness, tip = parameters
    whisker = jw.Whisker(1.0, stiffness, mass_per_length=1.0, tip_mass=tip)
    scene = jw.Scene(whisker, jw.Parabola(distance), jw.Support.fb(70.0))
    found = jw.modes(jw.scan(scene, np.array([0.9, 0.1, -1.1])), 2)
    return jnp.concatenate([found.omega.ravel(), found.shape[:, 0, 0, 32, 0], found.mz[:, 1, 0]])


def test_derivatives_and_batches():
    at = jnp.array([0.2, 1.0, 0.1])
    forward, backward = jax.jacfwd(measured)(at), jax.jacrev(measured)(at)
    np.testing.assert_allclose(backward, forward, rtol=1e-8, atol=1e-8)
    batch = np.asarray(at) + 1e-4 * np.concatenate([np.eye(3), -np.eye(3)])
    several = jax.vmap(measured)(jnp.asarray(batch))
    differences = (several[:3] - several[3:]).T / 2e-4
    np.testing.assert_allclose(forward, differences, rtol=DIFFERENCES, atol=1e-4)
    np.testing.assert_allclose(several[0], measured(batch[0]), rtol=1e-9)


def softened(compliance, mass):
    support = jw.Support((jw.Spring((0, 1), compliance=compliance, axis="phi"),))
    return jw.modes(jw.Whisker(mass_per_length=mass), 2, support=support, points=2).omega


def test_derivatives_at_a_rigid_support_and_inside_jit():
    np.testing.assert_allclose(jax.jit(softened)(0.1, 2.0), softened(0.1, 2.0), rtol=1e-9)
    by_compliance, by_mass = jax.jacrev(softened, argnums=(0, 1))(0.0, 2.0)
    # A torsion spring of 1 / compliance lowers omega^2 by mz^2 compliance.
    rigid = jw.modes(jw.Whisker(mass_per_length=2.0), 2)
    np.testing.assert_allclose(by_compliance, -(rigid.mz[:, 0] ** 2) / (2 * rigid.omega), rtol=1e-7)
    np.testing.assert_allclose(by_mass, -rigid.omega / 4, rtol=1e-7)
    second = jax.jacfwd(jax.jacrev(softened, argnums=1), argnums=1)(0.1, 2.0)
    np.testing.assert_allclose(second, 3 / 16 * softened(0.1, 2.0), rtol=1e-6)


def test_a_batch_with_invalid_masses():
    def one(mass):
        found = jw.modes(jw.Whisker(mass_per_length=mass), 2, points=2)
        return found.omega, found.status

    omega, status = jax.vmap(one)(jnp.array([1.0, -1.0, 4.0]))
    assert list(status) == [jw.Status.ok, jw.Status.invalid, jw.Status.ok]
    assert np.isnan(omega[1]).all()
    np.testing.assert_allclose(omega[2], omega[0] / 2, rtol=ROUNDING)
    slope = jax.grad(lambda mass: jnp.nansum(jax.vmap(one)(mass)[0]))(jnp.array([1.0, -1.0, 4.0]))
    assert slope[1] == 0 and np.isfinite(slope).all()


def test_failed_steps_stay_failed(scanned):
    failed = eqx.tree_at(lambda r: r.status, scanned, scanned.status.at[2].set(jw.Status.lost))
    failed = eqx.tree_at(lambda r: r.fx, failed, failed.fx.at[2].set(jnp.nan))
    found = jw.modes(failed)
    assert found.status[2] == jw.Status.lost
    assert np.isnan(found.omega[2]).all() and np.isnan(found.damping_ratio[2]).all()
    assert np.isfinite(np.delete(found.omega, 2, axis=0)).all()


def test_whiskers_on_one_network_vibrate_together():
    found = jw.modes(ROD, 2, support=jw.Support.fbfb(70.0))
    # Without mass, the bases would be springs in series; the second whisker moves more, in the first mode alike.
    moved = np.asarray(found.shape)[:, :, 0, 0]
    assert moved[0, 0] / moved[0, 1] > 0 > moved[1, 0] / moved[1, 1]
    assert found.shape.shape == (2, 2, 65, 2) and found.mz.shape == (2, 2)


def frequencies(result):
    return {"omega": jw.modes(result).omega[:, :2]}


def vibrating(stiffness, mass):
    return heavy(model("FB", stiffness=stiffness), mass)


def test_measured_frequencies_give_stiffness_and_mass():
    control, truth, sigma = np.linspace(0.7, -1.2, 11), {"stiffness": 70.0, "mass": 1.2}, 0.05

    def measured(**values):
        return frequencies(jw.scan(vibrating(**values), control))["omega"]

    omega = measured(**truth)
    table = {"control": control, "omega_1": omega[:, 0], "omega_2": omega[:, 1]}
    guess = {"stiffness": 100.0, "mass": 0.8}
    fit = jw.identify(vibrating, guess, table, channels=frequencies, sigma=sigma, snaps=False, starts=0)
    assert fit.status == jw.FitStatus.ok
    # The curvature of the misfit at its minimum, from differences of frequencies.
    rates = []
    for name, value in truth.items():
        more, less = (measured(**truth | {name: value * (1 + step)}) for step in (1e-4, -1e-4))
        rates.append(np.ravel(more - less) / (2e-4 * value * sigma))
    errors = np.sqrt(np.diag(np.linalg.inv(np.array(rates) @ np.array(rates).T)))
    for (name, value), error in zip(truth.items(), errors, strict=True):
        assert fit.estimates[name] == pytest.approx(value, rel=FITTED), name
        assert fit.standard_error[name] == pytest.approx(error, rel=1e-5), name


def test_a_map_of_frequencies_by_a_study(scanned, found):
    data = jw.study(
        lambda stiffness, distance: heavy(model("FB", stiffness=stiffness, distance=distance)),
        control=scanned.control,
        stiffness=[70.0, 40.0, -1.0],
        distance=[scanned.scene.profile.distance],
        outputs=(),
        channels=lambda result: {"omega": jw.modes(result).omega},
    )
    omega = np.stack([data[f"omega_{k}"] for k in (1, 2, 3, 4)], axis=-1)[:, 0]
    assert np.isnan(omega[2]).all()
    np.testing.assert_allclose(omega[0], found.omega, rtol=ROUNDING)
    softer = jw.modes(jw.scan(heavy(model("FB", stiffness=40.0)), scanned.control))
    np.testing.assert_allclose(omega[1], softer.omega, rtol=ROUNDING)
    assert np.all(omega[1, 0] < omega[0, 0])


def test_a_scan_pays_nothing_for_masses(scanned):
    before = compilations()
    jw.scan(model("FB", distance=0.21), np.array([0.9, 0.4, 0.1, -0.3, -1.1, -1.5]))
    assert compilations() == before
    code = "import sys, jaxwhisker; print([name for name in sys.modules if 'dynamics' in name])"
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert run.stdout.strip() == "[]"


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: jw.modes(3), "`at` must be a Whisker, Sensor, Scene, Deflection or Result, got 3"),
        (lambda: jw.modes(jw.Whisker()), "`mass_per_length` must be given for all whiskers that vibrate"),
        (lambda: jw.modes(ROD, 0), "`count` must be a positive int, got 0"),
        (lambda: jw.modes(ROD, 13), "`count` must be at most 12, got 13"),
        (lambda: jw.modes(ROD, points=1), "`points` must be an int of at least 2, got 1"),
        (lambda: jw.modes(ROD, support=3), "`support` must be a Support, got 3"),
        (lambda: jw.modes(jw.Sensor(ROD), support=jw.Support.fb(1.0)), "`support` must be that of a Whisker"),
        (lambda: jw.modes(ROD, step=1), "`step` must be None unless `at` is a Result, got 1"),
        (lambda: jw.modes(ROD, mass_damping=-1.0), "`mass_damping` must be a non-negative finite number, got -1"),
        (lambda: jw.modes(ROD, stiffness_damping="1"), "`stiffness_damping` must be a non-negative finite number"),
        (lambda: jw.modes(ROD, base_damping=(0.0, -1.0, 0.0)), "`base_damping` must be a non-negative finite number"),
        (lambda: jw.modes(ROD, base_damping=(0.0, 1.0)), "`base_damping` must be a number, or a tuple of three"),
        (lambda: jw.modes(ROD, support=jw.Support.hill(2)), "without springs between the shafts of two whiskers"),
        (
            lambda: jw.modes(jw.deflect(ROD, jw.PointForce(1.0, follower=True))),
            "`at` must be a Deflection under dead loads: a follower force has no potential",
        ),
    ],
)
def test_wrong_arguments(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.unchecked
def test_wrong_steps(scanned):
    for step in (6, -7, 1.0, True):
        with pytest.raises(ValueError, match="`step` must be an int from -6 to 5"):
            jw.modes(scanned, step=step)
    batch = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), scanned)
    with pytest.raises(ValueError, match="`at` must be the Result of a single scan"):
        jw.modes(batch)


RITZ = 1e-7  # of frequencies by Rayleigh and Ritz with polynomials of degree 12


def ritz(weight, spring, at):
    """Frequencies of an upright whisker under its weight: clamped, or held at one place by a spring across."""
    powers, beyond = np.arange(2, 11), np.arange(3, 7)
    s, w = np.polynomial.legendre.leggauss(20)
    s, w = np.concatenate([at * (s + 1) / 2, at + (1 - at) * (s + 1) / 2]), np.concatenate([at * w, (1 - at) * w]) / 2

    def functions(s, order):
        # The base moves along x with the spring, and does not turn. The shear force jumps at the spring.
        factor = np.array([np.prod(np.arange(p - order + 1, p + 1)) for p in (*powers, *beyond)])[:, None]
        plain = [s**p for p in powers - order] + [np.maximum(s - at, 0.0) ** p for p in beyond - order]
        constant = np.full((int(spring > 0), np.size(s)), float(order == 0))
        return np.concatenate([constant, factor * np.reshape(plain, (-1, np.size(s)))])

    value, slope, bend = (functions(s, order) for order in (0, 1, 2))
    stiffness = (bend * w) @ bend.T - weight * ((slope * w * (1 - s)) @ slope.T)
    here = functions(np.array([at]), 0)
    return np.sqrt(scipy.linalg.eigh(stiffness + spring * here @ here.T, (value * w) @ value.T, eigvals_only=True)[:3])


@pytest.mark.parametrize("spring", [0.0, 70.0])
def test_weight_lowers_frequencies_with_and_without_springs_on_the_shaft(spring):
    support = jw.Support((jw.Spring((0, 1), spring, 0.0, at=0.5),)) if spring else jw.Support.clamped()
    whisker = jw.Whisker(mass_per_length=2.0)
    for weight in (0.0, 4.0):
        bent = jw.deflect(whisker, gravity=(0.0, -weight / 2), support=support, points=3)
        found = jw.modes(bent, count=3)
        np.testing.assert_allclose(found.omega * np.sqrt(2), ritz(weight, spring, 0.5), rtol=RITZ)
