"""Programs on disk: other processes load them, and whatever is wrong with an entry, the program is compiled again."""

import json
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlib
import lineax
import numpy as np
import optimistix
import pytest

import jaxwhisker as jw
from jaxwhisker._base import linear_algebra, program, store
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.dimensionless import problem_of
from program_child import SIZES, solved

CHILD = Path(__file__).parents[1] / "program_child.py"
IGNORED = "A cached program.* is ignored and compiled again"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """An empty store of this test's own. jax's own cache is not used."""
    monkeypatch.setenv("JAXWHISKER_CACHE", str(tmp_path / "programs"))
    monkeypatch.setattr("jax._src.compilation_cache.is_cache_used", lambda _: False)
    return tmp_path / "programs"


def child(*argv, code=None, **environment):
    """Start a process that solves systems."""
    command = [sys.executable, "-W", "error:::jaxwhisker", *(["-c", code] if code else [str(CHILD)]), *map(str, argv)]
    # Without jax's own cache, in which the tests of this process may have put the same programs; and with jax's own
    # level of logs, because users must not see any.
    settings = {"JAX_ENABLE_COMPILATION_CACHE": "0", "TF_CPP_MIN_LOG_LEVEL": "1"}
    environment = os.environ | settings | environment
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def output(process):
    out, err = process.communicate(timeout=120)
    assert (process.returncode, err) == (0, "")
    return json.loads(out)


def entry(folder):
    """The only entry of a store."""
    (path,) = folder.iterdir()
    return path


# Processes


def test_another_process_compiles_nothing():
    first = [solved(size) for size in SIZES]
    second = output(child(*SIZES))
    assert [compiled for _, compiled in first] == [1] * len(SIZES)
    assert [compiled for _, compiled in second] == [0] * len(SIZES)
    assert [value for value, _ in first] == [value for value, _ in second]


def test_processes_that_write_at_once_share_the_store(folder):
    processes = [child(*SIZES, *SIZES) for _ in range(2)]
    results = [output(process) for process in processes]
    values = [[value for value, _ in result] for result in results]
    assert values[0] == values[1]
    assert all(compiled == 0 for result in results for _, compiled in result[len(SIZES) :])
    assert len(list(folder.iterdir())) == len(SIZES)
    assert solved(SIZES[0]) == (values[0][0], 0)


def test_a_killed_process_leaves_a_file_that_does_no_harm(folder, monkeypatch):
    code = (
        f"import os, sys; sys.path.insert(0, {str(CHILD.parent)!r}); import jax; from program_child import solved\n"
        "jax.config.update('jax_enable_x64', True); os.replace = lambda *_: os.kill(os.getpid(), 9); solved(2)"
    )
    process = child(code=code)
    process.communicate(timeout=120)
    assert process.returncode == -9
    rest = entry(folder)
    assert rest.name.endswith(store.UNFINISHED)
    assert solved(2)[1] == 1 and solved(2)[1] == 0
    assert rest in [path for path, _ in store.entries(folder)]  # the limit counts it
    monkeypatch.setattr(store, "LARGEST", rest.stat().st_size)
    solved(3)
    assert not rest.exists()


