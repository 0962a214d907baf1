"""Reconstruction of whiskers with several contacts: stored scans, tapered whiskers, noise, and what is ambiguous."""

from functools import cache

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxwhisker as jw
import several_cases as stored
from jaxwhisker._inverse.points import ContactsReconstruction, PointStatus

SIGMA = 1e-7  # of stored signals, whose errors are below 1e-8; their steps are too long to estimate it
STORED = 1e-8  # places of contacts: signals and places are stored with nine decimals
FORCES = 1e-6  # the same of forces, which are up to 50
ROUNDING = 1e-12  # of errors that vanish
OWN = 1e-9  # places from signals of the scan itself
NOISE = 0.002  # of the peaks
CLEAR = 0.1  # share of the peak above which a contact cannot be overlooked
ERRORS = (0.8, 1.25)  # errors in standard errors, root mean square of 200 correlated numbers
FAR = 6.0  # standard errors: errors are of first order in the noise
DIFFERENCE, SLOPE = 1e-6, 1e-6  # step of parameters, and error of derivatives by it
CHANNELS = ("fx", "fy", "mz")
STONE, PEG = jw.Circle(0.5, 0.2), jw.Circle(0.25, 0.12, position=-0.55)
CONTROL = np.linspace(0.252, -1.05, 53)
SMOOTH = ("wavy_curved", "two_circles_fb", "groove", "curved_ellipse")


class Taper(eqx.Module):
    """Stiffness of a cone whose tip has half the diameter of its base."""

    def __call__(self, s):
        return (1 - 0.5 * s) ** 4


CONE = jw.Whisker(bending_stiffness=Taper())


@cache
def scanned() -> jw.Result:
    """A cone that bends over a stone and then over a peg; between, it touches both."""
    return jw.scan(jw.Scene(CONE, (STONE, PEG), contacts=2), CONTROL)


def numbers_of_contacts(result) -> np.ndarray:
    return np.sum(np.asarray(result.phase) > 0, axis=-1)


def noisy(seed: int):
    """The signals of that scan with noise, and the size of the noise."""
    rng, scan = np.random.default_rng(seed), scanned()
    sigma = {c: NOISE * float(np.max(np.abs(getattr(scan, c)))) for c in CHANNELS}
    signals = {c: np.asarray(getattr(scan, c)) + s * rng.standard_normal(scan.fx.shape) for c, s in sigma.items()}
    return {"control": CONTROL} | signals, sigma


def located(measured, known, **more) -> ContactsReconstruction:
    return jw.reconstruct(measured, jw.Sensor(CONE), contacts=2, objects=known, **more)


@pytest.mark.parametrize("name", SMOOTH)
def test_contacts_with_known_objects_are_those_of_stored_scans(name):
    case = stored.CASES[name]
    scene = stored.scene_of(case)
    measured = {name: np.array(case[name]) for name in ("control", *CHANNELS)}
    sensor = jw.Sensor(scene.whisker, scene.support)
    points = jw.reconstruct(measured, sensor, sigma=SIGMA, contacts=2, objects=scene.profile.objects)
    most = 0
    for k, contacts in enumerate(case["contacts"]):
        for w in range(len(case["whiskers"])):
            own = sorted((c for c in contacts if c[0] == w + 1), key=lambda c: -c[4])
            assert points.status[k, w] == (PointStatus.ok if own else PointStatus.free)
            assert np.sum(np.asarray(points.phase[k, w]) > 0) == len(own)
            for j, (_, number, _, force, arc, x, y) in enumerate(own):
                places = [getattr(points, n)[k, w, j] for n in ("arc", "x", "y")]
                np.testing.assert_allclose(places, [arc, x, y], atol=STORED)
                assert points.force[k, w, j] == pytest.approx(force, abs=FORCES)
                assert points.object[k, w, j] == number
            most = max(most, len(own))
    assert most == 2


@pytest.mark.parametrize(("known", "least"), [((STONE, PEG), 1.0), ((STONE,), 0.9), ((PEG,), 0.5)])
def test_contacts_of_a_cone_with_known_and_unknown_objects(known, least):
    """`least`: share of the states with two contacts that signals determine."""
    scan = scanned()
    points, number = located(scan, known), numbers_of_contacts(scan)
    ok = np.asarray(points.status) == PointStatus.ok
    assert np.all(ok[number == 1]) and np.mean(ok[number == 2]) >= least
    assert np.all(np.asarray(points.status)[number == 0] == PointStatus.free)
    for name, truth in (("x", "contact_x"), ("y", "contact_y"), ("arc", "contact_arc"), ("slope", "contact_slope")):
        used = np.asarray(scan.phase) > 0
        off = np.abs(np.asarray(getattr(points, name)) - np.asarray(getattr(scan, truth)))
        assert np.max(off[used & ok[..., None]]) < OWN, name
        assert np.all(np.isnan(np.asarray(getattr(points, name))[~used | ~ok[..., None]]))
    names = {0: 0} | {(STONE, PEG).index(one) + 1: k + 1 for k, one in enumerate(known)}
    expected = np.vectorize(lambda k: names.get(k, 0))(np.asarray(scan.contact_object))
    np.testing.assert_array_equal(np.asarray(points.object)[ok], expected[ok])
    np.testing.assert_array_equal(np.asarray(points.phase)[ok], np.asarray(scan.phase)[ok])


