"""Two ways to see a scene in space: projected onto two axes, in plain Axes, or by a camera, in 3D Axes.

Both draw lines, arrows, words and the object. What the object hides is paler.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib import rcParams
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch
from matplotlib.ticker import MultipleLocator
from mpl_toolkits.mplot3d import Axes3D, proj3d
from mpl_toolkits.mplot3d.art3d import Line3D, Line3DCollection, Poly3DCollection

from jaxwhisker._base import checks
from jaxwhisker.plot.axes import OBJECT, SUPPORT, rounded
from jaxwhisker.plot.body import Body, Point, Points

VIEWS = {"xy": (0, 1), "xz": (0, 2), "yz": (2, 1)}  # the axes to the right and up
CAMERA = (15.0, 35.0)  # elevation and azimuth, degrees
BEHIND = 0.3  # opacity of what the object hides
DARKEST, LIGHTEST = 0.68, 0.97  # grey of faces
CUT_GREY = 0.93
LIGHT = np.array([-0.35, 0.8, 0.5]) / np.linalg.norm([-0.35, 0.8, 0.5])
TICKS = 4  # about so many along the longest side
FILLED = np.array([0.7, 0.77])  # of the Axes, across and up, by the box of a camera
SIZE = (5.8, 5.2)  # inches, of a figure by a camera
LABEL_PAD = 8.0  # points from the numbers of an axis in space to its label
RING = {"marker": "o", "linestyle": "none", "markerfacecolor": "none", "markeredgewidth": 2}
ARROW = {"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 0}

project: Any = proj3d.proj_transform

View = str | tuple[float, float]


class Drawn(NamedTuple):
    """Artists, and a function that moves them to points."""

    artists: list[Any]
    move: Callable[[Points], None]


def check_no_view(view: Any) -> None:
    """Check that a picture in the plane has no view.

    Raises:
        ValueError: if it has one.
    """
    if view is not None:
        checks.fail("view", "None in the plane", repr(view))


def check_view(view: Any, ax: Any = None) -> View:
    """The view of a picture: that of the argument, or one that suits the Axes.

    Raises:
        ValueError: if `view` is not a projection or two finite angles, or `ax` are not Axes that suit it.
    """
    if ax is not None:
        checks.instance("ax", ax, Axes, "matplotlib Axes")
    if view is None:
        return CAMERA if ax is None or isinstance(ax, Axes3D) else "xy"
    if isinstance(view, str):
        if view not in VIEWS:
            checks.fail("view", f"one of {', '.join(VIEWS)}, or (elevation, azimuth) in degrees", repr(view))
        if isinstance(ax, Axes3D):
            checks.fail("ax", "plain Axes for a projection", "3D Axes")
        return view
    try:
        elevation, azimuth = (float(angle) for angle in view)
        known = np.isfinite([elevation, azimuth]).all()
    except (TypeError, ValueError):
        known = False
    if not known:
        checks.fail("view", f"one of {', '.join(VIEWS)}, or (elevation, azimuth) in degrees", repr(view))
    if ax is not None and not isinstance(ax, Axes3D):
        checks.fail("ax", 'Axes with projection="3d" for a view by a camera', "plain Axes")
    return elevation, azimuth


def direction_of(elevation: float, azimuth: float) -> Point:
    """Direction to a camera: along z if both angles are 0. The azimuth turns it towards x, and the elevation up."""
    up, around = np.radians([elevation, azimuth])
    return np.array([np.cos(up) * np.sin(around), np.sin(up), np.cos(up) * np.cos(around)])


def picture(view: View, ax: Axes | None = None, *, figure: Any = None, place: Any = None) -> "Flat | Turned":
    """A picture in Axes, by default in a new figure, or in new Axes at a place in a figure."""
    flat = isinstance(view, str)
    options: dict[str, Any] = {} if flat else {"projection": "3d"}
    if figure is not None:
        ax = figure.add_axes(place, **options) if isinstance(place, tuple) else figure.add_subplot(place, **options)
    elif ax is None:
        from matplotlib import pyplot

        ax = pyplot.figure(figsize=None if flat else SIZE, layout="constrained").add_subplot(**options)
    assert ax is not None
    return Flat(ax, view) if isinstance(view, str) else Turned(ax, view)


class Flat:
    """A projection onto two axes."""

    def __init__(self, ax: Axes, view: str):
        self.ax, self.shown = ax, list(VIEWS[view])
        self.towards = np.cross(*np.eye(3)[self.shown])
        ax.set_aspect("equal")

    def line(self, points: Points, body: Body | None = None, **style: Any) -> Drawn:
        """A line through points; where the body hides it, it is paler."""
        style = {"solid_capstyle": "round"} | style
        label = style.pop("label", None)
        whole = self.ax.plot([], [], **style | _paler(style, body), label=label if body is None else None)[0]
        seen = None if body is None else self.ax.plot([], [], **style, label=label)[0]

        def move(points: Points) -> None:
            whole.set_data(*points.T[self.shown])
            if seen is not None and body is not None:
                seen.set_data(*_without_hidden(points, body, self.towards).T[self.shown])

        move(points)
        return Drawn([whole] if seen is None else [whole, seen], move)

    def arrow(self, ends: Points, colour: Any, width: float = 1.5, size: float = 10.0) -> Drawn:
        """An arrow from the first to the second point; NaN hides it."""
        arrow = FancyArrowPatch((0, 0), (0, 0), color=colour, linewidth=width, mutation_scale=size, zorder=5, **ARROW)
        self.ax.add_patch(arrow)

        def move(ends: Points) -> None:
            arrow.set_visible(bool(np.isfinite(ends).all()))
            arrow.set_positions(*np.nan_to_num(ends[:, self.shown]))

        move(ends)
        return Drawn([arrow], move)

    def words(self, point: Point, text: str, **style: Any) -> None:
        """Words centred at a point."""
        x, y = point[self.shown]
        self.ax.text(float(x), float(y), text, ha="center", va="center", **style)

    def body(self, body: Body) -> None:
        """The objects, those that are nearer in front."""
        from scipy.spatial import ConvexHull

        shown = body.shown(self.towards)
        own, lines = body.part[body.beside[shown, 0]], body.points[body.edges[shown]][..., self.shown]
        each = [body.points[np.unique(body.faces[body.part == part])] for part in body.parts]
        nearest = [float(np.max(points @ self.towards)) for points in each]
        style = {"colors": [to_rgb(SUPPORT)], "linewidths": 1, "capstyle": "round"}
        for k, part in enumerate(np.argsort(nearest)):
            flat = each[part][:, self.shown]
            around = flat[ConvexHull(flat).vertices]
            order = 0.5 * k / len(each)
            self.ax.fill(*around.T, color=OBJECT, linewidth=0, zorder=order)
            self.ax.add_collection(LineCollection(list(lines[own == part]), **style, zorder=order))

    def window(self, low: Point, high: Point, labels: Sequence[str]) -> None:
        """Limits and labels of the axes."""
        (left, bottom), (right, top) = low[self.shown], high[self.shown]
        across, up = (labels[axis] for axis in self.shown)
        self.ax.set(xlim=(left, right), ylim=(bottom, top), xlabel=across, ylabel=up)
        _set_ticks((high - low)[self.shown], self.ax.xaxis, self.ax.yaxis)


class Turned:
    """A picture by a camera far away."""

    def __init__(self, ax: Any, view: tuple[float, float]):
        self.ax, self.towards = ax, direction_of(*view)
        ax.computed_zorder = False
        ax.set_proj_type("ortho")
        ax.view_init(elev=view[0], azim=view[1], vertical_axis="y")
        for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
            axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
            # Grid lines end at the edges of their pane, which therefore look like them.
            edges = {"edgecolor": rcParams["grid.color"], "linewidth": rcParams["grid.linewidth"]}
            axis.labelpad = LABEL_PAD
            axis.pane.set(facecolor="none", alpha=None, closed=True, joinstyle="round", **edges)

    def line(self, points: Points, body: Body | None = None, **style: Any) -> Drawn:
        """A line through points; where the body hides it, it is paler."""
        style = {"solid_capstyle": "round"} | style
        label = style.pop("label", None)
        lines = [Line3D(*points.T, **style | _paler(style, body), label=label if body is None else None)]
        if body is not None:
            lines.append(_VisibleLine(*points.T, body=body, **style, label=label))
        for line in lines:
            self.ax.add_line(line)

        def move(points: Points) -> None:
            for line in lines:
                line.set_data_3d(*points.T)

        return Drawn(lines, move)

    def arrow(self, ends: Points, colour: Any, width: float = 1.5, size: float = 10.0) -> Drawn:
        """An arrow from the first to the second point; NaN hides it."""
        arrow = _SpaceArrow((0, 0), (0, 0), color=colour, linewidth=width, mutation_scale=size, zorder=5, **ARROW)
        self.ax.add_patch(arrow)

        def move(ends: Points) -> None:
            arrow.set_visible(bool(np.isfinite(ends).all()))
            arrow.ends = np.nan_to_num(ends)

        move(ends)
        return Drawn([arrow], move)

    def words(self, point: Point, text: str, **style: Any) -> None:
        """Words centred at a point."""
        self.ax.text(*point, text, ha="center", va="center", **style)

    def body(self, body: Body) -> None:
        """The object."""
        self.ax.add_collection3d(_Faces(body))
        self.ax.add_collection3d(_BodyOutline(body))

    def window(self, low: Point, high: Point, labels: Sequence[str]) -> None:
        """Limits and labels of the axes, which have the same scale."""
        self.ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
        # The box fills the Axes up to the room for the labels, whatever its shape.
        self.ax.set_box_aspect(high - low)
        corners = np.stack(np.meshgrid(*np.stack([low, high]).T)).reshape(3, -1)
        seen = np.ptp(project(*corners, self.ax.get_proj())[:2], axis=1)
        self.ax.set_box_aspect(high - low, zoom=float(np.min(FILLED / seen)) * self.ax.viewLim.width)
        self.ax.set(xlabel=labels[0], ylabel=labels[1], zlabel=labels[2])
        _set_ticks(high - low, self.ax.xaxis, self.ax.yaxis, self.ax.zaxis)


def shades_of(body: Body) -> Float[np.ndarray, " faces"]:
    """Grey of the faces of a body, from 0 (black) to 1 (white)."""
    light = DARKEST + (LIGHTEST - DARKEST) * (1 + body.smooth @ LIGHT) / 2
    return np.where(body.cut, CUT_GREY, light)


def _set_ticks(spans: np.ndarray, *axes: Any) -> None:
    step = rounded(float(np.max(spans)) / TICKS)
    for axis, span in zip(axes, spans, strict=True):
        # Short axes have two ticks at least.
        axis.set_major_locator(MultipleLocator(min(step, rounded(float(span) / 2.5))))


def _paler(style: dict[str, Any], body: Body | None) -> dict[str, Any]:
    opacity = style.get("alpha", 1.0)
    return {"alpha": opacity if body is None else BEHIND * opacity}


def _without_hidden(points: Points, body: Body, towards: Point) -> Points:
    """The points that a body does not hide; the others are NaN."""
    return np.where(body.hides(np.nan_to_num(points), towards)[:, None], np.nan, points)


def _towards(artist: Artist) -> Point:
    axes: Any = artist.axes
    return direction_of(axes.elev, axes.azim)


class _VisibleLine(Line3D):
    """The parts of a line that a body does not hide from the camera."""

    def __init__(self, *coordinates: Float[np.ndarray, " points"], body: Body, **style: Any):
        super().__init__(*coordinates, **style)
        self.body = body

    def draw(self, renderer: Any) -> None:
        points = np.stack(np.broadcast_arrays(*self.get_data_3d()), axis=1)
        seen = _without_hidden(points, self.body, _towards(self))
        axes: Any = self.axes
        self.set_data(*project(*seen.T, axes.M)[:2])
        Line2D.draw(self, renderer)
        self.stale = False


class _SpaceArrow(FancyArrowPatch):
    ends: Points = np.zeros((2, 3))

    def do_3d_projection(self) -> float:
        axes: Any = self.axes
        x, y, depth = project(*self.ends.T, axes.M)
        self.set_positions((x[0], y[0]), (x[1], y[1]))
        return float(np.min(depth))

    def draw(self, renderer: Any) -> None:
        self.do_3d_projection()
        super().draw(renderer)


class _Faces(Poly3DCollection):
    """The faces of a body that are turned towards the camera."""

    def __init__(self, body: Body):
        self.whole, self.corners = body, body.points[body.faces]
        grey = shades_of(body)
        self.shades = np.stack([grey, grey, grey, np.ones_like(grey)], axis=1)
        # Seams between faces would show if their edges were smoothed.
        style = {"edgecolors": "none", "linewidths": 0, "antialiaseds": False, "zorder": 0, "rasterized": True}
        super().__init__(self.corners, facecolors=self.shades, **style)

    def do_3d_projection(self) -> float:
        seen = self.whole.normals @ _towards(self) > 0
        self.set_verts(list(self.corners[seen]))
        self.set_facecolor(self.shades[seen])
        return super().do_3d_projection()


class _BodyOutline(Line3DCollection):
    """The silhouette of a body, and the edges of its cuts."""

    def __init__(self, body: Body):
        self.whole, self.corners = body, body.points
        style = {"colors": [to_rgb(SUPPORT)], "linewidths": 1, "capstyle": "round", "zorder": 0.5}
        super().__init__(self.corners[body.edges], **style)

    def do_3d_projection(self) -> float:
        self.set_segments(list(self.corners[self.whole.outline(_towards(self))]))
        return super().do_3d_projection()
