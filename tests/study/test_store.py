"""A study on disk: it resumes after being killed at any moment, and never mixes studies or leaves half a block."""

import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr

import jaxwhisker as jw
from jaxwhisker._scan import dataset
from jaxwhisker._study.store import Store
from study_child import AXES, CONTROL, build

CHILD = Path(__file__).parents[1] / "study_child.py"
KILLS = 4
BLOCKS = 16  # of the study
PATIENCE = 120.0  # seconds to wait for a child


@pytest.fixture(scope="module")
def whole():
    """The study, computed in memory without interruption."""
    return jw.study(build, control=CONTROL, **AXES)


@pytest.fixture(scope="module")
def stored(whole, tmp_path_factory):
    """The finished study on disk, for tests that do not change it."""
    store = tmp_path_factory.mktemp("stored") / "study.zarr"
    jw.study(build, control=CONTROL, store=store, **AXES)
    return store


@pytest.fixture
def copied(stored, tmp_path):
    """The finished study on disk, for tests that change it."""
    return Path(shutil.copytree(stored, tmp_path / "study.zarr"))


def _identical(found: xr.Dataset, whole: xr.Dataset) -> None:
    # Bit for bit; NaN equals NaN.
    xr.testing.assert_identical(found.load().assign_attrs(date=""), whole.assign_attrs(date=""))


def _marks(store: Path) -> list[Path]:
    """Chunks of `point_status`, one for every complete block."""
    return sorted(
        path for path in (store / "point_status" / "c").rglob("*") if path.name.isdecimal() and path.is_file()
    )


def _index(store: Path, mark: Path) -> tuple[str, ...]:
    return mark.relative_to(store / "point_status" / "c").parts


def _check_unfinished(store: Path, whole: xr.Dataset) -> int:
    """Check that complete blocks are, and that everything can be read. Return the number of complete blocks."""
    found = xr.open_zarr(store, chunks=None).load()
    block = _block(store)
    for mark in _marks(store):
        index = map(int, _index(store, mark))
        region = {dim: slice(k * b, k * b + b) for dim, k, b in zip(AXES, index, block, strict=True)}
        xr.testing.assert_equal(found.isel(region), whole.isel(region))
    return len(_marks(store))


def _block(store: Path) -> tuple[int, ...]:
    return zarr.open_array(store / "point_status", mode="r").chunks


