"""Arguments of `hubodo gap` in the wrong order or of the wrong kind."""

from argparse import Namespace
from pathlib import Path

import pytest

from hubodo.errors import InputError
from hubodo.verbs.gap_arguments import check_argument_order

VEHICLE = "[vehicle]\nwheel_radius = 0.3\ntrack_width = 1.4\n"
MODEL = VEHICLE + "[imu]\ngyro_noise = 0.01\naccel_noise = 0.1\n"


def arguments(folder, **paths):
    """Return parsed arguments; names of files in the folder, which holds a model and a vehicle."""
    (folder / "model.toml").write_text(MODEL, "utf-8")
    (folder / "vehicle.toml").write_text(VEHICLE, "utf-8")
    names = {"model": None, "log": None, "vehicle": None, "before": None, "after": None, **paths}
    return Namespace(**{key: None if name is None else Path(folder / name) for key, name in names.items()})


@pytest.mark.parametrize(
    ("paths", "message"),
    [
        ({"model": "a.mcap", "log": "model.toml"}, "MODEL comes before LOG"),
        ({"model": "vehicle.toml", "log": "a.mcap"}, "gap --vehicle"),
        ({"model": "model.toml", "log": "vehicle.toml"}, "a log is due here"),
        ({"vehicle": "vehicle.toml", "model": "model.toml"}, "a log is due here"),
        ({"model": "a.mcap", "before": "model.toml", "after": "b.mcap"}, "--before"),
        ({"model": "a.mcap", "before": "b.mcap", "after": "model.toml"}, "--after"),
        ({"model": "vehicle.toml", "before": "a.mcap", "after": "b.mcap"}, "gap --vehicle"),
    ],
)
def test_each_mistake_is_named_in_one_line(paths, message, tmp_path):
    with pytest.raises(InputError, match=message) as error:
        check_argument_order(arguments(tmp_path, **paths))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "paths",
    [
        {"model": "model.toml", "log": "a.mcap"},
        {"vehicle": "vehicle.toml", "model": "a.mcap"},
        {"model": "model.toml", "before": "a.mcap", "after": "b.mcap"},
        {"vehicle": "vehicle.toml", "before": "a.mcap", "after": "b.mcap"},
        {"model": "missing.toml", "log": "a.mcap"},
    ],
)
def test_arguments_in_the_proper_order_are_accepted(paths, tmp_path):
    check_argument_order(arguments(tmp_path, **paths))