def test_the_shape_of_an_unknown_object_is_fitted_to_contacts_beside_a_known_one():
    points = located(scanned(), PEG).unknown()
    fit = jw.fit_profile(points, jw.Circle)
    found = [fit.estimates[name] for name in ("distance", "radius", "position")]
    np.testing.assert_allclose(found, [0.5, 0.2, 0.0], atol=1e2 * OWN)
    free = np.asarray(points.status) == PointStatus.free
    assert np.all(np.isnan(np.asarray(points.x)[free])) and np.all(np.asarray(points.phase)[free] == jw.Phase.free)


def test_without_known_objects_two_contacts_are_ambiguous():
    scan, number = scanned(), numbers_of_contacts(scanned())
    points = jw.reconstruct(scan, jw.Sensor(CONE), contacts=2)
    status = np.asarray(points.status)
    assert np.all(status[number == 1] == PointStatus.ok) and np.all(status[number == 2] == PointStatus.ambiguous)
    assert np.all(np.isnan(np.asarray(points.x)[number == 2]))
    assert "ambiguous" in str(points)
    one = scan.contact_x[..., 0][number == 1]
    np.testing.assert_allclose(np.asarray(points.x)[number == 1], one, atol=OWN)
    # A scene with several contacts says how many there may be.
    same = jw.reconstruct(scan, scan.scene)
    np.testing.assert_array_equal(same.status, status)


def test_contacts_on_the_shaft_of_a_uniform_whisker_are_ambiguous():
    """Its reaction to two contacts on the shaft is that to another one."""
    case = stored.CASES["two_circles"]
    measured = {name: np.array(case[name]) for name in ("control", *CHANNELS)}
    assumed = jw.reconstruct(measured, jw.Sensor(jw.Whisker()), sigma=SIGMA)
    points = jw.reconstruct(measured, jw.Sensor(jw.Whisker()), sigma=SIGMA, contacts=2)
    number = np.array([len(contacts) for contacts in case["contacts"]])
    wrong = (number == 2) & (np.asarray(assumed.status)[:, 0] == PointStatus.ok)
    assert wrong.sum() >= 2
    with_shaft = np.asarray(assumed.phase)[:, 0] == jw.Phase.tangential
    assert np.all(np.asarray(points.status)[with_shaft, 0] == PointStatus.ambiguous)


def test_contacts_at_the_tip_of_a_uniform_whisker_are_not():
    scan = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.6)), np.linspace(0.6, -0.6, 25))
    points = jw.reconstruct(scan, jw.Sensor(jw.Whisker()), contacts=2)
    tip = np.asarray(scan.phase) == jw.Phase.tip
    assert tip.sum() > 5
    np.testing.assert_allclose(np.asarray(points.x)[tip], np.asarray(scan.contact_x)[tip], atol=OWN)


def test_another_object_than_the_known_one_gives_no_contact_with_it():
    scan, number = scanned(), numbers_of_contacts(scanned())
    points = located(scan, (jw.Circle(0.5, 0.2, position=0.02), jw.Circle(0.26, 0.12, position=-0.55)))
    status = np.asarray(points.status)
    assert np.all(status[number == 2] != PointStatus.ok)
    known = np.asarray(points.object)[status == PointStatus.ok]
    assert np.all(known == 0)
    one = number == 1
    off = np.abs(np.asarray(points.x) - np.asarray(scan.contact_x))[..., 0]
    assert np.nanmax(off[one]) < OWN  # something unknown, which is where it is


