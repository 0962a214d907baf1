"""Bending and strain along shafts, against an independent integration of the rod from its base to its contacts."""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxwhisker as jw
import several
from scenes import check_derivatives, cone, model, step_nearest

CONTROL = np.linspace(0.8, -1.6, 64)  # also that of test_shapes.py, for the same programs
AT = np.array([0.0, 0.013, 0.2, 0.5, 0.77, 0.95])  # arc lengths
EXACT = 1e-9  # of moments up to 3: the tolerance of the independent integration, and 16 integration steps
SECTIONS = 2e-8  # of whiskers that are not uniform, of moments below 1 and curvatures up to 7: 64 steps of order 6
CHORDS = 1e-4  # of the linear interpolation between 200 points of a shaft
VISIBLE = 1e-3  # moments that an error would change
RECOVERED = 1e-6  # relative: least squares stop at 1e-7
DIFFERENCES = 1e-6  # of central differences with a step of 1e-5


@cache
def scanned():
    return jw.scan(model("FB"), CONTROL)


def contacts_of(result, step, whisker):
    """Arc length, position and force of all contacts, from the base to the tip."""
    names = ("contact_arc", "contact_x", "contact_y", "contact_force", "contact_slope")
    fields = [np.ravel(getattr(result, name)[step, whisker]) for name in names]
    found = [(s, x, y, f * np.sin(slope), -f * np.cos(slope)) for s, x, y, f, slope in zip(*fields, strict=True)]
    return sorted(contact for contact in found if contact[0] > 0)


def moments(result, step, whisker=0, stiffness=lambda s: 1.0, curvature=0.0):
    """Internal moments at `AT`, of the rod that is bent by the forces of its contacts alone."""
    base = [float(getattr(result, name)[step, whisker]) for name in ("base_x", "base_y", "base_angle")]
    state, s0, found = np.array([*base[:2], base[2] + np.pi / 2]), 0.0, np.zeros(AT.size)
    contacts = contacts_of(result, step, whisker)
    for k, (s1, *_) in enumerate(contacts):

        def moment(z, beyond=contacts[k:]):
            return sum((x - z[0]) * fy - (y - z[1]) * fx for _, x, y, fx, fy in beyond)

        def rate(s, z, moment=moment):
            return [np.cos(z[2]), np.sin(z[2]), curvature + moment(z) / stiffness(s)]

        solution = solve_ivp(rate, (s0, s1), state, rtol=1e-12, atol=1e-12, dense_output=True)
        here = (s0 <= AT) & (s1 > AT)
        found[here] = moment(solution.sol(AT[here])) if here.any() else 0.0
        state, s0 = solution.y[:, -1], s1
    return found


@pytest.mark.parametrize("name", ["one contact", "two contacts"])
def test_moments_are_those_of_the_forces_of_contacts(name):
    result = scanned() if name == "one contact" else several.scanned()
    steps = np.flatnonzero(np.all(result.contact_arc > 0, axis=(1, 2) if name == "two contacts" else 1))[::2]
    bent = jw.bending(result, AT)
    assert steps.size > 3 and bent.moment.shape == (result.control.size, 1, AT.size)
    for step in steps:
        np.testing.assert_allclose(bent.moment[step, 0], moments(result, step), atol=EXACT)
    np.testing.assert_array_equal(bent.moment, bent.curvature)  # EI = 1
    np.testing.assert_allclose(bent.moment[..., 0], -result.mz, atol=EXACT)


@pytest.mark.parametrize("ratio", [0.3, 0.05])
def test_bending_of_a_curved_cone(ratio):
    result = jw.scan(jw.Scene(cone(ratio, curvature=(0.4, 0.4)), jw.Parabola(0.2)), CONTROL)
    bent, stiffness = jw.bending(result, AT), (1 - (1 - ratio) * AT) ** 4
    for step in np.flatnonzero(result.contact_arc[:, 0] > 0)[::6]:
        exact = moments(result, step, stiffness=lambda s: (1 - (1 - ratio) * s) ** 4, curvature=0.4)
        np.testing.assert_allclose(bent.moment[step, 0], exact, atol=SECTIONS)
        np.testing.assert_allclose(bent.curvature[step, 0], exact / stiffness, atol=SECTIONS)


