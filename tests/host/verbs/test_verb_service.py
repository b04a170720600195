"""`hubodo service` and `hubodo config`: files in their places, as required by the tools that read them."""

import dataclasses
import json
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

from hubodo.ingest.live.record_config import CONFIG_TABLES, RecordConfig, load_record_config
from hubodo.service import systemd_unit, udev_rules
from hubodo.service.installation import ServiceLocation, inaccessible_parent
from hubodo.settings_table import format_example_toml
from hubodo.verbs.config import SETTINGS
from in_process import hubodo

CONFIG = '[record]\nports = ["left=/dev/hubodo/E66"]\nvehicle = "v.toml"\n'


@pytest.fixture
def installed(tmp_path):
    """Install the service into a folder; return the folder and the JSON output."""
    (tmp_path / "hubodo.toml").write_text(CONFIG)
    (tmp_path / "v.toml").write_text("[vehicle]\n")
    root = tmp_path / "image"
    done = hubodo("service", "install", "--root", root, "--config", tmp_path / "hubodo.toml", "--json")
    assert done.code == 0, done.err
    return root, json.loads(done.out)


def test_an_installation_writes_unit_rules_and_settings_and_runs_nothing_with_root(installed):
    root, result = installed
    assert (root / "etc/hubodo/hubodo.toml").read_text() == CONFIG
    assert (root / "etc/hubodo/v.toml").exists()
    text = (root / "etc/systemd/system/hubodo.service").read_text()
    assert "record --config /etc/hubodo/hubodo.toml --wait -o ${STATE_DIRECTORY}" in text
    assert (root / "etc/udev/rules.d/70-hubodo.rules").read_text() == udev_rules.rules_text()
    assert result["commands"] == []
    again = hubodo("service", "install", "--root", root)
    assert again.code == 0, "existing settings are kept"
    assert (root / "etc/hubodo/hubodo.toml").read_text() == CONFIG


@pytest.mark.parametrize("user", [False, True])
def test_the_unit_wants_a_synchronised_clock_but_does_not_wait_for_the_network(user):
    text = systemd_unit.unit_text(Path("/usr/bin/hubodo"), Path("/etc/hubodo/hubodo.toml"), user=user)
    lines = [line.partition("=") for line in text.splitlines() if not line.startswith("#")]
    wants, after = (
        [value.split() for key, _, value in lines if key == wanted] for wanted in ("Wants", "After")
    )
    assert wants == [["time-set.target", "time-sync.target"]]
    assert after == [["local-fs.target", "time-set.target"]]
    assert not any(key == "Requires" for key, _, _ in lines)


def test_uninstall_removes_unit_and_rules_and_keeps_the_settings(installed):
    root, _ = installed
    done = hubodo("service", "uninstall", "--root", root)
    assert done.code == 0
    left = sorted(path.name for path in root.rglob("*") if path.is_file())
    assert left == ["hubodo.toml", "v.toml"]
    assert "settings" in done.out


def test_a_dry_run_shows_everything_and_writes_nothing(tmp_path):
    (tmp_path / "hubodo.toml").write_text('[record]\nports = ["/dev/ttyACM0"]\n')
    before = sorted(tmp_path.rglob("*"))
    done = hubodo("service", "install", "--dry-run", "--config", tmp_path / "hubodo.toml")
    assert done.code == 0
    assert "would write /etc/systemd/system/hubodo.service" in done.out
    assert "would run systemctl enable --now hubodo.service" in done.out
    assert "WatchdogSec=30" in done.out
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ("[record]\n", "has no port"),
        ("[record]\nprots = []\n", "did you mean 'ports'"),
        (None, "hubodo config example"),
    ],
)
def test_invalid_settings_are_refused_before_anything_is_written(tmp_path, config, message):
    arguments = ["service", "install", "--root", tmp_path / "image"]
    if config is not None:
        (tmp_path / "hubodo.toml").write_text(config)
        arguments += ["--config", tmp_path / "hubodo.toml"]
    done = hubodo(*arguments)
    assert done.code == 2
    assert message in done.err
    assert not (tmp_path / "image").exists()


