"""The line that says why a first call takes long: when it is printed, and what switches it off."""

import io
import time
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import jax.numpy as jnp
import pytest

from jaxwhisker._base import announce, store
from jaxwhisker._base.program import Program


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def terminal(monkeypatch):
    """A terminal as stderr, on which compilation is announced at once."""
    monkeypatch.delenv("JAXWHISKER_PROGRESS", raising=False)
    monkeypatch.setattr(announce, "PATIENCE", 0.0)
    shown = Terminal()
    # Not sys.stderr itself: pytest replaces it once more when the test begins.
    monkeypatch.setattr(announce, "sys", SimpleNamespace(stderr=shown, modules={}))
    return shown


def slow(x):
    time.sleep(0.3)  # while tracing
    return 2 * x


def compile_slowly():
    return Program(slow)(jnp.asarray(3.0))


def test_a_long_compilation_is_announced_once(terminal):
    compile_slowly()
    assert terminal.getvalue() == "jaxwhisker: compiling for scenes of this kind, once ...\n"


def test_calls_of_compiled_programs_are_not_announced(terminal):
    double = Program(slow)
    double(jnp.asarray(3.0))
    printed = terminal.getvalue()
    double(jnp.asarray(4.0))
    time.sleep(0.1)
    assert terminal.getvalue() == printed != ""


def test_programs_that_are_compiled_at_once_share_a_line(terminal):
    first, second = Program(slow), Program(lambda x: slow(x) + 1)
    with announce.announced(kept=True), ThreadPoolExecutor(2) as pool:
        first.prepare(pool, jnp.asarray(3.0))
        second.prepare(pool, jnp.asarray(3.0))
    assert terminal.getvalue() == "jaxwhisker: compiling for scenes of this kind, once, kept for later ...\n"


def test_the_line_says_whether_the_program_is_kept(terminal, monkeypatch):
    said = []

    def announced(*, kept):
        said.append(kept)
        return original(kept=kept)

    original = announce.announced
    monkeypatch.setattr("jaxwhisker._base.program.announced", announced)
    monkeypatch.setattr(store, "save", lambda *_: None)
    monkeypatch.setattr(store, "describe", lambda _: "known")
    compile_slowly()
    monkeypatch.setattr(store, "describe", lambda _: None)
    compile_slowly()
    monkeypatch.setattr(store, "describe", lambda _: "known")
    monkeypatch.setattr(store, "obstacle", lambda _: "it is a file")
    compile_slowly()
    assert said == [True, True, *[False] * 4]


def test_short_compilations_are_not_announced(terminal, monkeypatch):
    monkeypatch.setattr(announce, "PATIENCE", 60.0)
    compile_slowly()
    assert terminal.getvalue() == ""


@pytest.mark.parametrize("value", ["off", "OFF", "0", "no", "false"])
def test_an_environment_variable_switches_it_off(value, terminal, monkeypatch):
    monkeypatch.setenv("JAXWHISKER_PROGRESS", value)
    compile_slowly()
    assert terminal.getvalue() == ""


def test_nothing_is_printed_without_a_terminal(terminal, monkeypatch):
    file = io.StringIO()
    monkeypatch.setattr(announce.sys, "stderr", file)
    compile_slowly()
    assert file.getvalue() == ""
    monkeypatch.setattr(announce.sys, "stderr", None)  # as in a program without a console
    assert compile_slowly() == 6.0


def test_notebooks_count_as_terminals(terminal, monkeypatch):
    file = io.StringIO()
    monkeypatch.setattr(announce.sys, "stderr", file)
    monkeypatch.setitem(announce.sys.modules, "ipykernel", announce)
    compile_slowly()
    assert file.getvalue().count("\n") == 1


def test_a_failed_compilation_ends_the_announcement(terminal, monkeypatch):
    def fail(_):
        raise ValueError

    monkeypatch.setattr(announce, "PATIENCE", 0.2)
    with pytest.raises(ValueError):
        Program(fail)(jnp.asarray(3.0))
    time.sleep(0.4)
    assert terminal.getvalue() == ""


def test_a_long_search_shows_its_progress(terminal, monkeypatch):
    monkeypatch.setattr(announce, "PATIENCE", 0.01)
    monkeypatch.setattr(announce, "REFRESH", 0.0)
    with announce.progress("fitting") as report:
        for misfit in (7.0, 3.0, 5.0):
            time.sleep(0.02)
            report(misfit)
    lines = terminal.getvalue().split("\r")
    assert lines[1] == "jaxwhisker: fitting, 1 scans in 0 s, misfit 7"
    assert lines[3] == "jaxwhisker: fitting, 3 scans in 0 s, misfit 3"
    assert lines[-2].strip() == "" and lines[-1] == ""  # the line is erased


def test_a_search_shows_nothing_without_a_terminal(terminal, monkeypatch):
    file = io.StringIO()
    monkeypatch.setattr(announce.sys, "stderr", file)
    monkeypatch.setattr(announce, "REFRESH", 0.0)
    with announce.progress("fitting") as report:
        report(1.0)
    assert file.getvalue() == ""


def test_a_short_search_shows_nothing(terminal, monkeypatch):
    monkeypatch.setattr(announce, "PATIENCE", 60.0)
    with announce.progress("fitting") as report:
        report(1.0)
    assert terminal.getvalue() == ""


def test_the_line_says_what_programs_are_for(terminal):
    with announce.compiling_for("figure 5.14"):
        compile_slowly()
    assert "compiling for figure 5.14, once" in terminal.getvalue()
    terminal.truncate(0)
    compile_slowly()
    assert "compiling for scenes of this kind, once" in terminal.getvalue()
