"""Parabolas, circles, ellipses, graphs and tilted profiles: points, first contact by tip or shaft, scans, errors."""

# pyright: reportArgumentType=false
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from scenes import all_ok, event_list

EXACT = 1e-12
SAME = 1e-8  # two parametrisations of one object


class Curve(eqx.Module):
    """A parabola, a quartic or a dented parabola; graphs of this file."""

    height: float | jax.Array
    bow: float | jax.Array = 1.0
    growth: float | jax.Array = 0.0
    dent: float | jax.Array = 0.0

    def __call__(self, x):
        return self.height + self.bow * x**2 + self.growth * x**4 + self.dent * jnp.exp(-(((x - 0.2) / 0.1) ** 2))


def test_points_lie_on_the_object():
    p = jw.Parabola(0.3, 2.0, 0.4).point(0.8)
    assert abs(p.y - (0.3 + 2.0 * (p.x - 0.4) ** 2)) < EXACT
    c = jw.Circle(0.2, 0.7, -0.1).point(1.1)
    assert abs(np.hypot(c.x + 0.1, c.y - 0.9) - 0.7) < EXACT
    e = jw.Ellipse(0.2, 0.5, 0.9, 1.0).point(1.1)
    assert abs(((e.x - 1.0) / 0.5) ** 2 + ((e.y - 1.1) / 0.9) ** 2 - 1) < EXACT


def test_a_tilted_profile_is_turned_about_its_point():
    profile = jw.Tilted(jw.Circle(0.2, 0.7), 0.3, (0.1, 0.4))
    at = profile.point(0.6)
    np.testing.assert_allclose(jnp.arctan2(at.sin, at.cos), 0.9, atol=EXACT)
    # Turning keeps the distance between the centre of the circle and the fixed point.
    centre = [0.1 - 0.1 * np.cos(0.3) - 0.5 * np.sin(0.3), 0.4 - 0.1 * np.sin(0.3) + 0.5 * np.cos(0.3)]
    assert abs(np.hypot(at.x - centre[0], at.y - centre[1]) - 0.7) < EXACT


def test_a_small_circle_is_first_met_by_the_shaft():
    scene = jw.Scene(jw.Whisker(), jw.Circle(0.3, 0.2), jw.Support.fb(70.0))
    result = jw.scan(scene)
    assert all_ok(result)
    touch = result.events.of(jw.EventKind.touch, 1)[0]
    assert touch.after.phase[0] == jw.Phase.tangential
    assert abs(touch.after.base_x[0] - 0.2) < EXACT
    assert abs(touch.after.contact_arc[0] - 0.5) < EXACT
    assert abs(touch.after.contact_slope[0] - np.pi / 2) < EXACT
    assert [e for e in event_list(result) if e[0] == "tip_to_tangential"] == []
    assert result.control[0] > touch.control


def test_an_ellipse_with_equal_axes_is_a_circle():
    control = np.linspace(0.9, -1.7, 131)
    circle = jw.scan(jw.Scene(jw.Whisker(), jw.Circle(0.3, 1.0), jw.Support.fb(70.0)), control)
    ellipse = jw.scan(jw.Scene(jw.Whisker(), jw.Ellipse(0.3, 1.0, 1.0), jw.Support.fb(70.0)), control)
    for name in ("fx", "fy", "mz"):
        np.testing.assert_allclose(getattr(circle, name), getattr(ellipse, name), atol=SAME)


def test_the_graph_of_a_parabola_is_the_parabola():
    control = np.linspace(0.9, -1.7, 131)
    graph = jw.scan(jw.Scene(jw.Whisker(), jw.Graph(Curve(0.2)), jw.Support.fb(70.0)), control)
    parabola = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(70.0)), control)
    assert all_ok(graph)
    for name in ("fx", "fy", "mz", "base_x"):
        np.testing.assert_allclose(getattr(graph, name), getattr(parabola, name), atol=SAME)
    np.testing.assert_allclose([e[2] for e in event_list(graph)], [e[2] for e in event_list(parabola)], atol=SAME)


def test_a_graph_may_end_like_a_semicircle():
    control = np.linspace(0.9, -1.6, 101)
    half = jw.Graph(lambda x: 1.3 - jnp.sqrt(1.0 - x**2))
    graph = jw.scan(jw.Scene(jw.Whisker(), half, jw.Support.fb(70.0)), control)
    circle = jw.scan(jw.Scene(jw.Whisker(), jw.Circle(0.3, 1.0), jw.Support.fb(70.0)), control)
    assert all_ok(graph)
    np.testing.assert_allclose(graph.fy, circle.fy, atol=SAME)


