"""The local page's server, and the widget; see test_browser.py for what they show."""

import contextlib
import gc
import http.client
import json
import re
import socket
import sys
import threading

import pytest

import jaxwhisker as jw
from jaxwhisker import _explore
from jaxwhisker._explore import hosts
from jaxwhisker._explore.session import Session

VALUES = {"stiffness": 70.0}


def build(stiffness):
    return jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(stiffness))


class Echo(Session):
    """A session that answers with the request."""

    def __init__(self):
        super().__init__(build, {"stiffness": (10, 500)})

    def answer(self, values):
        return b"picture of " + json.dumps(values).encode()


@pytest.fixture(scope="module")
def port():
    """The port at which a session is served."""
    with hosts.served(Echo()) as url:
        yield int(url.rstrip("/").rsplit(":", 1)[1])


def send(port, method, path, body=None, **headers):
    """Status, headers and body of the server's answer."""
    host = f"127.0.0.1:{port}"
    sent = {"Host": host} | ({} if method == "GET" else {"Origin": f"http://{host}"})
    sent |= {} if body is None else {"Content-Length": str(len(body))}
    sent |= {name.replace("_", "-"): value for name, value in headers.items()}
    # a connection that the server resets is closed here, too
    with contextlib.closing(http.client.HTTPConnection(host, timeout=60)) as connection:
        connection.putrequest(method, path, skip_host=True)
        for name, value in sent.items():
            if value is not None:
                connection.putheader(name, value)
        connection.endheaders(body)
        response = connection.getresponse()
        return response.status, response.headers, response.read()


def test_the_page_and_its_parts_are_served(port):
    for path, kind in {"/": "text/html", "/explore.js": "text/javascript", "/explore.css": "text/css"}.items():
        status, headers, body = send(port, "GET", path)
        assert status == 200 and headers["Content-Type"].startswith(kind) and len(body) > 100
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert not re.search(rb"https?://", body)  # nothing is loaded from elsewhere
    status, headers, body = send(port, "GET", "/sliders")
    assert status == 200 and json.loads(body)["sliders"][0]["name"] == "stiffness"


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost"])
def test_the_page_gets_pictures(name, port):
    host = f"{name}:{port}"
    status, headers, body = send(port, "POST", "/scan", GOOD, Host=host, Origin=f"http://{host}")
    assert status == 200 and headers["Content-Type"] == "application/octet-stream"
    assert body == b"picture of " + GOOD


def test_connections_are_kept(port):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request("GET", "/")
    connection.getresponse().read()
    first = connection.sock
    connection.request("GET", "/explore.css")
    assert connection.getresponse().read() and connection.sock is first is not None
    connection.close()


GOOD = json.dumps(VALUES).encode()
REJECTED = {
    "foreign host": ("GET", "/", None, {"Host": "example.org"}, 403),
    "foreign host with the port": ("GET", "/", None, {"Host": "example.org:{port}"}, 403),
    "another port": ("GET", "/", None, {"Host": "127.0.0.1:1"}, 403),
    "no host": ("GET", "/", None, {"Host": None}, 400),
    "foreign host, missing page": ("GET", "/missing", None, {"Host": "example.org"}, 403),
    "sliders for a foreign page": ("GET", "/sliders", None, {"Origin": "http://example.org"}, 403),
    "scan for a foreign host": ("POST", "/scan", GOOD, {"Host": "example.org:{port}"}, 403),
    "foreign origin": ("POST", "/scan", GOOD, {"Origin": "http://example.org"}, 403),
    "origin with another port": ("POST", "/scan", GOOD, {"Origin": "http://127.0.0.1:1"}, 403),
    "no origin": ("POST", "/scan", GOOD, {"Origin": None}, 403),
    "null origin": ("POST", "/scan", GOOD, {"Origin": "null"}, 403),
    "another path": ("GET", "/session.py", None, {}, 404),
    "a path upwards": ("GET", "/../hosts.py", None, {}, 404),
    "scan by GET": ("GET", "/scan", None, {}, 404),
    "another path by POST": ("POST", "/", GOOD, {}, 404),
    "another method": ("PUT", "/scan", None, {}, 405),
    "preflight of a foreign page": ("OPTIONS", "/scan", None, {"Origin": "http://example.org"}, 403),
    "no body": ("POST", "/scan", None, {}, 400),
    "negative length": ("POST", "/scan", None, {"Content_Length": "-1"}, 400),
    "long": ("POST", "/scan", b" " * 1_000_000, {}, 413),
    "huge": ("POST", "/scan", None, {"Content_Length": str(10**12)}, 400),
    "malformed": ("POST", "/scan", b"{", {}, 400),
    "not text": ("POST", "/scan", b"\xff\xfe\xfd", {}, 400),
    "deeply nested list": ("POST", "/scan", b"[" * 60_000, {}, 400),
    "deeply nested dict": ("POST", "/scan", b'{"a":' * 9_000 + b"1" + b"}" * 9_000, {}, 400),
}


