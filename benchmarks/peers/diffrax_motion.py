"""diffrax: the free whisker as a first-order system in q and q', with the shape functions of `simulate`.

With the angles phi = A q at the Gauss points, and W = reach^T mass reach, Lagrange's equations are

    A^T (W cos(phi_i - phi_j)) A q'' + A^T (W sin(phi_i - phi_j)) phi'^2 + K q = 0.

diffrax chooses the steps and interpolates between them. Its solvers know no contact: only the ring-down is simulated.
Of its implicit solvers, Kvaerno3 needs ten times as long as Kvaerno5; of the explicit ones, Tsit5 longer than Dopri8.
A controller with a proportional part has smaller errors in Kvaerno5 and needs less time in Dopri8.
"""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from jaxwhisker._dynamics.legendre import basis
from jaxwhisker._dynamics.moving import Damping, System, system_of
from peers.motion import RingDown

UNDAMPED = Damping(0.0, 0.0, (0.0, 0.0, 0.0))
MOST_STEPS = 100_000


def ring_down(motion: RingDown, shapes: int, tolerance: float, solver: diffrax.AbstractSolver) -> np.ndarray:
    """Tip x, y at all samples, (samples + 1, 2), with the same relative and absolute tolerance."""
    own, (fx, fy, mz) = basis(shapes), motion.reaction
    x, y, _ = motion.shape(np.append(0.0, own.points))[1:].T
    curvature = x * fy - y * fx - mz
    q = (2 * np.arange(shapes) + 1) * ((own.weights * curvature) @ own.curvatures)
    times = np.linspace(0.0, motion.duration, motion.samples + 1)
    system = system_of(jw.Sensor(jw.Whisker(mass_per_length=1.0)), UNDAMPED, shapes)
    return np.asarray(_solved(system, solver, jnp.asarray(q), jnp.asarray(times), jnp.asarray(tolerance)))


def _rate(_, state, system: System):
    """Rates of q and q'."""
    q, moves = state
    shapes, couples = system.basis.angles, system.rods.second[0]
    angle, turns = shapes @ q, shapes @ moves
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    mass = shapes.T @ (couples * (cos[:, None] * cos + sin[:, None] * sin)) @ shapes
    pull = (couples * (sin[:, None] * cos - cos[:, None] * sin)) @ turns**2
    force = shapes.T @ pull + system.rods.stiffness[0] @ q
    return moves, -jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(mass), force)


def _tip(_, state, system: System):
    angle = jnp.pi / 2 + system.basis.angles @ state[0]
    return system.basis.weights @ jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)


@eqx.filter_jit
def _solved(system: System, solver: diffrax.AbstractSolver, q, times, tolerance):
    return diffrax.diffeqsolve(
        diffrax.ODETerm(_rate),
        solver,
        times[0],
        times[-1],
        None,
        (q, jnp.zeros_like(q)),
        system,
        saveat=diffrax.SaveAt(ts=times, fn=_tip),
        stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance, pcoeff=0.3, icoeff=0.3),
        max_steps=MOST_STEPS,
    ).ys
