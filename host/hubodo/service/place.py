"""Where the files of the service belong, and the commands that make the computer take note of them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hubodo.atomic_files import write_atomically
from hubodo.errors import HubodoError, InputError
from hubodo.ingest.live.record_config import load_record_config
from hubodo.service import rules, unit


@dataclass(frozen=True)
class Place:
    """Of the system, or of one user. root: in front of every path, for the files of another system."""

    user: bool = False
    root: Path | None = None

    @property
    def unit(self) -> Path:
        """The unit's file."""
        return (
            self._at(self._config_home() / "systemd/user" if self.user else Path("/etc/systemd/system"))
            / unit.NAME
        )

    @property
    def rules(self) -> Path | None:
        """The rules' file; a user has none."""
        return None if self.user else self._at(Path("/etc/udev/rules.d")) / rules.NAME

    @property
    def config(self) -> Path:
        """The settings' file."""
        return self._at(self._config_home() / "hubodo" if self.user else Path("/etc/hubodo")) / "hubodo.toml"

    @property
    def logs(self) -> str:
        """Where the logs will be, in words."""
        return "hubodo in the user's state folder" if self.user else "/var/lib/hubodo"

    def running(self, path: Path) -> Path:
        """A path as the running system will see it."""
        return path if self.root is None else Path("/") / path.relative_to(self.root)

    def systemctl(self, *words: str) -> tuple[str, ...]:
        """The command."""
        return ("systemctl", *(("--user",) if self.user else ()), *words)

    def commands(self) -> list[tuple[str, ...]]:
        """After an installation."""
        listen = [self.systemctl("daemon-reload"), self.systemctl("enable", "--now", unit.NAME)]
        devices = [("udevadm", "control", "--reload"), ("udevadm", "trigger", "--subsystem-match=tty")]
        return listen if self.user else devices + listen

    def _at(self, path: Path) -> Path:
        return path if self.root is None else self.root / path.relative_to("/")

    def _config_home(self) -> Path:
        return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config")


def planned(place: Place, config: Path | None, program: Path | None) -> dict[Path, str]:
    """The files of an installation, by path. config: a hubodo.toml to be taken over, with what it names.

    Raises ConfigError where it is not right, InputError without one.
    """
    files: dict[Path, str] = {}
    if config is not None:
        settings = load_record_config(config)
        if not settings.ports and settings.gnss is None:
            raise InputError(f"{config}: names no port; add ports to its [record]")
        files[place.config] = config.read_text("utf-8")
        for named in (settings.vehicle, settings.calibration):
            if named is not None and not Path(named).is_absolute():
                files[place.config.parent / named] = _text(config.parent / named)
    elif not place.config.exists():
        raise InputError(
            f"{place.config} is not there yet; give --config FILE (hubodo config example > FILE is a start)"
        )
    where = place.running(place.config)
    files[place.unit] = unit.unit_text(program or this_program(), where, user=place.user)
    if place.rules is not None:
        files[place.rules] = rules.rules_text()
    return files


def write(files: dict[Path, str]) -> None:
    """Puts them in place, each whole or not at all. Raises InputError without the right to."""
    for path, text in files.items():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, text)
        except PermissionError:
            raise InputError(
                f"{path}: no permission; use sudo, or --user for a service of yours alone"
            ) from None


def remove(paths: Sequence[Path]) -> None:
    """Takes files away. Raises InputError without the right to."""
    for path in paths:
        try:
            path.unlink()
        except PermissionError:
            raise InputError(
                f"{path}: no permission; use sudo, or --user for a service of yours alone"
            ) from None


def check_systemd() -> None:
    """Raises InputError where this computer is not run by systemd."""
    if shutil.which("systemctl") is None or not Path("/run/systemd/system").is_dir():
        raise InputError(
            "this computer is not run by systemd; let whatever starts programs here run "
            "`hubodo record --config hubodo.toml --wait -o FOLDER`, which behaves the same, "
            "or prepare another system's files with --root DIR"
        )


def run(commands: Sequence[tuple[str, ...]]) -> None:
    """Raises HubodoError at the first that fails; one that is not there, as udevadm at times, is left out."""
    for command in commands:
        if shutil.which(command[0]) is None:
            continue
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            why = (done.stderr or done.stdout).strip() or f"exit code {done.returncode}"
            raise HubodoError(f"{' '.join(command)}: {why}")


def this_program() -> Path:
    """The command `hubodo` that belongs to the Python that runs."""
    beside = Path(sys.executable).parent / "hubodo"
    found = beside if beside.exists() else shutil.which("hubodo")
    if found is None:
        raise InputError("the command hubodo is not found; give its path with --program")
    return Path(found)


def out_of_reach(program: Path) -> Path | None:
    """The folder above a program that only its owner may enter, which a user made for the service is not."""
    real = [folder for path in (program, program.resolve()) for folder in path.parents]
    return next((folder for folder in real if folder.is_dir() and not folder.stat().st_mode & 0o001), None)


def _text(path: Path) -> str:
    try:
        return path.read_text("utf-8")
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; hubodo.toml names it") from None
