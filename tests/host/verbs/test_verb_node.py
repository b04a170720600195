"""`hubodo node` against a fake node and the real firmware: identity, settings, bias, restart, refusals."""

import json
import math
import time

import pytest

from fakes.fake_node import FakeNode
from hubodo.cli import main
from hubodo.emulator.board.settings import Flash, Host
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.flash.image import firmware_folder
from hubowire.messages import BiasInit, BiasKind, ConfigKey, FilterKind, Reason, Reboot, SetConfig, Start
from virtual_runs import micropython_or_skip


def run_node_verb(capsys, *arguments):
    """Run `hubodo node`; return its exit code, its JSON or None, and the lines on stderr."""
    code = main(["node", *map(str, arguments), "--json"])
    output = capsys.readouterr()
    return code, json.loads(output.out) if output.out else None, output.err.strip().splitlines()


def test_info_shows_identification_and_health_of_the_node(capsys):
    with FakeNode(node_id=2, bias_q12=(4096, 0, -4096)) as node:
        code, result, _ = run_node_verb(capsys, node.path, "info")
        assert main(["node", node.path, "info"]) == 0
    shown = capsys.readouterr().out
    assert code == 0
    assert (result["node_id"], result["node"]) == (2, "right")
    assert result["hello"]["serial"] == b"FAKE0001".hex()
    assert result["hello"]["rate_hz"] == "208"
    assert result["health"]["battery_mv"] == 3700
    assert result["faults"] == []
    assert result["bias_filter"]["bias_x"] == pytest.approx(math.radians(0.07))
    assert result["bias_filter"]["sigma_y"] is None
    assert "node 2 (right)" in shown and "battery_mv" in shown and "0x6b who_am_i 0x69" in shown


def test_settings_are_stored_one_by_one_and_sampling_restarts_with_them(capsys):
    with FakeNode() as node:
        code, result, _ = run_node_verb(
            capsys, node.path, "set", "rate_hz=104", "filter-kind=RLS", "gyro_range_dps=500"
        )
        requests = [message for message in node.requests if isinstance(message, SetConfig | Start)]
    assert code == 0
    assert result["done"] == {"rate_hz": 104, "filter_kind": FilterKind.RLS, "gyro_range_dps": 500}
    assert requests == [
        SetConfig(ConfigKey.RATE_HZ, 104),
        SetConfig(ConfigKey.FILTER_KIND, FilterKind.RLS),
        SetConfig(ConfigKey.GYRO_RANGE_DPS, 500),
        Start(),
    ]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["set"], "at least one setting"),
        (["set", "rate=104"], "write KEY=VALUE with one of node_id"),
        (["set", "rate_hz"], "write KEY=VALUE"),
        (["set", "rate_hz=fast"], "write a whole number"),
        (["set", "bias_kind=best"], "or one of mean, rest, table, gravity"),
        (["set", "rate_hz=9999999999"], "does not fit 32 bits"),
        (["info", "rate_hz=104"], "takes no settings"),
        (["info", "--kind", "rest"], "--kind belongs to bias"),
        (["bias", "--repl"], "--repl belongs to reboot"),
        (["bias", "--samples", "100"], "from 2000"),
    ],
)
def test_invalid_arguments_are_refused_in_one_line_before_the_port_is_opened(capsys, arguments, message):
    code, result, lines = run_node_verb(capsys, "/dev/does-not-exist", *arguments)
    assert (code, result, len(lines)) == (2, None, 1)
    assert message in lines[0]


@pytest.mark.parametrize(
    ("reason", "arguments", "code", "message"),
    [
        (Reason.BAD_VALUE, ["set", "rate_hz=105"], 2, "refuses SetConfig: invalid value (7)"),
        (
            Reason.NOT_STORED,
            ["set", "batch=4"],
            1,
            "the setting could not be written to its flash",
        ),
        (Reason.WHEEL_TURNS, ["bias"], 1, "refuses BiasInit: the wheel turns; hold it still"),
        (99, ["bias"], 1, "refuses BiasInit: reason 99, unknown to this host"),
    ],
)
def test_a_refusal_by_the_node_is_one_line_with_its_exit_code(capsys, reason, arguments, code, message):
    with FakeNode(refuse=reason) as node:
        exit_code, result, lines = run_node_verb(capsys, node.path, *arguments)
    assert (exit_code, result, len(lines)) == (code, None, 1)
    assert message in lines[0]


