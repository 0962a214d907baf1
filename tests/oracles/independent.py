"""Laws that the states of a scan must satisfy, checked by elliptic integrals that share no code with the package.

The checks use only fields of a Result for whiskers in contact: force f, slope alpha, arc s1, moment mz, positions. With
theta0 = pi/2 - alpha at the base, the first integral of the elastica gives k^2 = sin(alpha/2)^2 + mz^2 / (4 f EI); then

    sqrt(f) s1 = F(psi, k),  sqrt(f) T = 2 k cos(t0),  sqrt(f) N = 2 E(psi, k) - 2 k^2 sin(t0) sin(psi) - F(psi, k)

with sin(t0) = sin(alpha/2)/k, tan(psi) = cot(t0) / sqrt(1 - k^2), are the way from the contact to the base (units
L = EI = 1; see exact.py). Whiskers bent the other way are mirrored first.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import ellipeinc, ellipkinc

import jaxwhisker as jw

DIFFERENCE = 1e-6  # step of the differences that determine stability
UNDECIDED = 1e-4  # eigenvalues this close to zero do not decide
LOADED = 1e-10  # force below which a contact is considered to have just begun


class Mechanics(NamedTuple):
    """Numbers of many scenes of one kind; leading axis: scenes."""

    kind: str  # of the profile
    profile: dict[str, np.ndarray]  # its parameters
    length: np.ndarray  # (scenes, whiskers)
    bending_stiffness: np.ndarray
    flexibility: np.ndarray  # (scenes, whiskers, whiskers)
    offset: np.ndarray  # (scenes, whiskers)


def contact_point(kind, p, slope):
    """Point of the object with this slope angle."""
    if kind == "parabola":
        x = np.tan(slope) / (2 * p["a"])
        return x, p["distance"] + p["a"] * x**2
    a, b = (p["radius"], p["radius"]) if kind == "circle" else (p["a"], p["b"])
    norm = np.hypot(a * np.sin(slope), b * np.cos(slope))
    return a**2 * np.sin(slope) / norm, p["distance"] + b * (1 - b * np.cos(slope) / norm)


def height_of(kind, p, x):
    """Height of the object's lower side above the bases; infinite beside the object."""
    if kind == "parabola":
        return p["distance"] + p["a"] * x**2
    a, b = (p["radius"], p["radius"]) if kind == "circle" else (p["a"], p["b"])
    inside = np.abs(x) < a
    return np.where(inside, p["distance"] + b * (1 - np.sqrt(1 - np.where(inside, x / a, 0.0) ** 2)), np.inf)


def _elastica(k, slope):
    """Arc, x and y of the contact relative to the base, each times sqrt(f)."""
    sin_t0 = np.sin(slope / 2) / k
    cos_t0 = np.sqrt(np.maximum(1 - sin_t0**2, 0.0))
    psi = np.arctan2(cos_t0, sin_t0 * np.sqrt(1 - k**2))
    arc = ellipkinc(psi, k**2)
    along = 2 * k * cos_t0
    across = 2 * (ellipeinc(psi, k**2) - k**2 * sin_t0 * np.sin(psi)) - arc
    x = along * np.cos(slope) - across * np.sin(slope)
    return arc, x, along * np.sin(slope) + across * np.cos(slope)


