"""Scenes that together have every part of scenes and every argument of each part, for tests of files."""

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw

SPHERE = jw.Sphere(0.9, centre=(0.1, 1.3, 0.2))
CIRCLE = jw.Circle(0.3, 0.5, position=0.1)
CURVED = jw.Whisker(0.9, 0.3, -0.2, lateral_curvature=0.1, twist=0.2, torsion_ratio=0.8, lateral_ratio=2.0)
TABLE = jw.Whisker(
    1.0, jw.Table([0.0, 0.4, 1.0], [1.0, 0.7, 0.2]), jw.Polynomial([0.1, 0.2], length=1.0), breaks=(0.4,)
)
HEAVY = jw.Whisker(mass_per_length=0.1, tip_mass=0.2, base_mass=0.3, base_inertia=0.4)
CONE = jw.Whisker.conical(0.05, 3e9, 2e-4, 1e-5, density=1300.0, intrinsic_curvature=jw.ParabolicShape(2.0))
SOLVER = jw.Shooting(12, jw.Splitting(10), newton_tolerance=1e-8, newton_steps=12)
PAD = jw.Array({"x": [0.0, 0.3], "length": [1.0, 0.8], "taper": [0.3, 0.5], "spring_x": [5.0, 6.0]})


def planar(*objects, **parts) -> jw.Scene:
    return jw.Scene(parts.pop("whisker", jw.Whisker()), objects if len(objects) != 1 else objects[0], **parts)


def spatial(surface, **parts):
    return jw.Scene(parts.pop("whisker", jw.Whisker()), surface, **parts)


def supported(*springs, **parts) -> jw.Scene:
    return planar(jw.Parabola(0.2), support=jw.Support(springs, **parts))


