"""The two mechanics offer everything that a scan asks for, under the same names and with the same arguments."""

import inspect
from typing import Any

import jax
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._scan.mechanics import Mechanics
from jaxwhisker._scan.plane import InThePlane
from jaxwhisker._scan.space import Space

FREE = jw.Scene(jw.Whisker(), jw.Parabola(0.3)), jw.Scene(jw.Whisker(), jw.Sphere(0.3, (0.0, 0.8, 0.1)))


@pytest.mark.parametrize("mechanics", [InThePlane, Space])
def test_a_mechanics_has_all_methods_with_the_same_arguments(mechanics):
    assert mechanics.__abstractmethods__ == frozenset()
    for name, method in vars(Mechanics).items():
        if isinstance(method, staticmethod) and name not in ("problem", "signals"):
            own = inspect.signature(getattr(mechanics, name)).parameters
            assert list(own) == list(inspect.signature(method.__func__).parameters), name
    for name in Mechanics.__annotations__:
        assert hasattr(mechanics, name), name


@pytest.mark.unchecked  # solutions are not needed
@pytest.mark.parametrize(("mechanics", "scene"), list(zip((InThePlane, Space), FREE, strict=True)))
def test_a_scan_without_friction_remembers_nothing(mechanics, scene):
    problem = dimensionless(scene)
    stops = np.array([1.0, 0.9])
    path = mechanics.follow(problem, stops, np.asarray(1)).path
    assert mechanics.memory(problem, path, stops) is None
    solutions: Any = None
    assert mechanics.remembered(None, path, solutions) is None
    assert mechanics.at_nodes(None, None) is None
    nodes = mechanics.event_nodes(problem, path)
    assert path.nodes.state.phase.shape == nodes.whiskers.shape
    assert len(jax.tree.leaves(problem.numbers())) > 0
