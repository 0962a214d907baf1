"""Laws of whiskers with several contacts, which share no code with the package: of stored and of random scans."""

import numpy as np
import pytest

import jaxwhisker as jw
import several_laws as laws
from random_several import KINDS, checked, drawn
from scenes import all_ok
from several_cases import CASES

STORED = 1e-8  # laws of stored states, which have nine decimals
SOLVED = 1e-7  # laws of scans: a hundred times their accuracy, and that of laws next to sharp objects
STRIDE = 3  # steps between two stored states that are checked
FOLD = 1e-3  # stability at a fold, of rods with 160 nodes
AT_ONCE = 1e-6  # distance of a snap from the event that causes it
AT_END = 2e-5  # distance of the drive from the end of a scan
NEAR, STRAIGHT = 1e-3, 1e-4  # lengths, in which a pressure is measured, and from where the object is straight
SCENES = 3  # of each kind
# After a jump, this curved whisker would rest along a side: its contact splits in two, which is not modelled.
ALONG_A_SIDE = "polygon, curved, FBFB", 0
MAKERS = {"circle": laws.circle, "ellipse": laws.ellipse, "cosine": laws.wave, "pipe": laws.pipe}
# Normals are not stored. Those at corners do not follow from places: random scenes with corners are checked.
SMOOTH = [name for name, case in CASES.items() if all(o["kind"] in MAKERS for o in case["objects"])]


def plain_of(case: dict) -> laws.Plain:
    """A stored case in plain numbers."""
    kappa = case["whiskers"][0]["intrinsic_curvature"]
    rods = tuple(laws.Rod(curvature=lambda s: kappa + 0 * s) for _ in case["whiskers"])
    objects = tuple(MAKERS[o["kind"]](**{k: v for k, v in o.items() if k != "kind"}) for o in case["objects"])
    springs = tuple(laws.PlainSpring(*s["between"], s["stiffness"], s["rest_length"]) for s in case["springs"])  # pyright: ignore
    return laws.Plain(rods, objects, springs, case["along_y"] or np.inf, case["turning"] or np.inf)


def held(plain: laws.Plain, values: dict, contacts: list, phase: int = laws.TANGENTIAL) -> tuple[laws.Held, ...]:
    """A stored state; the phase of contacts at the tip may not be stored, and is this one."""
    found = []
    for w, rod in enumerate(plain.rods):
        own = []
        for _, number, kind, force, arc, x, y in (c for c in contacts if c[0] == w + 1):
            normal = plain.objects[number - 1](np.array(x), np.array(y)).normal
            slope = float(np.arctan2(normal[0], -normal[1]))
            kind = phase if kind is None and arc == rod.length else kind or laws.TANGENTIAL
            own.append(laws.Contact(kind, force, arc, x, y, slope, number - 1))
        fx, fy, mz = (values[name][w] for name in ("fx", "fy", "mz"))
        places = (*(c.phase for c in own[::-1]), laws.FREE)
        yields = -fy / plain.along_y, -mz / plain.turning
        found.append(laws.Held(values["base_x"][w], *yields, fx, fy, mz, tuple(own), places))
    return tuple(found)


def stored(name: str):
    """A stored case in plain numbers, and its controls and states."""
    case = CASES[name]
    plain = plain_of(case)
    for k in range(0, len(case["control"]), STRIDE):
        values = {field: case[field][k] for field in ("base_x", "fx", "fy", "mz")}
        yield plain, case["control"][k], held(plain, values, case["contacts"][k])


@pytest.mark.parametrize("name", SMOOTH)
def test_stored_states_obey_all_laws(name):
    most = 0
    for plain, control, state in stored(name):
        found = laws.violations(plain, control, state)
        assert max(found.values()) < STORED, found
        assert all(spread > 0 for spread in laws.spreads(plain, state))
        assert laws.stability(plain, state) > 0
        most = max(most, sum(len(each.contacts) for each in state))
    assert most >= min(2, CASES[name]["contacts_at_once"])


@pytest.mark.parametrize(
    ("change", "law"),
    [
        ({"force": 1.01}, "balance"),
        ({"arc": 1.001}, "position"),
        ({"x": 1.001}, "surface"),
        ({"slope": 1.001}, "normal"),
        ({"force": -1.0}, "push"),
    ],
)
def test_a_changed_contact_breaks_a_law(change, law):
    plain, control, state = next(each for each in stored("wavy") if len(each[2][0].contacts) == 2)
    (whisker,) = state
    inner, outer = whisker.contacts
    ((field, factor),) = change.items()
    inner = inner._replace(**{field: factor * getattr(inner, field)})
    found = laws.violations(plain, control, (whisker._replace(contacts=(inner, outer)),))
    assert found[law] > 1e3 * STORED


