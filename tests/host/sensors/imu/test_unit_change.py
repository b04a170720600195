"""Records that change their unit, and the clock to which the scale of the gyros is relative."""

import numpy as np
import pytest

import hubodo
from generators.odd_records import fast_clock, missing_codes, very_coarse, vibration
from generators.poses import GRAVITY, Errors, carry
from hubodo.errors import HubodoError, InputError
from hubodo.sensors.imu.unit_change import check_one_unit

ACCEL = Errors((0.2, -0.3, 0.1), (0.01, -0.02, 0.005))
GYRO = Errors((0.01, -0.02, 0.015), (0.01, -0.02, 0.005))
SENSORS = {
    "rad/s and deg/s": ("gyro", np.degrees(1.0)),
    "g and m/s²": ("accel", GRAVITY),
    "m/s² and mg": ("accel", 1e3 / GRAVITY),
}


def record(seed, **options):
    """Return a record of 24 poses."""
    return carry(np.random.default_rng(seed), GYRO, ACCEL, dt=0.02, **options)


@pytest.mark.parametrize("units", SENSORS)
@pytest.mark.parametrize("power", [1, -1])
@pytest.mark.parametrize("share", [0.2, 0.5, 0.7])
def test_a_change_of_unit_is_refused_with_its_time(units, power, share):
    sensor, factor = SENSORS[units]
    for seed, noise in ((0, 4e-3), (1, 2e-4)):
        data = record(seed, gyro_noise=noise)
        values = {"gyro": data.gyro.copy(), "accel": data.accel.copy()}
        start = int(share * len(data.t))
        values[sensor][start:] *= factor**power
        with pytest.raises(InputError, match=f"as between {units}: the record is in two units") as refusal:
            check_one_unit(data.t, **values)
        assert float(str(refusal.value).split("about ")[1].split(" s")[0]) == pytest.approx(
            data.t[start], abs=4.0
        )


def test_the_node_and_the_time_are_named_before_the_unit_of_the_whole_record():
    data = record(3)
    accel = data.accel.copy()
    accel[: int(0.6 * len(accel))] /= GRAVITY
    log = hubodo.from_arrays(data.gyro, accel, t=data.t)
    with pytest.raises(HubodoError, match=r"node imu: the accelerometers' gravity changes by a factor of"):
        log.calibrate_imu(gravity=GRAVITY)


def test_rests_vibration_and_coarse_steps_are_no_other_unit():
    for seed in range(3):
        rng = np.random.default_rng(seed)
        data = record(seed, gyro_noise=(1e-6, 2e-4, 4e-3)[seed])
        static = np.repeat(data.gyro[:1], len(data.t), axis=0) + 1e-6 * rng.standard_normal(data.gyro.shape)
        t = np.arange(2 * len(data.t)) * 0.02
        check_one_unit(
            t, np.vstack([static, data.gyro]), np.vstack([data.accel[:1].repeat(len(static), 0), data.accel])
        )
        shaken = data.gyro + np.where(data.t > 100.0, vibration(data.t, rng, 2e-4), 0.0)[:, None]
        for gyro in (
            shaken,
            *(it(data.t, data.gyro, None, rng, 0)[1] for it in (very_coarse, missing_codes)),
        ):
            check_one_unit(data.t, gyro, data.accel)
    check_one_unit(data.t[:900], data.gyro[:900], data.accel[:900])


def test_the_scale_of_the_gyros_is_relative_to_the_clock_as_the_note_says():
    data = record(4)
    true, fast = (
        hubodo.from_arrays(data.gyro, data.accel, t=t).calibrate_imu(gravity=GRAVITY)
        for t in (data.t, fast_clock(data.t, None, None, None, 0)[0])
    )
    assert any("times that run 1 % fast make it 1 %" in note for note in fast.notes)
    ratio = np.diag(fast.gyro.triad.matrix) / np.diag(true.gyro.triad.matrix)
    assert ratio == pytest.approx(np.full(3, 1.01), abs=1e-5)
