"""Monitoring of a recording: Prometheus metrics and health."""

import itertools
import urllib.error
import urllib.request
from dataclasses import replace

import pytest
from prometheus_client.parser import text_string_to_metric_families

from fakes.fake_node import FakeNode
from hubodo.errors import InputError
from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.metrics import assess_health, metrics_text
from hubodo.ingest.live.metrics_server import MetricsServer
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.virtual_computer import VirtualComputer


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Return (snapshots, result) of three seconds of a node with damaged frames."""
    computer, snapshots = VirtualComputer(), []
    out = tmp_path_factory.mktemp("metrics") / "ride.mcap"
    with FakeNode(damage=2e-4, seed=3, computer=computer) as node:
        config = RecordConfig(ports=(f"left={node.path}",), duration=3.3)
        result = record(config, out, computer=computer, watch={"test": snapshots.append})
    return snapshots, result


def values(snapshot):
    """Return {(metric, node): value} as parsed from the text format."""
    families = text_string_to_metric_families(metrics_text(snapshot).decode())
    return {(s.name, s.labels.get("node")): s.value for family in families for s in family.samples}


def test_one_snapshot_a_second_has_the_counters_of_the_recorder(recording):
    snapshots, result = recording
    assert len(snapshots) == 4
    assert [round(b.t_ns - a.t_ns, -8) for a, b in itertools.pairwise(snapshots)] == [10**9] * 3
    (node,), (link,) = snapshots[-1].nodes, snapshots[-1].links
    assert 0 < node.samples <= result.nodes["left"]["samples"]
    assert node.rate == pytest.approx(208, rel=0.05)
    assert node.battery == 3.7
    assert node.temperature == pytest.approx(26.0)
    assert 0 < link.frames_damaged <= result.links["left"]["frames_damaged"]


def test_the_text_has_the_promised_names_and_the_recorders_numbers(recording):
    now = recording[0][-1]
    metrics = values(now)
    (node,), (link,) = now.nodes, now.links
    assert metrics["hubodo_frames_received_total", "left"] == node.frames
    assert metrics["hubodo_frames_lost_total", "left"] == node.frames_lost
    assert metrics["hubodo_sample_rate_hertz", "left"] == pytest.approx(node.rate)
    assert metrics["hubodo_clock_offset_seconds", "left"] == pytest.approx(node.clock_offset)
    assert metrics["hubodo_crc_errors_total", None] == link.crc_errors > 0
    assert metrics["hubodo_reconnects_total", None] == 0
    assert metrics["hubodo_recorder_bytes_total", None] == now.log.total > 0
    assert metrics["hubodo_recording", None] == metrics["hubodo_build_info", None] == 1
    assert metrics["hubodo_memory_bytes", None] > 1e6
    assert metrics["hubodo_disk_free_bytes", None] > 0


def test_health_names_only_the_problems(recording):
    now = recording[0][-1]
    assert assess_health(now)[0], assess_health(now)[1]
    hung = assess_health(now, now.t_ns + 60 * 10**9)
    assert hung == (False, "the recorder has made no progress for 60 s")
    full = replace(now, log=replace(now.log, recording=False, trouble="no space left"))
    assert assess_health(full) == (False, "nothing is recorded: no space left")
    dead = replace(now, links=tuple(replace(link, where=None) for link in now.links))
    assert assess_health(dead) == (False, "down: left")
    half = replace(now, links=(*now.links, *dead.links))
    assert assess_health(half)[0]
    assert assess_health(half)[1].endswith("down: left")
    assert values(full)["hubodo_recording", None] == 0


def test_both_are_served_without_the_page_and_a_hang_or_a_full_disk_turns_health_to_503(recording):
    now, clock = recording[0][-1], [0]

    def got(path):
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{server.port}{path}", timeout=10) as page:
                return page.status, page.read()
        except urllib.error.HTTPError as error:
            return error.code, error.read()

    with MetricsServer("127.0.0.1:0", lambda: clock[0]) as server:
        assert got("/healthz") == (503, b"starting\n")
        server.show(now)
        clock[0] = now.t_ns
        assert got("/healthz") == (200, b"recording ride.mcap\n")
        status, text = got("/metrics")
        assert status == 200
        assert b"hubodo_samples_total" in text
        assert got("/etc/passwd")[0] == 404
        clock[0] += 30 * 10**9
        assert got("/healthz")[0] == 503
        with pytest.raises(InputError, match="choose another port"):
            MetricsServer(f"127.0.0.1:{server.port}", lambda: 0)
    with pytest.raises(InputError, match="HOST:PORT"):
        MetricsServer("9464", lambda: 0)
