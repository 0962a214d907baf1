"""A scan on one page."""

from matplotlib.figure import Figure

from jaxwhisker._scan.quantities import REACTIONS
from jaxwhisker._scan.result import Result, check_one_scan
from jaxwhisker.plot.axes import control_size
from jaxwhisker.plot.signals import contact_range, reactions, spring_lengths
from jaxwhisker.plot.states import shapes


def overview(result: Result) -> Figure:
    """Draw a scan on one page: a state, the reactions and the lengths of the springs; return the Figure.

    Args:
        result: of `scan`.

    Raises:
        ValueError: if `result` is none of one scan.
    """
    springs = bool(check_one_scan(result).scene.support.springs)
    figure = Figure(figsize=(11, 6.5), layout="constrained")
    figure.suptitle(str(result.scene), fontsize=11)
    grid = figure.add_gridspec(len(REACTIONS) + springs, 2, width_ratios=(1, 1.2))
    low, high = contact_range([result])
    shapes(result, (low + high) / 2 * control_size(result.scene), ax=figure.add_subplot(grid[:, 0]))
    axes = [figure.add_subplot(grid[row, 1]) for row in range(grid.nrows)]
    reactions(result, axs=axes[:3])
    if springs:
        spring_lengths(result, ax=axes[3])
    for ax in axes:
        ax.set_xlim(low, high)
    for ax in axes[:-1]:
        ax.tick_params(labelbottom=False)
        ax.set_xlabel("")
    return figure