def test_springs_and_foundations_bend_a_shaft_below_them():
    support = jw.Support((jw.Spring((0, 1), 30.0, 0.02, at=0.1),), foundation=jw.Foundation(0.12, 0.3, 60.0))
    result = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.3), support), CONTROL)
    bent, beyond = np.asarray(jw.bending(result, AT).moment), AT > 0.3
    np.testing.assert_allclose(bent[..., 0], -result.mz, atol=EXACT)
    free, lines = np.asarray(result.contact_arc)[:, 0] == 0, jw.shapes(result, points=201)
    assert free.any() and np.all(bent[free][:, 0, ~beyond] != 0) and np.abs(bent[free][:, 0, beyond]).max() < EXACT
    for step in np.flatnonzero(~free)[::6]:
        ((arc, x, y, fx, fy),) = contacts_of(result, step, 0)
        # The points are equidistant from the base to the contact.
        s, x0, y0 = arc * np.linspace(0.0, 1.0, 200), lines.x[step, 0, :-1], lines.y[step, 0, :-1]
        exact = np.interp(AT, s, (x - x0) * fy - (y - y0) * fx, right=0.0)
        np.testing.assert_allclose(bent[step, 0, beyond], exact[beyond], atol=CHORDS)


def test_free_parts_are_not_strained():
    result = scanned()
    strain = np.asarray(jw.strain(result, AT, 0.01))[:, 0]
    arc, ok = np.asarray(result.contact_arc)[:, :1], np.asarray(result.status) == jw.Status.ok
    assert np.all(strain[(arc <= AT) & ok[:, None]] == 0) and np.any(arc <= AT)
    assert np.all(strain[(arc > AT) & ok[:, None]] != 0)


def test_a_scan_that_fails_leaves_its_neighbours_unaffected():
    each = jax.vmap(lambda c: jw.strain(jw.scan(model("FB", c), CONTROL), AT, 0.01))(jnp.array([70.0, -1.0]))
    np.testing.assert_allclose(each[0], jw.strain(scanned(), AT, 0.01), atol=EXACT)
    assert np.isnan(each[1]).all()


def test_the_right_side_of_a_whisker_that_bends_to_the_right_is_pressed():
    result = scanned()
    step = step_nearest(result, 0.1)
    assert result.fx[step, 0] != 0
    bent = jw.bending(result, AT)
    side = jw.strain(result, AT, 0.01, np.array([0.0, np.pi, np.pi / 2, 0.0, 0.0, 0.0]))[step, 0]
    np.testing.assert_allclose(side[:2], 0.01 * bent.curvature[step, 0, :2] * np.array([1, -1]), atol=EXACT)
    assert abs(side[2]) < EXACT
    # The tip is displaced to the side to which the shaft is bent: its right side is pressed if that is the right one.
    tip = jw.shapes(result).x[step, 0, -1] - result.base_x[step, 0]
    assert np.sign(side[0]) == -np.sign(tip)


def in_space(roll=0.0, curvature=0.4, ratio=2 / 3, offset=0.2):
    """A curved whisker that passes a sphere to its side."""
    drive = jw.LinearDrive((-1.0, 0.0, 0.0), (0.0, 0.0, offset))
    whisker = jw.Whisker(intrinsic_curvature=curvature, torsion_ratio=ratio)
    support = jw.Support(mount=jw.Mount(roll=roll))
    return jw.SpaceScene(whisker, jw.Sphere(1.0, (0.0, 1.3, 0.0)), support, motion=drive)


def moments_in_space(result, step, curvature, ratio):
    """Internal moments about d1, d2 and d3 at `AT`."""
    names = ("contact_x", "contact_y", "contact_z", "fx", "fy", "fz", "base_x", "base_y", "base_z")
    numbers = np.array([float(getattr(result, name)[step, 0]) for name in names])
    contact, force, base = numbers[:3], -numbers[3:6], numbers[6:]

    def moment(z):
        return np.reshape(z[3:], (3, 3)).T @ np.cross(contact - z[:3], force)

    def rate(s, z):
        k1, k2, k3 = moment(z) / [1.0, 1.0, ratio] - [0.0, curvature, 0.0]
        axes = np.reshape(z[3:], (3, 3))
        return np.append(axes[:, 2], axes @ [[0.0, -k3, k2], [k3, 0.0, -k1], [-k2, k1, 0.0]])

    start = np.append(base, np.asarray(result.base_rotation)[step, 0])
    arc = float(result.contact_arc[step, 0])
    solution = solve_ivp(rate, (0.0, arc), start, rtol=1e-12, atol=1e-12, dense_output=True)
    return np.array([moment(solution.sol(s)) if s < arc else np.zeros(3) for s in AT])


def test_bending_and_torsion_in_space():
    result = jw.scan(in_space(0.7), CONTROL)
    bent, touching = jw.bending(result, AT), np.flatnonzero(result.contact_arc[:, 0] > 0)
    assert touching.size > 10 and bent.moment.shape == (CONTROL.size, 1, AT.size, 3)
    for step in touching[::6]:
        exact = moments_in_space(result, step, 0.4, 2 / 3)
        np.testing.assert_allclose(bent.moment[step, 0], exact, atol=EXACT)
        np.testing.assert_allclose(bent.curvature[step, 0], exact / [1.0, 1.0, 2 / 3], atol=EXACT)
        assert np.abs(exact[0]).min() > VISIBLE  # all three parts
    # A fibre at d1 is stretched by a bend to the other side, about -d2, and one at d2 by a bend about d1.
    for direction, part in ((0.0, -bent.curvature[..., 1]), (np.pi / 2, bent.curvature[..., 0])):
        np.testing.assert_allclose(jw.strain(result, AT, 0.02, direction), 0.02 * part, atol=EXACT)


