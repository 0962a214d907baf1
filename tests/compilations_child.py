"""First calls of public functions in a new process: python compilations_child.py NAME...

Print, for the import and for the first call of each function, which operations were compiled outside programs. Programs
come from the store if an earlier run has left them there.
"""

import json
import sys
import tempfile
from pathlib import Path

import jax
import numpy as np

COUNTED = "/jax/core/compile/backend_compile_duration"
compiled: list[str] = []


def note(event: str, duration_secs: float, **more) -> None:
    """Note what JAX compiles."""
    del duration_secs
    if event == COUNTED:
        compiled.append(str(more.get("fun_name", "")))


jax.monitoring.register_event_duration_secs_listener(note)

import jaxwhisker as jw  # noqa: E402
from jaxwhisker._base import program  # noqa: E402
from recordings import TRUTH, fb  # noqa: E402

CONTROL = np.linspace(0.75, -1.35, 20)
POINTS = {"x": np.linspace(-0.5, 0.5, 12), "y": 0.3 + np.linspace(-0.5, 0.5, 12) ** 2}
ROD = jw.Whisker(mass_per_length=1.0)
FB = fb(**TRUTH)
BALL = jw.Sphere(0.9, (0.0, 1.2, 0.2))


def touching(x):
    return jw.SpaceScene(jw.Whisker(), BALL, motion=jw.LinearDrive((-1.0, 0.0, 0.0), (x, 0.0, 0.0)))


def calls(folder: Path) -> dict:
    """A call of each public function; later ones use the results of earlier ones."""
    found = {}

    def scan():
        found["scan"] = jw.scan(FB, CONTROL)
        return [str(event) for event in found["scan"].events], str(found["scan"])

    def study():
        found["study"] = jw.study(fb, control=CONTROL, c=[55.0, 70.0], q=[0.27])

    return {
        "scan": scan,
        "shapes": lambda: jw.shapes(found["scan"], at=CONTROL[:1]),
        "bending": lambda: jw.bending(found["scan"], [0.1, 0.3]),
        "strain": lambda: jw.strain(found["scan"], [0.1, 0.3], 0.01),
        "energy_balance": lambda: str(jw.energy_balance(found["scan"])),
        "stored_energy": lambda: jw.stored_energy(FB, found["scan"], CONTROL),
        "to_csv": lambda: jw.to_csv(found["scan"], folder / "scan.csv"),
        "to_dataframe": lambda: jw.to_dataframe(found["scan"]),
        "animate": lambda: jw.animate(found["scan"], folder / "scan.gif", seconds=0.1, width=320),
        "lateral_stability": lambda: jw.lateral_stability(found["scan"]),
        "lateral_loss": lambda: jw.lateral_loss(found["scan"]),
        "reconstruct": lambda: str(jw.reconstruct(found["scan"], FB)),
        "identify": lambda: str(jw.identify(fb, TRUTH, found["scan"], near=True, starts=0)),
        "information": lambda: str(jw.information(fb, TRUTH, sigma=0.01, control=CONTROL)),
        "design": lambda: str(jw.design(fb, {"c": 55.0}, sigma=0.01, control=CONTROL, q=[0.25, 0.27])),
        "study": study,
        "summary": lambda: jw.summary(found["study"]),
        "critical_stiffness": lambda: jw.critical_stiffness(jw.Whisker(), jw.Parabola(0.27)),
        "deflect": lambda: str(jw.deflect(ROD, jw.PointForce(5.0))),
        "modes": lambda: str(jw.modes(ROD, 2)),
        "simulate": lambda: str(jw.simulate(jw.Scene(ROD, jw.Parabola(0.2)), jw.Whisking(0.1, 0.05, offset=0.9), 0.1)),
        "fit_profile": lambda: str(jw.fit_profile(POINTS, jw.Parabola)),
        "fit_contour": lambda: str(jw.fit_contour(found["scan"], FB, sigma=0.01, knots=4)),
        "tactile_image": lambda: jw.tactile_image(touching, control=CONTROL, x=[0.0, 0.05]),
        "scan in space": lambda: str(jw.scan(touching(0.0), CONTROL)),
    }


def main(names: list[str]) -> None:
    """Print the operations as JSON."""
    found = {"import": list(compiled)}
    with tempfile.TemporaryDirectory() as folder:
        every = calls(Path(folder))
        for name in names:
            compiled.clear()
            every[name]()
            own = {f"jit({getattr(one, '__name__', 'program')})" for one in program._PROGRAMS}
            found[name] = [one for one in compiled if one not in own]
    print(json.dumps(found))


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(sys.argv[1:])
