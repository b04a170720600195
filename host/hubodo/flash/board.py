"""A board on a serial port, at its prompt: look, copy what differs, compare hashes, reset."""

from __future__ import annotations

import ast
import contextlib
import json
import termios
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import serial

from hubodo.errors import WireMismatch
from hubodo.flash.image import ARCHITECTURES, digests
from hubodo.flash.manifest import MANIFEST, Manifest, read_manifest, stands
from hubodo.flash.prompt import WANTED, BoardGone, FlashError, RawPrompt
from hubodo.flash.slots import MAIN, NEW, SLOTS, main_for, other, plan, slot_named, slots_line
from hubodo.flash.snippets import LOOK, PREPARE, RESET, ROLL_BACK, SERIAL, SURVEY, SWAP, TAKE
from hubowire import FINGERPRINT, Frame, FrameDecoder, decode, encode, encode_frame, hello_identity
from hubowire.messages import GetHello, Hello, Reboot, RebootMode

_HASH_CHARACTERS = 64
_COMES_BACK = 15.0
_SAYS_GOODBYE = 2.0
_ANSWERS = 1.0
_TAKES_S = 10.0
CONSOLE_BAUD = 115200
"""Of MicroPython's console where a chip of the board makes USB of a UART; USB itself does not care."""
_PROMPT = b">>> "
_RAW_PROMPT = b"\r\n>"
# A port that goes away while it is read shows itself in any of these, by the moment and the driver.
_LINK_GONE = (serial.SerialException, OSError, termios.error, TypeError)
_PIECE = 256
"""Bytes of a file that a board takes at once, as hexadecimal digits: none of these is ctrl-C."""


@dataclass(frozen=True)
class BoardIdentity:
    """A board's MicroPython. architecture: processor word for mpy-cross, None for bytecode only."""

    platform: str
    machine: str
    architecture: str | None
    version: tuple[int, ...]
    text: str


