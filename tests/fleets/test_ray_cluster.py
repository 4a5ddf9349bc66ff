"""Many cases on a Ray cluster of two workers: the results of local processes, also if one is killed in the middle.

All tests with Ray are in this file, which one process runs: a cluster can be joined from every process of the machine.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from threading import Thread
from typing import Any

import pandas as pd
import pytest
from guard import HANG

from gapscope.many.fleet import FleetPlan, run_fleet
from gapscope.many.rows import FleetStore
from gapscope.many.workers import in_order, ray_module

pytestmark = pytest.mark.skipif(
    find_spec("ray") is None,
    reason="Ray is not installed: make setup-learn, or pip install 'gapscope[cluster]'",
)
CHANCE = ["result", "finished", "seconds", "processor_seconds", "tries", "kept"]
"""Columns that differ from run to run."""


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two nodes of one core on the loopback interface, joined by this process."""
    ray = ray_module()
    from ray.cluster_utils import Cluster

    made = Cluster()
    for _ in range(2):
        # Ray replaces 127.0.0.1 by the address of the machine in its network
        made.add_node(
            node_ip_address="127.0.0.2",
            num_cpus=1,
            object_store_memory=80_000_000,
            include_dashboard=False,
        )
    ray.init(address=made.address, log_to_driver=False)
    yield made
    ray.shutdown()
    made.shutdown()


def _kill_a_busy_worker(cluster: Any, killed: list[int]) -> None:
    """Kill the first process of the cluster that is seen at a diagnosis; Ray names it after its function."""
    import psutil

    processes = [node.all_processes["raylet"] for node in cluster.list_all_nodes()]
    raylets = [one.process.pid for several in processes for one in several]
    end = time.monotonic() + HANG
    while time.monotonic() < end:
        for raylet in raylets:
            for worker in psutil.Process(raylet).children():
                if "diagnose_fleet_case" in " ".join(worker.cmdline()):
                    worker.send_signal(signal.SIGKILL)
                    killed.append(worker.pid)
                    return
        time.sleep(0.01)


def _rows(out: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Cases and numbers of effects without what differs from run to run."""
    store = FleetStore(out)
    cases = store.cases().sort_values("case", ignore_index=True)
    effects = store.effects("one", cases["result"])
    return cases.drop(columns=CHANCE), effects.drop(columns="result")


@pytest.mark.slow
@pytest.mark.nightly
def test_a_worker_killed_in_the_middle_changes_nothing_but_the_tries(
    cluster: Any, fleet_folder: Path, tmp_path: Path
) -> None:
    killed: list[int] = []
    killer = Thread(target=_kill_a_busy_worker, args=(cluster, killed))
    killer.start()
    ray_plan = FleetPlan((str(fleet_folder),), tmp_path / "ray", backend="ray")
    counts = run_fleet(ray_plan, lambda message: None)
    killer.join()
    assert killed and (counts.diagnosed, counts.failed) == (2, 1)
    assert sorted(FleetStore(tmp_path / "ray").cases()["tries"]) == [1, 1, 2]

    local_plan = FleetPlan((str(fleet_folder),), tmp_path / "local", jobs=2)
    run_fleet(local_plan, lambda message: None)
    both = (_rows(tmp_path / way) for way in ("ray", "local"))
    for ray_rows, local_rows in zip(*both, strict=True):
        pd.testing.assert_frame_equal(ray_rows, local_rows, check_exact=True)


@pytest.mark.nightly
def test_several_cases_of_one_diagnose_are_the_same_by_ray(
    cluster: Any, command: Callable[..., Any], fleet_folder: Path, tmp_path: Path
) -> None:
    cases, ways = sorted(fleet_folder.glob("arm_[AB]*")), ("local", "ray")
    for way in ways:
        how = ("--out", tmp_path / way, "--backend", way)
        assert command("diagnose", *cases, *how).code == 0
    for name in ("units.json", *(f"{case.name}/diagnosis.json" for case in cases)):
        local, ray = ((tmp_path / way / name).read_bytes() for way in ways)
        assert local == ray


@pytest.mark.nightly
def test_a_worker_that_is_lost_costs_its_own_call_only(cluster: Any) -> None:
    made = list(in_order(_inverse(), [(2,), (0,), (4,)], jobs=2, backend="ray"))
    assert made[0] == 0.5 and made[2] == 0.25
    assert isinstance(made[1], Exception)


def _inverse() -> Callable[[int], float]:
    """1 / number [1]; the process ends where there is none. Made here, so that workers need not import this file."""

    def inverse(number: int) -> float:
        if number == 0:
            os._exit(1)
        return 1.0 / number

    return inverse
