"""Computation of studies: the default control, and a cluster whose worker dies."""

import os
import signal
import threading
import time

import pytest
import xarray as xr
from distributed import Client, LocalCluster

import jaxwhisker as jw
from study_child import AXES, CONTROL
from study_child import build as shared

PATIENCE = 120.0  # seconds for the first blocks to come


def _build(stiffness, distance):
    return jw.Scene(jw.Whisker(), jw.Parabola(distance), jw.Support.fb(stiffness))


# The workers cannot import tests: the function goes to them by its code.
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
        # In mid-study: some blocks are complete, others are being computed.
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
