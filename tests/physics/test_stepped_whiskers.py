"""Whiskers whose stiffness, curvature and mass jump: against scipy, exact frequencies, derivatives by breaks."""

# pyright: reportArgumentType=false, reportCallIssue=false, reportOptionalMemberAccess=false
# pyright: reportAttributeAccessIssue=false

import diffrax
import equinox as eqx
import forward
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxwhisker as jw
from engine import dimensionless
from functions import Step
from jaxwhisker._rod import rod
from scenes import all_ok, check_derivatives

EXACT = 1e-8  # of signals relative to their size, with 32 steps
ROD = 1e-10  # of rods that scipy integrates to 1e-12
STAGES = 1e-9  # of rods that a solver with stages at both ends of its steps integrates
ROUNDING = 1e-12  # the same steps in another order
FREQUENCIES = 1e-9  # relative, of elements
MEETING = 1e-8  # of derivatives; two arcs share a break in proportion to rounding over 1e-6
DIFFERENCES = 1e-6  # relative: central differences lose half the digits
VISIBLE = 1e-2  # least relative change of weighted values when a parameter doubles

PLACE_AND_HEIGHT = jnp.array([0.37, 0.4])  # of a jump


def stepped(at=0.37, above=0.4, curvature=(0.1, 0.4), mass=None):
    """A whisker whose stiffness changes from 1 at a break, and whose curvature changes there, too."""
    return jw.Whisker(1.0, Step(at, 1.0, above), Step(at, *curvature), mass_per_length=mass, breaks=(at,))


def loaded(whisker, force=(1.0, 0.7), at=0.9):
    outer = jw.PointForce(force[0], position=at, direction=0.4)
    return jw.deflect(whisker, outer, jw.PointForce(force[1], position=0.5, direction=0.0))


def scene(whisker):
    return jw.Scene(whisker, jw.Parabola(0.2), jw.Support.fb(70.0, 0.2), rod=jw.Shooting(steps=16), detect=())


CONTROL = np.linspace(0.7, -0.9, 9)


@pytest.fixture(scope="module")
def scanned():
    return jw.scan(scene(stepped()), CONTROL)


def test_a_scan_against_forward_shooting(scanned):
    assert all_ok(scanned)
    own = forward.Rod(
        1.0,
        lambda s: np.where(s < 0.37, 1.0, 0.4),
        lambda s: np.where(s < 0.37, 0.1, 0.4),
        breaks=(0.37,),
    )
    largest = {name: np.max(np.abs(getattr(scanned, name))) for name in ("fx", "fy", "mz")}
    phases = set()
    for k in (1, 3, 5, 7):
        phase = int(scanned.phase[k, 0])
        guess = (scanned.contact_force[k, 0], scanned.contact_slope[k, 0], scanned.contact_arc[k, 0])[: phase + 1]
        exact = forward.equilibrium(
            drive=(CONTROL[k], 0.0, 0.0),
            rods=[own],
            springs=(((0, 1), 70.0, 0.2, "x"),),
            profile=forward.parabola(0.2),
            guess=[tuple(1.001 * float(value) for value in guess)],
        )
        for name, size in largest.items():
            assert abs(getattr(scanned, name)[k, 0] - getattr(exact, name)[0]) < EXACT * size, (k, name)
        phases.add(phase)
    assert phases == {jw.Phase.tip, jw.Phase.tangential}


def test_the_energy_of_a_stepped_whisker_is_the_work_of_the_drive(scanned):
    # Between two positions of a smooth stretch, the energy changes by the integral of fx.
    control = np.polynomial.legendre.leggauss(9)[0] * 0.05 + 0.1
    weights = np.polynomial.legendre.leggauss(9)[1] * 0.05
    result = jw.scan(scanned.scene, np.concatenate([[0.15], control[::-1], [0.05]]))
    energy = jw.stored_energy(scanned.scene, result)
    work = np.sum(weights * np.asarray(result.fx)[1:-1, 0][::-1])
    assert float(energy[0] - energy[-1]) == pytest.approx(work, rel=1e-7)


