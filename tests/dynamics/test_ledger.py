"""Work and losses of single time steps that are made by hand."""

# pyright: reportArgumentType=false
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._dynamics.gap import Gap
from jaxwhisker._dynamics.held import Pulls, SpringPositions, SprungShafts
from jaxwhisker._dynamics.ledger import booked, with_pulls
from jaxwhisker._dynamics.motion_state import Ledger, Moving, Rod, Touching
from jaxwhisker._dynamics.moving import Network, Rods, System
from jaxwhisker._equilibrium.shaft_springs import ShaftSprings
from jaxwhisker._model.motion import Pose

EXACT = 1e-12
N, NODES, POINTS, H = 2, 4, 2, 0.1
MASS = np.array([0.1, 1.0, 2.0, 0.3])
STIFFNESS = np.array([[2.0, 0.5], [0.5, 3.0]])
STORED = Ledger(*jnp.array([1.0, 2.0, 3.0, 4.0, 5.0]))


def system(mass_damping=0.0, stiffness_damping=0.0, held=None):
    """One whisker whose base a spring of stiffness 5, at rest at 0.2, holds along x."""
    none: Any = jnp.zeros((1, POINTS))
    rods = Rods(jnp.ones(1), none, STIFFNESS[None], MASS[None], jnp.full(1, 0.7), none, none, held)
    rods = jax.tree.map(jnp.asarray, rods)
    network = Network(jnp.full((1, 1), 1 / 5), jnp.array([[0.2, 0.0, 0.0]]), jnp.zeros((1, 1)))
    pose = Pose(*jnp.zeros((3, 1)))
    return System(rods, pose, network, None, None, mass_damping, stiffness_damping, (), free=(0,), n=N)


def moving(q=(0.0, 0.0), base=(0.0, 0.0, 0.0), at=0.0, velocity=0.0, spin=0.0, z=0.2, touching=None):
    """A state; all nodes have the same displacement and velocity along x."""
    nodes = jnp.zeros((1, 2, NODES)).at[0, 0]
    rod = Rod(
        jnp.array([q]), jnp.array([base]), jnp.zeros((1, POINTS)), nodes.set(at), nodes.set(velocity), spin, touching
    )
    rod = rod._replace(spin=jnp.full(1, spin))
    return Moving(rod, jnp.full(1, z), jnp.zeros(3), jnp.zeros((2, N + 1)), STORED, jnp.asarray(True))


@jax.jit
def changes(system, old, new, reaction, load):
    ledger = booked(system, old, new, reaction, load, H)
    return jax.tree.map(jnp.subtract, ledger, STORED)


def step(system, old, new, reaction=(0.0, 0.0, 0.0), load=0.0):
    return changes(system, old, new, jnp.array([reaction]), jnp.full(1, load))


def is_close(ledger, **expected):
    wanted = dict.fromkeys(Ledger._fields, 0.0) | expected
    np.testing.assert_allclose(ledger, [wanted[name] for name in Ledger._fields], atol=EXACT)


def test_air_and_material_take_energy():
    lost = 0.6 / H * MASS.sum() * 0.3**2
    is_close(step(system(mass_damping=0.6), moving(), moving(at=0.3)), damping=lost)
    q = np.array([0.2, -0.1])
    lost = 0.05 / H * q @ STIFFNESS @ q
    is_close(step(system(stiffness_damping=0.05), moving(q=(0.3, 0.3)), moving(q=(0.5, 0.2))), damping=lost)


def test_the_support_does_the_work_of_its_reaction():
    done = step(system(), moving(), moving(base=(0.1, -0.2, 0.3)), reaction=(2.0, 3.0, 4.0))
    is_close(done, work=0.2 - 0.6 + 1.2)


@pytest.mark.parametrize("damper", [0.0, 0.4])
def test_a_spring_stores_what_its_damper_does_not_take(damper):
    old, new = moving(z=0.3), moving(z=0.36)
    elastic = 5 * (0.33 - 0.2)  # mean force
    rate = 0.06 / H
    done = step(system(), old, new, load=elastic + damper * rate)
    is_close(done, work=0.06 * (elastic + damper * rate), damping=damper * rate * 0.06)