@pytest.mark.parametrize("known", [(STONE, PEG), (STONE,)])
def test_noise_gives_the_same_contacts_or_none(known):
    scan, scores = scanned(), []
    number = numbers_of_contacts(scan)
    weakest = np.min(np.where(np.asarray(scan.phase) > 0, np.asarray(scan.contact_force), np.inf), axis=-1)
    clear = weakest > CLEAR * np.max(np.asarray(scan.contact_force))
    lost = 0
    for seed in range(4):
        measured, sigma = noisy(seed)
        points = located(measured, known, sigma=sigma)
        ok = np.asarray(points.status) == PointStatus.ok
        assert np.all(np.sum(np.asarray(points.phase) > 0, axis=-1)[ok & clear] == number[ok & clear])
        lost += np.sum(~ok & clear)
        off = np.asarray(points.x) - np.asarray(scan.contact_x)
        error = np.asarray(points.standard_error)[..., 0]
        used = ok[..., None] & clear[..., None] & (np.asarray(points.phase) > 0)
        follows = np.all(~used | (np.asarray(points.object) > 0), axis=-1)[..., None]  # from the objects alone
        assert np.all(error[used & follows] < ROUNDING) and np.all(np.abs(off[used & follows]) < OWN)
        scores.append((off / error)[used & ~follows])
    assert lost < 0.1 * 4 * np.sum(clear)
    scores = np.concatenate(scores)
    if len(known) == 2:
        assert scores.size == 0
    else:
        assert scores.size > 40 and np.max(np.abs(scores)) < FAR
        assert ERRORS[0] < np.sqrt(np.mean(scores**2)) < ERRORS[1]


def build(q, length):
    return jw.Sensor(jw.Whisker(length, Taper()))


def objects(q, length):
    return jw.Circle(q, 0.2), PEG


def test_errors_of_parameters_widen_those_of_contacts():
    """Where noise changes nothing, they are those of the parameters, here of an object and of the whisker."""
    at, spread = {"q": 0.5, "length": 1.0}, np.diag([1e-6, 4e-6])
    measured = {"control": CONTROL} | {c: np.asarray(getattr(scanned(), c)) for c in CHANNELS}
    given = {"contacts": 2, "objects": objects, "covariance": spread}
    points = jw.reconstruct(measured, build, parameters=at, sigma=1e-3, **given)
    both = np.flatnonzero(numbers_of_contacts(scanned())[:, 0] == 2)
    variance = 0.0
    for (name, value), size in zip(at.items(), np.diag(spread), strict=True):
        step = DIFFERENCE * value
        high, low = (
            jw.reconstruct(measured, build, parameters=at | {name: value + s}, sigma=1e-3, contacts=2, objects=objects)
            for s in (step, -step)
        )
        variance += size * np.asarray((high.x - low.x) / (2 * step))[both, 0] ** 2
    found = np.asarray(points.covariance)[both, 0, :, 0, 0]
    assert np.all(found > 0)
    np.testing.assert_allclose(found, variance, rtol=100 * SLOPE)


def test_derivatives_of_contacts_by_the_signals():
    scan = scanned()
    both = np.flatnonzero(numbers_of_contacts(scan)[:, 0] == 2)
    k = int(both[both.size // 2])
    arrays = {"control": CONTROL[k : k + 1]} | {c: np.asarray(getattr(scan, c))[k : k + 1] for c in CHANNELS}
    sigma = {c: np.full((1, 1), 10 * DIFFERENCE) for c in CHANNELS}

    def place(mz):
        points = jw.reconstruct(arrays | {"mz": mz}, jw.Sensor(CONE), sigma=sigma, contacts=2, objects=STONE)
        return points.x[0, 0]

    mz = arrays["mz"]
    slope = jax.jacfwd(place)(mz)[:, 0, 0]
    difference = (place(mz + DIFFERENCE) - place(mz - DIFFERENCE)) / (2 * DIFFERENCE)
    assert np.all(np.abs(slope) > 0)
    np.testing.assert_allclose(slope, difference, rtol=1e2 * SLOPE)
    np.testing.assert_allclose(jax.jacrev(place)(mz)[:, 0, 0], slope, rtol=SLOPE)


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"objects": PEG}, "`contacts` must be at least 2 with `objects`"),
        ({"objects": PEG, "contacts": 3}, "`contacts` must be at most 2 with `objects`"),
        ({"objects": "peg", "contacts": 2}, "`objects` must be a profile"),
        ({"objects": jw.Box(0.3, 0.4, 0.6), "contacts": 2}, "`objects` must be smooth"),
        ({"contacts": 0}, "`contacts` must be"),
    ],
)
def test_wrong_arguments_are_named(given, named):
    with pytest.raises(ValueError, match=named):
        jw.reconstruct(scanned(), jw.Sensor(CONE), **given)


def test_what_is_not_available_is_named():
    with pytest.raises(ValueError, match="`objects` must be None with friction"):
        jw.reconstruct(scanned(), jw.Sensor(CONE, friction=0.3), contacts=2, objects=PEG)
    held = jw.Support((jw.Spring((0, 1), 70.0, 0.2, axis="axial", at=0.1),))
    with pytest.raises(ValueError, match="`contacts` must be 1 with springs"):
        jw.reconstruct(scanned(), jw.Sensor(CONE, held), contacts=2)
    with pytest.raises(ValueError, match="at most one contact each"):
        jw.reconstruct(scanned(), jw.Sensor(CONE))
