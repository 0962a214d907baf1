"""A segment of a rod in space under a force and a moment at its start, in the frame of its start, with derivatives.

Forward derivatives with respect to any number of parameters need only six changes of the state along the segment, due
to force and moment, and a seventh one if the rod is not uniform: its start then also depends on where it is.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.quaternions import product, times, total
from jaxwhisker._base.types import Scalar
from jaxwhisker._rod.space import SpaceLoad, SpaceSection, SpaceState, integrate, with_changes
from jaxwhisker._rod.space_end import SpaceEnd, longer

Load = Float[Array, "6"]  # force and moment at the start, along the directors there


def start_of(load: Load) -> tuple[SpaceState, SpaceLoad]:
    """The state at the start of a segment, in its own frame, and the load on it."""
    zero = jnp.zeros(())
    at_origin = (zero, zero, zero), (zero + 1, zero, zero, zero)
    return at_origin, SpaceLoad((load[0], load[1], load[2]), (load[3], load[4], load[5]))


def _end(load: Load, arc: Scalar, from_base: Scalar, section: SpaceSection, steps: int) -> SpaceEnd:
    start, on_rod = start_of(load)
    r, q = integrate(start, arc, on_rod, section, steps=steps, from_base=from_base)
    return jnp.stack([*r, *q])


@eqx.filter_custom_jvp
def segment_end(
    load: Load, arc: Scalar, from_base: Scalar, section: SpaceSection, steps: int, rate_steps: int
) -> SpaceEnd:
    """End of a segment towards the base.

    Args:
        load: force and moment of everything beyond, at the start.
        arc: length of the segment.
        from_base: arc length from the base to the start.
        section: stiffness and intrinsic curvature.
        steps: number of steps.
        rate_steps: number of steps for derivatives.
    """
    del rate_steps
    return _end(load, arc, from_base, section, steps)


@segment_end.def_jvp
def _(primals, tangents):
    load, arc, from_base, section, steps, rate_steps = primals
    end, by_load, by_arc, by_start = _end_and_slopes(load, arc, from_base, section, rate_steps)
    slopes = (lambda dot: jnp.sum(by_load * dot[:, None], axis=0)), (lambda dot: by_arc * dot)
    own = *slopes, (lambda dot: by_start * dot)
    terms = [slope(dot) for slope, dot in zip(own, tangents[:3], strict=True) if dot is not None]
    if jax.tree.leaves(tangents[3]):

        def by_section(section):
            return _end(load, arc, from_base, section, rate_steps)

        terms.append(eqx.filter_jvp(by_section, (section,), (tangents[3],))[1])
    change = total(*terms)
    return end if steps == rate_steps else segment_end(*primals), jnp.zeros_like(end) if change is None else change


def _end_and_slopes(
    load: Load, arc: Scalar, from_base: Scalar, section: SpaceSection, steps: int
) -> tuple[SpaceEnd, Float[Array, "6 7"], SpaceEnd, SpaceEnd]:
    """The end, and its derivatives with respect to the load, the arc, and the place of a start with the same arc."""
    start, on_rod = start_of(load)
    zero = jnp.zeros(())
    still = (zero, zero, zero), (zero, zero, zero)
    changes = [still] * 6
    if not section.uniform:
        changes.append(longer(start, on_rod, section, from_base))
    first = jax.tree.map(lambda *parts: jnp.stack(parts), *changes)
    fx, fy, fz, mx, my, mz = jnp.eye(6, len(changes))
    by_loads = SpaceLoad((fx, fy, fz), (mx, my, mz))
    end, last = with_changes(start, (first, by_loads), arc, on_rod, section, steps=steps, from_base=from_base)
    r, q = end

    def as_rates(change):
        moved, turn = change
        return jnp.stack([*moved, *product((None, *times(0.5, turn)), q)])

    rates = [as_rates(jax.tree.map(lambda leaf, k=k: leaf[k], last)) for k in range(len(changes))]
    by_arc = as_rates(longer(end, on_rod, section, from_base - arc))
    by_start = jnp.zeros_like(by_arc) if section.uniform else rates[6] - by_arc
    return jnp.stack([*r, *q]), jnp.stack(rates[:6]), by_arc, by_start
