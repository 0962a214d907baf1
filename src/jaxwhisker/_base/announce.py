"""One line on a terminal or in a notebook that says why a first call takes long."""

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

PATIENCE = 2.0  # seconds of compilation after which the line is printed


class _Notice:
    """What is being compiled in this process, and the line that says so."""

    lock = threading.Lock()
    running = 0
    timer: threading.Timer | None = None


@contextmanager
def announced(*, kept: bool) -> Iterator[None]:
    """Say on a terminal or in a notebook what is going on if this takes longer than `PATIENCE`.

    Args:
        kept: whether the program that is compiled will be kept on disk.
    """
    with _Notice.lock:
        _Notice.running += 1
        if _Notice.running == 1 and _interactive():
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


def _interactive() -> bool:
    if os.environ.get("JAXWHISKER_PROGRESS", "").lower() in ("off", "0", "no", "false"):
        return False
    return "ipykernel" in sys.modules or bool(getattr(sys.stderr, "isatty", bool)())


def _announce(kept: bool) -> None:
    later = ", kept for later" if kept else ""
    print(f"jaxwhisker: compiling for scenes of this kind, once{later} ...", file=sys.stderr, flush=True)
