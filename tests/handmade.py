"""A scan made by hand, for tests of what follows a scan: nothing is compiled."""

import equinox as eqx
import numpy as np

import jaxwhisker as jw
from jaxwhisker._scan.quantities import STATE


def handmade_scan(whisker=None, *, touching=True, failed=0, count=1):
    """A scan of one whisker at two drive positions, with a touch at 0.7 L; the last `failed` steps are lost."""
    whisker = jw.Whisker() if whisker is None else whisker
    length, force = whisker.length, whisker.bending_stiffness / whisker.length**2
    values = {name: np.zeros((2, 1)) for name in STATE} | {"phase": np.full((2, 1), int(touching))}
    if touching:
        values |= {"fx": np.array([[0.0], [-2 * force]]), "mz": np.array([[0.5 * force * length], [np.nan]])}
    at = {name: value[1:] for name, value in values.items()} | {"base_x": np.array([[0.3 * length]])}
    state = jw.State(**at)
    events = jw.Events(
        kind=np.array([int(jw.EventKind.touch)]),
        whiskers=np.array([[True]]),
        control=np.array([0.7 * length]),
        travel=np.zeros(1),
        before=state,
        after=state,
        count=np.asarray(count if touching else 0),
    )
    control = length * np.array([1.0, 0.5])
    scene = jw.Scene(whisker, jw.Parabola(0.2 * length, 1 / length), jw.Support.fb(70 * force / length, 0.2 * length))
    status = np.where(np.arange(2) >= 2 - failed, int(jw.Status.lost), int(jw.Status.ok))
    result = jw.Result(
        **values, control=control, spring_length=np.zeros((2, 1)), status=status, events=events, scene=scene
    )
    if failed:
        result = eqx.tree_at(lambda r: r.fx, result, np.where(status[:, None] == jw.Status.ok, result.fx, np.nan))
    return result
