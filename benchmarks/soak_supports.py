"""Random scenes on supports that yield in every direction, with mounts, coupled by torsion, turning, curved cones.

python benchmarks/soak_supports.py [scenes of a kind]     default 1,024; some minutes on two cores

Counts what is refused. States are equilibria and stable by the engine's own checks at every step; that those are right
is tested against forward shooting and against chains of links. Scenes whose bases move along x only are solved both as
such and as what they are a special case of.
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
    """Bending stiffness of a cone that loses this share of its diameter."""

    share: float

    def __call__(self, s):
        return (1 - self.share * s) ** 4


def spring(p, mount=None):
    """A spring along x: stiffness, rest length; distance and a of a parabola."""
    return jw.Scene(jw.Whisker(), jw.Parabola(p[2], p[3]), jw.Support((jw.Spring((0, 1), p[0], p[1]),), mount)), CONTROL


def follicle(p):
    """Three stiffnesses; distance, a; angle and height of the mount."""
    support = jw.Support.follicle(p[0], p[1], p[2], mount=jw.Mount(0.0, p[6], p[5]))
    return jw.Scene(jw.Whisker(), jw.Parabola(p[3], p[4]), support), CONTROL


def coupled(p):
    """Two whiskers: stiffnesses along x and in angle; distance, a; rest length between them."""
    springs = [
        ((0, 1), p[0], 0.1, "x"),
        ((1, 2), p[1], p[6], "x"),
        ((0, 1), p[2], 0.0, "phi"),
        ((1, 2), p[3], 0.0, "phi"),
    ]
    return jw.Scene(jw.Whisker(), jw.Parabola(p[4], p[5]), jw.Support(tuple(jw.Spring(*s) for s in springs))), CONTROL


def turning(p):
    """Stiffness along x and in angle; height of the pivot; distance and radius of a circle."""
    scene = jw.Scene(jw.Whisker(), jw.Circle(p[3], p[4]), jw.Support.follicle(x=p[0], phi=p[1]))
    return eqx.tree_at(lambda s: s.motion, scene, jw.Rotation((0.0, p[2]), -p[2])), ANGLES


def curved(p):
    """A curved cone on a follicle: three stiffnesses; distance, a; angle of the mount; taper, curvature."""
    support = jw.Support.follicle(p[0], p[1], p[2], mount=jw.Mount(angle=p[5]))
    return jw.Scene(jw.Whisker(1.0, Cone(p[6]), p[7]), jw.Parabola(p[3], p[4]), support), CONTROL


# Ranges: of exponents of ten in lists, else of values.
KINDS = {
    "a spring along x": (spring, [[0.5, 4], (0, 0.3), (0.1, 0.9), [-1, 1]]),
    "the same, with every pose": (lambda p: spring(p, jw.Mount()), [[0.5, 4], (0, 0.3), (0.1, 0.9), [-1, 1]]),
    "follicle, mounted askew": (follicle, [[1, 4], [1.5, 5], [0, 3], (0.1, 0.7), [-1, 1], (-0.3, 0.3), (-0.05, 0.1)]),
    "two coupled by torsion": (coupled, [[1, 4], [1, 4], [0, 3], [0, 3], (0.1, 0.7), [-1, 1], (0.05, 0.4)]),
    "turning about a pivot": (turning, [[1, 4], [0.3, 3], (-1, -0.1), (0.5, 0.9), [-1, 0.5]]),
    "curved cone on a follicle": (
        curved,
        [[1.3, 4], [1.5, 5], [0.3, 3], (0.1, 0.6), [-1, 1], (-0.3, 0.3), (0, 0.8), (-0.8, 0.8)],
    ),
}


def drawn(ranges, count, seed):
    """Random parameters."""
    rng = np.random.default_rng(seed)
    columns = [rng.uniform(low, high, count) for low, high in ranges]
    columns = [10**column if isinstance(r, list) else column for column, r in zip(columns, ranges, strict=True)]
    return jnp.asarray(np.stack(columns, axis=-1))


def main():
    """Write the results."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1024
    rows, moments = [], {}
    for kind, (build, ranges) in KINDS.items():

        def scanned(p, build=build):
            scene, control = build(p)
            result = jw.scan(scene, control)
            return result.mz, result.status, result.events.count

        mz, status, events = (np.asarray(leaf) for leaf in jax.jit(jax.vmap(scanned))(drawn(ranges, count, 7)))
        moments[kind] = np.where(status[..., None] == jw.Status.ok, mz, np.nan)
        refused = np.any(status != jw.Status.ok, axis=1)
        why = {jw.Status(int(s)).name for s in np.unique(status)} - {"ok"}
        rows.append({
            "scenes": kind, "number": count, "events": int(events.sum()), "steps ok": f"{np.mean(status == 0):.3%}",
            "scenes with a step refused": int(refused.sum()), "why": ", ".join(sorted(why)),
        })  # fmt: skip
        print(rows[-1], flush=True)
        jax.clear_caches()
    one, other = moments["a spring along x"], moments["the same, with every pose"]
    rows[1]["largest difference of mz to the row above"] = float(np.nanmax(np.abs(one - other)))
    write("soak_supports", rows)


if __name__ == "__main__":
    main()
