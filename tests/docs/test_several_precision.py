"""The benchmark of several contacts, without other simulators: its discrete rod, and what its figures rest on."""

import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

from common import read
from peers import linked_rod
from peers.scene import Circle, Circles

# isort: split
from several_cases import CASES

SCENE, STORED = Circles(), CASES["two_circles"]
CONTROL = np.array(STORED["control"])
REFERENCE = np.stack([np.array(STORED[name])[:, 0] for name in ("fx", "fy", "mz")], axis=1)
JUMP = STORED["events"][-1]["control"]
BEFORE = CONTROL > JUMP + 0.05
COARSE = 20, 0.01  # links, and the largest error relative to the peaks
FINER = 40, 0.003
TOUCHING_TWICE = -0.68
SMALL = 1e-5  # change of the drive
EXACT = 1e-6  # of forces from differences of energies


@cache
def scanned(links, at_nodes=False):
    return linked_rod.scan(SCENE, CONTROL, links, at_nodes)


def error(reactions):
    return np.max(np.abs(reactions - REFERENCE)[BEFORE] / np.max(np.abs(REFERENCE), axis=0))


@pytest.mark.parametrize(("links", "largest"), [COARSE, FINER])
def test_the_discrete_rod_agrees_with_the_stored_scan(links, largest):
    assert error(scanned(links)) < largest


def test_contacts_between_hinges_are_more_accurate_than_contacts_at_hinges():
    assert 10 * error(scanned(FINER[0])) < error(scanned(FINER[0], at_nodes=True))


def test_the_discrete_rod_comes_free_where_the_whisker_jumps():
    assert np.all(scanned(FINER[0])[CONTROL < JUMP] == 0)


def test_the_force_of_the_drive_is_the_slope_of_the_energy():
    rod = linked_rod.Rod(SCENE, FINER[0])
    for u in CONTROL[CONTROL >= TOUCHING_TWICE]:
        rod.settle(u)

    def energy(u):
        rod.settle(u)
        return (rod.angles - np.pi / 2) @ rod.bending @ (rod.angles - np.pi / 2) / 2

    slope = (energy(TOUCHING_TWICE + SMALL) - energy(TOUCHING_TWICE - SMALL)) / (2 * SMALL)
    fx = rod.settle(TOUCHING_TWICE)[0]
    assert np.count_nonzero(rod.forces.max(axis=1)) == 2
    assert slope == pytest.approx(fx, abs=EXACT)


def test_the_circles_are_those_of_the_stored_scan():
    stored = [Circle(distance=o["distance"], radius=o["radius"]).circles[0] for o in STORED["objects"]]
    moved = [(x + o["position"], y, r) for (x, y, r), o in zip(stored, STORED["objects"], strict=True)]
    assert np.array(moved) == pytest.approx(np.array(SCENE.circles), abs=1e-15)


def test_every_method_is_measured():
    methods = {row["method"] for row in read("several_precision")["rows"]}
    assert methods == {
        "jaxwhisker",
        "jaxwhisker, motion",
        "discrete rod",
        "discrete rod, contact at hinges",
        "MuJoCo",
        "Exudyn",
        "PyElastica",
    }
