"""Sliders: replies, the code of a scene, ranges, the local page's server, the widget; the command."""

import http.client
import json
import re
import signal
import socket
import subprocess
import sys
import threading
import urllib.request
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker import cli
from jaxwhisker._explore import page, session
from jaxwhisker._explore.code import code_of, code_of_scene, scanned
from jaxwhisker._explore.lifted import Lifting
from jaxwhisker._explore.picture import STEPS
from jaxwhisker._explore.reply import unpacked
from jaxwhisker._explore.session import Session
from jaxwhisker._explore.sliders import sliders_of
from jaxwhisker._explore.written import UnwritableError
from jaxwhisker.cli import explore as command

SAME = 1e-9  # of the peak: a scan's path depends a little on where it is told to end, its states do not
SINGLE = 1e-6  # lengths: lines are sent in float32
PRINTED = 1e-6  # relative: seven digits

CURVATURE = 1.0  # of the object, which `build` reads from here


def springs(stiffness):
    return jw.Support.fb(stiffness)


springs.__module__ = "__main__"  # as in a notebook, from which nothing can be imported


def build(stiffness, distance=0.2):
    if distance > 0.8:
        raise ValueError("`distance` must leave room.")
    if distance > 0.7:
        raise ZeroDivisionError("by nothing")
    profile = jw.Parabola(distance, CURVATURE)
    return jw.Scene(jw.Whisker(), profile, springs(stiffness), rod=jw.ClosedForm())


RANGES = {"stiffness": (10, 500, 70.0), "distance": (0.1, 0.9, 0.25)}
VALUES = {"stiffness": 70.0, "distance": 0.25}


@pytest.fixture(scope="module")
def sliders():
    return Session(build, RANGES)


@pytest.fixture(scope="module")
def replied(sliders):
    """Header and arrays of a reply."""
    return unpacked(sliders.answer(VALUES))


@pytest.fixture(scope="module")
def scanned_there(replied):
    """The scan at the same controls."""
    return jw.scan(build(**VALUES), replied[1]["control"])


@pytest.mark.parametrize("name", ["fx", "fy", "mz", "base_x", "contact_force", "contact_arc", "contact_x", "contact_y"])
def test_a_reply_is_the_scan_at_its_controls(name, replied, scanned_there):
    found, expected = replied[1][name], np.asarray(getattr(scanned_there, name))
    assert found.dtype == np.float64 and found.shape == (STEPS, 1)
    np.testing.assert_allclose(found, expected, rtol=0, atol=SAME * np.abs(expected).max())


def test_its_lines_are_the_shapes_of_the_scan(replied, scanned_there):
    lines = jw.shapes(scanned_there, points=replied[1]["line_x"].shape[-1])
    np.testing.assert_allclose(replied[1]["line_x"], lines.x, rtol=0, atol=SINGLE)
    np.testing.assert_allclose(replied[1]["line_y"], lines.y, rtol=0, atol=SINGLE)
    assert np.all(replied[1]["phase"] == np.asarray(scanned_there.phase))


def test_it_spans_the_default_control_and_tells_its_events(replied, scanned_there):
    header, arrays = replied
    usual = jw.scan(build(**VALUES))
    assert abs(arrays["control"][0] - usual.control[0]) < SAME
    assert abs(arrays["control"][-1] - usual.control[-1]) < 0.002  # of the default's last step
    assert [event["text"] for event in header["events"]] == [str(event) for event in usual.events]
    assert len(header["events"]) == 5 and header["events"][-1]["snap"] and header["events"][0]["whiskers"] == [0]
    assert (header["failed"], header["summary"]) == (0, f"{STEPS} steps: {STEPS} ok")
    assert header["labels"]["u"] == "u/L" and header["labels"]["mz"] == "mz L/EI"


def test_the_object_is_that_of_the_scene(replied):
    x, y = replied[1]["outline_x"], replied[1]["outline_y"]
    np.testing.assert_allclose(y, 0.25 + x**2, rtol=SINGLE)
    assert x.min() < -2.9 and x.max() > 2.9


def test_a_scene_that_is_refused_tells_why(sliders):
    header, arrays = unpacked(sliders.answer(VALUES | {"distance": 0.85}))
    assert header["error"] == "`distance` must leave room." and arrays == {}
    assert unpacked(sliders.answer(VALUES | {"distance": 0.75}))[0]["error"] == "ZeroDivisionError: by nothing"


