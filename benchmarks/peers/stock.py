"""The same equations with stock solvers of diffrax and stock Newton of optimistix, marched along the control.

The unknowns are z = (f, alpha, w) with s1 = 1 - max(w, 0) and the angle max(-w, 0) to the object. The rod is integrated
from contact to base. Every solve starts from the linear extrapolation of the last two solutions.
"""

import diffrax
import jax
import jax.numpy as jnp
import optimistix as optx

from peers.scene import CONTACT_SLOPE, Scene


def scan(scene: Scene, control, solver: diffrax.AbstractSolver, *, steps: int | None, tolerance: float):
    """Support reactions fx, fy, mz at every drive position, (steps, 3); adaptive steps if `steps` is None."""

    def field(_, state, args):
        x, y, cos, sin = state
        s1, force_x, force_y, xi, eta = args
        kappa = (xi - x) * force_y - (eta - y) * force_x
        return -s1 * jnp.stack([cos, sin, -kappa * sin, kappa * cos])

    def shot(z):
        f, alpha, w = z
        angle, tan = alpha + jnp.maximum(-w, 0.0), jnp.tan(alpha)
        force_x, force_y, xi, eta = f * jnp.sin(alpha), -f * jnp.cos(alpha), tan / 2, scene.distance + tan**2 / 4
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            solver,
            t0=0.0,
            t1=1.0,
            dt0=0.1 if steps is None else 1 / steps,
            y0=jnp.stack([xi, eta, jnp.cos(angle), jnp.sin(angle)]),
            args=(1 - jnp.maximum(w, 0.0), force_x, force_y, xi, eta),
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance)
            if steps is None
            else diffrax.ConstantStepSize(),
            adjoint=diffrax.ForwardMode(),
            max_steps=256 if steps is None else steps,
            throw=False,
        )
        x, y, cos, _ = solution.ys[0]
        return x, y, cos, (-force_x, -force_y, (xi - x) * -force_y + eta * force_x)

    def residual(z, u):
        x, y, cos, (fx, _, _) = shot(z)
        return jnp.stack([x - u - scene.rest_length + fx / scene.stiffness, y, cos])

    newton = optx.Newton(rtol=tolerance, atol=tolerance)

    def step(carry, u):
        last, change = carry
        z = optx.root_find(residual, newton, last + change, u, max_steps=16, throw=False).value
        return (z, z - last), jnp.stack(shot(z)[3])

    start = jnp.array([0.0, CONTACT_SLOPE, CONTACT_SLOPE - jnp.pi / 2])
    return jax.lax.scan(step, (start, jnp.zeros(3)), control)[1]
