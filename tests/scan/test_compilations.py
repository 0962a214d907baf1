"""What first calls compile outside programs, where each operation is compiled on its own and in every process."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import jaxwhisker as jw

TESTS = Path(__file__).parents[1]
# The first waits for a browser, the others read and write files, with NumPy alone.
ELSEWHERE = {"explore", "read_columns", "load_control", "load_scene", "save_scene"}
# Largest numbers of operations, with jax 0.10, in this order: later calls share what earlier ones compile. Fewer are
# better; a new one costs users 20 ms. Of `identify`, one is compiled only if its programs come from the store.
SCANS = {"import": 0, "scan": 2, "shapes": 0, "bending": 0, "strain": 0, "energy_balance": 4, "stored_energy": 0}
SCANS |= {"to_csv": 0, "to_dataframe": 0, "lateral_stability": 0, "deflect": 0}
OTHERS = {"import": 0, "scan": 2, "animate": 27, "lateral_loss": 41, "reconstruct": 14, "identify": 2}
OTHERS |= {"information": 0, "design": 2, "study": 1, "summary": 0, "critical_stiffness": 27, "modes": 0, "simulate": 2}
OTHERS |= {"fit_profile": 13, "fit_contour": 39, "tactile_image": 4, "scan in space": 0}


@pytest.mark.parametrize("most", [SCANS, OTHERS], ids=["scans", "others"])
def test_first_calls_compile_few_operations_outside_programs(most):
    names = [name for name in most if name != "import"]
    command = [sys.executable, str(TESTS / "compilations_child.py"), *names]
    done = subprocess.run(command, cwd=TESTS, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found.keys() == most.keys()
    assert {name: (len(own), own) for name, own in found.items() if len(own) > most[name]} == {}


def test_every_public_function_is_called():
    functions = {name for name in jw.__all__ if name[0].islower()}
    assert functions - SCANS.keys() - OTHERS.keys() == ELSEWHERE
