"""The warning about steps: for which whiskers, and about which of their functions."""

# pyright: reportArgumentType=false
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from functions import Step
from jaxwhisker._scan.resolution import RESOLVED, _error, warn_of_steps, warn_of_whisker


def stepped(at=0.37, breaks=(), unit=1.0, curvature=0.4):
    return jw.Whisker(
        unit, Step(at * unit, 1.0, 0.4), Step(at * unit, 0.1 / unit, curvature / unit), breaks=np.array(breaks) * unit
    )


HEAVY = jw.Whisker(mass_per_length=Step(0.37, 1.0, 0.2))


def test_a_warning_names_the_functions_that_are_examined():
    with pytest.warns(UserWarning, match="`bending_stiffness` and `intrinsic_curvature`: the estimated error"):
        warn_of_whisker(stepped(breaks=(0.6,)), 16, masses=True)
    with pytest.warns(UserWarning, match="resolve `mass_per_length`:"):
        warn_of_whisker(HEAVY, 16, masses=True)


def test_whiskers_that_need_no_warning_are_not_examined():
    before = _error.compilations
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_whisker(jw.Whisker(), 16, masses=True)
        warn_of_whisker(HEAVY, 16)
        jax.eval_shape(lambda at: warn_of_whisker(jw.Whisker(1.0, Step(at, 1.0, 0.2)), 16), jnp.asarray(0.37))
    assert _error.compilations == before


def test_all_whiskers_of_a_scene_are_examined_with_twice_its_steps():
    # The jumps of the first whisker are breaks; those of the second one are not, and vanish.
    good = stepped(breaks=(0.37,))

    def warnings_of(*whiskers, steps=8):
        scene = jw.Scene(whiskers, jw.Parabola(0.2), jw.Support.fbfb(70.0), rod=jw.Shooting(steps=steps))
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            warn_of_steps(scene)
        return len(found)

    bad = stepped(breaks=(0.6,))
    assert warnings_of(good, good) == 0 and warnings_of(good, bad) == 1 and warnings_of(bad, bad) == 2


def test_the_error_does_not_depend_on_the_unit_of_length():
    one, large = (_error(jax.tree.map(jnp.asarray, stepped(breaks=(0.6,), unit=unit)), 16) for unit in (1.0, 1000.0))
    assert one == pytest.approx(float(large), rel=1e-9) and one > 100 * RESOLVED


@pytest.mark.parametrize("whisker", [stepped(breaks=(0.37,)), jw.Whisker.rat("C", 2)])
def test_no_warning_for_stepped_whiskers_and_cones(whisker):
    assert _error(jax.tree.map(jnp.asarray, whisker), 16) < RESOLVED
