"""Calibration of wheels on drives with known positions: what is seen is right, what is not seen is named."""

import argparse
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from generators import wheel_drives
from generators.external_positions import Receiver, positions
from hubodo.calibration.file import Calibration, read_calibration
from hubodo.errors import CalibrationError
from hubodo.fuse.wheel.calibration.aided_filter import run_aided_filter
from hubodo.fuse.wheel.calibration.alignment import align_heading
from hubodo.fuse.wheel.calibration.calibrate import (
    WheelCalibration,
    WheelPriors,
    _CalibrationDrive,
    calibrate_wheels,
)
from hubodo.fuse.wheel.calibration.held_out import ErrorSummary, HeldOutErrors, measure_held_out_errors
from hubodo.fuse.wheel.calibration.positions import Positions, estimate_white_sigma
from hubodo.fuse.wheel.config import wheel_config
from hubodo.fuse.wheel.entries import X, Y
from hubodo.fuse.wheel.track import run_wheel_filter
from hubodo.log.csv_folder import write_folder
from hubodo.recording import Recording, Table
from hubodo.vehicle import NodeMount, Vehicle
from hubodo.verbs import calibrate
from vehicles import vehicle_toml
from wheel_runs import config, tables

ERRORS = replace(wheel_drives.Errors(), radius=0.02, track=0.03)
SLOW, FAST = (0.8, 1.8), (2.0, 4.0)
"""m/s, of the slowest leg and the fastest."""
TRUTH_OF = {
    ("wheel_radius", "error"): "radius",
    ("lever_arm", "x"): "arm_x",
    ("lever_arm", "y"): "arm_y",
    ("node_misalignment", "x"): "tilt_x",
    ("node_misalignment", "y"): "tilt_y",
    ("gyro_scale_factor", "z"): "spin_scale",
    ("gyro_scale_factor", "x"): "yaw_scale",
}


@cache
def _drive(
    seed: int, length: float, speed: tuple[float, float] = SLOW, right: str = "left"
) -> wheel_drives.WheelDrive:
    """right: where the z axis of the right node points."""
    rng = np.random.default_rng(seed)
    return wheel_drives.drive(
        wheel_drives.loop(rng, length, 6.0, speed), rng, ERRORS, facing={"right": right}
    )


def _leave_nothing_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """No stretches are left out from here on, which takes most of the time: for what they do not touch."""
    nothing = ErrorSummary(0.0, 0.0)
    module = "hubodo.fuse.wheel.calibration.calibrate.measure_held_out_errors"
    monkeypatch.setattr(module, lambda *_: HeldOutErrors(nothing, nothing, 0))


def _told(drive: wheel_drives.WheelDrive, seed: int, receiver: Receiver, declared: float = 0.1) -> Positions:
    """As a receiver tells them."""
    t, x, y = positions(drive, receiver, seed)
    return Positions(t, x, y, np.full(len(t), declared))


def _exact(drive: wheel_drives.WheelDrive, seed: int) -> Positions:
    return _told(drive, seed, Receiver(rate_hz=5.0, slow=0.0, antenna=(0.0, 0.0), delay=0.0))


def _off(drive: wheel_drives.WheelDrive, found: WheelCalibration) -> dict[str, list[float]]:
    """Errors of all that was seen, in sigmas, by parameter."""
    made: dict[str, list[float]] = {}
    for name, effects in found.nodes.items():
        for (effect, parameter), truth in TRUTH_OF.items():
            if parameter in effects.get(effect, {}):
                q = effects[effect][parameter]
                made.setdefault(f"{effect}.{parameter}", []).append(
                    (q.value - drive.nodes[name].truth[truth]) / q.sigma
                )
    return made


RECEIVERS = {
    "rtk": Receiver(),
    "that jumps": Receiver(jumps=2),
    "that is worse than anybody says": Receiver(slow=0.2, white=0.03, delay=-0.02),
}