class TestKilled:
    def test_goes_on_and_ends_bit_for_bit_the_same(self, whole, tmp_path):
        store, moments = tmp_path / "study.zarr", random.Random(4)
        complete = 0
        for kill in range(KILLS):
            child = subprocess.Popen([sys.executable, CHILD, store], stderr=subprocess.PIPE)
            # The first kill comes while the store is created, the others after another block is complete.
            begun = store.with_name("study.zarr.new")
            self._wait(child, begun.exists if kill == 0 else lambda n=complete: len(_marks(store)) > n)
            time.sleep(moments.uniform(0.0, 0.05 if kill == 0 else 0.2))
            child.send_signal(signal.SIGKILL)
            _, printed = child.communicate()
            assert child.returncode == -signal.SIGKILL, printed.decode()
            if store.exists():
                before, complete = complete, _check_unfinished(store, whole)
                assert complete >= before
            # Leave some blocks for the last run, however fast the machine.
            if 2 * complete > BLOCKS:
                break
        kept = {mark: mark.stat().st_mtime_ns for mark in _marks(store)}
        total = int(np.prod([-(-v.size // b) for v, b in zip(AXES.values(), _block(store), strict=True)]))
        assert total == BLOCKS
        assert 0 < len(kept) < total, "killed too early or too late"
        subprocess.run([sys.executable, CHILD, store], check=True, capture_output=True)
        assert kept == {mark: mark.stat().st_mtime_ns for mark in kept}, "complete blocks were computed again"
        _identical(xr.open_zarr(store, chunks=None), whole)

    @staticmethod
    def _wait(child, reached) -> None:
        end = time.monotonic() + PATIENCE
        while not reached():
            assert child.poll() is None, child.stderr.read().decode()
            assert time.monotonic() < end, "the child takes too long"
            time.sleep(0.002)


class TestUnfinished:
    def test_a_torn_chunk_is_computed_again(self, copied, whole):
        mark = _marks(copied)[3]
        chunk = copied / "mz" / "c" / Path(*_index(copied, mark), "0", "0")
        chunk.write_bytes(chunk.read_bytes()[:100])
        mark.unlink()
        _identical(jw.study(build, control=CONTROL, store=copied, **AXES), whole)

    def test_complete_blocks_are_not_computed_again(self, copied):
        chunk = copied / "mz" / "c" / Path(*_index(copied, _marks(copied)[3]), "0", "0")
        chunk.unlink()  # it would come back if its block were computed again
        again = jw.study(build, control=CONTROL, store=copied, **AXES)
        assert int(np.isnan(again.mz.isel(stiffness=slice(-1))).sum()) > 0

    def test_a_template_of_a_killed_process_is_written_again(self, whole, tmp_path):
        begun = tmp_path / "study.zarr.new"
        (begun / "point_status" / "c" / "0").mkdir(parents=True)
        (begun / "point_status" / "c" / "0" / "0").write_bytes(b"complete")
        (begun / "mz").mkdir()
        (begun / "mz" / "zarr.json").write_text("{")
        _identical(jw.study(build, control=CONTROL, store=tmp_path / "study.zarr", **AXES), whole)
        assert not begun.exists()

    def test_reads_as_not_computed(self, copied, whole):
        for chunk in (copied / "status" / "c", copied / "mz" / "c", copied / "event_kind" / "c"):
            shutil.rmtree(chunk)
        found = xr.open_zarr(copied)
        assert bool((found.status == -1).all()) and bool(np.isnan(found.mz).all())
        assert bool((found.event_kind == -1).all())

    def test_the_points_are_counted_in_the_store(self, stored):
        assert (
            xr.open_zarr(stored)
            .attrs["points"]
            .startswith("124 of 128 ok; 4 invalid (stiffness = -1, distance = 0.2: `stiffness` must be")
        )


class TestAnotherStudy:
    @pytest.mark.parametrize(
        ("change", "words"),
        [
            (dict(stiffness=AXES["stiffness"][:-1]), "its axis `stiffness` has 32 values, this one 31"),
            (dict(stiffness=AXES["stiffness"] + 1), "its axis `stiffness` has other values"),
            (dict(control=CONTROL[:-1]), "its control has 30 values, this one 29"),
            (dict(control=None), "its control is an explicit one"),
            (dict(outputs="status"), "its variables also contain event_control, .* mz"),
            (dict(derivatives="distance"), "its variables lack d_event_control_d_distance, .* d_mz_d_distance"),
            (dict(summary=True), "its variables lack contact_width, .* and also contain fx, fy, mz, status"),
            (
                dict(build=lambda distance, stiffness: build(stiffness, 1.01 * distance)),
                "its `build` makes other scenes",
            ),
        ],
        ids=lambda value: None if isinstance(value, str) else "-".join(value),
    )
    def test_is_refused(self, stored, whole, change, words):
        arguments = {"build": build, "control": CONTROL} | AXES | change
        with pytest.raises(ValueError, match=f"`store` must be that of the same study .* differs: {words}"):
            jw.study(**arguments, store=stored)
        _identical(xr.open_zarr(stored, chunks=None), whole)

    def test_other_axes_are_refused(self, stored):
        with pytest.raises(ValueError, match="its axes are distance, stiffness, here axes are stiffness"):
            jw.study(lambda stiffness: build(stiffness, 0.2), store=stored, stiffness=[70.0])

    def test_another_version_is_refused(self, stored, monkeypatch):
        monkeypatch.setattr(dataset, "version", lambda _: "99.0")
        with pytest.raises(ValueError, match=r"its jaxwhisker is .*, here 99\.0"):
            jw.study(build, control=CONTROL, store=stored, **AXES)

    def test_what_is_no_study_is_left_alone(self, tmp_path):
        xr.Dataset({"a": ("x", np.arange(3))}).to_zarr(tmp_path / "mine.zarr", consolidated=False)
        (tmp_path / "file").write_text("mine")
        for name in ("mine.zarr", "file"):
            before = sorted(tmp_path.rglob("*"))
            with pytest.raises(
                ValueError, match=f"`store` must be that of a study or not exist, got .*{name}, which is something else"
            ):
                jw.study(build, store=tmp_path / name, **AXES)
            assert sorted(tmp_path.rglob("*")) == before

    def test_two_at_once_are_refused(self, stored, tmp_path):
        holder = Store(stored)
        with pytest.raises(ValueError, match=r"`store` must not be in use, got .* another process"):
            jw.study(build, control=CONTROL, store=stored, **AXES)
        holder.close()
        Store(stored).close()
        beginner = Store(tmp_path / "new.zarr")
        with pytest.raises(ValueError, match="`store` must not be in use"):
            Store(tmp_path / "new.zarr")
        beginner.close()
