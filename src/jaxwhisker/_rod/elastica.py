"""The elastica between contact and base, in the frame of the contact: two ways to compute its end.

The contact is the origin, and x runs along the object's tangent. At the contact the moment vanishes and the force acts
along -y; `bend` is the force divided by EI.

Derivatives of a uniform rod's end need only two tangents through the computation, with respect to force and angle: a
longer rod is the same rod with another piece at its base, which gives the derivative with respect to the arc length. A
reverse pass stores twelve numbers. Other rods are differentiated through their integration.
"""

import abc
import dataclasses
from functools import partial

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.types import Scalar
from jaxwhisker._rod import rod
from jaxwhisker._rod.jacobi import jacobi
from jaxwhisker._rod.rod import Section

End = Float[Array, "4"]  # x, y, cos phi, sin phi at the base


class AbstractRod(eqx.Module):
    """Method that computes rods, and tolerance to which equilibria are solved."""

    newton_tolerance: float = eqx.field(static=True, default=1e-6, kw_only=True)
    newton_steps: int = eqx.field(static=True, default=8, kw_only=True)

    def __check_init__(self):
        if not (isinstance(self.newton_tolerance, float) and 0 < self.newton_tolerance < 1):
            checks.fail("newton_tolerance", "a float in (0, 1)", repr(self.newton_tolerance))
        checks.count("newton_steps", self.newton_steps)

    @abc.abstractmethod
    def end(self, bend: Scalar, arc: Scalar, angle: Scalar, section: Section | None = None) -> End:
        """End of the rod at its base, in the frame of the contact.

        Args:
            bend: force divided by EI, 1/length^2; the force itself if a section is given.
            arc: arc length from the base to the contact.
            angle: angle between the rod at the contact and the object, rad.
            section: stiffness and curvature along a rod that is not uniform.

        Returns:
            Position x, y (lengths) and direction cos phi, sin phi of the rod at its base, shape (4,).
        """

    def for_rates(self) -> "AbstractRod":
        """Method for derivatives that users take: they can exceed the values and need a smaller relative error."""
        return self


