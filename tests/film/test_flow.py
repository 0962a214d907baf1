"""Flow of the bases during a snap."""

import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker.film.flow import flows
from jaxwhisker.film.frames import SWINGS, lines_of
from pictured import ends_moved, row, snaps

SOLVED = 1e-9  # accuracy of Newton's method for poses and contacts of the flow
INTEGRATED = 1e-7  # accuracy of centre lines, which are integrated from base to contact
SETTLED = 0.02  # lengths: the flow ends this close to where the march's Newton method takes over
ONE_STEP = 0.03  # lengths by which contacts and bases differ between two states


@pytest.fixture(scope="module")
def flows_of_soft(soft):
    """Event, states of the flow and centre lines of both snaps."""
    numbers = snaps(soft)
    states = flows(soft, numbers)
    events = [soft.events[k] for k in numbers]
    controls = [np.full(group.phase.shape[0], event.control) for group, event in zip(states, events, strict=True)]
    return list(zip(events, states, lines_of(soft.scene, states, controls), strict=True))


def test_the_flow_passes_equilibria_of_whiskers_whose_bases_are_held(flows_of_soft):
    kinds = []
    for event, flow, lines in flows_of_soft:
        touching = flow.phase[:, 0] != jw.Phase.free
        kinds.append(touching.all())
        # Bases are upright at height 0; the whisker bent by the reaction ends at a point of the object.
        np.testing.assert_allclose(flow.base_y, 0.0, atol=SOLVED)
        np.testing.assert_allclose(flow.base_angle, 0.0, atol=SOLVED)
        at, lines = row((flow, lines), touching)
        np.testing.assert_allclose(at.contact_y, 0.2 + at.contact_x**2, atol=SOLVED)
        end = np.arange(len(at.phase)), 0, np.where(at.phase[:, 0] == jw.Phase.tip, -1, -2)
        np.testing.assert_allclose(lines.x[end], at.contact_x[:, 0], atol=INTEGRATED)
        np.testing.assert_allclose(lines.y[end], at.contact_y[:, 0], atol=INTEGRATED)
        # The spring is not in balance with the whisker, which moves the base.
        assert np.abs(10.0 * (flow.base_x[:, 0] - event.control - 0.2) + flow.fx[:, 0]).max() > 0.5
        for place, state in ((0, event.before), (-1, event.after)):
            np.testing.assert_allclose(flow.base_x[place], state.base_x, atol=SETTLED)
            assert np.array_equal(flow.phase[place], state.phase)
    # The first keeps its contact; the second swings free and touches again from the other side, bent the other way.
    assert kinds == [True, False]
    assert flow.mz[0, 0] > 0 > flow.mz[-1, 0]


def test_whiskers_move_steadily_unless_they_release_or_touch(flows_of_soft):
    for _, flow, lines in flows_of_soft:
        stays = (np.diff(flow.phase[:, 0]) == 0) & (flow.phase[1:, 0] != jw.Phase.free)
        assert ends_moved(lines)[stays].max() < SWINGS
        assert np.abs(np.diff(flow.contact_x[:, 0])[stays]).max() < ONE_STEP


def test_a_scan_without_snaps_has_no_flow(stiff):
    assert flows(stiff, []) == []
