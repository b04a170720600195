"""The node on each kind of board: pins, battery, and the cause of each kind of restart."""

import itertools
import shutil

import numpy as np
import pytest

import hubowire
from hubodo.emulator.board.models import MODELS
from hubodo.emulator.board.settings import BoardSettings, Flash, SensorBoard
from hubodo.emulator.chips.faults import BrownOut, Reset
from hubodo.emulator.motion import StillMotion
from hubodo.ingest.node.health import report_worsening
from hubowire import messages as m
from repetitions import each_value_first
from virtual_runs import (
    FIRMWARE,
    match_samples,
    messages_of,
    micropython_or_skip,
    request,
    run,
    unique_motion,
    virtual_node,
)

BOARDS = {
    "pico": m.Board.PICO,
    "pico_w": m.Board.PICO_W,
    "pico_2": m.Board.PICO_2,
    "pico_2_w": m.Board.PICO_2_W,
    "esp32": m.Board.ESP32,
    "esp32_s3": m.Board.ESP32_S3,
    "esp32_c3": m.Board.ESP32_C3,
}
PICOS = ["pico", "pico_w", "pico_2", "pico_2_w"]
UART_NUMBERS = {"esp32": 2, "esp32_s3": 1, "esp32_c3": 1, **dict.fromkeys(PICOS, 0)}


def run_with_health(tmp_path, seconds, *, health, config=None, **settings):
    """Run a node with another `reports.health`; return the bytes on its console and its resets."""
    micropython_or_skip()
    shutil.copytree(FIRMWARE, tmp_path / "firmware")
    reports = tmp_path / "firmware" / "reports.py"
    reports.write_text(f"{reports.read_text()}\n\n{health}")
    with virtual_node(seconds, StillMotion(), Flash(tmp_path / "firmware", config), **settings) as node:
        node.wait(100)
        return node.output, node.stats["resets"]


@pytest.mark.parametrize(("model", "link"), each_value_first(list(MODELS), ["usb", "uart"]))
def test_every_board_finds_its_sensor_on_its_own_pins(model, link):
    """The wiring is that of the README; the emulated port refuses pins and units that the board lacks."""
    uart = UART_NUMBERS[model] if link == "uart" else None
    sent, truth, stats = run(2, board=BoardSettings(model=model, uart_link=uart), config={"link": link})
    hello, health = messages_of(sent, m.Hello)[-1], messages_of(sent, m.Health)[-1]
    assert m.Board(hello.board) == BOARDS[model]
    assert health.faults == 0 and health.i2c_errors == 0
    assert len(match_samples(sent, truth)) > 300
    assert stats["resets"] == []


@pytest.mark.parametrize("model", PICOS)
def test_a_full_battery_on_vsys_is_measured_without_a_fault(model):
    """The radio of a Pico W shares the pin, and the divider reads 0.03 V unless the radio is deselected."""
    sent, _, _ = run(2, board=BoardSettings(model=model, battery_mv=4800))
    reports = messages_of(sent, m.Health)
    assert reports and {report.faults & m.Fault.LOW_BATTERY for report in reports} == {0}
    assert all(abs(report.battery_mv - 4800) < 15 for report in reports)