def test_failed_steps_and_places_that_a_whisker_does_not_have_are_nan():
    results: list[Any] = [scanned(), jw.scan(in_space(0.7), CONTROL)]
    for result in results:
        fields = {name: getattr(result, name) for name in type(result).__dataclass_fields__}
        whole = {name: value for name, value in fields.items() if isinstance(value, jax.Array) and name != "control"}
        # As scans do: failed steps are NaN, or zero if they are integers.
        failed = {n: v.at[20].set(0 if jnp.issubdtype(v.dtype, jnp.integer) else jnp.nan) for n, v in whole.items()}
        broken: Any = type(result)(**fields | failed)
        strain = jw.strain(broken, AT, 0.01)
        assert np.isnan(strain[20]).all()
        np.testing.assert_array_equal(np.delete(strain, 20, 0), np.delete(jw.strain(result, AT, 0.01), 20, 0))
        outside = jax.jit(lambda at, result=result: jw.bending(result, at).moment)(np.array([-0.1, 0.2, 1.1]))
        assert np.isnan(outside[:, :, [0, 2]]).all() and np.isfinite(outside[:, :, 1]).all()


def test_space_agrees_with_the_plane_and_turns_with_the_whisker():
    control = np.linspace(1.0, 0.1, 64)
    plane = jw.strain(jw.scan(jw.Scene(jw.Whisker(), jw.Circle(0.3, 1.0)), control), AT, 0.01)
    drive, ball = jw.LinearDrive((1.0, 0.0, 0.0)), jw.Sphere(1.0, (0.0, 1.3, 0.0))
    for roll in (0.0, 0.7):
        scene = jw.SpaceScene(jw.Whisker(), ball, jw.Support(mount=jw.Mount(roll=roll)), motion=drive)
        found = jw.strain(jw.scan(scene, -control), AT, 0.01, -roll)  # the mirror image
        np.testing.assert_allclose(found, -plane, atol=EXACT)


def test_derivatives():
    result = scanned()
    step = step_nearest(result, 0.1)

    def strains(p):
        c, q, s, distance = p
        found = jw.scan(model("FB", stiffness=c, distance=q), CONTROL)
        return jnp.ravel(jw.strain(found, jnp.stack([0.5 * s, s]), distance)[jnp.array([step, step + 4])])

    p = jnp.array([70.0, 0.2, 0.4, 0.01])
    check_derivatives(strains, p, seed=1, differences=DIFFERENCES, visible=VISIBLE)


def test_traced_and_batched_results_give_the_same():
    result = scanned()
    own = jw.strain(result, AT, 0.01, 0.3)
    traced = jax.jit(lambda at, distance: jw.strain(result, at, distance, 0.3))(AT, 0.01)
    np.testing.assert_allclose(traced, own, atol=EXACT)
    batch = jax.vmap(lambda distance: jw.strain(result, AT, distance, 0.3))(jnp.array([0.01, 0.02]))
    np.testing.assert_allclose(batch, np.stack([own, 2 * own]), atol=EXACT)


def test_fibres_identify_a_scene():
    def gauges(result):
        return {"fibre": jw.strain(result, [0.1, 0.3, 0.5], 0.01)[:, 0]}

    measured = gauges(scanned())["fibre"]
    columns = {"control": CONTROL} | {f"fibre_{k}": measured[:, k - 1] for k in (1, 2, 3)}
    guess = {"stiffness": 90.0, "distance": 0.22}
    fit = jw.identify(
        lambda stiffness, distance: model("FB", stiffness, 0.2, distance), guess, columns, channels=gauges
    )
    assert fit.status == jw.FitStatus.ok
    assert fit.estimates["stiffness"] == pytest.approx(70.0, rel=RECOVERED)
    assert fit.estimates["distance"] == pytest.approx(0.2, rel=RECOVERED)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda result: jw.strain(result, [0.2, 1.2], 0.01), "`at` must be arc lengths between 0 and 1"),
        (lambda result: jw.strain(result, [-0.1], 0.01), "`at` must be arc lengths between 0 and 1"),
        (lambda result: jw.bending(result, 0.2), "`at`"),
        (lambda result: jw.strain(result, AT, [0.01, 0.02]), "`distance` must be a number or an array of shape"),
        (lambda result: jw.strain(result, AT, 0.01, "left"), "`direction`"),
        (lambda result: jw.bending(result.scene, AT), "`result` must be the Result of a scan"),
    ],
)
def test_errors(call, message):
    with pytest.raises(ValueError, match=message):
        call(scanned())
