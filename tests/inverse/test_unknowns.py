"""Unknowns: their names, and which of them each recording shares with others."""

import numpy as np
import pytest

from jaxwhisker._inverse.channels import Channels
from jaxwhisker._inverse.gains import gains_from
from jaxwhisker._inverse.unknowns import split, unknowns_of


def unknowns(names, offsets=(), gains=(), shift=False, individual=(), recordings=1, channels=None):
    """Unknowns with these offsets and factors, pairs (whisker, channel) of two whiskers."""
    channels = channels or Channels()
    scale = gains_from(bool(gains), channels, 2).of_measured(gains)
    return unknowns_of(names, channels, offsets, scale, shift, individual, recordings)


def test_names_of_one_recording():
    assert unknowns(["c"], [(0, 0), (0, 2)], shift=True).all_names == ("c", "offset_fx", "offset_mz", "shift")
    assert unknowns([], [(0, 0), (1, 2)]).all_names == ("offset_fx_1", "offset_mz_2")
    channels = Channels(("bend",), lambda result, mix: {"bend": result.mz}, ("mix",))
    assert unknowns(["c"], gains=[(0, 0)], channels=channels).all_names == ("c", "mix", "gain_bend")


def test_recordings_share_what_is_not_individual():
    several = unknowns(["c", "mu"], [(0, 2)], [(0, 2)], True, {"mu": ["a", "b", "a"], "offsets": [1, 2, 3]}, 3)
    assert several.all_names == (
        *("c", "mu[a]", "mu[b]", "offset_mz[1]", "offset_mz[2]", "offset_mz[3]", "gain_mz", "shift"),
    )
    of_last = [several.all_names[k] for k in several.columns[2]]
    assert of_last == ["c", "mu[a]", "offset_mz[3]", "gain_mz", "shift"]
    assert several.scene_values(np.arange(8.0), 1) == {"c": 0.0, "mu": 2.0}
    np.testing.assert_array_equal(several.linear, [0, 0, 0, 1, 1, 1, 1, 0])
    np.testing.assert_array_equal(several.crosstalk, np.zeros(8, bool))
    np.testing.assert_array_equal(several.own_index, [0, 1, 1, 2, 2, 2, 3, 4])
    parts = split(several, np.arange(5.0))
    assert [list(part) for part in parts] == [[0.0, 1.0], [], [2.0], [3.0], [4.0]]


def test_crosstalk_of_every_recording():
    matrix = np.eye(3)
    matrix[0, 1] = matrix[2, 2] = np.nan
    both = unknowns_of(["c"], Channels(), [], gains_from(matrix, Channels(), 1), True, ["gains"], 2)
    assert both.all_names == ("c", "gain_fx_fy[1]", "gain_fx_fy[2]", "gain_mz[1]", "gain_mz[2]", "shift")
    np.testing.assert_array_equal(both.crosstalk, [0, 1, 1, 0, 0, 0])
    np.testing.assert_array_equal(both.linear, [0, 1, 1, 1, 1, 0])


def test_names_alone_mean_one_value_for_each_recording():
    assert unknowns(["c", "mu"], individual=["mu"], recordings=2).all_names == ("c", "mu[1]", "mu[2]")


@pytest.mark.parametrize(
    ("individual", "named"),
    [("mu", "got 'mu'"), (["q"], "'q'"), ({"mu": ["a"]}, "each of the 2 recordings"), (3.0, "got 3.0")],
)
def test_wrong_arguments_are_named(individual, named):
    with pytest.raises(ValueError, match=f"`individual`.*{named}"):
        unknowns(["c", "mu"], individual=individual, recordings=2)
