"""The command `explore`: options, sliders, error messages, Ctrl-C."""

import re
import signal
import subprocess
import sys
import urllib.request

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker import cli
from jaxwhisker._explore.hosts import served
from jaxwhisker._explore.session import Session
from jaxwhisker.cli import explore as command


def arguments(*argv):
    from jaxwhisker.cli import _parser

    return _parser().parse_args(["explore", *argv])


def test_sliders_and_their_ranges_follow_the_options():
    _, ranges = command._sliders(arguments("--model", "FBFBR"))
    assert ranges == {
        "stiffness": (10.0, 500.0, 70.0),
        "rest_length": (0.0, 0.5, 0.2),
        "distance": (0.05, 0.95, 0.2),
        "a": (0.2, 5.0, 1.0),
    }
    _, ranges = command._sliders(arguments("--stiffness", "900", "--distance", "0.1:0.3", "--length", "1:2:1.5"))
    assert ranges["stiffness"] == (2.963, 900.0, 900.0)  # from 10 EI/L^3
    assert (ranges["distance"], ranges["length"]) == ((0.1, 0.3), (1.0, 2.0, 1.5))
    _, ranges = command._sliders(arguments("--model", "FBFB", "--length", "0.08", "--bending-stiffness", "6.4e-4"))
    expected = {"stiffness": (12.5, 625.0, 87.5), "rest_length": (0.0, 0.04, 0.016), "distance": (0.004, 0.076, 0.016)}
    assert ranges == {name: pytest.approx(limits) for name, limits in (expected | {"a": (2.5, 62.5, 12.5)}).items()}
    _, ranges = command._sliders(arguments("--model", "FBFB", "--stiffness", "70,inf", "--rest-length", "0.1,0:1:0.3"))
    assert {"c1", "l1", "l2"} < set(ranges) and "c2" not in ranges and ranges["l2"] == (0.0, 1.0, 0.3)
    _, ranges = command._sliders(arguments("--model", "clamped", "--profile", "ellipse"))
    assert set(ranges) == {"distance", "a", "b"}


def test_parameters_have_the_kinds_of_the_options():
    kinds = command._kinds(arguments("--model", "FBFB", "--profile", "ellipse"), ("a", "c2", "l1", "length"))
    assert kinds == {"a": "length", "c2": "stiffness", "l1": "length"}
    assert command._kinds(arguments("--model", "clamped"), ("a",)) == {"a": "curvature"}


def test_scenes_are_those_of_the_options():
    build, _ = command._sliders(arguments("--model", "FBFB", "--stiffness", "70,inf", "--profile", "circle"))
    scene = build(c1=60.0, rest_length=0.1, distance=0.3, radius=2.0)
    expected = jw.Scene(jw.Whisker(), jw.Circle(0.3, 2.0), jw.Support.fbfb((60.0, jnp.inf), 0.1), jw.ClosedForm())
    assert str(scene) == str(expected)
    leaves = (jax.tree.leaves(jax.tree.map(float, each)) for each in (scene, expected))
    assert all(np.array_equal(one, other) for one, other in zip(*leaves, strict=True))


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
def test_wrong_options_end_with_one_line_and_exit_code_2(argv, words, refuses):
    refuses(["explore", "--no-browser", *argv], words)


def test_a_port_in_use_is_reported_on_one_line(capsys):
    def build(stiffness):
        return jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(stiffness))

    with served(Session(build, {"stiffness": (10, 500)})) as url:
        port = re.findall(r"\d+", url)[-1]
        assert cli.main(["explore", "--no-browser", "--port", port]) == cli.USAGE
    err = capsys.readouterr().err
    assert "in use" in err and err.count("\n") == 1


@pytest.mark.parametrize("package", ["tornado.web", "anywidget"])
def test_a_missing_package_is_reported_on_one_line_with_its_extra(package, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delitem(sys.modules, "jaxwhisker._explore.hosts")
    assert cli.main(["explore", "--no-browser"]) == cli.USAGE
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "pip install 'jaxwhisker[explore]'" in err


# Like `python -m jaxwhisker`, which would ignore Ctrl-C if a shell ran the tests in the background.
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
            found = re.search(r"http://127\.0\.0\.1:\d+/", process.stdout.readline())
            assert found is not None
            with urllib.request.urlopen(found[0], timeout=60) as response:
                assert b"explore.js" in response.read()
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=120)
        finally:
            process.kill()
    assert (process.returncode, err) == (cli.INTERRUPTED, "")
