"""Supports that were published for the whiskers of rats, in SI units; their numbers are in `published/rats.toml`."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._base.data_files import published
from jaxwhisker._base.suggest import Suggesting
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.foundation import Foundation
from jaxwhisker._model.motion import Mount
from jaxwhisker._model.spring import Spring

MM = 1e-3
REST_ANGLE = np.radians(20.0)  # default of `hill`, to the normal of the pad
HILL_GUIDE = 1e3  # N/m: of the centre of mass, which the model of Hill et al. holds at a constant height


class Published(eqx.Module, metaclass=Suggesting):
    """Constructors of published supports. The drive is the skull; the pad lies along x, the follicle below y = 0.

    The base of the whisker is where it enters the skin. Below, the follicle is rigid, and springs hold it there. The
    angle of the mount is that of the resting whisker to the normal of the pad; a scan towards -x protracts it.
    """

    @classmethod
    def simony(cls: Any, *, large_angles: bool = False, angle: Scalar | None = None, follicle: Scalar = 4 * MM) -> Any:
        """One whisker: two springs along the pad at the skin, two at the plate, and one below the plate.

        Each level has an anchor 1 mm to either side. All springs are unstrained at rest.

        Args:
            large_angles: whether to use the parameters for large angles: 0.2, 0.2 and 0.6 N/m instead of 0.3, 0.3 and
                1.0 N/m for each spring at the skin, at the plate and below it, and a rest angle of 75 instead of 65
                degrees to the pad.
            angle: angle of the resting whisker to the normal of the pad, rad. Default: 25 degrees, or 15 for large
                angles.
            follicle: length of the follicle, m.

        Raises:
            ValueError: if the angle is not less than a right angle, or the length is not positive.

        Examples:
            >>> support = jw.Support.simony()
            >>> len(support.springs), support.axes
            (5, ('x', 'y', 'phi'))

        Source: Simony, Bagdasarian, Herfst, Brecht, Ahissar and Golomb (2010), J. Neurosci. 30, 8935; stiffnesses,
        anchors and angles as in their program (ModelDB 127512).
        """
        checks.number("follicle", follicle, positive=True)
        if angle is not None:
            checks.acute_angle("angle", angle)
        numbers = published("rats")["simony"]
        skin, plate, below, rest = numbers["large_angles" if large_angles else "small_angles"].values()
        tilt: Any = np.radians(rest) if angle is None else angle
        x, y = follicle * jnp.sin(tilt), -follicle * jnp.cos(tilt)
        half = numbers["anchor"] * MM  # from a spring's end on the follicle to its anchor
        places: list[Any] = [(skin, 0.0, (-half, 0.0)), (skin, 0.0, (half, 0.0))]
        places += [
            (plate, -follicle, (x - half, y)),
            (plate, -follicle, (x + half, y)),
            (below, -follicle, (x, y - half)),
        ]
        springs = (Spring((0, 1), c, half, axis="axial", at=at, anchor=anchor) for c, at, anchor in places)
        return cls(tuple(springs), Mount(angle=tilt), free=("y", "phi"))

    @classmethod
    def hill(
        cls: Any,
        whiskers: int = 1,
        *,
        angle: Scalar = REST_ANGLE,
        follicle: Scalar = 4 * MM,
        pad: Scalar = 20 * MM,
        mass: Scalar = 10.5e-6,
    ) -> Any:
        """A row of whiskers in the pad: springs at the skin and at the plate connect neighbours, and the last to walls.

        A spring's stiffness is S divided by its rest length, S = pad mass omega^2 / 2, with the mass of all follicles
        and omega = 1 / ((r - sqrt(r^2 - 1)) tau); tau = 27 ms and r = 2 follow from the time in which the pad relaxes.
        The centre of mass of each follicle, 1.43 mm below the skin, keeps its height.

        Args:
            whiskers: number of whiskers, at equal distances between the walls.
            angle: angle of the resting whisker to the normal of the pad, rad; 20 degrees.
            follicle: length of the follicle, m.
            pad: width of the pad, m.
            mass: of each follicle with its whisker, kg.

        Raises:
            ValueError: if `whiskers` is not a positive int, the angle is not less than a right angle, a length or mass
                is not positive, or the follicles are longer than their distances.

        Examples:
            >>> support = jw.Support.hill()
            >>> print(f"{2 * support.springs[0].stiffness:.3f} N/m at the skin")
            0.401 N/m at the skin

        Source: Hill, Bermejo, Zeigler and Kleinfeld (2008), J. Neurosci. 28, 3438: follicle and pad; masses, times and
        the law of stiffness as in their program whisker_sim.
        """
        checks.number("follicle", follicle, positive=True)
        checks.number("pad", pad, positive=True)
        checks.number("mass", mass, positive=True)
        checks.acute_angle("angle", angle)
        checks.count("whiskers", whiskers)
        if not checks.is_traced((pad, follicle)) and not float(pad) > (whiskers + 1) * float(follicle):
            checks.fail("pad", f"wider than {whiskers + 1} follicles of {follicle}", pad)
        numbers = published("rats")["hill"]
        damping = numbers["damping_ratio"]
        omega = 1 / ((damping - np.sqrt(damping**2 - 1)) * numbers["time"])
        strength = pad / 2 * whiskers * mass * omega**2
        apart, last, springs = pad / (whiskers + 1), whiskers, []
        for at in (0.0, -follicle):
            x, y = -at * jnp.sin(angle), at * jnp.cos(angle)
            for base, side in ((1, -1), (last, 1)):
                rest, wall = apart - side * x, (side * pad / 2, y)
                springs.append(Spring((0, base), strength / rest, -side * rest, axis="axial", at=at, anchor=wall))
            springs += [Spring((k, k + 1), strength / apart, apart, axis="axial", at=(at, at)) for k in range(1, last)]
        held = -numbers["centre_of_mass"] * MM
        springs += [Spring((0, k), HILL_GUIDE, axis="y", at=held) for k in range(1, last + 1)]
        mounts = tuple(Mount(x=(k - (last + 1) / 2) * apart, angle=angle) for k in range(1, last + 1))
        return cls(tuple(springs), mounts if last > 1 else mounts[0], free=("phi",))

    @classmethod
    def berg(cls: Any, skin: Scalar, deep: Scalar, follicle: Scalar, *, mount: Mount | None = None) -> Any:
        """One whisker: a spring along the pad at the skin, and one at the lower end of the follicle.

        The paper shows this arrangement in a drawing and gives no stiffness. Intrinsic muscles turn the follicle about
        the skin; extrinsic ones shift the pad.

        Args:
            skin: stiffness at the skin, N/m; positive.
            deep: stiffness at the lower end, N/m; positive.
            follicle: length of the follicle, m; positive.
            mount: the mount of the whisker. Default: upright.

        Raises:
            ValueError: if a value is out of its domain.

        Source: Berg and Kleinfeld (2003), J. Neurophysiol. 89, 104.
        """
        return cls._two_levels(skin, deep, follicle, mount)

    @classmethod
    def schaefer(cls: Any, skin: Scalar, follicle_end: Scalar, follicle: Scalar, *, mount: Mount | None = None) -> Any:
        """One whisker on elastic supports at the skin and at the lower end of its follicle, without their dampers.

        Args:
            skin: stiffness at the skin, N/m; positive.
            follicle_end: stiffness at the lower end of the follicle-sinus complex, N/m; positive.
            follicle: length of the follicle, m; positive.
            mount: the mount of the whisker. Default: upright.

        Raises:
            ValueError: if a value is out of its domain.

        Source: the model of the follicle-sinus complex that the thesis reviews in its chapter 3, after Schaefer,
        Schmitz, Will and Behn (2011), 56th International Scientific Colloquium, TU Ilmenau.
        """
        return cls._two_levels(skin, follicle_end, follicle, mount)

    @classmethod
    def _two_levels(cls: Any, skin: Scalar, deep: Scalar, follicle: Scalar, mount: Mount | None) -> Any:
        checks.number("follicle", follicle, positive=True)
        springs = Spring((0, 1), skin, at=0.0), Spring((0, 1), deep, at=-follicle)
        return cls(springs, mount, free=("phi",))

    @classmethod
    def luo(
        cls: Any,
        superficial: Scalar,
        deep: Scalar,
        superficial_at: Scalar,
        deep_at: Scalar,
        *,
        tissue: Foundation | None = None,
        mount: Mount | None = None,
    ) -> Any:
        """One whisker as a beam inside its follicle, which bends there into an S.

        The base is the lower end of the whisker in its follicle. Springs across it act at two heights, and the tissue
        of the sinus along a stretch between them. The paper ranks the stiffnesses and gives no values that could serve
        as defaults.

        Args:
            superficial: stiffness of the upper spring, N/m; positive.
            deep: stiffness of the lower spring, N/m; positive.
            superficial_at: height of the upper spring above the base, along the whisker, m.
            deep_at: height of the lower spring, m.
            tissue: the tissue around the shaft. Default: none.
            mount: the mount of the whisker. Default: upright.

        Raises:
            ValueError: if a value is out of its domain.

        Source: Luo, Bresee, Rudnicki and Hartmann (2021), PLoS Comput. Biol. 17, e1007887.
        """
        springs = Spring((0, 1), superficial, at=superficial_at), Spring((0, 1), deep, at=deep_at)
        return cls(springs, mount, foundation=tissue, free=("phi",))