def test_failed_steps_are_counted_and_leave_gaps(sliders, monkeypatch):
    whole = session.picture

    def failing(scene):
        shown = whole(scene)
        bad = jnp.arange(STEPS) >= STEPS - 30
        holes = {name: jnp.where(bad[:, None], jnp.nan, getattr(shown.result, name)) for name in ("fx", "fy", "mz")}
        result = eqx.tree_at(lambda r: tuple(getattr(r, n) for n in holes), shown.result, tuple(holes.values()))
        result = eqx.tree_at(lambda r: r.status, result, jnp.where(bad, int(jw.Status.lost), 0))
        return shown._replace(result=result)

    monkeypatch.setattr(session, "picture", failing)
    header, arrays = unpacked(sliders.answer(VALUES))
    assert (header["failed"], header["summary"]) == (30, f"{STEPS} steps: {STEPS - 30} ok, 30 lost")
    assert sliders.description["statuses"][arrays["status"][-1]] == "lost"
    assert np.isnan(arrays["fx"][-30:]).all() and np.isfinite(arrays["fx"][:-30]).all()


@pytest.mark.unchecked
@pytest.mark.parametrize(
    "values",
    [
        {"stiffness": 70.0},
        {**VALUES, "radius": 1.0},
        {**VALUES, "stiffness": float("nan")},
        {**VALUES, "stiffness": 501.0},
        {**VALUES, "stiffness": "70"},
        {**VALUES, "stiffness": True},
        [70.0, 0.25],
        None,
    ],
)
def test_values_that_no_slider_has_are_refused(values, sliders):
    with pytest.raises(ValueError, match="stiffness"):
        sliders.answer(values)


def fixed(x):
    return jw.Scene(jw.Whisker(), jw.Parabola(x))


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "ranges", "words"),
    [
        (build, {"stiff": (1, 2)}, "`stiff` must be a parameter of `build`, but `build` takes stiffness, distance"),
        (build, {"distance": (0.1, 0.2)}, "`stiffness` must be given a range"),
        (build, {"stiffness": (500, 10)}, "`stiffness` must be a range with low < high, but is (500, 10)"),
        (build, {"stiffness": (10, 10)}, "low < high"),
        (build, {"stiffness": (10, float("nan"))}, "finite numbers, but is (10, nan)"),
        (build, {"stiffness": (10, float("inf"))}, "finite numbers"),
        (build, {"stiffness": 70.0}, "`stiffness` must be (low, high) or (low, high, start)"),
        (build, {"stiffness": (10,)}, "(low, high)"),
        (build, {"stiffness": (10, 20, 15, 16)}, "(low, high)"),
        (build, {"stiffness": ("soft", "stiff")}, "(low, high)"),
        (build, {"stiffness": (10, 500, 5)}, "`stiffness` must start between its ends 10 and 500, but does at 5"),
        (lambda x: None, {"x": (1, 2)}, "`build` must return a Scene, but returned None"),
        (lambda x, /: fixed(x), {"x": (1, 2)}, "`x` is positional only"),
        (70.0, {}, "`build` must be a function that returns a Scene, but is 70.0"),
        (fixed, {"x": (-1, 1, -0.5)}, "`distance` must be a positive finite number"),
    ],
)
def test_what_cannot_be_explored_is_told(make, ranges, words):
    with pytest.raises(ValueError, match=re.escape(words)):
        jw.explore(make, **ranges)


def test_float32_is_refused():
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(ValueError, match="jax_enable_x64"):
            jw.explore(build, stiffness=(10, 500))
    finally:
        jax.config.update("jax_enable_x64", True)


def test_wide_ranges_are_logarithmic_and_start_in_the_middle():
    ranges = {"a": (10, 500), "b": (10, 200), "c": (0, 500), "d": (-1, 500.0), "e": (np.float64(1), 21, 2)}
    found = sliders_of(lambda **values: fixed(1.0), ranges)
    assert [slider.logarithmic for slider in found] == [True, False, False, False, True]
    assert [slider.start for slider in found] == [70.71, 105.0, 250.0, 249.5, 2.0]


