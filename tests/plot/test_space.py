"""Figures of scenes and scans in space."""

# pyright: reportIndexIssue=false, reportCallIssue=false, reportArgumentType=false

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportOptionalMemberAccess=false

import dataclasses

import numpy as np
import pytest
from matplotlib import pyplot
from mpl_toolkits.mplot3d import Axes3D

import jaxwhisker as jw
from jaxwhisker import plot
from jaxwhisker._scan.space import problem_now
from jaxwhisker.plot import space
from pictured import LENGTH

MM = 1e3  # figures of this scene are in mm
ROUNDING = 1e-9  # of lengths in mm
AT = [0.02, -0.01]


def whiskers_of(ax):
    """The last whisker's line, which the object hides in part."""
    return [line for line in ax.get_lines() if line.get_label() == "whisker 1"]


def arrows_of(ax):
    return [patch for patch in ax.patches if type(patch).__name__ in ("FancyArrowPatch", "_SpaceArrow")]


@pytest.mark.parametrize(("view", "axes"), [("xy", "xy"), ("xz", "xz"), ("yz", "zy")])
def test_projections_show_the_whiskers_of_the_nearest_steps(in_space, view, axes):
    ax = plot.shapes(in_space, AT, view=view)
    assert not isinstance(ax, Axes3D)
    assert (ax.get_xlabel(), ax.get_ylabel()) == tuple(f"${name}$ (mm)" for name in axes)
    lines = jw.shapes(in_space, AT)
    exact = [[MM * np.asarray(getattr(lines, name))[k, 0] for name in axes] for k in range(2)]
    drawn = [np.asarray(line.get_data(orig=True), dtype=float) for line in ax.get_lines()]
    # The line as a whole lies below its visible part.
    for one in exact:
        assert any(data.shape == (2, 64) and np.allclose(data, one, atol=ROUNDING) for data in drawn)
    (seen,) = whiskers_of(ax)
    visible = np.isfinite(seen.get_xdata())
    np.testing.assert_allclose(seen.get_xydata()[visible].T, np.array(exact[1])[:, visible], atol=ROUNDING)
    for line in exact:
        assert np.all((line[0] > ax.get_xlim()[0]) & (line[0] < ax.get_xlim()[1]))
        assert np.all((line[1] > ax.get_ylim()[0]) & (line[1] < ax.get_ylim()[1]))
    assert ax.get_title() == "$u$ (mm): 20, \N{MINUS SIGN}10"
    assert ax.patches[0].get_xy().max() < max(ax.get_ylim()[1], ax.get_xlim()[1])  # the ball is whole


def test_a_camera_shows_whiskers_contacts_directors_and_forces(in_space):
    ax = plot.shapes(in_space, AT)
    assert isinstance(ax, Axes3D) and ax.get_zlabel() == "$z$ (mm)"
    lines = jw.shapes(in_space, AT)
    (seen,) = whiskers_of(ax)
    own = [MM * np.asarray(line)[1, 0] for line in (lines.x, lines.y, lines.z)]
    np.testing.assert_allclose(seen.get_data_3d(), own, atol=ROUNDING)
    step = int(np.argmin(np.abs(in_space.control - AT[1])))
    contact = MM * np.array([getattr(in_space, f"contact_{axis}")[step, 0] for axis in "xyz"])
    *directors, force = arrows_of(ax)
    push = -np.asarray(in_space.force)[step, 0]
    np.testing.assert_allclose(force.ends[1], contact, atol=ROUNDING)
    np.testing.assert_allclose(np.cross(force.ends[1] - force.ends[0], push), 0.0, atol=1e-6)
    assert (force.ends[1] - force.ends[0]) @ push > 0
    for k, arrow in enumerate(directors):
        along = arrow.ends[1] - arrow.ends[0]
        np.testing.assert_allclose(along / np.linalg.norm(along), in_space.base_rotation[step, 0, :, k], atol=1e-9)
    # The dotted line is the way of the contact, NaN where the whisker is free.
    (way,) = [line for line in ax.get_lines() if line.get_linestyle() == ":" and line.get_alpha() is None]
    touching = np.asarray(in_space.phase)[:, 0] > 0
    np.testing.assert_array_equal(np.isfinite(way.get_data_3d()[0]), touching)
    np.testing.assert_allclose(way.get_data_3d()[2][touching], MM * in_space.contact_z[touching, 0], atol=ROUNDING)
    words = {text.get_text() for text in ax.texts}
    assert words <= {"$d_1$", "$d_2$", "$d_3$"} and len(words) >= 2