def violations(scenes: Mechanics, control: np.ndarray, result: jw.Result) -> dict[str, np.ndarray]:
    """Residual of each law in each state, relative to its size: (scenes, steps) each, zero where not ok.

    Args:
        scenes: the mechanics of all scenes.
        control: (scenes, steps).
        result: their scans, stacked along the first axis.
    """
    r = {name: np.asarray(getattr(result, name)) for name in jw.State.__dataclass_fields__}
    ok = np.asarray(result.status) == jw.Status.ok
    touching = (r["phase"] != jw.Phase.free) & ok[..., None]
    tip, free = touching & (r["phase"] == jw.Phase.tip), ok[..., None] & ~touching
    # Everything in units of each whisker; bent to the left.
    length = scenes.length[:, None, :]
    unit = scenes.bending_stiffness[:, None, :] / length**2
    curved = ("a",) if scenes.kind == "parabola" else ()
    profile = {
        name: value[:, None, None] * (length if name in curved else 1 / length)
        for name, value in scenes.profile.items()
    }
    side = np.where(r["mz"] < 0, -1.0, 1.0)
    slope = np.where(touching, side * r["contact_slope"], 0.3)
    force = np.where(touching, np.maximum(r["contact_force"] / unit, 0.0), 1.0)
    moment = np.where(touching, side * r["mz"] / (unit * length), 1.0)
    fx, fy = r["fx"] / unit, r["fy"] / unit
    arc, base_x, contact_x, contact_y = (
        r[name] / length for name in ("contact_arc", "base_x", "contact_x", "contact_y")
    )
    # At almost zero force the whisker is straight, and lengths divided by sqrt(f) lose their digits.
    loaded = touching & (force > LOADED)
    k = np.sqrt(np.sin(slope / 2) ** 2 + moment**2 / (4 * np.maximum(force, LOADED)))
    k = np.where(loaded, np.clip(k, np.abs(np.sin(slope / 2)), 1 - 1e-15), 0.7)
    root = np.sqrt(np.maximum(force, LOADED))
    whole, x, y = _elastica(k, slope)
    on_x, on_y = contact_point(scenes.kind, profile, side * slope)
    balance = r["base_x"] - control[..., None] - scenes.offset[:, None, :]
    balance = balance + np.einsum("nij,nsj->nsi", scenes.flexibility, r["fx"])
    stands = height_of(scenes.kind, profile, base_x) - 1

    def where(mask, value):
        # NaN violates every law.
        return np.max(np.where(mask, np.where(np.isnan(value), np.inf, np.abs(value)), 0.0), axis=-1)

    with np.errstate(invalid="ignore"):
        missed = {
            "contact on the object, x": where(touching, (contact_x - on_x) / (1 + np.abs(on_x))),
            "contact on the object, y": where(touching, (contact_y - on_y) / (1 + np.abs(on_y))),
            "arc of the elastica": where(loaded, whole / root - arc),
            "base under the contact, x": where(loaded, side * (contact_x - base_x) - x / root),
            "base under the contact, y": where(loaded, contact_y - y / root),
            "force along the normal, x": where(touching, (fx + force * np.sin(side * slope)) / (1 + force)),
            "force along the normal, y": where(touching, (fy - force * np.cos(slope)) / (1 + force)),
            "the object only pushes": where(touching, np.minimum(r["contact_force"] / unit, 0.0)),
            "tip contact is at the tip": where(tip, arc - 1),
            "tip contact is from below": where(tip & loaded, np.maximum(k**2 - 0.5, 0.0)),
            "tangential contact is tangential": where(loaded & ~tip, k**2 - 0.5),
            "tangential contact is on the whisker": where(touching & ~tip, np.maximum(arc - 1, 0.0)),
            "balance of bases": where(
                ok[..., None], balance / (length[..., :1] + np.max(np.abs(r["base_x"]), -1, keepdims=True))
            ),
            "free whiskers carry nothing": where(free, np.abs(fx) + np.abs(fy) + np.abs(r["mz"] / (unit * length))),
            "free whiskers are clear": where(free, np.minimum(stands, 0.0)),
        }
        slopes, own = _slopes(scenes.kind, profile, tip, slope, k)
        judged = np.all(~touching | loaded, axis=-1) & ok
        slopes = np.where(loaded, slopes, 0.0) * unit / length
        matrix = np.eye(slopes.shape[-1]) - scenes.flexibility[:, None] * slopes[..., None, :]
        matrix = np.where(
            (judged & np.all(np.isfinite(slopes), axis=-1))[..., None, None], matrix, np.eye(slopes.shape[-1])
        )
        least = np.min(np.linalg.eigvals(matrix).real, axis=-1)
    missed["stable network"] = np.maximum(-least - UNDECIDED, 0.0)
    missed["stable whiskers"] = where(loaded, np.where(own < -UNDECIDED, own, 0.0))
    return missed


def _slopes(kind, profile, tip, slope, k):
    """d force_x / d base_x of the clamped whiskers, and the cosine between their branch and increasing base_x.

    The branch is the line g(alpha, k) = 0 in tip contact, and k^2 = 1/2 in tangential contact. From first touch to the
    fold, t0 and base_x decrease together.
    """

    def state(slope, k):
        arc, x, y = _elastica(k, slope)
        on_x, on_y = contact_point(kind, profile, slope)
        root = np.where(tip, arc, y / on_y)
        return y / root - on_y, on_x - x / root, root**2 * np.sin(slope), np.sin(slope / 2) / k

    def by(d_slope, d_k):
        ahead, behind = (state(slope + s * DIFFERENCE * d_slope, k + s * DIFFERENCE * d_k) for s in (1, -1))
        return [(a - b) / (2 * DIFFERENCE) for a, b in zip(ahead, behind, strict=True)]

    by_slope, by_k = by(1.0, 0.0), by(0.0, 1.0)
    along = np.where(tip, -by_k[0], 1.0), np.where(tip, by_slope[0], 0.0)
    d_x, d_force, d_t0 = (along[0] * by_slope[i] + along[1] * by_k[i] for i in (1, 2, 3))
    return d_force / d_x, d_x * np.sign(d_t0) / (np.abs(d_x) + np.hypot(*along))