@pytest.mark.parametrize("kind", RECEIVERS)
def test_what_is_seen_is_as_far_from_the_truth_as_it_says(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """An antenna half a metre ahead, stamps that are late, errors that last: none of them is a wheel's.

    With the worse ones, on the first drive, stretches that were left out must be better for it.
    """
    if kind == "rtk":
        _leave_nothing_out(monkeypatch)
    errors: dict[str, list[float]] = {}
    antennas = []
    for seed in (70, 71):
        right = "right" if seed == 71 else "left"
        drive = _drive(seed, 100.0, SLOW, right)
        receiver = RECEIVERS[kind]
        settings = config(drive, facing={"right": right})
        found = calibrate_wheels(settings, tables(drive), _told(drive, seed, receiver))
        assert found.held_out.stretches == (4 if seed == 70 and kind != "rtk" else 0)
        _leave_nothing_out(monkeypatch)
        for name, values in _off(drive, found).items():
            errors.setdefault(name, []).extend(values)
        antennas += [(q.value - a) / q.sigma for q, a in zip(found.antenna, receiver.antenna, strict=True)]
    print("seeds 70, 71", {name: np.round(values, 1).tolist() for name, values in errors.items()}, antennas)
    assert {"wheel_radius.error", "lever_arm.x", "node_misalignment.y"} <= set(errors)
    # Chi-square of so many numbers, at most four: 1 in 10,000 sets lies above. Of all, twice their mean.
    for values in (*errors.values(), antennas):
        assert np.sum(np.square(values)) < chi2.isf(1e-4, len(values)), values
    assert np.mean(np.square(np.concatenate([*errors.values(), antennas]))) < 2.0


def test_a_receiver_on_a_long_drive_finds_the_radius(monkeypatch: pytest.MonkeyPatch) -> None:
    """Metres of error that last two minutes are nothing beside half a kilometre."""
    _leave_nothing_out(monkeypatch)
    seed = 74
    drive = _drive(seed, 500.0, FAST)
    receiver = Receiver(rate_hz=1.0, white=0.7, slow=1.0, memory=120.0)
    found = calibrate_wheels(config(drive), tables(drive), _told(drive, seed, receiver, 1.5))
    for name, node in drive.nodes.items():
        quantity = found.nodes[name]["wheel_radius"]["error"]
        assert abs(quantity.value - node.truth["radius"]) < 4.0 * quantity.sigma < 0.025, (seed, name)


@pytest.mark.parametrize(
    "spoil, text",
    [
        (lambda told: replace(told, y=-told.y), "mirrored axes"),
        (lambda told: replace(told, x=1.2 * told.x, y=1.2 * told.y), "another wheel_radius"),
    ],
)
def test_what_cannot_be_is_refused_with_the_likely_reason(
    spoil: Callable[[Positions], Positions], text: str
) -> None:
    drive = _drive(76, 60.0)
    with pytest.raises(CalibrationError, match=text):
        calibrate_wheels(config(drive), tables(drive), spoil(_exact(drive, 76)))


def test_priors_can_be_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """A track that is known to a millimetre stays; one that is not is found."""
    _leave_nothing_out(monkeypatch)
    drive = _drive(77, 60.0)
    free = calibrate_wheels(config(drive), tables(drive), _exact(drive, 77))
    held = calibrate_wheels(config(drive), tables(drive), _exact(drive, 77), WheelPriors(track=0.001))
    assert "track_width" in free.vehicle and "track_width" not in held.vehicle


def test_stretches_that_were_left_out_say_whether_it_helps() -> None:
    """Beside a calibration that helps, one that was made on another vehicle's positions."""
    drive = _drive(78, 120.0, FAST)
    told = _exact(drive, 78)
    found = calibrate_wheels(config(drive), tables(drive), told)
    assert found.held_out.stretches == 4 and found.held_out.after.rms < 0.5 * found.held_out.before.rms
    plain = run_wheel_filter(config(drive), tables(drive)).track
    stretched = replace(plain, x=1.01 * plain.x, y=1.01 * plain.y)
    good = measure_held_out_errors(told, stretched, lambda *_: (plain, (0.0, 0.0)), (0.0, 0.0))
    bad = measure_held_out_errors(
        told, plain, lambda *_: (replace(plain, x=1.1 * plain.x, y=1.1 * plain.y), (0.0, 0.0)), (0.0, 0.0)
    )
    assert good.is_improved and not bad.is_improved
    first = told.select(np.arange(len(told)) < 30)
    assert (
        measure_held_out_errors(first, plain, lambda *_: (stretched, (0.0, 0.0)), (0.0, 0.0)).stretches == 0
    )


def test_a_calibration_that_does_not_help_is_not_made(monkeypatch: pytest.MonkeyPatch) -> None:
    drive = _drive(79, 60.0)
    module = "hubodo.fuse.wheel.calibration.calibrate.measure_held_out_errors"
    monkeypatch.setattr(module, lambda *_: HeldOutErrors(ErrorSummary(0.1, 0.2), ErrorSummary(0.15, 0.25), 4))
    with pytest.raises(
        CalibrationError,
        match=r"held-out segments \(0.100 m .* 0.150 m after; rms 0.200 m, 0.250 m\).*nothing is written",
    ):
        calibrate_wheels(config(drive), tables(drive), _exact(drive, 79))


def test_the_first_half_of_a_drive_makes_the_distance_of_all_of_it_better() -> None:
    """Rms over four drives: radii that are off by as much to either side leave one right by chance."""
    off: dict[str, list[float]] = {"nominal": [], "calibrated": []}
    for seed in range(70, 74):
        drive = _drive(seed, 120.0, FAST)
        told = _exact(drive, seed)
        found = calibrate_wheels(config(drive), tables(drive), told.select(told.t < 0.5 * told.t[-1]))
        calibration = Calibration()
        for name in drive.nodes:
            calibration = calibration.with_node(name, found.effects(name))
        calibration = calibration.with_vehicle(found.vehicle_effects())
        mounts = {name: NodeMount(name, "left") for name in drive.nodes}
        for label, known in (("nominal", None), ("calibrated", calibration)):
            settings = wheel_config(Vehicle(drive.radius, drive.track, mounts), list(mounts), known)
            track = run_wheel_filter(settings, tables(drive)).track
            way = float(np.sum(np.hypot(np.diff(track.x), np.diff(track.y))))
            off[label].append(way - drive.length)
    print(off)
    assert np.linalg.norm(off["calibrated"]) < 0.3 * np.linalg.norm(off["nominal"])


def test_a_straight_drive_names_track_and_scale_as_unseen() -> None:
    rng = np.random.default_rng(73)
    drive = wheel_drives.drive(wheel_drives.legs([(6.0, 0.0, 0.0), (30.0, 1.2, 0.0)]), rng, ERRORS)
    found = calibrate_wheels(config(drive), tables(drive), _exact(drive, 73))
    named = " ".join(found.not_observable)
    assert "left.gyro_scale_factor.x" in named
    assert "vehicle.track_width.error" in named
    assert "track_width" not in found.vehicle
    assert re.search(r"track_width.error: only [0-9]° of turning, 3[0-9] m", named)


def test_one_node_has_no_track_width() -> None:
    drive = _drive(74, 60.0)
    found = calibrate_wheels(config(drive, ("left",)), tables(drive), _exact(drive, 74))
    assert found.vehicle == {}
    assert any("one node does not show it" in line for line in found.not_observable)


def test_too_few_positions_and_too_short_a_drive_are_refused() -> None:
    drive = _drive(75, 20.0)
    told = _exact(drive, 75)
    with pytest.raises(CalibrationError, match="at least ten"):
        calibrate_wheels(config(drive), tables(drive), told.select(np.arange(len(told)) < 5))
    with pytest.raises(CalibrationError, match="m from the start"):
        calibrate_wheels(config(drive), tables(drive), replace(told, x=0.01 * told.x, y=0.01 * told.y))


@pytest.mark.parametrize(("sigma", "least"), [(0.01, 10.0), (2.0, 20.0)])
def test_a_heading_wants_ten_metres_and_ten_sigma_of_positions(sigma: float, least: float) -> None:
    """The farthest position lies 5 % nearer than that, or 5 % farther."""
    drive = _drive(75, 20.0)
    told = _exact(drive, 75)
    track = run_wheel_filter(config(drive), tables(drive)).track
    reach = np.hypot(told.x - told.x[0], told.y - told.y[0]).max()
    near, far = (
        replace(told, x=share * told.x, y=share * told.y, sigma=np.full(len(told), sigma))
        for share in (0.95 * least / reach, 1.05 * least / reach)
    )
    with pytest.raises(CalibrationError, match=f"drive {least:.0f} m away"):
        align_heading(track, near)
    align_heading(track, far)


def test_the_verb_writes_a_calibration_file_that_reads_back(tmp_path: Path) -> None:
    drive = _drive(76, 60.0)
    told = _exact(drive, 76)
    truth = Table({"t": told.t, "x": told.x, "y": told.y})
    write_folder(Recording(tables(drive), truth=truth), tmp_path / "log")
    vehicle = tmp_path / "v.toml"
    vehicle.write_text(vehicle_toml(drive.radius, drive.track))
    output = tmp_path / "c.toml"
    parser = argparse.ArgumentParser()
    calibrate.add_arguments(parser)
    words = ["wheels", str(tmp_path / "log"), "--vehicle", str(vehicle), "-o", str(output)]
    printed = calibrate.run(parser.parse_args(words)).as_json()
    written = read_calibration(output)
    assert printed["positions"] == "truth"
    found = written.nodes["left"].effects["wheel_radius"]
    assert found.parameters["error"].value == printed["nodes"]["left"]["wheel_radius"]["error"]["value"]
    assert found.parameters["error"].value == pytest.approx(drive.nodes["left"].truth["radius"], abs=0.002)
    assert len(found.source_sha256) == 64
    assert "track_width" in written.vehicle


def test_a_drive_begins_at_the_origin_as_far_off_as_antenna_and_first_position_may_be() -> None:
    """Independent errors add in squares; at most one by one."""
    drive = _drive(75, 20.0)
    at = Positions(np.array([0.0]), np.array([3.0]), np.array([4.0]), np.array([0.2]))
    for random, slow in ((3.0, 5.0), (1.5, 1.5), (0.2, 0.7)):
        told = run_aided_filter(config(drive), (), at, np.array([random]), slow, 3.0 + 4.0j, {})
        assert (told.n_used, told.n_jumps, told.cost) == (0, 0, 0.0)
        # 1.5 m is what is believed of an antenna that nobody measured.
        for entry, value in ((X, 3.0), (Y, 4.0)):
            place = told.core.columns.vehicle[entry]
            sigma = np.sqrt(told.core.p[place, place])
            assert told.core.x[place] == value
            assert np.linalg.norm([random, slow, 1.5]) < sigma < 1.01 * (random + slow + 1.5)


@pytest.mark.parametrize(("likeliest", "steep"), [(3.0, 1.0), (5.2, 1.0), (1.7, 3.0), (7.0, 0.4)])
def test_the_size_of_what_changes_slowly_is_the_largest_that_is_not_unlikely(
    likeliest: float, steep: float
) -> None:
    """3 cm, and doubled ten times; minus twice the logarithm of a likelihood six above its best."""
    sizes: list[float] = []

    def told(_: object, slow: float) -> SimpleNamespace:
        sizes.append(slow)
        return SimpleNamespace(cost=80.0 + steep * (np.log2(slow / 0.03) - likeliest) ** 2)

    drive = object.__new__(_CalibrationDrive)
    drive.positions, drive.run_aided = Positions(*np.zeros((4, 1))), told  # type: ignore[method-assign, assignment]
    found = drive.largest_slow_error()
    assert found == pytest.approx(0.03 * 2.0 ** (likeliest + np.sqrt(6.0 / steep)), rel=1e-6)
    assert len(set(sizes)) == len(sizes)


@pytest.mark.parametrize(("slope", "size"), [(1.0, 0.03), (-1.0, 0.03 * 2.0**10)])
def test_where_no_size_is_likeliest_it_is_the_last_one_that_is_looked_at(slope: float, size: float) -> None:
    drive = object.__new__(_CalibrationDrive)
    drive.positions = Positions(*np.zeros((4, 1)))
    drive.run_aided = lambda _, slow: SimpleNamespace(cost=slope * np.log(slow))  # type: ignore[method-assign, assignment, return-value]
    assert drive.largest_slow_error() == pytest.approx(size)


@pytest.mark.parametrize("seed", range(3))
def test_what_is_random_in_positions_shows_beside_what_changes_slowly_and_beside_wild_ones(seed):
    """One in a hundred wild: the median of differences is 4 % larger, and known to 3 %."""
    rng = np.random.default_rng(seed)
    t = np.arange(2000.0)
    x, y = 20.0 * np.sin(t / 200.0), 15.0 * np.cos(t / 300.0)
    wild = np.where(rng.random((2, len(t))) < 0.01, 30.0, 0.0)
    noise = rng.normal(0.0, 0.3, (2, len(t))) + wild * rng.normal(size=(2, len(t)))
    told = Positions(t, x + noise[0] + 0.01 * t, y + noise[1], np.full(len(t), 5.0))
    np.testing.assert_allclose(estimate_white_sigma(told, x, y), 0.31, rtol=0.09)
    declared = Positions(t, told.x, told.y, np.full(len(t), 0.1))
    np.testing.assert_array_equal(estimate_white_sigma(declared, x, y), 0.1)
    exact = Positions(t, x, y, np.full(len(t), 5.0))
    np.testing.assert_array_equal(estimate_white_sigma(exact, x, y), 0.01)


def test_of_few_positions_what_is_declared_counts():
    few = Positions(*np.zeros((3, 9)), np.array([0.001, *np.full(8, 2.0)]))
    np.testing.assert_array_equal(estimate_white_sigma(few, few.x, few.y), [0.01, *np.full(8, 2.0)])