def test_figures_use_given_axes_and_units(in_space):
    plain, solid = pyplot.figure().add_subplot(), pyplot.figure().add_subplot(projection="3d")
    assert plot.shapes(in_space, 0.0, units="dimensionless", ax=plain) is plain
    assert plain.get_xlabel() == "$x/L$" and plain.get_ylabel() == "$y/L$"
    assert plot.scene(in_space.scene, ax=solid) is solid
    with pytest.raises(ValueError, match="`ax` must be plain Axes for a projection"):
        plot.shapes(in_space, view="xz", ax=solid)
    with pytest.raises(ValueError, match=r"`view` must be one of xy, xz, yz, or .* got 'above'"):
        plot.scene(in_space.scene, view="above")
    with pytest.raises(ValueError, match="`view` must be None in the plane, got 'xy'"):
        plot.scene(jw.Scene(jw.Whisker(), jw.Parabola(0.2)), view="xy")


def test_a_scene_is_drawn_just_before_the_touch(in_space):
    ax = plot.scene(in_space.scene, view="xy")
    (whisker,) = whiskers_of(ax)
    touch = MM * in_space.events[0].control
    assert touch < whisker.get_xdata()[0] < touch + 0.01 * MM * LENGTH
    (whole,) = [line for line in ax.get_lines() if np.size(line.get_ydata()) == 64 and line is not whisker]
    np.testing.assert_allclose(whole.get_ydata()[[0, -1]], [0.0, MM * LENGTH], atol=ROUNDING)


def test_a_whisker_that_meets_nothing_is_drawn_beside_the_object():
    scene = jw.Scene(jw.Whisker(), jw.Sphere(0.2, (0.3, 3.0, 0.0)))
    assert space._start_of(problem_now(scene)) == pytest.approx(0.3, abs=0.05)


def test_springs_are_zigzags_along_their_axes_and_coils_about_them():
    support = jw.Support.follicle(x=80.0, z=90.0, phi_x=5.0, phi=7.0)
    scene = jw.Scene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.2)), support)
    drawn = space.drawing(scene, np.asarray(0.4), space.rest_state(scene, 0.4))
    assert [spring.axis for spring in support.springs] == ["x", "phi", "z", "phi_x"]
    for line, axis, turns in zip(drawn.springs, (0, 2, 2, 0), (False, True, False, True), strict=True):
        extent = np.ptp(line, axis=0)
        assert int(np.argmin(extent) if turns else np.argmax(extent)) == axis
        np.testing.assert_allclose((line[0] if turns else line[-1]), [0.4, 0.0, 0.0], atol=ROUNDING)
    assert np.isnan(drawn.contacts).all() and np.isnan(drawn.forces).all()
    np.testing.assert_allclose(drawn.scaled(3.0).whiskers, 3.0 * drawn.whiskers)
    np.testing.assert_allclose(drawn.scaled(3.0).directors, drawn.directors)


def with_friction(result):
    """The same scan, as if there were friction."""
    scene = jw.Scene(result.scene.whisker, result.scene.surface, result.scene.support, friction=0.3)
    parts = {"normal_force": result.contact_force, **{f"friction_{axis}": result.fx for axis in "xyz"}}
    return dataclasses.replace(result, slip=result.phase, scene=scene, **parts)


def test_reactions_are_six_signals_with_events(in_space):
    axes = plot.reactions(in_space)
    units = ["(mN)"] * 3 + ["(mN mm)"] * 3
    names = ("f_x", "f_y", "f_z", "m_x", "m_y", "m_z")
    assert [ax.get_ylabel() for ax in axes] == [f"${name}$ {unit}" for name, unit in zip(names, units, strict=True)]
    for ax, name, size in zip(axes, ("fx", "fy", "fz", "mx", "my", "mz"), [1e3] * 3 + [1e6] * 3, strict=True):
        curve, *events = ax.get_lines()
        np.testing.assert_allclose(curve.get_ydata(), size * np.asarray(getattr(in_space, name))[:, 0], atol=ROUNDING)
        np.testing.assert_allclose(curve.get_xdata(), MM * np.asarray(in_space.control), atol=ROUNDING)
        assert [line.get_xdata()[0] for line in events] == [MM * event.control for event in in_space.events]
    assert [bool(ax.get_xlabel()) for ax in axes] == [False, False, True] * 2
    places = [ax.get_subplotspec() for ax in axes]
    assert [(place.rowspan.start, place.colspan.start) for place in places] == [
        (0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1)
    ]  # fmt: skip
    with pytest.raises(ValueError, match="`axs` must be 6 Axes, got 3"):
        plot.reactions(in_space, axs=axes[:3])


