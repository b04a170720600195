"""Bosch chips give the same bytes to a bus that transfers a burst at once and to one that transfers bytes."""

import numpy as np
import pytest

from hubodo.emulator.chips import bmi088
from hubodo.emulator.chips.bmi088 import Bmi088
from hubodo.emulator.motion import RecordedMotion

T = np.arange(0.0, 2.0, 0.002)
MOTION = RecordedMotion(
    T,
    np.stack([np.sin(7 * T), np.cos(3 * T), np.sin(5 * T)], axis=1),
    np.stack([5 * np.sin(2 * T), 5 * np.cos(4 * T), 9 + np.sin(T)], axis=1),
    temperature_c=25.0,
    start=0.0,
)


def sampling(which):
    """Return the gyro or the accelerometer of a BMI088 that fills its FIFO."""
    chip = Bmi088(MOTION)
    if which == "gyro":
        chip.write(0.0, bytes([bmi088.FIFO_CONFIG_1, 0x80]))
        return chip
    part = chip.accelerometer
    for register, value in (
        (bmi088.ACC_PWR_CONF, 0),
        (bmi088.ACC_PWR_CTRL, 4),
        (bmi088.ACC_FIFO_CONFIG_1, 0x50),
    ):
        part.write(0.0, bytes([register, value]))
    return part


def burst(chip, t, register, n, parts):
    """Return a burst of n bytes, read in `parts` transfers."""
    chip.set_pointer(register)
    edges = np.linspace(0, n, parts + 1).astype(int)
    return b"".join(chip.read(t, int(size), 22e-6) for size in np.diff(edges))


@pytest.mark.parametrize("which", ["gyro", "accelerometer"])
@pytest.mark.parametrize("n_bytes", [70, 32, 1])
def test_a_burst_in_parts_is_that_of_one_transfer(which, n_bytes):
    """32 bytes end within a frame: that of the gyro is then lost, that of the accelerometer stays."""
    is_gyro = which == "gyro"
    fifo = bmi088.FIFO_DATA if is_gyro else bmi088.ACC_FIFO_DATA
    output = bmi088.RATE if is_gyro else bmi088.ACC_OUT
    results = []
    for parts in (1, n_bytes):
        chip, t, data = sampling(which), 0.1, []
        for _ in range(4):
            data.append(burst(chip, t, fifo, n_bytes, parts))
            data.append(burst(chip, t, output, 6, min(parts, 6)))
            t += 0.05
        results.append(data)
    assert results[0] == results[1]
    assert len(set(results[0])) > 4


def test_the_bytes_of_a_sample_belong_together_though_a_new_one_comes_meanwhile():
    chip = sampling("gyro")
    chip.set_pointer(bmi088.RATE)
    first = chip.read(0.1, 3, 22e-6)
    last = chip.read(0.11, 3, 22e-6)
    assert first + last == burst(sampling("gyro"), 0.1, bmi088.RATE, 6, 1)
    assert burst(chip, 0.11, bmi088.RATE, 6, 1) != first + last
