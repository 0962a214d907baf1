"""What the march asks of whiskers: the same in the plane and in space, and nothing of what only one of them knows."""

# pyright: reportArgumentType=false, reportCallIssue=false

import re
from pathlib import Path
from types import SimpleNamespace

import pytest

import jaxwhisker._path
from jaxwhisker._path.continuation import Continuation
from jaxwhisker._plane.continuation import ContinuationInPlane
from jaxwhisker._space.continuation import ContinuationInSpace
from jaxwhisker._space.friction import ContinuationWithFriction, continuation_of

ENGINE = [Path(jaxwhisker._path.__path__[0]) / f"{name}.py" for name in ("march", "transitions", "margins")]


def test_the_march_asks_what_is_listed():
    asked = {name for file in ENGINE for name in re.findall(r"mechanics\.(\w+)", file.read_text("utf-8"))}
    listed = {name for name in {**vars(Continuation), **Continuation.__annotations__} if not name.startswith("_")}
    assert asked == listed


@pytest.mark.parametrize("mechanics", [ContinuationInPlane, ContinuationInSpace, ContinuationWithFriction])
def test_all_mechanics_answer(mechanics):
    assert not mechanics.__abstractmethods__


@pytest.mark.unchecked  # stand-ins have only the fields that are used
def test_friction_in_space_is_a_law_of_its_own():
    smooth, rough = (continuation_of(SimpleNamespace(friction=friction)) for friction in (None, 0.3))
    assert type(smooth) is ContinuationInSpace and type(rough) is ContinuationWithFriction
    # Contacts with friction may stick and slip many times.
    problem = SimpleNamespace(friction=0.3, length=SimpleNamespace(size=1))
    assert ContinuationWithFriction(problem).capacity(2) > 10 * ContinuationInSpace(problem).capacity(2)
    assert not re.search(r"friction is (not )?None", Path(ENGINE[1]).read_text("utf-8"))
