"""A scan made by hand, for tests of what follows a scan: nothing is compiled."""

from typing import Any

import jax.numpy as jnp

import jaxwhisker as jw
from jaxwhisker._scan.quantities import STATE
from jaxwhisker._scan.state import OPTIONAL

SI = 0.05, 2.4e-5  # L in m and EI in N m^2: EI/L^2 = 9.6 mN, EI/L = 0.48 mN m


def handmade_scan(length=1.0, stiffness=1.0, *, touching=True, failed=0, count=1) -> jw.Result:
    """A scan of one whisker at two drive positions, with a touch at 0.7 L; the last `failed` steps are lost."""
    force = stiffness / length**2
    ok = jnp.arange(2) < 2 - failed
    values: dict[str, Any] = {name: jnp.zeros((2, 1)) for name in STATE if name not in OPTIONAL} | {
        "phase": jnp.full((2, 1), int(touching))
    }
    if touching:
        values |= {"fx": jnp.array([[0.0], [-2 * force]]), "mz": jnp.array([[0.5 * force * length], [jnp.nan]])}
    at: dict[str, Any] = {name: value[1:] for name, value in values.items()} | {"base_x": jnp.array([[0.3 * length]])}
    state = jw.State(**at)
    events = jw.Events(
        kind=jnp.array([int(jw.EventKind.touch)]),
        whiskers=jnp.array([[True]]),
        control=jnp.array([0.7 * length]),
        travel=jnp.zeros(1),
        before=state,
        after=state,
        count=jnp.asarray(count if touching else 0),
    )
    values["fx"] = jnp.where(ok[:, None], values["fx"], jnp.nan)
    return jw.Result(
        **values,
        control=length * jnp.array([1.0, 0.5]),
        spring_length=jnp.zeros((2, 1)),
        status=jnp.where(ok, int(jw.Status.ok), int(jw.Status.lost)),
        deferred_events=events,
        scene=jw.Scene(
            jw.Whisker(length, stiffness),
            jw.Parabola(0.2 * length, 1 / length),
            jw.Support.fb(70 * force / length, 0.2 * length),
        ),
    )
