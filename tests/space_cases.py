"""Scenes of the reference in space."""

# pyright: reportArgumentType=false

import jaxwhisker as jw
from random_space import Cone

ALONG = jw.LinearDrive((-1.0, 0.0, 0.0))


def case(row) -> jw.SpaceScene:
    """The scene of a case of the reference."""
    rod, drive, surface = (row["params"][key] for key in ("rod", "drive", "surface"))
    first, second, twist = rod["kappa0"]
    whisker = {"torsion_ratio": rod["torsion_ratio"]}
    whisker |= {"intrinsic_curvature": -second} if second else {}
    whisker |= {"lateral_curvature": first} if first else {}
    whisker |= {"twist": twist} if twist else {}
    whisker |= {"bending_stiffness": Cone(rod["taper"])} if rod["taper"] else {}
    if surface["kind"] == "sphere":
        body = jw.Sphere(surface["radius"], tuple(surface["center"]))
    elif surface["kind"] == "ellipsoid":
        body = jw.Ellipsoid(tuple(surface["half_axes"]), tuple(surface["center"]))
        body = body.rotated(tuple(surface["rotation_vector"]))
    else:
        body = jw.Cylinder(surface["radius"], tuple(surface["point"]), tuple(surface["axis"]))
    if drive["kind"] == "translation":
        motion = jw.LinearDrive(tuple(drive["direction"]), tuple(drive["origin"]))
    else:
        motion = jw.WhiskDrive(drive["elevation"], drive["roll0"], roll_rate=drive["roll_rate"])
    springs = [
        jw.Spring((0, 1), stiffness, axis=axis)
        for key, axes in (("spring_stiffness", "xyz"), ("rotational_stiffness_body", ("phi_x", "phi", "phi_y")))
        for stiffness, axis in zip(row["params"].get(key, ()), axes, strict=False)
    ]
    friction = row["params"].get("friction")
    mount = jw.Mount(roll=drive["roll"]) if drive.get("roll") else None
    return jw.SpaceScene(
        jw.Whisker(**whisker), body, jw.Support(tuple(springs), mount), motion=motion, friction=friction
    )
