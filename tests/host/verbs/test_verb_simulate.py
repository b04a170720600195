"""`hubodo simulate`: the drawn values are those of the model, and other verbs identify the hidden effects."""

import json
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from generators.gnss_drives import drive as gnss_drive
from generators.gnss_drives import loop as gnss_loop
from hubodo.cli import main
from hubodo.earth import EARTH_RATE
from hubodo.log.csv_folder import read_folder
from hubodo.log.recording_reader import read_recording
from hubodo.log.recording_writer import write_recording
from hubodo.model.bench import PoseSequence, TurntableProgramme
from hubodo.model.inputs import EarthRotation
from hubodo.recording import Recording, Table
from vehicles import model_toml

G = 9.80665
_VEHICLE = model_toml(
    facing={"left": "left", "right": "right"},
    frame=True,
    inputs="speed_noise = 0.003\nyaw_rate_noise = 0.002\n",
)
MODEL = f"""{_VEHICLE}[effects.gyro_bias]
z = 0.02
[nodes.left.effects.wheel_camber]
angle = 0.1
"""


def write_model(folder, text=MODEL, name="model.toml"):
    path = folder / name
    path.write_text(text, "utf-8")
    return path


def simulate(folder, *arguments, model=MODEL, out="log.mcap"):
    """Run `hubodo simulate`; return its exit code and the recording."""
    path = folder / out
    code = main(["simulate", str(write_model(folder, model)), "-o", str(path), *map(str, arguments)])
    return code, read_recording(path) if path.suffix == ".mcap" else read_folder(path)


def test_a_random_drive_has_nodes_a_noisy_reference_and_the_truth(tmp_path, capsys):
    code, log = simulate(tmp_path, "--duration", 40, "--seed", 3, "--json")
    result = json.loads(capsys.readouterr().out)
    assert (code, result["seed"], result["samples"]) == (0, 3, {"left": 8000, "right": 8000, "frame": 8000})
    assert result["effects"]["left"] == ["wheel_camber", "gyro_bias"]
    assert log.metadata["simulated.seed"] == "3"
    # Derived from the truth: the reference differs from its speed only by the noise.
    truth, reference = log.truth, log.reference
    speed = np.hypot(np.gradient(truth["x"], truth.t), np.gradient(truth["y"], truth.t))
    speed_error = reference["speed"] - np.interp(reference.t, truth.t, speed)
    assert np.std(speed_error) == pytest.approx(0.003, rel=0.2), "seed 3"
    yaw_rate = np.gradient(truth["heading"], truth.t)
    assert np.std(reference["yaw_rate"] - np.interp(reference.t, truth.t, yaw_rate)) == pytest.approx(
        0.002, rel=0.2
    )
    # The right node faces right: it measures the negative spin rate plus bias; the left wheel is cambered.
    right, left = log.nodes["right"], log.nodes["left"]
    v = np.interp(right.t, truth.t, speed) + np.interp(right.t, truth.t, yaw_rate) * 0.46
    assert np.mean(right["gz"] + v / 0.31) == pytest.approx(0.02, abs=1e-3)
    # Along the cambered axle: gravity, and the centripetal acceleration to the left.
    hub_offset = 0.46 - 0.31 * math.sin(0.1)
    lateral_acceleration = np.interp(left.t, truth.t, yaw_rate * (speed - yaw_rate * hub_offset))
    assert np.mean(left["az"] - np.cos(0.1) * lateral_acceleration) == pytest.approx(
        G * math.sin(0.1), abs=5e-3
    )
    assert np.mean(log.nodes["frame"]["az"]) == pytest.approx(G, abs=5e-3)
    assert np.std(log.nodes["frame"]["az"]) == pytest.approx(0.05, rel=0.05)


def test_a_seed_is_reproducible_and_the_noise_does_not_depend_on_other_nodes(tmp_path):
    arguments = ("--duration", 10, "--seed", 8)
    for name in "abc":
        (tmp_path / name).mkdir()
    first, again = simulate(tmp_path / "a", *arguments)[1], simulate(tmp_path / "b", *arguments)[1]
    fewer = simulate(tmp_path / "c", *arguments, model=MODEL.replace("[nodes.frame]\n", ""))[1]
    for other in (again, fewer):
        np.testing.assert_array_equal(other.nodes["left"]["gx"], first.nodes["left"]["gx"])
        np.testing.assert_array_equal(other.reference["speed"], first.reference["speed"])
    assert "frame" not in fewer.nodes


