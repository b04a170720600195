"""The whole node in real MicroPython on the virtual board: requests, faults, times, nothing invented."""

import shutil

import numpy as np
import pytest

import hubowire
from hubodo.calibration.apply import SampleCorrection
from hubodo.calibration.file import CalibratedEffect, NodeCalibration, Quantity
from hubodo.emulator.board.settings import Clock, Flash, Host, SensorBoard
from hubodo.emulator.chips.faults import BrownOut, BusNack, MissedSamples, OdrStep, StuckBus
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.motion import RecordedMotion, StillMotion
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.flash.node_settings import merged
from hubowire import messages as m
from virtual_runs import FIRMWARE, PERIOD, matched, micropython_or_skip, of, request, run, unique_motion

RATES = [
    ("lsm6ds33", 208, 0.0),
    ("lsm6ds33", 208, 0.1),
    ("lsm6ds33", 416, -0.1),
    ("lsm6ds33", 833, 0.07),
    ("lsm6ds33", 1660, -0.04),
    ("mpu6050", 200, 0.03),
    ("lsm6ds33", 104, 0.05),
    ("mpu6500", 1000, -0.02),
]


@pytest.mark.parametrize(("chip", "rate", "odr_error"), RATES)
def test_every_sample_arrives_in_order_and_its_time_is_known(chip, rate, odr_error):
    sent, truth, _ = run(
        5, sensors=SensorBoard(chip, specimen=Specimen(odr_error=odr_error)), config={"rate_hz": rate}
    )
    found = matched(sent, truth)
    # Between waking and its configuration an MPU runs at its own rate: those samples are not asked for.
    assert np.array_equal(found[:, 0] - found[0, 0], np.arange(len(found)))
    assert np.array_equal(found[:, 2], np.arange(len(found)))
    assert truth.t[int(found[0, 0])] < 0.03 and len(truth.t) - found[-1, 0] <= 20
    settled = found[truth.t[found[:, 0].astype(int)] > 3.5, 1]
    print(f"{chip} {rate} Hz: time error {settled.mean():.0f} +- {settled.std():.0f} us")
    # At 416 Hz the chip is looked at only 26 times a second, and the estimate settles more slowly.
    assert np.abs(settled).max() < (400 if rate == 416 else 200)
    period_us = of(sent, m.ImuBatch)[-1].period_ns / 1000
    assert period_us == pytest.approx(np.median(np.diff(truth.t)) * 1e6, rel=5e-4)
    health = of(sent, m.Health)[-1]
    assert (health.faults, health.samples_missed, health.frames_dropped, health.i2c_errors) == (0, 0, 0, 0)


