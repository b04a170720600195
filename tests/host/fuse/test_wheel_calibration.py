"""Wheel calibration on drives with known positions: observable parameters within sigma, others named."""

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
    WheelPriors,
    _CalibrationDrive,
    calibrate_wheels,
)
from hubodo.fuse.wheel.calibration.held_out import ErrorSummary, HeldOutErrors, measure_held_out_errors
from hubodo.fuse.wheel.calibration.positions import Positions, estimate_white_sigma
from hubodo.fuse.wheel.calibration.result import WheelCalibration
from hubodo.fuse.wheel.config import wheel_config
from hubodo.fuse.wheel.entries import X, Y
from hubodo.fuse.wheel.track import run_wheel_filter
from hubodo.log.csv_folder import write_folder
from hubodo.recording import Recording, Table
from hubodo.vehicle import NodeMount, Vehicle
from hubodo.verbs import calibrate
from in_process import hubodo
from repetitions import first_and_more
from vehicles import vehicle_toml
from wheel_runs import config, skip_held_out_segments, tables

ERRORS = replace(wheel_drives.Errors(), radius=0.02, track=0.03)
SLOW, FAST = (0.8, 1.8), (2.0, 4.0)
"""Speed of the slowest and of the fastest leg, m/s."""
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
def _loop_drive(
    seed: int, length: float, speed: tuple[float, float] = SLOW, right_facing: str = "left"
) -> wheel_drives.WheelDrive:
    """Return a loop; `right_facing` is the side that the z axis of the right node points to."""
    rng = np.random.default_rng(seed)
    return wheel_drives.drive(
        wheel_drives.loop(rng, length, 6.0, speed), rng, ERRORS, facing={"right": right_facing}
    )


def _receiver_positions(
    drive: wheel_drives.WheelDrive, seed: int, receiver: Receiver, declared: float = 0.1
) -> Positions:
    """Return the positions of a simulated receiver with the declared sigma, m."""
    t, x, y = positions(drive, receiver, seed)
    return Positions(t, x, y, np.full(len(t), declared))


def _exact_positions(drive: wheel_drives.WheelDrive, seed: int) -> Positions:
    """Return positions without slow error, antenna offset or delay."""
    return _receiver_positions(drive, seed, Receiver(rate_hz=5.0, slow=0.0, antenna=(0.0, 0.0), delay=0.0))


def _normalised_errors(
    drive: wheel_drives.WheelDrive, calibration: WheelCalibration
) -> dict[str, list[float]]:
    """Return (estimate - truth) / sigma of every observable parameter, by parameter name."""
    errors: dict[str, list[float]] = {}
    for name, effects in calibration.nodes.items():
        for (effect, parameter), truth in TRUTH_OF.items():
            if parameter in effects.get(effect, {}):
                estimate = effects[effect][parameter]
                errors.setdefault(f"{effect}.{parameter}", []).append(
                    (estimate.value - drive.nodes[name].truth[truth]) / estimate.sigma
                )
    return errors


RECEIVERS = {
    "rtk": Receiver(),
    "jumps": Receiver(jumps=2),
    "worse than declared": Receiver(slow=0.2, white=0.03, delay=-0.02),
}


