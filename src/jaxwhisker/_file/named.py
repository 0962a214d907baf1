"""Constructors with names that make a given part: `conical` for a cone, `fbfbr` for two whiskers with feedback.

Files are shorter with them. What is proposed here is written only if it makes the same part, to the last digit.
"""

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import jax
import numpy as np

from jaxwhisker._file.kinds import Kind, kinds_of
from jaxwhisker._model.along import LinearTaper, RoundMass, RoundSection
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker

Call = tuple[str, dict[str, Any]]  # name and arguments of a constructor


def named_call(part: Any) -> tuple[Kind, dict[str, Any]] | None:
    """A constructor that makes the part, and its arguments other than None; None if there is none."""
    made: Any = type(part)
    for name, arguments in _PROPOSALS[made](part) if made in _PROPOSALS else ():
        kind, given = kinds_of(made).get(name), {key: value for key, value in arguments.items() if value is not None}
        with suppress(ValueError):  # what a class allows, its constructors may refuse
            if kind is not None and same(kind.make(**given), part):
                return kind, given
    return None


def same(one: Any, other: Any) -> bool:
    """Whether two parts have the same structure and the same numbers, to the last bit."""
    leaves, others = jax.tree.leaves(one), jax.tree.leaves(other)
    return jax.tree.structure(one) == jax.tree.structure(other) and all(
        np.asarray(a, dtype=float).tobytes() == np.asarray(b, dtype=float).tobytes()
        for a, b in zip(leaves, others, strict=True)
    )


def _of_whisker(whisker: Whisker) -> Iterator[Call]:
    section, mass = whisker.bending_stiffness, whisker.mass_per_length
    if not isinstance(section, RoundSection):
        return
    known = {
        "length": whisker.length,
        "youngs_modulus": section.youngs_modulus,
        "intrinsic_curvature": whisker.intrinsic_curvature,
        "density": mass.density if isinstance(mass, RoundMass) else None,
    }
    taper = section.diameter
    if isinstance(taper, LinearTaper):
        yield "conical", known | {"base_diameter": taper.base, "tip_diameter": taper.tip}
    else:
        yield "from_material", known | {"diameter": taper}


def _of_support(support: Support) -> Iterator[Call]:
    name, springs = support.name.lower(), support.springs
    if not springs or any(spring.stiffness is None for spring in springs):
        return
    stiffness, rest = (tuple(getattr(one, key) for one in springs) for key in ("stiffness", "rest_length"))
    if all(np.ndim(number) == 0 and not callable(number) for number in (*stiffness, *rest)):
        if name != "follicle":
            yield name, {"stiffness": stiffness[0], "rest_length": rest[0]}
            if len(springs) > 1:
                yield name, {"stiffness": stiffness, "rest_length": rest[0]}
                yield name, {"stiffness": stiffness, "rest_length": rest}
        else:
            yield name, {one.axis: one.stiffness for one in springs} | {"mount": support.mount}


_PROPOSALS: dict[Any, Callable[[Any], Iterator[Call]]] = {Whisker: _of_whisker, Support: _of_support}
