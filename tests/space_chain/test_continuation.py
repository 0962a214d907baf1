"""What the march finds of whiskers in space with several contacts."""

import numpy as np

import jaxwhisker as jw
import pegs
from engine import dimensionless
from jaxwhisker._space_chain.continuation import ContinuationOfChainInSpace


def test_there_is_room_for_the_nodes_of_all_contacts():
    march = ContinuationOfChainInSpace(dimensionless(pegs.scene(pegs.ALONG_Z)))
    assert march.rows == 2
    assert march.capacity(2) == 600
    assert march.margin_noise < 1e-10


def test_whiskers_go_either_way_where_pegs_push_only_up():
    """A whisker at objects that are flat along z loses its stability exactly where the force along x vanishes."""
    events = pegs.scan().events
    last = int(events.count) - 1
    assert jw.EventKind(int(events.kind[last])) == jw.EventKind.bifurcation
    np.testing.assert_allclose(events.before.fx[last, 0], 0.0, atol=1e-5)
    assert float(events.before.fy[last, 0]) > 1
    assert jw.Status(int(pegs.scan().status[-1])) == jw.Status.undetermined
