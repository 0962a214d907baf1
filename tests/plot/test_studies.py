"""Maps of studies."""

# pyright: reportOptionalMemberAccess=false, reportAttributeAccessIssue=false, reportIndexIssue=false
# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false

import numpy as np
import pytest

from jaxwhisker import plot
from jaxwhisker.plot import studies
from pictured import steepness, summarised


def test_maps_share_a_scale():
    axs = plot.study(summarised(), critical=steepness(summarised()))
    assert [ax.get_legend().get_title().get_text() for ax in axs] == ["whisker 1", "whisker 2"]
    first, second = (ax.collections[0] for ax in axs)
    assert first.get_clim() == second.get_clim()
    assert axs[0].get_xlabel() == "stiffness [EI/L^3]" and axs[0].get_legend() is not None


def test_the_critical_stiffness_is_interpolated():
    critical = steepness(summarised()).isel(distance=1)
    (at,) = studies._crossings(critical.stiffness.values, critical.values)
    assert at == pytest.approx(43.2)
    assert studies._crossings(np.array([0.0, 1.0]), np.array([2.0, 0.5])) == []