@pytest.mark.parametrize("name", REJECTED)
def test_other_requests_get_an_error_and_the_server_goes_on(name, port, caplog):
    method, path, body, headers, expected = REJECTED[name]
    filled = {key: value and value.format(port=port) for key, value in headers.items()}
    status, found, text = send(port, method, path, body, **filled)
    assert status == expected
    assert b"picture" not in text and b"Traceback" not in text and "Access-Control-Allow-Origin" not in found
    assert send(port, "POST", "/scan", GOOD)[0] == 200
    assert caplog.records == []  # nothing is printed


def test_only_this_machine_is_served(port):
    with pytest.raises(OSError), socket.create_connection(("127.0.0.2", port), timeout=5):
        pass


def test_the_end_waits_for_the_current_picture_only(caplog):
    started, proceed, answered = threading.Event(), threading.Event(), []

    class Slow(Echo):
        def answer(self, values):
            started.set()
            assert proceed.wait(60)
            answered.append(values)
            return super().answer(values)

    def ask():
        with pytest.raises(OSError):  # the server closes the connection
            send(int(url.rstrip("/").rsplit(":", 1)[1]), "POST", "/scan", GOOD)

    clients = [threading.Thread(target=ask) for _ in range(2)]
    with hosts.served(Slow()) as url:
        for client in clients:
            client.start()
        assert started.wait(60)
        threading.Timer(0.5, proceed.set).start()
    assert len(answered) == 1
    for client in clients:
        client.join()
    gc.collect()
    assert caplog.records == []


def test_outside_jupyter_a_page_opens(monkeypatch):
    served = []

    def serve(session):
        served.append(session.sliders[0].name)
        raise KeyboardInterrupt

    monkeypatch.setattr(hosts, "serve", serve)
    assert jw.explore(build, stiffness=(10, 500)) is None
    assert served == ["stiffness"]


def test_in_jupyter_a_widget_is_returned(monkeypatch):
    monkeypatch.setattr(_explore, "_in_jupyter", lambda: True)
    widget = jw.explore(build, stiffness=(10, 500))
    assert isinstance(widget, hosts.Explorer)
    widget.close()


def test_the_widget_answers_messages(monkeypatch):
    widget, sent = hosts.Explorer(Echo()), []
    monkeypatch.setattr(widget, "send", lambda content, buffers=None: sent.append((content, buffers)))
    for message in ({"id": "one", "values": VALUES}, {"id": "two"}, "malformed"):
        widget._handle_custom_msg(message, [])
    assert sent[0] == ({"id": "one"}, [b"picture of " + GOOD])
    assert sent[1:] == [({"id": "two"}, [b"picture of null"]), ({"id": None}, [b"picture of null"])]
    assert widget.description == Echo().description
    widget.close()


def test_an_interrupt_of_the_kernel_is_an_answer(monkeypatch):
    def answer(self, values):
        raise KeyboardInterrupt

    monkeypatch.setattr(Echo, "answer", answer)
    widget, sent = hosts.Explorer(Echo()), []
    monkeypatch.setattr(widget, "send", lambda content, buffers=None: sent.append(content))
    widget._handle_custom_msg({"id": "one", "values": VALUES}, [])
    assert sent[0]["id"] == "one" and "interrupted" in sent[0]["error"]
    widget.close()


@pytest.mark.parametrize("package", ["anywidget", "tornado.web"])
def test_a_missing_package_is_an_error_that_names_the_extra(package, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delitem(sys.modules, "jaxwhisker._explore.hosts")
    with pytest.raises(ImportError, match=re.escape(f"{package}: pip install 'jaxwhisker[explore]'")):
        jw.explore(build, stiffness=(10, 500))
