"""Random ordinary scenes in space, each also in plain numbers for space_laws.py."""

# pyright: reportArgumentType=false, reportRedeclaration=false

from typing import NamedTuple

import equinox as eqx
import numpy as np
from scipy.spatial.transform import Rotation

import jaxwhisker as jw
from space_laws import UPRIGHT, Apart, Plain, RoundedCore, Surface, _left_jacobian


class Cone(eqx.Module):
    """Bending stiffness of a cone; a module, so that scenes share programs."""

    taper: float

    def __call__(self, s):
        return (1 - self.taper * s) ** 4


class Drawn(NamedTuple):
    """A scene, in plain numbers too, and the range of a scan across it."""

    scene: jw.SpaceScene
    plain: Plain
    text: str


KINDS = tuple(
    f"{rod} {base} {drive}"
    for rod in ("straight", "cone", "curved", "curved cone")
    for base in ("clamped", "sprung", "tilting")
    for drive in ("linear", "whisk")
)
SURFACES = "sphere", "ellipsoid", "cylinder", "paraboloid"
APART = 0.05  # lengths between two objects
EVERYDAY = "capsule", "box", "plane"  # a plane only with linear drives


def surface_drawn(rng, kind: str, size: float):
    """A surface about the origin, and its plain form with another point in place of the origin."""
    turn = tuple(map(float, rng.normal(size=3) * 0.6))
    if kind == "sphere":
        return jw.Sphere(size, (0.0, 0.0, 0.0)), lambda at: Surface(at, np.eye(3) / size, np.zeros(3), size / 2)
    if kind == "ellipsoid":
        axes = tuple(map(float, size * rng.uniform(0.5, 1.0, 3)))
        r = Rotation.from_rotvec(turn).as_matrix()
        plain = r @ np.diag(axes[1] / np.array(axes) ** 2) @ r.T
        ellipsoid = jw.Ellipsoid(axes, (0.0, 0.0, 0.0)).rotated(turn)
        return ellipsoid, lambda at: Surface(at, plain, np.zeros(3), axes[1] / 2)
    if kind == "box":
        edges = size * rng.uniform(0.7, 1.7, 3)
        radius = float(np.min(edges) * rng.uniform(0.05, 0.4))
        box = jw.RoundedBox(tuple(map(float, edges)), radius, (0.0, 0.0, 0.0)).rotated(turn)
        axes = Rotation.from_rotvec(turn).as_matrix().T
        half = edges / 2 - radius
        width = min(0.1 * radius, np.min(half))
        return box, lambda at: RoundedCore(at, axes, half, np.full(3, width), np.hypot(radius, np.sqrt(0.2) * width))
    if kind == "plane":
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        return jw.Plane((0.0, 0.0, 0.0), tuple(map(float, normal))), lambda at: Surface(
            at, np.zeros((3, 3)), normal, 0.0
        )
    if kind == "capsule":
        axis, unit = _axis_drawn(rng)
        radius, far = 0.5 * size, rng.uniform(0.2, 3.0) * rng.choice([-1, 1])
        capsule = jw.Capsule(radius, (0.0, 0.0, 0.0), tuple(map(float, far * unit)))
        axes = np.linalg.svd(unit[None])[2]
        half = np.array([abs(far) / 2, 0.0, 0.0])
        return capsule, lambda at: RoundedCore(at + far * unit / 2, axes, half, np.minimum(0.1 * radius, half), radius)
    if kind == "cylinder":
        axis, unit = _axis_drawn(rng)
        plain = (np.eye(3) - np.outer(unit, unit)) / size
        cylinder = jw.Cylinder(size, (0.0, 0.0, 0.0), tuple(map(float, axis)))
        return cylinder, lambda at: Surface(at, plain, np.zeros(3), size / 2)
    a, b = 0.5 / (size * rng.uniform(0.6, 1.0)), 0.5 / (size * rng.uniform(0.6, 1.0))
    depth = 1 / (2 * max(a, b))
    surface = jw.Paraboloid(float(-depth), float(a), float(b))
    return surface, lambda at: Surface(at, np.diag([2 * a, 0.0, 2 * b]), np.array([0.0, -1.0, 0.0]), depth)


def _axis_drawn(rng):
    """A direction near z, and the same as a unit vector."""
    tilt, lift = rng.uniform(-0.9, 0.9), rng.uniform(-0.3, 0.3)
    axis = np.array([np.sin(tilt), np.sin(lift), np.cos(tilt)])
    return axis, axis / np.linalg.norm(axis)


