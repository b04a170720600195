"""Installation of firmware and settings over Wi-Fi or Bluetooth, and the return to the previous firmware."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hubodo.errors import InputError
from hubodo.flash.image import ARCHITECTURES, build_image, hash_files
from hubodo.flash.install import RolledBackBoard
from hubodo.flash.manifest import add_manifest
from hubodo.flash.order import CONFIG
from hubodo.flash.prompt import FlashError
from hubodo.flash.slots import MAIN, SLOTS, main_for_slot
from hubodo.ingest.link.ports import BLE_KIND, PortName
from hubodo.ingest.node.conversation import Conversation
from hubodo.safe_text import json_text
from hubowire.budget import UART_BAUD
from hubowire.messages import (
    UPDATE_START_SELECT,
    Hello,
    UpdatePiece,
    UpdateStart,
    UpdateState,
    UpdateStatus,
)

_UPDATE_BYTES = 235
"""Data of a piece: the largest frame that fits a datagram."""
_BLE_UPDATE_BYTES = 100
"""Data of a piece by Bluetooth: a sealed packet of 133 bytes, for an MTU of 136 or more."""
_STATE_TIMEOUT_S = 0.4
_SILENCE_TIMEOUT_S = 30.0
"""Longest silence; a node hashes its files in up to 2 s, and joins its network again in up to 20 s."""
_RESTART_TIMEOUT_S = 180.0
"""A node that is not reached for 120 s after its restart returns to its old firmware (`radio/trial.py`)."""
_QUERY_PERIOD_S = 0.5
_QUERY = UpdateStart(0, 0, bytes(32))
_KEY_ADVICE = "is the key file that of the node?"
_CABLE_SETTINGS = {
    "node_id": "use `hubodo node PORT set node_id=N`",
    "key": "packets are authenticated, not secret: set it by USB",
    "password": "packets are authenticated, not secret: set it by USB",
    "link": "set it by USB",
}
_MAX_RESTARTS = 10
_REFUSALS = {
    UpdateStatus.NO_KEY: "the node has no key, and takes no firmware from strangers; flash it by USB with "
    "--key-file once",
    UpdateStatus.CABLE_ONLY: "its firmware is not in two slots, or it is a receiver; flash it by USB",
    UpdateStatus.DAMAGED: "a file differs from what was sent, as read back from its flash; the old firmware "
    "runs; flash it again, or by USB",
    UpdateStatus.NO_OTHER: "no complete older firmware to roll back to",
    UpdateStatus.NOT_STORED: "its flash is full or cannot be written; the old firmware runs; flash it by USB",
}


@dataclass(frozen=True)
class UpdatedNode:
    """The state of a node after an update.

    Attributes
    ----------
    port
        Port as given.
    node, hello
        Id and identification of the running node.
    files
        Number of files of the firmware.
    sent
        Names of the files that were sent; the node copied or had the others.
    n_repeated
        Number of requests that were repeated, as no answer came in time.
    seconds
        Duration, s.
    """

    port: str
    node: int
    hello: Hello
    files: int
    sent: tuple[str, ...]
    n_repeated: int
    seconds: float

    def as_json(self) -> dict[str, Any]:
        """Return the JSON form."""
        return {
            "port": self.port,
            "node": self.node,
            "firmware": ".".join(map(str, self.hello.firmware)),
            "fingerprint": f"{self.hello.fingerprint:08x}",
            "serial": self.hello.serial.hex(),
            "files": self.files,
            "copied": list(self.sent),
            "repeated": self.n_repeated,
            "seconds": round(self.seconds, 2),
        }


class _Package:
    """The list of files for one slot and the files, by number."""

    def __init__(self, image: dict[str, bytes], slot: int, settings: Mapping[str, object]) -> None:
        files = {name: content for name, content in image.items() if name != MAIN}
        if settings:
            files[CONFIG] = json_text(settings).encode()
        files[MAIN] = main_for_slot(image[MAIN], SLOTS[slot])
        hashes = hash_files(files)
        self.names = ["the list of files", *files]
        lines = [f"{hashes[name]} {len(content)} {name}\n" for name, content in files.items()]
        self.contents = ["".join(lines).encode(), *files.values()]
        self.start = UpdateStart(slot, len(self.contents[0]), hashlib.sha256(self.contents[0]).digest())

    def piece(self, state: UpdateState, size: int) -> UpdatePiece | None:
        """Return the piece that a node awaits; None if it has another list of files."""
        if state.file >= len(self.contents):
            return None
        data = self.contents[state.file][state.offset : state.offset + size]
        return UpdatePiece(state.file, state.offset, tuple((byte,) for byte in data)) if data else None


def update_over_air(
    port: PortName,
    node_id: int | None,
    folder: Path,
    settings: Mapping[str, object],
    report_progress: Callable[[str], None],
) -> UpdatedNode:
    """Install the firmware of `folder` on a node by its own link, and change the given settings.

    node_id: the node where several send to the port, None for the only one. Raises FlashError, ImageError,
    LinkError, and InputError where several nodes are present, or for a setting that needs a cable.
    """
    for name, advice in _CABLE_SETTINGS.items():
        if name in settings:
            raise InputError(f"--set {name}: not over Wi-Fi or Bluetooth; {advice}")
    started = time.monotonic()
    with Conversation(port, UART_BAUD, node_id) as node:
        report_progress(f"{port.text}: waiting for the node")
        node.any_version = True
        node.find()
        update = _Update(node, port, folder, settings, report_progress)
        update.run()
        report_progress(f"{port.text}: starting")
        _wait_for_slot(node, port, update.package.start.slot)
        node.any_version = False
        hello = node.identify()
        assert node.node_id is not None
        return UpdatedNode(
            port.text,
            node.node_id,
            hello,
            len(update.package.contents) - 1,
            tuple(update.package.names[k] for k in sorted(update.sent) if k),
            update.n_repeated,
            time.monotonic() - started,
        )


def roll_back_over_air(
    port: PortName, node_id: int | None, report_progress: Callable[[str], None]
) -> RolledBackBoard:
    """Start the previous firmware of a node by its own link. Raises FlashError, LinkError and InputError."""
    with Conversation(port, UART_BAUD, node_id) as node:
        report_progress(f"{port.text}: waiting for the node")
        node.any_version = True
        node.find()
        assert node.node_id is not None
        state = _request_state(node, port, _QUERY, _KEY_ADVICE)
        # A node that already runs the slot ignores the request.
        select = UpdateStart(state.slot, UPDATE_START_SELECT, bytes(32))
        _request_state(node, port, select, "the present firmware stays")
        report_progress(f"{port.text}: starting")
        _wait_for_slot(node, port, state.slot)
        return RolledBackBoard(port.text, node.node_id, *node.wait_identity(_SILENCE_TIMEOUT_S))


class _Update:
    """One update: one piece is on its way at a time, and is repeated until the node has answered."""

    def __init__(
        self,
        node: Conversation,
        port: PortName,
        folder: Path,
        settings: Mapping[str, object],
        report_progress: Callable[[str], None],
    ) -> None:
        self._node, self._port, self._report_progress = node, port, report_progress
        self._piece_bytes = _BLE_UPDATE_BYTES if port.kind == BLE_KIND else _UPDATE_BYTES
        self.sent: set[int] = set()
        self.n_repeated = 0
        state = _request_state(node, port, _QUERY, _KEY_ADVICE)
        number = state.mpy >> 10 & 0x3F
        architecture = ARCHITECTURES[number] if number < len(ARCHITECTURES) else None
        report_progress(f"{port.text}: compiling for {architecture or 'bytecode'}")
        self.package = _Package(add_manifest(build_image(folder, architecture)), state.slot, settings)

    def run(self) -> None:
        """Send what the node awaits until every file is verified."""
        message: UpdateStart | UpdatePiece | None = self.package.start
        acted_on = (-1, -1)
        answered, furthest, n_restarts = time.monotonic(), 0, 0
        while True:
            state = self._node.ask(message, _STATE_TIMEOUT_S, _is_after(acted_on))
            if state is None:
                if time.monotonic() - answered > _SILENCE_TIMEOUT_S:
                    raise FlashError(
                        f"{self._port.text}: no answer for {_SILENCE_TIMEOUT_S:.0f} s; the old firmware "
                        "stays; flash again to continue"
                    )
                self.n_repeated += message is not None
                # Whatever was lost, the answer tells the present state, also after a restart of the node.
                message, acted_on = self.package.start, (-1, -1)
                continue
            answered = time.monotonic()
            if state.slot != self.package.start.slot or state.status == UpdateStatus.COMPLETE:
                return
            _raise_refusal(self._port, state)
            acted_on, message = _position(state), None
            name = self.package.names[min(state.file, len(self.package.names) - 1)]
            total = len(self.package.contents) - 1
            self._report_progress(
                f"{self._port.text}: {state.file} of {total} files: {name}, {state.offset} B"
            )
            if state.status == UpdateStatus.WAITING:
                message = self.package.piece(state, self._piece_bytes)
                self.sent.add(state.file)
            n_restarts += state.file < furthest
            furthest = state.file
            if n_restarts > _MAX_RESTARTS:
                raise FlashError(
                    f"{self._port.text}: the update began again {n_restarts} times; is the supply of the "
                    "node stable, and no other computer flashing it? The old firmware stays"
                )


def _wait_for_slot(node: Conversation, port: PortName, slot: int) -> None:
    """Return once the node runs a slot; raise FlashError if it runs the other one, or nothing."""
    end = time.monotonic() + _RESTART_TIMEOUT_S
    while time.monotonic() < end:
        state = node.ask(_QUERY, _QUERY_PERIOD_S)
        # The slot of a state is the one that does not run.
        if state is not None and state.slot != slot:
            return
        if state is not None and state.status == UpdateStatus.IDLE:
            raise FlashError(
                f"{port.text}: the new firmware did not start, or did not reach this computer; the old one "
                "runs again, with its settings; see the node's console"
            )
    raise FlashError(
        f"{port.text}: the update is complete, but neither the new firmware nor the old one is reached; is "
        "the network up? Otherwise flash the node by USB"
    )


def _request_state(node: Conversation, port: PortName, request: UpdateStart, advice: str) -> UpdateState:
    """Repeat a request until the node answers; return its state. Raise FlashError if it does not, or refuses.

    advice: what to do without an answer.
    """
    end = time.monotonic() + _SILENCE_TIMEOUT_S
    while time.monotonic() < end:
        state = node.ask(request, _STATE_TIMEOUT_S)
        if state is not None:
            _raise_refusal(port, state)
            return state
    raise FlashError(f"{port.text}: no answer for {_SILENCE_TIMEOUT_S:.0f} s; {advice}")


def _raise_refusal(port: PortName, state: UpdateState) -> None:
    if state.status > UpdateStatus.COMPLETE:
        known = state.status in set(UpdateStatus)
        text = _REFUSALS[UpdateStatus(state.status)] if known else f"status {state.status}, unknown here"
        raise FlashError(f"{port.text}: {text}")


def _position(state: UpdateState) -> tuple[int, int]:
    """Return what grows during an update; a file that is checked follows its last piece."""
    return state.file, 2 * state.offset + (state.status == UpdateStatus.WAITING)


def _is_after(position: tuple[int, int]) -> Callable[[UpdateState], bool]:
    """Return a condition for states after a position: others were sent twice, or overtaken."""
    return lambda state: state.status >= UpdateStatus.COMPLETE or _position(state) > position
