"""Contacts in pictures of scans in space with several contacts."""

# pyright: reportOptionalOperand=false, reportAttributeAccessIssue=false

import numpy as np
import pytest

import jaxwhisker as jw
import pegs
from jaxwhisker import plot
from jaxwhisker._scan.state import state_of
from jaxwhisker.film.canvas import Canvas
from jaxwhisker.film.space import frames_in_space
from jaxwhisker.plot.contacts_in_space import pushes_of, ways_of
from jaxwhisker.plot.space import drawings, whisker_of_contacts

BALANCE = 1e-6  # of forces: errors of rods with eight steps a segment
GONE = np.full(3, np.nan)


@pytest.fixture(scope="module")
def tilted():
    return pegs.scan(pegs.TILTED)


@pytest.fixture(scope="module")
def both(tilted):
    """A step with two contacts."""
    return int(np.flatnonzero(np.sum(np.asarray(tilted.phase)[:, 0] != 0, axis=1) == 2)[1])


def test_the_forces_of_all_contacts_balance_the_reaction(tilted):
    pushes = pushes_of(tilted.scene, state_of(tilted))
    ok = np.asarray(tilted.status) == 0
    reaction = np.stack([tilted.fx, tilted.fy, tilted.fz], axis=-1)[:, 0]
    np.testing.assert_allclose(pushes.sum(axis=1)[ok], -reaction[ok], atol=BALANCE)
    assert np.max(np.abs(reaction[ok])) > 1.0


def test_figures_have_an_arrow_and_a_dot_for_each_contact(tilted, both):
    drawn = drawings(tilted, np.array([both]))
    assert drawn.forces.shape == (1, 2, 2, 3) and whisker_of_contacts(drawn) == [0, 0]
    for k in range(2):
        contact = [float(np.asarray(getattr(tilted, f"contact_{axis}"))[both, 0, k]) for axis in "xyz"]
        np.testing.assert_allclose(drawn.contacts[0, k], contact)
        np.testing.assert_allclose(drawn.forces[0, k, 1], contact)
    small, large = np.sort(np.linalg.norm(np.diff(drawn.forces[0], axis=1)[:, 0], axis=1))
    assert 0 < small < large
    ax = plot.shapes(tilted, [float(tilted.control[both])], view="xy")
    arrows = [patch for patch in ax.patches if type(patch).__name__ == "FancyArrowPatch"]
    assert len(arrows) == 5  # of two forces and three directors


def test_each_contact_goes_on_in_its_own_way():
    a, b = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    contacts = np.array([[a, GONE], [1.1 * a, GONE], [b, 1.2 * a], [1.1 * b, 1.3 * a], [1.2 * b, GONE], [GONE, GONE]])
    ways = ways_of(contacts, 1)
    np.testing.assert_allclose(ways[:, 0], [a, 1.1 * a, 1.2 * a, 1.3 * a, GONE, GONE])
    np.testing.assert_allclose(ways[:, 1], [GONE, GONE, b, 1.1 * b, 1.2 * b, GONE])
    np.testing.assert_array_equal(ways_of(contacts, 2), contacts)  # of two whiskers, with one contact each


def test_rings_of_films_mark_the_contact_of_an_event(tilted):
    shown, marks = frames_in_space(tilted, tilted.control.size)
    canvas = Canvas(tilted, shown, marks, fps=25, width=320, view="xy")
    mark = next(mark for mark in marks if mark.event.kind.name == "touch" and mark.first > 5)
    canvas.image(mark.first)
    event = mark.event
    (circle,) = canvas.captions._rings[1][0].artists
    state, k = event.after, event.contact - 1
    drawn = np.ravel(circle.get_data())
    np.testing.assert_allclose(drawn, [state.contact_x[0, k], state.contact_y[0, k]], atol=0.02)
    assert circle.get_visible()
    assert len(canvas.stage._parts._contacts) == 2


def test_strain_has_a_map(tilted):
    ax = plot.strain(tilted, 0.01)
    assert ax.get_title().startswith("largest strain: 0.0")
    with pytest.raises(ValueError, match="`scene` must be one with convex objects and rings, to be drawn"):
        plot.scene(jw.Scene(jw.Whisker(), jw.Surface(lambda x: 0.5 - x[1], (0.0, 1.0, 0.0), convex=False), contacts=2))