def test_an_interrupted_write_leaves_nothing(folder, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        solved(2)
    assert list(folder.iterdir()) == []


# The contents of an entry


def test_results_keep_their_structure(folder):
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fbfbr(70.0))
    scene = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype=float), scene)
    compiled, loaded = Program(problem_of)(scene), Program(problem_of)(scene)
    assert entry(folder).exists()
    assert jax.tree.structure(loaded) == jax.tree.structure(compiled) == jax.tree.structure(problem_of(scene))
    for one, other in zip(jax.tree.leaves(loaded), jax.tree.leaves(compiled), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_program_in_jaxs_own_cache_is_stored_as_well(folder, tmp_path):
    """What that cache provides lacks its kernels: its entry could be loaded, but not run."""
    code = (
        f"import os, sys; sys.path.insert(0, {str(CHILD.parent)!r}); import jax, json\n"
        "from program_child import solved\n"
        "jax.config.update('jax_enable_x64', True)\n"
        "jax.config.update('jax_persistent_cache_min_compile_time_secs', 0.0)\n"
        f"jax.config.update('jax_compilation_cache_dir', {str(tmp_path / 'jax')!r}); print(json.dumps(solved(3)))"
    )
    settings = {"JAX_ENABLE_COMPILATION_CACHE": "1", "TF_CPP_MIN_LOG_LEVEL": "3"}
    value, compiled = output(child(code=code, **settings))
    assert compiled == 1 and len(list(folder.iterdir())) == 1
    for _ in range(2):  # also when an earlier process has compiled it a second time
        store.clear()
        assert output(child(code=code, **settings)) == [value, 1]
        assert len(list(folder.iterdir())) == 1
    assert output(child(code=code, **settings)) == [value, 0]


def test_sources_that_lead_to_the_same_code_are_traced_but_not_compiled(folder, monkeypatch):
    value, _ = solved(3)
    for count in (2, 3):
        monkeypatch.setattr(store.sources, "digest", lambda _, count=count: f"changed {count}")
        with monkeypatch.context() as changed:
            changed.setattr(store, "compiled", lambda *_: pytest.fail("XLA compiles"))
            assert [solved(3), solved(3)] == [(value, 1), (value, 0)]
        assert len(list(folder.iterdir())) == count
    with monkeypatch.context() as changed:  # other code is compiled
        changed.setattr(store, "compiled", lambda *_: pytest.fail("XLA compiles"))
        with pytest.raises(pytest.fail.Exception):
            solved(2)


def first_of(x, y):
    return 2 * x


def second_of(x, y):
    return 2 * y


def only(x):
    return 2 * x


def test_programs_that_use_other_arguments_do_not_share_code(folder, monkeypatch):
    functions = first_of, second_of, only
    monkeypatch.setattr(store, "describe", lambda value: value[0].__qualname__)
    for function in functions:
        one = Program(function)
        vars(one)["__name__"] = "same"  # also in the code
        assert one(*np.array([1.0, 3.0])[: 1 + (function is not only)]) == (6.0 if function is second_of else 2.0)
    assert len(list(folder.iterdir())) == len(functions)


def test_a_program_that_calls_python_is_not_stored(folder, monkeypatch):
    def shout(x):
        return jax.pure_callback(lambda x: 2 * np.asarray(x), x, x)

    monkeypatch.setattr(store, "describe", lambda _: "a program that calls Python")
    for _ in range(2):
        assert Program(shout)(jnp.asarray(3.0)) == 6.0
    assert not folder.exists() or list(folder.iterdir()) == []


def test_several_devices_may_be_present():
    environment = {"XLA_FLAGS": "--xla_force_host_platform_device_count=4"}
    first, second = (output(child(3, **environment)) for _ in range(2))
    assert [first[0][1], second[0][1]] == [1, 0]
    assert first[0][0] == second[0][0]


# Keys


def key(monkeypatch, place=None, name="", value: object = "other"):
    """The key of a description after a change of one attribute."""
    with monkeypatch.context() as changed:
        if place is not None:
            changed.setattr(place, name, value, raising=False)
        store._platform.cache_clear()
        return store.key_of("x")


def test_keys_depend_on_everything_that_code_depends_on(monkeypatch):
    libraries = (jax, jaxlib, np, eqx, diffrax, lineax, optimistix)
    keys = [
        key(monkeypatch),
        *(key(monkeypatch, library, "__version__") for library in libraries),
        *(key(monkeypatch, type(jax.config), setting) for setting in store.SETTINGS),
        key(monkeypatch, store, "_processor", lambda: "another one"),
        key(monkeypatch, store.sources, "digest", lambda _: "other sources"),
        key(monkeypatch, store.platform, "python_version", lambda: "3.99"),
    ]
    monkeypatch.setenv("XLA_FLAGS", os.environ.get("XLA_FLAGS", "") + " ")
    keys += [key(monkeypatch), store.key_of("y")]
    assert len(set(keys)) == len(keys)
    monkeypatch.undo()
    assert key(monkeypatch) == keys[0]
    store._platform.cache_clear()


def test_shapes_types_options_and_lanes_have_entries_of_their_own(folder, monkeypatch):
    saved = []
    monkeypatch.setattr(store, "save", lambda key, _: saved.append(key))
    for quick in (False, True):
        for kind in (np.float64, np.float32):
            for size in (2, 3):
                Program(linear_algebra.positive_definite, quick=quick)(np.eye(size, dtype=kind))
    monkeypatch.setattr("jaxwhisker._base.program.MOST_SINGLE", 1)
    monkeypatch.setattr("jaxwhisker._base.program.MOST_ALONE", 1)
    jax.vmap(Program(linear_algebra.positive_definite, together=64))(np.stack([np.eye(2)] * 2))
    assert len(set(saved)) == len(saved) == 9


# Descriptions


class UsersModule(eqx.Module):
    """A user's module, whose code may change."""

    x: float


def users_function(x):
    return x


@pytest.mark.parametrize(
    "value",
    [
        users_function,
        lambda x: x,
        partial(users_function, 1),
        partial(users_function, jnp.sin),
        partial(jax.vmap, users_function),
        UsersModule,
        UsersModule(1.0),
        [1, {"a": (users_function,)}],
        jw.Graph(users_function),
        jw.Motion(lambda u: (u, 0.0, 0.0), 0.0, 1.0),
        jw.Whisker(bending_stiffness=lambda s: 1.0 + s),
        jax.jit(users_function),
        jax.tree_util.Partial(users_function),
        np.random.default_rng(0).normal,  # a method, whose object may differ
        np.random.default_rng(0),
        object(),
        slice(1),
        {1, 2},
    ],
)
def test_users_code_has_no_description(value):
    assert store.describe(value) is None


def test_a_function_with_a_borrowed_name_has_no_description():
    def wrapper(x):
        return x

    wrapper.__module__, wrapper.__qualname__ = linear_algebra.solve.__module__, "solve"
    assert store.describe(linear_algebra.solve) == "jaxwhisker._base.linear_algebra.solve"
    assert store.describe(wrapper) is None


def test_every_program_of_the_package_can_be_stored():
    import jaxwhisker._explore.picture
    import jaxwhisker.plot  # noqa: F401

    own = [one for one in program._PROGRAMS if one.function.__module__.startswith("jaxwhisker")]
    assert len(own) > 20
    assert [one for one in own if store.describe(one.function) is None] == []


def test_programs_with_users_functions_are_not_stored(folder):
    profile = jax.tree.map(jnp.asarray, jw.Graph(lambda x: 0.2 + x**2))
    outline = Program(type(profile).point)
    outline(profile, jnp.asarray(0.1))
    assert not folder.exists()
    known = jax.tree.map(jnp.asarray, jw.Parabola(0.2))
    Program(type(known).point)(known, jnp.asarray(0.1))
    assert len(list(folder.iterdir())) == 1


@pytest.mark.parametrize(
    "value",
    [
        None,
        ...,
        (1, 2.0, "three", True),
        {"a": [1]},
        np.dtype(float),
        jnp.float64,
        partial(jnp.sum, axis=1),
        jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fbfbr(70.0), rod=jw.ClosedForm()),
        jw.Shooting(8, solver=diffrax.Dopri8()),
        jw.Shooting(8, solver=jw.Splitting(stages=11)),
        jw.Phase.tip,
    ],
)
def test_known_code_has_a_description(value):
    assert isinstance(store.describe(value), str)


