"""Friction in space: the reference, scans in the plane, laws of single states, symmetries, batches, derivatives."""

# pyright: reportArgumentType=false, reportOptionalSubscript=false

import json
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from random_space import drawn
from space_laws import shaft, state_of, violations

EXACT = 1e-8  # the direction of slip is integrated to this, relative to the peak
LAWS = 1e-8  # the states are solved to 1e-10, and the laws are integrated to 1e-12
PARALLEL = 2e-5  # slip against friction, by differences of states 2e-4 apart
SLOPE = 3e-5  # central differences with a step of 1e-4, relative to the largest
NAMES = ("fx", "fy", "fz", "mx", "my", "mz")
KINDS = jw.EventKind
DATA = json.loads((Path(__file__).parents[1] / "data" / "space_friction.json").read_text("utf-8"))
CASES = DATA["cases"]
MU, OFFSET, RADIUS, HEIGHT = 0.3, 0.5, 1.0, 1.3
BACK = np.array([1.0, 0.6, 0.3, 0.35, 0.5, 0.45, -0.4, -1.0])  # turns at 0.3 and 0.5


def past_a_ball(mu=MU, offset=OFFSET, radius=RADIUS, height=HEIGHT, **others) -> jw.SpaceScene:
    """A straight whisker on a drive towards -x, past a ball beside its path."""
    return jw.SpaceScene(jw.Whisker(), jw.Sphere(radius, (0.0, height, -offset)), friction=mu, **others)


@pytest.mark.parametrize("row", CASES, ids=[row["name"].replace(" ", "_") for row in CASES])
def test_slipping_contacts_agree_with_the_reference(row):
    surface, drive = row["params"]["surface"], row["params"]["drive"]
    motion = jw.LinearDrive(tuple(drive["direction"]), tuple(drive["origin"]))
    ball = jw.Sphere(surface["radius"], tuple(surface["center"]))
    scene = jw.SpaceScene(jw.Whisker(), ball, motion=motion, friction=row["params"]["friction"])
    states = row["states"]
    result = jw.scan(scene, np.concatenate([[-1.5], states["u"], [1.5]]))
    error = np.array(states["error_estimate"])[:, None]  # of the reference, which is of second order
    for name in ("force", "moment"):
        there = np.array(states[name])
        peak = np.max(np.abs(there))
        assert np.all(np.abs(getattr(result, name)[1:-1, 0] - there) < (error + 1e-7) * peak), name
    events = [(event.kind.name, event.control) for event in result.events]
    there = [*((event["kind"], event["u"]) for event in row["events"]), ("release", row["end"]["u"])]
    assert [kind for kind, _ in events] == [kind for kind, _ in there]
    np.testing.assert_allclose([u for _, u in events], [u for _, u in there], atol=2e-7)  # two grids differ by 3e-8


@pytest.mark.parametrize("mu", [0.0, 1e-6])
def test_with_hardly_any_friction_contacts_slip_back(mu):
    """Without friction at a turn of the drive, nothing could hold a contact. What friction does is a multiple of it."""

    def forces(mu):
        result = jw.scan(past_a_ball(mu), BACK)
        return result.force, result.status

    without = jw.scan(past_a_ball(None), BACK).force
    (force, status), slope = forces(mu), jax.jacfwd(lambda mu: forces(mu)[0])(mu)
    assert np.all(status == 0)
    np.testing.assert_allclose(force, without + mu * slope, atol=EXACT)
    more = forces(mu + 3e-6)[0]
    np.testing.assert_allclose((more - force) / 3e-6, slope, atol=SLOPE * np.max(np.abs(slope)))
    there, back = BACK.tolist().index(0.6), BACK.tolist().index(0.35)
    assert slope[there, 0, 0] * slope[back, 0, 0] < 0  # friction turns with the drive


# Just before it comes free, such a contact sticks and slips in turn up to 300 times, ever more briefly.
CYCLES = {
    "in time": (0.932879, (0, 1.55664, 0.153224), 0.410905, (-1.9957, -0.10929, -0.0724231), -0.00972975, 157),
    # The last force before the release cannot be told from rounding errors.
    "at the end": (
        0.8757513830252712,
        (0, 1.5163431322358103, 0.06540933524034387),
        0.4407152147158542,
        (-1.67477089251291, 0.11524872969239874, -0.032740344629117554),
        -0.012514785235666338,
        40,
    ),
}


