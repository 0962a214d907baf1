"""Contact states: what the begin and the end of contacts change, and what they leave as it is."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.contact_state import ContactState, all_free
from jaxwhisker._equilibrium.dimensionless import problem_of
from jaxwhisker._equilibrium.friction import Friction

# A tip contact that sticks, a tangential one that slips, and a whisker that is free and stands on the left.
PHASE, SIDE, SLIP, PIECE = [1, 2, 0], [1.0, -1.0, -1.0], [0, -1, 1], [3, 2, 0]
PARAMETER, BEYOND = [0.3, 0.0, 0.0], [0.1, 0.0, 0.0]
BESIDE = [[1.0, -1.0, -1.0], [-1.0, 1.0, 1.0]]


def state_of(*, sides=None):
    friction = Friction(jnp.array(SLIP), jnp.array(PARAMETER), jnp.array(BEYOND))
    return ContactState(jnp.array(PHASE), jnp.array(SIDE), friction, jnp.array(PIECE), sides)


def listed(values):
    """The values as lists; they exist."""
    assert values is not None
    return jax.tree.map(lambda leaf: leaf.tolist(), values)


def values(state):
    """Phases, sides, slips and pieces."""
    return tuple(map(listed, (state.phase, state.side, state.friction.slip, state.piece)))


def test_what_whiskers_do_follows_from_phase_and_slip():
    state = state_of()
    assert state.free.tolist() == [False, False, True]
    assert state.touches.tolist() == [True, True, False]
    assert state.sticks.tolist() == [True, False, False]
    stuck = state._replace(friction=Friction(jnp.zeros(3, int), jnp.zeros(3), jnp.zeros(3)))
    assert stuck.sticks.tolist() == [True, True, False]


def test_contacts_that_end_leave_whiskers_free_that_slip_towards_the_vertex_when_they_touch_again():
    state = state_of()
    which = jnp.array([True, False, False])
    ended = state.ended(which)
    assert values(ended) == ([0, 2, 0], SIDE, [-1, -1, 1], [0, 2, 0])
    # Each now stands on a given side, but only those whose contact has ended.
    turned = state.ended(jnp.array([True, True, False]), jnp.array([-1.0, 1.0, 1.0]))
    assert values(turned) == ([0, 0, 0], [-1.0, 1.0, -1.0], [1, -1, 1], [0, 0, 0])
    assert values(state.ended(jnp.zeros(3, bool), -state.side)) == values(state)


def test_contacts_begin_slipping_towards_the_vertex():
    state, which = state_of(), jnp.array([False, False, True])
    begun = state.begun(which, jnp.array([2, 1, 2]), jnp.array([-1.0, 1.0, 1.0]), jnp.array([9, 9, 5]))
    assert values(begun) == ([1, 2, 2], [1.0, -1.0, 1.0], [0, -1, -1], [3, 2, 5])
    # Without pieces of the touches, those of the state stay.
    assert values(state.begun(which, jnp.array([2, 1, 1]), -state.side, None))[3] == PIECE
    smooth = ContactState(jnp.array(PHASE), jnp.array(SIDE)).begun(which, jnp.array([0, 0, 1]), jnp.ones(3), None)
    assert smooth.phase.tolist() == [1, 2, 1] and smooth.side.tolist() == [1.0, -1.0, 1.0]
    assert smooth.friction is None and smooth.piece is None and smooth.sides is None


def test_a_contact_that_ends_where_it_began_leaves_the_state_as_it_was():
    state, which = state_of().ended(jnp.ones(3, bool)), jnp.array([True, True, False])
    there = state.begun(which, jnp.array([1, 2, 1]), state.side, jnp.array([4, 1, 1]))
    assert values(there)[0] == [1, 2, 0]
    assert values(there.ended(which)) == values(state)


def test_whiskers_stand_on_a_side_of_each_of_several_objects():
    one, several = state_of(), state_of(sides=jnp.array(BESIDE))
    assert one.standing is one.side and several.standing is several.sides
    number = jnp.array([1, 0, 1])
    assert several.side_of(number).tolist() == [-1.0, -1.0, 1.0]
    assert one.side_of(number) is one.side and several.side_of(None) is several.side
    assert listed(several.now_standing(-jnp.array(BESIDE)).sides) == (-np.array(BESIDE)).tolist()
    assert several.now_standing(-jnp.array(BESIDE)).side.tolist() == SIDE
    assert one.now_standing(jnp.ones(3)).side.tolist() == [1.0, 1.0, 1.0]
    # The end of a contact says where its whisker stands, of all objects.
    ended = several.ended(jnp.array([False, True, False]), -jnp.array(BESIDE))
    assert listed(ended.sides) == [[1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]
    assert ended.side.tolist() == SIDE and ended.phase.tolist() == [1, 0, 0]


def test_contacts_remember_where_they_began_to_stick():
    state, places = state_of(), (jnp.array([0.5, 0.6, 0.7]), jnp.array([0.2, 0.3, 0.4]))
    assert listed(state.places) == (PARAMETER, BEYOND)
    moved = state.stuck_at(places)
    assert moved.places == places and values(moved) == values(state)
    assert state.stuck_at(None) is state
    smooth = ContactState(jnp.array(PHASE), jnp.array(SIDE))
    assert smooth.places is None and smooth.stuck_at(places) is smooth


@pytest.mark.parametrize("several", [False, True])
def test_whiskers_are_free_before_the_first_touch(several):
    profile = (jw.Circle(0.2, 0.3), jw.Circle(0.3, 0.2, -1.0)) if several else jw.Parabola(0.2)
    scene = jw.Scene(jw.Whisker(), profile, jw.Support.fbfb(70.0), jw.ClosedForm(), friction=None if several else 0.2)
    sides = jnp.array([[1.0, -1.0], [-1.0, 1.0]]) if several else jnp.array([1.0, -1.0])
    state = Program(lambda scene, sides: all_free(problem_of(scene), sides))(scene, sides)
    assert state.phase.tolist() == [int(Phase.free)] * 2 and state.free.all()
    assert state.side.tolist() == [1.0, -1.0]
    if several:
        assert state.friction is None and state.piece.tolist() == [0, 0]
        assert state.sides.tolist() == sides.tolist()
    else:
        assert state.friction.slip.tolist() == [-1, 1] and state.piece is None and state.sides is None
