"""Springs on the shaft and distributed loads: laws for a rod integrated outwards, derivatives, errors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxwhisker as jw

EXACT = 1e-8  # the accuracy of deflections, checked against a rod with tolerance 1e-12
SAME = 1e-9  # the same equilibrium, computed in another way
DIFFERENCE = 1e-5  # step of central differences, times numbers above 1
BY_DIFFERENCES = 1e-6  # their accuracy relative to the largest derivative

WHISKER = jw.Whisker(1.2, 1.7)
TAPERED = jw.Whisker(1.2, lambda s: 1.7 * (1 - s / 2.0) ** 4)
LOADS = (
    jw.PointForce(3.0, 0.9, direction=2.5),
    jw.PointMoment(-0.4, 0.5),
    jw.PointForce(1.0, 0.5, follower=True),
    jw.PointForce(0.5, 0.1),
)
AXIAL = jw.Spring((0, 1), 70.0, 0.2, axis="axial", at=0.15, anchor=(0.01, 0.12))
ABOVE = jw.Spring((0, 1), 4.0, 0.05, at=1.0)  # above all loads
TORSION = jw.Spring((0, 1), 3.0, 0.1, axis="phi", at=0.5)
BELOW = jw.Spring((0, 1), 40.0, 0.25, at=-0.1)
BASE = jw.Spring((0, 1), 50.0, 0.2)
TURN = jw.Spring((0, 1), 6.0, 0.05, axis="phi")
TISSUE = jw.Foundation(0.1, 0.3, 200.0, 0.21)
PATCH = jw.LineLoad(lambda s: -1.5 * s**2, 0.8, start=0.2, stop=0.7)
HEAVY = jw.LineLoad(y=-2.0)
SUPPORTS = {
    "springs": (WHISKER, jw.Support((BASE, AXIAL, TURN, ABOVE, TORSION, BELOW), jw.Mount(0.03, 0.02, 0.1))),
    "only above": (WHISKER, jw.Support((AXIAL,))),
    "tissue": (WHISKER, jw.Support((AXIAL,), foundation=TISSUE, free=("phi",))),
    "tapered": (TAPERED, jw.Support((BASE, AXIAL, ABOVE))),
}


def per_length(load):
    return isinstance(load, jw.LineLoad)


def outwards(whisker, support, loads, bent):
    """Load and moment beyond the tip, lengths of springs, and the rod at the points, from the base outwards."""
    mount, tissue = support.mounts[0], support.foundations[0]
    stiffness = whisker.bending_stiffness

    lines = [(load, float(load.start), float(load.stop or whisker.length)) for load in loads if per_length(load)]

    def rates(s, values, on, middle):
        x, y, phi, fx, fy, about = values
        bend = stiffness(s) if callable(stiffness) else stiffness
        push = np.array([-tissue.stiffness * (x - float(mount.x) - float(tissue.rest_length)) if on else 0.0, 0.0])
        for line, start, stop in lines:
            if start < middle < stop:
                push += [np.asarray(part(s) if callable(part) else part, dtype=float) for part in (line.x, line.y)]
        return [np.cos(phi), np.sin(phi), (about - x * fy + y * fx) / bend, *-push, y * push[0] - x * push[1]]

    fx, fy, mz, x, y, angle = (float(v) for v in (bent.fx, bent.fy, bent.mz, bent.base_x, bent.base_y, bent.base_angle))
    values = np.array([x, y, np.pi / 2 + angle, -fx, -fy, -mz - x * fy + y * fx])
    below = np.zeros(3)  # force and moment about the base by springs at and below the base
    lengths = {}
    loaded = [(float(load.position or whisker.length), load) for load in loads if not per_length(load)]
    loaded += [(end, None) for _, *both in lines for end in both]
    springs = [(float(spring.at), spring) for spring in support.springs if not spring.linear]
    ends = [] if tissue is None else [(tissue.start, None), (tissue.stop, None)]
    line, s = [], 0.0
    wanted = np.asarray(bent.s)
    for at, what in sorted([*loaded, *springs, *ends, (float(whisker.length), None)], key=lambda pair: pair[0]):
        stop = max(at, 0.0)
        if stop > s:
            on = tissue is not None and tissue.start <= s < tissue.stop
            path = solve_ivp(
                rates, (s, stop), values, args=(on, (s + stop) / 2), rtol=1e-12, atol=1e-13, dense_output=True
            )
            inside = np.unique(wanted[(wanted >= s) & (wanted < stop)])
            line += list(zip(inside, *path.sol(inside)[:3], strict=True)) if inside.size else []
            values, s = path.y[:, -1], stop
        x, y, phi = values[:3]
        if isinstance(what, jw.PointMoment):
            values[5] -= what.moment
        elif isinstance(what, jw.PointForce):
            way = what.direction + (phi - np.pi / 2 if what.follower else 0.0)
            push = what.force * np.array([np.cos(way), np.sin(way)])
            values[3:] -= *push, x * push[1] - y * push[0]
        elif what is not None:
            reach = min(at, 0.0)
            x, y = x + reach * np.cos(phi), y + reach * np.sin(phi)
            if what.anchor is not None:
                ax, ay = what.anchor
            else:
                ax, ay = mount.x - at * np.sin(mount.angle), mount.y + at * np.cos(mount.angle)
            away = np.array([x - ax, y - ay])
            turned = phi - np.pi / 2 - mount.angle
            length = {"axial": np.hypot(*away), "x": away[0], "y": away[1], "phi": turned}[what.axis]
            tension = what.stiffness * (length - what.rest_length)
            unit = {"axial": away / max(np.hypot(*away), 1e-9), "x": [1, 0], "y": [0, 1], "phi": [0, 0]}[what.axis]
            push, turn = -tension * np.array(unit), -tension * (what.axis == "phi")
            lengths[id(what)] = length
            if at > 0:
                values[3:] -= *push, x * push[1] - y * push[0] + turn
            else:
                base_x, base_y = float(bent.base_x), float(bent.base_y)
                below += *push, (x - base_x) * push[1] - (y - base_y) * push[0] + turn
    return values, below, lengths, np.array(line)


CASES = {name: (*both, LOADS) for name, both in SUPPORTS.items()} | {
    "line loads": (WHISKER, jw.Support.clamped(), (PATCH, HEAVY)),
    "all loads": (TAPERED, jw.Support((BASE, TURN)), (*LOADS, PATCH, HEAVY)),
    "line loads on springs": (WHISKER, jw.Support((BASE, ABOVE), foundation=TISSUE), (HEAVY, PATCH, LOADS[1])),
}


@pytest.mark.parametrize("name", CASES)
def test_rods_from_the_base_end_without_a_load(name):
    whisker, support, loads = CASES[name]
    bent = jw.deflect(whisker, *loads, support=support)
    assert bent.status == jw.Status.ok
    (x, y, phi, fx, fy, about), below, lengths, line = outwards(whisker, support, loads, bent)
    np.testing.assert_allclose([fx, fy, about - x * fy + y * fx], 0.0, atol=EXACT)
    np.testing.assert_allclose([x, y, phi], [bent.x[-1], bent.y[-1], bent.angle[-1]], atol=EXACT)
    for field, exact in zip((bent.x, bent.y, bent.angle), line[:, 1:].T, strict=True):
        np.testing.assert_allclose(np.interp(line[:, 0], bent.s, field), exact, atol=EXACT)
    carried = np.array([bent.fx, bent.fy, bent.mz])
    mount, pose = support.mounts[0], np.array([bent.base_x, bent.base_y, bent.base_angle])
    moved = pose - [mount.x, mount.y, mount.angle]
    network = {"x": 0.0, "y": 0.0, "phi": 0.0}
    for k, spring in enumerate(support.springs):
        if spring.linear:
            length = moved[list(network).index(spring.axis)]
            network[spring.axis] -= spring.stiffness * (length - spring.rest_length)
        else:
            length = lengths[id(spring)]
        np.testing.assert_allclose(bent.spring_length[k], length, atol=EXACT)
    for k, axis in enumerate(network):
        if axis in support.axes:
            np.testing.assert_allclose(carried[k], network[axis] + below[k], atol=EXACT * 10)
        else:
            np.testing.assert_allclose(moved[k], 0.0, atol=SAME)
    assert abs(float(bent.mz)) > 0.1 or "phi" in support.free


def test_a_spring_at_the_base_is_a_base_spring():
    expected = jw.deflect(WHISKER, *LOADS, support=jw.Support((BASE,)), points=21)
    at_base = jw.Spring((0, 1), 50.0, 0.2, at=0.0)
    result = jw.deflect(WHISKER, *LOADS, support=jw.Support((at_base,)), points=21)
    for name in vars(expected).keys() - {"whisker", "loads", "support"}:
        expected_values, values = np.asarray(getattr(expected, name)), np.asarray(getattr(result, name))
        if name in ("s", "x", "y", "angle", "curvature"):  # beyond the loads, a free straight end needs two points only
            expected_values, values = expected_values[:84], values[:84]
        np.testing.assert_allclose(values, expected_values, atol=SAME, err_msg=name)


PARAMETERS = {"force": 3.0, "at": 0.15, "c": 70.0, "rest": 0.2, "anchor": 0.12, "base": 50.0, "length": 1.2}
TISSUE_TOO = {"start": 0.1, "stop": 0.3, "density": 200.0, "across": 0.21}
AT = jnp.array([*PARAMETERS.values(), *TISSUE_TOO.values()])


def values(numbers):
    force, at, c, rest, anchor, base, length, *tissue = numbers
    springs = (
        jw.Spring((0, 1), c, rest, axis="axial", at=at, anchor=(0.01, anchor)),
        jw.Spring((0, 1), base, 0.2),
    )
    support = jw.Support(springs, foundation=jw.Foundation(*tissue))
    bent = jw.deflect(jw.Whisker(length), jw.PointForce(force, direction=2.8), support=support, points=5)
    return jnp.concatenate([jnp.stack([bent.fx, bent.fy, bent.mz, bent.base_x]), bent.spring_length, bent.x])


def test_derivatives_agree_with_differences_in_both_modes():
    @jax.jit
    def all_of(numbers, weights):
        value, along = jax.linearize(values, numbers)
        columns = jax.vmap(along, out_axes=-1)(jnp.eye(numbers.size))
        return value, columns, jax.linear_transpose(along, numbers)(weights)[0]

    weights = np.random.default_rng(4).normal(size=jax.eval_shape(values, AT).shape)
    _, forward, reverse = all_of(AT, weights)
    np.testing.assert_allclose(reverse, weights @ np.asarray(forward), rtol=SAME)
    for k, name in enumerate((*PARAMETERS, *TISSUE_TOO)):
        size = DIFFERENCE * max(1.0, float(AT[k]))
        step = size * jnp.eye(AT.size)[k]
        difference = (all_of(AT + step, weights)[0] - all_of(AT - step, weights)[0]) / (2 * size)
        atol = BY_DIFFERENCES * np.max(np.abs(forward[:, k]))
        np.testing.assert_allclose(forward[:, k], difference, atol=atol, err_msg=name)
        assert np.max(np.abs(forward[:, k])) > 1e-5, name


def test_failed_batch_elements_leave_their_neighbours_alone():
    def moment(at, force):
        spring = jw.Spring((0, 1), 70.0, 0.2, at=at)
        bent = jw.deflect(jw.Whisker(), jw.PointForce(force), support=jw.Support((spring,)), points=2)
        return bent.mz, bent.status

    def mean(ats, forces):
        found, status = jax.vmap(moment)(ats, forces)
        return jnp.nanmean(found), (found, status)

    ats, forces = jnp.array([0.1, 1.5, jnp.nan, 0.1]), jnp.array([2.0, 2.0, 2.0, 1e7])
    (_, (found, status)), (by_at, _) = jax.jit(jax.value_and_grad(mean, (0, 1), has_aux=True))(ats, forces)
    assert status.tolist() == [jw.Status.ok, jw.Status.invalid, jw.Status.invalid, jw.Status.inexact]
    assert np.isfinite(found[0]) and np.all(np.isnan(found[1:]))
    assert by_at[0] != 0 and np.all(by_at[1:] == 0)


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("whisker", "support", "words"),
    [
        (jw.Whisker(), jw.Support((ABOVE,)), "`at` must be less than the length 1.0, got 1.0"),
        (jw.Whisker(), jw.Support(foundation=jw.Foundation(0.1, 1.5, 9.0)), "`stop` must be less than the length"),
        (
            jw.Whisker(intrinsic_curvature=0.3),
            jw.Support(foundation=jw.Foundation(0.1, 0.5, 9.0)),
            "`whisker` must be straight on a Foundation",
        ),
    ],
)
def test_wrong_arguments(whisker, support, words):
    with pytest.raises(ValueError, match=words):
        jw.deflect(whisker, jw.PointForce(1.0), support=support)
