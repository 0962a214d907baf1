"""A scene pays for what it has: operations in what is traced, counted; they do not depend on the machine."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._equilibrium.newton import newton_step
from jaxwhisker._equilibrium.point import Mode, Point, at_control
from jaxwhisker._equilibrium.problem import problem_of
from operations import operations, rods, traced
from scenes import model

CONTROL = np.linspace(0.8, -1.6, 64)


def newton_operations(scene):
    """Operations of one Newton step, and of what the step's network adds."""
    dimensionless = problem_of(scene)
    n = scene.support.whiskers
    z = jnp.ones((n, 3))
    mode = Mode(jnp.full(n, 2), jnp.ones(n), jnp.asarray(False))
    point = Point(z, jnp.asarray(0.0))
    return operations(traced(lambda p, z: newton_step(p, mode, at_control(z.u, z.z), z), dimensionless, point))


def test_each_rung_costs_more_than_the_last():
    clamped, fb, fbfb = (newton_operations(model(name)) for name in ("clamped", "FB", "FBFB"))
    assert clamped < fb < fbfb


def test_a_clamped_whisker_has_no_network():
    assert problem_of(model("clamped")).flexibility is None
    # A network brings flexibility @ force, and its slope, into the step.
    assert newton_operations(model("FB")) - newton_operations(model("clamped")) >= 6


def test_springs_cost_the_newton_step_nothing():
    # FBFBR has a spring more than FBFB: that changes numbers in the flexibility matrix, not the step.
    assert newton_operations(model("FBFB")) == newton_operations(model("FBFBR"))


def test_whiskers_cost_the_rod_nothing():
    # Whiskers are lanes of one rod: what grows with their number is the small coupling system only.
    two, three = newton_operations(model("FBFB")), newton_operations(model("FBFBFBR"))
    assert three - two < 0.2 * two


def signals(scene):
    result = jw.scan(scene, CONTROL)
    return result.fx, result.fy, result.mz


def signals_and_events(scene):
    result = jw.scan(scene, CONTROL)
    return result.fx, result.fy, result.mz, result.events.before.mz


def slope(scene):
    return jax.grad(lambda scene: jnp.sum(jw.scan(scene, CONTROL).mz))(scene)


def of_scan(function, name="FB"):
    """The traced computation of a scan of a named model."""
    return traced(function, jax.tree.map(jnp.asarray, model(name)))


@pytest.mark.parametrize(("name", "most"), [("clamped", 6900), ("FB", 7250), ("FBFB", 7600)])
def test_a_scan_takes_so_many_operations(name, most):
    # Of an FB scan, half are decisions of the march; a change that adds many is asked for its reason here. Versions of
    # jax differ in what they trace a function to: 0.12 takes a tenth less than 0.10.
    assert 0.8 * most < operations(of_scan(signals, name)) < most


def test_a_scan_integrates_rods_in_three_places():
    # Of the march's Newton step, of the steps' and for the signals: values with Newton's own tangents, nothing more.
    assert rods(of_scan(signals)) == 3


def test_events_that_nobody_takes_are_not_computed():
    # Corners of the path are found in any case: without them there is no path. The states there are another matter.
    without, located = of_scan(signals), of_scan(signals_and_events)
    assert rods(located) > rods(without)
    assert operations(located) > operations(without) + 500


def test_derivatives_that_nobody_takes_are_not_computed():
    assert rods(of_scan(slope)) > rods(of_scan(signals)) + 3


ALLOWED = {"jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "numpy", "jaxtyping"}


def test_import_is_light():
    # Nothing but what these bring along themselves: neither matplotlib nor xarray nor tqdm before they are used.
    code = (
        "import sys\n"
        f"for name in {sorted(ALLOWED)}: __import__(name)\n"
        "before = set(sys.modules)\n"
        "import jaxwhisker\n"
        "import jax\n"
        "assert not jax.config.jax_enable_x64\n"
        "heavy = {name.split('.')[0] for name in set(sys.modules) - before} - set(sys.stdlib_module_names)\n"
        "heavy |= {'matplotlib', 'xarray', 'tqdm', 'pandas', 'scipy.integrate'} & set(sys.modules)\n"
        "print(*sorted(heavy - {'jaxwhisker'}))\n"
    )
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert run.stdout.split() == []


PROGRAMS = ["_spring_length", "follow_path", "problem_of", "solve_steps"]  # of one scan


def test_the_first_scan_compiles_each_of_its_parts_once(caplog):
    # March and steps are compiled ahead, at once, for a path that is not known yet: if its type were another than the
    # march's, by a weak integer even, they would be compiled once more, unnoticed.
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), rod=jw.Shooting(steps=3))
    with jax.log_compiles(), caplog.at_level("WARNING"):
        jw.scan(scene, CONTROL)
    compiled = [record.getMessage().split(")")[0].removeprefix("Compiling jit(") for record in caplog.records]
    assert sorted(name for name in compiled if name in PROGRAMS) == PROGRAMS
