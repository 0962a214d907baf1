"""Valleys of gaps along shafts over waves: found wherever they are, also beside a crest in the same cell."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
import several_laws as laws
from jaxwhisker._chain.shaft import WholeShaft
from jaxwhisker._chain.valleys import gap_facing, lowest_valley
from random_several import Drawn, checked
from several_cases import Wave

CELLS = 12
PLACE = 2e-3  # lengths: a cubic between two samples, half a wave apart, in place of a cosine
LEVEL = 0.02  # wavelengths: the same, of gaps
SOLVED = 1e-7  # laws of scans, as in tests/physics/test_several_contacts.py


def straight(lean: float, starts: int = -1) -> WholeShaft:
    """A straight shaft from (1, 0), its tip, to the left; it has no contact, or a tangential one at the tip."""
    beyond = jnp.linspace(0.0, 1.0, CELLS + 1)[None]
    cos, sin = jnp.full_like(beyond, np.cos(lean)), jnp.full_like(beyond, np.sin(lean))
    x, y = 1 - beyond * cos, -beyond * sin
    return WholeShaft(beyond, x, y, cos, sin, 0 * beyond, jnp.asarray([starts]), jnp.asarray([-1]))


def found(wave: Wave, shaft: WholeShaft):
    """The arc length from the tip to the lowest valley, and whether there is one."""
    along = gap_facing(jw.Graph(wave), shaft)
    assert along is not None
    valley = lowest_valley(along, CELLS, shaft.starts == 0, shaft.ends == 0)
    return float(valley.index + valley.share) / CELLS, bool(valley.some)


def minima(wave: Wave, lean: float) -> tuple[np.ndarray, np.ndarray]:
    """Arc lengths of all minima, and the gaps there, by dense sampling."""
    s = np.linspace(0.0, 1.0, 200_001)
    x, y = 1 - s * np.cos(lean), -s * np.sin(lean)
    height, slope = jax.vmap(jax.value_and_grad(wave))(jnp.asarray(x))
    gap = (np.asarray(height) - y) / np.sqrt(1 + np.asarray(slope) ** 2)
    k = 1 + np.flatnonzero((gap[1:-1] < gap[:-2]) & (gap[1:-1] < gap[2:]))
    return s[k], gap[k]


@pytest.mark.parametrize("wavelength", [0.05, 0.07, 0.11, 0.3])
def test_valleys_over_waves(wavelength):
    for lean in (-0.1, 0.03, 0.2):
        wave = Wave(0.5, 0.1 * wavelength, wavelength, 0.5)
        place, some = found(wave, straight(lean))
        places, gaps = minima(wave, lean)
        nearest = np.argmin(np.abs(places - place))
        assert some and abs(places[nearest] - place) < PLACE
        assert gaps[nearest] < np.min(gaps) + LEVEL * wavelength


def test_no_valley_over_a_slope_or_beside_the_contact_at_which_the_shaft_starts():
    parabola = Wave(0.0, 0.0, 1.0, 0.5)
    # The tangent of the parabola at its point above the tip.
    contact = float(jnp.arctan(1.0))
    assert not found(parabola, straight(-0.1))[1]
    assert not found(parabola, straight(contact, starts=0)._replace(y=straight(contact).y + 0.5))[1]


# Crests are missed in the first four without samples within steps. In the last one, events follow soon after jumps.
@pytest.mark.parametrize(
    "numbers",
    [
        (0.48, -0.04, 0.2, 0.5),
        (0.42, -0.01, 0.1, 0.25),
        (0.416, -0.008, 0.08, 0.5),
        (0.43, 0.05, 0.25, 0.5),
        (0.412, -0.006, 0.06, 0.5),
    ],
)
def test_scans_over_textures(numbers):
    scene = jw.Scene(jw.Whisker(), jw.Graph(Wave(*numbers)), contacts=2)
    control = np.linspace(1.6, -1.8, 120)
    result = jw.scan(scene, control)
    assert np.all(np.asarray(result.status) == jw.Status.ok)
    plain = laws.Plain((laws.Rod(),), (laws.wave(*numbers),), ())
    assert max(value for *_, value in checked(Drawn(scene, plain, control), result, every=10)) < SOLVED
