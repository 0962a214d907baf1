"""Fits of a scene's parameters: what is compiled for another `build`, and functions without a hash."""

import pytest

import jaxwhisker as jw
from jaxwhisker._base.program import Program
from recordings import CONTROL, TRUTH, exact, fb


def test_another_build_compiles_nothing_but_itself(monkeypatch):
    data = exact(fb(**TRUTH))
    jw.identify(fb, TRUTH, data, starts=0)
    compiled = []
    compile_one = Program._compile

    def counted(self, *args):
        compiled.append(self.__name__)
        return compile_one(self, *args)

    monkeypatch.setattr(Program, "_compile", counted)
    monkeypatch.setenv("JAXWHISKER_CACHE", "off")
    # Another function, one more parameter, offsets, and fewer samples.
    fit = jw.identify(
        lambda rest, c, q: jw.Scene(jw.Whisker(), jw.Parabola(q), jw.Support.fb(c, rest)),
        {"rest": 0.2, **TRUTH},
        {name: values[::2] for name, values in data.items()},
        offsets=True,
        starts=0,
    )
    assert fit.measured.control.size == CONTROL.size // 2
    assert compiled == ["_scene_and_slopes"]


def test_functions_without_a_hash_are_fitted():
    class Build:
        __hash__ = None  # pyright: ignore[reportAssignmentType]

        def __call__(self, c, q):
            return fb(c, q)

    fit = jw.identify(Build(), TRUTH, exact(fb(**TRUTH)), starts=0)
    assert fit.estimates == pytest.approx(TRUTH)
