"""Count the operations of a traced computation. Their number depends on neither machine nor compiler."""

import jax
from jax.interpreters import partial_eval

STAGES = 11  # of the default solver; identifies its loops


def inner(equation):
    """The jaxprs inside an equation."""
    for value in equation.params.values():
        for part in value if isinstance(value, tuple | list) else [value]:
            core = getattr(part, "jaxpr", part)
            if hasattr(core, "eqns"):
                yield core


def operations(jaxpr):
    """Number of operations of a jaxpr; those of inner jaxprs count once."""
    return sum(1 + sum(map(operations, inner(equation))) for equation in jaxpr.eqns)


def rods(jaxpr):
    """Number of rod integrations in a jaxpr; values and tangents integrated together count once."""
    loops = (e.primitive.name == "scan" and e.params["length"] == STAGES for e in jaxpr.eqns)
    return sum(loops) + sum(rods(core) for equation in jaxpr.eqns for core in inner(equation))


def traced(function, *args):
    """The jaxpr of a function, without operations that its results do not need."""
    closed = jax.make_jaxpr(function)(*args)
    jaxpr, _ = partial_eval.dce_jaxpr(closed.jaxpr, [True] * len(closed.jaxpr.outvars))
    return jaxpr