def test_derivatives_of_signals_by_a_break():
    control = jnp.array([0.3, -0.2, -0.6])

    def signals(p):
        result = jw.scan(scene(stepped(p[0], p[1])), control)
        return jnp.concatenate([result.fx[:, 0], result.mz[:, 0]])

    check_derivatives(signals, PLACE_AND_HEIGHT, seed=1, differences=DIFFERENCES, visible=VISIBLE)


def test_derivatives_of_a_deflection_by_a_break():
    def values(p):
        bent = loaded(stepped(p[0], p[1]))
        return jnp.stack([bent.mz, bent.x[-1], bent.y[-1]])

    check_derivatives(values, PLACE_AND_HEIGHT, seed=1, differences=DIFFERENCES, visible=VISIBLE)


@pytest.mark.parametrize("whisker", [stepped(), stepped(0.9), stepped(0.37, 0.01)], ids=["middle", "at load", "soft"])
def test_a_deflection_against_scipy(whisker):
    force = (0.01, 0.02) if whisker.bending_stiffness.above < 0.1 else (1.0, 0.7)
    bent = loaded(whisker, force)
    assert bent.status == jw.Status.ok
    at, above = float(whisker.breaks[0]), float(whisker.bending_stiffness.above)
    outer = np.array([np.cos(0.4), np.sin(0.4)]) * force[0]
    inner = np.array([force[1], 0.0])
    base = -np.array([float(bent.fx), float(bent.fy)])
    np.testing.assert_allclose(base, outer + inner, atol=ROD)
    state = np.array([0.0, 0.0, np.pi / 2])
    moment, load, begin = -float(bent.mz), outer + inner, 0.0
    for stop, taken in ((0.5, inner), (0.9, outer)):
        x0, y0 = state[:2]

        def rate(s, r, x0=x0, y0=y0, moment=moment, load=load):
            bending = moment - (r[0] - x0) * load[1] + (r[1] - y0) * load[0]
            curvature = np.where(s < at, 0.1, 0.4) + bending / np.where(s < at, 1.0, above)
            return np.array([np.cos(r[2]), np.sin(r[2]), curvature])

        shift = begin
        state = forward.integrated(
            lambda s, r, rate=rate, shift=shift: rate(s + shift, r),
            tuple(state),
            stop - begin,
            tuple(b - begin for b in (at,) if b > begin),
        )
        moment += -(state[0] - x0) * load[1] + (state[1] - y0) * load[0]
        load, begin = load - taken, stop
        here = int(np.argmin(np.abs(np.asarray(bent.s) - stop)))
        np.testing.assert_allclose([bent.x[here], bent.y[here], bent.angle[here]], state, atol=EXACT)
    assert abs(moment) < EXACT


def beam(at, stiffness, mass):
    """Angular frequencies of a clamped beam that changes at a point: zeros of its determinant."""

    def waves(k, x):
        c, s, ch, sh = np.cos(k * x), np.sin(k * x), np.cosh(k * x), np.sinh(k * x)
        rows = [[c, s, ch, sh], [-s, c, sh, ch], [-c, -s, ch, sh], [s, -c, sh, ch]]  # derivatives 0 to 3 over k^n
        return np.array(rows) * k ** np.arange(4)[:, None]

    def determinant(omega):
        k1, k2 = ((mass[i] * omega**2 / stiffness[i]) ** 0.25 for i in (0, 1))
        one, two = waves(k1, at), waves(k2, 0.0)
        tip, base = waves(k2, 1 - at), waves(k1, 0.0)
        one[2:] *= stiffness[0]
        two[2:] *= stiffness[1]
        nothing = np.zeros((2, 4))
        matrix = np.block([[base[:2], nothing], [one, -two], [nothing, tip[2:]]])
        return np.linalg.det(matrix / np.max(np.abs(matrix), axis=1, keepdims=True))

    grid = np.linspace(0.2, 120.0, 2000)
    values = np.array([determinant(omega) for omega in grid])
    changes = np.flatnonzero(values[1:] * values[:-1] < 0)
    return np.array([brentq(determinant, grid[k], grid[k + 1], xtol=1e-13) for k in changes])