class Shooting(AbstractRod):
    """Integrate the rod's differential equation with diffrax, from the contact to the base.

    Args:
        steps: number of steps of equal size. Rods that are not uniform take twice as many, shorter where they are
            thinner; breaks of a whisker are further ends of steps. No status reports that there are too few steps: with
            the default solver, 8 steps give errors of 1e-9, and of 1e-7 for a cone. `scan` warns where they do not
            resolve a function of arc length.
        solver: any diffrax solver; its step-size control is not used. Default: a `Splitting` of order 6.
        newton_tolerance: largest size of the last Newton step, dimensionless. Convergence is quadratic: the error is
            about its square.
        newton_steps: maximum number of Newton steps; from good predictions, 2 suffice.

    Raises:
        ValueError: if `steps` or `newton_steps` is not a positive int, `newton_tolerance` is not a float in (0, 1), or
            `solver` is not a diffrax solver.

    Examples:
        >>> accurate = jw.Shooting(steps=12)
        >>> print(jw.Scene(jw.Whisker(), jw.Parabola(distance=0.2), rod=accurate))
        clamped: 1 whisker, parabola q = 0.2, shooting, 12 steps
    """

    steps: int = eqx.field(static=True, default=8)  # error of the base's position 1e-9 L for the strongest bends
    solver: diffrax.AbstractSolver | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        checks.count("steps", self.steps)
        if self.solver is not None:
            checks.instance("solver", self.solver, diffrax.AbstractSolver, "a solver of diffrax")

    def end(self, bend, arc, angle, section=None):
        zero = jnp.zeros_like(bend)
        start = (zero, zero, jnp.cos(angle), jnp.sin(angle))
        load = rod.Load(None, -bend, None)
        steps = self.steps if section is None else 2 * self.steps
        end = rod.integrate(start, arc, load, section, steps=steps, solver=self.solver, from_base=arc)
        return jnp.stack(end)

    def for_rates(self):
        return dataclasses.replace(self, steps=self.steps + -(-self.steps // 2))

    def __str__(self) -> str:
        return f"shooting, {self.steps} steps" + (f" of {type(self.solver).__name__}" if self.solver else "")


class ClosedForm(AbstractRod):
    """Evaluate the rod's closed form in Jacobi's elliptic functions: exact to rounding, but uniform straight rods only.

    Let theta be the angle between the rod and the object's tangent, and chi = pi/2 - theta. The rod is a pendulum,
    chi'' = -bend sin(chi), at rest at the contact: sin(chi/2) = k cd(u, k) with u^2 = bend arc^2 and k = sin(chi/2) at
    the contact. This gives cos(theta) = 2 k k' cd nd, sin(theta) = 1 - 2 k^2 cd^2 and their integrals. k^2 is at most
    1/2.

    Args:
        newton_tolerance: largest size of the last Newton step, dimensionless. Convergence is quadratic: the error is
            about its square.
        newton_steps: maximum number of Newton steps; from good predictions, 2 suffice.

    Raises:
        ValueError: if `newton_tolerance` is not a float in (0, 1), or `newton_steps` is not a positive int.

    Examples:
        >>> print(jw.Scene(jw.Whisker(), jw.Parabola(distance=0.2), rod=jw.ClosedForm()))
        clamped: 1 whisker, parabola q = 0.2, closed form
    """

    def end(self, bend, arc, angle, section=None):
        assert section is None  # checked by Scene
        cos, sin = jnp.cos(angle), jnp.sin(angle)
        sn, cn, dn, epsilon = jacobi(bend * arc**2, (1 - sin) / 2)
        cd, nd = cn / dn, 1 / dn
        return jnp.stack([
            -arc * cos * sn * nd,
            -arc * (2 * epsilon - 1 - (1 - sin) * sn * cd),
            cos * cd * nd,
            1 - (1 - sin) * cd**2,
        ])  # fmt: skip

    def __str__(self) -> str:
        return "closed form"


@partial(jax.custom_jvp, nondiff_argnums=(3, 4))
def rod_end(bend: Scalar, arc: Scalar, angle: Scalar, method: AbstractRod, for_rates: AbstractRod) -> End:
    """End of a uniform rod, computed by `method`; its derivatives are computed by `for_rates`."""
    del for_rates
    return method.end(bend, arc, angle)


@rod_end.defjvp
def _(method, for_rates, primals, tangents):
    bend, arc, angle = primals

    def value_twice(bend_and_angle):
        end = for_rates.end(bend_and_angle[0], arc, bend_and_angle[1])
        return end, end

    by_bend_and_angle, end = jax.jacfwd(value_twice, has_aux=True)(jnp.stack([bend, angle]))
    x, _, cos, sin = end
    turn = bend * x
    by_arc = jnp.stack([-cos, -sin, turn * sin, -turn * cos])
    bend_dot, arc_dot, angle_dot = tangents
    end_dot = by_bend_and_angle[:, 0] * bend_dot + by_arc * arc_dot + by_bend_and_angle[:, 1] * angle_dot
    return end if for_rates == method else rod_end(*primals, method, for_rates), end_dot


@eqx.filter_custom_jvp
def uneven_rod_end(
    force: Scalar, arc: Scalar, angle: Scalar, section: Section, method: AbstractRod, for_rates: AbstractRod
) -> End:
    """End of a rod that is not uniform, computed by `method`; its derivatives are computed by `for_rates`."""
    del for_rates
    return method.end(force, arc, angle, section)


@uneven_rod_end.def_jvp
def _(primals, tangents):
    *at, method, for_rates = primals
    end, end_dot = eqx.filter_jvp(for_rates.end, tuple(at), tuple(tangents[:4]))
    return end if for_rates == method else uneven_rod_end(*primals), end_dot
