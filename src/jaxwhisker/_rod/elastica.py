"""The elastica between contact and base, seen from the contact: two ways to compute its end.

The contact is the origin, x along the object's tangent. There the moment vanishes and the force pushes along -y; `bend`
is the force over EI. Whatever the end is differentiated by, two tangents go through the computation, and twelve numbers
are all that a reverse pass has to keep: a longer rod is the same one with another piece at its base. (That holds for
uniform rods; others are differentiated as they are integrated.)
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
    """How rods are computed, and how exactly the equilibrium is solved for with them."""

    newton_tolerance: float = eqx.field(static=True, default=1e-6, kw_only=True)
    newton_steps: int = eqx.field(static=True, default=8, kw_only=True)

    def __check_init__(self):
        if not (isinstance(self.newton_tolerance, float) and 0 < self.newton_tolerance < 1):
            raise ValueError(f"`newton_tolerance` must be a float in (0, 1), but is {self.newton_tolerance!r}.")
        checks.count("newton_steps", self.newton_steps)

    @abc.abstractmethod
    def end(self, bend: Scalar, arc: Scalar, angle: Scalar, section: Section | None = None) -> End:
        """The rod's end an arc length before the contact, where it has that angle to the object.

        Of a rod that is not uniform `bend` is the force, and `section` tells what changes along it.
        """

    def for_rates(self) -> "AbstractRod":
        """The method for derivatives that a user sees, to be as exact as the values, of which they are a multiple."""
        return self


class Shooting(AbstractRod):
    """The rod's differential equation, integrated with diffrax from the contact to the base.

    Args:
        steps: of the solver; rods that are not uniform take twice as many, shorter where they are thinner. No status
            tells of too few: with the default solver 8 are good for 1e-9, and for 1e-7 of a cone.
        solver: any diffrax solver, its own adaptive steps not used; by default the best `Splitting` of order 6.
        newton_tolerance: size of the last Newton step; convergence is quadratic, so the error is about its square.
        newton_steps: limit of Newton's method; good predictions need 2.
    """

    steps: int = eqx.field(static=True, default=8)  # 1e-9 L in the base's position for the hardest bends of a scan
    solver: diffrax.AbstractSolver | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        checks.count("steps", self.steps)
        if not (self.solver is None or isinstance(self.solver, diffrax.AbstractSolver)):
            raise ValueError(f"`solver` must be a solver of diffrax, but is {self.solver!r}.")

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
    """Jacobi's elliptic functions: exact to rounding, for uniform straight whiskers.

    With chi = pi/2 - theta, theta the angle to the object, the rod is a pendulum, chi'' = -bend sin(chi), at rest where
    it touches. From sin(chi/2) = k cd(u, k), with u^2 = bend arc^2 and k = sin(chi/2) at the contact, follow
    cos(theta) = 2 k k' cd nd and sin(theta) = 1 - 2 k^2 cd^2, and with them their integrals. k^2 is at most 1/2.

    Args:
        newton_tolerance: size of the last Newton step; convergence is quadratic, so the error is about its square.
        newton_steps: limit of Newton's method; good predictions need 2.
    """

    def end(self, bend, arc, angle, section=None):
        assert section is None  # a Scene refuses it
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
    """The rod's end by one method, its derivatives by another one."""
    del for_rates
    return method.end(bend, arc, angle)


@rod_end.defjvp
def _(method, for_rates, primals, tangents):
    bend, arc, angle = primals

    def twice(bend_and_angle):
        end = for_rates.end(bend_and_angle[0], arc, bend_and_angle[1])
        return end, end

    by_bend_and_angle, end = jax.jacfwd(twice, has_aux=True)(jnp.stack([bend, angle]))
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
    """The end of a rod that is not uniform, by one method, its derivatives by another one."""
    del for_rates
    return method.end(force, arc, angle, section)


@uneven_rod_end.def_jvp
def _(primals, tangents):
    *at, method, for_rates = primals
    end, end_dot = eqx.filter_jvp(for_rates.end, tuple(at), tuple(tangents[:4]))
    return end if for_rates == method else uneven_rod_end(*primals), end_dot
