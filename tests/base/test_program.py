"""Programs: sharing of compiled code, derivatives, batches and failures, compared with plain jax."""

import gc
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._base import program as programs
from jaxwhisker._base import store
from jaxwhisker._base.primitive import LANES
from jaxwhisker._base.program import Program

X = jnp.linspace(0.3, 1.2, 4)
Y = jnp.linspace(-1.0, 2.0, 3)


def plain(x, y):
    """A smooth function of two numbers with several results."""
    return {"product": jnp.sin(x) * y**2, "sum": jnp.stack([x + y, x * x])}


def traced(function, **options):
    """A program, and a list that grows when it is traced."""
    traces = []

    def wrapped(*args):
        traces.append(args)
        return function(*args)

    return Program(wrapped, **options), traces


def assert_same(found, expected):
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert (one.dtype, one.shape) == (other.dtype, other.shape)
        if one.dtype != jax.dtypes.float0:
            np.testing.assert_allclose(one, other, rtol=1e-14, atol=1e-14)


# Static arguments


def test_a_program_has_the_name_of_its_function():
    assert vars(Program(plain))["__name__"] == "plain" and Program(plain).__doc__ == plain.__doc__


def test_arguments_that_are_no_arrays_are_static():
    scale, traces = traced(lambda x, name, factor: {"name": name, "x": factor * x})
    assert scale(jnp.asarray(3.0), "a", 2) == {"name": "a", "x": 6.0}
    assert scale(jnp.asarray(4.0), "a", 2) == {"name": "a", "x": 8.0}
    assert scale(jnp.asarray(4.0), "b", 2) == {"name": "b", "x": 8.0}
    assert scale(jnp.asarray(4.0), "b", 3) == {"name": "b", "x": 12.0}
    assert len(traces) == 3


def test_xla_logs_nothing_while_it_compiles(monkeypatch):
    """After two minutes of compilation, it would print that this is slow, and ask for a bug report."""
    levels, before = [], jax.stages.Lowered.compile
    monkeypatch.setenv("TF_CPP_MIN_LOG_LEVEL", "1")  # the default of jax

    def compiled(lowered, *options):
        levels.append(("compiles", *levels[-1:]))
        return before(lowered, *options)

    monkeypatch.setattr(store, "absl_set_min_log_level", levels.append)
    monkeypatch.setattr(jax.stages.Lowered, "compile", compiled)
    Program(lambda x: x + 1.0)(jnp.arange(7.0))
    assert ("compiles", store.FATAL) in levels and levels[-1] == 1


def test_only_so_many_executables_are_kept(monkeypatch):
    monkeypatch.setattr(programs, "MOST_KEPT", 2)
    scale, traces = traced(lambda x, factor: factor * x)
    assert [float(scale(jnp.asarray(1.0), factor)) for factor in (1, 2, 3, 3, 1)] == [1.0, 2.0, 3.0, 3.0, 1.0]
    assert scale.compilations == 2 and len(traces) == 4


@pytest.mark.parametrize("factors", [(2, 2.0), (2.0, 2), (True, 1, 1.0)])
def test_equal_static_arguments_of_different_types_differ(factors):
    scale = Program(lambda x, factor: x * factor)
    for factor in factors:
        assert scale(jnp.arange(3), factor).dtype == (jnp.arange(3) * factor).dtype


def test_named_arguments_and_modules():
    class Module(eqx.Module):
        x: jax.Array
        power: int = eqx.field(static=True)

    raised = Program(lambda module, *, offset: Module(module.x**module.power + offset, module.power))
    found = raised(Module(jnp.asarray(3.0), 2), offset=np.float64(1.0))
    assert (found.x, found.power) == (10.0, 2)
    assert raised(Module(jnp.asarray(3.0), 3), offset=np.float64(1.0)).x == 28.0


def test_shapes_and_types_have_programs_of_their_own():
    double, traces = traced(lambda x: 2 * x)
    for x in (jnp.ones(2), jnp.ones(3), jnp.ones(2, int), np.ones(2), jnp.zeros(2)):
        assert_same(double(x), jnp.asarray(2 * x))
    assert len(traces) == 3


def test_the_decorator_passes_options_on():
    @partial(Program, frozen=True)
    def double(x):
        return 2 * x

    assert double(jnp.asarray(3.0)) == 6.0
    assert jax.grad(double)(3.0) == 0.0


