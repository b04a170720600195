"""Installation of the service: paths of its files, and the commands that activate them."""

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
from hubodo.service import systemd_unit, udev_rules


@dataclass(frozen=True)
class ServiceLocation:
    """The locations of the service's files.

    Attributes
    ----------
    is_user_service
        True for a service of one user, False for one of the system.
    root
        Root folder of another system whose files are written; None for this one.
    """

    is_user_service: bool = False
    root: Path | None = None

    @property
    def unit(self) -> Path:
        """Path of the systemd unit."""
        return (
            self._at(
                self._config_home() / "systemd/user" if self.is_user_service else Path("/etc/systemd/system")
            )
            / systemd_unit.UNIT_NAME
        )

    @property
    def rules(self) -> Path | None:
        """Path of the udev rules; None for a user service."""
        return (
            None if self.is_user_service else self._at(Path("/etc/udev/rules.d")) / udev_rules.RULES_FILE_NAME
        )

    @property
    def config(self) -> Path:
        """Path of hubodo.toml."""
        return (
            self._at(self._config_home() / "hubodo" if self.is_user_service else Path("/etc/hubodo"))
            / "hubodo.toml"
        )

    @property
    def log_folder_text(self) -> str:
        """Description of the log folder."""
        return "hubodo in the user's state folder" if self.is_user_service else "/var/lib/hubodo"

    def path_on_target(self, path: Path) -> Path:
        """Return a path as seen by the system that will run the service."""
        return path if self.root is None else Path("/") / path.relative_to(self.root)

    def systemctl(self, *arguments: str) -> tuple[str, ...]:
        """Return a systemctl command line."""
        return ("systemctl", *(("--user",) if self.is_user_service else ()), *arguments)

    def activation_commands(self) -> list[tuple[str, ...]]:
        """Return the commands to run after the files are installed."""
        start = [self.systemctl("daemon-reload"), self.systemctl("enable", "--now", systemd_unit.UNIT_NAME)]
        devices = [("udevadm", "control", "--reload"), ("udevadm", "trigger", "--subsystem-match=tty")]
        return start if self.is_user_service else devices + start

    def _at(self, path: Path) -> Path:
        return path if self.root is None else self.root / path.relative_to("/")

    def _config_home(self) -> Path:
        return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config")


def plan_files(location: ServiceLocation, config: Path | None, program: Path | None) -> dict[Path, str]:
    """Return the content of the files of an installation, by path.

    config: a hubodo.toml to install together with the files it names. Raises ConfigError if it is invalid,
    InputError if there is none.
    """
    files: dict[Path, str] = {}
    if config is not None:
        settings = load_record_config(config)
        if not settings.ports and settings.gnss is None:
            raise InputError(f"{config}: has no port; add ports to its [record]")
        files[location.config] = config.read_text("utf-8")
        for file in (settings.vehicle, settings.calibration):
            if file is not None and not Path(file).is_absolute():
                files[location.config.parent / file] = _read_text(config.parent / file)
    elif not location.config.exists():
        raise InputError(
            f"{location.config} does not exist; give --config FILE (start with hubodo config example > FILE)"
        )
    config_path = location.path_on_target(location.config)
    files[location.unit] = systemd_unit.unit_text(
        program or find_program(), config_path, user=location.is_user_service
    )
    if location.rules is not None:
        files[location.rules] = udev_rules.rules_text()
    return files


def write_files(files: dict[Path, str]) -> None:
    """Write the files, each atomically; raise InputError without permission."""
    for path, text in files.items():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, text)
        except PermissionError:
            raise InputError(
                f"{path}: no permission; use sudo, or --user for a service of this user"
            ) from None


def remove_files(paths: Sequence[Path]) -> None:
    """Delete the files; raise InputError without permission."""
    for path in paths:
        try:
            path.unlink()
        except PermissionError:
            raise InputError(
                f"{path}: no permission; use sudo, or --user for a service of this user"
            ) from None


def check_systemd() -> None:
    """Raise InputError if this computer is not run by systemd."""
    if shutil.which("systemctl") is None or not Path("/run/systemd/system").is_dir():
        raise InputError(
            "this computer is not run by systemd; let whatever starts programs here run "
            "`hubodo record --config hubodo.toml --wait -o FOLDER`, which behaves the same, "
            "or prepare another system's files with --root DIR"
        )


def run_commands(commands: Sequence[tuple[str, ...]]) -> None:
    """Run the commands and raise HubodoError at the first failure; missing programs are skipped."""
    for command in commands:
        if shutil.which(command[0]) is None:
            continue
        result = subprocess.run(command, capture_output=True, text=True)
        if result.returncode:
            reason = (result.stderr or result.stdout).strip() or f"exit code {result.returncode}"
            raise HubodoError(f"{' '.join(command)}: {reason}")


def find_program() -> Path:
    """Return the path of the `hubodo` command that belongs to this Python."""
    candidate = Path(sys.executable).parent / "hubodo"
    program = candidate if candidate.exists() else shutil.which("hubodo")
    if program is None:
        raise InputError("the command hubodo was not found; give its path with --program")
    return Path(program)


def inaccessible_parent(program: Path) -> Path | None:
    """Return a parent folder that only its owner may enter, where the service could not start, or None."""
    parents = [folder for path in (program, program.resolve()) for folder in path.parents]
    return next((folder for folder in parents if folder.is_dir() and not folder.stat().st_mode & 0o001), None)


def _read_text(path: Path) -> str:
    try:
        return path.read_text("utf-8")
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; hubodo.toml names it") from None
