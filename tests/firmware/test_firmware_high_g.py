"""A second accelerometer of 200 g: all its samples arrive, scaled and dated, and those of the IMU as well."""

import numpy as np
import pytest

from hubodo.emulator.board.settings import SensorBoard
from hubodo.emulator.chips.adxl375 import LSB, Adxl375
from hubodo.emulator.chips.faults import BusNack
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.motion import RecordedMotion
from hubowire import messages as m
from virtual_runs import messages_of, request, run

T = np.arange(0.0, 6.0, 0.002)
FORCE = np.stack([900 * np.sin(2 * T), 300 * np.cos(3 * T), 9.8 + 5 * np.sin(T)], axis=1)
MOTION = RecordedMotion(T, np.zeros((len(T), 3)), FORCE, temperature_c=25.0, start=0.0)


def high_g_samples(sent):
    """Return device times, s, and acceleration, m/s², of all samples sent."""
    times, force = [], []
    for message in messages_of(sent, m.HighG):
        ages = np.arange(len(message.samples) - 1, -1, -1)
        times.append(message.t_us * 1e-6 - ages * message.period_ns * 1e-9)
        force.append(np.array(message.samples) * message.lsb_ng * 1e-9 * 9.80665)
    return np.concatenate(times), np.concatenate(force)


@pytest.mark.parametrize(
    ("rate_hz", "config"),
    [(400, {"rate_hz": 416, "batch": 8}), (100, {"rate_hz": 208, "fifo": False})],
    ids=["400 Hz beside a FIFO", "100 Hz beside a polled IMU"],
)
def test_each_sample_is_the_acceleration_of_its_time_and_none_is_lost(rate_hz, config):
    odr_error = 0.02
    sent, _, _ = run(
        5,
        motion=MOTION,
        config={**config, "high_g_rate_hz": rate_hz},
        sensors=SensorBoard(high_g=True, specimen=Specimen(odr_error)),
    )
    t, force = high_g_samples(sent)
    expected_s = 1.0 / (rate_hz * (1.0 - odr_error))
    assert len(t) > 4.3 / expected_s
    # Dated evenly, though a sample waits for up to a period until the node counts it; once that is measured.
    steady = t > t[0] + 1.0
    for axis in range(3):
        bounds = [np.interp(t + shift * expected_s, T, FORCE[:, axis]) for shift in np.linspace(-0.6, 0.6, 9)]
        low, high = np.min(bounds, axis=0) - LSB, np.max(bounds, axis=0) + LSB
        assert np.all(((force[:, axis] > low) & (force[:, axis] < high))[steady])
    # Both ends are dated within 0.6 of a period.
    assert np.mean(np.diff(t[steady])) == pytest.approx(expected_s, rel=1.2 / np.sum(steady))
    assert np.abs(np.diff(t[steady]) - expected_s).max() < 0.3 * expected_s
    last = messages_of(sent, m.Health)[-1]
    assert (last.faults, last.samples_missed, last.i2c_errors, last.frames_dropped) == (0, 0, 0, 0)
    assert (0x53, 0xE5, 0) in messages_of(sent, m.Hello)[-1].parts


def test_a_chip_that_is_not_there_is_searched_and_one_that_fails_is_read_again():
    sent, _, _ = run(3, motion=MOTION, config={"high_g_rate_hz": 400})
    assert not messages_of(sent, m.HighG)
    assert messages_of(sent, m.Health)[-1].i2c_errors == 0
    faults = (BusNack(2.0, 3, chip="high_g"),)
    sent, _, _ = run(
        4, motion=MOTION, config={"high_g_rate_hz": 400}, sensors=SensorBoard(high_g=True), faults=faults
    )
    t, _ = high_g_samples(sent)
    assert messages_of(sent, m.Health)[-1].i2c_errors == 3
    assert t[-1] > 3.5


def test_a_choice_without_enough_heap_has_no_second_accelerometer():
    config = {"high_g_rate_hz": 400, "bias_kind": int(m.BiasKind.GRAVITY)}
    sent, _, _ = run(2, motion=MOTION, config=config, sensors=SensorBoard(high_g=True))
    assert not messages_of(sent, m.HighG)


def test_a_setting_for_which_the_heap_has_no_room_beside_the_chip_is_refused():
    script = [(1.0, request(9, m.SetConfig(m.ConfigKey.BIAS_KIND, m.BiasKind.GRAVITY)))]
    for high_g_rate_hz, refused in ((400, True), (0, False)):
        config = {"high_g_rate_hz": high_g_rate_hz}
        sent, _, _ = run(2, motion=MOTION, config=config, sensors=SensorBoard(high_g=True), script=script)
        answers = [answer.reason for answer in messages_of(sent, m.Nack)]
        assert answers == ([m.Reason.BAD_VALUE] if refused else [])


def test_the_emulated_chip_is_in_standby_at_reset_and_gives_the_oldest_sample_of_its_fifo_first():
    chip = Adxl375(MOTION)
    chip.set_pointer(0x39)
    assert chip.read(1.0, 1, 1e-5) == b"\0"
    for register, value in ((0x31, 0x0B), (0x2C, 0x0C), (0x38, 0x80), (0x2D, 0x08)):
        chip.write(1.0, bytes([register, value]))
    chip.set_pointer(0x39)
    assert chip.read(1.2, 1, 1e-5) == b"\x20"
    chip.set_pointer(0x32)
    first = np.frombuffer(chip.read(1.2, 6, 1e-5), "<i2")
    # 80 samples so far, of which the last 32 wait.
    expected = [np.interp(1.0 + 49 / 400.0, T, FORCE[:, axis]) / LSB for axis in range(3)]
    assert np.abs(first - expected).max() < 1.0
    assert chip.truth().fifo_dropped == 48
