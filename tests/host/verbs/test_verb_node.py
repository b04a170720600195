"""`hubodo node` against a fake node and the real firmware: what it is, settings, bias, restart, refusals."""

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


def asked(capsys, *words):
    """(exit code, JSON or None, the lines on stderr) of `hubodo node`."""
    code = main(["node", *map(str, words), "--json"])
    told = capsys.readouterr()
    return code, json.loads(told.out) if told.out else None, told.err.strip().splitlines()


def test_info_tells_who_the_node_is_and_how_it_fares(capsys):
    with FakeNode(node_id=2, bias_q12=(4096, 0, -4096)) as node:
        code, told, _ = asked(capsys, node.path, "info")
        assert main(["node", node.path, "info"]) == 0
    shown = capsys.readouterr().out
    assert code == 0
    assert (told["node_id"], told["node"]) == (2, "right")
    assert told["hello"]["serial"] == b"FAKE0001".hex()
    assert told["hello"]["rate_hz"] == "208"
    assert told["health"]["battery_mv"] == 3700
    assert told["faults"] == []
    assert told["bias_filter"]["bias_x"] == pytest.approx(math.radians(0.07))
    assert told["bias_filter"]["sigma_y"] is None
    assert "node 2 (right)" in shown and "battery_mv" in shown and "0x6b who_am_i 0x69" in shown


def test_settings_are_stored_one_by_one_and_those_of_sampling_put_into_force(capsys):
    with FakeNode() as node:
        code, told, _ = asked(
            capsys, node.path, "set", "rate_hz=104", "filter-kind=RLS", "gyro_range_dps=500"
        )
        requests = [message for message in node.requests if isinstance(message, SetConfig | Start)]
    assert code == 0
    assert told["done"] == {"rate_hz": 104, "filter_kind": FilterKind.RLS, "gyro_range_dps": 500}
    assert requests == [
        SetConfig(ConfigKey.RATE_HZ, 104),
        SetConfig(ConfigKey.FILTER_KIND, FilterKind.RLS),
        SetConfig(ConfigKey.GYRO_RANGE_DPS, 500),
        Start(),
    ]


@pytest.mark.parametrize(
    ("words", "said"),
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
def test_what_makes_no_sense_is_refused_in_one_line_before_the_port_is_touched(capsys, words, said):
    code, told, lines = asked(capsys, "/dev/does-not-exist", *words)
    assert (code, told, len(lines)) == (2, None, 1)
    assert said in lines[0]


@pytest.mark.parametrize(
    ("reason", "words", "code", "said"),
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
def test_a_refusal_of_the_node_is_one_line_with_the_right_code(capsys, reason, words, code, said):
    with FakeNode(refuse=reason) as node:
        found, told, lines = asked(capsys, node.path, *words)
    assert (found, told, len(lines)) == (code, None, 1)
    assert said in lines[0]


def test_a_bias_is_asked_for_with_its_kind_and_number_of_samples(capsys):
    with FakeNode(bias_q12=(410, 0, 0)) as node:
        code, told, _ = asked(capsys, node.path, "bias", "--kind", "rest", "--samples", "3000")
        requests = [message for message in node.requests if isinstance(message, SetConfig | BiasInit)]
    assert code == 0
    assert requests == [SetConfig(ConfigKey.BIAS_KIND, BiasKind.REST), BiasInit(3000)]
    assert told["bias_filter"]["bias_x"] == pytest.approx(math.radians(0.07) * 410 / 4096)


class PromptNode(FakeNode):
    """Says Hello right behind its answer, as it looks to a host that reads late."""

    def _answer(self, frame, message):
        super()._answer(frame, message)
        self._turn()


class HastyNode(FakeNode):
    """Its port goes with what the host has not read yet, the answer among it, and comes back."""

    def _answer(self, frame, message):
        super()._answer(frame, message)
        if isinstance(message, Reboot):
            self.unplug(drain=False)
            self.plug()


@pytest.mark.parametrize("kind", [FakeNode, PromptNode, HastyNode])
def test_a_restart_is_waited_for(capsys, tmp_path, kind):
    with kind(link=tmp_path / "tty") as node:
        before = node.hello().boot_id
        code, told, _ = asked(capsys, node.path, "reboot")
        assert any(isinstance(message, Reboot) for message in node.requests)
        after = node.hello().boot_id
    assert code == 0
    assert before != after == int(told["hello"]["boot_id"])


def test_a_silent_port_a_stranger_and_another_version_are_named(capsys):
    with FakeNode(fingerprint=0xDEADBEEF) as node:
        code, _, lines = asked(capsys, node.path, "info")
        assert code == 2 and "the node speaks deadbeef" in lines[0] and "hubodo flash" in lines[0]
    with FakeNode() as node:
        code, _, lines = asked(capsys, node.path, "info", "--node-id", "9")
        assert code == 1 and "node 9 is not received; received: 1" in lines[0]
    with FakeNode() as node:
        node._streaming, node._next_health, node._next_hello = False, math.inf, math.inf
        time.sleep(0.1)
        code, _, lines = asked(capsys, node.path, "info")
        assert code == 1 and len(lines) == 1


@pytest.mark.timeout(300)
def test_the_real_firmware_is_told_a_rate_finds_its_bias_and_starts_anew(tmp_path, capsys):
    micropython_or_skip()
    bias = (0.02, -0.01, 0.03)
    node = VirtualNode(
        StillMotion(rate=bias),  # to a gyro at rest the same
        Flash(firmware_folder(), {"node_id": 1, "rate_hz": 208}),
        host=Host(path=tmp_path / "ttyLEFT"),
    )
    with node:
        code, told, lines = asked(capsys, node.port, "set", "rate_hz=833", "node_id=2")
        assert code == 0, lines
        assert float(told["hello"]["rate_hz"]) == pytest.approx(833, rel=0.01)
        assert told["node"] == "right"
        code, told, lines = asked(capsys, node.port, "bias", "--kind", "mean")
        assert code == 0, lines
        step = math.radians(0.07)
        for axis, value in zip("xyz", bias, strict=True):
            assert told["bias_filter"][f"bias_{axis}"] == pytest.approx(value, abs=step)
        assert told["bias_filter"]["samples"] == 2000
        code, _, lines = asked(capsys, node.port, "set", "rate_hz=7")
        assert code == 2 and "refuses SetConfig" in lines[-1]
        before = int(told["hello"]["boot_id"])
        code, told, lines = asked(capsys, node.port, "reboot")
        assert code == 0, lines
        assert int(told["hello"]["boot_id"]) != before
        assert float(told["hello"]["rate_hz"]) == pytest.approx(833, rel=0.01)
