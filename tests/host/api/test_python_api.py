"""The Python interface: results equal those of the verbs, short representations, errors of one line."""

import io
import json

import numpy as np
import pandas as pd
import pytest

import hubodo
import wanted
from hubodo.terminal import SafeConsole
from in_process import hubodo as run


@pytest.fixture(scope="module")
def drive(examples):
    return hubodo.open(str(examples / "drive.mcap"), vehicle=examples / "vehicle.toml")


@pytest.fixture(scope="module")
def night(examples):
    return hubodo.open(examples / "night.mcap")


def test_a_track_and_its_files_equal_those_of_the_verb(drive, examples, tmp_path):
    track = drive.fuse(smooth=2.0)
    arguments = ("--vehicle", examples / "vehicle.toml", "--smooth", 2, "-o", tmp_path / "verb")
    assert run("fuse", drive.path, *arguments).code == 0
    track.save(tmp_path / "api")
    texts = [(tmp_path / side / "track.csv").read_text() for side in ("verb", "api")]
    assert texts[0] == texts[1]
    results = [json.loads((tmp_path / side / "fuse.json").read_text()) for side in ("verb", "api")]
    assert results[0].pop("output") == str(tmp_path / "verb") and results[1].pop("output") == str(
        tmp_path / "api"
    )
    assert results[0] == results[1] == track.as_json()
    with pytest.raises(hubodo.InputError, match="exists"):
        track.save(tmp_path / "api")


@pytest.fixture(scope="module")
def track(drive):
    return drive.fuse()


def test_a_frame_holds_the_columns_by_time(drive, track):
    frame = drive.frame("left")
    assert list(frame.columns) == ["gx", "gy", "gz", "ax", "ay", "az", "temperature"]
    assert np.array_equal(frame.index, drive["left"].t) and np.array_equal(frame["gz"], drive["left"]["gz"])
    frame.loc[:, "gz"] = 0.0
    assert drive["left"]["gz"].any()
    assert np.array_equal(track.frame()["sigma_x"], track.sigma_x)


def test_a_frame_by_utc_has_exact_times(drive, examples):
    zero_ns = 1_700_000_000_123_456_789
    dated = hubodo.LoadedLog(drive.path, hubodo.Recording(drive.nodes, t_zero_ns=zero_ns))
    index = dated.frame("left", utc=True).index
    assert index[1] == pd.Timestamp(zero_ns + 5_000_000, tz="UTC")
    with pytest.raises(hubodo.InputError, match="date"):
        hubodo.LoadedLog(drive.path, hubodo.Recording(drive.nodes)).frame("left", utc=True)


@pytest.fixture(scope="module")
def night_results(night):
    """Return the results of a gyro axis at standstill by the verbs that give the same."""
    return {"allan": night.allan("left", "gy"), "warmup": night.warmup("left", "gy")}


def test_allan_and_warmup_equal_those_of_the_verbs(night, night_results):
    for verb, result in night_results.items():
        done = run(verb, night.path, "--node", "left", "--channel", "gy", "--json")
        verb_result = json.loads(done.out)
        assert {key: verb_result[key] for key in result.as_json()} == json.loads(json.dumps(result.as_json()))


def test_a_result_prints_the_text_of_its_verb(night, night_results):
    for verb, result in night_results.items():
        console = SafeConsole(file=io.StringIO(), width=160)
        result.render(console)
        printed = run(verb, night.path, "--node", "left", "--channel", "gy").out
        assert console.file.getvalue() == printed and len(printed) > 500


def test_gap_equals_that_of_the_verb(drive, examples, tmp_path):
    simulated = hubodo.simulate(examples / "leaning.toml", duration=30.0, rate=52.0, seed=3)
    log = simulated.save(tmp_path / "leaning.mcap")
    gap = simulated.gap(examples / "model.toml", reject=["empirical"])
    arguments = (
        "gap",
        examples / "model.toml",
        log,
        "--reject",
        "empirical",
        "-o",
        tmp_path / "gap",
        "--json",
    )
    verb_result = json.loads(run(*arguments).out)
    assert verb_result["found"] == json.loads(json.dumps(gap.as_json()["found"]))
    assert [it.effect for it in gap.found] == ["wheel_camber"] and gap.after < 1.1 < gap.before
    gap.save(tmp_path / "api")
    for name in ("gap.json", "model.toml"):
        texts = [(tmp_path / side / name).read_text() for side in ("gap", "api")]
        assert texts[0] == texts[1].replace("simulated-random", "leaning.mcap"), name
    assert "leans" in (tmp_path / "api" / "report.html").read_text()
    with pytest.raises(hubodo.InputError, match="not a result of gap"):
        gap.save(examples)
    assert "wheel_camber" in gap._repr_html_() and "gap" in gap.plot()._repr_html_()


def test_the_heading_of_a_real_ride_agrees_with_its_frame_gyro():
    log = hubodo.open(wanted.recording("wheelchair"))
    mounts = {name: hubodo.NodeMount(name, "left") for name in ("left", "right")}
    track = log.fuse(hubodo.Vehicle(0.31, 0.92, mounts))
    frame = log["frame"]
    gyro_heading = np.concatenate(
        ([0.0], np.cumsum(np.diff(frame.t) * (frame["gz"][1:] + frame["gz"][:-1]) / 2.0))
    )
    difference = track.heading - np.interp(track.t, frame.t, gyro_heading)
    assert np.degrees(np.ptp(track.heading)) > 90.0 and np.degrees(np.ptp(difference)) < 3.0


