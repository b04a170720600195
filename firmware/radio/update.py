"""Receives firmware into the slot that does not run, verifies and selects it; loaded with UpdateStart.

The list of files, a line `sha256 size name` each, comes first, and is stored in the slot until the end: with
it an interrupted update continues with the first file that is not complete. Files that the running firmware
has are copied from it. main.py, the last of the list, is then replaced by a rename, which selects the slot
for a first start on trial (`switch.py`). A file config.json holds changes of the settings.
"""

import gc
import os
import struct
import sys
from binascii import hexlify
from hashlib import sha256
from time import ticks_add, ticks_diff, ticks_ms

from framing import PAYLOAD
from micropython import const
from wire import GET_HELLO, PING, REASON_BAD_VALUE, REASON_BUSY, REBOOT, REBOOT_MODE_RUN, TIME_REQUEST

from radio.wire_update import (
    UPDATE_PIECE,
    UPDATE_PIECE_FORMAT,
    UPDATE_PIECE_SIZE,
    UPDATE_START,
    UPDATE_START_FORMAT,
    UPDATE_START_SELECT,
    UPDATE_START_SIZE,
    UPDATE_STATE,
    UPDATE_STATE_FORMAT,
    UPDATE_STATE_SIZE,
    UPDATE_STATUS_CABLE_ONLY,
    UPDATE_STATUS_CHECKING,
    UPDATE_STATUS_COMPLETE,
    UPDATE_STATUS_DAMAGED,
    UPDATE_STATUS_IDLE,
    UPDATE_STATUS_NO_KEY,
    UPDATE_STATUS_NOT_STORED,
    UPDATE_STATUS_WAITING,
)

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_SLOTS = ("/fw_a", "/fw_b")
_LIST = "/update.txt"
_MAIN = "main.py"
_NEW_MAIN = "/main.py.new"
_IDLE_MS = const(60000)
"""Without a request for this time the node restarts with its old firmware."""
_BLOCK = const(512)


def start(node, frame):
    """Answer an UpdateStart; begin the update unless it is refused or only a query."""
    for name in ("radio", "radio.update", "radio.wire_update"):
        sys.modules.pop(name, None)
    if frame.size < UPDATE_START_SIZE:
        node.commands.nack(UPDATE_START, frame.seq, REASON_BAD_VALUE, frame.size)
        return
    update = Update(node)
    slot, size, digest = struct.unpack_from(UPDATE_START_FORMAT, frame.raw, PAYLOAD)
    if update.status == UPDATE_STATUS_IDLE and size and slot == update.slot:
        if size == UPDATE_START_SELECT:
            update.stop_sampling()
            from radio import switch

            switch.select_other(update)
        else:
            update.prepare(size, hexlify(digest))
    update.reply()


