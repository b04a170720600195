"""A board on a serial port, controlled over its MicroPython prompt: identify, copy, verify, reset."""

from __future__ import annotations

import ast
import contextlib
import errno
import json
import termios
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import serial

from hubodo.errors import WireMismatch
from hubodo.flash.image import ARCHITECTURES, hash_files
from hubodo.flash.manifest import MANIFEST, Manifest, is_complete, read_manifest
from hubodo.flash.prompt import NEXT_CHUNK, BoardDisconnected, FlashError, RawPrompt
from hubodo.flash.slots import (
    MAIN,
    NEW_SUFFIX,
    SLOTS,
    active_slot,
    main_for_slot,
    other_slot,
    plan_flash,
    slots_line,
)
from hubodo.flash.snippets import IDENTIFY, LIST_HASHES, PREPARE, RECEIVE_FILE, RESET, ROLL_BACK, SERIAL, SWAP
from hubowire import FINGERPRINT, Frame, FrameDecoder, decode, encode, encode_frame, hello_identity
from hubowire.messages import GetHello, Hello, Reboot, RebootMode

_SHA256_HEX_LENGTH = 64
_PROMPT_RETURN_TIMEOUT_S = 15.0
_REBOOT_TIMEOUT_S = 2.0
_PROMPT_TIMEOUT_S = 1.0
_SERIAL_WRITE_TIMEOUT_S = 10.0
CONSOLE_BAUD = 115200
"""Baud rate of MicroPython's console behind a USB converter; native USB ignores it."""
_PROMPT = b">>> "
_RAW_PROMPT = b"\r\n>"
# Exceptions of a port that disappears while it is read, depending on moment and driver.
_LINK_GONE = (serial.SerialException, OSError, termios.error, TypeError)
_CHUNK_BYTES = 256
"""Bytes of a file sent at once, as hexadecimal digits, none of which is ctrl-C."""


@dataclass(frozen=True)
class BoardIdentity:
    """The identity of a board and of its MicroPython.

    Attributes
    ----------
    platform, machine
        As reported by MicroPython.
    architecture
        Processor name for mpy-cross; None for bytecode only.
    version
        Version of MicroPython.
    text
        Version text of MicroPython.
    """

    platform: str
    machine: str
    architecture: str | None
    version: tuple[int, ...]
    text: str


