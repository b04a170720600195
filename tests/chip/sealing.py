"""Measure the cost of authenticating a datagram on an emulated Pico: python tests/chip/sealing.py"""

import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host  # noqa: E402
from hubodo.emulator.motion import StillMotion  # noqa: E402
from hubodo.emulator.virtual_node import VirtualNode  # noqa: E402
from hubodo.flash.image import firmware_folder  # noqa: E402

PROGRAM = """
import gc
from hashlib import sha256
from time import ticks_diff, ticks_us
_BLOCK, _ID = 64, 4
{hmac}
prove = Hmac(bytes(range(32)))
view = memoryview(bytearray(272))
for size in (34, 118, 214, 250):
    gc.collect()
    heap, begun = gc.mem_alloc(), ticks_us()
    for _ in range(20):
        prove.digest(b"n", view[5 : 9 + size])
    took = ticks_diff(ticks_us(), begun) // 20
    print(size, "bytes:", took, "us,", (gc.mem_alloc() - heap) // 20, "bytes of heap")
gc.collect()
heap, begun = gc.mem_alloc(), ticks_us()
for _ in range(20):
    prove.digest(b"answer", bytes(24))
    Session(prove.digest(b"session", bytes(24))).hmac.digest(b"proof")
took = ticks_diff(ticks_us(), begun) // 20
print("a handshake:", took, "us,", (gc.mem_alloc() - heap) // 20, "bytes of heap")
print("end")
"""


def main() -> None:
    source = (firmware_folder() / "sealed.py").read_text()
    hmac = source[source.index("class Hmac:") : source.index("class SealedLink")]
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "main.py").write_text(PROGRAM.format(hmac=hmac))
        node = VirtualNode(
            StillMotion(),
            Flash(firmware=Path(folder)),
            board=BoardSettings(interpreter="rp2040"),
            clock=Clock("stepped", run_for=2.5),
            host=Host("memory"),
            own_process=False,
        )
        with node:
            node.wait(120)
            output = node.output.decode(errors="replace")
    print(output.partition("end")[0].strip())


if __name__ == "__main__":
    main()