def run(code, step):
    """What the code of a page prints, and its names."""
    printed = []
    names = {"__name__": "fresh", "print": lambda *words: printed.append(words[0])}
    exec(str(step).join(code), names)
    return names, printed


def check(code, scene, arrays, step):
    names, printed = run(code, step)
    assert jax.tree.all(jax.tree.map(lambda a, b: bool(jnp.all(a == b)), names["scene"], scene))
    assert str(printed[0]) == str(names["result"])
    for name in ("fx", "fy", "mz"):
        text = re.search(rf"{name} = (\S+?)(,|$)", printed[1])
        assert text is not None
        np.testing.assert_allclose(float(text[1]), arrays[name][step, 0], rtol=PRINTED)
        peak = np.abs(arrays[name]).max()
        np.testing.assert_allclose(getattr(names["result"], name), arrays[name], rtol=0, atol=SAME * peak)


def test_the_code_runs_as_it_is_and_gives_the_same_numbers(replied):
    header, arrays = replied
    code = "".join(header["code"])
    assert "def build(stiffness, distance=0.2):" in code and "def springs(stiffness):" in code
    assert "CURVATURE = 1.0" in code and "scene = build(stiffness=70.0, distance=0.25)" in code
    check(header["code"], build(**VALUES), arrays, 217)


def test_a_scene_that_is_written_out_gives_the_same_numbers(replied):
    _, arrays = replied
    scene = build(**VALUES)
    check(scanned(code_of_scene(scene), arrays["control"]), scene, arrays, 300)


def of(make, **values):
    """The code of a scene, the names that it binds, and the scene."""
    code, names = code_of(make, make(**values), values), {"__name__": "fresh"}
    exec(code, names)
    return code, names["scene"], make(**values)


def same(one, other):
    assert jax.tree.structure(one) == jax.tree.structure(other)
    assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True))


def test_lambdas_are_told_apart_and_closures_come_along():
    height, offset = 0.3, jw.Whisker(2.0)
    both = [lambda x: fixed(x + height), lambda x: jw.Scene(offset, jw.Circle(x, np.float64(2.0)))]
    code, found, expected = of(both[0], x=0.5)
    assert "build = lambda x: fixed(x + height)" in code and "height = 0.3" in code
    same(found, expected)
    code, found, expected = of(both[1], x=0.5)
    assert "offset = jw.Whisker(length=2.0)" in code
    same(found, expected)


def test_a_lambda_of_several_lines_is_taken_whole():
    make = [
        lambda x, y=(
            1.0
        ): fixed(
            x
        )
    ][0]  # fmt: skip
    _, found, expected = of(make, x=0.5)
    same(found, expected)


def test_functions_of_modules_are_imported():
    code, found, expected = of(lambda x: fixed(json.loads(str(x))), x=0.5)
    assert "import json" in code and f"from {__name__} import fixed" in code
    same(found, expected)


def test_without_a_source_the_scene_is_written_out():
    names = {"jw": jw}
    exec("def made(x): return jw.Scene(jw.Whisker(), jw.Parabola(x))", names)
    code, found, expected = of(names["made"], x=0.5)
    assert "jw.Parabola(distance=0.5)" in code and "made" not in code
    same(found, expected)


def test_what_cannot_be_written_is_told():
    secret = object()

    def make(x):
        assert secret is not None
        return jw.Scene(jw.Whisker(1.0, lambda s: 2.0 - s), jw.Parabola(x))

    code = code_of(make, make(0.5), {"x": 0.5})
    assert "# Of yours it needs: secret." in code and "scene = make(x=0.5)" in code
    with pytest.raises(UnwritableError):
        code_of_scene(make(0.5))


