"""Linearised whiskers: derivatives of their bases against differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._space.contact import Traction, base_of, frame_of, in_drive
from jaxwhisker._space.linear import linearise
from jaxwhisker._space.problem import of_each

SLOPE = 1e-7  # central differences with a step of 1e-5
TRACTIONS = [None, Traction(None, jnp.asarray(True)), Traction(jnp.asarray(0.3), jnp.asarray(False))]


@pytest.mark.parametrize("traction", TRACTIONS, ids=["none", "force", "friction"])
@pytest.mark.parametrize("whisker", [jw.Whisker(), jw.Whisker(lateral_curvature=0.4)], ids=["straight", "curved"])
def test_steps_change_the_base_as_differences_do(whisker, traction):
    friction = None if traction is None else traction.friction
    problem = dimensionless(jw.SpaceScene(whisker, jw.Sphere(1.0, (0.0, 0.0, 0.0)), friction=friction))
    out = np.array([0.3, -0.9, 0.2]) / np.linalg.norm([0.3, -0.9, 0.2])
    ahead = np.cross(out, [0.1, 0.2, 0.9])
    z = jnp.array([[0.8, 0.2 * problem.rolls, -0.2, *out, *ahead / np.linalg.norm(ahead), 0.3, -0.2]])
    phase, u = jnp.array([int(Phase.tip)]), jnp.asarray(0.2)
    drives = jax.jvp(problem.drive, (u,), (jnp.ones(()),))
    at = of_each(problem, lambda body, z, phase: linearise(problem, body, drives, z, phase, traction), z, phase)

    def pose(z, u):
        def one(body, z, phase):
            base = base_of(body, problem.surface, problem.rod, z, phase, traction)
            return in_drive(base, problem.drive(u), body.mount, z[1]).pose[: problem.rows]

        return of_each(problem, one, z, phase)[0]

    for k in range(at.directions.shape[-1]):
        step = 1e-5 * at.directions[:, :, k]
        np.testing.assert_allclose(at.pose_by[0, :, k], (pose(z + step, u) - pose(z - step, u)) / 2e-5, atol=SLOPE)
        # The normal turns with the contact.
        normals = [frame_of(problem.surface, (z + sign * step)[0])[:, 2] for sign in (1, -1)]
        np.testing.assert_allclose(at.out_by[0, :, k], (normals[0] - normals[1]) / 2e-5, atol=SLOPE)
    np.testing.assert_allclose(at.pose_by_u[0], (pose(z, u + 1e-5) - pose(z, u - 1e-5)) / 2e-5, atol=SLOPE)
    np.testing.assert_allclose(at.pose[0], pose(z, u), atol=1e-12)
