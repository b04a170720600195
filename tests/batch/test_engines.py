"""Every engine gives the same numbers even if a worker dies; finished results are stored."""

import json
import os
import re
import signal
import subprocess
import sys
import time

import pandas as pd
import pytest

from batch.cluster import cluster
from batch.fleet_logs import FleetLog, write
from hubodo.fleet import engine as engines
from hubodo.fleet.engine import connect_client, examine_each
from in_process import hubodo

pytestmark = pytest.mark.real_time

LOGS = 6
COLUMNS = ["log", "vehicle", "date", "status", "node", "quantity", "value", "sigma", "unit"]


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    for number in range(LOGS):
        write(folder, FleetLog(f"van-{number % 3}", number, seed=number))
    return folder


def numbers(out):
    read = pd.read_parquet(out / "table.parquet")
    return read[COLUMNS].sort_values(["log", "quantity", "node"]).reset_index(drop=True)


def batch(logs, out, *options):
    """Run a batch of `info`, which starts faster than other verbs, and return its --json output."""
    logs = logs if isinstance(logs, list) else [logs]
    done = hubodo("batch", "info", *logs, "-o", out, "--json", *options)
    assert done.code == 0, done.err
    return json.loads(done.out)


def test_a_cluster_that_loses_a_worker_gives_the_results_of_a_local_run(logs, tmp_path, here, monkeypatch):
    assert batch(logs, tmp_path / "here", *here)["done"] == LOGS
    with cluster(tmp_path, 2) as running:

        def lose_one(client, work, places):
            for number, outcome in enumerate(examine_each(client, work, places)):
                if number == 2:
                    running.workers[0].kill()
                yield outcome

        monkeypatch.setattr("hubodo.fleet.workflow.examine_each", lose_one)
        done = batch(logs, tmp_path / "there", "--scheduler", running.address)
        assert running.workers[0].wait() == -signal.SIGKILL and running.workers[1].poll() is None
    assert done["done"] == LOGS
    pd.testing.assert_frame_equal(numbers(tmp_path / "here"), numbers(tmp_path / "there"))


def test_a_log_that_kills_its_worker_is_a_failed_row_and_is_retried_and_its_neighbours_are_not_blamed(
    logs, tmp_path, here, monkeypatch
):
    """The analysis kills its worker, as the kernel does when memory runs out.

    The killer comes first, so its death finds its neighbours assigned to the same worker.
    """
    import dask

    killer = write(tmp_path, FleetLog("van-9", 1.0, seed=99)).rename(tmp_path / "killer.mcap")
    monkeypatch.setattr("hubodo.verbs.batch.run_on_log", _die_at_killer)
    # Dask gives up after one killed worker instead of four, as each takes seconds to start.
    settings = {"distributed.scheduler.allowed-failures": 0, "distributed.scheduler.worker-saturation": 4.0}
    with dask.config.set(settings):
        first = batch([killer, logs / "van-0"], tmp_path / "out", "--workers", 1)
    assert (first["done"], first["failed"]) == (LOGS // 3, 1)
    assert "died" in first["errors"][0]["error"] and first["errors"][0]["log"] == str(killer)
    monkeypatch.undo()
    again = batch([killer, logs / "van-0"], tmp_path / "out", *here)
    assert (again["fresh"], again["done"], again["failed"]) == (1, LOGS // 3 + 1, 0)


def _die_at_killer(verb, options, log, folder):
    if log.name == "killer.mcap":
        os.kill(os.getpid(), signal.SIGKILL)
    from hubodo.verbs.batch import run_on_log

    return run_on_log(verb, options, log, folder)


def test_ctrl_c_stores_finished_results_and_exits_with_130(logs, tmp_path, here):
    out = tmp_path / "out"
    words = ["batch", "info", str(logs), "-o", str(out), "--workers", "1"]
    command = [sys.executable, "-c", INTERRUPTED, *words]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 130, errors
    *progress, last = errors.splitlines()
    assert last == "hubodo batch: interrupted; nothing more was written"
    assert all(re.match(r" *\d+ %  ", line) for line in progress), errors
    finished = numbers(out).log.nunique()
    assert 3 <= finished < LOGS
    assert (out / "fleet.html").is_file()
    assert _none_left(process.pid)
    assert batch(logs, out, *here)["fresh"] == LOGS - finished


INTERRUPTED = """
import os, signal, sys
from hubodo.cli import main
from hubodo.fleet import workflow
if __name__ == "__main__":
    # Background jobs and `nohup` ignore it, and programs inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    plain = workflow.examine_each
    def each(*given):
        for number, made in enumerate(plain(*given)):
            yield made
            if number == 2:
                os.killpg(0, signal.SIGINT)  # as a terminal does: to all of them
    workflow.examine_each = each
    sys.exit(main(sys.argv[1:]))
"""


def _none_left(group):
    """Return True once no process of the group exists."""
    for _ in range(100):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


def test_a_missing_scheduler_is_refused_in_one_line(logs, tmp_path, monkeypatch):
    monkeypatch.setattr(engines, "_SCHEDULER_TIMEOUT_S", 0.5)
    done = hubodo("batch", "info", logs, "-o", tmp_path / "out", "--scheduler", "tcp://127.0.0.1:9")
    assert done.code == 1
    assert done.err.count("\n") == 1 and "tcp://127.0.0.1:9: no scheduler answers" in done.err


def test_workers_accept_no_connection_without_the_certificate_of_the_run():
    from distributed import Client

    with connect_client(None, 1, "auto") as client:
        address = client.scheduler.address
        assert address.startswith("tls://127.0.0.1:")
        assert client.submit(sum, [1, 2]).result() == 3
        for stranger in (address, address.replace("tls", "tcp")):
            with pytest.raises((OSError, TypeError)):
                Client(stranger, timeout=1)