@cache
def cycled(name):
    radius, centre, mu, direction, z, _ = CYCLES[name]
    motion = jw.LinearDrive(direction, (0, 0, z))
    scene = jw.SpaceScene(jw.Whisker(), jw.Sphere(radius, centre), motion=motion, friction=mu)
    return jw.scan(scene, np.linspace(-1.2, 1.4, 131))


@pytest.mark.parametrize("name", CYCLES)
def test_contacts_that_stick_and_slip_in_turn_are_released(name):
    result = cycled(name)
    assert np.all(result.status == jw.Status.ok)
    events = result.events
    assert len(events) == int(events.count) >= CYCLES[name][-1] and not events.truncated
    assert events[0].kind == KINDS.touch and events[-1].kind in (KINDS.release, KINDS.snap_off)
    assert np.all(np.asarray(result.phase)[np.asarray(result.control) > events[-1].control] == jw.Phase.free)


@pytest.mark.parametrize("name", CYCLES)
def test_below_vmap_their_first_and_last_events_are_kept(name):
    """There is room for the first half of the usual number of events, and for as many last ones."""
    result = cycled(name)
    events, lanes = result.events, jnp.linspace(-1.2, 1.4, 131)[None]
    kept = jax.tree.map(lambda leaf: leaf[0], jax.vmap(lambda control: jw.scan(result.scene, control).events)(lanes))
    size = kept.kind.shape[0]
    assert kept.truncated and int(kept.count) > size and kept.kind[-1] == events[-1].kind
    np.testing.assert_allclose(kept.control[:9], np.asarray(events.control)[:9], atol=1e-7)
    assert kept.control[-1] == pytest.approx(events[-1].control, abs=1e-4)
    assert np.min(np.diff(np.asarray(kept.travel, dtype=float))) >= 0


def test_without_a_coefficient_it_is_the_scan_without_friction():
    control = np.linspace(0.8, -0.9, 12)
    without = jw.scan(jw.SpaceScene(jw.Whisker(), jw.Sphere(RADIUS, (0.0, HEIGHT, -OFFSET))), control)
    zero = jw.scan(past_a_ball(0.0), control)
    assert np.all(zero.status == jw.Status.ok)
    for name in NAMES:
        np.testing.assert_allclose(getattr(zero, name), getattr(without, name), atol=1e-9)


def test_in_the_plane_of_symmetry_it_is_the_plane_scan_with_turns():
    control = np.array([0.9, 0.7, 0.4, 0.3, 0.2, 0.25, 0.3, 0.45, 0.6, 0.4, 0.2, 0.1])
    plane = jw.scan(jw.Scene(jw.Whisker(), jw.Circle(0.3, 1.0), friction=0.4), control)
    space = jw.scan(past_a_ball(0.4, 0.0), control)
    assert np.all(space.status == 0)
    for name in ("fx", "fy", "mz", "contact_force", "normal_force"):
        peak = np.max(np.abs(getattr(plane, name)))
        np.testing.assert_allclose(getattr(space, name), getattr(plane, name), atol=EXACT * peak, err_msg=name)
    np.testing.assert_allclose([space.fz, space.mx], 0, atol=EXACT)
    events = [(event.kind, event.control) for event in plane.events if event.kind != KINDS.vertex]
    there = [(event.kind, event.control) for event in space.events]
    assert [kind for kind, _ in events] == [kind for kind, _ in there]
    np.testing.assert_allclose([u for _, u in there], [u for _, u in events], atol=EXACT)


LAW_SCENES = [
    ("straight clamped linear", 1),
    ("straight tilting whisk", 4),
    ("curved sprung linear", 5),
    ("curved cone clamped whisk", 2),
]


