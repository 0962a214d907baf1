"""Rods in space: error of the base against run time, in a batch.

python benchmarks/space_rod.py

Random rods with loads and angles as in scans: uniform ones with f s1^2 up to 3.5, cones 5:1 whose load is a third of
that. Derivatives are those with respect to force, arc length, angle and roll. The error is the largest one of position
and quaternion among all rods, against 128 steps. Rods in the plane (`Shooting`) have three derivatives. Times are lower
quartiles.
"""

import jax

jax.config.update("jax_enable_x64", True)

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from common import interleaved, write
from jaxwhisker._rod.space import SpaceSection
from jaxwhisker._rod.space_end import space_rod_end

LANES, STEPS, EXACT = 1024, (4, 6, 8, 12, 16, 24), 128


class Cone(eqx.Module):
    """Bending stiffness of a cone."""

    taper: float

    def __call__(self, s):
        return (1 - self.taper * s) ** 4


KINDS = {
    "curved": SpaceSection(1.0, None, (None, -0.8, None)),
    "curved, torsion": SpaceSection(1.0, 0.7, (None, -0.8, None)),
    "curved and twisted, torsion": SpaceSection(1.0, 0.7, (None, -0.8, 0.5)),
    "cone, curved": SpaceSection(Cone(0.8), None, (None, -0.8, None)),
    "cone, curved, torsion": SpaceSection(Cone(0.8), 0.7, (None, -0.8, None)),
}


def rods(share: float) -> jax.Array:
    """Random force, arc length, angle and roll."""
    rng = np.random.default_rng(0)
    arc = rng.uniform(0.5, 1.0, LANES)
    force = share * rng.uniform(0.3, 1.0, LANES) * 3.5 / arc**2
    chi = np.where(rng.uniform(size=LANES) < 0.5, 0.0, rng.uniform(0.0, 1.2, LANES))
    return jnp.stack([force, arc, chi, rng.uniform(-np.pi, np.pi, LANES)], axis=1)


def compiled(one, at):
    """Value, and value with derivatives, of a batch."""

    def both(z):
        return jax.jacfwd(lambda z: (one(z),) * 2, has_aux=True)(z)

    return [jax.jit(jax.vmap(function)).lower(at).compile() for function in (one, both)]


def main() -> None:
    """Measure and store."""
    ends = {"plane": lambda n: lambda z: jw.Shooting(n).end(*z[:3])}
    for name, section in KINDS.items():
        ends[name] = lambda n, section=section: lambda z: space_rod_end(*z, section, n, n)
    rows = []
    for name, end in ends.items():
        at = rods(0.3 if "cone" in name else 1.0)[:, : 3 if name == "plane" else 4]
        exact = jax.jit(jax.vmap(end(EXACT)))(at)
        programs = {n: compiled(end(n), at) for n in STEPS}
        calls = {
            (n, k): lambda p=p, at=at: jax.block_until_ready(p(at)) for n in STEPS for k, p in enumerate(programs[n])
        }
        times = interleaved(calls, repeats=41)
        for n in STEPS:
            rows.append({
                "rod": name,
                "steps": n,
                "error": float(jnp.max(jnp.abs(programs[n][0](at) - exact))),
                "us per rod": times[n, 0]["lower"] / LANES * 1e6,
                "with derivatives, us": times[n, 1]["lower"] / LANES * 1e6,
            })  # fmt: skip
    write("space_rod", rows)


if __name__ == "__main__":
    main()
