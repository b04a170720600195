"""A board on a serial port as seen by mpremote: look, copy what differs, compare hashes, reset."""

import ast
import contextlib
import json
import subprocess
import sys
import tempfile
import termios
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import serial

from hubodo.errors import HubodoError
from hubodo.flash.image import ARCHITECTURES, digests
from hubodo.flash.slots import MAIN, NEW, SLOTS, main_for, plan, slot_named
from hubowire import Frame, FrameDecoder, decode, encode, encode_frame
from hubowire.messages import GetHello, Hello, Reboot, RebootMode

_COMMAND_TIMEOUT = 60.0
_FILE_TIMEOUT = 5.0
"""Beyond that, for each file of a conversation."""
_HASH_CHARACTERS = 64
_COMES_BACK = 6.0
CONSOLE_BAUD = 115200
"""Of MicroPython's console where a chip of the board makes USB of a UART; USB itself does not care."""
_PROMPT = b">>> "
_RAW_PROMPT = b"\r\n>"
# Ends a line that was begun, then ctrl-B: a REPL that took the 0x01 of a frame for ctrl-A is in raw mode.
_ASK_PROMPT = b"\r\x02"
# A port that goes away while it is read shows itself in any of these, by the moment and the driver.
_LINK_GONE = (serial.SerialException, OSError, termios.error, TypeError)
_LOOK = (
    "import sys;i=sys.implementation;"
    "print([sys.platform,getattr(i,'_machine',''),getattr(i,'_mpy',0),tuple(i.version[:3]),sys.version])"
)
_SERIAL = (
    "import machine,binascii;print(binascii.hexlify((bytes(machine.unique_id())+bytes(8))[:8]).decode())"
)
# Reads each file in small pieces, into the same memory: a node has little.
_HASH = """
import os,hashlib,binascii
b=bytearray(512)
m=memoryview(b)
def sha(n):
    h=hashlib.sha256()
    with open(n,'rb') as f:
        while True:
            k=f.readinto(b)
            if not k:
                return binascii.hexlify(h.digest()).decode()
            h.update(m[:k])
"""
_SURVEY = (
    _HASH
    + """
def walk(d):
    for e in list(os.ilistdir(d or '/')):
        n=d+'/'+e[0]
        if not e[1]&0x4000:
            print('# %s %s'%(sha(n),n))
        elif n in {folders}:
            walk(n)
walk('')
try:
    print(open('/main.py').read())
except OSError:
    pass
"""
)
_PREPARE = """
import os
for n in {folders}:
    try:
        os.mkdir(n)
    except OSError:
        pass
for n in {remove}:
    os.remove(n)
b=bytearray(512)
m=memoryview(b)
for a,z in {copy}:
    with open(a,'rb') as f:
        with open(z,'wb') as g:
            while True:
                k=f.readinto(b)
                if not k:
                    break
                g.write(m[:k])
"""
_SWAP = """
import os
for n in {swap}:
    os.rename('/'+n+'{new}','/'+n)
for n in {forget}:
    os.remove(n)
for n in {folders}:
    try:
        os.rmdir(n)
    except OSError:
        pass
"""


class FlashError(HubodoError):
    """The board did not answer, or does not hold what was sent."""


@dataclass(frozen=True)
class BoardIdentity:
    """A board's MicroPython. architecture: processor word for mpy-cross, None for bytecode only."""

    platform: str
    machine: str
    architecture: str | None
    version: tuple[int, ...]
    text: str


