"""Argument checks: before tracing, a ValueError with name, allowed values and value; while tracing, a status."""

# pyright: reportArgumentType=false, reportCallIssue=false
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base import checks

pytestmark = pytest.mark.unchecked

nan, inf = float("nan"), float("inf")

CASES = [
    ("length", lambda: jw.Whisker(length=-1.0), "positive"),
    ("scene", lambda: jw.stored_energy(3, 4), "Scene"),
    ("compliance", lambda: jw.Spring((0, 1), compliance=-1.0), "non-negative"),
    ("compliance", lambda: jw.Spring((0, 1), compliance=inf), "finite"),
    ("compliance", lambda: jw.Spring((0, 1), 3.0, compliance=1.0), "Exactly one"),
    ("stiffness", lambda: jw.Spring((0, 1)), "Exactly one"),
    ("length", lambda: jw.Whisker(length=0.0), "positive"),
    ("length", lambda: jw.Whisker(length=nan), "positive"),
    ("length", lambda: jw.Whisker(length=inf), "finite"),
    ("bending_stiffness", lambda: jw.Whisker(bending_stiffness=0.0), "positive"),
    ("bending_stiffness", lambda: jw.Whisker(bending_stiffness=nan), "positive"),
    ("length", lambda: jw.Whisker(length=np.ones(3)), "number"),
    ("length", lambda: jw.Whisker(length="long"), "number"),
    ("distance", lambda: jw.Parabola(0.0), "positive"),
    ("distance", lambda: jw.Parabola(-0.2), "positive"),
    ("distance", lambda: jw.Parabola(nan), "positive"),
    ("a", lambda: jw.Parabola(0.2, a=0.0), "positive"),
    ("a", lambda: jw.Parabola(0.2, a=nan), "positive"),
    ("position", lambda: jw.Parabola(0.2, position=nan), "finite"),
    ("radius", lambda: jw.Circle(0.2, -1.0), "positive"),
    ("radius", lambda: jw.Circle(0.2, nan), "positive"),
    ("a", lambda: jw.Ellipse(0.2, 0.0, 1.0), "positive"),
    ("b", lambda: jw.Ellipse(0.2, 1.0, -1.0), "positive"),
    ("g", lambda: jw.Graph(3.0), "function"),
    ("extent", lambda: jw.Graph(lambda x: x**2 + 1, extent=-1.0), "positive"),
    ("stiffness", lambda: jw.Support.fb(-3.0, 0.2), "positive"),
    ("stiffness", lambda: jw.Support.fb(0.0, 0.2), "positive"),
    ("stiffness", lambda: jw.Spring((0, 1), nan), "positive"),
    ("rest_length", lambda: jw.Support.fb(70.0, nan), "finite"),
    ("stiffness", lambda: jw.Support.fbfb([70.0, 70.0, 70.0], 0.2), "per spring"),
    ("stiffness", lambda: jw.Support.fb([70.0, 50.0], 0.2), "per spring"),
    ("rest_length", lambda: jw.Support.fbfbr(70.0, [0.2, 0.2]), "per spring"),
    ("model", lambda: jw.Support.named("BFF", 70.0), "FBFBR"),
    ("between", lambda: jw.Spring((1, 1), 70.0), "different"),
    ("between", lambda: jw.Spring((0, -1), 70.0), "pair of ints"),
    ("between", lambda: jw.Spring((0, 1, 2), 70.0), "pair of ints"),
    ("between", lambda: jw.Spring((0, 0.5), 70.0), "pair of ints"),
    ("springs", lambda: jw.Support((jw.Spring((0, 1), 1.0), jw.Spring((2, 3), 1.0))), "connect"),
    ("springs", lambda: jw.Support((jw.Spring((0, 3), 1.0),)), "connect"),
    ("springs", lambda: jw.Support((70.0,)), "Spring"),
    ("whisker", lambda: jw.Scene((jw.Whisker(), jw.Whisker()), jw.Parabola(0.2), jw.Support.fb(70.0)), "FB"),
    ("whisker", lambda: jw.Scene(1.0, jw.Parabola(0.2)), "Whisker"),
    ("profile", lambda: jw.Scene(jw.Whisker(), 0.2), "Parabola"),
    ("support", lambda: jw.Scene(jw.Whisker(), jw.Parabola(0.2), 70.0), "Support"),
    ("scene", lambda: jw.scan("FB"), "Scene"),
    ("control", lambda: jw.scan(scene, np.zeros((3, 2))), "one-dimensional"),
    ("control", lambda: jw.scan(scene, np.zeros(0)), "non-empty"),
    ("control", lambda: jw.scan(scene, 0.5), "one-dimensional"),
    ("control", lambda: jw.scan(scene, np.array([0.5, nan, 0.3])), "index 1"),
    ("control", lambda: jw.scan(scene, [0.5, inf]), "finite"),
    ("control", lambda: jw.scan(scene, ["left", "right"]), "numbers"),
    ("loads", lambda: jw.deflect(jw.Whisker()), "PointForce"),
    ("position", lambda: jw.deflect(jw.Whisker(), jw.PointForce(1.0, position=1.5)), "at most"),
    ("position", lambda: jw.PointForce(1.0, position=-0.5), "positive"),
    ("force", lambda: jw.PointForce(nan), "finite"),
    ("points", lambda: jw.deflect(jw.Whisker(), jw.PointForce(1.0), points=1), "at least 2"),
]
scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(70.0, 0.2))


