"""The code of the current scene: Python that runs as it is, in a fresh process.

That of a `build` of the user's is its source, together with what it uses of the names around it. What has no source, or
uses what cannot be written, is written out as a scene of numbers; and what cannot be that either says what is missing.
"""

import ast
import dis
import linecache
import sys
import textwrap
import types
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

import jaxwhisker
from jaxwhisker._explore.written import UnwritableError, written, written_scene
from jaxwhisker._model.scene import Scene

_HEAD = ["import jax", "import numpy as np", "", "import jaxwhisker as jw"]
_FLOAT64 = 'jax.config.update("jax_enable_x64", True)'

_PRINTED = """
for k in range(result.fx.shape[1]):
    fx, fy, mz = (f"{name} = {getattr(result, name)[step, k]:.7g}" for name in ("fx", "fy", "mz"))
    print(f"u = {result.control[step]:.7g}, whisker {k + 1}: {fx}, {fy}, {mz}")
"""


def scanned(code: str, control: Float[np.ndarray, " steps"]) -> list[str]:
    """Code that makes a scene, and scans it as a page does: what stands before and after the number of a step."""
    positions = f"np.linspace({float(control[0])!r}, {float(control[-1])!r}, {control.size})"
    return [f"{code}\nresult = jw.scan(scene, {positions})\nprint(result)\n\nstep = ", _PRINTED]


def code_of_scene(scene: Scene, values: Mapping[str, float] | None = None) -> str:
    """The code of a scene, written out in numbers.

    Raises:
        UnwritableError: if the scene holds what is no number, such as a function.
    """
    del values
    return "\n".join([*_HEAD, "", _FLOAT64, "", f"scene = {written_scene(scene)}", ""])


def code_of(build: Callable[..., Scene], scene: Scene, values: Mapping[str, float]) -> str:
    """The code of a scene that `build` made of these values."""
    name = getattr(build, "__name__", "build")
    name = name if name.isidentifier() else "build"
    source = _Source()
    source.define(build, name)
    if source.missing:
        try:
            return code_of_scene(scene)
        except UnwritableError:
            pass
    imports = sorted(source.imports - set(_HEAD))
    missing = [f"# Of yours it needs: {', '.join(source.missing)}."] * bool(source.missing)
    call = f"scene = {name}({', '.join(f'{key}={written(value)}' for key, value in values.items())})"
    return "\n\n".join(["\n".join([*_HEAD, *imports]), _FLOAT64, *source.definitions, *missing, call]) + "\n"


class _Source:
    """The source of functions, and what they use of the names around them."""

    def __init__(self):
        self.imports: set[str] = set()
        self.definitions: list[str] = []
        self.missing: list[str] = []
        self._bound: dict[str, Any] = {"jax": jax, "np": np, "jw": jaxwhisker}  # what every name stands for

    def define(self, function: Any, name: str) -> None:
        """Take over the source of a function, and all that it uses before it."""
        self._bound[name] = function
        source = None
        if isinstance(function, types.FunctionType):
            source = _definition(function.__code__, name)
        if source is None:
            self.missing.append(name)
            return
        for used, value in _used(function):
            self._use(used, value)
        self.definitions.append(source)

    def _use(self, name: str, value: Any) -> None:
        if name in self._bound:
            if self._bound[name] is not value:  # one name for two things
                self.missing.append(name)
            return
        self._bound[name] = value
        if isinstance(value, types.ModuleType):
            line = f"import {value.__name__}"
            self.imports.add(line if value.__name__ == name else f"{line} as {name}")
        elif _importable(value):
            line = f"from {value.__module__} import {value.__name__}"
            self.imports.add(line if value.__name__ == name else f"{line} as {name}")
        elif isinstance(value, types.FunctionType):
            self.define(value, name)
        else:
            try:
                self.definitions.append(f"{name} = {written(value)}")
            except UnwritableError:
                self.missing.append(name)


def _importable(value: Any) -> bool:
    """Whether another process finds a function or class under its name."""
    module, name = getattr(value, "__module__", None), getattr(value, "__name__", None)
    if not isinstance(name, str) or module == "__main__":
        return False
    return getattr(sys.modules.get(str(module)), name, None) is value


def _used(function: types.FunctionType) -> list[tuple[str, Any]]:
    """Names from outside that a function reads, and what they stand for; Python's own left out."""
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    found = {name: cell.cell_contents for name, cell in cells}
    codes = [function.__code__]
    for code in codes:
        codes += [constant for constant in code.co_consts if isinstance(constant, types.CodeType)]
        for step in dis.get_instructions(code):
            if step.opname == "LOAD_GLOBAL" and step.argval in function.__globals__:
                found[step.argval] = function.__globals__[step.argval]
    return list(found.items())


@lru_cache(maxsize=64)
def _definition(code: types.CodeType, name: str) -> str | None:
    """The source of a function, bound to that name; None if it cannot be found."""
    lines = linecache.getlines(code.co_filename)
    text = "".join(lines)
    try:
        tree = ast.parse(text)
    except SyntaxError:
        return None
    nodes = [node for node in ast.walk(tree) if _first_line(node) == code.co_firstlineno]
    for node in nodes:
        if isinstance(node, ast.FunctionDef) and node.name == code.co_name:
            return textwrap.dedent("".join(lines[code.co_firstlineno - 1 : node.end_lineno])).rstrip()
        if isinstance(node, ast.Lambda) and code.co_name == "<lambda>":
            segment = ast.get_source_segment(text, node) or ""
            if _alike(segment, code):
                # In brackets it may go over several lines.
                return f"{name} = ({segment})" if "\n" in segment else f"{name} = {segment}"
    return None


def _first_line(node: Any) -> int | None:
    decorators = getattr(node, "decorator_list", [])
    return decorators[0].lineno if decorators else getattr(node, "lineno", None)


def _alike(segment: str, code: types.CodeType) -> bool:
    """Whether this source of a lambda is that of the code: on one line there may be several."""
    whole = compile(f"({segment})", "<lambda>", "eval")
    other = next(constant for constant in whole.co_consts if isinstance(constant, types.CodeType))

    def told(code: types.CodeType) -> tuple:
        constants = tuple(c for c in code.co_consts if not isinstance(c, types.CodeType))
        # What is free in a closure is global to a lambda alone.
        return code.co_varnames, {*code.co_names, *code.co_freevars}, constants

    return told(other) == told(code)
