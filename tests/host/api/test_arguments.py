"""Arguments of the Python interface that may be a path or an object."""

import hashlib
from pathlib import Path

import pytest

from hubodo.api.arguments import as_calibration, as_model, as_vehicle
from hubodo.calibration.file import Calibration
from hubodo.errors import ConfigError
from hubodo.vehicle import load_vehicle
from vehicles import model_toml, vehicle_toml


def test_a_path_is_read_and_an_object_is_returned_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "vehicle.toml"
    path.write_text(vehicle_toml(0.165, 0.55))
    vehicle = as_vehicle(str(path))
    assert vehicle == as_vehicle(path) == load_vehicle(path) and vehicle.wheel_radius == 0.165
    assert as_vehicle(vehicle) is vehicle
    (tmp_path / "model.toml").write_text(model_toml(0.165, 0.55))
    model = as_model(tmp_path / "model.toml")
    assert model.vehicle.wheel_radius == 0.165 and as_model(model) is model


def test_a_calibration_that_was_read_comes_with_the_hash_of_its_file(tmp_path: Path) -> None:
    path = tmp_path / "calibration.toml"
    path.write_text("")
    calibration, source = as_calibration(path)
    assert calibration == Calibration()
    assert source == {"file": str(path), "sha256": hashlib.sha256(b"").hexdigest()}
    assert as_calibration(calibration) == (calibration, None)
    assert as_calibration(None) == (None, None)


@pytest.mark.parametrize("read", [as_vehicle, as_model, as_calibration])
def test_a_missing_file_is_named(read, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="nowhere"):
        read(tmp_path / "nowhere.toml")