@pytest.mark.parametrize(("name", "make", "allowed"), CASES, ids=[f"{c[0]}-{k}" for k, c in enumerate(CASES)])
def test_the_argument_is_named(name, make, allowed):
    with pytest.raises(ValueError, match=f"`{name}`") as error:
        make()
    assert allowed in str(error.value)
    assert "must" in str(error.value) and ", got " in str(error.value)


@pytest.mark.parametrize(
    ("check", "message"),
    [
        (lambda: checks.number("c", -3.0, positive=True), "`c` must be a positive finite number, got -3.0."),
        (lambda: checks.number("c", nan, positive=True, finite=False), "`c` must be a positive number, got nan."),
        (lambda: checks.number("c", -1, non_negative=True), "`c` must be a non-negative finite number, got -1.0."),
        (lambda: checks.number("c", inf), "`c` must be a finite number, got inf."),
        (lambda: checks.number("c", True), "`c` must be a finite number, got True."),
        (lambda: checks.number("c", "3"), "`c` must be a finite number, got '3'."),
        (lambda: checks.number("c", np.ones(3)), "`c` must be a finite number, got an array of shape (3,)."),
        (lambda: checks.pair("p", [1.0, 2.0]), "`p` must be a pair of numbers, got [1.0, 2.0]."),
        (lambda: checks.pair("p", (1.0, nan)), "`p[1]` must be a finite number, got nan."),
        (lambda: checks.triple("p", (1.0, 2.0)), "`p` must be a tuple of three numbers, got (1.0, 2.0)."),
        (lambda: checks.triple("p", (1.0, nan, 2.0)), "`p[1]` must be a finite number, got nan."),
        (
            lambda: checks.triple("p", (1.0, 0.0, 2.0), positive=True),
            "`p[1]` must be a positive finite number, got 0.0.",
        ),
        (lambda: checks.acute_angle("a", -1.6), "`a` must be less than a right angle, got -1.6 rad."),
        (
            lambda: checks.vector("v", np.ones((2, 3))),
            "`v` must be a non-empty one-dimensional array of finite numbers, got an array of shape (2, 3).",
        ),
        (
            lambda: checks.vector("v", [1.0, 2.0, inf]),
            "`v` must be a non-empty one-dimensional array of finite numbers, got inf at index 2.",
        ),
        (
            lambda: checks.within("at", [0.0, -2], [1.0, nan, -1.0], "scan"),
            "`at` must be within the scan, from -1 to 1, got -2.",
        ),
        (lambda: checks.count("n", True), "`n` must be a positive int, got True."),
        (lambda: checks.count("n", 1, least=2), "`n` must be an int of at least 2, got 1."),
        (lambda: checks.instance("s", 3, str, "a name"), "`s` must be a name, got 3."),
        (
            lambda: checks.function("f", np.sin),
            "`f` must be a function that JAX can trace, got sin, which raised TracerArrayConversionError. "
            "Use jnp.where instead of `if`, jnp.interp instead of np.interp, and jax.numpy instead of math and numpy.",
        ),
        (
            lambda: checks.function("f", pow),
            "`f` must be a function that is called with one number and returns one number, "
            "got pow(base, exp, mod=None).",
        ),
        (
            lambda: checks.function("f", lambda x: x, shape=(3,)),
            "`f` must be a function that is called with one array of shape (3,) and returns one number, got <lambda>, "
            "which returns an array of shape (3,) and type float64.",
        ),
        (
            lambda: checks.function("f", lambda u: [u], ("x", "y")),
            "`f` must be a function that is called with one number and returns (x, y), got <lambda>, which returns 1 "
            "values.",
        ),
    ],
)
def test_messages(check, message):
    with pytest.raises(ValueError) as error:
        check()
    assert str(error.value) == message


