"""Ctrl-C while a program is compiled: it acts at once, says so, and loses nothing."""

import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import jax
import jax.numpy as jnp
import pytest

from jaxwhisker._base import announce, aside, program
from jaxwhisker._base.aside import Compilers
from jaxwhisker._base.program import Program

FOREVER = 60.0  # s, for a compiler that nobody lets end
AGAIN = 0.1  # s, until Ctrl-C is pressed again
X = jnp.asarray(3.0)


class Compiler:
    """A compiler that ends only when it may."""

    def __init__(self):
        self.threads, self.began, self.may_end, self.ended = [], threading.Event(), threading.Event(), 0

    def slow(self, compile_now):
        def compiled(*args):
            self.threads.append(threading.current_thread().name)
            self.began.set()
            self.may_end.wait(FOREVER)
            self.ended += 1
            return compile_now(*args)

        return compiled

    def interrupts(self, call, waits=None):
        """Whether Ctrl-C while something is compiled ends a call, although the compiler goes on."""
        acted, before = threading.Event(), signal.getsignal(signal.SIGINT)

        def once(*_):
            if not acted.is_set():
                acted.set()
                raise KeyboardInterrupt

        def press():
            self.began.wait(FOREVER)
            if waits is not None:
                waits.wait(FOREVER)
            while not acted.is_set():  # a signal is lost that comes just before the main thread goes to sleep
                signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
                acted.wait(AGAIN)

        presses = threading.Thread(target=press)
        signal.signal(signal.SIGINT, once)
        presses.start()
        try:
            with pytest.raises(KeyboardInterrupt):
                call()
            ended = self.ended
            self.may_end.set()
        finally:
            acted.set()  # also if the call ended without it
            presses.join()
            signal.signal(signal.SIGINT, before)
        return ended == 0


@pytest.fixture
def compiler(monkeypatch):
    slow = Compiler()
    monkeypatch.setenv("JAXWHISKER_CACHE", "off")
    monkeypatch.setattr(jax.stages.Lowered, "compile", slow.slow(jax.stages.Lowered.compile))
    return slow


@pytest.fixture
def said(monkeypatch):
    """Lines that are shown to the user."""
    lines = []
    monkeypatch.setattr(announce, "say", lines.append)
    return lines


@pytest.fixture
def waits(monkeypatch):
    """An event: the main thread has begun to wait for compilers."""
    event, own = threading.Event(), aside.interruptible

    @contextmanager
    def interruptible():
        with own():
            event.set()
            yield

    for module in (aside, program):
        monkeypatch.setattr(module, "interruptible", interruptible)
    return event


def test_an_interrupt_acts_while_a_program_is_compiled(compiler, said, waits):
    handler, double = signal.getsignal(signal.SIGINT), Program(lambda x: 2 * x)
    assert compiler.interrupts(lambda: double(X), waits)
    assert signal.getsignal(signal.SIGINT) is handler
    assert len(said) == 1 and said[0].startswith("interrupted; ")
    assert double(X) == 6.0 and compiler.threads == ["compiler"]  # the next call waits for the same program


def test_an_interrupt_acts_while_several_programs_are_compiled(compiler, said, waits, monkeypatch):
    monkeypatch.setattr(aside, "threads", lambda: 1)
    programs = [Program(lambda x, k=k: k * x) for k in range(3)]

    def prepare():
        with Compilers() as pool:
            for each in programs:
                each.prepare(pool, X)

    assert compiler.interrupts(prepare, waits)
    assert len(said) == 1 and len(compiler.threads) == 1
    assert [each(X) for each in programs] == [0.0, 3.0, 6.0]  # those in the queue are compiled again
    assert len(compiler.threads) == 3


def test_an_interrupt_while_tracing_does_not_wait_for_compilers(compiler):
    def slow(x):
        time.sleep(FOREVER / 10)
        return x

    def prepare():
        with Compilers() as pool:
            Program(lambda x: 2 * x).prepare(pool, X)
            Program(slow).prepare(pool, X)

    assert compiler.interrupts(prepare)


def test_compilers_are_waited_for(compiler):
    threading.Timer(0.1, compiler.may_end.set).start()
    double = Program(lambda x: 2 * x)
    with Compilers() as pool:
        double.prepare(pool, X)
    assert all(future.done() for future in double._executables.values())


def test_other_threads_compile_themselves(compiler):
    compiler.may_end.set()
    with ThreadPoolExecutor(1, thread_name_prefix="other") as pool:
        assert pool.submit(Program(lambda x: 2 * x), X).result() == 6.0
    assert compiler.threads == ["other_0"]


def test_errors_of_the_compiler_are_raised(monkeypatch):
    def fail(*_):
        raise RuntimeError("no compiler")

    monkeypatch.setattr(jax.stages.Lowered, "compile", fail)
    with pytest.raises(RuntimeError, match="no compiler"):
        Program(lambda x: 2 * x)(X)