SCENES = {
    "parabola": planar(jw.Parabola(0.2, 2.0, -0.1), whisker=HEAVY, friction=0.3, gravity=(0.5, -1)),
    "circle and digits": planar(jw.Circle(0.1 + 0.2, 1e-7, position=-1 / 3)),
    "arrays of JAX and NumPy": planar(jw.Circle(jnp.asarray(0.3), np.float64(0.7)), friction=jnp.asarray(0.2)),
    "integers": planar(jw.Parabola(1, 2), whisker=jw.Whisker(3)),
    "ellipse": planar(jw.Ellipse(0.2, 0.5, 0.3, 0.1), rod=jw.ClosedForm(newton_tolerance=1e-7, newton_steps=9)),
    "box": planar(jw.Box(0.3, 0.8, 0.5, -0.1), rod=SOLVER),
    "polygon": planar(jw.Polygon([(-0.4, 0.6), (0.1, 0.2), (0.5, 0.6)])),
    "hollow polygon": planar(
        jw.Polygon([(-0.4, 0.9), (-0.4, 0.3), (0.0, 0.5), (0.4, 0.3), (0.4, 0.9)], concave=True), contacts=2
    ),
    "contour": planar(jw.Contour(0.2, jnp.log(jnp.array([0.4, 0.5, 0.8])), (-1.0, 0.1, 1.0), position=0.1)),
    "graph": planar(jw.Graph(jw.Polynomial([0.2, 0.1, 1.0], length=2.0), 0.1, extent=50.0)),
    "cut": planar(jw.Cut(jw.Parabola(0.2), left=-0.3, right=0.5)),
    "tilted": planar(jw.Tilted(jw.Parabola(0.2), 0.3, about=(0.1, -0.2))),
    "pipe": planar(jw.Pipe(0.65, 0.1, 0.4), contacts=2, detect=()),
    "several objects": planar(jw.Parabola(0.2), CIRCLE, detect=("second_contact", "crossing")),
    "several contacts": planar(CIRCLE, jw.Box(0.4, 0.2, 0.3, position=2.0), contacts=3, friction=0.2),
    "table": planar(CIRCLE, whisker=TABLE),
    "cone": planar(jw.Circle(0.01, 0.02), whisker=CONE),
    "cone with a tip": planar(
        jw.Circle(0.01, 0.02),
        whisker=jw.Whisker(0.05, CONE.bending_stiffness, mass_per_length=CONE.mass_per_length, tip_mass=1e-6),
    ),
    "section in a table": planar(
        jw.Circle(0.01, 0.02),
        whisker=jw.Whisker.from_table([0.0, 0.01, 0.02], youngs_modulus=3e9, diameter=[2e-4, 1.5e-4, 5e-5]),
    ),
    "several whiskers": planar(CIRCLE, whisker=(jw.Whisker(), jw.Whisker(0.9, 2.0)), support=jw.Support.fbfb(70.0)),
    "feedback": planar(CIRCLE, support=jw.Support.fbfbr((60.0, jnp.inf, 70.0), (0.1, 0.2, 0.3))),
    "follicle": planar(CIRCLE, support=jw.Support.follicle(30.0, 40.0, 2.0, mount=jw.Mount(0.1, -0.2, 0.3))),
    "springs": supported(
        jw.Spring((0, 1), 50.0, -0.2, axis="axial", at=0.1, anchor=(0.3, -0.1)),
        jw.Spring((0, 1), compliance=0.02, rest_length=0.1),
        jw.Spring((1, 2), 10.0, 0.2, axis="axial", at=(0.3, 0.4), one_sided="tension"),
        jw.Spring((0, 2), 20.0, 0.1),
        free=("phi",),
    ),
    "law of a spring": supported(jw.Spring((0, 1), jw.Polynomial([0.0, 50.0, 0.0, 3.0], length=1.0), at=0.1)),
    "several mounts": supported(mount=(jw.Mount(), jw.Mount(0.3, angle=-0.1))),
    "foundations": supported(
        *(jw.Spring((0, k), 50.0, 0.1 * k) for k in (1, 2)), foundation=(jw.Foundation(0.01, 0.1, 2000.0, 0.02), None)
    ),
    "published": planar(jw.Circle(0.01, 0.02), whisker=jw.Whisker.rat("C", 2), support=jw.Support.simony()),
    "translation": planar(CIRCLE, motion=jw.Translation(1)),
    "rotation": planar(CIRCLE, motion=jw.Rotation((0.1, -0.5), 0.5, -1)),
    "sphere": spatial(SPHERE, whisker=CURVED, friction=0.3),
    "ellipsoid": spatial(
        jw.Ellipsoid((1.2, 0.7, 0.5), centre=(0.0, 1.1, 0.1)), motion=jw.Rotation((0.0, -0.5), 0.5), rod=SOLVER
    ),
    "cylinder": spatial(
        jw.Cylinder(0.9, point=(0.0, 1.2, 0.1), axis=(0.5, 0.0, 0.8)),
        whisker=HEAVY,
        gravity=(0.5, -1, 0.3),
        motion=jw.LinearDrive((-1.0, 0.0, 0.3), (0.1, 0.2, 0.3)),
    ),
    "paraboloid": spatial(
        jw.Paraboloid(0.2, 2.0, 0.5), motion=jw.RotaryDrive((0.1, 0.2, 1.0), (0.1, -0.5, 0.2), -1.0, 1.2)
    ),
    "capsule": spatial(jw.Capsule(0.1, start=(0.0, 0.9, 0.0), end=(0.1, 0.9, 3.0))),
    "spherical harmonics": spatial(jw.SphericalHarmonics([0.5, 0.01, 0.0, 0.02], (0.0, 1.2, 0.1), 1e-3, 2e-3)),
    "rounded box": spatial(
        jw.RoundedBox((0.8, 0.5, 0.6), 0.05, centre=(0.0, 1.0, 0.1)).rotated((0.1, 0.0, 0.2)), contacts=2
    ),
    "torus": spatial(jw.Torus(0.4, 0.1, centre=(0.0, 1.0, 0.1), axis=(0.0, 1.0, 0.2)), contacts=2),
    "plane": spatial(jw.Plane((-0.5, 0.0, 0.1), outward=(1.0, -1.0, 0.2))),
    "extruded": spatial(jw.Extruded(CIRCLE), motion=jw.WhiskDrive(0.1, 0.2, 0.3, 0.4, (0.1, 0.2, 0.3), -1.0, 1.2)),
    "revolved": spatial(
        jw.Revolved(jw.Ellipse(0.2, 0.5, 0.3)), motion=jw.WhiskDrive(protraction=0.1, protraction_rate=-1.0)
    ),
    "moved": spatial(SPHERE.moved((0.1, 0.2, 0.3)).rotated((0.0, 0.1, 0.2), about=(0.1, 0.2, 0.3))),
    "follicle in space": spatial(
        SPHERE, support=jw.Support.follicle(9.0, z=8.0, phi_x=3.0, mount=jw.Mount(z=0.1, elevation=0.2, roll=0.3))
    ),
    "pad": PAD.coupled(SPHERE, [jw.Spring((1, 2), 9.0, 0.3)], jw.LinearDrive((-1.0, 0.0, 0.0))),
}