def test_right_values_pass():
    checks.number("c", 3, positive=True)
    checks.number("c", np.float32(0.0), non_negative=True)
    checks.number("c", inf, finite=False)
    checks.pair("p", (1, 2.0))
    checks.triple("p", (1, -2.0, np.float32(0.5)))
    checks.acute_angle("a", -1.5)
    checks.vector("v", [1, 2])
    checks.within("at", [1.0 + 1e-12, -1.0], [1.0, nan, -1.0], "scan")
    checks.count("n", 2, least=2)
    checks.function("f", jnp.sin)
    checks.function("f", jnp.sum, shape=(3,))
    checks.function("f", lambda u: (u, 0, jnp.zeros(())), ("x", "y", "angle"))
    checks.function("f", lambda u: jnp.stack([u, u]), ("x", "y"))


def test_functions_of_traced_parameters_pass():
    @jax.jit
    def call(a):
        checks.function("f", lambda x: a * x)
        checks.number("a", a, positive=True)
        checks.vector("v", jnp.stack([a, a]))
        return a

    assert call(-1.0) == -1.0


def test_errors_inside_a_function_are_not_hidden():
    with pytest.raises(ZeroDivisionError):
        checks.function("f", lambda x: 1 / 0)


def test_float32_mode_is_an_error_that_names_the_remedy():
    code = (
        "import jaxwhisker as jw\n"
        "try:\n"
        "    jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2)))\n"
        "except ValueError as error:\n"
        "    assert 'jax_enable_x64' in str(error), error\n"
        "else:\n"
        "    raise SystemExit('no error')\n"
        "import jax\n"
        "assert not jax.config.jax_enable_x64\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_wrong_traced_values_give_a_status():
    @jax.jit
    def scan(stiffness, distance, length):
        whisker, profile = jw.Whisker(length), jw.Parabola(distance)
        return jw.scan(jw.Scene(whisker, profile, jw.Support.fb(stiffness, 0.2)), jnp.linspace(0.7, 0.5, 4))

    assert np.all(np.asarray(scan(70.0, 0.2, 1.0).status) == jw.Status.ok)
    bad = [(-3.0, 0.2, 1.0), (nan, 0.2, 1.0), (0.0, 0.2, 1.0), (70.0, 0.0, 1.0), (70.0, nan, 1.0), (70.0, 0.2, -1.0)]
    for values in bad:
        result = scan(*values)
        assert np.all(np.asarray(result.status) == jw.Status.invalid), values
        assert np.all(np.isnan(result.mz))


def test_a_traced_control_that_is_not_finite_gives_a_status():
    result = jax.jit(jw.scan)(scene, jnp.array([0.7, nan, 0.5]))
    assert np.all(np.asarray(result.status) == jw.Status.invalid)


def test_a_default_control_of_a_billion_steps_is_an_error():
    with pytest.raises(ValueError, match="Springs this soft need an explicit `control`"):
        jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(1e-6)))
