"""Silhouettes of objects: cut off far out, up to their ends, or all around."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._model.silhouette import CONTOUR_POINTS, CUT_OFF, behind, silhouette_of

ROUNDING = 1e-9  # of lengths: ends come from bisection
SEMICIRCLE = jw.Graph(lambda x: 0.9 - jnp.sqrt(0.49 - x**2))


@pytest.mark.parametrize("length", [1.0, 20.0])
@pytest.mark.parametrize(
    "profile", [jw.Parabola(0.2, 2.0, 0.4), jw.Graph(lambda x: 0.2 + 2 * x**2, 0.4), jw.Graph(jnp.cosh, 0.4)]
)
def test_an_open_object_is_cut_off(profile, length):
    x, y = silhouette_of(profile, length)
    assert x.size == CONTOUR_POINTS and (np.diff(x) > 0).all()
    np.testing.assert_allclose(x[[0, -1]], 0.4 + CUT_OFF * length * np.array([-1.0, 1.0]), rtol=ROUNDING)
    if not isinstance(profile, jw.Graph):
        np.testing.assert_allclose(y, 0.2 + 2 * (x - 0.4) ** 2, rtol=ROUNDING)


def test_a_graph_is_drawn_up_to_where_it_ends():
    x, y = silhouette_of(SEMICIRCLE, 1.0)
    assert x.size >= CONTOUR_POINTS - 2  # rounding may exclude its very ends
    np.testing.assert_allclose(x[[0, -1]], (-0.7, 0.7), atol=0.01)
    np.testing.assert_allclose(np.hypot(x, y - 0.9), 0.7, atol=ROUNDING)


@pytest.mark.parametrize("turned", [False, True])
def test_a_closed_object_is_drawn_all_around_or_along_its_lower_side(turned):
    profile = jw.Circle(0.2, 0.7, -0.1)
    centre = np.array([-0.1, 0.9])
    if turned:
        profile, angle = jw.Tilted(profile, 0.3), 0.3
        centre = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ centre
    x, y = silhouette_of(profile, 1.0)
    np.testing.assert_allclose(np.hypot(x - centre[0], y - centre[1]), 0.7, atol=ROUNDING)
    assert np.hypot(x[0] - x[-1], y[0] - y[-1]) < ROUNDING and y.max() > centre[1] + 0.69
    x, y = silhouette_of(profile, 1.0, whole=False)
    half = np.hypot(x[0] - x[-1], y[0] - y[-1])
    assert half == pytest.approx(1.4, abs=1e-5)
    assert y.max() < centre[1] + 0.7 * np.sin(0.3) + ROUNDING


def test_a_contour_is_drawn_up_to_its_upright_ends():
    contour = jw.Contour.like(jw.Circle(0.2, 0.7), np.linspace(-1.0, 1.0, 5))
    x, y = silhouette_of(contour, 1.0)
    np.testing.assert_allclose(np.hypot(x, y - 0.9), 0.7, atol=1e-6)
    np.testing.assert_allclose(x[[0, -1]], (-0.7, 0.7), atol=1e-6)


def test_objects_of_one_kind_share_a_program():
    from jaxwhisker._model import silhouette

    silhouette_of(jw.Parabola(0.2), 1.0)
    programs = silhouette._silhouette.compilations
    silhouette_of(jw.Parabola(0.7, 3.0), 2.0)
    assert silhouette._silhouette.compilations == programs


def test_a_contour_that_is_not_convex_is_closed_behind_it():
    x, y = silhouette_of(jw.Parabola(0.2), 1.0)
    assert behind(x, y).shape == (0, 2)
    wave = np.stack([x, np.cos(6 * x) + x / 2], axis=1)
    last, first = behind(*wave.T)
    np.testing.assert_allclose(last - first, wave[-1] - wave[0], atol=ROUNDING)
    inwards = np.array([wave[0, 1] - wave[-1, 1], wave[-1, 0] - wave[0, 0]])
    np.testing.assert_allclose(np.max(wave @ inwards), first @ inwards, rtol=ROUNDING)
