"""The command `study`: options, files, exit codes, pictures."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.image import imread

import jaxwhisker as jw
from jaxwhisker import cli
from jaxwhisker._study import critical as steepnesses
from jaxwhisker._study.compute import Kernel
from jaxwhisker.cli.study import axis
from jaxwhisker.plot import studies
from scenes import model

SAME = 1e-9  # a scan in a batch and alone, relative to the peak
CRITICAL = 28.791640199192  # largest dF_x/dx0 of the clamped whisker at q = 0.2, by the closed form
READ = 1e-4  # relative: the critical stiffness read between 33 values of a range

BAD = {
    "nothing varies": (["--stiffness", "70"], ["needs a range", "jaxwhisker scan"]),
    "range": (["--stiffness", "30:200"], ["--stiffness", "start:stop:count", "'30:200'"]),
    "count": (["--stiffness", "30:200:1"], ["--stiffness", "start:stop:count"]),
    "count is no number": (["--distance", "0.1:0.4:many"], ["--distance", "'0.1:0.4:many'"]),
    "value": (["--distance", "0.1,near"], ["--distance", "'near'"]),
    "fixed value": (["--stiffness", "30:200:3", "--distance", "-0.1"], ["`distance`", "-0.1"]),
    "spring of nothing": (["--model", "clamped", "--stiffness", "30:200:3"], ["--stiffness", "clamped"]),
    "radius of a parabola": (["--radius", "1:2:3"], ["--radius", "parabola"]),
    "half a control": (["--stiffness", "30,50", "--start", "1"], ["--stop", "--start"]),
    "step": (["--stiffness", "30,50", "--start", "1", "--stop", "0", "--step", "-1"], ["--step", "-1.0"]),
    "picture's kind": (["--stiffness", "30,50", "--plot", "map.doc"], ["--plot", "map.doc"]),
    "picture of three": (
        ["--stiffness", "30,50", "--distance", "0.1,0.2", "--a", "1,2", "--plot", "m.png"],
        ["--plot"],
    ),
    "store's folder": (["--stiffness", "30,50", "--store", "nowhere/out.zarr"], ["nowhere"]),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_wrong_ends_with_one_line_and_exit_code_2(name, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    argv, words = BAD[name]
    assert cli.main(["study", *argv]) == cli.USAGE
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith("jaxwhisker study: error:")
    for word in words:
        assert word in err
    assert list(tmp_path.iterdir()) == []


def test_ranges_lists_and_numbers():
    np.testing.assert_array_equal(axis("30:200:64"), np.linspace(30, 200, 64))
    assert axis("30,50,inf") == (30.0, 50.0, np.inf)
    assert axis("0.2") == (0.2,)


CONTROL = ["--start", "0.9", "--stop", "-1.7", "--step", "0.05"]
LINE = ["study", "--stiffness=-5,50,80,inf", "--distance", "0.15:0.2:2", "--rest-length", "0.1", *CONTROL]


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    line = [*LINE, "--store", str(folder / "out.zarr"), "--plot", str(folder / "map.png")]
    return cli.main(line), line, folder


def opened(folder):
    return xr.open_zarr(folder / "out.zarr", chunks=None, consolidated=False)


def test_store_holds_the_scans(stored, capsys):
    code, _, folder = stored
    assert code == cli.NOT_ALL_OK  # a negative stiffness
    data = opened(folder)
    assert dict(data.fy.sizes) == {"stiffness": 4, "distance": 2, "control": 53, "whisker": 1}
    assert bool(data.fy.isel(stiffness=0).isnull().all())
    for c, q in ((50.0, 0.15), (80.0, 0.2), (np.inf, 0.2)):
        one = jw.scan(model("FB", c, rest_length=0.1, distance=q), data.control.values)
        found = data.sel(stiffness=c).sel(distance=q, method="nearest")
        np.testing.assert_allclose(found.mz.values, one.mz, atol=SAME * 10)
        np.testing.assert_array_equal(found.status.values, one.status)


def test_the_same_line_goes_on_and_tells_what_it_found(stored, capsys, monkeypatch):
    code, line, folder = stored
    before = opened(folder).load()
    monkeypatch.setattr(Kernel, "__call__", None)  # everything is there already
    assert cli.main(line) == code
    xr.testing.assert_identical(opened(folder).load().drop_attrs(), before.drop_attrs())
    printed = capsys.readouterr().out
    assert "6 of 8 ok; 2 invalid (stiffness = -5, distance = 0.15: `stiffness` must be" in printed
    peak = float(jw.summary(before).max_mz.max())
    assert any(
        words[:3] == ["1", "max", "mz"] and words[-1] == f"{peak:.5g}" for words in map(str.split, printed.split("\n"))
    )


def test_another_line_on_the_store_is_refused(stored, capsys):
    _, line, folder = stored
    assert cli.main([word.replace("50,80", "50,81") for word in line]) == cli.USAGE
    assert "`store`" in capsys.readouterr().err
    assert 80.0 in opened(folder).stiffness


def test_picture_is_no_blank(stored):
    _, _, folder = stored
    assert np.std(imread(folder / "map.png")[..., :3]) > 0.05


def test_critical_stiffness_is_where_the_picture_has_it():
    stiffness, distance = np.linspace(10, 60, 6), np.array([0.15, 0.2])
    build = lambda stiffness, distance=0.2: model("FB", stiffness, distance=distance)  # noqa: E731
    data = xr.Dataset(coords={"stiffness": stiffness})
    steepness = steepnesses.steepness(build, data)
    (at,) = studies._crossings(steepness.stiffness.values, steepness.values)
    assert abs(at / CRITICAL - 1) < READ
    grid = steepnesses.steepness(build, xr.Dataset(coords={"stiffness": stiffness, "distance": distance}))
    np.testing.assert_allclose(grid.isel(distance=-1), steepness, rtol=1e-12)
    assert np.all(grid.isel(distance=0) > grid.isel(distance=-1))
    bad = steepnesses.steepness(build, xr.Dataset(coords={"stiffness": [-10.0, 10.0]}))
    np.testing.assert_array_equal(np.isnan(bad), bad.stiffness <= 0)


def test_one_range_is_drawn_as_lines(stored):
    _, _, folder = stored
    found = jw.summary(opened(folder)).isel(distance=1, drop=True)
    steepness = xr.DataArray([2.0, 0.5], {"stiffness": [30.0, 120.0]}, ["stiffness"])
    (ax,) = jw.plot.study(found, critical=steepness)
    curve, critical = ax.lines
    np.testing.assert_array_equal(np.asarray(curve.get_xdata()), [-5.0, 50.0, 80.0])  # infinity has no place
    np.testing.assert_array_equal(np.asarray(curve.get_ydata()), found.max_mz.values[:3, 0])
    np.testing.assert_allclose(np.asarray(critical.get_xdata()), [60.0, 60.0])
    assert ax.get_xlabel() == "stiffness [EI/L^3]" and ax.get_ylabel() == "largest mz [EI/L]"
