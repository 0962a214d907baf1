"""PyElastica: the Cosserat rod in motion, and past several circles at rest.

The clamp holds the first node and the first element. This element reaches from half its length before the base to half
its length behind it, which makes the error second order. The thinner the rod, the less it stretches and shears and the
smaller the rotary inertia of its cross-sections, but the largest stable time step falls with the square of the radius.

Contact is a user-defined force between circles and the straight elements, because RodSphereContact locates the
element up to one element too far. It has a damper, and a LaplaceDissipationFilter damps the highest frequencies;
without them, contacts chatter when they pass from element to element.
"""

from collections.abc import Callable

import elastica as ea
import numpy as np
from numba import njit

from peers.motion import RingDown, Sweep, substeps
from peers.scene import Circles

LARGEST = 0.7  # time step, relative to the estimated limit of stability
DAMPED = 0.3  # damper of a contact, relative to critical damping of a node
FILTER_ORDER = 5
SPEED = 0.2  # of the base between states at rest
REST = 5.0  # time for which it then stands
RESTING = 6.0  # damping per mass on the way to rest
MEAN = 1.0  # time over which the reactions of a state are averaged


class _Simulator(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Damping):
    pass


@njit(cache=True)
def _push(force, position, velocity, x, y, radius, stiffness, damping):
    """Add the forces that push all elements out of the circle, shared by their nodes; they never pull."""
    last = position.shape[1] - 2
    for k in range(last + 1):
        along_x, along_y = position[0, k + 1] - position[0, k], position[1, k + 1] - position[1, k]
        share = (x - position[0, k]) * along_x + (y - position[1, k]) * along_y
        share /= along_x**2 + along_y**2
        if (share <= 0 and k > 0) or (share >= 1 and k < last):
            continue  # a neighbour is closer
        share = min(max(share, 0.0), 1.0)
        away_x, away_y = position[0, k] + share * along_x - x, position[1, k] + share * along_y - y
        apart = np.sqrt(away_x**2 + away_y**2)
        if apart < radius:
            speed_x = (1 - share) * velocity[0, k] + share * velocity[0, k + 1]
            speed_y = (1 - share) * velocity[1, k] + share * velocity[1, k + 1]
            speed = (speed_x * away_x + speed_y * away_y) / apart
            size = max(stiffness * (radius - apart) - damping * speed, 0.0) / apart
            force[0, k] += (1 - share) * size * away_x
            force[1, k] += (1 - share) * size * away_y
            force[0, k + 1] += share * size * away_x
            force[1, k + 1] += share * size * away_y


class _Object(ea.NoForces):
    """Push elements out of all circles."""

    def __init__(self, scene, stiffness, damping):
        super().__init__()
        self.circles, self.stiffness, self.damping = scene.circles, stiffness, damping

    def apply_forces(self, system, time=0.0):
        place = system.position_collection, system.velocity_collection
        for circle in self.circles:
            _push(system.external_forces, *place, *circle, self.stiffness, self.damping)


class _Clamp(ea.ConstraintBase):
    """Hold the first node and element and move them along x: displacement and velocity are functions of time."""

    def __init__(self, position, director, moved, velocity, **kwargs):
        super().__init__(**kwargs)
        self.position, self.director = np.array(position), np.array(director)
        self.moved, self.velocity = moved, velocity

    def constrain_values(self, system, time):
        system.position_collection[..., 0] = self.position
        system.position_collection[0, 0] += self.moved(time)
        system.director_collection[..., 0] = self.director

    def constrain_rates(self, system, time):
        system.velocity_collection[..., 0] = 0.0
        system.velocity_collection[0, 0] = self.velocity(time)
        system.omega_collection[..., 0] = 0.0


def _rod(elements: int, radius: float, x: float) -> ea.CosseratRod:
    h = 1 / (elements - 0.5)
    return ea.CosseratRod.straight_rod(
        elements,
        start=np.array([x, -h / 2, 0.0]),
        direction=np.array([0.0, 1.0, 0.0]),
        normal=np.array([0.0, 0.0, 1.0]),
        base_length=elements * h,
        base_radius=radius,
        density=1 / (np.pi * radius**2),
        youngs_modulus=4 / (np.pi * radius**4),
    )


def _clamped(rod: ea.CosseratRod, moved: Callable, velocity: Callable) -> _Simulator:
    simulator = _Simulator()
    simulator.append(rod)
    simulator.constrain(rod).using(
        _Clamp, constrained_position_idx=(0,), constrained_director_idx=(0,), moved=moved, velocity=velocity
    )
    return simulator