def test_frequencies_of_a_stepped_beam():
    exact = beam(0.37, (1.0, 0.2), (1.0, 1.0))
    assert exact[0] == pytest.approx(2.78556, abs=5e-6)
    omega = jw.modes(jw.Whisker(1.0, Step(0.37, 1.0, 0.2), mass_per_length=1.0, breaks=(0.37,)), count=3).omega
    np.testing.assert_allclose(omega, exact[:3], rtol=FREQUENCIES)


def test_frequencies_of_a_beam_whose_mass_alone_jumps():
    def first(at):
        return jw.modes(jw.Whisker(mass_per_length=Step(at, 1.0, 0.2), breaks=(at,)), count=3).omega

    np.testing.assert_allclose(first(0.6), beam(0.6, (1.0, 1.0), (1.0, 0.2))[:3], rtol=FREQUENCIES)
    slope = jax.jacfwd(first)(0.6)
    ahead, behind = (beam(0.6 + h, (1.0, 1.0), (1.0, 0.2))[:3] for h in (1e-4, -1e-4))
    np.testing.assert_allclose(slope, (ahead - behind) / 2e-4, rtol=1e-5)


def test_vibrations_with_contacts_on_both_sides_of_a_break(scanned):
    # A break where nothing changes must not matter, no matter where the contact is.
    whisker = jw.Whisker(1.0, Step(0.37, 1.0, 1.0), Step(0.37, 0.1, 0.1), mass_per_length=1.0)
    split = eqx.tree_at(lambda w: w.breaks, whisker, np.array([0.7]), is_leaf=lambda leaf: leaf is None)
    assert np.min(scanned.contact_arc) < 0.7 < np.max(scanned.contact_arc)
    plain, broken = (
        jw.modes(eqx.tree_at(lambda r: r.scene.whisker, scanned, own), count=2) for own in (whisker, split)
    )
    assert np.sum(np.asarray(plain.status) == jw.Status.ok) > 4
    np.testing.assert_allclose(broken.omega, plain.omega, rtol=FREQUENCIES)
    np.testing.assert_allclose(broken.shape, plain.shape, atol=1e-7)


def section(breaks, *, units=1.0):
    at = 0.37 * units
    found = jw.Whisker(units, Step(at, 1.0, 0.2), Step(at, 0.1 / units, 0.6 / units), breaks=breaks)
    return found.section(units, 1.0)


START, LOAD = (0.0, 0.0, 1.0, 0.0), rod.Load(None, -0.8, None)


def by_scipy(arc, first):
    """The end of a rod under LOAD, from the arc length `first` towards the base."""

    def rate(t, r):
        s = first - t
        bend = np.where(s < 0.37, 0.1, 0.6) + 0.8 * r[0] / np.where(s < 0.37, 1.0, 0.2)
        return np.array([-np.cos(r[2]), -np.sin(r[2]), -bend])

    x, y, angle = forward.integrated(rate, (0.0, 0.0, 0.0), arc, (first - 0.37,))
    return np.array([x, y, np.cos(angle), np.sin(angle)])


def start():
    return tuple(map(jnp.asarray, START))


@pytest.mark.parametrize("solver", [None, diffrax.Tsit5(), diffrax.Dopri8()], ids=["splitting", "tsit5", "dopri8"])
def test_a_rod_against_scipy(solver):
    # Tsit5 uses the last rate of change of one step at the beginning of the next one.
    first, steps = jnp.asarray(1.0), 64 if isinstance(solver, diffrax.Tsit5) else 24
    end = rod.integrate(start(), first, LOAD, section((0.37,)), steps=steps, solver=solver, from_base=first)
    np.testing.assert_allclose(end, by_scipy(1.0, 1.0), atol=ROD if solver is None else STAGES)


