"""Scans that films of several tests show."""

import pytest

import jaxwhisker as jw
from jaxwhisker.film.frames import frames
from pictured import FILM_STEPS, past_ball, swept


def scanned(stiffness, length=1.0, bending_stiffness=1.0):
    unit = bending_stiffness / length**3
    return jw.scan(
        jw.Scene(
            jw.Whisker(length, bending_stiffness),
            jw.Parabola(0.2 * length, 1.0 / length),
            jw.Support.fb(stiffness * unit, 0.2 * length),
            rod=jw.ClosedForm(),
        )
    )


@pytest.fixture(scope="session")
def in_space():
    """A scan in space, in SI units."""
    return past_ball()


@pytest.fixture(scope="session")
def motion():
    """A simulation: touches, bounces, slides along the object and is released."""
    return swept()


@pytest.fixture(scope="session")
def soft():
    """Snaps through twice, the second time to the far side, where it is released."""
    return scanned(10.0)


@pytest.fixture(scope="session")
def soft_in_si():
    """The same scan in SI units; EI/L^2 = 1.2 mN, EI/L = 60 mN mm."""
    return scanned(10.0, 0.05, 3e-6)


@pytest.fixture(scope="session")
def stiff():
    """Snaps off."""
    return scanned(70.0)


@pytest.fixture(scope="session")
def film_of_soft(soft):
    return frames(soft, FILM_STEPS)
