"""`hubodo service`: the recorder from the start of the computer to its end."""

from __future__ import annotations

import argparse
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from hubodo.service import place, unit
from hubodo.service.place import Place

EXAMPLE = "sudo hubodo service install --config hubodo.toml"
_SHOWN = (
    "ActiveState",
    "SubState",
    "StatusText",
    "MainPID",
    "NRestarts",
    "MemoryCurrent",
    "ActiveEnterTimestamp",
)


@dataclass(frozen=True)
class Placed:
    """What was done, or with `dry` would be: files by path, None where one is removed; commands; warnings.

    exposure: of the unit by systemd-analyze, 0 to 10, None where it cannot say.
    """

    files: dict[str, str | None]
    commands: tuple[str, ...]
    warnings: tuple[str, ...]
    exposure: float | None
    dry: bool
    says: str

    def as_json(self) -> dict[str, Any]:
        return {
            "files": self.files,
            "commands": list(self.commands),
            "warnings": list(self.warnings),
            "exposure": self.exposure,
            "dry_run": self.dry,
        }

    def render(self, console: Console) -> None:
        def say(text: str) -> None:
            console.print(text, highlight=False, markup=False, soft_wrap=True)

        would = "would " if self.dry else ""
        for path, text in self.files.items():
            say(f"{would}{'remove' if text is None else 'write'} {path}")
            if self.dry and text is not None:
                say("\n".join(f"    {line}" for line in text.splitlines()))
        for command in self.commands:
            say(f"{would}run {command}")
        if self.exposure is not None:
            say(f"exposure by systemd-analyze security: {self.exposure:.1f} of 10")
        for line in self.warnings:
            say(f"warning: {line}")
        if not self.dry:
            say(self.says)


@dataclass(frozen=True)
class ServiceState:
    """What systemd knows of the service, by its own names."""

    values: dict[str, str]

    @property
    def failed(self) -> bool:
        return self.values.get("ActiveState") != "active"

    def as_json(self) -> dict[str, Any]:
        return self.values

    def render(self, console: Console) -> None:
        now = self.values
        lines = [f"{unit.NAME}: {now.get('ActiveState')} ({now.get('SubState')})"]
        if now.get("ActiveEnterTimestamp"):
            lines[0] += f" since {now['ActiveEnterTimestamp']}"
        lines += [now["StatusText"]] if now.get("StatusText") else []
        lines.append(f"process {now.get('MainPID')}, started again {now.get('NRestarts')} times")
        if now.get("MemoryCurrent", "").isdigit():
            lines[-1] += f", {int(now['MemoryCurrent']) / 1e6:.0f} MB"
        lines.append("its messages: journalctl -u hubodo")
        for line in lines:
            console.print(line, highlight=False, markup=False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What to do, where, and with which settings."""
    parser.add_argument(
        "does",
        choices=("install", "status", "uninstall"),
        help="install: put unit, udev rules and settings in place and start; status: whether it runs and how "
        "it fares; uninstall: stop and remove, settings and logs stay",
    )
    parser.add_argument("--config", type=Path, metavar="TOML", help="hubodo.toml to be installed with it")
    parser.add_argument("--program", type=Path, metavar="PATH", help="the command hubodo (default: this one)")
    parser.add_argument("--user", action="store_true", help="a service of this user alone, without root")
    parser.add_argument(
        "--root",
        type=Path,
        metavar="DIR",
        help="the files of another system, such as a mounted image; runs nothing",
    )
    parser.add_argument("--dry-run", action="store_true", help="only show what would be done")


def run(args: argparse.Namespace) -> Placed | ServiceState:
    """Does what is asked for."""
    where = Place(args.user, args.root.absolute() if args.root is not None else None)
    quiet = args.dry_run or args.root is not None
    if not quiet:
        place.check_systemd()
    if args.does == "status":
        place.check_systemd()
        return _state(where)
    return _install(args, where, quiet) if args.does == "install" else _uninstall(where, quiet, args.dry_run)


def _install(args: argparse.Namespace, where: Place, quiet: bool) -> Placed:
    program = args.program or place.this_program()
    files = place.planned(where, args.config, program)
    warnings = []
    closed = None if where.user else place.out_of_reach(program)
    if closed is not None:
        warnings.append(
            f"{program} lies below {closed}, which only its owner may enter: the service runs as a user of "
            "its own and will not start; install hubodo where all may read it, such as /opt/hubodo, or --user"
        )
    commands = where.commands()
    if not args.dry_run:
        place.write(files)
    if not quiet:
        place.run(commands)
    return Placed(
        {str(path): text for path, text in files.items()},
        () if args.root is not None else tuple(map(" ".join, commands)),
        tuple(warnings),
        unit.exposure(files[where.unit]),
        args.dry_run,
        f"recording into {where.logs}; how it fares: hubodo service status{' --user' if where.user else ''}",
    )


def _uninstall(where: Place, quiet: bool, dry: bool) -> Placed:
    present = [path for path in (where.unit, where.rules) if path is not None and path.exists()]
    commands = [where.systemctl("disable", "--now", unit.NAME)] if where.unit.exists() else []
    if not quiet:
        place.run(commands)
    if not dry:
        place.remove(present)
    after = [where.systemctl("daemon-reload")]
    if not quiet:
        place.run(after)
    return Placed(
        {str(path): None for path in present},
        () if where.root is not None else tuple(map(" ".join, commands + after)),
        (),
        None,
        dry,
        f"removed; settings in {where.config.parent} and logs in {where.logs} are left",
    )


def _state(where: Place) -> ServiceState:
    shown = subprocess.run(
        where.systemctl("show", unit.NAME, f"--property={','.join(_SHOWN)}"), capture_output=True, text=True
    )
    pairs = (line.partition("=") for line in shown.stdout.splitlines())
    return ServiceState({key: value for key, _, value in pairs})
