"""The whisker: a slender, inextensible, shearless elastic rod, straight or curved when unloaded."""

import inspect
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import as_text, number_or_function
from jaxwhisker._base.program import Program
from jaxwhisker._base.suggest import Suggesting
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.along import CHECKED_POINTS, AlongWhisker, Breaks, as_breaks
from jaxwhisker._model.round import Round
from jaxwhisker._rod.rod import Section, at_arc

CURVATURES = ("intrinsic_curvature", "lateral_curvature", "twist")
RATIOS = ("torsion_ratio", "lateral_ratio")  # to the bending stiffness
POISSON_RATIO = 0.3  # of a round rod whose torsional stiffness is not given


class Whisker(Round, metaclass=Suggesting):
    """A whisker, clamped upright at its base.

    With the default values everything is dimensionless: lengths in L, forces in EI/L^2, moments in EI/L.

    Args:
        length: L, the arc length from base to tip, in any unit of length; positive.
        bending_stiffness: EI, force times length squared: a positive number, or a function of the arc length s in
            [0, L] from the base that is positive and may vanish only at the tip. The function is called with one traced
            number. The parameters of an `equinox.Module` are differentiable; a plain function is constant.
        intrinsic_curvature: kappa0 = d phi / ds of the unloaded whisker, 1/length, positive counter-clockwise (towards
            -x, the default direction of a scan): a number, or a function like that of the bending stiffness. Default: a
            straight whisker, which is faster to compute than one with a curvature of 0.
        mass_per_length: rho A, mass per length: a positive number, which is the same everywhere along the whisker, or a
            function like that of the bending stiffness, which also may vanish only at the tip. For a cone it decreases
            like the square of the diameter; the constructors with a `density` compute it. Masses are needed for
            vibrations and motion; equilibria do not depend on them. Default: unknown.
        tip_mass: mass of a point attached to the tip, not negative. Default: none.
        base_mass: mass of a point that moves with the base, such as a follicle, not negative. It has an effect only
            where springs let the base move along x or y. Default: none.
        base_inertia: rotary inertia of what is attached to the base, about the base, mass times length squared, not
            negative. Default: none.
        torsion_ratio: GJ / EI, a positive number that is the same everywhere along the whisker. Only needed in space,
            where curved whiskers twist. Default: 1 / (1 + nu) of a round whisker, with Poisson's ratio nu = 0.3.
        lateral_ratio: EI of a strip against bending out of the plane, towards z, divided by the `bending_stiffness`,
            which is that against bending in the plane: a positive number that is the same everywhere along the whisker.
            Only for objects in space. Default: a whisker that is as stiff in every direction.
        lateral_curvature: k1 of the unloaded whisker, 1/length: a number, or a function like that of the bending
            stiffness. Positive bends an upright whisker out of the plane towards +z; the intrinsic curvature is
            kappa0 = -k2. Only for objects in space. Default: none.
        twist: k3 of the unloaded whisker, rad/length, at which the directions of these two curvatures turn about it: a
            number, or a function like that of the bending stiffness. Only for objects in space. Default: none.
        breaks: arc lengths from the base at which one of these functions jumps or has a kink: numbers inside (0, L), in
            ascending order. Integration steps and finite elements end there. The functions may have the value of either
            side at a break. Derivatives with respect to a break need the same number in the function. Default: none;
            then a warning says where functions are not resolved.

    Raises:
        ValueError: if the length is not a positive finite number, the bending stiffness, the mass per length or a
            ratio is not positive and finite, another mass is negative, JAX cannot trace a function with one
            number as its argument, the unloaded whisker turns by a right angle or more, or breaks are not inside the
            whisker, not in ascending order, or given without a function.

    Examples:
        >>> jw.Whisker().uniform
        True
        >>> cone = jw.Whisker(length=0.05, bending_stiffness=lambda s: 2e-6 * (1 - 15.0 * s) ** 4)
        >>> print(f"{cone.stiffness_at(0.04):.2e}")  # N m^2, at 40 mm from the base
        5.12e-08
    """

    length: Scalar = 1.0
    bending_stiffness: AlongWhisker = eqx.field(default=1.0, converter=number_or_function("bending_stiffness"))
    intrinsic_curvature: AlongWhisker | None = eqx.field(
        default=None, converter=number_or_function("intrinsic_curvature")
    )
    mass_per_length: AlongWhisker | None = eqx.field(
        default=None, kw_only=True, converter=number_or_function("mass_per_length")
    )
    tip_mass: Scalar | None = eqx.field(default=None, kw_only=True)
    base_mass: Scalar | None = eqx.field(default=None, kw_only=True)
    base_inertia: Scalar | None = eqx.field(default=None, kw_only=True)
    torsion_ratio: Scalar | None = eqx.field(default=None, kw_only=True)
    lateral_ratio: Scalar | None = eqx.field(default=None, kw_only=True)
    lateral_curvature: AlongWhisker | None = eqx.field(
        default=None, kw_only=True, converter=number_or_function("lateral_curvature")
    )
    twist: AlongWhisker | None = eqx.field(default=None, kw_only=True, converter=number_or_function("twist"))
    breaks: Breaks | None = eqx.field(default=None, kw_only=True, converter=as_breaks)

    def __check_init__(self):
        checks.number("length", self.length, positive=True)
        self._check_breaks()
        self._check_masses()
        for name in CURVATURES:
            if getattr(self, name) is not None and not callable(getattr(self, name)):
                checks.number(name, getattr(self, name))
        for name in RATIOS:
            if getattr(self, name) is not None:
                checks.number(name, getattr(self, name), positive=True)
        if not callable(self.bending_stiffness):
            checks.number("bending_stiffness", self.bending_stiffness, positive=True)
        if self.uniform or checks.is_traced(self):
            return
        self._check_along("bending_stiffness", self.bending_stiffness)
        with jax.ensure_compile_time_eval():
            turn = float(_largest_turn_now(jax.tree.map(checks.as_float, self.without_masses())))
        if not turn < np.pi / 2:
            given = [f"`{name}`" for name in CURVATURES if getattr(self, name) is not None]
            raise ValueError(
                f"{' and '.join(given)} must turn the unloaded whisker by less than a right angle, got a turn of "
                f"{np.degrees(turn):.4g} degrees: a whisker that curls up would touch in more than one place."
            )

    def _check_masses(self) -> None:
        for name in ("tip_mass", "base_mass", "base_inertia"):
            if getattr(self, name) is not None:
                checks.number(name, getattr(self, name), non_negative=True)
        if self.mass_per_length is None:
            return
        if not callable(self.mass_per_length):
            checks.number("mass_per_length", self.mass_per_length, positive=True)
        elif not checks.is_traced((self.length, self.mass_per_length)):
            self._check_along("mass_per_length", self.mass_per_length)

    def _check_breaks(self) -> None:
        if self.breaks is None:
            return
        functions = (getattr(self, name) for name in ("bending_stiffness", *CURVATURES, "mass_per_length"))
        if not any(map(callable, functions)):
            allowed = "absent unless bending stiffness, a curvature or mass per length is a function"
            checks.fail("breaks", allowed, _text(self.breaks))
        if checks.is_traced((self.breaks, self.length)):
            return
        if not _inside(np.asarray(self.breaks), float(self.length), np):
            checks.fail("breaks", f"in ascending order inside (0, {float(self.length):g})", _text(self.breaks))

    def _check_along(self, name: str, value: AlongWhisker) -> None:
        """Check that a concrete function of arc length is positive and finite."""
        with jax.ensure_compile_time_eval():
            values, positive = map(np.asarray, self._samples(value))
        if not positive.all():
            k = int(np.argmin(positive))
            allowed = "positive and finite along the whisker (zero only at the tip)"
            checks.fail(name, allowed, f"{values[k]} at {k / (CHECKED_POINTS - 1):.3g} of its length")

    @property
    def uniform(self) -> bool:
        """Whether the whisker is straight and its bending stiffness constant."""
        curved = self.intrinsic_curvature is not None or self.needs_space
        return not callable(self.bending_stiffness) and not curved

    @property
    def tapers(self) -> bool:
        """Whether the whisker is straight, and its bending stiffness is known not to increase towards the tip."""
        curved = self.intrinsic_curvature is not None or self.needs_space
        return not curved and getattr(self.bending_stiffness, "tapers", not callable(self.bending_stiffness))

    @property
    def needs_space(self) -> bool:
        """Whether the whisker is a strip, or has a lateral curvature or a twist, which the plane has no room for."""
        return any(getattr(self, name) is not None for name in ("lateral_ratio", "lateral_curvature", "twist"))

    @property
    def torsion(self) -> Scalar:
        """GJ / EI: the `torsion_ratio` or its default."""
        return 1 / (1 + POISSON_RATIO) if self.torsion_ratio is None else self.torsion_ratio

    def stiffness_at(self, s: Scalar) -> Float[Array, ""]:
        """EI at the arc length s from the base, force times length squared."""
        return at_arc(self.bending_stiffness, s)

    @property
    def base_stiffness(self) -> Scalar:
        """EI at the base; that of the first whisker is the unit in which scenes are dimensionless."""
        return self.stiffness_at(jnp.zeros(())) if callable(self.bending_stiffness) else self.bending_stiffness

    def valid(self):
        """Whether traced parameters are in the domain that the constructor checks."""
        length, (_, stiff) = jnp.asarray(self.length), self._samples(self.bending_stiffness)
        if self.breaks is not None:
            stiff &= _inside(jnp.asarray(self.breaks), length, jnp)
        for ratio in (self.torsion_ratio, self.lateral_ratio):
            if ratio is not None:
                stiff &= (jnp.asarray(ratio) > 0) & jnp.isfinite(ratio)
        return jnp.isfinite(length) & (length > 0) & jnp.all(stiff) & (self._largest_turn() < jnp.pi / 2)

    def valid_masses(self) -> Bool[Array, ""]:
        """Whether traced masses are in the domains that the constructor checks, with a mass per length."""
        points = (self.tip_mass, self.base_mass, self.base_inertia)
        masses = jnp.stack([jnp.asarray(0.0 if mass is None else mass, dtype=float) for mass in points])
        _, positive = self._samples(0.0 if self.mass_per_length is None else self.mass_per_length)
        return jnp.all(positive) & jnp.all((masses >= 0) & jnp.isfinite(masses))

    @property
    def has_masses(self) -> bool:
        """Whether any mass is given."""
        return any(mass is not None for mass in _masses(self))

    def without_masses(self) -> "Whisker":
        """The whisker without masses, which equilibria do not depend on."""
        kept = None if self.uniform else self.breaks  # the breaks of a uniform whisker are those of its mass
        return eqx.tree_at(_masses_and_breaks, self, (*[None] * 4, kept), is_leaf=lambda leaf: leaf is None)

    def mass_at(self, s: Scalar) -> Float[Array, ""]:
        """rho A at the arc length s from the base, mass per length; zero if it is unknown."""
        return at_arc(0.0 if self.mass_per_length is None else self.mass_per_length, s)

    def curvature_at(self, s: Scalar) -> Float[Array, ""]:
        """kappa0 at the arc length s from the base, 1/length, positive counter-clockwise."""
        return at_arc(0.0 if self.intrinsic_curvature is None else self.intrinsic_curvature, s)

    def curvature_in_space(self, s: Scalar) -> Float[Array, "3"]:
        """(k1, k2, k3) at the arc length s from the base, 1/length, with k2 = -kappa0."""
        k1, k3 = (0.0 if value is None else value for value in (self.lateral_curvature, self.twist))
        return jnp.stack([at_arc(k1, s), -self.curvature_at(s), at_arc(k3, s)])

    def section(self, length_unit: Scalar, stiffness_unit: Scalar, *, heavy: bool = False) -> Section:
        """Bending stiffness and intrinsic curvature along the whisker, in these units of length and EI.

        If it is `heavy`, its mass per length is a part of it.
        """
        one = jnp.asarray(1.0)  # an array, because the orientation of each whisker differs in a batch
        stiffness, curvature, breaks = self.bending_stiffness, self.intrinsic_curvature, self.breaks
        breaks = None if breaks is None else jnp.asarray(breaks)
        mass = self.mass_per_length if heavy else None
        return Section(stiffness, curvature, length_unit, stiffness_unit, one, breaks, mass)

    def _largest_turn(self) -> Float[Array, ""]:
        """Largest angle between the unloaded whisker and the upright."""
        if self.needs_space:
            return self._largest_turn_in_space()
        if self.intrinsic_curvature is None:
            return jnp.zeros(())
        step = jnp.asarray(self.length, dtype=float) / (CHECKED_POINTS - 1)
        curvature = jax.vmap(self.curvature_at)(step * jnp.arange(CHECKED_POINTS))
        return jnp.max(jnp.abs(jnp.cumsum((curvature[1:] + curvature[:-1]) / 2) * step))

    def _largest_turn_in_space(self) -> Float[Array, ""]:
        from jaxwhisker._base.rotation import rotation_matrix  # a whisker in the plane does without it

        step = jnp.asarray(self.length, dtype=float) / (CHECKED_POINTS - 1)
        middles = step * (jnp.arange(CHECKED_POINTS - 1) + 0.5)
        turns = jax.vmap(lambda s: rotation_matrix(step * self.curvature_in_space(s)))(middles)

        def onwards(frame, turn):
            frame = frame @ turn
            return frame, jnp.arctan2(jnp.hypot(frame[0, 2], frame[1, 2]), frame[2, 2])

        return jnp.max(jax.lax.scan(onwards, jnp.eye(3), turns)[1])

    def _samples(self, value: AlongWhisker) -> tuple[Float[Array, " points"], Bool[Array, " points"]]:
        """A quantity at points along the whisker, and whether it is positive, or zero at the tip, and finite."""
        return _samples_now(*jax.tree.map(checks.as_float, (value, self.length)))