# Transformations


def gradient(function):
    return jax.grad(lambda x, y: jnp.sum(function(x, y)["sum"]) + function(x, y)["product"], argnums=(0, 1))


def nested(function):
    return jax.vmap(jax.vmap(function, (None, 0)), (0, None))


TRANSFORMED = {
    "vmap": lambda f, x, y: jax.vmap(f, (0, None))(x, y[0]),
    "vmap of another axis": lambda f, x, y: jax.vmap(f, (None, 0), out_axes=-1)(x[0], y),
    "nested vmap": lambda f, x, y: nested(f)(x, y),
    "vmap of matrices": lambda f, x, y: jax.vmap(jax.vmap(f), in_axes=(1, None))(jnp.outer(x, y), x),
    "jvp": lambda f, x, y: jax.jvp(f, (x[0], y[0]), (0.5, -2.0)),
    "jvp by one argument": lambda f, x, y: jax.jvp(lambda x: f(x, y[0]), (x[0],), (0.5,)),
    "grad": lambda f, x, y: gradient(f)(x[0], y[0]),
    "vmap of grad": lambda f, x, y: jax.vmap(gradient(f), (0, None))(x, y[0]),
    "grad of vmap": lambda f, x, y: jax.grad(lambda x: nested(f)(x, y)["product"].sum())(x),
    "jacfwd": lambda f, x, y: jax.jacfwd(f)(x[0], y[0]),
    "jacrev of nested vmap": lambda f, x, y: jax.jacrev(lambda x: nested(f)(x, y))(x),
    "hessian": lambda f, x, y: jax.hessian(lambda x: f(x, y[0])["product"])(x[0]),
}


@pytest.mark.parametrize("transformed", TRANSFORMED.values(), ids=TRANSFORMED)
def test_transformations_agree_with_plain_jax(transformed):
    run, expected = Program(plain), transformed(plain, X, Y)
    assert_same(transformed(run, X, Y), expected)
    assert_same(jax.jit(lambda x, y: transformed(run, x, y))(X, Y), expected)
    assert_same(jax.jit(lambda x: transformed(run, x, Y))(X), expected)  # a caller's jit that knows some values
    assert_same(jax.jit(lambda: transformed(run, X, Y))(), expected)  # ... or all


def test_values_share_one_program():
    run, traces = traced(plain, frozen=True)
    run(X[0], Y[0])
    for transformed in TRANSFORMED.values():
        transformed(run, X, Y)
    assert len(traces) == 1


def test_derivatives_are_traced_once():
    run, traces = traced(plain)
    for values in (X, X + 0.1, 2 * X):
        jax.vmap(gradient(run), (0, None))(values, Y[0])
        gradient(run)(values[0], Y[0])
    assert len(traces) <= 2  # the program and its derivative


def test_inside_a_caller_it_is_part_of_the_callers_program():
    run, traces = traced(plain)
    assert_same(jax.jit(run)(X[0], Y[0]), plain(X[0], Y[0]))
    assert len(traces) == 1 and not run.is_ready(X[0], Y[0])


# Derivatives


def test_a_frozen_program_has_no_derivatives():
    run = Program(plain, frozen=True)
    assert_same(run(X[0], Y[0]), plain(X[0], Y[0]))
    for derivative in (jax.jacfwd, jax.jacrev):
        zeros = derivative(run)(X[0], Y[0])
        assert all(not leaf.any() for leaf in jax.tree.leaves(zeros))
    inside = jax.jacfwd(lambda x: run(x, Y[0])["sum"] + x)(X[0])
    assert inside.tolist() == [1.0, 1.0]


def test_a_tangent_rule_replaces_the_derivative():
    given = []

    def tangent(args, dots, _):
        given.append(dots)
        (x, _, name), (x_dot, y_dot, _) = args, dots
        assert name == "static" and y_dot is None
        return {"value": 10 * jnp.cos(x) * x_dot, "kind": None, "name": None}

    run = Program(lambda x, y, name: {"value": jnp.sin(x) * y, "kind": jnp.asarray(3), "name": name}, tangent=tangent)
    results = run(X[0], Y[0], "static")
    assert results["kind"] == 3 and results["name"] == "static"

    def value(x):
        return run(x, Y[0], "static")["value"]

    np.testing.assert_allclose(jax.grad(value)(X[0]), 10 * jnp.cos(X[0]))
    np.testing.assert_allclose(jax.jacfwd(value)(X[0]), 10 * jnp.cos(X[0]))
    np.testing.assert_allclose(jax.vmap(jax.grad(value))(X), 10 * jnp.cos(X))
    np.testing.assert_allclose(jax.vmap(jax.hessian(value))(X), -10 * jnp.sin(X))
    assert {name for _, _, name in given} == {None}


