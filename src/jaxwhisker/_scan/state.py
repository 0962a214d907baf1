"""The state of the whiskers in equilibrium, in the plane and in space."""

from typing import Any, overload

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxwhisker._model.motion import Pose
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod import rod

PerWhisker = Float[Array, "*whiskers"]  # (whiskers,) or (steps, whiskers); of one whisker, without this axis
# With a last axis of contacts if whiskers may have several:
PerContact = PerWhisker | Float[Array, "*whiskers contacts"]
NumberPerContact = Int[Array, "*whiskers"] | Int[Array, "*whiskers contacts"]


class State(eqx.Module):
    """Whiskers in equilibrium, in the scene's units; every field has shape (whiskers,), in a Result (steps, whiskers).

    If whiskers may have several contacts (see `Scene`), the contact fields and `phase` have a last axis of contacts, in
    order from the tip to the base; places that are not used are free, and follow. All contact fields of a free whisker
    are zero, and so are the reactions, unless the whisker has a weight or springs on its shaft.
    """

    base_x: PerWhisker  # position of the base, a length
    base_y: PerWhisker
    base_angle: PerWhisker  # angle of the base to the upright, rad, counter-clockwise positive
    fx: PerWhisker  # support reaction on the whisker: force along +x
    fy: PerWhisker  # force along +y
    mz: PerWhisker  # moment, counter-clockwise positive
    contact_force: PerContact  # f >= 0, a force
    contact_slope: PerContact  # slope angle alpha of the object, rad, positive: rises towards +x
    contact_arc: PerContact  # arc length from base to contact
    contact_x: PerContact  # contact point, a length
    contact_y: PerContact
    phase: NumberPerContact  # Phase.free, .tip, .tangential
    # The following fields are None without friction: the direction of slip along the object (+1 towards +x, -1 towards
    # -x, 0 if the contact sticks), and the parts of the contact force along the normal (>= 0) and, positive towards +x,
    # along the object.
    slip: NumberPerContact | None = eqx.field(default=None, kw_only=True)
    normal_force: PerContact | None = eqx.field(default=None, kw_only=True)
    friction_force: PerContact | None = eqx.field(default=None, kw_only=True)
    # None with one object: the number of the object that is touched, in the order of the scene's profiles: 1, 2, ...
    contact_object: NumberPerContact | None = eqx.field(default=None, kw_only=True)
    # The loads on the whisker of the springs whose second end is on its shaft and whose first end is on another one:
    # for each spring, the force along x, along y, and the moment, in the drive's frame. None without such springs.
    shaft_loads: tuple[PerWhisker, ...] | None = eqx.field(default=None, kw_only=True)


class SpaceState(eqx.Module):
    """Whiskers in equilibrium in space, in the scene's frame and units; in a result with a leading axis of steps.

    If whiskers may have several contacts (see `SpaceScene`), the contact fields and `phase` have a last axis of
    contacts, in order from the tip to the base; places that are not used are free, and follow. The reactions and all
    contact fields of a free whisker are zero.
    """

    fx: PerWhisker  # support reaction on the whisker: force along +x
    fy: PerWhisker
    fz: PerWhisker
    mx: PerWhisker  # moment about the displaced base, right-handed about +x
    my: PerWhisker
    mz: PerWhisker
    base_x: PerWhisker  # position of the base, a length
    base_y: PerWhisker
    base_z: PerWhisker
    base_rotation: Float[Array, "*whiskers 3 3"]  # columns: d1, d2 and the tangent d3 at the base
    contact_force: PerContact  # size of the force of the object on the whisker
    contact_arc: PerContact  # arc length from base to contact
    contact_x: PerContact  # contact point, a length
    contact_y: PerContact
    contact_z: PerContact
    phase: NumberPerContact  # Phase.free, .tip, .tangential
    # The following fields are None without friction: whether a contact slips (1) or sticks (0), and the parts of the
    # contact force: that along the object's normal (>= 0), and friction, which acts on the whisker along the object.
    slip: NumberPerContact | None = eqx.field(default=None, kw_only=True)
    normal_force: PerContact | None = eqx.field(default=None, kw_only=True)
    friction_x: PerContact | None = eqx.field(default=None, kw_only=True)
    friction_y: PerContact | None = eqx.field(default=None, kw_only=True)
    friction_z: PerContact | None = eqx.field(default=None, kw_only=True)
    # None with one object: the number of the object that is touched, in the order of the scene's objects: 1, 2, ...
    contact_object: NumberPerContact | None = eqx.field(default=None, kw_only=True)
    in_space = True

    @property
    def force(self) -> Float[Array, "*whiskers 3"]:
        """Support reaction, force (fx, fy, fz)."""
        return jnp.stack([self.fx, self.fy, self.fz], axis=-1)

    @property
    def moment(self) -> Float[Array, "*whiskers 3"]:
        """Support reaction, moment (mx, my, mz)."""
        return jnp.stack([self.mx, self.my, self.mz], axis=-1)

    @property
    def own_force(self) -> Float[Array, "*whiskers 3"]:
        """Support reaction, force along d1, d2 and d3 of each whisker's base."""
        return jnp.sum(self.base_rotation * self.force[..., :, None], axis=-2)

    @property
    def own_moment(self) -> Float[Array, "*whiskers 3"]:
        """Support reaction, moment about d1, d2 and d3 of each whisker's base."""
        return jnp.sum(self.base_rotation * self.moment[..., :, None], axis=-2)


FRICTION = ("slip", "normal_force", "friction_force")  # fields that are None without friction
FRICTION_IN_SPACE = ("slip", "normal_force", "friction_x", "friction_y", "friction_z")  # the same in space
OBJECTS = ("contact_object",)  # fields that are None with a single object
# Fields of states in space only.
IN_SPACE = ("fz", "mx", "my", "base_z", "base_rotation", "contact_z", "friction_x", "friction_y", "friction_z")
OPTIONAL = (*FRICTION, *OBJECTS, "shaft_loads", *IN_SPACE)  # fields that not every state has


@overload
def state_of(state: State) -> State: ...
@overload
def state_of(state: SpaceState) -> SpaceState: ...
def state_of(state: Any) -> Any:
    """The fields of a state, without what a result holds besides."""
    kind = SpaceState if isinstance(state, SpaceState) else State
    fields = {name: getattr(state, name) for name in kind.__dataclass_fields__}
    return kind(**jax.tree.map(jnp.asarray, fields))


def base_of(state: State) -> Pose:
    """The poses of the bases."""
    return Pose(state.base_x, state.base_y, state.base_angle)


def material(whisker: Whisker) -> rod.Material:
    """The rod's material, in the whisker's own units."""
    return whisker.base_stiffness if whisker.uniform else whisker.section(1.0, 1.0)