class Update:
    """One update; from `prepare` on it executes requests and duties of the node, until that restarts."""

    def __init__(self, node):
        self._node = node
        self._commands = node.commands
        running = sys.path[0]
        self.slot = 1 if running == _SLOTS[0] else 0
        self.folder = _SLOTS[self.slot]
        self.running = running
        self.status = UPDATE_STATUS_IDLE
        sealed = sys.modules.get("sealed")
        if sealed is None or not isinstance(node.link, sealed.SealedLink):
            self.status = UPDATE_STATUS_NO_KEY
        elif running not in _SLOTS or not hasattr(node, "slow"):
            # Files at the root are no fallback; a receiver has no duties to extend.
            self.status = UPDATE_STATUS_CABLE_ONLY
        self._file = self._offset = self._size = 0
        self._path = self.folder + _LIST
        self._digest = b""
        self._list_digest = b""
        self._list: Any = None
        self._out: Any = None
        self._due_ms = ticks_ms()

    def stop_sampling(self):
        """Stop sampling until the restart, and free its heap."""
        node = self._node
        node.stop()
        node.parts.mag = node.estimator = None
        node.warm = ()
        for name in tuple(sys.modules):
            if name.startswith("drivers."):
                delattr(sys.modules["drivers"], name[8:])
                del sys.modules[name]
        node.commands = node.slow = self
        gc.collect()

    def prepare(self, size, digest):
        """Begin, or continue with the list of files where it is stored already."""
        self.stop_sampling()
        self._due_ms = ticks_add(ticks_ms(), _IDLE_MS)
        self._list_digest = self._digest = digest
        self._block = bytearray(_BLOCK)
        self._view = memoryview(self._block)
        try:
            if self._hash(self._path) == digest:
                self._open_list()
            else:
                self._empty(self.folder)
                self._receive(size)
        except OSError:
            self.end(UPDATE_STATUS_NOT_STORED)

    def reply(self):
        """Queue the state."""
        outbox = self._node.outbox
        mpy = getattr(sys.implementation, "_mpy", 0)
        struct.pack_into(
            UPDATE_STATE_FORMAT, outbox.note(), PAYLOAD, self.status, self.slot, mpy, self._file, self._offset
        )
        outbox.post(UPDATE_STATE, UPDATE_STATE_SIZE)

    # In place of `node.commands`.

    def handle(self, frame, received_us):
        """Execute a request: those of an update, and those that do not need the sensors."""
        node = self._node
        if frame.node and frame.node != node.outbox.node_id:
            return
        request = frame.type_id
        if request == UPDATE_START and frame.size >= UPDATE_START_SIZE:
            slot, size, digest = struct.unpack_from(UPDATE_START_FORMAT, frame.raw, PAYLOAD)
            self._due_ms = ticks_add(ticks_ms(), _IDLE_MS)
            if size and slot == self.slot and hexlify(digest) != self._list_digest:
                # Another firmware: it starts again after a restart.
                node.leave = REBOOT_MODE_RUN
            self.reply()
        elif request == UPDATE_PIECE and frame.size > UPDATE_PIECE_SIZE:
            self._due_ms = ticks_add(ticks_ms(), _IDLE_MS)
            self._use_piece(frame.raw, frame.size)
            self.reply()
        elif request in (GET_HELLO, PING, TIME_REQUEST, REBOOT):
            self._commands.handle(frame, received_us)
        else:
            self._commands.nack(request, frame.seq, REASON_BUSY, 0)

    def bias_given_up(self):
        """Do nothing: no initialisation is pending."""

    # In place of `node.slow`.

    def step(self, ms):
        """Check or copy one file; restart the node when the host has been silent for long."""
        if ticks_diff(ms, self._due_ms) >= 0:
            self._node.leave = REBOOT_MODE_RUN
        elif self.status == UPDATE_STATUS_CHECKING:
            try:
                self._check_next()
            except OSError:
                self.end(UPDATE_STATUS_NOT_STORED)
            if self.status != UPDATE_STATUS_CHECKING:
                self.reply()

    def _use_piece(self, raw, payload_size):
        file, offset, count = struct.unpack_from(UPDATE_PIECE_FORMAT, raw, PAYLOAD)
        if (
            self.status != UPDATE_STATUS_WAITING
            or (file, offset) != (self._file, self._offset)
            or count != payload_size - UPDATE_PIECE_SIZE
        ):
            return
        at = PAYLOAD + UPDATE_PIECE_SIZE
        try:
            self._out.write(memoryview(raw)[at : at + count])
            self._offset += count
            if self._offset >= self._size:
                self._finish_file()
        except OSError:
            self.end(UPDATE_STATUS_NOT_STORED)

    def _receive(self, size):
        self._out = open(self._path, "wb")
        self._size, self._offset = size, 0
        self.status = UPDATE_STATUS_WAITING
        if not size:
            self._finish_file()

    def _finish_file(self):
        self._out.close()
        self._out = None
        # As read back from flash.
        if self._hash(self._path) != self._digest:
            os.remove(self._path)
            self.end(UPDATE_STATUS_DAMAGED)
        elif self._list is None:
            self._open_list()
        else:
            self.status = UPDATE_STATUS_CHECKING

    def _open_list(self):
        self._list = open(self._path, "rb")
        self.status = UPDATE_STATUS_CHECKING

    def _check_next(self):
        line = self._list.readline()
        if not line:
            self._switch()
            return
        digest, size, name = line.split()
        name = str(name, "utf-8")
        self._file += 1
        self._offset = 0
        self._digest = digest
        path = self._path = _NEW_MAIN if name == _MAIN else self.folder + "/" + name
        if self._hash(path) == digest:
            return
        for k in range(1, len(path)):
            if path[k] == "/":
                _create_folder(path[:k])
        source = self.running + "/" + name
        if name != _MAIN and self._hash(source) == digest:
            with open(source, "rb") as old, open(path, "wb") as new:
                while count := old.readinto(self._block):
                    new.write(self._view[:count])
            if self._hash(path) == digest:
                return
        self._receive(int(size))

    def _switch(self):
        """Select the complete slot for the next start, which is on trial."""
        self._list.close()
        os.remove(self.folder + _LIST)
        del self._block, self._view
        gc.collect()
        from radio import switch

        switch.switch(self.folder)
        self.end(UPDATE_STATUS_COMPLETE)

    def end(self, status):
        self.status = status
        self._node.leave = REBOOT_MODE_RUN

    def _hash(self, path):
        """Return the SHA-256 of a file as hexadecimal digits; empty without the file."""
        self._node.board.feed()
        digest = sha256()
        try:
            with open(path, "rb") as file:
                while count := file.readinto(self._block):
                    digest.update(self._view[:count])
        except OSError:
            return b""
        return hexlify(digest.digest())

    def _empty(self, folder):
        """Delete the files of a folder, and create it if it is missing."""
        _create_folder(folder)
        for name in os.listdir(folder):
            path = folder + "/" + name
            self._node.board.feed()
            if os.stat(path)[0] & 0x4000:
                self._empty(path)
            else:
                os.remove(path)


def _create_folder(path):
    try:
        os.mkdir(path)
    except OSError:
        # The folder exists already.
        pass
