"""States, events and results of scans in space."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxwhisker._base.leaves import Deferred, deferred
from jaxwhisker._model.space_scene import SpaceScene
from jaxwhisker._scan.result import AbstractResult, Events


class SpaceState(eqx.Module):
    """Whiskers in equilibrium in space, in the scene's frame and units; in a result with a leading axis of steps.

    The reactions and all contact fields of a free whisker are zero.
    """

    fx: Float[Array, "*steps whiskers"]  # support reaction on the whisker: force along +x
    fy: Float[Array, "*steps whiskers"]
    fz: Float[Array, "*steps whiskers"]
    mx: Float[Array, "*steps whiskers"]  # moment about the displaced base, right-handed about +x
    my: Float[Array, "*steps whiskers"]
    mz: Float[Array, "*steps whiskers"]
    base_x: Float[Array, "*steps whiskers"]  # position of the base, a length
    base_y: Float[Array, "*steps whiskers"]
    base_z: Float[Array, "*steps whiskers"]
    base_rotation: Float[Array, "*steps whiskers 3 3"]  # columns: d1, d2 and the tangent d3 at the base
    contact_force: Float[Array, "*steps whiskers"]  # size of the force of the object on the whisker
    contact_arc: Float[Array, "*steps whiskers"]  # arc length from base to contact
    contact_x: Float[Array, "*steps whiskers"]  # contact point, a length
    contact_y: Float[Array, "*steps whiskers"]
    contact_z: Float[Array, "*steps whiskers"]
    phase: Int[Array, "*steps whiskers"]  # Phase.free, .tip, .tangential
    # The following fields are None without friction: whether a contact slips (1) or sticks (0), and the parts of the
    # contact force: that along the object's normal (>= 0), and friction, which acts on the whisker along the object.
    slip: Int[Array, "*steps whiskers"] | None = eqx.field(default=None, kw_only=True)
    normal_force: Float[Array, "*steps whiskers"] | None = eqx.field(default=None, kw_only=True)
    friction_x: Float[Array, "*steps whiskers"] | None = eqx.field(default=None, kw_only=True)
    friction_y: Float[Array, "*steps whiskers"] | None = eqx.field(default=None, kw_only=True)
    friction_z: Float[Array, "*steps whiskers"] | None = eqx.field(default=None, kw_only=True)
    in_space = True

    @property
    def force(self) -> Float[Array, "*steps whiskers 3"]:
        """Support reaction, force (fx, fy, fz)."""
        return jnp.stack([self.fx, self.fy, self.fz], axis=-1)

    @property
    def moment(self) -> Float[Array, "*steps whiskers 3"]:
        """Support reaction, moment (mx, my, mz)."""
        return jnp.stack([self.mx, self.my, self.mz], axis=-1)

    @property
    def own_force(self) -> Float[Array, "*steps whiskers 3"]:
        """Support reaction, force along d1, d2 and d3 of each whisker's base."""
        return jnp.sum(self.base_rotation * self.force[..., :, None], axis=-2)

    @property
    def own_moment(self) -> Float[Array, "*steps whiskers 3"]:
        """Support reaction, moment about d1, d2 and d3 of each whisker's base."""
        return jnp.sum(self.base_rotation * self.moment[..., :, None], axis=-2)


class SpaceEvents(Events):
    """The events of a scan in order: arrays of fixed size, of which the first `count` are filled."""

    before: SpaceState  # fields (events, whiskers)
    after: SpaceState


class SpaceResult(AbstractResult, SpaceState):
    """A scan in space: the states at all steps, with shape (steps, whiskers), and the events.

    A step whose status is not `Status.ok` holds NaN; its phase is `free`.
    """

    control: Float[Array, " steps"]  # drive position: a length, an angle in rad or a number, depending on the motion
    spring_length: Float[Array, "steps springs"]  # of torsion springs, angles, rad; in the frame of the drive
    status: Int[Array, " steps"]  # Status.ok, or the reason for failure
    deferred_events: Deferred = eqx.field(converter=deferred)
    scene: SpaceScene
