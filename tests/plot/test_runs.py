"""Figures of simulations: time on the axis, shapes, events, failures."""

# pyright: reportOptionalMemberAccess=false, reportAttributeAccessIssue=false, reportArgumentType=false
# pyright: reportCallIssue=false, reportIndexIssue=false, reportOperatorIssue=false

import jax
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker import plot
from jaxwhisker.plot import drawing, runs
from pictured import failed_motion

ROUNDING = 1e-12
T = 0.5  # unit of time of the simulation
LOST = 60  # sample at which a simulation fails


def curve(ax):
    return np.asarray(ax.get_lines()[0].get_xydata()).T


def test_signals_are_drawn_over_time(motion):
    rows = plot.reactions(motion)
    assert [ax.get_xlabel() for ax in rows] == ["", "", "$t/T$"]
    for ax, name in zip(rows, ("fx", "fy", "mz"), strict=True):
        np.testing.assert_allclose(curve(ax), [motion.time / T, getattr(motion, name)[:, 0]], atol=ROUNDING)
        marked = {float(line.get_xdata()[0]) for line in ax.get_lines()[1:]}
        assert marked == {event.time / T for event in motion.events}
    assert plot.signal(motion, "tip_x").get_ylabel() == "$x_1/L$"
    assert plot.signal(motion, "mz", units="SI").get_xlabel() == "$t$ (ms)"
    np.testing.assert_allclose(curve(plot.signal(motion, "mz", units="SI"))[0], 1000 * motion.time)


def test_an_overview_shows_the_whole_motion(motion):
    page = plot.overview(motion)
    assert page.axes[-1].get_xlabel() == "$t/T$"
    for ax in page.axes[1:]:
        np.testing.assert_allclose(ax.get_xlim(), np.array([0.0, motion.time[-1]]) / T)


def test_times_outside_the_motion_are_rejected(motion):
    with pytest.raises(ValueError, match=r"`at` must be within the times of the simulation, from 0 to 3, got 3\.5"):
        plot.shapes(motion, 3.5)


def test_simulations_are_compared_over_time_and_with_scans_over_the_control(motion, result):
    np.testing.assert_allclose(curve(plot.compare({"a": motion}, "gap"))[0], motion.time / T)
    both = plot.compare({"a": motion, "b": result}, "mz")
    assert both.get_xlabel() == "$u/L$"
    np.testing.assert_allclose(curve(both)[0], motion.control)
    with pytest.raises(ValueError, match=r"`quantity` must be one of .*, got 'gap'"):
        plot.compare({"a": motion, "b": result}, "gap")


def test_shapes_are_those_of_the_samples_nearest_to_times(motion):
    k = 50
    ax = plot.shapes(motion, float(motion.time[k]) + 0.004)
    (whisker,) = [line for line in ax.get_lines() if line.get_label() == "whisker 1"]
    lines = motion.shapes(drawing.LINE_POINTS)
    np.testing.assert_allclose(whisker.get_xydata().T, [lines.x[k, 0], lines.y[k, 0]], atol=ROUNDING)
    np.testing.assert_allclose(whisker.get_xydata()[-1], [motion.tip_x[k, 0], motion.tip_y[k, 0]], atol=ROUNDING)
    (arrow,) = ax.texts
    np.testing.assert_allclose(arrow.xy, [motion.contact_x[k, 0], motion.contact_y[k, 0]])
    assert ax.get_title() == f"$t/T$: {float(motion.time[k]) / T:.3f}"
    assert plot.in_words(motion, float(motion.time[k])) == "1: tangential"


def test_an_impact_does_not_shorten_all_other_forces(motion):
    struck = jax.tree.map(lambda leaf: leaf, motion)
    object.__setattr__(struck, "contact_force", motion.contact_force.at[50].set(1e4))
    assert drawing.largest_force(struck) < 1.5 * drawing.largest_force(motion)


def test_phases_run_over_time(motion):
    ax = plot.phases(motion)
    assert ax.get_xlabel() == "$t/T$"
    touches = [line for line in ax.get_lines() if line.get_marker() == "o"]
    assert {float(line.get_xdata()[0]) for line in touches} == {
        event.time / T for event in motion.events.of(jw.EventKind.touch)
    }


def test_events_have_the_samples_around_them(motion):
    for event, timed in zip(runs.events_of(motion), motion.events, strict=True):
        assert (event.kind, event.whiskers, event.control) == (timed.kind, (timed.whisker,), timed.control)
        after = int(np.searchsorted(motion.time, timed.time))
        assert float(event.before.base_x[0]) == float(motion.base_x[after - 1, 0])
        assert float(event.after.base_x[0]) == float(motion.base_x[after, 0])


def test_failed_samples_leave_gaps_at_known_times(motion):
    lost = failed_motion(motion, LOST)
    time, values = curve(plot.signal(lost, "fx"))
    np.testing.assert_allclose(time, motion.time / T)
    assert np.array_equal(np.isnan(values), np.arange(time.size) >= LOST)
    for draw in (plot.shapes, plot.phases, plot.overview):
        draw(lost)
        draw(failed_motion(motion, 0))


def test_a_free_sensor_has_no_object(motion):
    free = jw.Simulation(
        **{name: getattr(motion, name) for name in jw.Simulation.__dataclass_fields__ if name != "scene"},
        scene=jw.Sensor.of(motion.scene),
    )
    assert not plot.shapes(free, 1.0).patches and plot.shapes(motion, 1.0).patches
    assert str(free.scene) == "FB: 1 whisker, 1 spring, no object"


@pytest.mark.unchecked
def test_a_batch_of_simulations_is_rejected(motion):
    batch = jax.tree.map(lambda leaf: np.stack([leaf, leaf]), motion)
    for draw in (plot.reactions, plot.shapes, lambda run: plot.compare({"a": run}, "fx")):
        with pytest.raises(ValueError, match=r"`result` must be a single simulation, got a batch of shape \(2,\)"):
            draw(batch)
