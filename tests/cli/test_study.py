"""The command `study`: options, files, exit codes, output, pictures."""

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

SAME = 1e-9  # difference between a scan in a batch and a single one, relative to the peak
CRITICAL = 28.791640199192  # largest dF_x/dx0 of the clamped whisker at q = 0.2, by the closed form
READ = 1e-4  # relative: the critical stiffness is interpolated between 33 values of a range

BAD = {
    "nothing varies": (["--stiffness", "70"], ["needs a range", "jaxwhisker scan"]),
    "range": (["--stiffness", "30:200"], ["--stiffness", "start:stop:count", "'30:200'"]),
    "count": (["--stiffness", "30:200:1"], ["--stiffness", "start:stop:count"]),
    "count is a word": (["--distance", "0.1:0.4:many"], ["--distance", "'0.1:0.4:many'"]),
    "value": (["--distance", "0.1,near"], ["--distance", "'near'"]),
    "fixed value": (["--stiffness", "30:200:3", "--distance", "-0.1"], ["`distance`", "-0.1"]),
    "stiffness of no spring": (["--model", "clamped", "--stiffness", "30:200:3"], ["--stiffness", "clamped"]),
    "radius of a parabola": (["--radius", "1:2:3"], ["--radius", "parabola"]),
    "half a control": (["--stiffness", "30,50", "--start", "1"], ["--stop", "--start"]),
    "step": (["--stiffness", "30,50", "--start", "1", "--stop", "0", "--step", "-1"], ["--step", "-1.0"]),
    "format of the picture": (["--stiffness", "30,50", "--plot", "map.doc"], ["--plot", "map.doc"]),
    "picture of three ranges": (
        ["--stiffness", "30,50", "--distance", "0.1,0.2", "--a", "1,2", "--plot", "m.png"],
        ["--plot"],
    ),
    "folder of the store": (["--stiffness", "30,50", "--store", "nowhere/out.zarr"], ["nowhere"]),
    "store that cannot be written": (["--stiffness", "30,50", "--store", "/proc/out.zarr"], ["/proc/out.zarr"]),
    "picture that cannot be written": (["--stiffness", "30,50", "--plot", "/proc/map.png"], ["/proc/map.png"]),
}


@pytest.mark.parametrize("name", BAD)
def test_wrong_options_end_with_one_line_and_exit_code_2(name, refuses):
    argv, words = BAD[name]
    refuses(["study", *argv], words)


def test_axes_are_ranges_lists_or_numbers():
    np.testing.assert_array_equal(axis("30:200:64"), np.linspace(30, 200, 64))
    assert axis("30,50,inf") == (30.0, 50.0, np.inf)
    assert axis("0.2") == (0.2,)


def peaks(failed, max_fy):
    """The summary of a study over three stiffnesses, made by hand."""
    dims = ("stiffness", "whisker")
    names = ("min_fx", "max_fx", "max_mz", "contact_width")
    values = {name: (dims, np.ones((3, 1))) for name in names} | {"max_fy": (dims, np.reshape(max_fy, (3, 1)))}
    coords = {"stiffness": [30.0, 40.0, 50.0], "whisker": [1]}
    attrs = {"points": "in words", "scene": "FB", "typical_force": 9.6e-3, "typical_length": 0.05}
    data = xr.Dataset(values | {"steps_failed": ("stiffness", failed)}, coords, attrs)
    for name in (*names, "max_fy"):
        data[name].attrs["units"] = {"max_mz": "N m", "contact_width": "m"}.get(name, "N")
    return data


