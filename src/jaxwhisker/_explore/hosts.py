"""Hosts of the sliders: a widget in Jupyter, and a local page, which only this machine can open."""

import asyncio
import json
import socket
import threading
import webbrowser
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from importlib.resources import files
from typing import Any

from jaxwhisker._explore.session import Session

try:
    import anywidget
    import traitlets
    from tornado.httpserver import HTTPServer
    from tornado.web import Application, RequestHandler
except ImportError as error:
    raise ImportError(f"`explore` needs {error.name}: pip install 'jaxwhisker[explore]'") from error


def _asset(name: str) -> str:
    return files("jaxwhisker._explore").joinpath(name).read_text(encoding="utf-8")


PAGE, STYLE = _asset("explore.html"), _asset("explore.css")
SCRIPT = "\n".join(map(_asset, ("draw.js", "space.js", "explore.js")))  # anywidget needs a single module

# The widget


class Explorer(anywidget.AnyWidget):
    """The sliders of a session in Jupyter."""

    _esm = SCRIPT
    _css = STYLE
    description = traitlets.Dict().tag(sync=True)

    def __init__(self, session: Session):
        super().__init__(description=session.description)
        self._session = session
        self.on_msg(self._answer)

    def _answer(self, widget: Any, message: Any, buffers: Any) -> None:
        del widget, buffers
        request = message if isinstance(message, dict) else {}
        head = {"id": request.get("id")}
        try:
            self.send(head, buffers=[self._session.answer(request.get("values"))])
        except KeyboardInterrupt:
            self.send(head | {"error": "The kernel was interrupted. Move a slider to continue."})


# The page

LONGEST_REQUEST = 2**16  # bytes
LONGEST_READ = 2**24  # bytes; a longer request closes the connection, because only a complete one can be answered
_FILES = {
    "/": (PAGE, "text/html; charset=utf-8"),
    "/explore.js": (SCRIPT, "text/javascript; charset=utf-8"),
    "/explore.css": (STYLE, "text/css; charset=utf-8"),
}
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
}


def serve(session: Session, *, port: int = 0, browser: bool = True) -> None:
    """Show the sliders on a local page until Ctrl-C.

    Args:
        session: the sliders and their pictures.
        port: port of the page; 0 for any free port.
        browser: whether to open the page in the browser.

    Raises:
        OSError: if the port is taken.
        KeyboardInterrupt: on Ctrl-C.
    """
    with served(session, port) as url:
        print(f"The sliders are at {url} (Ctrl-C stops them).", flush=True)
        if browser:
            webbrowser.open(url)
        try:
            threading.Event().wait()
        finally:
            print("Stopping after the current picture.", flush=True)


@contextmanager
def served(session: Session, port: int = 0) -> Iterator[str]:
    """Serve the sliders at 127.0.0.1 from other threads, and yield the address of the page.

    Raises:
        OSError: if the port is taken.
    """
    listener = socket.create_server(("127.0.0.1", port))
    listener.setblocking(False)
    names = [f"{name}:{listener.getsockname()[1]}" for name in ("127.0.0.1", "localhost")]
    worker = ThreadPoolExecutor(1)  # one picture at a time
    application = Application(
        default_handler_class=_Handler,
        log_function=lambda handler: None,  # no log of twenty requests a second
        session=session,
        worker=worker,
        hosts=names,
    )
    stopped = threading.Event()

    async def run() -> None:
        server = HTTPServer(application, max_body_size=LONGEST_READ)
        server.add_socket(listener)
        await asyncio.to_thread(stopped.wait)
        server.stop()
        await server.close_all_connections()

    thread = threading.Thread(target=lambda: asyncio.run(run()))
    thread.start()
    try:
        yield f"http://{names[0]}/"
    finally:
        stopped.set()
        thread.join()
        worker.shutdown()  # wait for the picture: a process that exits while compiling crashes


class _Handler(RequestHandler):
    """Answer requests of the page, and refuse those of other sites."""

    def set_default_headers(self) -> None:
        for name, value in _HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        hosts, headers = self.settings["hosts"], self.request.headers
        if headers.get("Host") not in hosts:  # a foreign host name that points to this machine (DNS rebinding)
            self.send_error(403, message=f"This page is at http://{hosts[0]}/ only.")
            return
        origin = headers.get("Origin", None if self.request.method == "GET" else "")
        if origin is not None and origin not in [f"http://{host}" for host in hosts]:
            self.send_error(403, message="Only the page itself may send requests.")

    def get(self) -> None:
        if self.request.path == "/sliders":
            self.write(self.settings["session"].description)
        elif self.request.path in _FILES:
            text, kind = _FILES[self.request.path]
            self.set_header("Content-Type", kind)
            self.write(text)
        else:
            self.send_error(404, message="There is no such page.")

    async def post(self) -> None:
        if self.request.path != "/scan":
            self.send_error(404, message="There is no such page.")
            return
        if len(self.request.body) > LONGEST_REQUEST:
            self.send_error(413, message=f"A request must have at most {LONGEST_REQUEST} bytes.")
            return
        try:
            values = json.loads(self.request.body)
        except (ValueError, RecursionError):  # deeply nested JSON raises a RecursionError, before Python 3.13
            self.send_error(400, message="A request must be JSON.")
            return
        if isinstance(values, dict) and any(isinstance(value, dict) for value in values.values()):
            self.send_error(400, message="The values of a request must be numbers.")
            return
        loop = asyncio.get_running_loop()
        picture = await loop.run_in_executor(self.settings["worker"], self.settings["session"].answer, values)
        self.set_header("Content-Type", "application/octet-stream")
        self.write(picture)

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(kwargs.get("message", f"{status_code} {self._reason}"))
