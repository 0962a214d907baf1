"""Impulses that stop contacts: Coulomb's law holds for each of them, and in every step of a motion."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._dynamics.stop import SOFT, balanced, balanced_together
from scenes import model

MU, H = 0.3, 0.01
ROUNDING = 1e-9  # relative; velocities and impulses are of order 1
BALANCED = 1e-9  # of the ledger of energy
UNSETTLED = 1e-3  # share of random contacts whose modes go round in circles, and which therefore stop
SOFTENED = 1e-6  # of impulses of order 1: a hundred times SOFT over the smallest ease, 0.1


class Drawn:
    """Contacts with random velocities, inertia and forces."""

    def __init__(self, n, seed):
        rng = np.random.default_rng(seed)
        root = rng.normal(size=(n, 2, 2))
        self.ease = root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(2)  # positive definite
        self.rates = rng.normal(size=(n, 2)) * [0.3, 1.0]
        self.slip = rng.integers(-1, 2, n)
        self.force = rng.uniform(0, 100, n)
        self.drag = np.where(self.slip == 0, rng.uniform(-1, 1, n), -self.slip) * MU * self.force

    def impulses(self):
        """The impulses, and those of the whole step."""

        so_far = H * np.stack([self.force, self.drag], axis=1)
        given = jax.vmap(lambda *own: balanced(jnp.asarray(MU), *own))(self.slip, so_far, self.rates, self.ease)
        return np.asarray(given), so_far + given


def test_impulses_obey_the_law_of_friction():
    contacts = Drawn(4000, seed=0)
    given, total = contacts.impulses()
    left = contacts.rates + np.einsum("nij,nj->ni", contacts.ease, given)
    np.testing.assert_allclose(left[:, 0], 0, atol=ROUNDING)  # along the normal, every contact stops
    stops = np.abs(left[:, 1]) < ROUNDING
    limit = MU * np.abs(total[:, 0])
    rubs = np.abs(np.abs(total[:, 1]) - limit) < ROUNDING * (1 + limit)
    pushed_inwards = contacts.ease[:, 0, 0] < MU * np.abs(contacts.ease[:, 0, 1])  # Painleve
    pressed = (total[:, 0] > 0) & ~pushed_inwards
    assert np.all(stops | rubs)
    assert np.all(np.abs(total[:, 1]) <= limit * (1 + ROUNDING) + ROUNDING, where=pressed)
    assert min(np.sum(stops & pressed & ~rubs), np.sum(~stops & pressed)) > 500  # both occur
    assert np.all(total[:, 1] * left[:, 1] <= ROUNDING, where=pressed)  # what slides on, slides against friction


def test_friction_stays_within_its_cone_where_slips_end():
    scene = model("FB")
    scene = jw.Scene(jw.Whisker(mass_per_length=1.0), scene.profile, scene.support, friction=MU)
    duration = 2 * np.pi
    drive = 0.3 + 0.5 * np.cos(2 * np.linspace(0.0, duration, 201))
    motion = jw.simulate(scene, drive, duration, steps=1500, stiffness_damping=0.02)
    assert np.all(motion.status == jw.Status.ok)
    assert motion.slip is not None and motion.friction_force is not None and motion.normal_force is not None
    rested = (motion.slip[:-1] != 0) & (motion.slip[1:] == 0) & (motion.normal_force[1:] > 0)
    assert np.sum(rested) >= 2
    assert np.all(np.abs(motion.friction_force) <= MU * motion.normal_force * (1 + ROUNDING) + ROUNDING)
    e = motion.energy
    ledger = e.total[0] + e.work - e.damping - e.impact - e.friction + e.contact
    np.testing.assert_allclose(e.total, ledger, atol=BALANCED * float(e.work.max()))


class DrawnTogether:
    """Whiskers with several contacts, some of which touch, with random velocities, inertia and impulses so far."""

    def __init__(self, n, count, parts, seed):
        rng = np.random.default_rng(seed)
        root = rng.normal(size=(n, parts * count, parts * count))
        self.ease = root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(parts * count)
        self.rates = np.concatenate([size * rng.normal(size=(n, count)) for size in (0.3, 1.0)[-parts:]], axis=1)
        self.touches, self.slip = rng.uniform(size=(n, count)) < 0.8, rng.integers(-1, 2, (n, count))
        pressed = rng.uniform(0, 0.5, (n, count))
        drag = np.where(self.slip == 0, rng.uniform(-1, 1, (n, count)), -self.slip) * MU * pressed
        self.so_far = np.concatenate([pressed, drag][:parts], axis=1)

    def impulses(self, friction):
        """The impulses, the velocities after them, and the impulses of the whole step."""
        own = self.touches, self.slip == 0, self.slip, self.so_far, self.rates, self.ease
        given = np.asarray(jax.jit(jax.vmap(lambda *own: balanced_together(friction, *own)))(*own))
        return given, self.rates + np.einsum("nij,nj->ni", self.ease, given), self.so_far + given


def test_contacts_stop_together_and_none_pulls():
    drawn = DrawnTogether(500, 3, 1, seed=1)
    given, left, total = drawn.impulses(None)
    touches, rates, ease = drawn.touches, drawn.rates, drawn.ease
    assert np.all(given[~touches] == 0)
    assert np.all(total >= -ROUNDING, where=touches)
    stopped = np.abs(left) < ROUNDING
    assert np.all(stopped | (given == 0))
    assert np.sum(stopped.sum(axis=1) == 3) > 50 and np.sum(touches & (given == 0)) > 50  # both occur
    spent = np.einsum("ni,ni->n", given, rates) + np.einsum("ni,nij,nj->n", given, ease, given) / 2
    assert spent.max() < ROUNDING  # the kinetic energy does not grow


@pytest.mark.parametrize("count", [2, 3])
def test_each_of_several_contacts_obeys_the_law_of_friction(count):
    drawn = DrawnTogether(2000, count, 2, seed=count)
    given, left, total = drawn.impulses(jnp.asarray(MU))
    acts, (pressed, drag) = given[:, :count] != 0, np.split(total, 2, axis=1)
    assert np.all(drawn.touches, where=acts) and np.all(pressed > -ROUNDING, where=acts)
    # Of the resistance that keeps impulses finite, this is left.
    slow = 2 * SOFT * np.trace(drawn.ease, axis1=1, axis2=2)[:, None] * (1 + np.abs(given[:, count:]))
    stops, rubs = np.abs(left[:, count:]) < slow, np.abs(np.abs(drag) - MU * pressed) < ROUNDING * (1 + pressed)
    assert np.all(np.abs(left[:, :count]) < ROUNDING, where=acts)  # along the normal, every contact stops
    assert np.all(stops | rubs, where=acts)
    into, across = (np.diagonal(drawn.ease, k, 1, 2)[:, :count] for k in (0, count))
    lawful = acts & (into > MU * np.abs(across))  # not Painleve's paradox
    outside = lawful & (np.abs(drag) > MU * pressed * (1 + ROUNDING) + ROUNDING)
    assert np.mean(outside) < UNSETTLED and np.all(stops[outside])
    assert np.all(drag * left[:, count:] <= slow, where=lawful)  # what slides on, slides against friction
    assert min(np.sum(stops & lawful & ~rubs), np.sum(~stops & lawful)) > 300  # both occur


def test_a_contact_alone_stops_as_in_scenes_with_one_contact():
    drawn = DrawnTogether(2000, 1, 2, seed=3)
    given, _, _ = drawn.impulses(jnp.asarray(MU))
    own = drawn.slip[:, 0], drawn.so_far, drawn.rates, drawn.ease
    expected = jax.vmap(lambda *own: balanced(jnp.asarray(MU), *own))(*own)
    acts = given[:, 0] != 0
    assert np.sum(acts) > 500
    np.testing.assert_allclose(given[acts], np.asarray(expected)[acts], atol=SOFTENED)


def test_two_contacts_that_only_move_together_stop_together():
    ease = jnp.eye(4).at[2:, 2:].set(1.0)  # on a straight stretch, impulses along it act alike
    rates, so_far = jnp.array([-1.0, -1.0, 0.2, 0.2]), jnp.zeros(4)
    touches, slip = jnp.array([True, True]), jnp.array([0, 0])
    given = balanced_together(jnp.asarray(MU), touches, slip == 0, slip, so_far, rates, ease)
    np.testing.assert_allclose(given, [1.0, 1.0, -0.1, -0.1], atol=SOFTENED)
