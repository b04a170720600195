"""`hubodo service`: run the recorder as a systemd service."""

from __future__ import annotations

import argparse
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from hubodo.service import installation, systemd_unit
from hubodo.service.installation import ServiceLocation

EXAMPLE = "sudo hubodo service install --config hubodo.toml"
_STATUS_PROPERTIES = (
    "ActiveState",
    "SubState",
    "StatusText",
    "MainPID",
    "NRestarts",
    "MemoryCurrent",
    "ActiveEnterTimestamp",
)


@dataclass(frozen=True)
class ServiceChange:
    """The changes of an installation or removal; with `dry` they were only planned.

    Attributes
    ----------
    files
        Content by path, None for a removed file.
    commands
        Commands that were run.
    warnings
        One line each.
    exposure
        Rating of the unit by systemd-analyze security, 0 (safe) to 10, or None.
    is_dry_run
        True if nothing was changed.
    closing_line
        Closing line for the terminal.
    """

    files: dict[str, str | None]
    commands: tuple[str, ...]
    warnings: tuple[str, ...]
    exposure: float | None
    is_dry_run: bool
    closing_line: str

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result."""
        return {
            "files": self.files,
            "commands": list(self.commands),
            "warnings": list(self.warnings),
            "exposure": self.exposure,
            "dry_run": self.is_dry_run,
        }

    def render(self, console: Console) -> None:
        """Print files, commands, exposure and warnings."""

        def print_line(text: str) -> None:
            console.print(text, highlight=False, markup=False, soft_wrap=True)

        would = "would " if self.is_dry_run else ""
        for path, text in self.files.items():
            print_line(f"{would}{'remove' if text is None else 'write'} {path}")
            if self.is_dry_run and text is not None:
                print_line("\n".join(f"    {line}" for line in text.splitlines()))
        for command in self.commands:
            print_line(f"{would}run {command}")
        if self.exposure is not None:
            print_line(f"exposure by systemd-analyze security: {self.exposure:.1f} of 10")
        for line in self.warnings:
            print_line(f"warning: {line}")
        if not self.is_dry_run:
            print_line(self.closing_line)


@dataclass(frozen=True)
class ServiceState:
    """The state of the service, as properties of systemd."""

    values: dict[str, str]

    @property
    def failed(self) -> bool:
        """Return True if the service is not active."""
        return self.values.get("ActiveState") != "active"

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result."""
        return self.values

    def render(self, console: Console) -> None:
        """Print state, process, restarts and memory."""
        now = self.values
        lines = [f"{systemd_unit.UNIT_NAME}: {now.get('ActiveState')} ({now.get('SubState')})"]
        if now.get("ActiveEnterTimestamp"):
            lines[0] += f" since {now['ActiveEnterTimestamp']}"
        lines += [now["StatusText"]] if now.get("StatusText") else []
        lines.append(f"process {now.get('MainPID')}, restarted {now.get('NRestarts')} times")
        if now.get("MemoryCurrent", "").isdigit():
            lines[-1] += f", {int(now['MemoryCurrent']) / 1e6:.0f} MB"
        lines.append("its messages: journalctl -u hubodo")
        for line in lines:
            console.print(line, highlight=False, markup=False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo service`."""
    parser.add_argument(
        "does",
        metavar="ACTION",
        choices=("install", "status", "uninstall"),
        help="install: write unit, udev rules and settings, and start; status: show state and health; "
        "uninstall: stop and remove; settings and logs are kept",
    )
    parser.add_argument("--config", type=Path, metavar="TOML", help="hubodo.toml to install")
    parser.add_argument(
        "--program", type=Path, metavar="PATH", help="path of the hubodo command (default: this one)"
    )
    parser.add_argument("--user", action="store_true", help="install for this user only, without root")
    parser.add_argument(
        "--root",
        type=Path,
        metavar="DIR",
        help="root folder of another system, such as a mounted image; nothing is run",
    )
    parser.add_argument("--dry-run", action="store_true", help="only show the changes")


def run(args: argparse.Namespace) -> ServiceChange | ServiceState:
    """Install, remove or query the service.

    Returns
    -------
    ServiceChange or ServiceState
        The changed files and the commands that were run, or the state of the service.

    Raises
    ------
    InputError
        If this computer does not run systemd, or a setting is missing.
    """
    location = ServiceLocation(args.user, args.root.absolute() if args.root is not None else None)
    files_only = args.dry_run or args.root is not None
    if not files_only:
        installation.check_systemd()
    if args.does == "status":
        installation.check_systemd()
        return _query_state(location)
    return (
        _install(args, location, files_only)
        if args.does == "install"
        else _uninstall(location, files_only, args.dry_run)
    )


def _install(args: argparse.Namespace, location: ServiceLocation, files_only: bool) -> ServiceChange:
    program = args.program or installation.find_program()
    files = installation.plan_files(location, args.config, program)
    warnings = []
    private_folder = None if location.is_user_service else installation.inaccessible_parent(program)
    if private_folder is not None:
        warnings.append(
            f"{program} is below {private_folder}, which only its owner may enter: the service runs as "
            "its own user and will not start; install hubodo below /opt, for example, or use --user"
        )
    commands = location.activation_commands()
    if not args.dry_run:
        installation.write_files(files)
    if not files_only:
        installation.run_commands(commands)
    user_option = " --user" if location.is_user_service else ""
    return ServiceChange(
        {str(path): text for path, text in files.items()},
        () if args.root is not None else tuple(map(" ".join, commands)),
        tuple(warnings),
        systemd_unit.rate_exposure(files[location.unit]),
        args.dry_run,
        f"recording into {location.log_folder_text}; status: hubodo service status{user_option}",
    )


def _uninstall(location: ServiceLocation, files_only: bool, is_dry_run: bool) -> ServiceChange:
    present = [path for path in (location.unit, location.rules) if path is not None and path.exists()]
    commands = (
        [location.systemctl("disable", "--now", systemd_unit.UNIT_NAME)] if location.unit.exists() else []
    )
    if not files_only:
        installation.run_commands(commands)
    if not is_dry_run:
        installation.remove_files(present)
    after = [location.systemctl("daemon-reload")]
    if not files_only:
        installation.run_commands(after)
    return ServiceChange(
        {str(path): None for path in present},
        () if location.root is not None else tuple(map(" ".join, commands + after)),
        (),
        None,
        is_dry_run,
        f"removed; settings in {location.config.parent} and logs in {location.log_folder_text} are kept",
    )


def _query_state(location: ServiceLocation) -> ServiceState:
    shown = subprocess.run(
        location.systemctl("show", systemd_unit.UNIT_NAME, f"--property={','.join(_STATUS_PROPERTIES)}"),
        capture_output=True,
        text=True,
    )
    pairs = (line.partition("=") for line in shown.stdout.splitlines())
    return ServiceState({key: value for key, _, value in pairs})