for _base in Whisker.__mro__[1:3]:  # Round and Measured: errors of Python name functions as users call them
    for _name, _value in vars(_base).items():
        if isinstance(_value, classmethod):
            inspect.unwrap(_value.__func__).__qualname__ = f"Whisker.{_name}"


def _samples(value: AlongWhisker, length: Scalar) -> tuple[Float[Array, " points"], Bool[Array, " points"]]:
    s = np.linspace(0.0, 1.0, CHECKED_POINTS if callable(value) else 2) * length
    values = jax.vmap(lambda s: at_arc(value, s))(s)
    positive = (values > 0).at[-1].set(values[-1] >= 0)
    return values, positive & jnp.isfinite(values)


_samples_now, _largest_turn_now = Program(_samples), Program(Whisker._largest_turn)


def _masses(whisker: Whisker) -> tuple:
    return whisker.mass_per_length, whisker.tip_mass, whisker.base_mass, whisker.base_inertia


def _masses_and_breaks(whisker: Whisker) -> tuple:
    return *_masses(whisker), whisker.breaks


def _inside(breaks: Any, length: Any, numpy: Any) -> Any:
    """Whether breaks ascend and are inside the whisker."""
    return numpy.all(numpy.diff(breaks) >= 0) & (breaks[0] > 0) & (breaks[-1] < length)


def _text(breaks: Breaks) -> str:
    return "(" + ", ".join(map(as_text, breaks)) + ")"


def with_equal_breaks(whiskers: tuple[Whisker, ...]) -> tuple[Whisker, ...]:
    """Whiskers with equal numbers of breaks, which can be stacked; additional breaks are at the base."""
    own = [jnp.zeros(0) if whisker.breaks is None else jnp.asarray(whisker.breaks) for whisker in whiskers]
    most = max(breaks.size for breaks in own)
    if most == 0:
        return whiskers
    return tuple(
        eqx.tree_at(
            lambda w: w.breaks, whisker, jnp.pad(breaks, (most - breaks.size, 0)), is_leaf=lambda leaf: leaf is None
        )
        for whisker, breaks in zip(whiskers, own, strict=True)
    )
