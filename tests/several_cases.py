"""Stored exact scans of whiskers with several contacts, and their scenes."""

import copy
import json
from functools import cache
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw

CASES = {
    c["name"]: c for c in json.loads((Path(__file__).parent / "data" / "several_contacts.json").read_text())["cases"]
}


class Wave(eqx.Module):
    """A parabola with waves; a module, so that scenes share programs."""

    distance: float
    amplitude: float
    wavelength: float
    a: float

    def __call__(self, x):
        return self.distance + self.amplitude * (1 - jnp.cos(2 * jnp.pi * x / self.wavelength)) + self.a * x**2


def _wave(position: float, **numbers: float) -> jw.Graph:
    return jw.Graph(Wave(**numbers), position=position)


def _polygon(outline: list) -> jw.Polygon:
    return jw.Polygon(outline)


MAKERS = {
    "circle": jw.Circle,
    "ellipse": jw.Ellipse,
    "cosine": _wave,
    "box": jw.Box,
    "polygon": _polygon,
    "pipe": jw.Pipe,
}


def _object(o: dict):
    return MAKERS[o["kind"]](**{name: value for name, value in o.items() if name != "kind"})


def scene_of(case: dict) -> jw.Scene:
    """The scene of a stored scan."""
    springs = [jw.Spring(tuple(s["between"]), s["stiffness"], s["rest_length"]) for s in case["springs"]]
    for axis, stiffness in (("y", case["along_y"]), ("phi", case["turning"])):
        springs += [jw.Spring((0, 1), stiffness, 0.0, axis=axis)] if stiffness else []
    curvature = case["whiskers"][0]["intrinsic_curvature"]
    straight = isinstance(curvature, float) and curvature == 0
    whisker = jw.Whisker() if straight else jw.Whisker(intrinsic_curvature=curvature)
    objects = tuple(map(_object, case["objects"]))
    contacts = 3 if len(objects) == 3 else 2
    return jw.Scene(
        whisker, objects if len(objects) > 1 else next(iter(objects)), jw.Support(tuple(springs)), contacts=contacts
    )


def changed(case: dict, paths: list, values) -> dict:
    """A case with other numbers in these places."""
    case = copy.deepcopy(case)
    for path, value in zip(paths, values, strict=True):
        part = case
        for key in path[:-1]:
            part = part[key]
        part[path[-1]] = value
    return case


def number_at(case: dict, path: list) -> float:
    """The number of a case in one place."""
    for key in path:
        case = case[key]
    return case  # pyright: ignore[reportReturnType]


@cache
def scanned(name: str) -> jw.Result:
    """The scan of a stored case, at its start and at its controls."""
    case = CASES[name]
    return jw.scan(scene_of(case), np.array([case["start"], *case["control"]]))


def contacts_of(state, whisker: int) -> list[list[float]]:
    """Phase, force, arc, x and y of the contacts of a whisker, from its base to its tip."""
    names = "phase", "contact_force", "contact_arc", "contact_x", "contact_y"
    table = np.stack([np.asarray(getattr(state, name))[whisker] for name in names], axis=1)
    return table[table[:, 0] != jw.Phase.free][::-1].tolist()