def test_different_values_have_different_descriptions():
    values = [1, 1.0, True, "1", b"1", (1,), [1], {"a": 1}, {"b": 1}, partial(jnp.sin, 1), partial(jnp.cos, 1), jnp.sin]
    assert len({store.describe(value) for value in values}) == len(values)


# Entries that cannot be used


def damaged(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def truncated(path):
    os.truncate(path, path.stat().st_size // 2)


def emptied(path):
    path.write_bytes(b"")


def of_another_format(path):
    path.write_bytes(b"other program\n" + path.read_bytes())


def writable(path):
    path.chmod(0o666)


@pytest.mark.parametrize("spoil", [damaged, truncated, emptied, of_another_format, writable])
def test_a_bad_entry_is_ignored_with_a_warning_and_replaced(spoil, folder):
    value, _ = solved(3)
    spoil(entry(folder))
    with pytest.warns(UserWarning, match=IGNORED) as warned:
        assert solved(3) == (value, 1)
    assert str(folder) in str(warned[0].message)
    assert solved(3) == (value, 0)


def test_an_entry_with_the_name_of_another_one_is_ignored(folder):
    value, _ = solved(3)
    other = entry(folder).read_bytes()
    path = entry(folder).rename(folder.parent / "other")
    solved(2)
    os.replace(path, entry(folder))
    assert entry(folder).read_bytes() == other
    with pytest.warns(UserWarning, match=f"{IGNORED}.*checksum"):
        assert solved(2)[1] == 1
    assert solved(3) == (value, 1)


@pytest.mark.filterwarnings("error")
def test_an_entry_with_a_class_that_was_renamed_is_compiled_again_without_a_warning(folder, monkeypatch):
    import program_child

    former = type("Former", (), {"__module__": "program_child"})
    monkeypatch.setattr(program_child, "Former", former, raising=False)
    store.save("renamed", former())
    assert isinstance(store.load("renamed"), former)
    monkeypatch.delattr(program_child, "Former")
    assert store.load("renamed") is None


def test_code_that_xla_cannot_load_is_compiled_again(folder, monkeypatch):
    value, _ = solved(3)
    content = store.load(entry(folder).stem)
    store.save(entry(folder).stem, (*content[:2], (b"no code", *content[2][1:])))
    with pytest.warns(UserWarning, match=IGNORED):
        assert solved(3) == (value, 1)
    assert solved(3) == (value, 0)


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="files have no owner here")
def test_entries_of_another_user_are_not_loaded(folder, monkeypatch):
    value, _ = solved(3)
    monkeypatch.setattr(store, "distrust", lambda _: None)
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    monkeypatch.setattr(store.pickle, "loads", lambda _: pytest.fail("the entry was loaded"))
    with pytest.warns(UserWarning, match=f"{IGNORED}.*belongs to another user"):
        assert solved(3) == (value, 1)


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="files have no owner here")
def test_a_folder_of_another_user_is_not_used(folder, monkeypatch):
    value, _ = solved(3)
    before = entry(folder).stat()
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    with pytest.warns(UserWarning, match=r"not kept in .*programs: it belongs to another user"):
        assert solved(3) == (value, 1)
    after = entry(folder).stat()
    assert (before.st_mtime_ns, before.st_ino) == (after.st_mtime_ns, after.st_ino)


