"""Programs in a separate process, for tests of the store: python program_child.py SIZE...

For each size, print the sum of the solution of a linear system, and whether the program was compiled in this process.
"""

import json
import sys

import jax.numpy as jnp
import numpy as np

from jaxwhisker._base import linear_algebra
from jaxwhisker._base.program import Program

LAPACK = 6  # a program for this size calls LAPACK, which jax initialises when it lowers a program
SIZES = (2, 3, LAPACK)


class Counted(Program):
    """A program that counts how often it is compiled."""

    count = 0

    def _compile(self, *args):
        self.count += 1
        return super()._compile(*args)


def solved(size: int) -> tuple[float, int]:
    """Sum of the solution of a system of this size, and how many programs were compiled for it."""
    program = Counted(jnp.linalg.solve if size == LAPACK else linear_algebra.solve)
    rows = np.arange(size * size, dtype=float).reshape(size, size)
    return float(program(np.eye(size) + 0.01 * rows, np.ones((size, 1))).sum()), program.count


if __name__ == "__main__":
    import jax

    jax.config.update("jax_enable_x64", True)
    print(json.dumps([solved(int(size)) for size in sys.argv[1:]]))
