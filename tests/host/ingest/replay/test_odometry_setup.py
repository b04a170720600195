"""Settings of the odometry that a log holds."""

from pathlib import Path

import pytest

from hubodo.errors import ConfigError
from hubodo.ingest.replay.odometry_setup import read_odometry_setup
from hubodo.log.log_writer import LogWriter
from hubodo.log.logfile import open_log
from vehicles import vehicle_toml


def _setup(tmp_path: Path, attachments: dict[str, bytes], **metadata: str) -> object:
    path = tmp_path / "log.mcap"
    with LogWriter(path, metadata=metadata, clock=None) as log:
        for name, data in attachments.items():
            log.add_attachment(name, "text/plain", data)
    with open_log(path) as log:
        return read_odometry_setup(log)


def test_a_log_without_settings_leaves_them_unknown(tmp_path: Path) -> None:
    setup = _setup(tmp_path, {})
    assert (setup.vehicle, setup.calibration, setup.rate_hz) == (None, None, None)


def test_vehicle_and_rate_are_those_of_the_log(tmp_path: Path) -> None:
    setup = _setup(tmp_path, {"vehicle.toml": vehicle_toml(0.165, 0.55).encode()}, odometry_rate_hz="12.5")
    assert setup.vehicle.wheel_radius == 0.165
    assert setup.rate_hz == 12.5


@pytest.mark.parametrize("rate", ["0", "-3", "inf", "nan"])
def test_a_rate_that_no_odometry_can_have_is_no_limit(tmp_path: Path, rate: str) -> None:
    assert _setup(tmp_path, {}, odometry_rate_hz=rate).rate_hz is None


def test_a_rate_that_is_no_number_is_refused_with_file_and_value(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"log\.mcap: odometry_rate_hz = 'fast' is not a number"):
        _setup(tmp_path, {}, odometry_rate_hz="fast")


def test_an_attached_vehicle_that_is_no_text_is_refused_with_a_remedy(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"vehicle\.toml: not TOML: .*; give --vehicle"):
        _setup(tmp_path, {"vehicle.toml": b"\xff\xfe"})