def touching(touches, began=False, arc=0.5, force=0.0, drag=0.0) -> Touching:
    none = jnp.zeros(1)
    gap = Gap(
        **{name: none for name in ("distance", "foot", "end", "at_tip")},
        normal=jnp.array([[0.6, -0.8]]),
        tangent=jnp.array([[0.8, 0.6]]),
        across=jnp.zeros((1, POINTS)),
        along=jnp.zeros((1, POINTS)),
        object=None,
    )
    each = (
        none + arc,
        none,
        gap,
        none + force,
        none + drag,
        none + touches > 0,
        none.astype(int),
        none + began > 0,
        none,
    )
    return Touching(*each, None)


def test_contacts_do_work_along_the_normal_or_end_an_approach():
    shift = 0.6 * -0.1 + -0.8 * 0.2
    for touches, arc in ((True, 0.5), (False, 0.5), (True, 0.3)):
        old, new = (
            moving(touching=touching(touches, arc=arc)),
            moving(base=(-0.1, 0.2, 0.0), touching=touching(1, force=3.0)),
        )
        lasts = touches and arc == 0.5
        is_close(step(system(), old, new), **{"contact": 3.0 * shift} if lasts else {"impact": -3.0 * shift})


def test_friction_takes_the_work_of_the_drag():
    slip = 0.8 * -0.1 + 0.6 * 0.2
    new = moving(base=(-0.1, 0.2, 0.0), touching=touching(True, drag=-2.0))
    is_close(step(system(), moving(touching=touching(True)), new), friction=2.0 * slip)


def test_the_implicit_step_loses_half_the_energy_of_the_changes():
    old = moving(touching=touching(True, began=True))
    new = moving(q=(0.2, -0.1), velocity=0.3, spin=0.4, z=0.3, touching=touching(True))
    q = np.array([0.2, -0.1])
    lost = (MASS.sum() * 0.3**2 + 0.7 * 0.4**2 + q @ STIFFNESS @ q + 5 * 0.1**2) / 2
    # The spring is as strained as at the end of the step, at 0.3.
    is_close(step(system(), old, new, load=0.5), impact=lost, work=0.1 * 0.5)


@pytest.mark.parametrize("moves", ["drive", "whisker"])
def test_springs_on_shafts_give_back_what_they_store(moves):
    """A spring of stiffness 3, at rest at 0.2, gets longer by 0.1 and is damped."""
    none = jnp.zeros((1, 1))
    springs = ShaftSprings(
        none, none, none, none, none + 3, none + 0.2, none.astype(int), none, none.astype(int), none + 1
    )
    held = SprungShafts(springs, jnp.eye(1, 3)[None], jnp.zeros((1, 1, POINTS)), jnp.zeros((1, 1, N)), none)
    first, longer = 0.5, 0.1
    stored, elastic, damped = 1.5 * (0.4**2 - 0.3**2), 3 * (first + longer / 2 - 0.2), 0.9
    at = jnp.zeros((1, 1, 3))
    moved = at.at[..., 0].add(longer if moves == "whisker" else 0.0)
    ends = SpringPositions(at, at, none + first), SpringPositions(moved, at, none + first + longer)
    pulls = Pulls(*ends, none + elastic, none + damped, at.at[..., 0].set(-elastic - damped), at)
    ledger = jax.jit(with_pulls)(system(held=held), moving(), STORED, pulls)
    work = stored + damped * longer if moves == "drive" else 0.0
    is_close(jax.tree.map(jnp.subtract, ledger, STORED), work=work, damping=damped * longer)
    # In an implicit step, the tension is that at the end, and the difference is lost.
    late = pulls._replace(elastic=none + 3 * 0.4, load=at.at[..., 0].set(-3 * 0.4 - damped))
    old = moving(touching=touching(True, began=True))
    ledger = jax.tree.map(jnp.subtract, jax.jit(with_pulls)(system(held=held), old, STORED, late), STORED)
    lost = 3 * 0.4 * longer - stored
    work = stored + damped * longer + lost if moves == "drive" else 0.0
    is_close(ledger, work=work, damping=damped * longer, impact=lost)