@pytest.mark.parametrize("mode", [0o770, 0o707])
def test_a_folder_that_others_can_write_to_is_not_used(mode, folder):
    folder.mkdir()
    folder.chmod(mode)
    for _ in range(2):
        with pytest.warns(UserWarning, match="other users can write to it"):
            assert solved(3)[1] == 1
    assert list(folder.iterdir()) == []


def test_new_folders_are_closed_to_others(folder):
    old = os.umask(0)
    try:
        solved(2)
    finally:
        os.umask(old)
    assert (folder.stat().st_mode & 0o777, entry(folder).stat().st_mode & 0o777) == (0o700, 0o600)


# The folder


@pytest.mark.parametrize("value", ["off", "OFF", "0", "no", "false"])
def test_the_store_can_be_switched_off(value, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("JAXWHISKER_CACHE", value)
    assert store.folder() is None
    assert [solved(2)[1], solved(2)[1]] == [1, 1]
    assert store.clear() == 0
    assert list(tmp_path.iterdir()) == []


def test_the_default_folder_belongs_to_the_user(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("JAXWHISKER_CACHE", "~/elsewhere")
    assert store.folder() == tmp_path / "elsewhere"
    monkeypatch.delenv("JAXWHISKER_CACHE")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    assert store.folder() == tmp_path / ".cache" / "jaxwhisker"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert store.folder() == tmp_path / "xdg" / "jaxwhisker"


def test_without_a_home_nothing_is_kept(monkeypatch):
    def homeless():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("JAXWHISKER_CACHE")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(store.Path, "home", homeless)
    assert store.folder() is None
    assert solved(2)[1] == 1


def test_a_folder_that_cannot_be_written_is_left_alone(folder):
    folder.write_text("a file")
    with pytest.warns(UserWarning, match=f"not kept in {folder}: it is a file") as caught:
        assert [solved(2)[1], solved(2)[1]] == [1, 1]
    assert len(caught) == 1 and folder.read_text() == "a file"


def test_a_folder_that_cannot_be_made_is_reported_once(folder, monkeypatch):
    folder.write_text("a file")
    folder.chmod(0o700)  # root may enter it
    monkeypatch.setenv("JAXWHISKER_CACHE", str(folder / "below" / "it"))
    assert store.obstacle(folder / "below" / "it") == f"{folder} is a file"
    with pytest.warns(UserWarning, match=f"it: {folder} is a file. Every process compiles them") as caught:
        assert [solved(size)[1] for size in (2, 3)] == [1, 1]
    assert len(caught) == 1


def test_a_full_disk_leaves_nothing(folder, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.warns(UserWarning, match="No space left on device"):
        assert solved(2)[1] == 1
    assert list(folder.iterdir()) == []


def test_a_read_only_store_is_read(folder, monkeypatch):
    def forbidden(*_):
        raise OSError(30, "Read-only file system")

    value, _ = solved(2)
    monkeypatch.setattr(os, "utime", forbidden)
    assert solved(2) == (value, 0)


def test_the_least_recently_used_entries_are_deleted(folder, monkeypatch):
    def ages(size, seconds):
        new = set(folder.glob("*")) if folder.exists() else set()
        solved(size)
        (path,) = set(folder.glob("*")) - new
        os.utime(path, (seconds, seconds))
        return path

    first, second, third = (ages(size, 1000 + size) for size in (2, 3, 4))
    assert solved(2)[1] == 0  # used just now
    total = sum(path.stat().st_size for path in (first, second, third))
    monkeypatch.setattr(store, "LARGEST", total)
    assert solved(6)[1] == 1
    assert first.exists() and not second.exists()
    assert sum(path.stat().st_size for path in folder.iterdir()) <= total


def test_clearing_deletes_entries_and_nothing_else(folder):
    solved(2)
    solved(3)
    for name in ("notes.txt", "download.part", f"x{store.UNFINISHED}"):
        (folder / name).touch()
    assert store.clear() == 2
    assert sorted(path.name for path in folder.iterdir()) == ["download.part", "notes.txt"]
    assert solved(2)[1] == 1
