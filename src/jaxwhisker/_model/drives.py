from typing import NamedTuple
import equinox as eqx, jax.numpy as jnp
from jaxwhisker._base.rotation import about, rotation_matrix
class Placement(NamedTuple):
    position: object
    rotation: object
class AbstractDrive(eqx.Module):
    pass
class LinearDrive(AbstractDrive):
    direction: tuple
    origin: tuple = (0., 0., 0.)
    ends = None
    onwards = 1
    def unit(self, length): return length
    def valid(self): return jnp.asarray(True)
    def placement(self, u):
        d = jnp.stack([jnp.asarray(x, float) for x in self.direction]); d = d / jnp.sqrt(jnp.sum(d**2))
        o = jnp.stack([jnp.asarray(x, float) for x in self.origin])
        return Placement(o + u * d, jnp.eye(3))
def placement_of(motion, u):
    if isinstance(motion, AbstractDrive): return motion.placement(u)
    x, y, a = motion.pose(u)
    return Placement(jnp.stack([x, y, 0 * x]), about(2, a))
def mount_in_space(mount):
    std = jnp.array([[1., 0, 0], [0, 0, 1.], [0, -1., 0]])
    return Placement(jnp.stack([jnp.asarray(mount.x, float), jnp.asarray(mount.y, float), jnp.zeros(())]), about(2, mount.angle) @ std)