@pytest.mark.parametrize(("kind", "seed"), LAW_SCENES)
def test_states_obey_the_laws(kind, seed):
    of = drawn(kind, np.random.default_rng([7, seed]))
    scene = eqx.tree_at(lambda scene: scene.friction, of.scene, 0.25, is_leaf=lambda x: x is None)
    whole = jw.scan(scene)
    ok = (whole.status == 0) & (whole.phase[:, 0] > 0)
    first, last = (float(whole.control[np.flatnonzero(ok)[k]]) for k in (0, -1))
    first += 0.01 * (last - first)
    # There, back, and past the object; at each place, three states close to each other.
    there, back, past = (first + share * (last - first) for share in (0.6, 0.4, 0.95))
    places = np.concatenate([np.linspace(a, b, 7)[1:-1] for a, b in ((first, there), (there, back), (back, past))])
    ways = np.repeat(np.sign([there - first, back - there, past - back]), 5)
    control = np.concatenate([[u - 1e-4 * way, u, u + 1e-4 * way] for u, way in zip(places, ways, strict=True)])
    control = np.concatenate([[first], control[:15], [there], control[15:30], [back], control[30:], [past]])
    result = jw.scan(scene, control)
    middle = np.concatenate([np.arange(5) * 3 + start for start in (2, 18, 34)])
    checked = 0
    for k in middle:
        phases = np.asarray(result.phase[k - 1 : k + 2, 0])
        if not (np.all(result.status[k - 1 : k + 2] == 0) and np.all(phases == phases[0]) and phases[0]):
            continue
        states = [state_of(step_of(result, j), control[j]) for j in (k - 1, k, k + 1)]
        found = violations(of.plain, states[1])
        found.pop("normal")  # the law without friction
        assert max(found.values()) < LAWS, found
        normal, _ = of.plain.surface.normal_and_curvature(states[1].contact)
        pressure = float(result.normal_force[k, 0])
        friction = np.array([float(getattr(result, f"friction_{axis}")[k, 0]) for axis in "xyz"])
        np.testing.assert_allclose(-states[1].force, pressure * normal + friction, atol=LAWS * (1 + pressure))
        assert abs(friction @ normal) < LAWS * (1 + pressure)
        size = np.linalg.norm(friction)
        tangents = [shaft(of.plain, state).directors[:, 2] for state in states]
        moved = states[2].contact - states[0].contact
        moved = moved - tangents[1] * (states[2].contact_arc - states[0].contact_arc)
        if result.slip[k, 0]:
            assert abs(size - 0.25 * pressure) < LAWS * (1 + pressure)
            slip = moved / np.linalg.norm(moved)
            assert np.linalg.norm(slip + friction / size) < PARALLEL * (1 + 1e-3 / np.linalg.norm(moved))
        else:
            assert size < 0.25 * pressure + LAWS
            assert np.linalg.norm(moved) < 1e-8  # a rolling contact's curvature leaves terms of third order
        checked += 1
    assert checked >= 8


def step_of(result, k):
    """The fields of one step of a result that the laws need."""
    names = [f"{of}{axis}" for of in ("f", "m", "base_", "contact_") for axis in "xyz"]
    names += ["base_rotation", "contact_force", "contact_arc", "phase"]
    return SimpleNamespace(**{name: np.asarray(getattr(result, name))[k] for name in names})


def test_where_the_drive_turns_contacts_stick_and_slip_later():
    result = jw.scan(past_a_ball(), BACK)
    kinds = [event.kind for event in result.events]
    assert kinds == [
        *(KINDS.touch, KINDS.tip_to_tangential, KINDS.stick, KINDS.slip, KINDS.stick, KINDS.slip),
        *(KINDS.tangential_to_tip, KINDS.release),
    ]  # fmt: skip
    turns = [event.control for event in result.events.of(KINDS.stick)]
    np.testing.assert_allclose(turns, [0.3, 0.5])
    assert list(result.slip[:, 0]) == [0, 1, 0, 1, 0, 1, 1, 0]


def test_a_nearly_straight_whisker_sticks_and_snaps_on_its_way_back():
    """It hardly yields along its axis: contacts that are pushed far before they slide would be out of its reach."""
    rng = np.random.default_rng([11, 3])
    of, friction = drawn("straight clamped linear", rng), float(rng.uniform(0.05, 0.6))
    scene = eqx.tree_at(lambda scene: scene.friction, of.scene, friction, is_leaf=lambda x: x is None)
    start, turn = -0.13984642254866913, -0.08085188382519405
    result = jw.scan(scene, np.concatenate([np.linspace(start, turn, 80), np.linspace(turn, start, 80)[1:]]))
    assert np.all(result.status == 0)
    assert KINDS.stick in [event.kind for event in result.events]
    size = np.sqrt(sum(np.asarray(getattr(result, f"friction_{axis}")) ** 2 for axis in "xyz"))
    assert np.all(size < friction * np.asarray(result.normal_force) + LAWS)