def _past(scene, rod, simulator, mass_damping: float, radius: float, dt: float) -> None:
    """Add damping, and contact with all circles of a scene."""
    stiffness = 100 / radius**2  # 25 EA / L
    damping = 2 * DAMPED * np.sqrt(stiffness / rod.n_elems)
    simulator.dampen(rod).using(ea.AnalyticalLinearDamper, uniform_damping_constant=mass_damping, time_step=dt)
    simulator.dampen(rod).using(ea.LaplaceDissipationFilter, filter_order=FILTER_ORDER)
    simulator.add_forcing_to(rod).using(_Object, scene, stiffness, damping)
    simulator.finalize()


def _reactions(rod: ea.CosseratRod) -> tuple[float, float, float]:
    """The force in the middle of the first element, at the base, and the moment extrapolated to it: fx, fy, mz."""
    x, y, _ = rod.director_collection[..., 0].T @ rod.internal_stress[:, 0]
    first, second = rod.bend_matrix[0, 0, :2] * rod.kappa[0, :2]
    return -x, -y, (second - 3 * first) / 2


def _largest_step(elements: int, radius: float) -> float:
    """Limits of shear in an element, and of longitudinal waves and bending."""
    return LARGEST * min(0.88 * radius**2, radius / (2 * elements))


def ring_down(motion: RingDown, elements: int, radius: float) -> np.ndarray:
    """Tip x, y at all samples, (samples + 1, 2)."""
    rod = _rod(elements, radius, 0.0)
    h = 1 / (elements - 0.5)
    angle = motion.shape(h * np.arange(elements))[:, 2]  # at the middles of the elements
    tangent = np.stack([np.cos(angle), np.sin(angle), np.zeros(elements)])
    rod.position_collection[:, 1:] = rod.position_collection[:, :1] + np.cumsum(h * tangent, axis=1)
    rod.director_collection[1] = np.stack([-tangent[1], tangent[0], tangent[2]])
    rod.director_collection[2] = tangent
    simulator = _clamped(rod, lambda t: 0.0, lambda t: 0.0)
    simulator.finalize()
    steps = substeps(motion, _largest_step(elements, radius))
    dt = np.float64(motion.duration / motion.samples / steps)
    stepper, time, tip = ea.PositionVerlet(), np.float64(0.0), []
    for k in range(motion.samples + 1):
        for _ in range(steps if k else 0):
            time = stepper.step(simulator, time, dt)
        tip.append(rod.position_collection[:2, -1].copy())
    return np.array(tip)


def sweep(motion: Sweep, elements: int, radius: float) -> np.ndarray:
    """Support reactions fx, fy, mz at all samples but the first, (samples, 3)."""
    rod = _rod(elements, radius, motion.start)
    rod.velocity_collection[0] = -motion.speed
    simulator = _clamped(rod, lambda t: -motion.speed * t, lambda t: -motion.speed)
    steps = substeps(motion, _largest_step(elements, radius))
    dt = np.float64(motion.duration / motion.samples / steps)
    _past(motion.scene, rod, simulator, motion.mass_damping, radius, dt)
    stepper, time, reactions = ea.PositionVerlet(), np.float64(0.0), []
    for _ in range(motion.samples):
        for _ in range(steps):
            time = stepper.step(simulator, time, dt)
        reactions.append(_reactions(rod))
    return np.array(reactions)


def states(scene: Circles, base_x: np.ndarray, elements: int, radius: float) -> np.ndarray:
    """Support reactions fx, fy, mz at decreasing base positions, (states, 3).

    The base moves, and rests for some time. Because the shear force at the base vibrates longest, reactions are means
    over the last part of this time.
    """
    rod = _rod(elements, radius, base_x[0])
    drag = np.abs(np.diff(base_x, prepend=base_x[0])) / SPEED
    ends = np.cumsum(drag + REST)
    times = np.stack([ends - REST, ends], axis=1).ravel()
    places = np.repeat(base_x - base_x[0], 2)

    def moved(t):
        return np.interp(t, times, places)

    def velocity(t):
        k = np.searchsorted(ends, t)
        return -SPEED if k < ends.size and t < ends[k] - REST else 0.0

    simulator = _clamped(rod, moved, velocity)
    dt = np.float64(_largest_step(elements, radius))
    _past(scene, rod, simulator, RESTING, radius, dt)
    stepper, time, reactions = ea.PositionVerlet(), np.float64(0.0), []
    for end in ends:
        read = []
        while time < end:
            time = stepper.step(simulator, time, dt)
            if time > end - MEAN:
                read.append(_reactions(rod))
        reactions.append(np.mean(read, axis=0))
    return np.array(reactions)