def test_an_overview_shows_a_state_six_reactions_friction_and_springs(in_space):
    state, *signals = plot.overview(in_space).axes
    assert isinstance(state, Axes3D) and len(signals) == 7
    assert signals[-1].get_ylabel() == r"$\Delta\ell$ (mm)"
    state, *signals = plot.overview(with_friction(in_space), view="xz").axes
    assert not isinstance(state, Axes3D)
    labels = [ax.get_ylabel().split("$")[1] for ax in signals]
    assert labels[6:] == ["f_n", "f_{t,x}", "f_{t,y}", "f_{t,z}", r"\Delta\ell"]
    assert len({ax.get_xlim() for ax in signals}) == 1


def test_quantities_of_space_are_drawn_and_those_of_the_plane_are_not(in_space):
    ax = plot.signal(in_space, "contact_z")
    (curve,) = ax.get_lines()
    np.testing.assert_allclose(curve.get_ydata(), MM * np.asarray(in_space.contact_z)[:, 0], atol=ROUNDING)
    assert plot.axis_label("fz", in_space.scene) == "$f_z$ (mN)" and plot.control_axis(in_space.scene) == "$u$ (mm)"
    for name in ("contact_slope", "base_angle", "normal_force", "base_rotation"):
        with pytest.raises(ValueError, match=f"`quantity` must be one of fx, .*, got '{name}'"):
            plot.signal(in_space, name)
    assert plot.signal(with_friction(in_space), "friction_z").get_ylabel() == "$f_{t,z}$ (mN)"


def test_scans_in_space_and_in_the_plane_are_compared(in_space, result_in_si):
    ax = plot.compare({"plane": result_in_si, "space": in_space}, "fy")
    assert len(ax.get_lines()) == 2
    with pytest.raises(ValueError, match=r"`quantity` must be one of .*, got 'fz'"):
        plot.compare({"plane": result_in_si, "space": in_space}, "fz")


def test_phases_and_words_describe_scans_in_space(in_space):
    assert plot.in_words(in_space, 0.0) == "1: tangential"
    assert [label.get_text() for label in plot.phases(in_space).get_yticklabels()] == ["whisker 1"]
    entries = plot.spring_lengths(in_space).get_legend().get_texts()
    assert {"spring 1", "spring 2, $z$"} <= {entry.get_text() for entry in entries}


BALL = jw.Sphere(0.3, (-0.5, 0.8, 0.05))
ARRAY = jw.Array({
    "name": ["front", "back"],
    "x": [0.0, 0.3],
    "z": [0.1, 0.0],
    "length": [2.0, 1.0],
    "protraction": [0.0, -0.1],
    "elevation": [0.2, 0.0],
})  # fmt: skip


@pytest.mark.parametrize("view", [None, "xy", "xz"], ids=str)
def test_an_array_is_drawn_before_its_scan(view):
    ax = plot.scene(ARRAY, view=view, units="dimensionless")
    lines = {line.get_label(): line for line in ax.get_lines()}
    for name, length in (("front", 2.0), ("back", 1.0)):
        placed = (scene := ARRAY.scene(name, BALL)).motion.placement(0.0)
        base = placed.position + placed.rotation @ np.asarray(
            [scene.support.mounts[0].x, 0.0, scene.support.mounts[0].z]
        )
        tip = base + length * np.asarray(placed.rotation)[:, 1]
        shown = {None: [0, 1, 2], "xy": [0, 1], "xz": [0, 2]}[view]
        points = np.stack(lines[name].get_data_3d() if view is None else lines[name].get_data(), axis=1)
        np.testing.assert_allclose(
            points[[0, -1]], np.stack([base, tip])[:, shown] / 2.0, atol=1e-6
        )  # in L of the first
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["front", "back"]
    assert ax.get_xlabel() == "$x/L$"


def test_an_array_is_drawn_with_an_object():
    alone, both = (plot.scene(ARRAY, surface=surface, view="xy") for surface in (None, BALL))
    assert len(both.patches) == len(alone.patches) + 1
    outline = both.patches[0].get_xy()
    assert np.ptp(outline[:, 0]) == pytest.approx(2 * BALL.radius, rel=1e-2)  # m
    assert both.get_xlim()[0] < outline[:, 0].min()


def test_large_arrays_have_no_legend():
    assert plot.scene(jw.Array({"length": [1.0] * 12})).get_legend() is None


@pytest.mark.unchecked
def test_objects_belong_to_arrays():
    with pytest.raises(ValueError, match="`surface` must be None for a Scene"):
        plot.scene(ARRAY.scene("front", BALL), surface=BALL)
    with pytest.raises(ValueError, match="`surface` must be a surface, such as a Sphere, or a tuple of surfaces, got"):
        plot.scene(ARRAY, surface=jw.Parabola(0.2))