PARTS = [
    jw.Scene(jw.Whisker(0.05, 2e-9), jw.Circle(0.01, 0.02, 0.001), jw.Support.clamped()),
    jw.Scene(jw.Whisker(intrinsic_curvature=0.1), jw.Ellipse(0.2, 1.0, 0.5), jw.Support.fbfb((70.0, jnp.inf))),
    jw.Scene(jw.Whisker(), jw.Tilted(jw.Parabola(0.3), 0.1), jw.Support.fbfbr(70.0, (0.2, 0.3, 0.6))),
    jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fbfbfbr((1.0, 2.0, 3.0, 4.0, 5.0), 0.1), jw.ClosedForm()),
    jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.follicle(70.0, 80.0, 9.0, mount=jw.Mount(angle=0.1))),
    jw.Scene((jw.Whisker(), jw.Whisker(0.9)), jw.Parabola(0.2), jw.Support.fbfb(70.0), jw.Shooting(6)),
    jw.Scene(jw.Whisker(), jw.Parabola(0.2), motion=jw.Rotation((0.0, -1.0), 0.9, -1)),
    jw.Scene(jw.Whisker(), jw.Contour.like(jw.Parabola(0.2), (-0.5, 0.0, 0.5))),
    jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support((jw.Spring((0, 1), compliance=0.0),))),
]


@pytest.mark.parametrize("scene", PARTS, ids=str)
def test_scenes_of_numbers_are_written_out(scene):
    names = {"__name__": "fresh"}
    exec(code_of_scene(scene), names)
    same(names["scene"], scene)


def test_functions_made_anew_are_one_function_of_their_numbers():
    def tapered(taper):
        return jw.Scene(jw.Whisker(1.0, lambda s: (1 - taper * s) ** 4), jw.Graph(lambda x: 0.2 + x**2))

    lifting = Lifting()
    first, second = lifting(tapered(0.2)), lifting(tapered(0.5))
    assert jax.tree.structure(first) == jax.tree.structure(second)
    assert jax.tree.structure(tapered(0.2)) != jax.tree.structure(tapered(0.5))  # or it would be for nothing
    for scene, taper in ((first, 0.2), (second, 0.5)):
        graph: Any = scene.profile
        np.testing.assert_allclose(float(scene.whiskers[0].stiffness_at(0.4)), (1 - taper * 0.4) ** 4)
        assert float(graph.g(0.5)) == 0.45


def test_functions_that_differ_by_more_than_numbers_stay_their_own():
    def made(function):
        return jw.Scene(jw.Whisker(), jw.Graph(lambda x: 0.2 + function(x)))

    lifting = Lifting()
    for function in (jnp.square, jnp.cosh):
        graph: Any = lifting(made(function)).profile
        assert float(graph.g(0.5)) == 0.2 + float(function(0.5))


# The local page


@pytest.fixture(scope="module")
def server(sliders, replied):
    with page.Server(sliders) as served:
        thread = threading.Thread(target=served.serve_forever)
        thread.start()
        yield served
        served.shutdown()
        thread.join()


def asked(server, method, path, body=None, **headers):
    """Status, headers and body of what the server answers."""
    here = f"127.0.0.1:{server.server_port}"
    connection = http.client.HTTPConnection(here, timeout=60)
    connection.putrequest(method, path, skip_host=True)
    sent = {"Host": here} | ({"Origin": f"http://{here}"} if method == "POST" else {})
    sent |= {} if body is None else {"Content-Length": str(len(body))}
    for name, value in (sent | {name.replace("_", "-"): value for name, value in headers.items()}).items():
        if value is not None:
            connection.putheader(name, value)
    connection.endheaders(body)
    response = connection.getresponse()
    found = response.status, response.headers, response.read()
    connection.close()
    return found


def test_the_page_and_its_parts_are_served(server):
    for path, kind in {"/": "text/html", "/explore.js": "text/javascript", "/explore.css": "text/css"}.items():
        status, headers, body = asked(server, "GET", path)
        assert status == 200 and headers["Content-Type"].startswith(kind) and len(body) > 100
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert not re.search(rb"https?://", body)  # nothing comes from elsewhere
    status, _, body = asked(server, "GET", "/sliders")
    assert status == 200 and json.loads(body)["sliders"][0]["name"] == "stiffness"


def test_a_scan_is_the_reply_of_the_session(server, replied):
    for host in ("127.0.0.1", "localhost"):
        here = f"{host}:{server.server_port}"
        sent = json.dumps(VALUES).encode()
        status, headers, body = asked(server, "POST", "/scan", sent, Host=here, Origin=f"http://{here}")
        assert status == 200 and headers["Content-Type"] == "application/octet-stream"
        assert np.array_equal(unpacked(body)[1]["mz"], replied[1]["mz"])