def test_an_output_name_without_mcap_gives_a_csv_folder(tmp_path):
    _, folder = simulate(tmp_path, "--duration", 6, out="drive")
    (tmp_path / "again").mkdir()
    _, log = simulate(tmp_path / "again", "--duration", 6)
    np.testing.assert_array_equal(folder.nodes["left"]["gz"], log.nodes["left"]["gz"])
    assert sorted(p.name for p in (tmp_path / "drive").iterdir()) == [
        "frame.csv", "left.csv", "reference.csv", "right.csv", "truth.csv"
    ]  # fmt: skip


def test_at_standstill_the_bias_follows_the_temperature(tmp_path):
    model = MODEL + "[effects.gyro_temperature]\nz = 0.01\n"
    arguments = ("--drive", "rest", "--duration", 60, "--temperature", 20, 40, "--settle", 15)
    _, log = simulate(tmp_path, *arguments, model=model)
    node = log.nodes["frame"]
    warm = 20 + 20 * (1 - np.exp(-node.t / 15))
    np.testing.assert_allclose(node["temperature"], warm, atol=0.03)
    slope = np.polyfit(warm - 25.0, node["gz"], 1)
    np.testing.assert_allclose(slope, [0.01, 0.02], atol=1e-3)
    assert not log.truth["x"].any()


def test_a_falling_supply_changes_the_dependent_bias_and_is_in_the_log(tmp_path):
    model = MODEL + "[effects.gyro_supply]\nz = 0.1\n"
    arguments = ("--drive", "rest", "--duration", 60, "--candidates", "field")
    _, log = simulate(tmp_path, *arguments, "--supply", 4.1, 3.4, model=model)
    node = log.nodes["frame"]
    volts = 4.1 - 0.7 * node.t / 60
    np.testing.assert_allclose(node["supply"], volts, atol=1e-4)
    np.testing.assert_allclose(np.polyfit(volts - 3.7, node["gz"], 1), [0.1, 0.02], atol=1e-3)
    (tmp_path / "again").mkdir()
    _, log = simulate(tmp_path / "again", *arguments, model=model)
    assert "supply" not in log.nodes["frame"]
    assert log.nodes["frame"]["gz"].mean() == pytest.approx(0.02, abs=1e-3)


LOW_NOISE_MODEL = MODEL.replace("0.004", "2e-5").replace("accel_noise = 0.05", "accel_noise = 0.002")