def test_times_run_on_when_the_ticks_begin_anew():
    start = PERIOD - 2_000_000
    sent, truth, _ = run(4, clock=Clock(ticks_start_us=start))
    found = matched(sent, truth, start)
    assert np.array_equal(found[:, 0], np.arange(len(found)))
    assert np.abs(found[len(found) // 2 :, 1]).max() < 200
    assert {batch.t_us < PERIOD // 2 for batch in of(sent, m.ImuBatch)} == {True, False}


FAULTS = [
    ("lsm6ds33", 208, BusNack(t=2.0, count=3)),
    ("lsm6ds33", 208, StuckBus(t=2.0)),
    ("lsm6ds33", 208, MissedSamples(t=2.0, n=5)),
    ("lsm6ds33", 208, BrownOut(t=2.0, of="chips")),
    ("lsm6ds33", 1660, StuckBus(t=2.0)),
    ("lsm6ds33", 833, BrownOut(t=2.0, of="chips")),
    ("mpu6050", 200, StuckBus(t=2.0)),
    ("mpu6050", 1000, StuckBus(t=2.0)),
]


@pytest.mark.parametrize(
    ("chip", "rate", "fault"), FAULTS, ids=lambda value: getattr(value, "__class__", value)
)
def test_after_a_fault_samples_go_on_and_what_is_lost_is_flagged(chip, rate, fault):
    sent, truth, _ = run(5, sensors=SensorBoard(chip), config={"rate_hz": rate}, faults=[fault])
    found = matched(sent, truth)
    k = found[:, 0]
    assert np.all(np.diff(k) > 0), "no sample twice, none out of order"
    assert truth.t[int(k[-1])] > 4.8, "still sampling at the end"
    gaps = np.flatnonzero(
        (np.diff(k) > 1) | (np.diff(truth.t[k.astype(int)]) > 1.5 * np.median(np.diff(truth.t)))
    )
    flagged = [batch for batch in of(sent, m.ImuBatch) if batch.flags & m.BatchFlag.GAP_BEFORE]
    assert len(flagged) == len(gaps)
    health = of(sent, m.Health)[-1]
    jumps = np.diff(found[:, 2]) - 1
    assert jumps.sum() == health.samples_missed
    if len(gaps):
        between = np.diff(truth.t[k.astype(int)])[gaps]
        expected = between / np.median(np.diff(truth.t)) - 1
        assert abs(health.samples_missed - expected.sum()) <= 1 + 0.01 * expected.sum()
    assert health.faults == 0
    if isinstance(fault, StuckBus):
        assert health.bus_recoveries >= 1 and health.i2c_errors >= 1
    if isinstance(fault, BusNack):
        assert health.i2c_errors == 3


@pytest.mark.parametrize("chip", ["lsm6ds33", "mpu6050"])
def test_the_fifo_serves_low_rates_when_asked_to(chip):
    sent, truth, stats = run(4, sensors=SensorBoard(chip), config={"rate_hz": 208, "fifo": True})
    found = matched(sent, truth)
    assert np.array_equal(found[:, 0] - found[0, 0], np.arange(len(found)))
    # One look at the chip in eight samples: the estimate needs longer to find the edge.
    assert np.abs(found[len(found) * 3 // 4 :, 1]).max() < 1000
    # Polled, each sample takes more than two; here only the 0.4 s in which the period is measured do.
    assert stats["bus"]["transactions"] < 1.5 * len(found)


def test_a_chip_that_becomes_faster_is_followed_without_losing_a_sample():
    sent, truth, _ = run(5, faults=[OdrStep(t=2.0, ratio=1.02)])
    found = matched(sent, truth)
    assert np.array_equal(found[:, 0], np.arange(len(found)))
    assert len(truth.t) - len(found) <= 8


@pytest.mark.parametrize("rate", [208, 416])
def test_a_chip_that_answers_only_later_is_found_and_read_in_whole_batches(rate):
    """Nobody answers when the node starts; the FIFO needs slots that the later search has shaped."""
    sent, truth, _ = run(5, config={"rate_hz": rate}, faults=[BusNack(t=0.0, count=1)])
    assert any(hello.rate_mhz == 0 for hello in of(sent, m.Hello)), "it began without a chip"
    found = matched(sent, truth)
    assert len(found) > 3 * rate
    assert np.array_equal(np.diff(found[:, 0]), np.ones(len(found) - 1))


def test_another_chip_at_the_address_is_refused_and_named():
    sent, _, _ = run(3, sensors=SensorBoard(specimen=Specimen(who_am_i=0x6A)))
    assert not of(sent, m.ImuBatch)
    assert of(sent, m.Health)[-1].faults == m.Fault.WRONG_WHO_AM_I
    assert (0x6B, 0x6A, 0) in of(sent, m.Hello)[-1].parts


def test_an_unknown_mpu_is_used_and_its_id_told():
    sent, truth, _ = run(3, sensors=SensorBoard("mpu6050", specimen=Specimen(who_am_i=0x34)))
    assert len(matched(sent, truth)) > 500
    assert (0x68, 0x34, 0) in of(sent, m.Hello)[-1].parts


def test_every_request_is_answered():
    token = b"hostTIME"
    asked = [
        m.GetHello(),
        m.Ping(),
        m.TimeRequest(token),
        m.SetConfig(m.ConfigKey.BATCH, 4),
        m.SetConfig(m.ConfigKey.RATE_HZ, 209),
        m.SetConfig(m.ConfigKey.FILTER_KIND, 3),
        m.SetConfig(99, 0),
        m.BiasInit(1999),
        m.Stop(),
        m.BiasInit(2000),
        m.Start(),
    ]
    script = [(1.0 + 0.1 * i, request(100 + i, message)) for i, message in enumerate(asked)]
    script.append((2.5, hubowire.encode_frame(hubowire.Frame(0x7F, 1, 200, b""))))
    script.append((2.6, request(201, m.Ping(), node=2)))
    script.append((2.7, b"\x05noise\x00"))
    sent, _, _ = run(4, script=script)
    acks = {(a.request, a.request_seq) for a in of(sent, m.Ack)}
    assert acks == {
        (m.Ping.type_id, 101),
        (m.SetConfig.type_id, 103),
        (m.Stop.type_id, 108),
        (m.Start.type_id, 110),
    }
    nacks = {(n.request, n.request_seq, n.reason, n.detail) for n in of(sent, m.Nack)}
    assert nacks == {
        (m.SetConfig.type_id, 104, m.Reason.BAD_VALUE, 209),
        (m.SetConfig.type_id, 105, m.Reason.BAD_VALUE, 3),
        (m.SetConfig.type_id, 106, m.Reason.BAD_VALUE, 99),
        (m.BiasInit.type_id, 107, m.Reason.BAD_VALUE, 1999),
        (m.BiasInit.type_id, 109, m.Reason.NO_IMU, 0),
        (0x7F, 200, m.Reason.UNKNOWN_MESSAGE, 0x7F),
    }
    (reply,) = of(sent, m.TimeReply)
    assert reply.token == token
    assert 1.19e6 < reply.received_us <= reply.sent_us < 1.21e6
    batches = of(sent, m.ImuBatch)
    assert {len(batch.samples) for batch in batches[-5:]} == {4}, "the new batch size since Start"
    assert sum(batch.flags & 1 for batch in batches) == 1, "the pause is a gap"
    assert of(sent, m.Health)[-1].samples_missed == 0, "nothing was missed while stopped"
    assert of(sent, m.Health)[-1].frames_damaged == 1


def test_the_bias_of_a_wheel_at_rest_is_found_and_of_a_turning_one_refused():
    rate = (0.02, -0.05, 0.1)
    init = [(0.5, request(7, m.BiasInit(2000)))]
    sent, _, _ = run(12, motion=StillMotion(rate=rate), script=init, config={"rate_hz": 416})
    assert [a.request_seq for a in of(sent, m.Ack)] == [7]
    last = of(sent, m.Filter)[-1]
    assert last.state == m.FilterState.TRACKING and last.samples == 2000
    steps = np.round(np.degrees(rate) / 0.07)
    np.testing.assert_allclose(np.array(last.bias_q12) / 4096, steps, atol=0.01)
    np.testing.assert_allclose(np.array(last.rate_q8) / 256, 0, atol=0.05)

    sent, _, _ = run(12, motion=StillMotion(rate=(0, 0, 2.0)), script=init, config={"rate_hz": 416})
    assert [(n.request_seq, n.reason) for n in of(sent, m.Nack)] == [(7, m.Reason.WHEEL_TURNS)]
    assert of(sent, m.Filter)[-1].state == m.FilterState.WAITING


@pytest.mark.parametrize("watchdog", [True, False])
def test_reboot_to_the_repl_ends_at_a_prompt_that_listens_to_ctrl_c(watchdog):
    script = [(1.0, request(1, m.Reboot(m.RebootMode.REPL))), (3.0, b"\x03print(6 * 7)\r")]
    node = VirtualNode(
        unique_motion(12),
        Flash(FIRMWARE, {"watchdog": watchdog}),
        clock=Clock("stepped", run_for=12.0),
        host=Host("memory", script=script),
        own_process=False,
    )
    with node:
        node.wait(100)
        assert node.output.replace(b"\r", b"").endswith(b"42\n>>> ")
        assert len(node.stats["resets"]) == (1 if watchdog else 0)


def test_a_settings_file_that_makes_no_sense_gives_the_defaults():
    config = {"rate_hz": "fast", "batch": 200, "node_id": 2, "unknown": 1}
    sent, _, _ = run(2, config=config)
    hello = of(sent, m.Hello)[-1]
    assert (hello.rate_mhz, hello.batch) == (416_000, 16)
    assert {frame.node for frame, _ in sent} == {2}


@pytest.mark.parametrize("at", [0.0001, 0.0005, 0.002, 0.01])
def test_a_ctrl_c_while_the_node_boots_does_not_strand_it_at_the_prompt(at):
    """Hosts may send any byte; two, as some do to be sure."""
    script = [(at, b"\x03"), (at + 0.001, b"\x03"), (0.5, b"\0" + request(1, m.Ping()))]
    sent, truth, stats = run(1, script=script)
    assert stats["counts"].get("at_prompt", 0) == 0 and stats["resets"] == []
    assert [ack.request_seq for ack in of(sent, m.Ack)] == [1]
    assert truth.t[int(matched(sent, truth)[-1, 0])] > 0.9


@pytest.mark.parametrize("link", ["usb", "uart"])
def test_a_firmware_that_fails_leaves_ctrl_c_for_the_prompt(tmp_path, link):
    firmware = tmp_path / "firmware"
    shutil.copytree(FIRMWARE, firmware)
    (firmware / "reports.py").write_text(
        (FIRMWARE / "reports.py").read_text() + "\n\ndef health(node):\n    1 // 0\n"
    )
    micropython_or_skip()
    node = VirtualNode(
        unique_motion(4),
        Flash(firmware, {"link": link}, folder=tmp_path / "flash"),
        clock=Clock("stepped", run_for=4.0),
        host=Host("memory", script=[(2.0, b"\x03")]),
        own_process=False,
    )
    with node:
        node.wait(100)
        assert node.stats["counts"]["at_prompt"] == 1 and node.stats["resets"] == []


def test_on_the_console_of_a_node_that_sends_by_uart_ctrl_c_is_ctrl_c():
    node = VirtualNode(
        unique_motion(3),
        Flash(FIRMWARE, {"link": "uart", "watchdog": False}),
        clock=Clock("stepped", run_for=3.0),
        host=Host("memory", script=[(1.5, b"\x03")]),
        own_process=False,
    )
    with node:
        node.wait(100)
        assert b"KeyboardInterrupt" in node.output and node.stats["counts"]["at_prompt"] == 1


@pytest.mark.parametrize(("forgetting", "deviation"), [(1_027_604, 0.1), (964_690, 0.2)])
def test_recursive_least_squares_is_chosen_by_configuration(forgetting, deviation):
    """Forgetting factors 0.98 and 0.92, set while running; the node reports the rate behind the bias."""
    script = [
        (0.3, request(1, m.SetConfig(m.ConfigKey.FORGETTING_Q20, forgetting))),
        (0.4, request(2, m.SetConfig(m.ConfigKey.FILTER_KIND, m.FilterKind.RLS))),
        (0.5, request(3, m.BiasInit(2000))),
        (0.6, request(4, m.GetHello())),
    ]
    motion = StillMotion(rate=(0.02, -0.05, 0.1))
    sent, _, _ = run(7, motion=motion, script=script, config={"rate_hz": 416})
    assert {ack.request_seq for ack in of(sent, m.Ack)} == {1, 2, 3}
    assert of(sent, m.Hello)[-1].filter_kind == m.FilterKind.RLS
    last = of(sent, m.Filter)[-1]
    assert last.state == m.FilterState.TRACKING and last.saturations == 0
    np.testing.assert_allclose(np.array(last.rate_q8) / 256, 0, atol=deviation)


def test_the_bias_of_the_settings_and_the_warm_up_are_told_beside_raw_samples():
    """No initialisation: bias and warm-up come from /config.json, the samples are those of the chip."""
    config = {"bias_udps": [210_000, 0, -140_000], "warmup_udps": [700_000, -1_400_000, 0], "warmup_s": 10}
    sent, truth, _ = run(12, config=config)
    found = matched(sent, truth)
    assert np.array_equal(found[:, 0], np.arange(len(found))), "not a count is touched"
    told = [f for f in of(sent, m.Filter) if f.state == m.FilterState.TRACKING]
    assert {f.samples for f in told} == {0} and {f.bias_sigma_q12 for f in told} == {(0, 0, 0)}
    age = np.array([f.t_us for f in told]) * 1e-6
    bias = np.array([f.bias_q12 for f in told]) / 4096
    grown = -np.expm1(-age / 10)[:, None]
    expected = np.array([3.0, 0.0, -2.0]) + grown * np.array([10.0, -20.0, 0.0])
    # The Kalman filter moves the bias by k2 / k1 = 1e-6 of a rate of up to 7000 steps; a batch takes 40 ms.
    np.testing.assert_allclose(bias, expected, atol=0.15)


def test_one_calibration_serves_node_and_host_and_is_applied_once():
    """A gyro that warms up at rest: the node sends it raw and names its bias; the host takes it off."""
    c1, constant, bias = np.array([0.02, 0.0, -0.01]), 10.0, np.array([0.004, -np.radians(0.14), 0.0])
    t = np.arange(0, 14, 0.005)
    gyro = bias - c1 * np.expm1(-t / constant)[:, None]
    accel = np.tile([0.0, 0.0, 9.80665], (len(t), 1))
    effects = {
        "gyro_bias": dict(zip("xyz", bias, strict=True)),
        "gyro_warmup": {**dict(zip("xyz", c1, strict=True)), "time_constant": constant},
    }
    calibration = NodeCalibration(
        {
            name: CalibratedEffect({key: Quantity(float(value), 0.0) for key, value in values.items()})
            for name, values in effects.items()
        }
    )
    sent, _, _ = run(
        13,
        motion=RecordedMotion(t, gyro, accel, temperature_c=25.0, start=0.0),
        config=merged({"gain_bias_q30": 0}, calibration),
    )
    batches = of(sent, m.ImuBatch)[10:]
    age = np.concatenate([b.t_us + b.period_ns / 1000 * np.arange(len(b.samples)) for b in batches]) * 1e-6
    raw = np.concatenate([b.samples for b in batches])
    shown = raw[:, :3] * np.radians(0.07)
    true, _ = SampleCorrection.from_calibration(calibration).apply(shown, raw[:, 3:] * 1.0, age=age)
    assert np.abs(shown[-100:].mean(axis=0) - gyro[-200]).max() < 1e-3, "sent as the chip gave it"
    # Steps of 1.2e-3 rad/s, a bias that moves by ten of them: rounding stays, the warm-up does not.
    assert np.abs(true).max() < 0.52 * np.radians(0.07) and np.abs(true.mean(axis=0)).max() < 1e-4
    told = [f for f in of(sent, m.Filter) if f.state == m.FilterState.TRACKING][5:]
    exact = bias - c1 * np.expm1(-np.array([f.t_us for f in told]) * 1e-6 / constant)[:, None]
    found = np.array([f.bias_q12 for f in told]) / 4096 * np.radians(0.07)
    assert np.abs(found - exact).max() < 0.1 * np.radians(0.07)


def test_the_bias_is_found_while_the_wheel_turns():
    """Gravity turns with 4 rad/s; 1 deg/s of bias along the axle. A wheel at rest is refused."""
    t = np.arange(0, 31, 0.001)
    accel = np.stack([9.80665 * np.cos(4 * t), -9.80665 * np.sin(4 * t), 0 * t], axis=1)
    gyro = np.tile([0.0, 0.0, 4.0 + np.radians(1.0)], (len(t), 1))
    config = {"bias_kind": m.BiasKind.GRAVITY, "bias_sigma_udps": 2_000_000, "phase_mrad": 5}
    init = [(1.0, request(7, m.BiasInit(5000)))]
    sent, _, _ = run(
        27, motion=RecordedMotion(t, gyro, accel, temperature_c=25.0), config=config, script=init
    )
    assert [a.request_seq for a in of(sent, m.Ack)] == [7]
    last = of(sent, m.Filter)[-1]
    assert last.state == m.FilterState.TRACKING and last.samples == 5000
    sigma = np.array(last.bias_sigma_q12) / 4096
    assert last.bias_q12[2] / 4096 == pytest.approx(1 / 0.07, abs=4 * sigma[2]) and sigma[2] < 1
    assert sigma[0] > 25, "across the axle nothing is seen"

    sent, _, _ = run(27, motion=StillMotion(), config=config, script=init)
    assert [(n.request_seq, n.reason) for n in of(sent, m.Nack)] == [(7, m.Reason.WHEEL_RESTS)]


@pytest.mark.parametrize("kind", [m.BiasKind.REST, m.BiasKind.TABLE])
def test_the_kind_of_initialisation_is_chosen_while_running(kind):
    """At rest, and on a table that turns with 45 deg/s, whose rate is set as well."""
    rest = np.array([0.02, -0.05, 0.1])
    rate = rest + (np.array([0.0, 0.0, np.radians(45.0)]) if kind == m.BiasKind.TABLE else 0.0)
    script = [
        (0.3, request(1, m.SetConfig(m.ConfigKey.BIAS_KIND, kind))),
        (0.4, request(2, m.SetConfig(m.ConfigKey.TABLE_RATE_UDPS, 45_000_000))),
        (0.5, request(3, m.BiasInit(2000))),
    ]
    sent, _, _ = run(7, motion=StillMotion(rate=rate), script=script, config={"rate_hz": 416})
    assert {ack.request_seq for ack in of(sent, m.Ack)} == {1, 2, 3}
    last = of(sent, m.Filter)[-1]
    steps, sigma = np.degrees(rest) / 0.07, np.array(last.bias_sigma_q12) / 4096
    found = np.array(last.bias_q12) / 4096
    print(f"{kind.name}: {found} of {steps} steps, sigma {sigma}")
    assert last.state == m.FilterState.TRACKING and last.samples == 2000
    if kind == m.BiasKind.REST:
        np.testing.assert_allclose(found, steps, atol=0.6)
    else:
        assert abs(found[2] - steps[2]) < 3 * sigma[2] and sigma[2] < sigma[0] / 4
