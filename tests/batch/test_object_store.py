"""Logs and results in an S3 server on loopback, with the ordinary client."""

import json

import pandas as pd
import pytest

from batch.fleet_logs import FleetLog, cut, write
from in_process import hubodo
from repetitions import first_and_more

pytestmark = pytest.mark.real_time

BUCKET = "drives"


@pytest.fixture(scope="module")
def server():
    """Yield the address of the server, shared by all tests because a process caches its client."""
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    yield "http://{}:{}".format(*server.get_host_and_port())
    server.stop()


@pytest.fixture
def store(server, monkeypatch):
    """Return a client of the server; workers find it by the environment variables of the AWS tools."""
    import boto3

    for name, value in (
        ("AWS_ENDPOINT_URL", server),
        ("AWS_ACCESS_KEY_ID", "none"),
        ("AWS_SECRET_ACCESS_KEY", "none"),
        ("AWS_DEFAULT_REGION", "us-east-1"),
    ):
        monkeypatch.setenv(name, value)
    client = boto3.client("s3")
    for bucket in client.list_buckets()["Buckets"]:
        for item in client.list_objects_v2(Bucket=bucket["Name"]).get("Contents", ()):
            client.delete_object(Bucket=bucket["Name"], Key=item["Key"])
    client.create_bucket(Bucket=BUCKET)
    return client


@pytest.mark.parametrize("engine", first_and_more("thread", "process"))
def test_a_bucket_gives_the_results_of_a_folder_and_stores_them(store, here, tmp_path, engine):
    folder = tmp_path / "logs"
    paths = [write(folder, FleetLog(f"van-{day % 2}", day, seed=day)) for day in range(3)]
    paths.append(cut(folder, FleetLog("van-1", 9, seed=9)))
    for path in paths:
        store.upload_file(str(path), BUCKET, str(path.relative_to(folder)))

    def batch(logs, out, *options):
        done = hubodo("batch", "allan", logs, "-o", out, *options, "--json")
        assert done.code == 0, done.err
        return json.loads(done.out)

    assert batch(folder, tmp_path / "out", *here)["done"] == 3
    worker = here if engine == "thread" else ("--workers", 1)
    there = batch(f"s3://{BUCKET}/", f"s3://{BUCKET}/results", *worker)
    assert (there["done"], there["refused"], there["fresh"]) == (3, 1, 4)
    assert batch(f"s3://{BUCKET}/*/*.mcap", f"s3://{BUCKET}/results", *here)["fresh"] == 0
    store.download_file(BUCKET, "results/table.parquet", str(tmp_path / "table.parquet"))
    near, far = (
        pd.read_parquet(tmp_path / "out" / "table.parquet"),
        pd.read_parquet(tmp_path / "table.parquet"),
    )
    assert far.log.str.startswith(f"s3://{BUCKET}/van-").all()
    far.log = far.log.str.replace(f"s3://{BUCKET}/", f"{folder}/")
    far.error = far.error.str.replace(f"s3://{BUCKET}/", f"{folder}/")
    pd.testing.assert_frame_equal(near.drop(columns="cpu"), far.drop(columns="cpu"))
    page = store.get_object(Bucket=BUCKET, Key="results/fleet.html")["Body"].read()
    assert b"4 logs of 2 vehicles" in page


def test_files_of_a_verb_are_stored_beside_the_table(store, here, tmp_path):
    write(tmp_path / "logs", FleetLog("van-1", 0, seed=1))
    words = ["batch", "export", tmp_path / "logs", "--format", "parquet", "-o", f"s3://{BUCKET}/out"]
    done = hubodo(*words, *here)
    assert done.code == 0, done.err
    names = [item["Key"] for item in store.list_objects_v2(Bucket=BUCKET)["Contents"]]
    assert any(name.startswith("out/files/export/20260601T060000-1-") for name in names)
    assert any(name.endswith("/left.parquet") for name in names)


def test_a_missing_bucket_is_refused_in_one_line(store, tmp_path):
    done = hubodo("batch", "info", "s3://nobody/", "-o", tmp_path / "out")
    assert done.code == 2 and done.err.count("\n") == 1 and "s3://nobody/" in done.err