def test_a_loop_of_the_drive_costs_work():
    """The contact slips on the way; heat is the work of the drive around a closed loop."""
    loop = np.concatenate([[1.0], np.linspace(0.8, 0.3, 401), np.linspace(0.3, 0.8, 401)[1:]])
    result = jw.scan(past_a_ball(), loop)
    work = np.trapezoid(np.asarray(result.fx[1:, 0]), loop[1:])
    assert work > 0.1
    here, there = np.asarray(result.fz[101, 0]), np.asarray(result.fz[-101, 0])
    assert abs(here - there) > 0.1  # friction has turned


def test_mirror_images_have_mirrored_signals():
    one, other = jw.scan(past_a_ball(), BACK), jw.scan(past_a_ball(offset=-OFFSET), BACK)
    for name, sign in zip(NAMES, (1, 1, -1, -1, -1, 1), strict=True):
        np.testing.assert_allclose(getattr(other, name), sign * getattr(one, name), atol=EXACT, err_msg=name)


def test_batches_and_jit_agree_with_single_scans_and_a_failed_lane_is_alone():
    radii = jnp.array([1.0, -1.0, 0.9])

    def forces(radius):
        result = jw.scan(past_a_ball(radius=radius), BACK)
        return result.force[:, 0], result.status

    batch, status = jax.vmap(forces)(radii)
    assert np.all(np.isnan(batch[1])) and np.all(status[1] == jw.Status.invalid)
    for k in (0, 2):
        alone, _ = forces(radii[k])
        np.testing.assert_allclose(batch[k], alone, atol=1e-10)
    compiled, _ = jax.jit(forces)(radii[2])
    np.testing.assert_allclose(compiled, batch[2], atol=1e-10)


def test_derivatives_follow_the_history_in_both_modes():
    """The parameters are friction, offset, radius, height and the position of a turn."""

    def force(x):
        control = jnp.asarray(BACK[:-1]).at[2].set(x[4])
        result = jw.scan(past_a_ball(*x[:4]), control)
        return jnp.concatenate([jnp.ravel(result.force[1:, 0]), result.events.control[:6]])

    x = jnp.array([MU, OFFSET, RADIUS, HEIGHT, BACK[2]])
    slope = jax.jacfwd(force)(x)
    np.testing.assert_allclose(jax.jacrev(force)(x), slope, atol=1e-9 * np.max(np.abs(slope)))
    step = 1e-4
    difference = np.stack([(force(x.at[k].add(step)) - force(x.at[k].add(-step))) / (2 * step) for k in range(5)], 1)
    np.testing.assert_allclose(slope, difference, atol=SLOPE * np.max(np.abs(difference)))


def test_coupled_whiskers_agree_in_eager_and_staged_scans():
    springs = [jw.Spring((0, 1), 60.0, axis=axis) for axis in "xyz"] + [jw.Spring((1, 2), 60.0, axis="x")]
    springs += [jw.Spring((0, 2), 80.0, axis=axis) for axis in "yz"]
    mounts = (jw.Mount(), jw.Mount(x=-0.5))
    scene = past_a_ball(0.2, 0.3, support=jw.Support(tuple(springs), mounts))
    control = np.array([1.5, 1.0, 0.7, 0.4, 0.5, 0.2, -0.1])
    eager = jw.scan(scene, control)
    assert np.all(eager.status == 0)

    @jax.jit
    def forces(friction):
        return jw.scan(eqx.tree_at(lambda scene: scene.friction, scene, friction), control).force

    np.testing.assert_allclose(forces(0.2), eager.force, atol=1e-10)


@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_the_coefficient_is_not_negative(value):
    with pytest.raises(ValueError, match="friction"):
        past_a_ball(value)


def test_without_friction_there_are_no_fields_of_it():
    result = jw.scan(jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, -0.5))), BACK[:3])
    assert result.slip is None and result.normal_force is None and result.friction_x is None
