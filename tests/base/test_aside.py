"""Ctrl-C while a program is compiled: it acts at once, says so, and loses nothing."""

import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import pytest

from jaxwhisker._base import announce, aside
from jaxwhisker._base.aside import Compilers
from jaxwhisker._base.program import Program

COMPILING = 1.0  # s
X = jnp.asarray(3.0)


@pytest.fixture
def compiled(monkeypatch):
    """Names of the threads that compile, which takes them a second."""
    names, compile_now = [], jax.stages.Lowered.compile

    def slowly(*args):
        names.append(threading.current_thread().name)
        time.sleep(COMPILING)
        return compile_now(*args)

    monkeypatch.setenv("JAXWHISKER_CACHE", "off")
    monkeypatch.setattr(jax.stages.Lowered, "compile", slowly)
    return names


@pytest.fixture
def said(monkeypatch):
    """Lines that are shown to the user."""
    lines = []
    monkeypatch.setattr(announce, "say", lines.append)
    return lines


def interrupted(call):
    """Seconds from Ctrl-C, during a call, to its exception."""
    pressed = []

    def press():
        pressed.append(time.monotonic())
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)

    timer = threading.Timer(COMPILING / 4, press)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        call()
    return time.monotonic() - pressed[0]


def test_an_interrupt_acts_while_a_program_is_compiled(compiled, said):
    handler, double = signal.getsignal(signal.SIGINT), Program(lambda x: 2 * x)
    assert interrupted(lambda: double(X)) < COMPILING / 2
    assert signal.getsignal(signal.SIGINT) is handler
    assert len(said) == 1 and said[0].startswith("interrupted; ")
    assert double(X) == 6.0 and compiled == ["compiler"]  # the next call waits for the same program


def test_an_interrupt_acts_while_several_programs_are_compiled(compiled, said, monkeypatch):
    monkeypatch.setattr(aside, "threads", lambda: 1)
    programs = [Program(lambda x, k=k: k * x) for k in range(3)]

    def prepare():
        with Compilers() as pool:
            for program in programs:
                program.prepare(pool, X)

    assert interrupted(prepare) < COMPILING / 2
    assert len(said) == 1 and len(compiled) == 1
    assert [program(X) for program in programs] == [0.0, 3.0, 6.0]  # those in the queue are compiled again
    assert len(compiled) == 3


def test_an_interrupt_while_tracing_does_not_wait_for_compilers(compiled):
    def slow(x):
        time.sleep(2 * COMPILING)
        return x

    def prepare():
        with Compilers() as pool:
            Program(lambda x: 2 * x).prepare(pool, X)
            Program(slow).prepare(pool, X)

    assert interrupted(prepare) < COMPILING / 2


def test_compilers_are_waited_for(compiled):
    double = Program(lambda x: 2 * x)
    with Compilers() as pool:
        double.prepare(pool, X)
    assert all(future.done() for future in double._executables.values())


def test_other_threads_compile_themselves(compiled):
    with ThreadPoolExecutor(1, thread_name_prefix="other") as pool:
        assert pool.submit(Program(lambda x: 2 * x), X).result() == 6.0
    assert compiled == ["other_0"]


def test_errors_of_the_compiler_are_raised(monkeypatch):
    def fail(*_):
        raise RuntimeError("no compiler")

    monkeypatch.setattr(jax.stages.Lowered, "compile", fail)
    with pytest.raises(RuntimeError, match="no compiler"):
        Program(lambda x: 2 * x)(X)