def test_a_tangent_rule_knows_the_results():
    run = Program(
        lambda x: {"n": jnp.asarray(1), "e": jnp.exp(x)},
        tangent=lambda _, x_dot, at: {"n": None, "e": at["e"] * x_dot[0]},
    )

    def exponential(x):
        return run(x)["e"]

    for derivative in (jax.grad(exponential), jax.jacfwd(exponential), jax.hessian(exponential)):
        np.testing.assert_allclose(derivative(X[0]), jnp.exp(X[0]))
        both = jnp.stack([X, 2 * X])
        np.testing.assert_allclose(jax.vmap(jax.vmap(derivative), in_axes=1)(both), jnp.exp(both.T))


def test_tangents_by_jax_for_the_rule_of_another_program():
    other = Program(lambda x, y, name: (jnp.sin(x) * y, jnp.asarray(3), name))
    value, kind, name = other.along((X[0], Y[0], "static"), (jnp.asarray(2.0), None, None))
    np.testing.assert_allclose(value, 2 * jnp.cos(X[0]) * Y[0])
    assert kind is None and name is None and not other.compilations


def test_integers_have_no_derivative():
    def function(x, n):
        return {"n": n + 1, "positive": x > 0, "power": x**n, "rounded": jnp.floor(x).astype(int)}

    run, n = Program(function), jnp.asarray(3)
    assert_same(run(X[0], n), function(X[0], n))
    assert_same(jax.grad(lambda x: run(x, n)["power"])(X[0]), 3 * X[0] ** 2)

    def slopes(function):
        return jax.vmap(jax.grad(lambda x, n: function(x, n)["power"]))(X, jnp.arange(4))

    assert_same(slopes(run), slopes(function))
    none = np.zeros((), jax.dtypes.float0)
    found, dots = jax.jvp(run, (X[0], n), (jnp.asarray(1.0), none))
    expected, expected_dots = jax.jvp(function, (X[0], n), (jnp.asarray(1.0), none))
    assert_same(found, expected)
    assert_same(dots, expected_dots)


# Batches


@pytest.mark.parametrize("count", [5, 64, 130])
def test_large_batches_run_in_blocks(count, monkeypatch):
    monkeypatch.setattr("jaxwhisker._base.program.MOST_SINGLE", 4)
    monkeypatch.setattr("jaxwhisker._base.program.MOST_ALONE", 4)
    x, y = np.linspace(0.0, 1.0, count), np.linspace(1.0, 2.0, count)
    together, traces = traced(plain, together=LANES)
    assert_same(jax.vmap(together)(x, y), jax.vmap(plain)(x, y))
    assert [lanes for _, lanes, _ in together._executables] == [LANES]
    assert_same(jax.vmap(together, (0, None))(x[::-1], y[0]), jax.vmap(plain, (0, None))(x[::-1], y[0]))
    assert len(traces) == 1


def test_blocks_are_compiled_after_many_lanes(monkeypatch):
    monkeypatch.setattr("jaxwhisker._base.program.MOST_SINGLE", 4)
    monkeypatch.setattr("jaxwhisker._base.program.MOST_ALONE", 20)
    together, traces = traced(plain, together=LANES)

    def compiled(count):
        x, y = np.linspace(0.0, 1.0, count), np.linspace(1.0, 2.0, count)
        assert_same(jax.vmap(together)(x, y), jax.vmap(plain)(x, y))
        return [lanes for _, lanes, _ in together._executables]

    # Small batches never count, and once there are blocks, every large batch uses them.
    assert [compiled(count) for count in (10, 4, 4, 4, 10, 5, 5)] == [[0]] * 5 + [[0, LANES]] * 2
    assert len(traces) == 2
    together.clear()
    assert compiled(10) == [0] and compiled(21) == [0, LANES]