class FlashBoard:
    """A board controlled over MicroPython's prompt, and a running node over its protocol.

    port: a serial device, held from `interrupt` until `reset` or the end of the `with` block. Errors are
    FlashError with the port and a remedy.
    """

    def __init__(self, port: str) -> None:
        self.port = port
        self._prompt: RawPrompt | None = None

    def __enter__(self) -> FlashBoard:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._prompt is not None:
            with contextlib.suppress(*_LINK_GONE):
                self._prompt.leave()
            self._close()

    def _close(self) -> None:
        if self._prompt is not None:
            with contextlib.suppress(*_LINK_GONE):
                self._prompt.close()
        self._prompt = None

    def interrupt(self) -> None:
        """Stop the running program, for example a streaming node, and enter the prompt.

        A node with a watchdog gets there by a restart; its USB port disappears and returns.
        """
        request = encode_frame(Frame(Reboot.type_id, 0, 0, encode(Reboot(RebootMode.REPL))))
        try:
            link = self._open()
        except (serial.SerialException, OSError) as error:
            if error.errno == errno.ENOENT:
                raise FlashError(
                    f"{self.port}: no such device; plug it in, `hubodo doctor` lists the ports"
                ) from None
            if "lock" in str(error):
                raise FlashError(f"{self.port}: is busy: stop the program that uses it ({error})") from None
            raise FlashError(
                f"{self.port}: cannot be opened as a serial port ({error}); `hubodo doctor` lists the ports"
            ) from None
        with contextlib.suppress(*_LINK_GONE), link:
            link.write(b"\0" + request)
            self._wait_prompt(link)
        end = time.monotonic() + _PROMPT_RETURN_TIMEOUT_S
        while time.monotonic() < end:
            with contextlib.suppress(*_LINK_GONE):
                self._prompt = RawPrompt(self._open())
                if self._prompt.enter(_PROMPT_TIMEOUT_S):
                    return
            self._close()
            time.sleep(0.2)
        raise FlashError(
            f"{self.port}: no answer and no prompt; is MicroPython on the board? mpremote connect {self.port}"
        )

    def _open(self) -> serial.Serial:
        return serial.Serial(
            self.port, CONSOLE_BAUD, timeout=0.1, write_timeout=_SERIAL_WRITE_TIMEOUT_S, exclusive=True
        )

    @staticmethod
    def _wait_prompt(link: serial.Serial) -> None:
        end = time.monotonic() + _REBOOT_TIMEOUT_S
        received = b""
        while time.monotonic() < end and not received.endswith((_PROMPT, _RAW_PROMPT)):
            received = (received + link.read(link.in_waiting or 1))[-64:]

    def identify(self) -> BoardIdentity:
        """Return the identity of the board and of its MicroPython."""
        platform, machine, mpy, version, text = ast.literal_eval(self.run(IDENTIFY).strip().splitlines()[-1])
        index = mpy >> 10 & 0x3F
        architecture = ARCHITECTURES[index] if index < len(ARCHITECTURES) else None
        return BoardIdentity(platform, machine, architecture, version, text)

    def run(self, code: str, pieces: Iterable[bytes] = ()) -> str:
        """Run Python code on the board and return what it prints; see `RawPrompt.run`."""
        assert self._prompt is not None, "call interrupt first"
        try:
            return self._prompt.run(code, pieces)
        except _LINK_GONE as error:
            raise BoardDisconnected(
                f"{self.port}: disconnected ({error}); check plug and cable, then try again"
            ) from None

    def unique_id(self) -> str:
        """Return the unique id of the board as hexadecimal digits, as in its `Hello`."""
        return self.run(SERIAL).strip().splitlines()[-1]

    def list_hashes(self, names: Iterable[str]) -> tuple[dict[str, str], str | None]:
        """Return the SHA-256 of each firmware file on the board by path, and the slot that runs."""
        folders = [
            slot + folder for slot in ("", *SLOTS) for folder in ("", *_folders(names)) if slot + folder
        ]
        lines = self.run(LIST_HASHES.format(folders=folders)).splitlines()
        rows = [line.split(" ", 2) for line in lines if line.startswith("# ") and line.count(" ") >= 2]
        hashes = {path: digest for _, digest, path in rows if len(digest) == _SHA256_HEX_LENGTH}
        return hashes, active_slot("\n".join(lines))

    def config(self) -> dict[str, object]:
        """Return the node's /config.json, or an empty object."""
        code = "import os\nprint(open('config.json').read() if 'config.json' in os.listdir() else '{}')"
        with contextlib.suppress(ValueError):
            config = json.loads(self.run(code))
            if isinstance(config, dict):
                return config
        return {}

    def copy(self, image: dict[str, bytes], progress: Callable[[str], None]) -> list[str]:
        """Copy an image into the free slot, verify every hash, and select that slot for the next start.

        Until the last step the node starts its old firmware: see `slots`. Returns the names of copied files.
        Raises FlashError if a file differs from what was sent.
        """
        hashes = hash_files(image | {slot: main_for_slot(image[MAIN], slot) for slot in SLOTS})
        held, running = self.list_hashes(image)
        flash_plan = plan_flash(image, hashes, held, running)
        folders = _folders(image)
        if flash_plan.slot is not None:
            slot_folders = [flash_plan.slot, *(flash_plan.slot + folder for folder in folders)]
            self.run(PREPARE.format(folders=slot_folders, remove=flash_plan.remove, copy=flash_plan.copy))
        if flash_plan.send:
            self._copy(flash_plan.send, progress)
            held, _ = self.list_hashes(image)
            damaged = [
                path
                for path, digest in sorted(flash_plan.expected_hashes.items())
                if held.get(path) != digest
            ]
            if damaged:
                raise FlashError(f"{self.port}: {', '.join(damaged)} differ from what was sent; flash again")
        if flash_plan.swap or flash_plan.obsolete:
            self.run(
                SWAP.format(swap=flash_plan.swap, new=NEW_SUFFIX, forget=flash_plan.obsolete, folders=folders)
            )
        return sorted(_name(path, flash_plan.slot) for path in flash_plan.send)

    def _copy(self, files: dict[str, bytes], progress: Callable[[str], None]) -> None:
        self.run(RECEIVE_FILE.format(piece=_CHUNK_BYTES, wanted=repr(NEXT_CHUNK.decode())))
        for number, (path, content) in enumerate(files.items(), 1):
            progress(f"{number} of {len(files)} files: {path}")
            self.run(f"take({path!r},{len(content)})", _pieces(content))

    def roll_back(self) -> Manifest:
        """Select the other slot for the next start, if its files are unchanged since it was flashed.

        Returns the manifest of that slot. Raises FlashError if there is no complete older firmware.
        """
        _, running = self.list_hashes(())
        if running is None:
            raise FlashError(f"{self.port}: its firmware is not in slots; run `hubodo flash` first")
        slot = other_slot(running)
        path = f"{slot}/{MANIFEST}"
        text = self.run(f"try:\n    print(open({path!r}).read())\nexcept OSError:\n    print('')")
        manifest = read_manifest(text)
        if manifest is None or not is_complete(manifest, slot, self.list_hashes(manifest.files)[0]):
            raise FlashError(f"{self.port}: no complete older firmware to roll back to; flash the board")
        self.run(ROLL_BACK.format(new=NEW_SUFFIX, now=slots_line(running), then=slots_line(slot)))
        return manifest

    def reset(self) -> None:
        """Restart the board; the port may disappear and return."""
        assert self._prompt is not None, "call interrupt first"
        with contextlib.suppress(*_LINK_GONE):
            self._prompt.start(RESET)
        self._close()

    def wait_hello(self, timeout: float = 15.0) -> tuple[int, Hello]:
        """Return node id and `Hello` of the running firmware; raise WireMismatch for another version."""
        frame = self._hello_frame(timeout)
        fingerprint, _ = hello_identity(frame.payload)
        if fingerprint != FINGERPRINT:
            raise WireMismatch(
                f"{self.port}: node speaks {fingerprint:08x}, host speaks {FINGERPRINT:08x}: "
                "the running firmware is not the copied one; remove other files from the board"
            )
        hello = decode(frame.type_id, frame.payload)
        assert isinstance(hello, Hello)
        return frame.node, hello

    def wait_identity(self, timeout: float = 15.0) -> tuple[int, int, tuple[int, ...]]:
        """Return node id, fingerprint and version of the running firmware, of any version."""
        frame = self._hello_frame(timeout)
        return (frame.node, *hello_identity(frame.payload))

    def _hello_frame(self, timeout: float) -> Frame:
        """Wait for a `Hello`, and request one, as the first may precede the opening of the port."""
        request = encode_frame(Frame(GetHello.type_id, 0, 0, encode(GetHello())))
        decoder = FrameDecoder()
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            try:
                with serial.Serial(self.port, CONSOLE_BAUD, timeout=0.2, exclusive=True) as link:
                    requested = False
                    while time.monotonic() < end:
                        for frame in decoder.feed(link.read(link.in_waiting or 1)):
                            if frame.type_id == Hello.type_id:
                                return frame
                            if not requested:
                                requested = True
                                link.write(b"\0" + request)
            except _LINK_GONE:
                time.sleep(0.2)
        raise FlashError(
            f"{self.port}: copied, but no identification in {timeout:.0f} s: try mpremote connect {self.port}"
        )


def _pieces(content: bytes) -> Iterator[bytes]:
    """Yield the chunks that the snippet RECEIVE_FILE requests."""
    for offset in range(0, len(content), _CHUNK_BYTES):
        yield content[offset : offset + _CHUNK_BYTES].hex().encode()


def _folders(names: Iterable[str]) -> list[str]:
    """Return the folders that an image needs inside a slot."""
    return sorted({f"/{Path(name).parent}" for name in names} - {"/."})


def _name(path: str, slot: str | None) -> str:
    """Return the name in the image of a file copied to a path."""
    return path.removeprefix(f"{slot}/").removeprefix("/").removesuffix(NEW_SUFFIX)
