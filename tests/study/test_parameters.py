"""Points of a study and the blocks into which they are split."""

import numpy as np

import jaxwhisker as jw
from jaxwhisker._scan.dataset import VARIABLES
from jaxwhisker._study.parameters import FEW, LANES, Blocks, Parameters, blocks_of, parameters_of, split

AXES = {"a": np.arange(3.0), "b": np.arange(5.0)}
SIZES = {"control": 100, "whisker": 1, "spring": 1, "event": 48}
PLENTY = 1e12  # bytes


def test_points_are_numbered_with_the_last_dimension_running_fastest():
    grid, rows = Parameters(AXES, False), Parameters({"a": np.arange(4.0), "b": np.arange(4.0)}, True)
    assert (grid.total, rows.total) == (15, 4)
    assert grid.one(7) == {"a": 1.0, "b": 2.0} and rows.one(3) == {"a": 3.0, "b": 3.0}
    whole = grid.at((slice(0, 3), slice(0, 5)))
    for name, values in grid.numbered(np.arange(15)).items():
        np.testing.assert_array_equal(whole[name], values)


def test_masked_values_are_missing():
    def build(stiffness):
        return jw.Scene(jw.Whisker(), jw.Parabola(0.5), jw.Support.fb(stiffness, 0.2))

    values = np.ma.masked_equal([50.0, 60.0, 70.0], 60.0)
    table = {"stiffness": values}
    for read in (parameters_of(build, None, table, ()), parameters_of(build, table, {}, ())):
        np.testing.assert_array_equal(read.values["stiffness"], [50.0, np.nan, 70.0])


def test_a_few_points_are_spread_from_both_ends():
    grid = Parameters(AXES, False)
    assert grid.spread(4).tolist() == [0, 14, 4, 9]
    assert sorted(grid.spread(99).tolist()) == list(range(15))


def test_blocks_cover_all_points_once():
    for shape, most in (((7, 5), 6), ((3, 4, 5), 10), ((1000,), 64), ((2, 3), 100)):
        blocks, seen = split(shape, most), np.zeros(shape, int)
        assert blocks.lanes <= most
        for index in blocks.indices():
            seen[blocks.region(index)] += 1
        assert np.all(seen == 1)


def test_blocks_are_smaller_where_memory_is_short():
    quantities = [VARIABLES["fx"], VARIABLES["event_kind"]]

    def lanes(total, memory):
        return blocks_of((total,), SIZES, quantities, memory, 2).lanes

    assert lanes(100_000, PLENTY) == LANES and lanes(20, PLENTY) <= FEW and lanes(100_000, 1.21e9) < LANES
    assert blocks_of((20,), SIZES, quantities, 1.0, 2) == Blocks((20,), (1,))
