"""PyElastica: a Cosserat rod whose clamped base is dragged beneath a sphere; every state is damped to rest.

PyElastica has no statics. Its rod also stretches and shears, but a thin rod does so very little: with EI = 1 the
stretching stiffness is 4 / radius^2. Contact is a user-defined force on the nodes inside the circle, because
RodSphereContact locates the element up to one element too far and the rod touches too early. The clamp holds the first
node and the first element, as OneEndFixedBC does, which makes the error first order.
"""

import elastica as ea
import numpy as np

from peers.scene import Circle

RADIUS = 0.02
SPEED = 0.2  # of the base between states; the slowest free vibration has a period of 1.8
REST = 8.0  # waiting time before a state is read
DAMPING = 3.0
CONTACT_STIFFNESS = 1e5


class _Simulator(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Damping):
    pass


class _Object(ea.NoForces):
    """Push nodes out of the circle."""

    def __init__(self, scene):
        super().__init__()
        self.centre, self.radius = np.array([[0.0], [scene.distance + scene.radius], [0.0]]), scene.radius

    def forces(self, rod):
        """Force on every node, (3, nodes)."""
        away = rod.position_collection - self.centre
        apart = np.sqrt(np.sum(away**2, axis=0))
        return CONTACT_STIFFNESS * np.maximum(self.radius / apart - 1, 0.0) * away

    def apply_forces(self, system, time=0.0):
        system.external_forces += self.forces(system)


class _Clamp(ea.ConstraintBase):
    """Hold the base upright and move it along x as a function of time."""

    def __init__(self, position, director, x_of_time, **kwargs):
        super().__init__(**kwargs)
        self.position, self.director, self.x_of_time = np.array(position), np.array(director), x_of_time

    def constrain_values(self, system, time):
        system.position_collection[..., 0] = self.x_of_time(time), self.position[1], self.position[2]
        system.director_collection[..., 0] = self.director

    def constrain_rates(self, system, time):
        system.velocity_collection[..., 0] = 0.0
        system.omega_collection[..., 0] = 0.0


def states(scene: Circle, base_x: np.ndarray, elements: int, offset: float = 0.0) -> np.ndarray:
    """Support reactions of a clamped whisker at decreasing base positions, (states, 6).

    The base moves beside the centre of the sphere, at z = `offset`. The reactions are fx, fy, fz, mx, my, mz.
    """
    start = scene.radius  # clear of the object
    drag = np.abs(np.diff([start, *base_x])) / SPEED
    ends = np.cumsum(drag + REST)
    times = np.stack([ends - drag - REST, ends - REST, ends], axis=1).ravel()
    places = np.stack([[start, *base_x[:-1]], base_x, base_x], axis=1).ravel()

    simulator = _Simulator()
    rod = ea.CosseratRod.straight_rod(
        elements,
        start=np.array([start, 0.0, offset]),
        direction=np.array([0.0, 1.0, 0.0]),
        normal=np.array([0.0, 0.0, 1.0]),
        base_length=1.0,
        base_radius=RADIUS,
        density=1 / (np.pi * RADIUS**2),
        youngs_modulus=4 / (np.pi * RADIUS**4),
    )
    simulator.append(rod)
    dt = 0.3 / elements * RADIUS / 2  # fraction of the time in which a longitudinal wave passes an element
    simulator.constrain(rod).using(
        _Clamp,
        constrained_position_idx=(0,),
        constrained_director_idx=(0,),
        x_of_time=lambda t: np.interp(t, times, places),
    )
    simulator.dampen(rod).using(ea.AnalyticalLinearDamper, uniform_damping_constant=DAMPING, time_step=dt)
    simulator.add_forcing_to(rod).using(_Object, scene)
    simulator.finalize()

    stepper, time, reactions = ea.PositionVerlet(), np.float64(0.0), []
    for end in ends:
        while time < end:
            time = stepper.step(simulator, time, np.float64(dt))
        push, arm = _Object(scene).forces(rod), rod.position_collection - rod.position_collection[:, :1]
        reactions.append(-np.append(push.sum(axis=1), np.cross(arm, push, axis=0).sum(axis=1)))
    return np.array(reactions)
