"""What first calls compile outside programs, where each operation is compiled on its own and in every process."""

import json
import subprocess
import sys
from pathlib import Path

import jaxwhisker as jw

TESTS = Path(__file__).parents[1]
ELSEWHERE = {"explore"}  # it waits for a browser
# Fewer are better. The number of each call, in this order, in a new process: later calls share what earlier ones compile.
MOST = {
    "import": 0,
}


def test_first_calls_compile_few_operations_outside_programs():
    command = [sys.executable, str(TESTS / "compilations_child.py")]
    done = subprocess.run(command, cwd=TESTS, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    counts = json.loads(done.stdout)
    names = counts.pop("names")
    assert counts.keys() == MOST.keys()
    more = {name: (count, names.get(name)) for name, count in counts.items() if count > MOST[name]}
    assert more == {}


def test_every_public_function_is_called():
    functions = {name for name in jw.__all__ if name[0].islower()}
    assert functions - MOST.keys() == ELSEWHERE