def test_a_simulated_log_equals_that_of_the_verb(examples, tmp_path):
    arguments = ("--drive", "loop", "--duration", 20, "--seed", 5, "--temperature", 20, 30)
    assert run("simulate", examples / "model.toml", *arguments, "-o", tmp_path / "verb").code == 0
    simulated = hubodo.simulate(examples / "model.toml", "loop", duration=20, seed=5, temperature=(20, 30))
    simulated.save(tmp_path / "api")
    for name in ("left.csv", "right.csv", "reference.csv", "truth.csv"):
        assert (tmp_path / "verb" / name).read_text() == (tmp_path / "api" / name).read_text()
    assert simulated.fuse().score.final_percent < 5.0


def test_results_have_a_short_representation_and_one_in_html(drive, track, night_results):
    allan, warmup = night_results["allan"], night_results["warmup"]
    for result in (drive, drive["left"], drive.recording, track, allan, warmup, track.plot(), drive.plot()):
        assert len(repr(result)) < 250 and repr(result).startswith(type(result).__name__ + "(")
    for result in (drive, drive["left"], track, allan, warmup):
        assert result._repr_html_().count("<tr>") > 2
    for plot in (drive.plot("ax"), track.plot(), allan.plot(["MPU-6050"]), warmup.plot()):
        assert "<svg" in plot._repr_html_()


def test_the_suffix_selects_the_format_of_a_plot(drive, tmp_path):
    plot = drive.plot()
    assert plot.save(tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(hubodo.InputError, match=r"\.png, \.svg, \.pdf"):
        plot.save(tmp_path / "a.gif")


def test_files_can_be_written_and_read_by_text_paths(examples, tmp_path):
    model = hubodo.read_model(str(examples / "leaning.toml"))
    hubodo.write_model(model, str(tmp_path / "model.toml"))
    assert hubodo.read_model(str(tmp_path / "model.toml")) == model
    assert hubodo.load_vehicle(str(tmp_path / "model.toml")) == model.vehicle
    hubodo.write_calibration(hubodo.Calibration(), str(tmp_path / "calibration.toml"))
    assert hubodo.read_calibration(str(tmp_path / "calibration.toml")) == hubodo.Calibration()


def test_a_log_is_a_mapping_of_its_tables(drive):
    assert list(drive) == ["left", "right", "reference", "truth"] and len(drive) == 4
    assert "left" in drive and "gnss" not in drive
    assert drive["truth"] is drive.recording.truth and drive.duration == pytest.approx(60.0, abs=0.1)


def test_a_table_without_rows_or_numbers_has_a_representation():
    assert repr(hubodo.Table({"t": np.array([])})) == "Table(0 rows, t)"
    empty = hubodo.Table({"t": np.arange(3.0), "gx": np.full(3, np.nan)})
    assert '>gx</td><td class="number"></td>' in empty._repr_html_()


def open_bare(log, folder):
    """Return a log of the same samples that carries no vehicle."""
    return hubodo.open(log.save(folder))


@pytest.mark.parametrize(
    ("invalid_call", "error", "message"),
    [
        (lambda log, folder: hubodo.open(folder / "no.mcap"), hubodo.LogError, "no.mcap"),
        (lambda log, folder: log["middle"], hubodo.InputError, "no table 'middle'; it has left, right"),
        (lambda log, folder: log.frame(), hubodo.InputError, "which node"),
        (lambda log, folder: log.allan("frame"), hubodo.InputError, "no node 'frame'"),
        (lambda log, folder: log.warmup("left", "ax"), hubodo.InputError, "gx, gy, gz"),
        (lambda log, folder: log.fuse(smooth=-1.0), hubodo.InputError, "smooth = -1.0"),
        (lambda log, folder: log.fuse(smooth=1.0, method="differential"), hubodo.InputError, "filter"),
        (lambda log, folder: log.gap(folder / "vehicle.toml"), hubodo.ConfigError, "imu"),
        (lambda log, folder: log.gap(folder / "model.toml", accept=["cambre"]), hubodo.InputError, "accept"),
        (lambda log, folder: open_bare(log, folder / "a").gap(), hubodo.InputError, "give a model file"),
        (lambda log, folder: log.plot("mx"), hubodo.InputError, "'mx'"),
        (lambda log, folder: log.save(folder / "drive.mcap"), hubodo.InputError, "exists already"),
        (lambda log, folder: hubodo.simulate(folder / "model.toml", "fly"), hubodo.InputError, "'fly'"),
        (lambda log, folder: open_bare(log, folder / "b").fuse(), hubodo.InputError, "holds no vehicle"),
    ],
)
def test_invalid_calls_are_refused_in_one_line(invalid_call, error, message, drive, examples):
    with pytest.raises(error, match=message) as caught:
        invalid_call(drive, examples)
    assert "\n" not in str(caught.value)