def test_other_batches_run_one_by_one(monkeypatch):
    monkeypatch.setattr("jaxwhisker._base.program.MOST_SINGLE", 4)
    monkeypatch.setattr("jaxwhisker._base.program.MOST_ALONE", 4)
    for count, together in ((4, LANES), (5, 0)):
        run = Program(plain, together=together)
        jax.vmap(run, (0, None))(np.linspace(0.0, 1.0, count), Y[0])
        assert [lanes for _, lanes, _ in run._executables] == [0]


@pytest.mark.parametrize("together", [0, LANES])
def test_an_empty_batch_has_empty_results(together):
    run = Program(plain, together=together)
    assert_same(jax.vmap(run)(X[:0], X[:0]), jax.vmap(plain)(X[:0], X[:0]))
    assert_same(nested(run)(X, Y[:0]), nested(plain)(X, Y[:0]))


def test_batches_keep_the_precision_of_their_caller():
    one = Program(lambda x: x / 3)
    jax.config.update("jax_enable_x64", False)
    try:
        with jax.enable_x64(True):
            x = jnp.linspace(0.0, 1.0, 5)
            assert_same(jax.vmap(one)(x), x / 3)
    finally:
        jax.config.update("jax_enable_x64", True)


# Compilation


def test_preparing_compiles_aside():
    run, traces = traced(plain)
    assert not run.is_ready(X[0], Y[0])
    with ThreadPoolExecutor(1) as pool:
        described = run.prepare(pool, X[0], Y[0])
        assert run.is_ready(X[0], Y[0])
    assert jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), described) == {
        "product": ((), np.dtype(float)),
        "sum": ((2,), np.dtype(float)),
    }
    assert_same(run(X[0], Y[0]), plain(X[0], Y[0]))
    assert len(traces) == 1


def test_programs_are_prepared_from_descriptions_of_arrays():
    run, traces = traced(plain)
    number = jax.ShapeDtypeStruct((), np.dtype(float))
    with ThreadPoolExecutor(1) as pool:
        described = run.prepare(pool, number, number)
        Program(lambda results: results["sum"]).prepare(pool, described)
    run(X[0], Y[0])
    assert len(traces) == 1


def test_cleared_programs_are_compiled_again():
    run, traces = traced(plain)
    run(X[0], Y[0])
    programs.clear()
    assert not run.is_ready(X[0], Y[0])
    run(X[0], Y[0])
    assert len(traces) == 2


def test_threads_that_call_at_once_compile_once():
    def slow(x):
        time.sleep(0.2)  # while tracing
        return 2 * x

    run, traces = traced(slow)
    ready = threading.Barrier(8)

    def call(x):
        ready.wait()
        return float(run(x))

    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(call, np.arange(8.0))) == [2.0 * k for k in range(8)]
    assert len(traces) == 1


def test_a_program_may_need_another_shape_of_itself():
    @Program
    def total(x):
        return x.sum() if len(x) < 3 else x.sum() + total(np.ones(2))

    assert total(np.ones(3)) == 5.0


@pytest.mark.parametrize(
    "call", [lambda f: f(X), lambda f: jax.vmap(f)(X), lambda f: jax.grad(lambda x: f(x).sum())(X)]
)
def test_an_error_while_tracing_does_not_poison_later_calls(call):
    failures = [ValueError("first"), ValueError("second")]

    @Program
    def run(x):
        if failures:
            raise failures.pop(0)
        return jnp.sin(x)

    for text in ("first", "second"):
        with pytest.raises(ValueError, match=text):
            call(run)
    assert_same(call(run), call(jnp.sin))


def test_an_error_while_compiling_does_not_poison_later_calls(monkeypatch):
    run = Program(plain)
    monkeypatch.setitem(run._options, "xla_cpu_unknown_option", True)
    with ThreadPoolExecutor(1) as pool:
        run.prepare(pool, X[0], Y[0])
    with pytest.raises(Exception, match="xla_cpu_unknown_option"):
        run(X[0], Y[0])
    monkeypatch.undo()
    assert_same(run(X[0], Y[0]), plain(X[0], Y[0]))


@pytest.mark.parametrize("enabled", [True, False])
def test_garbage_is_not_collected_during_tracing(enabled):
    collecting = []

    @programs.Program
    def traced(x):
        collecting.append(gc.isenabled())
        return x + 1

    before = gc.isenabled()
    try:
        (gc.enable if enabled else gc.disable)()
        traced(np.zeros(3))
        assert collecting == [False] and gc.isenabled() == enabled
    finally:
        (gc.enable if before else gc.disable)()
