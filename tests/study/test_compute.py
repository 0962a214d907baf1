"""Computation of studies: the default control, and a cluster whose worker dies."""

import dataclasses
import os
import signal
import threading
import time

import numpy as np
import pytest
import xarray as xr
from distributed import Client, LocalCluster

import jaxwhisker as jw
from jaxwhisker._scan.route import STEP
from jaxwhisker._scan.scan import default_control
from jaxwhisker._study.compute import Job, common_control, compute_in_worker, key_of
from jaxwhisker._study.parameters import parameters_of
from study_child import AXES, CONTROL
from study_child import build as shared

PATIENCE = 120.0  # seconds for the first blocks to come
ROUNDING = 1e-9  # of positions in a batch and alone
MOTIONS = {
    "towards -x": jw.Translation(-1),
    "towards +x": jw.Translation(+1),
    "rotation": jw.Rotation(pivot=(0.3, 0.0), direction=-1),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_default_control_spans_the_default_controls_of_scans(name):
    motion = MOTIONS[name]

    def moved(distance):
        return jw.Scene(jw.Whisker(), jw.Parabola(distance), rod=jw.ClosedForm(), motion=motion)

    points = {"distance": [0.2, 0.3, np.nan]}  # a bad point does not count
    control = common_control(moved, parameters_of(moved, points, {}, ()), motion.onwards)
    each = [motion.onwards * default_control(moved(distance)) for distance in (0.2, 0.3)]
    travel = motion.onwards * control
    np.testing.assert_allclose(travel[0], min(u[0] for u in each), atol=ROUNDING)
    end = max(u[-1] for u in each)
    assert end - 2 * STEP < travel[-1] < end + STEP
    np.testing.assert_allclose(np.diff(travel), STEP)


def test_a_worker_refuses_another_build():
    def other(stiffness, distance):
        return shared(stiffness, 1.01 * distance)

    samples = [{"stiffness": 70.0, "distance": 0.2}]
    job = Job(shared, ("stiffness", "distance"), CONTROL, ("fx",), (), False, ("fx",))
    changed = dataclasses.replace(job, build=other, key=key_of(job, samples))
    with pytest.raises(RuntimeError, match="differ between the processes"):
        compute_in_worker(changed, samples, {})


def _build(stiffness, distance):
    return jw.Scene(jw.Whisker(), jw.Parabola(distance), jw.Support.fb(stiffness))


# The workers cannot import tests: the function is pickled by value.
_build.__module__ = "__main__"


@pytest.fixture(scope="module")
def client():
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=50) as cluster,
        Client(cluster) as client,
    ):
        yield client


def test_a_killed_worker_is_survived_and_the_bits_are_the_same(client, tmp_path):
    store = tmp_path / "study.zarr"
    killed = []

    def kill():
        # Some blocks are complete, others are being computed.
        end = time.monotonic() + PATIENCE
        while len(list((store / "point_status").glob("c/*/*"))) < 2 and time.monotonic() < end:
            time.sleep(0.01)
        worker = next(iter(pids))
        os.kill(pids[worker], signal.SIGKILL)
        killed.append(worker)

    pids = client.run(os.getpid)
    assert len(pids) == 2
    killer = threading.Thread(target=kill)
    killer.start()
    there = jw.study(_build, control=CONTROL, store=store, client=client, **AXES).load()
    killer.join()
    assert killed and killed[0] not in client.run(os.getpid)
    here = jw.study(shared, control=CONTROL, **AXES)
    xr.testing.assert_identical(there.assign_attrs(date=""), here.assign_attrs(date=""))
