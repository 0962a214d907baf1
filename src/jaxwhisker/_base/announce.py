"""What users are told: a line on a terminal or in a notebook that says why a call takes long, and warnings."""

import inspect
import os
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager

PATIENCE = 2.0  # seconds after which a line is printed
REFRESH = 0.5  # seconds between two updates of a line of progress


class _Notice:
    """What is being compiled in this process, and the line that says so."""

    lock = threading.Lock()
    running = 0
    told = False
    timer: threading.Timer | None = None
    purpose = "scenes of this kind"


@contextmanager
def compiling_for(purpose: str) -> Iterator[None]:
    """Say what the programs that are compiled meanwhile are for, instead of scenes of one kind."""
    before, _Notice.purpose = _Notice.purpose, purpose
    try:
        yield
    finally:
        _Notice.purpose = before


@contextmanager
def announced(*, kept: bool) -> Iterator[None]:
    """Say what is going on if this takes longer than `PATIENCE`; in scripts and logs, once.

    Args:
        kept: whether the program that is compiled will be kept on disk.
    """
    with _Notice.lock:
        _Notice.running += 1
        if _Notice.running == 1 and (_interactive() or not (_Notice.told or _silenced())):
            _Notice.timer = threading.Timer(PATIENCE, _announce, [kept])
            _Notice.timer.daemon = True
            _Notice.timer.start()
    try:
        yield
    finally:
        with _Notice.lock:
            _Notice.running -= 1
            if _Notice.running == 0 and _Notice.timer is not None:
                _Notice.timer.cancel()
                _Notice.timer = None


def _silenced() -> bool:
    return os.environ.get("JAXWHISKER_PROGRESS", "").lower() in ("off", "0", "no", "false")


def _interactive() -> bool:
    return not _silenced() and ("ipykernel" in sys.modules or bool(getattr(sys.stderr, "isatty", bool)()))


@contextmanager
def progress(doing: str) -> Iterator[Callable[[float], None]]:
    """Show on a terminal or in a notebook how far a search has come if it takes longer than `PATIENCE`.

    Args:
        doing: what is shown, such as "fitting".

    Yields:
        A function to call after every trial with its misfit, from any thread.
    """
    if not _interactive():
        yield lambda misfit: None
        return
    from tqdm import tqdm

    lock, least = threading.Lock(), float("inf")
    line = "jaxwhisker: {desc}, {n} scans in {elapsed_s:.0f} s{postfix}"
    # Every trial counts (`miniters`): tqdm would skip those that it expects to be fast.
    when = {"delay": PATIENCE, "mininterval": REFRESH, "miniters": 1}
    with tqdm(desc=doing, bar_format=line, file=sys.stderr, leave=False, **when) as bar:

        def report(misfit: float) -> None:
            nonlocal least
            with lock:
                least = min(least, misfit)
                bar.set_postfix_str(f"misfit {least:.3g}", refresh=False)
                bar.update()

        yield report


def _announce(kept: bool) -> None:
    _Notice.told = True
    _print(f"compiling for {_Notice.purpose}, once{', kept for later' if kept else ''} ...")


def say(text: str) -> None:
    """Print a line on a terminal or in a notebook."""
    if _interactive():
        _print(text)


def _print(text: str) -> None:
    print(f"jaxwhisker: {text}", file=sys.stderr, flush=True)


def warn(text: str) -> None:
    """Warn at the first line outside the package."""
    level, frame = 1, inspect.currentframe()
    while frame is not None and frame.f_globals.get("__name__", "").startswith("jaxwhisker."):
        level, frame = level + 1, frame.f_back
    warnings.warn(text, stacklevel=level)