@pytest.mark.parametrize(
    ("failed", "max_fy", "code", "last"),
    [
        ([0, 0, 0], [1.0, 1.0, 1.0], cli.OK, "scans: in words"),
        ([0, 2, 0], [1.0, np.nan, 1.0], cli.OK, "scans: in words"),
        ([2, 2, 2], [np.nan, np.nan, np.nan], cli.NOT_ALL_OK, "scans: in words"),
        ([0, 0, 0], [1.0, 0.0, 0.0], cli.OK, "No whisker touches the object in 2 of 3 scans."),
        (
            [0, 0, 0],
            [0.0, 0.0, 0.0],
            cli.NO_CONTACT,
            "No whisker touches the object in any scan: all reactions are zero.",
        ),
    ],
)
def test_exit_code_and_last_line_report_how_the_study_ended(failed, max_fy, code, last, monkeypatch, capsys):
    def study(*_, **settings):
        # The first line is printed at once, before anything is computed.
        assert capsys.readouterr().out == "FB, parabola: 3 scans; stiffness 30 to 50 (3 values)\n"
        return peaks(failed, max_fy)

    monkeypatch.setattr("jaxwhisker.cli.study.study", study)
    assert cli.main(["study", "--stiffness", "30:50:3"]) == code
    printed = capsys.readouterr().out
    assert printed.splitlines()[-1] == last
    assert "max mz (mN mm)" in printed and "contact width (mm)" in printed
    assert any(line.split() == ["1", "contact", "width", "(mm)", *["1000"] * 3] for line in printed.splitlines())


CONTROL = ["--start", "0.9", "--stop", "-1.7", "--step", "0.05"]
LINE = ["study", "--stiffness=-5,50,80,inf", "--distance", "0.15:0.2:2", "--rest-length", "0.1", *CONTROL]


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    line = [*LINE, "--store", str(folder / "out.zarr"), "--plot", str(folder / "map.png")]
    return cli.main(line), line, folder


def opened(folder):
    return xr.open_zarr(folder / "out.zarr", chunks=None, consolidated=False)


def test_store_contains_the_scans(stored):
    code, _, folder = stored
    assert code == cli.OK  # although the scans with a negative stiffness failed
    data = opened(folder)
    assert dict(data.fy.sizes) == {"stiffness": 4, "distance": 2, "control": 53, "whisker": 1}
    assert bool(data.fy.isel(stiffness=0).isnull().all())
    for c, q in ((50.0, 0.15), (80.0, 0.2), (np.inf, 0.2)):
        one = jw.scan(model("FB", c, rest_length=0.1, distance=q), data.control.values)
        found = data.sel(stiffness=c).sel(distance=q, method="nearest")
        np.testing.assert_allclose(found.mz.values, one.mz, atol=SAME * 10)
        np.testing.assert_array_equal(found.status.values, one.status)


def test_the_same_line_resumes_and_prints_the_results(stored, capsys, monkeypatch):
    code, line, folder = stored
    before = opened(folder).load()
    monkeypatch.setattr(Kernel, "__call__", None)  # nothing is left to compute
    assert cli.main(line) == code
    xr.testing.assert_identical(opened(folder).load().drop_attrs(), before.drop_attrs())
    printed = capsys.readouterr().out
    assert "6 of 8 ok; 2 invalid (stiffness = -5, distance = 0.15: `stiffness` must be" in printed
    peak = float(jw.summary(before).max_mz.max())
    assert any(
        words[:3] == ["1", "max", "mz"] and words[-1] == f"{peak:.5g}" for words in map(str.split, printed.split("\n"))
    )


def test_a_different_command_line_for_the_store_is_rejected(stored, capsys):
    _, line, folder = stored
    assert cli.main([word.replace("50,80", "50,81") for word in line]) == cli.USAGE
    assert "`store`" in capsys.readouterr().err
    assert 80.0 in opened(folder).stiffness


def test_picture_is_not_blank(stored):
    _, _, folder = stored
    assert np.std(imread(folder / "map.png")[..., :3]) > 0.05


def test_the_picture_shows_the_critical_stiffness():
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
    np.testing.assert_array_equal(np.asarray(curve.get_xdata()), [-5.0, 50.0, 80.0])  # infinity is left out
    np.testing.assert_array_equal(np.asarray(curve.get_ydata()), found.max_mz.values[:3, 0])
    np.testing.assert_allclose(np.asarray(critical.get_xdata()), [60.0, 60.0])
    assert ax.get_xlabel() == "stiffness (EI/L$^{3}$)" and ax.get_ylabel() == "largest $m_z$ (EI/L)"