def test_without_systemd_the_error_names_the_command_to_run_instead(monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    for action in ("install", "status", "uninstall"):
        done = hubodo("service", action)
        assert done.code == 2
        assert "hubodo record --config hubodo.toml --wait" in done.err


def test_a_user_service_has_its_own_unit_and_no_udev_rules(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    location = ServiceLocation(is_user_service=True)
    assert location.unit == tmp_path / "config/systemd/user/hubodo.service"
    assert location.rules is None
    assert location.systemctl("start") == ("systemctl", "--user", "start")
    assert "DynamicUser" not in systemd_unit.unit_text(tmp_path / "hubodo", location.config, user=True)


@pytest.mark.parametrize("user", [False, True])
def test_systemd_accepts_every_line_of_the_unit(tmp_path, user):
    if shutil.which("systemd-analyze") is None:
        pytest.skip("no systemd-analyze here")
    program = tmp_path / "a folder" / "hubodo"
    program.parent.mkdir()
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    path = tmp_path / systemd_unit.UNIT_NAME
    path.write_text(systemd_unit.unit_text(program, tmp_path / "hubodo.toml", user=user))
    done = subprocess.run(
        [
            "systemd-analyze",
            "verify",
            "--man=no",
            "--recursive-errors=no",
            *(["--user"] if user else []),
            path,
        ],
        capture_output=True,
        text=True,
    )
    messages = [line for line in done.stderr.splitlines() if systemd_unit.UNIT_NAME in line]
    assert messages == []


def test_systemd_rates_the_security_of_the_unit_as_good(tmp_path):
    if shutil.which("systemd-analyze") is None:
        pytest.skip("no systemd-analyze here")
    exposure = systemd_unit.rate_exposure(
        systemd_unit.unit_text(tmp_path / "hubodo", tmp_path / "hubodo.toml", user=False)
    )
    assert exposure is not None
    assert exposure <= 2.5


def test_a_program_in_a_private_folder_is_detected(tmp_path):
    hidden = tmp_path / "home"
    hidden.mkdir(mode=0o700)
    assert inaccessible_parent(hidden / "bin/hubodo") is not None


def test_udev_rules_are_well_formed_and_jump_to_an_existing_label():
    text = udev_rules.rules_text()
    for line in text.splitlines():
        if not line.startswith("#"):
            parts = re.findall(r'([A-Z]+(?:\{\w+\})?)(==|!=|\+=|=)"([^"]*)"(?:, |$)', line)
            assert ", ".join(f'{key}{op}"{value}"' for key, op, value in parts) == line
    assert 'SYMLINK+="hubodo/$env{ID_SERIAL_SHORT}"' in text
    assert text.count('GOTO="hubodo_end"') == 3
    assert text.rstrip().endswith('LABEL="hubodo_end"')
    if (
        shutil.which("udevadm")
        and "verify" in subprocess.run(["udevadm", "--help"], capture_output=True, text=True).stdout
    ):
        subprocess.run(["udevadm", "verify", "-"], input=text, text=True, check=True)


def test_the_example_file_has_the_defaults_and_is_valid_if_uncommented(tmp_path):
    done = hubodo("config", "example")
    assert done.code == 0
    path = tmp_path / "hubodo.toml"
    path.write_text(done.out)
    assert load_record_config(path) == RecordConfig()
    for name in ("vehicle.toml", "calibration.toml"):
        (tmp_path / name).write_text("")
    path.write_text(re.sub(r"(?m)^#(\w+ = )", r"\1", done.out))
    assert set(tomllib.loads(path.read_text())["record"]) == {
        f.name for f in dataclasses.fields(RecordConfig)
    }
    checked = hubodo("config", "check", path, "--json")
    assert checked.code == 0, checked.err
    assert json.loads(checked.out)["settings"]["record"]["rotate_after"] == 3600


def test_every_setting_is_explained_and_every_table_of_the_file_has_settings():
    assert tuple(SETTINGS) == CONFIG_TABLES
    for shape in SETTINGS.values():
        assert all(item.metadata.get("says") for item in dataclasses.fields(shape))
    assert format_example_toml(SETTINGS, "head").startswith("# head\n")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("rotate_aftr = 3", "did you mean 'rotate_after'"),
        ("disk_budget_mb = 100", "only closed logs are removed"),
        ("disk_budget_mb = 100\nrotate_at_mb = 80", "must hold two logs"),
        ("rotate_after = inf", "must be a finite number"),
        ("disk_reserve_mb = -1", "at least 0"),
        ("disk_reserve_mb = nan", "must be a finite number"),
        ('vehicle = "none.toml"', "no such file"),
    ],
)
def test_config_check_names_each_mistake_with_its_key(tmp_path, line, message):
    path = tmp_path / "hubodo.toml"
    path.write_text(f"[record]\n{line}\n")
    done = hubodo("config", "check", path)
    assert done.code == 2
    assert message in done.err
    assert "\n" not in done.err.strip()


def test_the_same_bounds_hold_on_the_command_line(tmp_path):
    done = hubodo("record", "/dev/nope", "-o", tmp_path / "x.mcap", "--rotate-after", "0")
    assert (done.code, "--rotate-after: 0: write a number above 0" in done.err) == (2, True)
