"""Each verb of `hubodo batch` gives the same result as on a single log, and its files are stored."""

import json

import pandas as pd
import pytest

from in_process import hubodo
from repetitions import first_and_more
from vehicles import DRIVE_MODEL, LOW_INPUT_NOISE

OPTIONS = {
    "fuse": ("--vehicle", "MODEL"),
    "report": ("--vehicle", "MODEL"),
    "export": ("--format", "parquet"),
    "calibrate wheels": ("--vehicle", "MODEL"),
}
FILES = {
    "fuse": {"track.csv", "fuse.json"},
    "report": {"report.html"},
    "export": {"left.parquet", "right.parquet", "reference.parquet", "truth.parquet"},
    "calibrate wheels": {"calibration.toml"},
    "gap": {"gap.json", "model.toml", "report.html"},
}
CAMBER = "\n[nodes.left.effects.wheel_camber]\nangle = 0.2\n"


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    """Return the model and the logs of two vehicles, the second with a cambered left wheel."""
    folder = tmp_path_factory.mktemp("drives")
    model = folder / "model.toml"
    model.write_text(DRIVE_MODEL + LOW_INPUT_NOISE)
    (folder / "leaning.toml").write_text(model.read_text() + CAMBER)
    for vehicle, model_file in (("van-1", model), ("van-2", folder / "leaning.toml")):
        (folder / "logs" / vehicle).mkdir(parents=True)
        words = ["--duration", 24, "--rate", 100, "--seed", 3, "-o", folder / "logs" / vehicle / "a.mcap"]
        assert hubodo("simulate", model_file, *words).code == 0
    return model, folder / "logs"


def finished(out):
    return pd.concat(pd.read_parquet(path) for path in (out / "finished").iterdir())


@pytest.mark.parametrize("verb", ["fuse", "export", *first_and_more("calibrate wheels", "report")])
def test_a_verb_gives_the_result_of_a_single_run(drives, tmp_path, here, verb):
    model, logs = drives
    log, out = logs / "van-2" / "a.mcap", tmp_path / "out"
    options = [model if word == "MODEL" else word for word in OPTIONS[verb]]
    done = hubodo("batch", *verb.split(), log, *options, "-o", out, *here)
    assert done.code == 0, done.err
    row = finished(out).iloc[0]
    name = "alone.html" if verb == "report" else "alone"
    alone = hubodo(*verb.split(), log, *options, "-o", tmp_path / name, "--json")
    assert alone.code == 0, alone.err
    mine, theirs = json.loads(row.result), json.loads(alone.out)
    for result in (mine, theirs):
        for key in (
            "output",
            "folder",
            "size",
        ):  # output paths, and the size of a page that contains its path
            result.pop(key, None)
    assert mine == theirs
    assert {path.name for path in (out / row.files).rglob("*") if path.is_file()} >= FILES[verb]


def test_a_missing_effect_is_found_in_the_vehicle_that_has_it(drives, tmp_path, here):
    model, logs = drives
    done = hubodo("batch", "gap", model, logs, "-o", tmp_path / "out", *here)
    assert done.code == 0, done.err
    table = pd.read_parquet(tmp_path / "out" / "table.parquet")
    effects = table[table.p_value.notna()]
    assert list(effects.vehicle) == ["van-2"] and list(effects.quantity) == ["found.wheel_camber"]
    assert list(effects.node) == ["left"] and effects.q_value.iloc[0] < 0.01
    angle = table[table.quantity == "wheel_camber.angle"].iloc[0]
    assert angle.value == pytest.approx(0.2, abs=4 * angle.sigma)
    assert "wheel_camber in 1" in (tmp_path / "out" / "fleet.html").read_text()
    folder = tmp_path / "out" / effects.files.iloc[0]
    assert {path.name for path in folder.iterdir()} == FILES["gap"]


def test_a_changed_model_causes_new_results(drives, tmp_path, here):
    model, logs = drives
    mine = tmp_path / "mine.toml"

    def fresh(text):
        mine.write_text(text)
        words = ["--vehicle", mine, "-o", tmp_path / "out", *here, "--json"]
        return json.loads(hubodo("batch", "export", logs / "van-1", *words).out)["fresh"]

    text = model.read_text()
    assert fresh(text) == 1
    assert fresh(text.replace("0.92", "0.93")) == 1
    assert fresh(text) == 0
