"""Impulses that stop contacts: Coulomb's law holds for each of them, and in every step of a motion."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from jaxwhisker._dynamics.stop import balanced, pushes
from scenes import model

MU, H = 0.3, 0.01
ROUNDING = 1e-9  # relative; velocities and impulses are of order 1
BALANCED = 1e-9  # of the ledger of energy


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


def test_contacts_stop_together_and_none_pulls():
    rng = np.random.default_rng(1)
    root = rng.normal(size=(500, 3, 3))
    ease = root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(3)
    rates, so_far, touches = rng.normal(size=(500, 3)), rng.uniform(0, 0.5, (500, 3)), rng.uniform(size=(500, 3)) < 0.8
    given = np.asarray(jax.jit(jax.vmap(pushes))(touches, so_far, rates, ease))
    left = rates + np.einsum("nij,nj->ni", ease, given)
    assert np.all(given[~touches] == 0)
    assert np.all(so_far + given >= -ROUNDING, where=touches)
    stopped = np.abs(left) < ROUNDING
    assert np.all(stopped | (given == 0))
    assert np.sum(stopped.sum(axis=1) == 3) > 50 and np.sum(touches & (given == 0)) > 50  # both occur
    spent = np.einsum("ni,ni->n", given, rates) + np.einsum("ni,nij,nj->n", given, ease, given) / 2
    assert spent.max() < ROUNDING  # the kinetic energy does not grow