def test_north_is_found_on_a_simulated_turntable(tmp_path, capsys):
    arguments = ["--drive", "turntable", "--duration", 300, "--latitude_deg", 48.1, "--azimuth_deg", 37.0]
    code, log = simulate(tmp_path, *arguments, "--angles_deg", 0, 180, 90, 270, model=LOW_NOISE_MODEL)
    assert code == 0
    assert set(np.unique(log.table["moving"])) == {0.0, 1.0}
    capsys.readouterr()
    arguments = ["--node", "frame", "--axis", "x", "--latitude_deg", "48.1", "--method", "maytag4", "--json"]
    assert main(["north", str(tmp_path / "log.mcap"), *arguments]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["azimuth_deg"] == pytest.approx(37.0, abs=5 * result["sigma_deg"])
    assert result["sigma_deg"] < 1.0


def test_calibrating_simulated_poses_estimates_the_errors_and_its_file_reproduces_them(tmp_path, capsys):
    model = (
        LOW_NOISE_MODEL
        + "[effects.gyro_scale_factor]\nx = 0.03\ny = -0.02\n[nodes.frame.effects.accel_bias]\nx = 0.3\n"
    )
    assert simulate(tmp_path, "--drive", "poses", "--duration", 160, "--seed", 5, model=model)[0] == 0
    calibration = tmp_path / "c.toml"
    arguments = ["calibrate", "imu", str(tmp_path / "log.mcap"), "--node", "frame", "-o", str(calibration)]
    assert main(arguments) == 0
    capsys.readouterr()
    plain = LOW_NOISE_MODEL.replace("[effects.gyro_bias]\nz = 0.02\n", "")
    again = tmp_path / "again"
    again.mkdir()
    arguments = ("--drive", "rest", "--duration", 20, "--calibration", calibration, "--json")
    code, log = simulate(again, *arguments, model=plain)
    assert code == 0
    result = json.loads(capsys.readouterr().out)
    assert {"gyro_bias", "gyro_scale_factor", "accel_bias"} <= set(result["effects"]["frame"])
    assert result["effects"]["right"] == []
    assert np.mean(log.nodes["frame"]["gz"]) == pytest.approx(0.02, abs=5e-4)
    assert np.mean(log.nodes["frame"]["ax"]) == pytest.approx(0.3, abs=0.01)


def test_nodes_on_a_turntable_have_no_wheel_effects(tmp_path, capsys):
    simulate(tmp_path, "--drive", "turntable", "--duration", 30, "--json")
    assert json.loads(capsys.readouterr().out)["effects"]["left"] == ["gyro_bias"]


def test_the_reference_of_a_log_can_be_driven_again(tmp_path):
    _, first = simulate(tmp_path, "--duration", 30, "--seed", 4)
    again = tmp_path / "again"
    again.mkdir()
    _, second = simulate(again, "--drive", "reference", "--from", tmp_path / "log.mcap")
    x = [np.interp(28.0, log.truth.t, log.truth["x"]) for log in (first, second)]
    y = [np.interp(28.0, log.truth.t, log.truth["y"]) for log in (first, second)]
    length = first.reference["speed"].sum() / 50.0
    assert math.hypot(x[0] - x[1], y[0] - y[1]) < 0.005 * length


def test_a_drive_follows_the_fixes_of_a_log(tmp_path):
    """The fixes are converted with independent code; the drive must have their speeds and turns."""
    rng = np.random.default_rng(2)
    source = gnss_drive(rng, gnss_loop(rng, length=120.0), sigma=0.3)
    t = source.fix_t
    gnss = Table(
        {
            "t": t,
            "latitude_deg": source.fix_latitude_deg,
            "longitude_deg": source.fix_longitude_deg,
            "altitude": 0 * t,
        }
    )
    node = Table({name: np.arange(3.0) for name in ("t", "gx", "gy", "gz", "ax", "ay", "az")})
    write_recording(Recording({"any": node}, gnss=gnss), tmp_path / "gnss.mcap")
    code, log = simulate(tmp_path, "--drive", "gnss", "--from", tmp_path / "gnss.mcap")
    assert code == 0
    speed = np.interp(log.reference.t + t[0], source.t, source.speed)
    assert np.std(log.reference["speed"] - speed) < 0.1, "seed 2"
    times = np.array([20.0, 60.0])
    heading = np.interp(times, log.truth.t, log.truth["heading"])
    assert np.diff(heading) == pytest.approx(
        np.diff(np.interp(times + t[0], source.t, source.heading)), abs=0.2
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--duration", "1"], "--duration: 1: write a number from 5"),
        (["--rate", "0.1"], "--rate: 0.1: write a number from 1"),
        (["--seed", "-1"], "whole number from 0"),
        (["--rate", "0"], "--rate: 0: write"),
        (["--temperature", "1", "2", "--settle", "0"], "--settle: 0: write"),
        (["--drive", "turntable", "--angles-deg", "nan"], "--angles-deg: nan: write"),
        (["--drive", "reference"], "needs --from LOG"),
        (["--from", "x.mcap"], "goes with reference or gnss"),
        (["--drive", "gnss", "--from", "nope.mcap"], "nope.mcap"),
        (["--drive", "poses", "--duration", "30"], "74 s or more"),
        (["--latitude_deg", "48"], "turntable or poses"),
        (["--settle", "3"], "two temperatures"),
        (["--temperature", "1", "2", "3"], "give one number"),
        (["--supply", "1", "2", "3"], "give one number"),
        (["--virtual-node", "--supply", "3.9"], "remove --supply"),
        (["--virtual-node", "--drive", "poses"], "cannot do poses"),
        (["--virtual-node", "--rate", "100"], "52, 104, 208, 416"),
        (["--calibration", "nope.toml"], "nope.toml"),
    ],
)
def test_each_mistake_is_one_line_and_leaves_nothing(tmp_path, capsys, arguments, message):
    out = tmp_path / "log.mcap"
    assert main(["simulate", str(write_model(tmp_path)), "-o", str(out), *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not out.exists()


def test_a_mistake_in_the_model_and_an_existing_output_are_refused(tmp_path, capsys):
    bad = write_model(tmp_path, MODEL.replace("gyro_bias", "gyro_bais"))
    assert main(["simulate", str(bad), "-o", str(tmp_path / "log.mcap")]) == 2
    assert "did you mean 'gyro_bias'" in capsys.readouterr().err
    (tmp_path / "taken.mcap").write_bytes(b"")
    assert main(["simulate", str(write_model(tmp_path)), "-o", str(tmp_path / "taken.mcap")]) == 2
    assert "exists already" in capsys.readouterr().err
    strange = write_model(tmp_path, MODEL.replace("nodes.frame", "nodes.box"))
    assert main(["simulate", str(strange), "-o", str(tmp_path / "l.mcap"), "--virtual-node"]) == 2
    assert "no node is called 'box' in the protocol" in capsys.readouterr().err


def test_an_input_can_be_a_constant(tmp_path):
    model = MODEL.replace("[inputs]", "[inputs]\nspeed = 1.5\nyaw_rate = 0")
    _, log = simulate(tmp_path, "--duration", 10, model=model)
    assert np.mean(log.nodes["left"]["gz"]) == pytest.approx(1.5 / 0.31 + 0.02, abs=1e-3)
    assert log.truth["x"][-1] == pytest.approx(15.0, abs=0.01)


def test_a_turntable_follows_its_programme():
    inputs, report = TurntableProgramme((0.0, np.pi), 5.0, 2.0).inputs_and_record(21.0, EarthRotation(0.5))
    np.testing.assert_allclose(
        inputs.yaw_rate.integral(np.array([4.9, 7.0, 11.9, 14.0])), [0, np.pi, np.pi, 0], atol=1e-6
    )
    t, angle, moving = report.T
    assert moving[t < 5.0].max() == 0.0
    assert moving[(t >= 5.0) & (t < 6.95)].min() == 1.0
    still = inputs.yaw_rate(np.linspace(0.2, 4.8, 100))
    assert np.abs(still).max() < 1e-9
    np.testing.assert_allclose(angle[(t >= 7.0) & (t < 12.0)], np.pi, atol=1e-6)


def test_rates_and_forces_of_hand_held_poses_match_their_attitudes():
    """Compare with numerically differentiated attitudes."""
    poses = PoseSequence(
        Rotation.random(4, rng=np.random.default_rng(1)), rest_time=1.0, turn_time=2.0, latitude=0.8
    )
    assert poses.duration == 10.0
    h = 1e-5

    def attitude(t):
        number = min(int(t // 3.0), 3)
        s = np.clip((t - 3.0 * number - 1.0) / 2.0, 0.0, 1.0)
        fraction = s**3 * (10 - 15 * s + 6 * s * s)
        rotation = (poses.attitudes[number].inv() * poses.attitudes[min(number + 1, 3)]).as_rotvec()
        return poses.attitudes[number] * Rotation.from_rotvec(fraction * rotation)

    for t in (0.5, 1.7, 2.4, 5.1, 8.0, 9.9):
        rate, slope, force = (a[:, 0] for a in poses(np.array([t])))
        body_rate = (attitude(t - h).inv() * attitude(t + h)).as_rotvec() / (2 * h)
        world = attitude(t).inv()
        earth = world.apply(EARTH_RATE * np.array([0, np.cos(0.8), np.sin(0.8)]))
        np.testing.assert_allclose(rate, body_rate + earth, atol=1e-7)
        np.testing.assert_allclose(force, world.apply([0, 0, G]), atol=1e-9)
        ends = poses(np.array([t - h, t + h]))[0]
        np.testing.assert_allclose(slope, (ends[:, 1] - ends[:, 0]) / (2 * h), atol=1e-6)
