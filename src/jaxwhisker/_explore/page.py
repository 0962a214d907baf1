"""The local page: the sliders in a browser, without Jupyter, served to this machine alone."""

import json
import sys
import webbrowser
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from jaxwhisker._explore.assets import PAGE, SCRIPT, STYLE
from jaxwhisker._explore.session import Session

LARGEST = 65_536  # bytes of a request
_FILES = {"/": (PAGE, "text/html"), "/explore.js": (SCRIPT, "text/javascript"), "/explore.css": (STYLE, "text/css")}
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
        session: what answers.
        port: 0 for any that is free.
        browser: open the page in the browser.

    Raises:
        OSError: if the port is taken.
        KeyboardInterrupt: when it is ended.
    """
    with Server(session, port) as server:
        print(f"{server.url} shows the sliders; Ctrl-C ends it.", flush=True)
        if browser:
            webbrowser.open(server.url)
        try:
            server.serve_forever()
        finally:
            # A process that ends while one of its threads is within the compiler crashes.
            if session.busy:
                print("It ends when the scene under way is computed.", flush=True)
            session.close()


class Server(ThreadingHTTPServer):
    """Serves one session on 127.0.0.1, to pages that come from there."""

    daemon_threads = True  # a request that waits for the compiler does not keep the process alive

    def __init__(self, session: Session, port: int = 0):
        super().__init__(("127.0.0.1", port), _Handler)
        self.session = session
        self.hosts = {f"{name}:{self.server_port}" for name in ("127.0.0.1", "localhost")}

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A page that was closed while it waited is no error."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://127.0.0.1:{self.server_port}/"


class _Refused(Exception):  # noqa: N818, it is an answer
    def __init__(self, status: HTTPStatus, words: str):
        super().__init__(words)
        self.status = status


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"  # connections are kept
    wbufsize = -1  # head and body of a reply leave together ...
    disable_nagle_algorithm = True  # ... and at once
    timeout = 60.0  # s without a request, after which a connection is closed
    server: Server

    def do_GET(self) -> None:
        self._answer(self._read)

    def do_POST(self) -> None:
        self._answer(self._scan)

    def _answer(self, found: Any) -> None:
        try:
            if self.headers.get("Host") not in self.server.hosts:
                # A name of somebody else's that was made to point here.
                raise _Refused(HTTPStatus.FORBIDDEN, f"This page is at {self.server.url} only.")
            self._send(HTTPStatus.OK, *found())
        except _Refused as refused:
            self.close_connection = True  # what is left of the request stays unread
            self._send(refused.status, f"{refused}".encode(), "text/plain")

    def _read(self) -> tuple[bytes, str]:
        if self.path == "/sliders":
            return json.dumps(self.server.session.description).encode(), "application/json"
        if self.path not in _FILES:
            raise _Refused(HTTPStatus.NOT_FOUND, "There is no such page.")
        text, kind = _FILES[self.path]
        return text.encode(), kind

    def _scan(self) -> tuple[bytes, str]:
        if self.headers.get("Origin") not in {f"http://{host}" for host in self.server.hosts}:
            raise _Refused(HTTPStatus.FORBIDDEN, "Only the page itself may ask.")
        if self.path != "/scan":
            raise _Refused(HTTPStatus.NOT_FOUND, "There is no such page.")
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdecimal()):
            raise _Refused(HTTPStatus.LENGTH_REQUIRED, "A request must tell its length.")
        if int(length) > LARGEST:
            raise _Refused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"A request may have {LARGEST} bytes at most.")
        try:
            values = json.loads(self.rfile.read(int(length)))
            return self.server.session.answer(values), "application/octet-stream"
        except ValueError as error:  # as of JSON that is none
            raise _Refused(HTTPStatus.BAD_REQUEST, str(error)) from None

    def _send(self, status: HTTPStatus, body: bytes, kind: str) -> None:
        self.send_response(status)
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        self.send_header("Content-Type", f"{kind}; charset=utf-8" if kind.startswith("text") else kind)
        self.send_header("Content-Length", str(len(body)))
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: twenty requests a second are no news."""