def test_a_bias_initialisation_is_requested_with_kind_and_number_of_samples(capsys):
    with FakeNode(bias_q12=(410, 0, 0)) as node:
        code, result, _ = run_node_verb(capsys, node.path, "bias", "--kind", "rest", "--samples", "3000")
        requests = [message for message in node.requests if isinstance(message, SetConfig | BiasInit)]
    assert code == 0
    assert requests == [SetConfig(ConfigKey.BIAS_KIND, BiasKind.REST), BiasInit(3000)]
    assert result["bias_filter"]["bias_x"] == pytest.approx(math.radians(0.07) * 410 / 4096)


class PromptNode(FakeNode):
    """A node that sends Hello right after its answer, as seen by a host that reads late."""

    def _answer(self, frame, message):
        super()._answer(frame, message)
        self._turn()


class HastyNode(FakeNode):
    """A node whose port disappears at once, with its unread answer, and comes back."""

    def _answer(self, frame, message):
        super()._answer(frame, message)
        if isinstance(message, Reboot):
            self.unplug(drain=False)
            self.plug()


@pytest.mark.parametrize("kind", [FakeNode, PromptNode, HastyNode])
def test_a_restart_is_waited_for(capsys, tmp_path, kind):
    with kind(link=tmp_path / "tty") as node:
        before = node.hello().boot_id
        code, result, _ = run_node_verb(capsys, node.path, "reboot")
        assert any(isinstance(message, Reboot) for message in node.requests)
        after = node.hello().boot_id
    assert code == 0
    assert before != after == int(result["hello"]["boot_id"])


def test_a_silent_port_another_node_and_another_protocol_are_named(capsys):
    with FakeNode(fingerprint=0xDEADBEEF) as node:
        code, _, lines = run_node_verb(capsys, node.path, "info")
        assert code == 2 and "the node speaks deadbeef" in lines[0] and "hubodo flash" in lines[0]
    with FakeNode() as node:
        code, _, lines = run_node_verb(capsys, node.path, "info", "--node-id", "9")
        assert code == 1 and "node 9 is not received; received: 1" in lines[0]
    with FakeNode() as node:
        node._streaming, node._next_health, node._next_hello = False, math.inf, math.inf
        time.sleep(0.1)
        code, _, lines = run_node_verb(capsys, node.path, "info")
        assert code == 1 and len(lines) == 1


@pytest.mark.timeout(300)
def test_the_real_firmware_changes_its_rate_initialises_its_bias_and_restarts(tmp_path, capsys):
    micropython_or_skip()
    bias = (0.02, -0.01, 0.03)
    node = VirtualNode(
        StillMotion(rate=bias),  # for a gyro at standstill a constant rate is a bias
        Flash(firmware_folder(), {"node_id": 1, "rate_hz": 208}),
        host=Host(path=tmp_path / "ttyLEFT"),
    )
    with node:
        code, result, lines = run_node_verb(capsys, node.port, "set", "rate_hz=833", "node_id=2")
        assert code == 0, lines
        assert float(result["hello"]["rate_hz"]) == pytest.approx(833, rel=0.01)
        assert result["node"] == "right"
        code, result, lines = run_node_verb(capsys, node.port, "bias", "--kind", "mean")
        assert code == 0, lines
        step = math.radians(0.07)
        for axis, value in zip("xyz", bias, strict=True):
            assert result["bias_filter"][f"bias_{axis}"] == pytest.approx(value, abs=step)
        assert result["bias_filter"]["samples"] == 2000
        code, _, lines = run_node_verb(capsys, node.port, "set", "rate_hz=7")
        assert code == 2 and "refuses SetConfig" in lines[-1]
        before = int(result["hello"]["boot_id"])
        code, result, lines = run_node_verb(capsys, node.port, "reboot")
        assert code == 0, lines
        assert int(result["hello"]["boot_id"]) != before
        assert float(result["hello"]["rate_hz"]) == pytest.approx(833, rel=0.01)
