"""Whiskers that touch several pegs or rings in space, and laws of their states, checked by numpy and scipy only.

The rod is integrated from the base, with the reaction of the support. At each contact, the contact force is taken off.
"""

from functools import cache
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import jaxwhisker as jw

TOLERANCE = 1e-12  # of the integration
PLACES = 60  # of each segment, which must not be inside an object
TILTED = ((0.2, 0.1, 1.0), (-0.3, 0.0, 1.0))
ALONG_Z = ((0.0, 0.0, 1.0), (0.0, 0.0, 1.0))
# Two pegs along z: an independent chain of elastica segments in the plane, each event solved to 1e-12.
CONTROL = -0.64
REACTION = {"fx": -5.284004959, "fy": 8.1112055326, "mz": 4.0277054343}
CONTACTS = {  # from the tip
    "contact_force": (2.1612902914, 7.6334118372),
    "contact_arc": (0.9175716017, 0.3317006121),
    "contact_x": (0.0569637857, -0.4766106112),
    "contact_y": (0.5082837328, 0.2750579249),
}
EVENTS = {"touch": -0.5875385224, "tangential_to_tip": -0.73131241038, "release": -0.75047328622}  # after the first
EXACT = 2e-8  # errors of reactions of rods with eight steps a segment


def scene(axes: Any = TILTED, whisker: Any = None, support: Any = None) -> Any:
    """A whisker before two pegs, by default straight and clamped."""
    pegs = (jw.Cylinder(0.2, (0.0, 0.7, 0.0), axes[0]), jw.Cylinder(0.12, (-0.55, 0.37, 0.0), axes[1]))
    own = jw.Whisker() if whisker is None else whisker
    return jw.Scene(own, pegs, jw.Support() if support is None else support, contacts=2)


@cache
def scan(axes: Any = ALONG_Z) -> Any:
    """The scan of a straight whisker past both pegs."""
    return jw.scan(scene(axes), np.sort(np.append(np.linspace(0.3, -1.0, 27), CONTROL))[::-1])


def seen_from(body: Any, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances of points from a cylinder or a torus, and the directions away from it."""
    axis = np.array(body.axis) / np.linalg.norm(body.axis)
    off = points - np.array(body.centre if isinstance(body, jw.Torus) else body.point)
    away = off - (off @ axis)[..., None] * axis
    if isinstance(body, jw.Torus):
        away = off - float(body.radius) * away / np.linalg.norm(away, axis=-1, keepdims=True)
    distance = np.linalg.norm(away, axis=-1)
    radius = float(body.tube_radius if isinstance(body, jw.Torus) else body.radius)
    return distance - radius, away / distance[..., None]


def violations(result: Any, step: int) -> dict[str, float]:
    """By how much the state of a uniform whisker of length 1 misses each law."""
    at = {name: np.asarray(getattr(result, name))[step, 0] for name in ("contact_force", "contact_arc", "phase")}
    force, moment, base = (
        np.array([float(np.asarray(getattr(result, name))[step, 0]) for name in names])
        for names in (("fx", "fy", "fz"), ("mx", "my", "mz"), ("base_x", "base_y", "base_z"))
    )
    points = np.stack([np.asarray(getattr(result, f"contact_{axis}"))[step, 0] for axis in "xyz"], axis=-1)
    whisker, missed = result.scene.whiskers[0], dict.fromkeys(("place", "surface", "tangent", "pull", "depth"), 0.0)
    torsion = 1.0 / whisker.torsion_ratio if whisker.torsion_ratio is not None else 1.0
    kappa = np.array([0.0, -(whisker.intrinsic_curvature or 0.0), 0.0])
    here, at_rest = np.concatenate([base, np.asarray(result.base_rotation)[step, 0].T.ravel()]), 0.0
    load, about = -force, -moment  # of all contacts beyond, about the base
    order = [k for k in reversed(range(len(at["phase"]))) if at["phase"][k] != 0]
    for k in [*order, None]:
        end = 1.0 if k is None else at["contact_arc"][k]

        def rate(_, state, load=load, about=about):
            d1, d2, d3 = state[3:].reshape(3, 3)
            m = about - np.cross(state[:3] - base, load)
            k1, k2, k3 = kappa + np.array([m @ d1, m @ d2, torsion * (m @ d3)])
            omega = k1 * d1 + k2 * d2 + k3 * d3
            return np.concatenate([d3, *(np.cross(omega, d) for d in (d1, d2, d3))])

        if end > at_rest:
            places = np.linspace(at_rest, end, PLACES)
            way = solve_ivp(rate, (at_rest, end), here, "DOP853", places, rtol=TOLERANCE, atol=TOLERANCE).y
            depth = max(float(-seen_from(one, way[:3].T)[0].min()) for one in result.scene.objects)
            here, missed["depth"] = way[:, -1], max(missed["depth"], depth)
        if k is None:
            break
        at_rest, tangent = end, here[9:12]
        several = len(result.scene.objects) > 1
        own = int(np.asarray(result.contact_object)[step, 0, k]) - 1 if several else 0
        distance, normal = seen_from(result.scene.objects[own], points[k])
        missed["place"] = max(missed["place"], float(np.abs(here[:3] - points[k]).max()))
        missed["surface"] = max(missed["surface"], float(abs(distance)))
        leans = tangent @ normal
        tip = at["phase"][k] == jw.Phase.tip
        missed["tangent"] = max(missed["tangent"], float(leans if tip else abs(leans)))
        missed["pull"] = max(missed["pull"], float(-at["contact_force"][k]))
        push = at["contact_force"][k] * normal
        load, about = load - push, about - np.cross(points[k] - base, push)
    return missed | {"force": np.abs(load).max(), "moment": np.abs(about).max()}