@pytest.mark.parametrize("kind", first_and_more("worse than declared", "jumps", "rtk"))
def test_estimates_are_within_their_sigmas_for_each_kind_of_receiver(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Antenna offset, clock delay and correlated position errors are not attributed to a wheel."""
    skip_held_out_segments(monkeypatch)
    errors: dict[str, list[float]] = {}
    antennas = []
    for seed in (70, 71):
        right_facing = "right" if seed == 71 else "left"
        drive = _loop_drive(seed, 100.0, SLOW, right_facing)
        receiver = RECEIVERS[kind]
        settings = config(drive, facing={"right": right_facing})
        calibration = calibrate_wheels(settings, tables(drive), _receiver_positions(drive, seed, receiver))
        assert calibration.held_out.n_segments == 0
        for name, values in _normalised_errors(drive, calibration).items():
            errors.setdefault(name, []).extend(values)
        antennas += [
            (estimate.value - offset) / estimate.sigma
            for estimate, offset in zip(calibration.antenna, receiver.antenna, strict=True)
        ]
    print("seeds 70, 71", {name: np.round(values, 1).tolist() for name, values in errors.items()}, antennas)
    assert {"wheel_radius.error", "lever_arm.x", "node_misalignment.y"} <= set(errors)
    # Chi-square of at most four numbers: 1 in 10,000 sets lies above. Their overall mean stays below 2.
    for values in (*errors.values(), antennas):
        assert np.sum(np.square(values)) < chi2.isf(1e-4, len(values)), values
    assert np.mean(np.square(np.concatenate([*errors.values(), antennas]))) < 2.0


@pytest.mark.repeat  # beside the held-out segments of exact positions
def test_held_out_segments_improve_with_the_worst_receiver() -> None:
    seed = 70
    drive = _loop_drive(seed, 100.0)
    measured = _receiver_positions(drive, seed, RECEIVERS["worse than declared"])
    assert calibrate_wheels(config(drive), tables(drive), measured).held_out.n_segments == 4


@pytest.mark.repeat
def test_a_long_drive_with_a_metre_level_receiver_determines_the_radius(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Errors of 1 m with a correlation time of two minutes are small beside a drive of 500 m."""
    skip_held_out_segments(monkeypatch)
    seed = 74
    drive = _loop_drive(seed, 500.0, FAST)
    receiver = Receiver(rate_hz=1.0, white=0.7, slow=1.0, memory=120.0)
    calibration = calibrate_wheels(
        config(drive), tables(drive), _receiver_positions(drive, seed, receiver, 1.5)
    )
    for name, node in drive.nodes.items():
        quantity = calibration.nodes[name]["wheel_radius"]["error"]
        assert abs(quantity.value - node.truth["radius"]) < 4.0 * quantity.sigma < 0.025, (seed, name)


@pytest.mark.parametrize(
    "corrupt, text",
    [
        (lambda measured: replace(measured, y=-measured.y), "mirrored axes"),
        (lambda measured: replace(measured, x=1.2 * measured.x, y=1.2 * measured.y), "another wheel_radius"),
        (
            lambda measured: replace(measured, x=0.5 * measured.x, y=0.5 * measured.y),
            "the wheels rolled (1.9|2.0). times .*diameter",
        ),
    ],
)
def test_impossible_positions_are_refused_with_the_likely_reason(
    corrupt: Callable[[Positions], Positions], text: str
) -> None:
    drive = _loop_drive(76, 60.0)
    with pytest.raises(CalibrationError, match=text):
        calibrate_wheels(config(drive), tables(drive), corrupt(_exact_positions(drive, 76)))


def _jumping_positions(exact: Positions, seed: int) -> Positions:
    """Return positions that jump by some 2 m at every twentieth."""
    jump = np.cumsum(2.0 * np.random.default_rng(seed).standard_normal((2, len(exact) // 20 + 1)), axis=1)
    error = np.repeat(jump, 20, axis=1)[:, : len(exact)]
    return replace(exact, x=exact.x + error[0], y=exact.y + error[1])


def test_a_truth_that_jumps_ends_with_exit_code_2_in_one_line_and_writes_nothing(tmp_path: Path) -> None:
    drive = _loop_drive(77, 60.0)
    jumping = _jumping_positions(_exact_positions(drive, 77), 77)
    truth = Table({"t": jumping.t, "x": jumping.x, "y": jumping.y})
    write_folder(Recording(tables(drive), truth=truth), tmp_path / "log")
    (tmp_path / "v.toml").write_text(vehicle_toml(drive.radius, drive.track))
    output = tmp_path / "c.toml"
    done = hubodo("calibrate", "wheels", tmp_path / "log", "--vehicle", tmp_path / "v.toml", "-o", output)
    assert done.code == 2 and not output.exists()
    assert re.search(
        r"the positions jumped [0-9]+ times among .*nothing is written", done.err.strip().splitlines()[-1]
    )
    assert len(done.err.strip().splitlines()) == 1


def test_a_tight_prior_keeps_the_track_width_fixed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A track width known to 1 mm is not estimated; the calibration by the verb estimates it."""
    skip_held_out_segments(monkeypatch)
    drive = _loop_drive(77, 60.0, FAST)
    fixed = calibrate_wheels(
        config(drive), tables(drive), _exact_positions(drive, 77), WheelPriors(track=0.001)
    )
    assert "track_width" not in fixed.vehicle


def test_held_out_segments_show_whether_a_calibration_improves() -> None:
    """Compare a calibration that helps with one made from positions of another vehicle."""
    drive = _loop_drive(78, 120.0, FAST)
    measured = _exact_positions(drive, 78)
    calibration = calibrate_wheels(config(drive), tables(drive), measured)
    assert (
        calibration.held_out.n_segments == 4
        and calibration.held_out.after.rms < 0.5 * calibration.held_out.before.rms
    )
    track = run_wheel_filter(config(drive), tables(drive)).track
    scaled_track = replace(track, x=1.01 * track.x, y=1.01 * track.y)
    improving = measure_held_out_errors(measured, scaled_track, lambda *_: (track, (0.0, 0.0)), (0.0, 0.0))
    worsening = measure_held_out_errors(
        measured, track, lambda *_: (replace(track, x=1.1 * track.x, y=1.1 * track.y), (0.0, 0.0)), (0.0, 0.0)
    )
    assert improving.is_improved and not worsening.is_improved
    first_positions = measured.select(np.arange(len(measured)) < 30)
    assert (
        measure_held_out_errors(
            first_positions, track, lambda *_: (scaled_track, (0.0, 0.0)), (0.0, 0.0)
        ).n_segments
        == 0
    )


def test_a_calibration_that_worsens_held_out_segments_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    drive = _loop_drive(79, 60.0, FAST)
    module = "hubodo.fuse.wheel.calibration.calibrate.measure_held_out_errors"
    monkeypatch.setattr(module, lambda *_: HeldOutErrors(ErrorSummary(0.1, 0.2), ErrorSummary(0.15, 0.25), 4))
    with pytest.raises(
        CalibrationError,
        match=r"held-out segments \(0.100 m .* 0.150 m after; rms 0.200 m, 0.250 m\).*nothing is written",
    ):
        calibrate_wheels(config(drive), tables(drive), _exact_positions(drive, 79))


@pytest.mark.parametrize("seeds", first_and_more(range(70, 72), range(70, 74)), ids=str)
def test_calibration_on_the_first_half_improves_the_total_distance(
    seeds: range, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Use the rms over several drives: on a single one the radius errors of both wheels may cancel."""
    skip_held_out_segments(monkeypatch)
    distance_errors: dict[str, list[float]] = {"nominal": [], "calibrated": []}
    for seed in seeds:
        drive = _loop_drive(seed, 90.0, FAST)
        measured = _exact_positions(drive, seed)
        result = calibrate_wheels(
            config(drive), tables(drive), measured.select(measured.t < 0.5 * measured.t[-1])
        )
        calibration = Calibration()
        for name in drive.nodes:
            calibration = calibration.with_node(name, result.effects(name))
        calibration = calibration.with_vehicle(result.vehicle_effects())
        mounts = {name: NodeMount(name, "left") for name in drive.nodes}
        for label, known_calibration in (("nominal", None), ("calibrated", calibration)):
            settings = wheel_config(
                Vehicle(drive.radius, drive.track, mounts), list(mounts), known_calibration
            )
            track = run_wheel_filter(settings, tables(drive)).track
            distance = float(np.sum(np.hypot(np.diff(track.x), np.diff(track.y))))
            distance_errors[label].append(distance - drive.length)
    print(distance_errors)
    assert np.linalg.norm(distance_errors["calibrated"]) < 0.3 * np.linalg.norm(distance_errors["nominal"])


def test_on_a_straight_drive_track_width_and_yaw_scale_are_not_observable(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    skip_held_out_segments(monkeypatch)
    rng = np.random.default_rng(73)
    drive = wheel_drives.drive(wheel_drives.legs([(6.0, 0.0, 0.0), (30.0, 1.2, 0.0)]), rng, ERRORS)
    calibration = calibrate_wheels(config(drive), tables(drive), _exact_positions(drive, 73))
    reasons = " ".join(calibration.not_observable)
    assert "left.gyro_scale_factor.x" in reasons
    assert "vehicle.track_width.error" in reasons
    assert "track_width" not in calibration.vehicle
    assert re.search(r"track_width.error: only [0-9]° of turning, 3[0-9] m", reasons)


def test_one_node_does_not_observe_the_track_width(monkeypatch: pytest.MonkeyPatch) -> None:
    skip_held_out_segments(monkeypatch)
    drive = _loop_drive(74, 60.0, FAST)
    calibration = calibrate_wheels(config(drive, ("left",)), tables(drive), _exact_positions(drive, 74))
    assert calibration.vehicle == {}
    assert any("one node does not show it" in line for line in calibration.not_observable)


def test_too_few_positions_and_too_short_a_drive_are_refused() -> None:
    drive = _loop_drive(75, 20.0)
    measured = _exact_positions(drive, 75)
    with pytest.raises(CalibrationError, match="at least ten"):
        calibrate_wheels(config(drive), tables(drive), measured.select(np.arange(len(measured)) < 5))
    with pytest.raises(CalibrationError, match="m from the start"):
        calibrate_wheels(
            config(drive), tables(drive), replace(measured, x=0.01 * measured.x, y=0.01 * measured.y)
        )


@pytest.mark.parametrize(("sigma", "min_distance"), [(0.01, 10.0), (2.0, 20.0)])
def test_heading_alignment_needs_ten_metres_and_ten_position_sigma(sigma: float, min_distance: float) -> None:
    """The farthest position is 5 % nearer or 5 % farther than the required distance."""
    drive = _loop_drive(75, 20.0)
    measured = _exact_positions(drive, 75)
    track = run_wheel_filter(config(drive), tables(drive)).track
    max_distance = np.hypot(measured.x - measured.x[0], measured.y - measured.y[0]).max()
    near, far = (
        replace(measured, x=share * measured.x, y=share * measured.y, sigma=np.full(len(measured), sigma))
        for share in (0.95 * min_distance / max_distance, 1.05 * min_distance / max_distance)
    )
    with pytest.raises(CalibrationError, match=f"drive {min_distance:.0f} m away"):
        align_heading(track, near)
    align_heading(track, far)


def test_the_verb_writes_a_calibration_file_that_reads_back(tmp_path: Path) -> None:
    drive = _loop_drive(76, 60.0)
    measured = _exact_positions(drive, 76)
    truth = Table({"t": measured.t, "x": measured.x, "y": measured.y})
    write_folder(Recording(tables(drive), truth=truth), tmp_path / "log")
    vehicle = tmp_path / "v.toml"
    vehicle.write_text(vehicle_toml(drive.radius, drive.track))
    output = tmp_path / "c.toml"
    parser = argparse.ArgumentParser()
    calibrate.add_arguments(parser)
    options = ["wheels", str(tmp_path / "log"), "--vehicle", str(vehicle), "-o", str(output)]
    printed = calibrate.run(parser.parse_args(options)).as_json()
    written = read_calibration(output)
    assert printed["positions"] == "truth"
    wheel_radius = written.nodes["left"].effects["wheel_radius"]
    assert (
        wheel_radius.parameters["error"].value == printed["nodes"]["left"]["wheel_radius"]["error"]["value"]
    )
    assert wheel_radius.parameters["error"].value == pytest.approx(
        drive.nodes["left"].truth["radius"], abs=0.002
    )
    assert len(wheel_radius.source_sha256) == 64
    assert "track_width" in written.vehicle


def test_the_initial_position_sigma_covers_antenna_random_and_slow_errors() -> None:
    """The initial sigma lies between the root sum of squares and the sum of the three errors."""
    drive = _loop_drive(75, 20.0)
    first_position = Positions(np.array([0.0]), np.array([3.0]), np.array([4.0]), np.array([0.2]))
    for random, slow in ((3.0, 5.0), (1.5, 1.5), (0.2, 0.7)):
        aided = run_aided_filter(config(drive), (), first_position, np.array([random]), slow, 3.0 + 4.0j, {})
        assert (aided.n_used, len(aided.jumps), aided.cost) == (0, 0, 0.0)
        # 1.5 m is the prior sigma of an antenna offset that nobody measured.
        for entry, value in ((X, 3.0), (Y, 4.0)):
            column = aided.core.columns.vehicle[entry]
            sigma = np.sqrt(aided.core.p[column, column])
            assert aided.core.x[column] == value
            assert np.linalg.norm([random, slow, 1.5]) < sigma < 1.01 * (random + slow + 1.5)


@pytest.mark.parametrize(("best_doublings", "curvature"), [(3.0, 1.0), (5.2, 1.0), (1.7, 3.0), (7.0, 0.4)])
def test_the_slow_error_is_the_largest_within_six_of_the_best_cost(
    best_doublings: float, curvature: float
) -> None:
    """The search doubles 3 cm ten times; a cost of six above the minimum is the limit of the likely sizes."""
    sizes: list[float] = []

    def run_aided(_: object, slow: float) -> SimpleNamespace:
        sizes.append(slow)
        return SimpleNamespace(cost=80.0 + curvature * (np.log2(slow / 0.03) - best_doublings) ** 2)

    drive = object.__new__(_CalibrationDrive)
    drive.positions, drive.run_aided = Positions(*np.zeros((4, 1))), run_aided  # type: ignore[method-assign, assignment]
    slow_error = drive.largest_slow_error()
    assert slow_error == pytest.approx(0.03 * 2.0 ** (best_doublings + np.sqrt(6.0 / curvature)), rel=1e-6)
    assert len(set(sizes)) == len(sizes)


@pytest.mark.parametrize(("slope", "size"), [(1.0, 0.03), (-1.0, 0.03 * 2.0**10)])
def test_a_monotonic_cost_selects_the_end_of_the_searched_sizes(slope: float, size: float) -> None:
    drive = object.__new__(_CalibrationDrive)
    drive.positions = Positions(*np.zeros((4, 1)))
    drive.run_aided = lambda _, slow: SimpleNamespace(cost=slope * np.log(slow))  # type: ignore[method-assign, assignment, return-value]
    assert drive.largest_slow_error() == pytest.approx(size)


@pytest.mark.parametrize("seed", range(3))
def test_white_position_sigma_is_robust_to_drift_and_outliers(seed):
    """One percent of outliers inflates the median of differences by 4 %; it is known to 3 %."""
    rng = np.random.default_rng(seed)
    t = np.arange(2000.0)
    x, y = 20.0 * np.sin(t / 200.0), 15.0 * np.cos(t / 300.0)
    outliers = np.where(rng.random((2, len(t))) < 0.01, 30.0, 0.0)
    noise = rng.normal(0.0, 0.3, (2, len(t))) + outliers * rng.normal(size=(2, len(t)))
    measured = Positions(t, x + noise[0] + 0.01 * t, y + noise[1], np.full(len(t), 5.0))
    np.testing.assert_allclose(estimate_white_sigma(measured, x, y), 0.31, rtol=0.09)
    declared = Positions(t, measured.x, measured.y, np.full(len(t), 0.1))
    np.testing.assert_array_equal(estimate_white_sigma(declared, x, y), 0.1)
    exact = Positions(t, x, y, np.full(len(t), 5.0))
    np.testing.assert_array_equal(estimate_white_sigma(exact, x, y), 0.01)


def test_fewer_than_ten_positions_keep_their_declared_sigma():
    few = Positions(*np.zeros((3, 9)), np.array([0.001, *np.full(8, 2.0)]))
    np.testing.assert_array_equal(estimate_white_sigma(few, few.x, few.y), [0.01, *np.full(8, 2.0)])
