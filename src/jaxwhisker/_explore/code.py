"""Python code of a scene or a motion: calls with numbers, which run in a new process."""

import inspect
import re
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from jaxwhisker._base.leaves import PlainFunction
from jaxwhisker._model.along import LinearTaper, RoundMass, RoundSection
from jaxwhisker._model.scene import AbstractScene, Sensor
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._scan.quantities import reactions_of

_HEAD = ["import jax", "import numpy as np", "", "import jaxwhisker as jw"]
_FLOAT64 = 'jax.config.update("jax_enable_x64", True)'

_signature = lru_cache(inspect.signature)  # cached for twenty pictures a second

_PRINT = """
for k in range(result.fx.shape[1]):
    values = ", ".join(f"{name} = {getattr(result, name)[step, k]:.7g}" for name in REACTIONS)
    print(f"PLACE, whisker {k + 1}: {values}")
"""
_CONTROL, _TIME = "u = {result.control[step]:.7g}", "t = {result.time[step]:.7g}"


def code_of(scene: AbstractScene, comment: str = "") -> str:
    """Code that constructs a scene.

    User-defined functions and classes appear by their names: imported if they come from a module, else listed in a
    comment. A function without a name gets the name of its argument.
    """
    writer = _Writer()
    arguments = "".join(f"    {argument},\n" for argument in writer.arguments(scene))
    return writer.code([f"# {comment}"] * bool(comment), f"scene = jw.Scene(\n{arguments})\n")


def code_of_call(build: Callable, values: Mapping[str, float]) -> str:
    """Code that calls a user's function, whose result it names `result`."""
    writer = _Writer()
    name = writer.name(build, "build")
    return writer.code([], f"result = {name}({', '.join(f'{key}={value!r}' for key, value in values.items())})\n")


def code_of_scan(scene: AbstractScene | Sensor, scene_code: str, control: Float[np.ndarray, " steps"]) -> list[str]:
    """Code that constructs a scene, scans it and prints one step, as the texts before and after the step's number."""
    positions = f"np.linspace({float(control[0])!r}, {float(control[-1])!r}, {control.size})"
    scanned = f"{scene_code}\nresult = jw.scan(scene, {positions})\nprint(result)\n\nstep = "
    return [scanned, _print(scene, _CONTROL)]


def code_of_motion(scene: AbstractScene | Sensor, code: str) -> list[str]:
    """Code that makes a simulation and prints one sample, as the texts before and after the sample's number."""
    return [f"{code}print(result)\n\nstep = ", _print(scene, f"{_TIME}, {_CONTROL}")]


def _print(scene: AbstractScene | Sensor, place: str) -> str:
    return _PRINT.replace("PLACE", place).replace("REACTIONS", repr(reactions_of(scene)))


