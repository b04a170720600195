"""The text of the systemd unit, with its sandbox and restart policy."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

UNIT_NAME = "hubodo.service"
_HOME_FOLDERS = ("/home/", "/root/", "/run/user/")

_UNIT_HEADER = """\
# Written by `hubodo service install`; changes belong into a drop-in: systemctl edit hubodo
[Unit]
Description=hubodo: recorder of wheel nodes
Wants=time-set.target time-sync.target
# Not after time-sync.target, which is never reached without a network under systemd-time-wait-sync.
After=local-fs.target time-set.target
StartLimitIntervalSec=0

[Service]
Type=notify
NotifyAccess=main
ExecStart={program} record --config {config} --wait -o ${{STATE_DIRECTORY}}
ExecReload=/bin/kill -HUP $MAINPID
WatchdogSec=30
Restart=on-failure
RestartSec=2
RestartPreventExitStatus=2
TimeoutStopSec=10
StateDirectory=hubodo
# Enough for ports, logs and web clients; each server of the recorder limits its own connections.
LimitNOFILE=4096
Environment=OPENBLAS_NUM_THREADS=1 PYTHONUNBUFFERED=1
"""

_SANDBOX = """
DynamicUser=yes
SupplementaryGroups=dialout
UMask=0027
NoNewPrivileges=yes
CapabilityBoundingSet=
AmbientCapabilities=
ProtectSystem=strict
ProtectHome={home}
PrivateTmp=yes
ProtectProc=invisible
ProcSubset=pid
ProtectClock=yes
ProtectHostname=yes
ProtectKernelTunables=yes
ProtectKernelModules=yes
ProtectKernelLogs=yes
ProtectControlGroups=yes
RemoveIPC=yes
KeyringMode=private
LockPersonality=yes
RestrictRealtime=yes
RestrictSUIDSGID=yes
RestrictNamespaces=yes
# Unix sockets for notifications to systemd; the others for socket://, udp:// and metrics.
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6
SystemCallArchitectures=native
SystemCallFilter=@system-service
SystemCallFilter=~@privileged @resources
SystemCallErrorNumber=EPERM
# Serial ports only; PrivateDevices= would hide them.
DevicePolicy=closed
DeviceAllow=char-ttyACM rw
DeviceAllow=char-ttyUSB rw
DeviceAllow=char-ttyAMA rw
DeviceAllow=char-ttyS rw
"""

_USER_SANDBOX = """
NoNewPrivileges=yes
LockPersonality=yes
RestrictRealtime=yes
RestrictSUIDSGID=yes
"""


def unit_text(program: Path, config: Path, *, user: bool) -> str:
    """Return the unit for a `hubodo` program; with `user` for a user's service manager, less sandboxed."""
    head = _UNIT_HEADER.format(program=_quote_path(program), config=_quote_path(config))
    if user:
        return f"{head}{_USER_SANDBOX}\n[Install]\nWantedBy=default.target\n"
    home = "read-only" if f"{program}/".startswith(_HOME_FOLDERS) else "yes"
    return f"{head}{_SANDBOX.format(home=home)}\n[Install]\nWantedBy=multi-user.target\n"


def rate_exposure(unit: str) -> float | None:
    """Return the exposure by `systemd-analyze security`, 0 (safe) to 10, or None if not available."""
    with tempfile.TemporaryDirectory(prefix="hubodo-") as folder:
        path = Path(folder) / UNIT_NAME
        path.write_text(unit, "utf-8")
        try:
            result = subprocess.run(
                ["systemd-analyze", "security", "--offline=true", "--no-pager", str(path)],
                capture_output=True,
                text=True,
                timeout=30,
            )
        except (OSError, subprocess.TimeoutExpired):
            return None
    _, marker, rating = result.stdout.partition("Overall exposure level for ")
    words = rating.partition(":")[2].split()
    return float(words[0]) if marker and words else None


def _quote_path(path: Path) -> str:
    text = str(path).replace("%", "%%").replace("\\", "\\\\").replace('"', '\\"').replace("$", "$$")
    return f'"{text}"' if " " in text or '"' in text else text
