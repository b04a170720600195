"""Implausible settings are refused in one line that names file and key, in every kind of TOML file."""

import os
import re

import pytest

from fuzz import seeds
from hubodo.calibration.file import read_calibration
from hubodo.errors import ConfigError
from hubodo.flash.fleet import read_fleet
from hubodo.ingest.link.keys import KeyRing
from hubodo.ingest.live.record_config import load_record_config
from hubodo.model.model_file import read_model
from hubodo.sensors.allan.datasheet import read_datasheet
from hubodo.vehicle import load_vehicle
from hubodo.web.config import load_web_config

KINDS = {
    "vehicle": (load_vehicle, seeds.VEHICLE),
    "model": (read_model, seeds.MODEL),
    "calibration": (read_calibration, seeds.CALIBRATION),
    "data sheet": (lambda path: read_datasheet(str(path)), seeds.DATASHEET),
    "recorder": (load_record_config, seeds.RECORD),
    "page": (load_web_config, seeds.RECORD),
    "keys": (KeyRing, "[keys]\n"),
    "fleet": (read_fleet, '[nodes]\ne6614103e7452d2f = "left"\n'),
}
NUMBER = re.compile(r"(?<=[=\[] )-?[0-9][0-9.e-]*")


@pytest.mark.parametrize("kind", KINDS)
def test_a_hostile_toml_file_is_refused_in_one_short_line(tmp_path, kind) -> None:
    read, text = KINDS[kind]
    path = tmp_path / "x.toml"
    path.touch(0o600)  # a file of keys that others can read is refused
    for content in (
        b"x = " + b"9" * 5000,
        b"x = " + b"[" * 3000 + b"]" * 3000,
        b"x = " + b"{a=" * 2000 + b"1" + b"}" * 2000,
        b"a." * 3000 + b"a = 1",
        b"# \xff",
        b"# \0",
        b"# x\n" * 300_000,
        b'x = "' + b"y" * 900_000 + b'"',
        b"y" * 900_000 + b" = 1",
    ):
        path.write_bytes(text.encode() + b"\n[zz]\n" + content)
        if content.startswith((b"x = ", b"y", b"a.")) and kind in ("page", "data sheet"):
            path.write_bytes(content)  # these readers ignore other tables
        try:
            read(path)
        except ConfigError as error:
            assert str(path) in str(error)
            assert len(str(error)) < 2100
        else:
            assert kind == "page"


@pytest.mark.parametrize("kind", KINDS)
def test_a_pipe_a_device_or_a_folder_is_refused(tmp_path, kind) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "pipe", tmp_path / "folder", "/dev/zero"):
        with pytest.raises(ConfigError if kind != "data sheet" else Exception, match=r"device|no such file"):
            KINDS[kind][0](type(tmp_path)(path))


def test_a_byte_order_mark_is_skipped(tmp_path) -> None:
    (tmp_path / "v.toml").write_bytes(b"\xef\xbb\xbf" + seeds.VEHICLE.encode())
    assert load_vehicle(tmp_path / "v.toml").track_width == 0.92


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ("page", "keys", "fleet")])
def test_each_number_must_be_finite_and_plausible(tmp_path, kind) -> None:
    read, text = KINDS[kind]
    path = tmp_path / "x.toml"
    numbers = list(NUMBER.finditer(text))
    assert len(numbers) > 3
    for number in numbers:
        key = text[: number.start()].splitlines()[-1].split(" ")[0]
        for value in ("nan", "inf", "-inf", "1e300", "-1e300", "2020-01-01", "12:00:00", "true"):
            path.write_text(text[: number.start()] + value + text[number.end() :])
            with pytest.raises(ConfigError, match=rf"x\.toml.*{key}"):
                read(path)