def unloaded(curvature):
    """Positions of an unloaded whisker of constant curvature on an upright mount: a helix."""
    return np.array([UPRIGHT @ (s * _left_jacobian(s * curvature)[:, 2]) for s in np.linspace(0.0, 1.0, 101)])


def drawn(kind: str, rng: np.random.Generator, surfaces: tuple[str, ...] = SURFACES) -> Drawn:
    """A random scene of a kind, with one of these surfaces."""
    *rod, base, drive = kind.split()
    while True:
        found = _tried(" ".join(rod), base, drive, rng, surfaces)
        if found is not None:
            return found


def _ahead(rng, placed, direction, tip, size):
    """Where to put an object that a linear drive passes with this overlap; None if nowhere."""
    side = np.cross(direction, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    # The lowest point of the object in the plane of the scan, at a lateral offset.
    along = np.linspace(-1, 1, 41) * 1.5 * size
    offset = rng.uniform(-0.8, 0.8) * size
    ground = np.array([direction[0], 0.0, direction[2]])
    ground /= np.linalg.norm(ground)
    heights = np.linspace(-3, 3, 1201)
    grid = along[:, None, None] * ground + offset * side + heights[None, :, None] * np.array([0.0, 1.0, 0.0])
    hit = placed(np.zeros(3)).off(grid) < 0
    if not np.any(hit):
        return None
    lowest = np.min(np.broadcast_to(heights, hit.shape)[hit])
    overlap = rng.uniform(0.05, 0.6)
    inside = tip - offset * side + (0 - lowest - overlap) * np.array([0.0, 1.0, 0.0])
    # No part of the object near the plane in which the base moves.
    flat = np.linspace(-2, 2, 41)
    plane = np.stack(np.meshgrid(flat, flat), -1).reshape(-1, 2)
    plane = plane[:, :1] * ground + plane[:, 1:] * side
    if np.min(placed(inside).off(plane[np.abs(plane @ side) < 0.4] + np.array([0, 0.1, 0]))) < 0:
        return None
    return inside


def _before_wall(rng, wall, direction, tip):
    """Where to put a wall that the tip of a whisker touches; None if the drive hardly approaches it."""
    normal = np.array(wall.outward)
    # A whisker that points straight at a wall buckles.
    if not -0.95 < normal @ direction < -0.2 or abs(normal[1]) > 0.9:
        return None
    return tip + rng.uniform(0.0, 1.0) * direction


def _tried(rod, base, drive, rng, surfaces):
    curved, cone, strip = "curved" in rod, "cone" in rod, "strip" in rod
    whisker, curvature, roll, taper, lateral = {}, np.zeros(3), 0.0, 0.0, 1.0
    ratio = float(rng.uniform(0.6, 0.8))
    if curved:
        curvature = np.array([0.0, -rng.uniform(-1.2, 1.2), rng.uniform(-0.8, 0.8)])
        whisker = {"intrinsic_curvature": float(-curvature[1]), "twist": float(curvature[2])}
    if strip:
        lateral = float(np.exp(rng.uniform(np.log(0.3), np.log(50.0))))
        whisker["lateral_ratio"] = lateral
    if curved or strip or drive == "whisk":
        roll = float(rng.uniform(-np.pi, np.pi))
    if cone:
        taper = float(rng.uniform(0.3, 0.8))
        whisker["bending_stiffness"] = Cone(taper)
    turned = UPRIGHT @ Rotation.from_rotvec([0, 0, roll]).as_matrix()
    points = unloaded(curvature)
    points = points @ (turned @ UPRIGHT.T).T
    name = surfaces[rng.integers(len(surfaces))]
    size = float(np.exp(rng.uniform(np.log(0.2), np.log(1.5 if drive == "linear" else 0.8))))
    surface, placed = surface_drawn(rng, name, size)
    tip = points[-1]
    inside = np.array([0.0, 0.0, 0.0])
    if name in ("paraboloid", "plane") and drive == "whisk":
        return None

    if drive == "linear":
        heading = rng.uniform(-np.pi, np.pi) if rng.random() < 0.7 else np.pi
        direction = np.array([np.cos(heading), rng.uniform(-0.2, 0.2), np.sin(heading)])
        direction /= np.linalg.norm(direction)
        inside = (
            _before_wall(rng, surface, direction, tip) if name == "plane" else _ahead(rng, placed, direction, tip, size)
        )
        if inside is None:
            return None
        motion = jw.LinearDrive(tuple(map(float, direction)))
        mount = jw.Mount(roll=roll) if curved or strip else None

        def placement(u):
            return u * direction, np.eye(3), turned

        text = f"dir {direction.round(2)} at {inside.round(2)}"
    else:
        elevation, rate = float(rng.uniform(-0.25, 0.25)), float(rng.uniform(-0.8, 0.8))
        motion = jw.WhiskDrive(elevation=elevation, roll=roll, roll_rate=rate)
        mount = None

        def placement(u):
            r = Rotation.from_euler("Y", roll + rate * u).as_matrix()
            r = Rotation.from_euler("Z", u).as_matrix() @ Rotation.from_euler("X", elevation).as_matrix() @ r
            return np.zeros(3), r, r @ UPRIGHT

        own = unloaded(curvature)
        u = rng.uniform(-0.4, 0.5)
        part = int(100 * rng.uniform(0.4, 0.95))
        where = placement(u)[1] @ own[part]
        ahead = (placement(u + 1e-3)[1] @ own[part] - where) / 1e-3
        ahead /= np.linalg.norm(ahead)
        across = rng.normal(size=3)
        across -= across @ ahead * ahead
        across /= np.linalg.norm(across)
        lean = rng.uniform(-0.9, 0.9)
        ray = np.cos(lean) * ahead + np.sin(lean) * across
        steps = np.linspace(0, 3, 301)
        inside = where + ray * (steps[np.argmax(placed(inside).off(-steps[:, None] * ray) > 0)])
        if np.min(placed(inside).off(np.zeros(3))) < 0.08:
            return None
        if np.min(placed(inside).off(own @ placement(-np.pi / 2)[1].T)) < 0.01:
            return None
        text = f"elevation {elevation:.2f} roll rate {rate:.2f} at {part} u {u:.2f}"
    surface = surface.moved(tuple(map(float, inside)))
    springs, linear, tilting = [], np.full(3, np.inf), np.full(3, np.inf)
    if base != "clamped":
        linear = np.exp(rng.uniform(np.log(5), np.log(1000), 3))
        springs += [jw.Spring((0, 1), float(c), axis=a) for c, a in zip(linear, "xyz", strict=True)]
    if base == "tilting":
        tilting = np.exp(rng.uniform(np.log(3), np.log(100), 3))
        springs += [
            jw.Spring((0, 1), float(c), axis=a) for c, a in zip(tilting, ("phi_x", "phi_y", "phi"), strict=True)
        ]
    scene = jw.SpaceScene(
        jw.Whisker(torsion_ratio=ratio, **whisker), surface, jw.Support(tuple(springs), mount), motion=motion
    )
    plain = Plain(
        placed(inside),
        placement,
        stiffness=(lambda s: (1 - taper * s) ** 4),
        torsion_ratio=ratio,
        lateral_ratio=lateral,
        curvature=lambda s: curvature,
        springs=linear,
        tilting=tilting,
    )
    return Drawn(
        scene,
        plain,
        f"{name} {size:.2f} {text} curv {curvature.round(2)} roll {roll:.2f} taper {taper:.2f} {lateral:.2g}",
    )


def drawn_before_two(kind: str, rng: np.random.Generator) -> Drawn:
    """A random scene of a kind with a linear drive, with a second object that is apart from the first one."""
    while True:
        first = drawn(kind, rng, SURFACES[:3])
        _, drive, turned = first.plain.placement(0.0)
        motion = first.scene.motion
        assert isinstance(motion, jw.LinearDrive)
        direction = drive @ np.asarray(motion.direction)
        tip = turned @ UPRIGHT.T @ unloaded(np.asarray(first.plain.curvature(0.0)))[-1]
        size = float(np.exp(rng.uniform(np.log(0.1), np.log(0.8))))
        surface, placed = surface_drawn(rng, SURFACES[rng.integers(3)], size)
        inside = _ahead(rng, placed, direction, tip, size)
        if inside is None:
            continue
        inside = inside + rng.uniform(0.3, 3.0) * direction
        near, second = inside + rng.uniform(-2.0, 2.0, (40000, 3)), placed(inside)
        if np.min(np.maximum(first.plain.surface.off(near), second.off(near))) < APART:
            continue
        objects = (first.scene.surface, surface.moved(tuple(map(float, inside))))
        scene = jw.SpaceScene(first.scene.whisker, objects, first.scene.support, motion=motion)
        plain = first.plain._replace(surface=Apart((first.plain.surface, second)))
        return Drawn(scene, plain, f"{first.text}; {objects[1]}")
