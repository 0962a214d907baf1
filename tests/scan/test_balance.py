"""Energy balance: work is stored, turned into heat, or lost in snaps, for all supports, motions and contacts."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
import several
from jaxwhisker._scan import balance
from scenes import all_ok, cone, follicle, model

BALANCE = 1e-8  # relative to the largest work: the accuracy of rods in eight steps
NOTHING = 1e-10  # relative to the largest work: rounding
STEP = 1e-6  # of differences
SLOPES = 1e-6  # relative to 1 + the difference: differences, and states next to a fold
OUT = np.linspace(0.9, -1.7, 60)
# Out, back while contacts stick and slip, and out again past the snap.
THERE_AND_BACK = np.concatenate([np.linspace(0.9, -0.4, 20), np.linspace(-0.35, 0.3, 15), np.linspace(0.25, -1.7, 25)])
MU = 0.3


def rough(scene, mu=MU):
    return jw.Scene(scene.whiskers, scene.profile, scene.support, scene.rod, motion=scene.motion, friction=mu)


def one(support, **options):
    return jw.Scene(jw.Whisker(), jw.Parabola(0.2), support, **options)


def yielding(**options):
    return one(follicle(x=70.0, y=200.0, phi=5.0, mount=(0.05, 0.02, 0.1)), **options)


def on_shaft(*springs, whisker=None, **options):
    axial = jw.Spring((0, 1), 70.0, 0.2, axis="axial", at=0.1, anchor=(0.01, 0.08))
    support = jw.Support((axial, *springs), **{key: options.pop(key) for key in ("foundation",) if key in options})
    return jw.Scene(whisker or jw.Whisker(), jw.Parabola(0.3), support, **options)


SCENES = {
    "shaft": (
        lambda: on_shaft(jw.Spring((0, 1), 5.0, 0.1, axis="phi", at=0.05), motion=jw.Rotation((0.3, -0.2), 0.4)),
        np.linspace(-1.2, 1.0, 40),
    ),
    "tissue": (
        lambda: on_shaft(whisker=cone(0.5), foundation=jw.Foundation(0.05, 0.2, 300.0, 0.2)),
        OUT,
    ),
    "clamped": (lambda: one(jw.Support.clamped()), OUT),
    "snap-off": (lambda: model("FB"), OUT),
    "snap-through": (lambda: model("FB", 10.0), OUT),
    "network": (lambda: model("FBFBR"), np.linspace(0.9, -2.0, 60)),
    "follicle": (lambda: yielding(), OUT),
    "rotation": (lambda: yielding(motion=jw.Rotation((0.3, -0.2), 0.4)), np.linspace(-1.2, 1.0, 50)),
    "friction": (lambda: rough(model("FB")), THERE_AND_BACK),
    "friction, clamped": (lambda: rough(one(jw.Support.clamped())), THERE_AND_BACK),
    "friction, network": (lambda: rough(model("FBFBR")), THERE_AND_BACK),
}


@cache
def scanned(name):
    scene, control = SCENES[name]
    return jw.scan(scene(), control)


@cache
def balanced(name):
    return jw.energy_balance(scanned(name))


def kinds(result):
    return {event.kind for event in result.events}


@pytest.mark.parametrize("name", SCENES)
def test_work_is_stored_turned_into_heat_or_lost(name):
    result, energies = scanned(name), balanced(name)
    assert all_ok(result)
    size = np.max(np.abs(energies.work))
    assert size > 0.5
    np.testing.assert_allclose(energies.residual, 0.0, atol=BALANCE * size)
    others = energies.stored + energies.heat.sum(axis=1) + energies.loss
    np.testing.assert_allclose(energies.work - others, energies.residual, atol=NOTHING * size)
    np.testing.assert_array_equal(energies.control, result.control)
    stored = np.asarray(jw.stored_energy(result.scene, result))
    np.testing.assert_allclose(energies.stored, stored - stored[0], atol=NOTHING * size)


@pytest.mark.parametrize("name", SCENES)
def test_heat_never_falls_and_snaps_lose_energy(name):
    result, energies = scanned(name), balanced(name)
    size = np.max(np.abs(energies.work))
    assert np.min(np.diff(np.asarray(energies.heat), axis=0)) > -NOTHING * size
    assert np.min(np.diff(np.asarray(energies.loss))) >= 0
    snaps = kinds(result) & {jw.EventKind.snap_through, jw.EventKind.snap_off}
    assert (float(energies.loss[-1]) > 0.01) == bool(snaps)
    assert (float(energies.heat[-1].sum()) > 0.1) == (result.scene.friction is not None)


def test_scenes_have_the_events_that_they_stand_for():
    assert jw.EventKind.snap_off in kinds(scanned("snap-off"))
    assert jw.EventKind.snap_through in kinds(scanned("snap-through"))
    for name in ("friction", "friction, clamped", "friction, network"):
        assert {jw.EventKind.stick, jw.EventKind.slip, jw.EventKind.snap_off} <= kinds(scanned(name))
        slip = np.asarray(scanned(name).slip)[np.asarray(scanned(name).phase) != jw.Phase.free]
        assert {-1, 0, 1} <= set(slip.tolist())


def test_the_balance_does_not_depend_on_the_steps_of_the_drive():
    energies = balanced("friction")
    control = np.array([0.9, -0.4, 0.3, -1.7])
    few = jw.energy_balance(jw.scan(scanned("friction").scene, control))
    at = [int(np.flatnonzero(u == THERE_AND_BACK)[0]) for u in control]
    for name in ("work", "stored", "heat", "loss"):
        there = np.asarray(getattr(energies, name))[at]
        np.testing.assert_allclose(getattr(few, name), there, atol=BALANCE * float(energies.work.max()))


def test_a_closed_loop_without_friction_and_snaps_takes_no_work():
    loop = np.concatenate([np.linspace(0.9, -0.8, 12), np.linspace(-0.7, 0.9, 12)])
    energies = jw.energy_balance(jw.scan(model("FB"), loop))
    size = np.max(energies.work)
    assert size > 1
    assert abs(energies.work[-1]) < BALANCE * size and energies.loss[-1] == 0


@pytest.mark.parametrize("start", [0.9, 0.1])
def test_a_closed_loop_with_friction_takes_the_work_of_its_heat(start):
    # The second time around, the loop begins and ends in the same state, also if it begins in contact.
    once = np.concatenate([np.linspace(start, -0.4, 10), np.linspace(-0.3, 0.9, 9), np.linspace(0.9, start, 5)])
    result = jw.scan(rough(model("FB")), np.append(once, once))
    energies = jw.energy_balance(result)
    (work, stored, loss), heat = (
        (np.asarray(v)[-1] - np.asarray(v)[once.size - 1] for v in (energies.work, energies.stored, energies.loss)),
        np.asarray(energies.heat)[-1, 0] - np.asarray(energies.heat)[once.size - 1, 0],
    )
    assert heat > 1 and abs(stored) < BALANCE and loss == 0
    assert abs(work - heat) < BALANCE * float(energies.work.max())


def test_energies_are_in_the_units_of_the_scene():
    length, bending = 37.5, 4.2e4
    support = jw.Support.fb(70.0 * bending / length**3, 0.2 * length)
    scene = jw.Scene(jw.Whisker(length, bending), jw.Parabola(0.2 * length, 1 / length), support, friction=MU)
    energies = jw.energy_balance(jw.scan(scene, THERE_AND_BACK * length))
    for name in ("work", "stored", "heat", "loss"):
        here = np.asarray(getattr(energies, name)) * length / bending
        np.testing.assert_allclose(here, getattr(balanced("friction"), name), atol=BALANCE * 20)


def test_a_wrong_law_of_friction_breaks_the_balance(monkeypatch):
    """The residual is zero only because heat is computed independently of work and stored energy."""
    law = balance.heat_rate

    def more(mu, normal, slip, slipped):
        return law(1.001 * mu, normal, slip, slipped)

    def against(mu, normal, slip, slipped):
        return law(mu, normal, -slip, slipped)

    for wrong in (more, against):
        monkeypatch.setattr(balance, "heat_rate", wrong)
        monkeypatch.setattr(balance, "integrals_now", balance._integrals)  # not the stored program
        energies = jw.energy_balance(scanned("friction"))
        assert np.max(np.abs(energies.residual)) > 1e-4 * np.max(energies.work)


@pytest.mark.parametrize("friction", [False, True])
def test_derivatives(friction):
    control = THERE_AND_BACK[::4] if friction else OUT[::4]

    def energies(p):
        distance, stiffness, mu, turn = p
        scene = model("FB", stiffness, distance=distance)
        moved = jnp.asarray(control).at[5].add(turn)
        found = jw.energy_balance(jw.scan(rough(scene, mu) if friction else scene, moved))
        return jnp.stack([found.work, found.stored, found.heat[:, 0], found.loss])

    at = jnp.array([0.2, 40.0, MU, 0.0])
    assert float(energies(at)[3, -1]) > 0.1
    slopes = np.asarray(jax.jacfwd(energies)(at))
    for k in range(4):
        step = STEP * (100 if k == 1 else 1)
        difference = np.asarray((energies(at.at[k].add(step)) - energies(at.at[k].add(-step))) / (2 * step))
        error = np.abs(difference - slopes[..., k]) / (1 + np.abs(difference))
        assert np.max(error) < 3 * SLOPES, k
    if not friction:
        backwards = jax.grad(lambda p: energies(p)[0, -1])(at)
        np.testing.assert_allclose(backwards, slopes[0, -1], atol=SLOPES)


def test_a_batch_with_a_failed_scan():
    def scan(mu):
        return jw.scan(rough(model("FB"), mu), THERE_AND_BACK[::3])

    mus = jnp.array([MU, -1.0, 0.1])
    batch = jw.energy_balance(jax.vmap(scan)(mus))
    inside = jax.vmap(lambda mu: jw.energy_balance(scan(mu)))(mus)
    assert batch.work.shape == (3, THERE_AND_BACK[::3].size) and batch.heat.shape == (*batch.work.shape, 1)
    for name in ("work", "stored", "heat", "loss", "residual"):
        values = np.asarray(getattr(batch, name))
        assert np.isnan(values[1]).all() and np.isfinite(values[[0, 2]]).all()
        np.testing.assert_allclose(getattr(inside, name), values, atol=BALANCE)
        alone = getattr(jw.energy_balance(scan(0.1)), name)
        np.testing.assert_allclose(values[2], alone, atol=BALANCE)


def test_energies_are_unknown_from_the_first_failed_step_on():
    result = scanned("snap-off")
    status = result.status.at[20].set(int(jw.Status.inexact))
    energies = jw.energy_balance(eqx.tree_at(lambda tree: tree.status, result, status))
    for name in ("work", "stored", "heat", "loss", "residual"):
        values = np.asarray(getattr(energies, name))
        assert np.isfinite(values[:20]).all() and np.isnan(values[20:]).all()


@pytest.mark.unchecked
def test_a_result_is_required():
    with pytest.raises(ValueError, match="`result` must be the Result of a scan"):
        jw.energy_balance(model("FB"))  # pyright: ignore[reportArgumentType]


def test_the_balance_of_whiskers_with_several_contacts():
    result = several.scanned()
    energies = jw.energy_balance(result)
    largest = np.max(np.abs(energies.work))
    np.testing.assert_allclose(energies.residual, 0.0, atol=BALANCE * largest)
    assert float(energies.loss[-1]) > 0.1 * largest and float(energies.stored[-1]) == 0.0
