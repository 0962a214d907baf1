"""Options for motion in time, and the simulation that they describe."""

import argparse
import math
from typing import TYPE_CHECKING

from jaxwhisker._file.scene_file import SceneFile
from jaxwhisker._model.assembly import AbstractScene
from jaxwhisker._model.scene import Scene, time_unit
from jaxwhisker.cli import options
from jaxwhisker.cli.scene_file import control_of

if TYPE_CHECKING:
    from jaxwhisker._dynamics.simulation import Simulation

STEP = 0.005  # default of the largest time step, in T = L^2 sqrt(rho A / EI)
MOST_STEPS = 2_000_000
# A motion ends later than the scan, in T: fast whiskers lose the contact later, and then vibrate.
LATER = 2.0
NEEDED = ("mass_per_length", "stiffness_damping", "time_step", "playback_speed")  # options that need a drive speed


def add_motion(command: argparse.ArgumentParser) -> None:
    """Add the options of motion in time."""
    text = "With --drive-speed, whiskers move in time, with inertia.\nT = L^2 sqrt(RHO/EI) is the unit of time."
    add, number = command.add_argument_group("motion", text).add_argument, options.parse_number
    add("--drive-speed", type=number, metavar="V", help="speed of the drive (default: a scan, which has no time)")
    text = "mass per length of the whiskers, in kg/m if all options are in SI units (default: none)"
    add("--mass-per-length", type=number, metavar="RHO", help=text)
    text = "time constant of damping in whiskers and springs (default: 0)"
    add("--stiffness-damping", type=number, metavar="TAU", help=text)
    add("--time-step", type=number, metavar="DT", help=f"largest time step (default: {STEP:g} T)")


def check_motion(args: argparse.Namespace, scene: AbstractScene) -> None:
    """Check that the options of motion fit together and to a scene, before anything is computed.

    Raises:
        ValueError: if not; the message names the option.
    """
    if args.drive_speed is None:
        for name in NEEDED:
            if getattr(args, name, None) is not None:
                raise ValueError(f"--{name.replace('_', '-')} needs --drive-speed: a scan has no time.")
        return
    for option, value in (("drive-speed", args.drive_speed), ("time-step", args.time_step)):
        if value is not None and not 0 < value < math.inf:
            raise ValueError(f"--{option} must be a positive finite number, got {value}.")
    if scene.in_space:
        raise ValueError("--drive-speed needs a scene in the plane: motions in space are not available.")
    if scene.whiskers[0].mass_per_length is None:
        needed = "--mass-per-length, in the units of the other options" if args.scene is None else "`mass_per_length`"
        raise ValueError(f"--drive-speed needs {needed}.")
    if args.detect:
        raise ValueError("--detect needs a scan: a motion with --drive-speed goes on in these contacts.")


def motion_of(args: argparse.Namespace, scene: Scene, file: SceneFile | None = None) -> "Simulation":
    """Simulate the motion of a scene whose drive moves at constant speed, with a sample at each of its positions."""
    from jaxwhisker._dynamics.simulate import simulate

    unit, speed = float(time_unit(scene.whiskers[0])), args.drive_speed
    control = control_of(args, scene, file, further=LATER * unit * speed)
    if control is None or control.size < 2:
        raise ValueError("--step must leave at least two positions between --start and --stop for a motion.")
    largest = STEP * unit if args.time_step is None else args.time_step
    # Without the factor, a whole number might be rounded up.
    every = math.ceil(abs(control[1] - control[0]) / speed / largest * (1 - 1e-9))
    steps = (control.size - 1) * every
    if steps > MOST_STEPS:
        limit = f"at most {MOST_STEPS:,} time steps, got {speed:g}, which leaves {steps:,} (see --time-step)"
        raise ValueError(f"--drive-speed must leave {limit}.")
    ends, damping = control[[0, -1]], args.stiffness_damping or 0.0
    duration = abs(ends[1] - ends[0]) / speed
    return simulate(scene, ends, duration, steps=steps, every=every, stiffness_damping=damping)