@pytest.mark.parametrize("model", ["pico", "pico_w"])
def test_a_battery_that_runs_empty_is_reported_until_the_last_second_and_nothing_is_written(model, tmp_path):
    """The supply falls from 3.6 V by 0.1 V/s, and ends at 3.2 V without notice."""
    micropython_or_skip()
    end, journal = 4.0, tmp_path / "journal"
    journal.touch()
    board = BoardSettings(model=model, battery_mv=3600, battery_mv_per_s=-100)
    with virtual_node(end, unique_motion(end), Flash(FIRMWARE, journal=journal), board=board) as node:
        node.wait(100)
        frames, truth = hubowire.FrameDecoder().feed(node.output), node.chip.truth()
    sent = [(frame, hubowire.decode(frame.type_id, frame.payload)) for frame in frames]
    reports = messages_of(sent, m.Health)
    for report in reports:
        expected_mv = 3600 - 100e-6 * report.t_us
        assert abs(report.battery_mv - expected_mv) < 15
        assert bool(report.faults & m.Fault.LOW_BATTERY) == (report.battery_mv < 3300)
    assert end - 1.1 < reports[-1].t_us * 1e-6 and reports[-1].faults == m.Fault.LOW_BATTERY
    events = [
        event for one, two in itertools.pairwise(reports) for event in report_worsening("left", one, two, 0)
    ]
    assert [event.text for event in events] == ["left: low battery"]
    matches = match_samples(sent, truth)
    assert np.all(np.diff(matches[:, 0]) == 1) and truth.t[int(matches[-1, 0])] > end - 0.1
    assert journal.read_text() == "", "a loss of power cannot harm files that nothing writes"


@pytest.mark.parametrize("model", ["esp32", "esp32_s3", "esp32_c3"])
def test_a_board_without_a_divider_measures_the_battery_only_with_a_configured_pin(model):
    sent, _, _ = run(2, board=BoardSettings(model=model))
    assert {(h.battery_mv, h.faults) for h in messages_of(sent, m.Health)} == {(0, 0)}
    pins = {"battery": MODELS[model].battery_pin}
    sent, _, _ = run(2, board=BoardSettings(model=model, battery_mv=4100), config={"pins": pins})
    assert all(abs(h.battery_mv - 4100) < 15 for h in messages_of(sent, m.Health))


@pytest.mark.parametrize(("model", "measured"), [("pico", True), ("pico_w", False), ("pico_2_w", False)])
def test_the_battery_is_not_measured_while_wi_fi_uses_its_pin(tmp_path, model, measured):
    config = {"link": "udp", "ssid": "x", "password": "y", "host": "127.0.0.1"}
    probe = "def health(node):\n    print('battery', node.board.battery_mv())\n"
    printed, _ = run_with_health(tmp_path, 3.0, health=probe, board=BoardSettings(model=model), config=config)
    volts_mv = {int(line.split()[1]) for line in printed.decode().splitlines() if line.startswith("battery")}
    assert volts_mv and (min(volts_mv) > 3600 if measured else volts_mv == {0})


@pytest.mark.parametrize(
    ("model", "chip"), each_value_first(["pico", "pico_2_w", "esp32"], ["lsm6ds33", "mpu6050", "mpu6500"])
)
def test_the_cause_of_each_restart_is_reported(model, chip):
    """The node restarts by power-on, a requested reboot, the reset pin and a brown-out."""
    script = [(1.0, request(1, m.Reboot(m.RebootMode.RUN)))]
    faults = [Reset(2.5), BrownOut(4.0)]
    sent, _, stats = run(
        5.5, sensors=SensorBoard(chip), board=BoardSettings(model=model), script=script, faults=faults
    )
    assert [cause for _, cause in stats["resets"]] == ["machine.reset", "reset pin", "brown-out"]
    boots = {hello.boot_id: m.ResetCause(hello.reset_cause) for hello in messages_of(sent, m.Hello)}
    brown_out_cause = m.ResetCause.BROWN_OUT if model == "pico_2_w" else m.ResetCause.POWER_ON
    assert list(boots.values()) == [
        m.ResetCause.POWER_ON,
        m.ResetCause.SOFT,
        m.ResetCause.HARD,
        brown_out_cause,
    ]


@pytest.mark.parametrize("model", ["pico", "pico_2", "esp32"])
def test_a_watchdog_reset_is_distinguished_from_a_reboot(tmp_path, model):
    stall = "from time import sleep_ms\n\ndef health(node):\n    sleep_ms(9000)\n"
    printed, resets = run_with_health(tmp_path, 11.0, health=stall, board=BoardSettings(model=model))
    assert resets[0][1] == "watchdog"
    sent = [(f, hubowire.decode(f.type_id, f.payload)) for f in hubowire.FrameDecoder().feed(printed)]
    causes = [hello.reset_cause for hello in messages_of(sent, m.Hello)]
    assert causes[0] == m.ResetCause.POWER_ON and causes[-1] == m.ResetCause.WATCHDOG