def test_a_connection_is_kept(server):
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=60)
    connection.request("GET", "/")
    connection.getresponse().read()
    own = connection.sock
    connection.request("GET", "/explore.css")
    assert connection.getresponse().read() and connection.sock is own is not None
    connection.close()


GOOD = json.dumps(VALUES).encode()
REFUSED = {
    "a foreign name": ("GET", "/", None, {"Host": "example.org"}, 403),
    "a foreign name with the port": ("GET", "/", None, {"Host": "example.org:{port}"}, 403),
    "another port": ("GET", "/", None, {"Host": "127.0.0.1:1"}, 403),
    "no host": ("GET", "/", None, {"Host": None}, 403),
    "a scan by a foreign name": ("POST", "/scan", GOOD, {"Host": "example.org:{port}"}, 403),
    "a foreign page": ("POST", "/scan", GOOD, {"Origin": "http://example.org"}, 403),
    "another page of this machine": ("POST", "/scan", GOOD, {"Origin": "http://127.0.0.1:1"}, 403),
    "no page": ("POST", "/scan", GOOD, {"Origin": None}, 403),
    "a page without an origin": ("POST", "/scan", GOOD, {"Origin": "null"}, 403),
    "another path": ("GET", "/session.py", None, {}, 404),
    "a path upwards": ("GET", "/../page.py", None, {}, 404),
    "a scan by GET": ("GET", "/scan", None, {}, 404),
    "another path by POST": ("POST", "/", GOOD, {}, 404),
    "another method": ("PUT", "/scan", GOOD, {}, 501),
    "leave to ask from elsewhere": ("OPTIONS", "/scan", None, {}, 501),
    "no length": ("POST", "/scan", None, {}, 411),
    "a length that is none": ("POST", "/scan", None, {"Content_Length": "-1"}, 411),
    "a long request": ("POST", "/scan", None, {"Content_Length": str(page.LARGEST + 1)}, 413),
    "no JSON": ("POST", "/scan", b"{", {}, 400),
    "no text": ("POST", "/scan", b"\xff\xfe\xfd", {}, 400),
    "a value missing": ("POST", "/scan", b"{}", {}, 400),
    "NaN": ("POST", "/scan", b'{"stiffness": NaN, "distance": 0.2}', {}, 400),
    "beyond the range": ("POST", "/scan", b'{"stiffness": 9, "distance": 0.2}', {}, 400),
}


@pytest.mark.parametrize("name", REFUSED)
def test_all_else_is_refused(name, server):
    method, path, body, headers, expected = REFUSED[name]
    filled = {key: value and value.format(port=server.server_port) for key, value in headers.items()}
    status, found, words = asked(server, method, path, body, **filled)
    assert status == expected
    assert b"Traceback" not in words and "Access-Control-Allow-Origin" not in found
    if name == "beyond the range":
        assert words == b"`stiffness` must be a number from 10 to 500, but is 9."


def test_only_this_machine_is_served(server):
    assert server.server_address[0] == "127.0.0.1"
    with pytest.raises(OSError), socket.create_connection(("127.0.0.2", server.server_port), timeout=5):
        pass


def test_a_closed_session_answers_no_more():
    closed = Session(build, RANGES)
    closed.close()
    with pytest.raises(ValueError, match="closed"):
        closed.answer(VALUES)


def test_outside_of_jupyter_a_page_opens(monkeypatch):
    served = []

    def serve(session):
        served.append(session.sliders[0].name)
        raise KeyboardInterrupt

    monkeypatch.setattr(page, "serve", serve)
    assert jw.explore(build, stiffness=(10, 500)) is None
    assert served == ["stiffness"]


# The widget


def test_the_widget_answers_messages(sliders, replied, monkeypatch):
    pytest.importorskip("anywidget", reason="pip install jaxwhisker[explore]")
    from jaxwhisker._explore.widget import Explorer

    shown, sent = Explorer(sliders), []
    monkeypatch.setattr(shown, "send", lambda content, buffers=None: sent.append((content, buffers)))
    shown._handle_custom_msg({"id": "one", "values": VALUES}, [])
    shown._handle_custom_msg({"id": "two", "values": {}}, [])
    assert sent[0][0] == {"id": "one"}
    assert np.array_equal(unpacked(sent[0][1][0])[1]["mz"], replied[1]["mz"])
    assert sent[1][0]["id"] == "two" and "stiffness" in sent[1][0]["error"]
    assert shown.description == sliders.description
    shown.close()


