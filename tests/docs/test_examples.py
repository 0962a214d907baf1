"""The examples in the docstrings of the public API print what they show."""

import doctest
import inspect

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw

# Users start with these names; each must have an example.
ILLUSTRATED = [
    *("Circle", "ClosedForm", "Contour", "Deflection", "Ellipse", "Graph", "Motion", "Mount", "Parabola", "PointForce"),
    *("LinearDrive", "Sphere", "SpaceForce", "SpaceMoment", "SpaceScene", "WhiskDrive"),
    *("PointMoment", "Rotation", "Scene", "Sensor", "Shooting", "Spring", "Support", "Tilted", "Translation"),
    *("Whisker", "Whisker.conical", "Whisker.from_material", "Whisker.rat", "deflect"),
]


def examples():
    """Examples by name of function or class."""
    finder, found = doctest.DocTestFinder(exclude_empty=True), {}
    for name in jw.__all__:
        own = inspect.unwrap(getattr(jw, name))
        # Constructors may be those of a base class.
        for kind in [base for base in inspect.getmro(own) if ours(base)] if inspect.isclass(own) else [own]:
            for test in finder.find(kind, name, module=False, globs={"jw": jw, "jnp": jnp, "np": np}):
                if test.examples:
                    found.setdefault(test.name, test)
    return found


def ours(kind):
    return kind.__module__.startswith("jaxwhisker")


EXAMPLES = examples()


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_prints_the_output_below_it(name):
    output = []
    doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(EXAMPLES[name], out=output.append)
    assert not output, "".join(output)


@pytest.mark.parametrize("name", ILLUSTRATED)
def test_names_that_users_start_with_have_an_example(name):
    assert name in EXAMPLES
