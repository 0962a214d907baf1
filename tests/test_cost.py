"""A scene pays for what it has: operations in what is traced, counted; they do not depend on the machine."""

import subprocess
import sys

import jax
import jax.numpy as jnp

from jaxwhisker.equilibrium import Mode, Point, at_control, newton_step
from jaxwhisker.scene import problem
from scenes import model


def operations(jaxpr):
    """Operations of a jaxpr, those of inner ones included once."""
    total = 0
    for equation in jaxpr.eqns:
        total += 1
        for value in equation.params.values():
            for inner in value if isinstance(value, tuple | list) else [value]:
                core = getattr(inner, "jaxpr", inner)
                if hasattr(core, "eqns"):
                    total += operations(core)
    return total


def newton_operations(scene):
    """Operations of one Newton step, and of what the step's network adds."""
    dimensionless = problem(scene)
    n = scene.support.whiskers
    z = jnp.ones((n, 3))
    mode = Mode(jnp.full(n, 2), jnp.ones(n), jnp.asarray(False))
    point = Point(z, jnp.asarray(0.0))
    return operations(
        jax.make_jaxpr(lambda p, z: newton_step(p, mode, at_control(z.u, z.z), z))(dimensionless, point).jaxpr
    )


def test_each_rung_costs_more_than_the_last():
    clamped, fb, fbfb = (newton_operations(model(name)) for name in ("clamped", "FB", "FBFB"))
    assert clamped < fb < fbfb


def test_a_clamped_whisker_has_no_network():
    assert problem(model("clamped")).flexibility is None
    # A network brings flexibility @ force, and its slope, into the step.
    assert newton_operations(model("FB")) - newton_operations(model("clamped")) >= 6


def test_springs_cost_the_newton_step_nothing():
    # FBFBR has a spring more than FBFB: that changes numbers in the flexibility matrix, not the step.
    assert newton_operations(model("FBFB")) == newton_operations(model("FBFBR"))


def test_whiskers_cost_the_rod_nothing():
    # Whiskers are lanes of one rod: what grows with their number is the small coupling system only.
    two, three = newton_operations(model("FBFB")), newton_operations(model("FBFBFBR"))
    assert three - two < 0.2 * two


def test_import_is_light():
    code = (
        "import sys, jaxwhisker\n"
        "heavy = {'matplotlib', 'xarray', 'tqdm', 'pandas'} & set(sys.modules)\n"
        "import jax\n"
        "assert not jax.config.jax_enable_x64\n"
        "raise SystemExit(f'imports {heavy}' if heavy else 0)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
