"""Settings of JAX that forbid what the package does: its functions work, and the caller's own code keeps them."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base.program import Program
from jaxwhisker._base.settings import as_here, own_settings
from recordings import TRUTH, exact, fb

SETTINGS = {
    "disable_jit": jax.disable_jit,
    "strict promotion of types": lambda: jax.numpy_dtype_promotion("strict"),
    "no promotion of ranks": lambda: jax.numpy_rank_promotion("raise"),
    "no transfers": lambda: jax.transfer_guard("disallow"),
    "no NaN": lambda: jax.debug_nans(True),
    "no infinities": lambda: jax.debug_infs(True),
}
CONTROL = np.linspace(0.75, -1.35, 20)  # touch, vertex and snap-off


def scene(stiffness=70.0, **options):
    return jw.Scene(jw.Whisker(**options), jw.Parabola(0.2), jw.Support.fb(stiffness))


def peak(stiffness):
    return jw.scan(scene(stiffness), CONTROL).mz.max()


def bent(force):
    return jw.deflect(jw.Whisker(), jw.PointForce(force)).mz


def derivative(function, at):
    """By vjp, because jax.grad itself moves a number to the device."""
    value, pull = jax.vjp(function, at)
    return value, pull(ARRAYS["one"])[0]


WHISKER = jw.Whisker(mass_per_length=1.0)
HEAVY = jw.Scene(WHISKER, jw.Parabola(0.2))
CALLS = {
    "scan": lambda: str(jw.scan(scene(), CONTROL)),
    "slope of a scan": lambda: derivative(peak, ARRAYS["stiffness"]),
    "batch of scans": lambda: jax.vmap(peak)(ARRAYS["batch"]),
    "deflect": lambda: derivative(bent, ARRAYS["one"]),
    "shapes": lambda: jw.shapes(jw.scan(scene(), CONTROL), at=CONTROL[:1]).x,
    "reconstruct": lambda: str(jw.reconstruct(jw.scan(scene(), CONTROL), scene())),
    "modes": lambda: jw.modes(WHISKER, 2).frequency,
    "simulate": lambda: str(simulated()),
    "identify": lambda: list(identified().estimates.values()),
}
ARRAYS = {}


def simulated():
    return jw.simulate(HEAVY, jw.Whisking(0.1, 0.05, offset=0.9), 0.1, steps=4)


def identified():
    return jw.identify(fb, TRUTH, exact(fb(**TRUTH)), near=True, starts=0)


@pytest.fixture(scope="module", autouse=True)
def plain():
    """Results with the default settings."""
    ARRAYS.update(stiffness=jnp.asarray(70.0), one=jnp.asarray(1.0), batch=jnp.asarray([60.0, 70.0]))
    return {name: call() for name, call in CALLS.items()}


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("setting", SETTINGS)
def test_functions_work_with_every_setting(setting, name, plain):
    with SETTINGS[setting]():
        result = CALLS[name]()
    if isinstance(result, str):
        assert result == plain[name]
    else:
        jax.tree.map(np.testing.assert_array_equal, result, plain[name])


def test_the_callers_own_code_keeps_its_settings():
    with jax.numpy_dtype_promotion("strict"), jax.debug_nans(True), jax.disable_jit():
        jw.deflect(jw.Whisker(), jw.PointForce(1.0))
        assert jax.config.jax_disable_jit  # pyright: ignore[reportAttributeAccessIssue]
        with pytest.raises(FloatingPointError):
            jnp.log(-ARRAYS["one"])
        with pytest.raises(Exception, match="promotion"):
            jnp.add(ARRAYS["batch"], jnp.arange(2))


def test_default_settings_are_not_touched(monkeypatch):
    monkeypatch.setattr(jax, "debug_nans", None)  # would fail if it was called
    with own_settings():
        assert jax.config.jax_numpy_dtype_promotion == "standard"  # pyright: ignore[reportAttributeAccessIssue]


def test_functions_for_later_keep_the_precision():
    jax.config.update("jax_enable_x64", False)
    try:
        with jax.enable_x64(True):
            later = as_here(lambda: jnp.zeros(1))
        assert later().dtype == float and jnp.zeros(1).dtype == np.float32
    finally:
        jax.config.update("jax_enable_x64", True)


@pytest.mark.filterwarnings("error")
def test_results_can_be_used_after_a_block_with_float64(plain):
    jax.config.update("jax_enable_x64", False)
    try:
        with jax.enable_x64(True):
            result = jw.scan(scene(), CONTROL)
            points, motion = jw.reconstruct(result, scene()), simulated()
            modes = jw.modes(WHISKER, 2)
        assert str(result) == plain["scan"] and str(points) == plain["reconstruct"] and str(motion)
        np.testing.assert_array_equal(modes.frequency, plain["modes"])
        np.testing.assert_array_equal(jw.shapes(result, at=CONTROL[:1]).x, plain["shapes"])
        assert result.to_xarray().event_energy_before.dtype == float
        with pytest.raises(ValueError, match="`jax_enable_x64` must be True"):
            jw.scan(scene(), CONTROL)
    finally:
        jax.config.update("jax_enable_x64", True)


def test_programs_run_where_their_arguments_are():
    code = (
        "import jax, jax.numpy as jnp, numpy as np\n"
        "from jaxwhisker._base.program import Program\n"
        "there, double = jax.devices()[1], Program(lambda x: 2 * x)\n"
        "assert double(jnp.ones(2)).sum() == 4.0\n"
        "x = jax.device_put(jnp.ones(2), there)\n"
        "assert double(x).devices() == {there} and double(x).sum() == 4.0\n"
        "assert jax.grad(lambda x: (x * double(x)).sum())(x).sum() == 8.0\n"
        "with jax.default_device(there):\n"
        "    assert double(jnp.ones(2)).sum() == 4.0\n"
        "with jax.default_device(there):\n"
        "    assert double(np.ones(3)).devices() == {there}\n"
        "assert double(np.ones(3)).devices() == {jax.devices()[0]}\n"
    )
    environment = os.environ | {"XLA_FLAGS": "--xla_force_host_platform_device_count=2", "JAXWHISKER_CACHE": "off"}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True, timeout=120)


def test_results_are_on_the_device_of_the_arguments():
    code = (
        "import jax, jax.numpy as jnp, numpy as np, jaxwhisker as jw\n"
        "jax.config.update('jax_enable_x64', True)\n"
        "jax.config.update('jax_num_cpu_devices', 2)\n"  # unlike XLA_FLAGS, it leaves the keys of stored programs alone
        "there = jax.devices()[1]\n"
        "stiffness, control = jax.device_put((jnp.asarray(70.0), jnp.linspace(0.8, -1.0, 20)), there)\n"
        "def scan(c): return jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.5), jw.Support.fb(c, 0.2)), control)\n"
        "def elsewhere(tree): return [leaf for leaf in jax.tree.leaves(tree) if leaf.devices() != {there}]\n"
        "result = scan(stiffness)\n"
        "fields = {name: getattr(result, name) for name in ('fx', 'fy', 'mz', 'contact_x', 'phase', 'status')}\n"
        "assert not elsewhere((fields, result.events, jw.shapes(result, at=control[:2]).x))\n"
        "assert not elsewhere(jax.jvp(lambda c: scan(c).fx, (stiffness,), (jnp.ones_like(stiffness),)))\n"
        "assert not elsewhere(jax.vmap(lambda c: scan(c).fx)(jnp.stack([stiffness, stiffness])))\n"
        "assert not elsewhere(jw.deflect(jw.Whisker(stiffness), jw.PointForce(0.3)).fx)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=240)


@pytest.mark.parametrize("setting", SETTINGS)
def test_programs_are_shared_by_all_settings(setting):
    program = Program(lambda x, y: {"sum": x + y, "log": jnp.log(-x) * jnp.arange(2)})
    x, y = jnp.asarray(1.0), jnp.arange(2)
    expected = program(x, y)
    with SETTINGS[setting]():
        jax.tree.map(np.testing.assert_array_equal, program(x, y), expected)
    assert program.compilations == 1