def test_breaks_are_in_the_units_of_the_whisker_and_no_points():
    first, at = jnp.asarray(0.9), jnp.array([0.0, 0.2, 0.53 / 0.9, 1.0])
    one = rod.points(start(), first, LOAD, section((0.37,)), at=at, from_base=first)
    scaled = rod.points(start(), first, LOAD, section((37.0,), units=100.0), at=at, from_base=first)
    assert all(values.shape == (4,) for values in one)
    np.testing.assert_allclose(one, scaled, atol=ROUNDING)
    end = rod.integrate(start(), first, LOAD, section((0.37,)), steps=32, from_base=first)
    np.testing.assert_allclose([values[-1] for values in one], end, atol=1e-4)  # three steps
    np.testing.assert_allclose(end, by_scipy(0.9, 0.9), atol=ROD)


@pytest.mark.parametrize("off", [-1e-16, 0.0, 1e-16], ids=["below", "at", "above"])
@pytest.mark.parametrize("closed", [False, True])
def test_derivatives_by_a_break_where_two_arcs_meet(off, closed):
    # Rounding may put the break into either arc, and the function may have either value at the break itself.
    first, here = jnp.asarray(1.0), jnp.asarray(0.37)

    def stiffness(s):
        return jnp.where((s <= 0.37) if closed else (s < 0.37), 1.0, 0.2)

    def end(at, meet):
        own = rod.Section(stiffness, None, 1.0, 1.0, breaks=at[None])
        middle = rod.integrate(start(), first - meet, LOAD, own, steps=16, from_base=first)
        return jnp.stack(rod.integrate(middle, meet, LOAD, own, steps=16, from_base=meet))

    values, slopes = jax.jvp(lambda at: end(at, here + off), (here,), (jnp.ones(()),))
    plain, right = jax.jvp(lambda at: end(at, here + 0.1), (here,), (jnp.ones(()),))
    np.testing.assert_allclose(values, plain, atol=ROD)
    np.testing.assert_allclose(slopes, right, atol=MEETING)
    assert abs(right[0]) > 0.1


def test_breaks_outside_an_arc_do_not_matter():
    first = jnp.asarray(0.3)
    with_break, without = (
        rod.integrate(start(), first, LOAD, section(breaks), steps=8, from_base=first) for breaks in ((0.37,), None)
    )
    np.testing.assert_allclose(with_break, without, atol=ROUNDING)


def test_whiskers_with_different_numbers_of_breaks_share_a_scene():
    whiskers = stepped(), jw.Whisker(0.9, Step(0.3, 1.0, 1.0), Step(0.3, 0.1, 0.2))
    both = jw.Scene(whiskers, jw.Parabola(0.2), jw.Support.fbfb(70.0), detect=("second_contact", "crossing"))
    own = dimensionless(both).section
    assert isinstance(own, rod.Section) and own.breaks.shape == (2, 1)
    np.testing.assert_array_equal(own.breaks, [[0.37], [0.0]])
    jax.eval_shape(lambda scene: jw.scan(scene, jnp.linspace(0.7, -0.9, 4)), both)


JUMP = jw.Whisker(1.0, Step(0.37, 1.0, 0.2), mass_per_length=1.0)


@pytest.mark.parametrize(
    "call",
    [
        lambda: jw.deflect(JUMP, jw.PointForce(1.0)),
        lambda: jw.modes(JUMP),
        lambda: jw.modes(jw.Whisker(mass_per_length=Step(0.37, 1.0, 0.2))),
        lambda: jw.scan(jw.Scene(JUMP, jw.Parabola(0.2)), np.array([0.85])),
        lambda: jw.simulate(jw.Sensor(stepped(above=0.2, mass=1.0)), 0.0, 0.01, steps=2),
    ],
    ids=["deflect", "modes", "masses", "scan", "simulate"],
)
def test_a_warning_where_functions_are_not_resolved(call):
    with pytest.warns(UserWarning, match=r"do not resolve .*breaks"):
        call()
