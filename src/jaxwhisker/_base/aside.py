"""Compilation in other threads. XLA ignores Ctrl-C while it compiles; a thread that waits for it does not.

After an interrupt, what is being compiled is finished in the background, where the next call finds it.
"""

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager

from jaxwhisker._base import announce
from jaxwhisker._base.primitive import threads
from jaxwhisker._base.settings import as_here


class Compilers(ThreadPoolExecutor):
    """One thread per processor. Leaving the block waits for them, unless it is interrupted."""

    def __init__(self):
        super().__init__(threads())

    def __exit__(self, kind, *_):
        try:
            with interruptible():
                self.shutdown(wait=kind is None)
        finally:
            self.shutdown(wait=False, cancel_futures=True)


def aside(function: Callable, pool: Executor | None) -> Future:
    """The result of a function, computed in the pool; without one, in a thread of its own."""
    if pool is not None:
        return pool.submit(as_here(function))
    done, compute = Future(), as_here(function)
    if threading.current_thread() is not threading.main_thread():  # others are never interrupted
        done.set_result(function())
        return done

    def run() -> None:
        try:
            done.set_result(compute())
        except BaseException as error:
            done.set_exception(error)

    # Not a daemon: XLA aborts a process that ends while it compiles.
    threading.Thread(target=run, name="compiler").start()
    return done


@contextmanager
def interruptible() -> Iterator[None]:
    """Say, where the user sees it, that the compiler goes on after an interrupt."""
    try:
        yield
    except KeyboardInterrupt:
        announce.say("interrupted; what is being compiled is finished in the background, and the process ends after it")
        raise
