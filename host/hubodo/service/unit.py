"""The text of the systemd unit: what the recorder may do, and when it is started again."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

NAME = "hubodo.service"
_HOMES = ("/home/", "/root/", "/run/user/")

_HEAD = """\
# Written by `hubodo service install`; changes belong into a drop-in: systemctl edit hubodo
[Unit]
Description=hubodo: recorder of wheel nodes
Wants=time-set.target time-sync.target
# Not after time-sync.target, which systemd-time-wait-sync holds back for ever where there is no network.
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
# Enough for its ports, logs and visitors; each server of the recorder bounds its connections by itself.
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
# Unix sockets to tell systemd how it fares; the others for socket:// and udp://, and for metrics.
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6
SystemCallArchitectures=native
SystemCallFilter=@system-service
SystemCallFilter=~@privileged @resources
SystemCallErrorNumber=EPERM
# Serial ports and nothing else; PrivateDevices= would hide them.
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
    """The unit. program: the command `hubodo`; user: for the service manager of a user, with fewer fences."""
    head = _HEAD.format(program=_quoted(program), config=_quoted(config))
    if user:
        return f"{head}{_USER_SANDBOX}\n[Install]\nWantedBy=default.target\n"
    home = "read-only" if f"{program}/".startswith(_HOMES) else "yes"
    return f"{head}{_SANDBOX.format(home=home)}\n[Install]\nWantedBy=multi-user.target\n"


def exposure(text: str) -> float | None:
    """What `systemd-analyze security` makes of a unit, 0 safe to 10; None where it cannot say."""
    with tempfile.TemporaryDirectory(prefix="hubodo-") as folder:
        path = Path(folder) / NAME
        path.write_text(text, "utf-8")
        try:
            done = subprocess.run(
                ["systemd-analyze", "security", "--offline=true", "--no-pager", str(path)],
                capture_output=True,
                text=True,
                timeout=30,
            )
        except (OSError, subprocess.TimeoutExpired):
            return None
    _, found, rest = done.stdout.partition("Overall exposure level for ")
    words = rest.partition(":")[2].split()
    return float(words[0]) if found and words else None


def _quoted(path: Path) -> str:
    text = str(path).replace("%", "%%").replace("\\", "\\\\").replace('"', '\\"').replace("$", "$$")
    return f'"{text}"' if " " in text or '"' in text else text