WARM_UP = {"bias_udps": [0, 0, 0], "warmup_udps": [1_400_000, 0, 0], "warmup_s": 10, "gain_bias_q30": 0}


def reported_biases(sent):
    """Return (bias in steps, boot number from 0) of the x axis in each Filter message."""
    boot, rows, last_boot = -1, [], None
    for _, message in sent:
        if isinstance(message, m.Hello) and message.boot_id != last_boot:
            last_boot, boot = message.boot_id, boot + 1
        if isinstance(message, m.Filter) and message.state == m.FilterState.TRACKING:
            rows.append((message.bias_q12[0] / 4096, boot))
    return rows


@pytest.mark.parametrize(("model", "chip"), each_value_first(["pico", "esp32"], ["lsm6ds33", "mpu6050"]))
def test_the_warm_up_continues_after_a_reset_and_restarts_after_a_brown_out(model, chip):
    """The warm-up is 1.4 deg/s within 10 s: complete after a reset, restarted by a brown-out."""
    faults = [Reset(2.0), BrownOut(4.0)]
    sent, _, _ = run(
        6,
        sensors=SensorBoard(chip),
        board=BoardSettings(model=model),
        motion=StillMotion(),
        faults=faults,
        config=WARM_UP,
    )
    rows = np.array(reported_biases(sent))
    full = 1.4 / (0.07 if chip == "lsm6ds33" else 2000 / 32768)
    first, warm, cold = (rows[rows[:, 1] == boot, 0] for boot in (0, 1, 2))
    assert first[-1] < 0.25 * full, "the chip is cold after power-on"
    assert np.all(np.abs(warm - full) < 0.02 * full), "the reset pin does not cool the chip"
    assert cold[-1] < 0.25 * full, "a brown-out lets it start cold"


def test_a_change_of_range_does_not_make_a_cold_chip_warm():
    """Stop and Start create a new driver, while the chip keeps running."""
    script = [
        (1.0, request(1, m.Stop())),
        (1.1, request(2, m.SetConfig(m.ConfigKey.GYRO_RANGE_DPS, 1000))),
        (1.2, request(3, m.Start())),
    ]
    sent, _, _ = run(3, motion=StillMotion(), script=script, config=WARM_UP)
    steps = np.array([row[0] for row in reported_biases(sent)])
    assert messages_of(sent, m.Hello)[-1].gyro_range_dps == 1000
    assert steps[-1] < 0.4 * 1.4 / 0.035


def test_an_imu_on_spi_delivers_every_sample_and_is_configured_again_after_a_dip_of_the_supply():
    sent, truth, _ = run(
        3.5,
        config={"rate_hz": 200, "pins": {"imu_csn": 13}},
        sensors=SensorBoard("icm42688", select_pin=13),
        faults=(BrownOut(2.0, "chips"),),
    )
    hello, health = messages_of(sent, m.Hello)[-1], messages_of(sent, m.Health)[-1]
    assert hello.parts == ((0, 0x47, 0), (0x1E, 0x3D, m.Part.LIS3MDL)) and messages_of(sent, m.Mag)
    matches = match_samples(sent, truth)
    before = matches[truth.t[matches[:, 0].astype(int)] < 2.0]
    assert len(before) > 350 and np.all(np.diff(before[:, 0]) == 1)
    assert np.abs(before[200:, 1]).max() < 50, "us"
    gaps = [bool(batch.flags & m.BatchFlag.GAP_BEFORE) for batch in messages_of(sent, m.ImuBatch)]
    assert sum(gaps) == 1 and truth.t[int(matches[-1, 0])] > 3.4
    assert (health.faults, health.i2c_errors) == (0, 1), "lost settings count as an error"