def test_jupyter_without_anywidget_tells_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "anywidget", None)
    monkeypatch.delitem(sys.modules, "jaxwhisker._explore.widget", raising=False)
    monkeypatch.setattr(sys.modules["jaxwhisker._explore"], "_in_jupyter", lambda: True)
    with pytest.raises(ImportError, match=re.escape("pip install jaxwhisker[explore]")):
        jw.explore(build, stiffness=(10, 500))


# The command


def arguments(*argv):
    from jaxwhisker.cli import _parser

    return _parser().parse_args(["explore", *argv])


def test_the_command_has_a_slider_for_every_parameter():
    _, ranges = command._builder(arguments("--model", "FBFBR"))
    assert ranges == {
        "stiffness": (10.0, 500.0, 70.0),
        "rest_length": (0.0, 0.5, 0.2),
        "distance": (0.05, 0.95, 0.2),
        "a": (0.2, 5.0, 1.0),
    }
    _, ranges = command._builder(arguments("--stiffness", "900", "--distance", "0.1:0.3", "--length", "1:2:1.5"))
    assert ranges["stiffness"] == (10.0, 900.0, 900.0)
    assert (ranges["distance"], ranges["length"]) == ((0.1, 0.3), (1.0, 2.0, 1.5))
    _, ranges = command._builder(arguments("--model", "FBFB", "--stiffness", "70,inf", "--rest-length", "0.1,0:1:0.3"))
    assert {"c1", "l1", "l2"} < set(ranges) and "c2" not in ranges and ranges["l2"] == (0.0, 1.0, 0.3)
    _, ranges = command._builder(arguments("--model", "clamped", "--profile", "ellipse"))
    assert set(ranges) == {"distance", "a", "b"}


def test_its_scenes_are_those_of_the_options():
    made, _ = command._builder(arguments("--model", "FBFB", "--stiffness", "70,inf", "--profile", "circle"))
    found = made(c1=60.0, rest_length=0.1, distance=0.3, radius=2.0)
    expected = jw.Scene(jw.Whisker(), jw.Circle(0.3, 2.0), jw.Support.fbfb((60.0, jnp.inf), 0.1), jw.ClosedForm())
    assert str(found) == str(expected)
    same(jax.tree.map(float, found), jax.tree.map(float, expected))


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["--stiffness=-5:3"], ["`stiffness`", "positive", "-1.0"]),
        (["--stiffness", "500:10"], ["`stiffness`", "low < high"]),
        (["--stiffness", "1:2:3:4"], ["--stiffness", "LOW:HIGH"]),
        (["--stiffness", "soft"], ["--stiffness", "'soft'"]),
        (["--model", "FBFB", "--stiffness", "1,2,3"], ["`stiffness`", "one per spring (2)"]),
        (["--model", "clamped", "--stiffness", "3"], ["--stiffness", "clamped"]),
        (["--radius", "1"], ["--radius", "parabola"]),
        (["--distance", "nan"], ["`distance`", "nan"]),
        (["--port", "70000"], ["--port", "70000"]),
        (["--port", "-1"], ["--port"]),
    ],
)
def test_wrong_options_end_with_one_line_and_exit_code_2(argv, words, capsys):
    assert cli.main(["explore", "--no-browser", *argv]) == cli.USAGE
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith("jaxwhisker")
    assert all(word in err for word in words)


def test_a_taken_port_is_told(server, capsys):
    assert cli.main(["explore", "--no-browser", "--port", str(server.server_port)]) == cli.USAGE
    assert "in use" in capsys.readouterr().err


# As `python -m jaxwhisker`, but that a shell's background jobs, and all that they start, ignore Ctrl-C.
COMMAND = """\
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from jaxwhisker.cli import main
sys.exit(main(["explore", "--no-browser"]))
"""


def test_the_command_serves_until_it_is_interrupted():
    line = [sys.executable, "-c", COMMAND]
    with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            url = process.stdout.readline().split()[0]
            assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", url)
            with urllib.request.urlopen(url, timeout=60) as response:
                assert b"explore.js" in response.read()
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=120)
        finally:
            process.kill()
    assert (process.returncode, err) == (cli.INTERRUPTED, "")
