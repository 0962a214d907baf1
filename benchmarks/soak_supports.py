"""Soak test of supports: springs along all axes, mounts, coupling by torsion, rotation, curved cones.

python benchmarks/soak_supports.py [scenes per kind]     default 1,024; a few minutes on two cores

Counts failed steps. The package itself checks equilibrium and stability at every step; the tests compare these checks
with forward shooting and with chains of links. Scenes whose bases move along x only are solved twice: in the special
case and in the general one.
"""

import sys

import jax

jax.config.update("jax_enable_x64", True)

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from common import write

CONTROL = np.linspace(1.6, -3.0, 100)
ANGLES = np.linspace(-1.5, 1.5, 100)


class Cone(eqx.Module):
    """Bending stiffness of a cone whose diameter falls by a fraction `share` from base to tip."""

    share: float

    def __call__(self, s):
        return (1 - self.share * s) ** 4


def spring(p, mount=None):
    """A spring along x. Parameters: stiffness, rest length; distance and a of the parabola."""
    return jw.Scene(jw.Whisker(), jw.Parabola(p[2], p[3]), jw.Support((jw.Spring((0, 1), p[0], p[1]),), mount)), CONTROL


def follicle(p):
    """A follicle. Parameters: three stiffnesses; distance, a; angle and height of the mount."""
    support = jw.Support.follicle(p[0], p[1], p[2], mount=jw.Mount(0.0, p[6], p[5]))
    return jw.Scene(jw.Whisker(), jw.Parabola(p[3], p[4]), support), CONTROL


def coupled(p):
    """Two whiskers. Parameters: stiffnesses along x and in angle; distance, a; rest length between the bases."""
    springs = [
        ((0, 1), p[0], 0.1, "x"),
        ((1, 2), p[1], p[6], "x"),
        ((0, 1), p[2], 0.0, "phi"),
        ((1, 2), p[3], 0.0, "phi"),
    ]
    return jw.Scene(jw.Whisker(), jw.Parabola(p[4], p[5]), jw.Support(tuple(jw.Spring(*s) for s in springs))), CONTROL


def rotation(p):
    """A rotation. Parameters: stiffness along x and in angle; height of the pivot; distance and radius of a circle."""
    scene = jw.Scene(jw.Whisker(), jw.Circle(p[3], p[4]), jw.Support.follicle(x=p[0], phi=p[1]))
    return eqx.tree_at(lambda s: s.motion, scene, jw.Rotation((0.0, p[2]), -p[2])), ANGLES


def curved(p):
    """A curved cone. Parameters: three stiffnesses; distance, a; angle of the mount; taper, curvature."""
    support = jw.Support.follicle(p[0], p[1], p[2], mount=jw.Mount(angle=p[5]))
    return jw.Scene(jw.Whisker(1.0, Cone(p[6]), p[7]), jw.Parabola(p[3], p[4]), support), CONTROL


# Ranges of the parameters: tuples are values, lists are exponents of ten.
KINDS = {
    "a spring along x": (spring, [[0.5, 4], (0, 0.3), (0.1, 0.9), [-1, 1]]),
    "the same, all axes": (lambda p: spring(p, jw.Mount()), [[0.5, 4], (0, 0.3), (0.1, 0.9), [-1, 1]]),
    "follicle with a tilted mount": (
        follicle,
        [[1, 4], [1.5, 5], [0, 3], (0.1, 0.7), [-1, 1], (-0.3, 0.3), (-0.05, 0.1)],
    ),
    "two whiskers coupled by torsion": (coupled, [[1, 4], [1, 4], [0, 3], [0, 3], (0.1, 0.7), [-1, 1], (0.05, 0.4)]),
    "rotation about a pivot": (rotation, [[1, 4], [0.3, 3], (-1, -0.1), (0.5, 0.9), [-1, 0.5]]),
    "curved cone on a follicle": (
        curved,
        [[1.3, 4], [1.5, 5], [0.3, 3], (0.1, 0.6), [-1, 1], (-0.3, 0.3), (0, 0.8), (-0.8, 0.8)],
    ),
}


def drawn(ranges, count, seed):
    """Draw random parameters."""
    rng = np.random.default_rng(seed)
    columns = [rng.uniform(low, high, count) for low, high in ranges]
    columns = [10**column if isinstance(r, list) else column for column, r in zip(columns, ranges, strict=True)]
    return jnp.asarray(np.stack(columns, axis=-1))


def main() -> None:
    """Measure and store."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1024
    rows, moments = [], {}
    for kind, (build, ranges) in KINDS.items():

        def scanned(p, build=build):
            scene, control = build(p)
            result = jw.scan(scene, control)
            return result.mz, result.status, result.events.count

        mz, status, events = (np.asarray(leaf) for leaf in jax.jit(jax.vmap(scanned))(drawn(ranges, count, 7)))
        moments[kind] = np.where(status[..., None] == jw.Status.ok, mz, np.nan)
        failed = np.any(status != jw.Status.ok, axis=1)
        names = {jw.Status(int(s)).name for s in np.unique(status)} - {"ok"}
        rows.append({
            "kind": kind, "scenes": count, "events": int(events.sum()), "steps ok": f"{np.mean(status == 0):.3%}",
            "scenes with a failed step": int(failed.sum()), "status": ", ".join(sorted(names)),
        })  # fmt: skip
        print(rows[-1], flush=True)
        jax.clear_caches()
    one, other = moments["a spring along x"], moments["the same, all axes"]
    rows[1]["largest difference in mz from the row above"] = float(np.nanmax(np.abs(one - other)))
    write("soak_supports", rows)


if __name__ == "__main__":
    main()