class FlashBoard:
    """Talks to MicroPython's REPL through mpremote, and to a running node through its own protocol.

    port: a serial device. Errors are FlashError with the port and what to try.
    """

    def __init__(self, port: str) -> None:
        self.port = port

    def look(self) -> BoardIdentity:
        """What MicroPython says of itself and of the board."""
        platform, machine, mpy, version, text = ast.literal_eval(self.run(_LOOK).strip().splitlines()[-1])
        number = mpy >> 10 & 0x3F
        architecture = ARCHITECTURES[number] if number < len(ARCHITECTURES) else None
        return BoardIdentity(platform, machine, architecture, version, text)

    def run(self, code: str) -> str:
        """What a piece of Python prints on the board."""
        return self._run("exec", code)

    def unique_id(self) -> str:
        """The board's own number, as its `Hello` tells it, in hex."""
        return self.run(_SERIAL).strip().splitlines()[-1]

    def interrupt(self) -> None:
        """Brings a streaming node to its REPL; harmless to a board that runs something else.

        A node with a watchdog gets there by a restart, and its USB port goes away and comes back.
        """
        request = encode_frame(Frame(Reboot.type_id, 0, 0, encode(Reboot(RebootMode.REPL))))
        try:
            link = serial.Serial(self.port, CONSOLE_BAUD, timeout=0.1, exclusive=True)
        except (serial.SerialException, OSError) as error:
            reason = "is busy: stop what reads it" if "lock" in str(error) else "cannot be opened"
            raise FlashError(f"{self.port}: {reason} ({error})") from None
        with contextlib.suppress(*_LINK_GONE), link:
            link.write(b"\0" + request)
            self._wait_for((_PROMPT, _RAW_PROMPT), link, 2.0)
        end = time.monotonic() + _COMES_BACK
        while time.monotonic() < end:
            with (
                contextlib.suppress(*_LINK_GONE),
                serial.Serial(self.port, CONSOLE_BAUD, timeout=0.1, exclusive=True) as link,
            ):
                link.write(_ASK_PROMPT)
                if self._wait_for((_PROMPT,), link, 1.0):
                    return
            time.sleep(0.2)
        # No prompt: mpremote's own ways of getting one come next, and their error says more.

    @staticmethod
    def _wait_for(prompts: tuple[bytes, ...], link: serial.Serial, timeout: float) -> bool:
        end = time.monotonic() + timeout
        seen = b""
        while time.monotonic() < end and not seen.endswith(prompts):
            seen = (seen + link.read(4096))[-64:]
        return seen.endswith(prompts)

    def survey(self, names: Iterable[str]) -> tuple[dict[str, str], str | None]:
        """SHA-256 of every file where files of these names may be, by path; and the slot that runs."""
        folders = [
            slot + folder for slot in ("", *SLOTS) for folder in ("", *_folders(names)) if slot + folder
        ]
        lines = self.run(_SURVEY.format(folders=folders)).splitlines()
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
            self.run(_PREPARE.format(folders=made, remove=todo.remove, copy=todo.copy))
        if todo.send:
            progress(f"{len(todo.send)} of {len(image)} files")
            self._copy(todo.send)
            held, _ = self.survey(image)
            wrong = [path for path, digest in sorted(todo.expect.items()) if held.get(path) != digest]
            if wrong:
                raise FlashError(f"{self.port}: {', '.join(wrong)} did not come back as sent; flash again")
        if todo.swap or todo.forget:
            self.run(_SWAP.format(swap=todo.swap, new=NEW, forget=todo.forget, folders=folders))
        return sorted(_name(path, todo.slot) for path in todo.send)

    def _copy(self, files: dict[str, bytes]) -> None:
        """All files in one conversation: each start of mpremote costs a second or more."""
        words: list[str] = []
        with tempfile.TemporaryDirectory() as scratch:
            for number, (name, content) in enumerate(files.items()):
                local = Path(scratch) / str(number)
                local.write_bytes(content)
                words += ["+", "fs", "cp", str(local), f":{name}"]
            self._run(*words[1:], longer=_FILE_TIMEOUT * len(files))

    def reset(self) -> None:
        """Restarts the board; the link may vanish and come back."""
        self._run("reset")

    def wait_hello(self, timeout: float = 15.0) -> tuple[int, Hello]:
        """Node id and `Hello` of the firmware that runs now.

        The first may have gone by before the port was open: a node that is heard is asked for another.
        """
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
                                hello = decode(frame.type_id, frame.payload)
                                assert isinstance(hello, Hello)
                                return frame.node, hello
                            if not asked:
                                asked = True
                                link.write(b"\0" + request)
            except _LINK_GONE:
                time.sleep(0.2)
        raise FlashError(
            f"{self.port}: copied, but no Hello within {timeout:.0f} s: see mpremote connect {self.port}"
        )

    def _run(self, *command: str, longer: float = 0.0) -> str:
        """What mpremote prints; longer: s that it may take beyond _COMMAND_TIMEOUT."""
        patience = _COMMAND_TIMEOUT + longer
        words = [sys.executable, "-m", "mpremote", "connect", self.port, "resume", *command]
        try:
            done = subprocess.run(words, capture_output=True, text=True, timeout=patience, check=False)
        except subprocess.TimeoutExpired:
            raise FlashError(f"{self.port}: no answer to mpremote within {patience:.0f} s") from None
        if done.returncode != 0:
            said = (done.stderr or done.stdout).strip().splitlines()[-1:] or ["no answer"]
            raise FlashError(f"{self.port}: mpremote {command[0]}: {said[0]}; is MicroPython on the board?")
        return done.stdout


def _folders(names: Iterable[str]) -> list[str]:
    """The folders that an image needs below a slot."""
    return sorted({f"/{Path(name).parent}" for name in names} - {"/."})


def _name(path: str, slot: str | None) -> str:
    """The name in the image of a file that was sent to a path."""
    return path.removeprefix(f"{slot}/").removeprefix("/").removesuffix(NEW)
