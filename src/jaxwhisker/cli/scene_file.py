"""A file that describes the scene, instead of options."""

import argparse
from pathlib import Path

import numpy as np

from jaxwhisker._file.scan_range import ScanRange
from jaxwhisker._file.scene_file import SceneFile
from jaxwhisker._model.assembly import AbstractScene
from jaxwhisker.cli import options
from jaxwhisker.cli.given import given

# Options that describe what a file describes.
OF_SCENES = ("model", "profile", *options.PARAMETERS, "friction", "detect", "mass_per_length")


def add_scene_file(command: argparse.ArgumentParser) -> None:
    """Add the file of a scene, which comes before other arguments."""
    text = "file of a scene, in place of the options of whiskers, springs and object"
    command.add_argument("scene", nargs="?", type=Path, metavar="SCENE.toml", help=text)


def file_of(args: argparse.Namespace) -> SceneFile | None:
    """The file of the scene; None if options describe it.

    Raises:
        ValueError: if both do, or the file does not describe a scene.
    """
    if args.scene is None:
        return None
    for name in OF_SCENES:
        if name in given(args) or (name == "detect" and getattr(args, name, None) is not None):
            option = f"--{name.replace('_', '-')}"
            raise ValueError(f"{option} does not go with a file of a scene: change {args.scene} instead.")
    file = SceneFile(args.scene)
    if "units" not in given(args):
        args.units = file.range.units
    return file


def control_of(
    args: argparse.Namespace, scene: AbstractScene, file: SceneFile | None, *, further: float = 0.0
) -> np.ndarray | None:
    """Drive positions of the scan of a scene: those of the options, else of the file; None for the default ones.

    Args:
        args: the options.
        scene: the scene.
        file: its file, if there is one.
        further: how far the drive moves beyond the default end of a scan.
    """
    if file is None:
        return options.control_of(args, scene, further=further)
    asked, own = {name: getattr(args, name) for name in ("start", "stop") if name in given(args)}, file.range
    if not asked and args.step is None and not (further and own.is_default):
        return own.control(scene)
    asked = {name: getattr(own, name) for name in ("start", "stop", "steps")} | asked
    start, stop = ScanRange(asked["start"], asked["stop"]).ends(scene, further)
    if args.step is not None:
        return options.positions(start, stop, args.step)
    return ScanRange(start, stop, asked["steps"]).control(scene)
