"""Logs and results in Google Cloud Storage, emulated on loopback, with the ordinary client."""

import json

import pandas as pd
import pytest

from batch.fleet_logs import FleetLog, write
from in_process import hubodo

pytestmark = pytest.mark.real_time

BUCKET = "drives"


@pytest.fixture
def store(monkeypatch):
    """Return a client of the store; workers find it by the environment variable of Google's tools."""
    from gcp_storage_emulator.server import create_server

    # The client queries the kind of a bucket by gRPC, which the emulated store lacks.
    monkeypatch.setenv("GCSFS_EXPERIMENTAL_ZB_HNS_SUPPORT", "false")
    server = create_server("127.0.0.1", 0, in_memory=True, default_bucket=BUCKET)
    server.start()
    address = "http://{}:{}".format(*server._api._httpd.server_address[:2])
    monkeypatch.setenv("STORAGE_EMULATOR_HOST", address)
    from gcsfs import GCSFileSystem

    yield GCSFileSystem(token="anon", endpoint_url=address, skip_instance_cache=True)
    server.stop()


def test_a_google_bucket_gives_the_results_of_a_folder_and_stores_them(store, here, tmp_path):
    folder = tmp_path / "logs"
    for day in range(2):
        path = write(folder, FleetLog(f"van-{day}", day, seed=day))
        store.put_file(str(path), f"{BUCKET}/{path.relative_to(folder)}")

    def batch(logs, out):
        done = hubodo("batch", "allan", logs, "-o", out, *here, "--json")
        assert done.code == 0, done.err
        return json.loads(done.out)

    assert batch(folder, tmp_path / "out")["done"] == 2
    there = batch(f"gs://{BUCKET}/", f"gs://{BUCKET}/results")
    assert (there["done"], there["refused"], there["fresh"]) == (2, 0, 2)
    assert batch(f"gs://{BUCKET}/*/*.mcap", f"gs://{BUCKET}/results")["fresh"] == 0
    store.get_file(f"{BUCKET}/results/table.parquet", str(tmp_path / "table.parquet"))
    near = pd.read_parquet(tmp_path / "out" / "table.parquet")
    far = pd.read_parquet(tmp_path / "table.parquet")
    far.log = far.log.str.replace(f"gs://{BUCKET}/", f"{folder}/")
    pd.testing.assert_frame_equal(near.drop(columns="cpu"), far.drop(columns="cpu"))