class FlashBoard:
    """Talks to MicroPython's prompt, and to a running node through its own protocol.

    port: a serial device, held from `interrupt` until the end of the `with` block or `reset`. Errors are
    FlashError with the port and what to try.
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
        """Brings a streaming node, or whatever else runs, to its prompt.

        A node with a watchdog gets there by a restart, and its USB port goes away and comes back.
        """
        request = encode_frame(Frame(Reboot.type_id, 0, 0, encode(Reboot(RebootMode.REPL))))
        try:
            link = self._open()
        except (serial.SerialException, OSError) as error:
            reason = "is busy: stop what reads it" if "lock" in str(error) else "cannot be opened"
            raise FlashError(f"{self.port}: {reason} ({error})") from None
        with contextlib.suppress(*_LINK_GONE), link:
            link.write(b"\0" + request)
            self._wait_prompt(link)
        end = time.monotonic() + _COMES_BACK
        while time.monotonic() < end:
            with contextlib.suppress(*_LINK_GONE):
                self._prompt = RawPrompt(self._open())
                if self._prompt.enter(_ANSWERS):
                    return
            self._close()
            time.sleep(0.2)
        raise FlashError(
            f"{self.port}: no answer and no prompt; is MicroPython on the board? mpremote connect {self.port}"
        )

    def _open(self) -> serial.Serial:
        return serial.Serial(self.port, CONSOLE_BAUD, timeout=0.1, write_timeout=_TAKES_S, exclusive=True)

    @staticmethod
    def _wait_prompt(link: serial.Serial) -> None:
        end = time.monotonic() + _SAYS_GOODBYE
        seen = b""
        while time.monotonic() < end and not seen.endswith((_PROMPT, _RAW_PROMPT)):
            seen = (seen + link.read(link.in_waiting or 1))[-64:]

    def look(self) -> BoardIdentity:
        """What MicroPython says of itself and of the board."""
        platform, machine, mpy, version, text = ast.literal_eval(self.run(LOOK).strip().splitlines()[-1])
        number = mpy >> 10 & 0x3F
        architecture = ARCHITECTURES[number] if number < len(ARCHITECTURES) else None
        return BoardIdentity(platform, machine, architecture, version, text)

    def run(self, code: str, pieces: Iterable[bytes] = ()) -> str:
        """What a piece of Python prints on the board; see `RawPrompt.run`."""
        assert self._prompt is not None, "interrupted before"
        try:
            return self._prompt.run(code, pieces)
        except _LINK_GONE as error:
            raise BoardGone(f"{self.port}: went away ({error}); look at plug and cable, try again") from None

    def unique_id(self) -> str:
        """The board's own number, as its `Hello` tells it, in hex."""
        return self.run(SERIAL).strip().splitlines()[-1]

    def survey(self, names: Iterable[str]) -> tuple[dict[str, str], str | None]:
        """SHA-256 of every file where files of these names may be, by path; and the slot that runs."""
        folders = [
            slot + folder for slot in ("", *SLOTS) for folder in ("", *_folders(names)) if slot + folder
        ]
        lines = self.run(SURVEY.format(folders=folders)).splitlines()
        found = [line.split(" ", 2) for line in lines if line.startswith("# ") and line.count(" ") >= 2]
        held = {path: digest for _, digest, path in found if len(digest) == _HASH_CHARACTERS}
        return held, slot_named("\n".join(lines))

    def config(self) -> dict[str, object]:
        """The node's /config.json, empty where there is none."""
        code = "import os\nprint(open('config.json').read() if 'config.json' in os.listdir() else '{}')"
        with contextlib.suppress(ValueError):
            found = json.loads(self.run(code))
            if isinstance(found, dict):
                return found
        return {}

    def copy(self, image: dict[str, bytes], progress: Callable[[str], None]) -> list[str]:
        """Puts an image into the free slot, compares every hash, and has the node run it from the next start.

        Until the last step the node starts what it had: see `slots`. Returns the names sent.
        Raises FlashError when a file does not come back as it was sent.
        """
        hashes = digests(image | {slot: main_for(image[MAIN], slot) for slot in SLOTS})
        held, running = self.survey(image)
        todo = plan(image, hashes, held, running)
        folders = _folders(image)
        if todo.slot is not None:
            made = [todo.slot, *(todo.slot + folder for folder in folders)]
            self.run(PREPARE.format(folders=made, remove=todo.remove, copy=todo.copy))
        if todo.send:
            self._copy(todo.send, progress)
            held, _ = self.survey(image)
            wrong = [path for path, digest in sorted(todo.expect.items()) if held.get(path) != digest]
            if wrong:
                raise FlashError(f"{self.port}: {', '.join(wrong)} did not come back as sent; flash again")
        if todo.swap or todo.forget:
            self.run(SWAP.format(swap=todo.swap, new=NEW, forget=todo.forget, folders=folders))
        return sorted(_name(path, todo.slot) for path in todo.send)

    def _copy(self, files: dict[str, bytes], progress: Callable[[str], None]) -> None:
        self.run(TAKE.format(piece=_PIECE, wanted=repr(WANTED.decode())))
        for number, (path, content) in enumerate(files.items(), 1):
            progress(f"{number} of {len(files)} files: {path}")
            self.run(f"take({path!r},{len(content)})", _pieces(content))

    def roll_back(self) -> Manifest:
        """Has the node run its other slot from the next start, if every file there is as it was flashed.

        Returns what that slot holds. Raises FlashError when there is nothing whole to go back to.
        """
        _, running = self.survey(())
        if running is None:
            raise FlashError(f"{self.port}: its firmware is not in slots; `hubodo flash` puts it there")
        slot = other(running)
        path = f"{slot}/{MANIFEST}"
        text = self.run(f"try:\n    print(open({path!r}).read())\nexcept OSError:\n    print('')")
        manifest = read_manifest(text)
        if manifest is None or not stands(manifest, slot, self.survey(manifest.files)[0]):
            raise FlashError(
                f"{self.port}: no whole firmware beside the one that runs: nothing to roll back to; flash it"
            )
        self.run(ROLL_BACK.format(new=NEW, now=slots_line(running), then=slots_line(slot)))
        return manifest

    def reset(self) -> None:
        """Restarts the board; the link may vanish and come back."""
        assert self._prompt is not None, "interrupted before"
        with contextlib.suppress(*_LINK_GONE):
            self._prompt.begin(RESET)
        self._close()

    def wait_hello(self, timeout: float = 15.0) -> tuple[int, Hello]:
        """Node id and `Hello` of the firmware that runs now; WireMismatch when it is of another version."""
        frame = self._hello_frame(timeout)
        fingerprint, _ = hello_identity(frame.payload)
        if fingerprint != FINGERPRINT:
            raise WireMismatch(
                f"{self.port}: node speaks {fingerprint:08x}, host speaks {FINGERPRINT:08x}: "
                "the firmware that runs is not the one that was copied; remove other files from the board"
            )
        hello = decode(frame.type_id, frame.payload)
        assert isinstance(hello, Hello)
        return frame.node, hello

    def wait_identity(self, timeout: float = 15.0) -> tuple[int, int, tuple[int, ...]]:
        """Node id, fingerprint and version of the firmware that runs now, whichever that is."""
        frame = self._hello_frame(timeout)
        return (frame.node, *hello_identity(frame.payload))

    def _hello_frame(self, timeout: float) -> Frame:
        """The first may have gone by before the port was open: a node that is heard is asked for another."""
        request = encode_frame(Frame(GetHello.type_id, 0, 0, encode(GetHello())))
        decoder = FrameDecoder()
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            try:
                with serial.Serial(self.port, CONSOLE_BAUD, timeout=0.2, exclusive=True) as link:
                    asked = False
                    while time.monotonic() < end:
                        for frame in decoder.feed(link.read(link.in_waiting or 1)):
                            if frame.type_id == Hello.type_id:
                                return frame
                            if not asked:
                                asked = True
                                link.write(b"\0" + request)
            except _LINK_GONE:
                time.sleep(0.2)
        raise FlashError(
            f"{self.port}: copied, but no Hello within {timeout:.0f} s: see mpremote connect {self.port}"
        )


def _pieces(content: bytes) -> Iterator[bytes]:
    """What TAKE asks for."""
    for at in range(0, len(content), _PIECE):
        yield content[at : at + _PIECE].hex().encode()


def _folders(names: Iterable[str]) -> list[str]:
    """The folders that an image needs below a slot."""
    return sorted({f"/{Path(name).parent}" for name in names} - {"/."})


def _name(path: str, slot: str | None) -> str:
    """The name in the image of a file that was sent to a path."""
    return path.removeprefix(f"{slot}/").removeprefix("/").removesuffix(NEW)
