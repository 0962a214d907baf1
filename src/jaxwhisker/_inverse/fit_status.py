"""How a fit ended."""

import math
from enum import IntEnum

DEVIATIONS = 6.0  # of chi^2 above which a misfit is implausible


class FitStatus(IntEnum):
    """How a fit ended; only one that ended `ok` has standard errors."""

    ok = 0
    implausible = 1  # noise does not explain the misfit: another scene, another minimum, or too small a sigma
    not_converged = 2  # the least-squares solver did not come to an end
    at_bound = 3  # a parameter ended at its bound
    failed = 4  # the scene could not be scanned there
    undetermined = 5  # the data do not tell all parameters of a profile


def plausible(chi2: float, degrees: int) -> bool:
    """Whether noise of the size that was told explains a sum of squares with so many degrees of freedom."""
    return bool(chi2 < degrees + DEVIATIONS * math.sqrt(2 * max(degrees, 1)))
