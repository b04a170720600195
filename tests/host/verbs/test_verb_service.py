"""`hubodo service` and `hubodo config`: files in their places, as the tools that read them want them."""

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
    """(root of a system, what was printed) after an installation into it."""
    (tmp_path / "hubodo.toml").write_text(CONFIG)
    (tmp_path / "v.toml").write_text("[vehicle]\n")
    root = tmp_path / "image"
    done = hubodo("service", "install", "--root", root, "--config", tmp_path / "hubodo.toml", "--json")
    assert done.code == 0, done.err
    return root, json.loads(done.out)


def test_an_installation_puts_unit_rules_and_settings_in_place_and_runs_nothing_in_another_system(installed):
    root, told = installed
    assert (root / "etc/hubodo/hubodo.toml").read_text() == CONFIG
    assert (root / "etc/hubodo/v.toml").exists()
    text = (root / "etc/systemd/system/hubodo.service").read_text()
    assert "record --config /etc/hubodo/hubodo.toml --wait -o ${STATE_DIRECTORY}" in text
    assert (root / "etc/udev/rules.d/70-hubodo.rules").read_text() == udev_rules.rules_text()
    assert told["commands"] == []
    again = hubodo("service", "install", "--root", root)
    assert again.code == 0, "settings that are there stay"
    assert (root / "etc/hubodo/hubodo.toml").read_text() == CONFIG


@pytest.mark.parametrize("user", [False, True])
def test_the_unit_asks_for_a_synchronised_clock_but_waits_for_no_network(user):
    text = systemd_unit.unit_text(Path("/usr/bin/hubodo"), Path("/etc/hubodo/hubodo.toml"), user=user)
    lines = [line.partition("=") for line in text.splitlines() if not line.startswith("#")]
    wants, after = (
        [value.split() for key, _, value in lines if key == wanted] for wanted in ("Wants", "After")
    )
    assert wants == [["time-set.target", "time-sync.target"]]
    assert after == [["local-fs.target", "time-set.target"]]
    assert not any(key == "Requires" for key, _, _ in lines)


def test_what_was_installed_can_be_removed_and_settings_stay(installed):
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
    ("config", "says"),
    [
        ("[record]\n", "has no port"),
        ("[record]\nprots = []\n", "did you mean 'ports'"),
        (None, "hubodo config example"),
    ],
)
def test_settings_that_would_not_start_are_refused_before_anything_is_written(tmp_path, config, says):
    words = ["service", "install", "--root", tmp_path / "image"]
    if config is not None:
        (tmp_path / "hubodo.toml").write_text(config)
        words += ["--config", tmp_path / "hubodo.toml"]
    done = hubodo(*words)
    assert done.code == 2
    assert says in done.err
    assert not (tmp_path / "image").exists()


def test_without_systemd_it_says_what_to_run_instead(monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    for does in ("install", "status", "uninstall"):
        done = hubodo("service", does)
        assert done.code == 2
        assert "hubodo record --config hubodo.toml --wait" in done.err


def test_a_user_has_a_unit_of_its_own_and_no_rules(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    place = ServiceLocation(is_user_service=True)
    assert place.unit == tmp_path / "config/systemd/user/hubodo.service"
    assert place.rules is None
    assert place.systemctl("start") == ("systemctl", "--user", "start")
    assert "DynamicUser" not in systemd_unit.unit_text(tmp_path / "hubodo", place.config, user=True)


@pytest.mark.parametrize("user", [False, True])
def test_systemd_understands_every_line_of_the_unit(tmp_path, user):
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
    said = [line for line in done.stderr.splitlines() if systemd_unit.UNIT_NAME in line]
    assert said == []


def test_the_unit_is_fenced_in_by_systemds_own_measure(tmp_path):
    if shutil.which("systemd-analyze") is None:
        pytest.skip("no systemd-analyze here")
    found = systemd_unit.rate_exposure(
        systemd_unit.unit_text(tmp_path / "hubodo", tmp_path / "hubodo.toml", user=False)
    )
    assert found is not None
    assert found <= 2.5


def test_a_program_that_the_service_may_not_reach_is_told(tmp_path):
    hidden = tmp_path / "home"
    hidden.mkdir(mode=0o700)
    assert inaccessible_parent(hidden / "bin/hubodo") is not None


def test_every_rule_is_made_of_known_keys_and_jumps_to_a_label():
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


def test_the_example_file_changes_nothing_and_uncommented_is_right_line_by_line(tmp_path):
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
    ("line", "says"),
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
def test_a_check_names_each_mistake_with_its_key(tmp_path, line, says):
    path = tmp_path / "hubodo.toml"
    path.write_text(f"[record]\n{line}\n")
    done = hubodo("config", "check", path)
    assert done.code == 2
    assert says in done.err
    assert "\n" not in done.err.strip()


def test_the_same_bounds_hold_on_the_command_line(tmp_path):
    done = hubodo("record", "/dev/nope", "-o", tmp_path / "x.mcap", "--rotate-after", "0")
    assert (done.code, "--rotate-after: 0: write a number above 0" in done.err) == (2, True)