class _Writer:
    """Writes parts of a scene as Python expressions, and collects the user-defined names that they use."""

    def __init__(self):
        self.imports: set[str] = set()
        self.needed: dict[str, Any] = {}  # user-defined functions and classes that cannot be imported

    def code(self, comments: list[str], statement: str) -> str:
        """A statement with the imports and comments that it needs."""
        head = "\n".join([*_HEAD, *sorted(self.imports)])
        needed = [f"# Define these first: {', '.join(self.needed)}."] * bool(self.needed)
        return "\n".join([head, "", _FLOAT64, "", *comments, *needed, statement])

    def arguments(self, value: Any) -> list[str]:
        """The constructor's arguments as `name=expression`, without those that have their default."""
        written = []
        for name, parameter in _signature(type(value)).parameters.items():
            text = self.expression(getattr(value, name), name)
            default = parameter.default
            if default is parameter.empty or text != self.expression(default, name):
                written.append(f"{name}={text}")
        return written

    def expression(self, value: Any, name: str) -> str:
        """The expression of a value that is given as the argument `name`."""
        if value is None or isinstance(value, bool | str):
            return repr(value)
        if isinstance(value, int | float | np.number | np.ndarray | jax.Array):
            return _literal(value)
        if isinstance(value, tuple):
            parts = [self.expression(part, name) for part in value]
            return f"({', '.join(parts)}{',' * (len(parts) == 1)})"
        if isinstance(value, PlainFunction):
            return self.name(value.function, name)
        if not isinstance(value, eqx.Module):
            return self.name(value, name)
        try:
            return self._shorter(value) or f"{self._class(type(value))}({', '.join(self.arguments(value))})"
        except AttributeError:  # a user-defined class that does not store its constructor's arguments
            return self.name(value, name)

    def _shorter(self, value: Any) -> str | None:
        """A shorter expression that calls a class method; None if there is none."""
        if isinstance(value, Support):
            return self._named_support(value)
        if isinstance(value, Whisker) and isinstance(value.bending_stiffness, RoundSection):
            return self._whisker_from_material(value, value.bending_stiffness)
        if len(objects := getattr(value, "objects", ())) > 1:
            return self.expression(objects, "objects")
        return self._placed(value) if getattr(value, "is_surface", False) else None

    def _placed(self, surface: Any) -> str | None:
        from jaxwhisker._model.surface import Placed

        if not isinstance(surface, Placed):
            return None
        original = self.expression(surface.surface, "surface")
        if surface.about is None and not np.any(np.asarray(surface.rotation)):
            return f"{original}.moved({self.expression(surface.by, 'by')})"
        about = f", {self.expression(surface.about, 'about')}" if surface.about is not None else ""
        return f"{original}.rotated({self.expression(surface.rotation, 'rotation')}{about})"

    def _named_support(self, support: Support) -> str | None:
        springs = support.springs
        if support.mount is not None or support.name not in ("FB", "FBFB", "FBFBR", "FBFBFBR"):
            return None
        numbers = (spring.stiffness for spring in springs if not callable(spring.stiffness))
        stiffness: Any = tuple(float(number) for number in numbers if number is not None)
        rest_length: Any = tuple(float(spring.rest_length) for spring in springs)
        if len(stiffness) < len(springs):  # a spring has a compliance instead
            return None
        # One number for all springs if that gives the same support.
        if len(set(stiffness)) == 1:
            stiffness = stiffness[0]
        if rest_length == tuple((b - a) * rest_length[0] for a, b in (spring.between for spring in springs)):
            rest_length = rest_length[0]
        numbers = f"stiffness={_literal(stiffness)}, rest_length={_literal(rest_length)}"
        return f"jw.Support.{support.name.lower()}({numbers})"

    def _whisker_from_material(self, whisker: Whisker, section: RoundSection) -> str:
        length = self.expression(whisker.length, "length")
        material = f"length={length}, youngs_modulus={self.expression(section.youngs_modulus, 'youngs_modulus')}"
        mass, further = whisker.mass_per_length, []
        density = f", density={self.expression(mass.density, 'density')}" if isinstance(mass, RoundMass) else ""
        if isinstance(section.diameter, LinearTaper):
            ends = (self.expression(end, "diameter") for end in (section.diameter.base, section.diameter.tip))
            text = "jw.Whisker.conical({}, base_diameter={}, tip_diameter={}{})".format(material, *ends, density)
        else:
            diameter = self.expression(section.diameter, "diameter")
            text = f"jw.Whisker.from_material({material}, diameter={diameter}{density})"
        names = ("intrinsic_curvature", "mass_per_length", "tip_mass", "base_mass", "base_inertia", "torsion_ratio")
        for name in (*names, "lateral_ratio", "lateral_curvature", "twist", "breaks"):
            value = getattr(whisker, name)
            if value is not None and not isinstance(value, RoundMass):
                further.append(f"{name}={self.expression(value, name)}")
        if not further:
            return text
        if density:
            further.append(f"mass_per_length={text}.mass_per_length")
        return f"jw.Whisker({length}, {text}.bending_stiffness, {', '.join(further)})"

    def _class(self, kind: type) -> str:
        return f"jw.{kind.__name__}" if kind.__module__.startswith("jaxwhisker.") else self.name(kind, kind.__name__)

    def name(self, value: Any, default: str) -> str:
        """The name of a user-defined function or class."""
        name, module = getattr(value, "__qualname__", ""), getattr(value, "__module__", "__main__")
        if name.isidentifier() and module != "__main__":
            self.imports.add(f"from {module} import {name}")
            return name
        name = unused = name if name.isidentifier() else default
        count = 1
        while self.needed.setdefault(unused, value) is not value:  # another function has this name
            count += 1
            unused = f"{name}_{count}"
        return unused


def _literal(value: Any) -> str:
    """The expression of a number, an array of numbers or a tuple of Python numbers."""
    array = np.asarray(value)
    text = repr(value) if isinstance(value, tuple) else repr(array.tolist())
    text = re.sub(r"\b(inf|nan)\b", r"np.\1", text)
    return text if isinstance(value, tuple) or array.ndim == 0 else f"np.array({text})"