def test_a_graph_in_other_units():
    control = np.linspace(0.9, -1.5, 25)
    one = jw.scan(jw.Scene(jw.Whisker(), jw.Graph(Curve(0.2)), jw.Support.fb(70.0)), control)
    stretched = jw.Scene(jw.Whisker(10.0), jw.Graph(Curve(2.0, 0.1)), jw.Support.fb(0.07, 2.0))
    ten = jw.scan(stretched, 10 * control)
    np.testing.assert_allclose(np.asarray(ten.fy) * 100, one.fy, atol=SAME)


def test_a_graph_with_parameters_goes_through_vmap():
    def peak(growth):
        scene = jw.Scene(jw.Whisker(), jw.Graph(Curve(0.2, growth=growth)), jw.Support.fb(70.0))
        return jnp.max(jw.scan(scene, jnp.linspace(0.8, -1.5, 64)).fy)

    peaks = jax.vmap(peak)(jnp.array([0.0, 0.5, 1.0]))
    assert np.all(np.isfinite(peaks)) and np.ptp(peaks) > 1e-3


def test_a_graph_that_is_not_convex_is_reported():
    dented = jw.Graph(Curve(0.2, dent=0.1))
    result = jw.scan(jw.Scene(jw.Whisker(), dented, jw.Support.fb(70.0)), np.linspace(0.8, -1.5, 100))
    assert jw.Status.not_convex in np.asarray(result.status)
    bad = np.asarray(result.status) != jw.Status.ok
    assert np.all(np.isnan(np.asarray(result.fx)[bad]))
    assert np.all(np.isfinite(np.asarray(result.fx)[~bad]))


def test_traced_parameters_out_of_their_domain_are_invalid():
    valid = jax.jit(lambda q, r: jw.Circle(q, r).valid())
    assert valid(0.2, 1.0)
    assert not valid(0.0, 1.0) and not valid(0.2, -1.0) and not valid(jnp.nan, 1.0) and not valid(0.2, jnp.inf)
    tilted = jax.jit(lambda angle: jw.Tilted(jw.Parabola(0.2), angle).valid())
    assert tilted(1.0) and not tilted(2.0)


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: jw.Graph(3.0),
            "`g` must be a function that is called with one number and returns one number, got 3.0",
        ),
        (lambda: jw.Graph(lambda x: x**2 if x > 0 else -x), "`g` must be a function that JAX can trace, got <lambda>"),
        (lambda: jw.Graph(lambda x: np.interp(x, [0, 1], [1, 2])), "`g` .* jnp.interp instead of np.interp"),
        (lambda: jw.Graph(math.exp), "`g` must be a function that JAX can trace, got exp"),
        (lambda: jw.Graph(lambda: 1.0), r"`g` must be a function that is called with one number .*, got <lambda>\(\)"),
        (lambda: jw.Graph(lambda x: jnp.stack([x, x])), r"`g` .* returns one number, got .* of shape \(2,\)"),
        (lambda: jw.Graph(lambda x: x > 0), r"`g` .* returns one number, got .* of shape \(\) and type bool"),
        (lambda: jw.Graph(lambda x: None), "`g` .* returns one number, got .* a value of type NoneType"),
        (lambda: jw.Graph(lambda x: x**2, extent=np.nan), "`extent` must be a positive finite number, got nan"),
        (lambda: jw.Tilted(0.3, 0.1), "`profile` must be a profile such as Parabola or Graph, got 0.3"),
        (lambda: jw.Tilted(jw.Parabola(0.2), 2.0), "`angle` must be less than a right angle, got 2 rad"),
        (lambda: jw.Tilted(jw.Parabola(0.2), 0.1, 3.0), "`about` must be a pair of numbers, got 3.0"),
        (lambda: jw.Tilted(jw.Parabola(0.2), 0.1, (0.0, np.inf)), r"`about\[1\]` must be a finite number, got inf"),
    ],
)
def test_wrong_profiles(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_the_unit_of_a_graph_is_internal():
    with pytest.raises(TypeError, match="unit"):
        jw.Graph(lambda x: 0.2 + x**2, unit=np.nan)  # pyright: ignore[reportCallIssue]


def test_a_point_of_a_graph_faces_itself():
    graph = jw.Graph(Curve(0.2), 0.3)
    for profile in (graph, jw.Tilted(graph, 0.4, (0.1, -0.2))):
        at = profile.point(jnp.asarray(0.7))
        assert profile.facing(at.x, at.y) == pytest.approx(0.7, abs=EXACT)
    assert jw.Tilted(jw.Circle(0.3, 0.5), 0.4).facing(jnp.asarray(0.1), jnp.asarray(0.1)) is None