@pytest.mark.parametrize(
    ("x", "y", "degrees", "off"),
    [
        (0.4, 0.3, -45.0, 0.0),  # at a corner, between the normals of its sides
        (0.4, 0.3, 0.0, 0.0),
        (0.4, 0.3, 10.0, np.sin(np.radians(10.0))),  # beyond that of its flank
        (0.4, 0.3, 135.0, np.inf),  # into the object
        (0.399, 0.3, -45.0, 1e-3),  # beside the corner
        (0.399, 0.3, -90.0, 0.0),  # on the bottom, along its normal
        (0.399, 0.3, -88.0, 1e-3),
    ],
)
def test_a_corner_pushes_between_the_normals_of_its_sides(x, y, degrees, off):
    turn = np.radians(degrees)
    found, _ = laws.box(0.3, 0.8, 0.5).touched(x, y, np.array([np.cos(turn), np.sin(turn)]))
    if np.isinf(off):
        assert found > 0.1
    else:
        assert abs(found - off) < STORED


def test_an_inner_corner_pushes_along_the_normals_of_its_sides_only():
    roof = laws.Outline(np.array(CASES["roof"]["objects"][0]["outline"]))
    left, right = (np.array([np.sin(turn), -np.cos(turn)]) for turn in (np.arctan2(0.3, 0.7), np.arctan2(-0.3, 0.6)))
    for normal in (left, right):
        assert roof.touched(0.0, 0.8, normal)[0] < STORED
    between = (left + right) / np.linalg.norm(left + right)
    assert roof.touched(0.0, 0.8, between)[0] > 0.1


def test_a_whisker_that_passes_through_an_object_is_noticed():
    plain, control, state = next(each for each in stored("two_circles") if each[2][0].contacts)
    (whisker,) = state
    free = whisker._replace(fx=0.0, fy=0.0, mz=0.0, contacts=(), places=(laws.FREE, laws.FREE))
    found = laws.violations(plain, control, (free,))
    assert found["depth"] > 1e-3


def test_a_base_that_is_not_where_its_spring_holds_it_is_noticed():
    plain, control, state = next(each for each in stored("two_circles_fbfb") if each[2][0].contacts)
    moved = state[0]._replace(x=state[0].x + 1e-5)
    assert laws.violations(plain, control, (moved, state[1]))["springs"] > 1e-6


def test_a_tip_contact_behind_two_circles_is_not_stable():
    """FB loses its stability where its last contact reaches the tip: it is stable before, and not after."""
    case = CASES["two_circles_fb"]
    plain, event = plain_of(case), case["events"][-2]["before"]
    assert case["events"][-1]["kind"] == "snap_off"
    before, after = (held(plain, event, event["contacts"], phase) for phase in (laws.TANGENTIAL, laws.TIP))
    assert laws.stability(plain, before) > 0.1
    assert laws.stability(plain, after) < -0.01


@pytest.mark.parametrize("name", SMOOTH)
def test_stability_vanishes_at_folds(name):
    case = CASES[name]
    plain, at = plain_of(case), 0.0
    for event in case["events"]:
        if "after" in event and event["control"] < at - AT_ONCE:
            state = held(plain, event["before"], event["before"]["contacts"], laws.TIP)
            assert abs(laws.stability(plain, state)) < FOLD
        at = event["control"]


@pytest.mark.parametrize("kind", KINDS)
def test_random_scenes_obey_all_laws(kind):
    number = list(KINDS).index(kind)
    for k in range(SCENES):
        one = drawn(kind, np.random.default_rng((0, number, k)))
        result = jw.scan(one.scene, one.control)
        if (kind, k) == ALONG_A_SIDE:
            assert set(np.asarray(result.status).tolist()) == {jw.Status.ok, jw.Status.unsettled}
        else:
            assert all_ok(result), (k, result)
        assert len(result.events) > 2
        for law, control, _, value in checked(one, result):
            assert value < SOLVED, (k, law, control)


def test_a_tip_snaps_into_an_inner_corner():
    one = drawn("roof, straight, clamped", np.random.default_rng((10, 12, 4)))
    result = jw.scan(one.scene, one.control)
    assert all_ok(result), result
    # The forces on both faces at the tip.
    into = [e for e in result.events if np.sum(np.asarray(e.after.phase) == laws.TIP) == 2]
    assert len(into) == 1 and into[0].kind == jw.EventKind.snap_through
    for law, control, _, value in checked(one, result):
        assert value < SOLVED, (law, control)


def test_a_cone_ends_as_not_convex_where_it_would_lie_on_the_object():
    # Its only contact, without any moment, comes to where the object becomes concave.
    one = drawn("wave, cone, FB", np.random.default_rng((10, 7, 5)))
    end = -0.766977
    result = jw.scan(one.scene, np.append(one.control[one.control > end + AT_END], [end + AT_END, end - AT_END]))
    assert np.all(result.status[:-1] == jw.Status.ok) and result.status[-1] == jw.Status.not_convex
    ((contact,),) = (held.contacts for held in laws.state_of(result, -2))
    rod, object_ = one.plain.rods[0], one.plain.objects[0]
    way = np.linspace(-NEAR, NEAR, 3)  # along the whisker
    x = contact.x + way * np.cos(contact.slope)
    curvature = object_(x, object_.g(x)).curvature
    assert abs(curvature[1]) < STRAIGHT * (curvature[2] - curvature[0]) / (2 * NEAR)
    moment = rod.stiffness(contact.arc + way) * curvature  # of a whisker that lies on the object
    assert contact.force > 1.5 * (moment[2] - moment[0]) / (2 * NEAR)
    assert -(moment[2] - 2 * moment[1] + moment[0]) / NEAR**2 > 1  # the pressure
