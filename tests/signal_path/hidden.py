"""An effect hidden below the registers of an emulated chip and identified from the daemon's log.

    python tests/signal_path/hidden.py [--seconds 40] [--seed 3] [--effects wheel_camber,...] [-o out/hidden]

Each ride runs the firmware on two virtual boards, in real time: MicroPython, pseudo serial ports, MCAP. The
model that `hubodo gap` gets has no effects; it knows the clocks of nodes and reference to 5 ms.
"""

import json
import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hubodo.cli import main as hubodo
from hubodo.log.recording_reader import read_recording
from hubodo.log.recording_writer import write_recording
from script_arguments import script_parser
from vehicles import model_toml

MODEL = model_toml(
    track_width=0.55,
    gyro_noise=0.002,
    accel_noise=0.02,
    inputs="speed_noise = 0.001\nyaw_rate_noise = 0.0005\nclock_sigma = 0.005\n",
)
HIDDEN = {
    "wheel_camber": ("left", {"angle": 0.03}),
    "wheel_radius": ("right", {"error": 0.004}),
    "lever_arm": ("left", {"x": 0.004}),
    "gyro_scale_factor": ("right", {"z": 0.004}),
    "outliers": ("left", {"probability": 0.02, "sigma": 20.0}),
}


def drive(folder, name, seconds, seed):
    """Record a ride with one hidden effect and return the log, which does not name it."""
    node, parameters = HIDDEN[name]
    lines = [f"[nodes.{node}.effects.{name}]", *(f"{key} = {value}" for key, value in parameters.items())]
    (folder / "hidden.toml").write_text(MODEL + "\n".join(lines) + "\n")
    (folder / "model.toml").write_text(MODEL)
    words = ["simulate", str(folder / "hidden.toml"), "-o", str(folder / "told.mcap"), "--virtual-node"]
    with redirect_stdout(StringIO()):
        code = hubodo([*words, "--rate", "208", "--duration", str(seconds), "--seed", str(seed)])
    assert code == 0
    recording = read_recording(folder / "told.mcap")
    recording.metadata.pop("simulated.model")
    write_recording(recording, folder / "drive.mcap")
    return folder / "drive.mcap"


def named(folder):
    """Return the findings of `hubodo gap` in the ride."""
    with redirect_stdout(StringIO()):
        code = hubodo(
            ["gap", str(folder / "model.toml"), str(folder / "drive.mcap"), "-o", str(folder / "gap")]
        )
    assert code == 0
    return json.loads((folder / "gap" / "gap.json").read_text("utf-8"))


def main(argv=None):
    parser = script_parser(__doc__)
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--seed", type=int, default=3, help="of the first ride")
    parser.add_argument("--effects", default=",".join(HIDDEN))
    parser.add_argument("-o", dest="out", type=Path, default=Path("out/hidden"))
    args = parser.parse_args(argv)
    table = Table(
        "hidden",
        "named",
        "parameters",
        "confidence",
        "gap",
        title="chips → MicroPython → serial → MCAP → gap",
    )
    right, names = 0, args.effects.split(",")
    for k, name in enumerate(names):
        folder = args.out / f"{name}-{args.seed + k}"
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / "drive.mcap").exists():
            drive(folder, name, args.seconds, args.seed + k)
        result = named(folder)
        node, parameters = HIDDEN[name]
        findings = [(it["effect"], it["scope"]) for it in result["found"]]
        right += findings == [(name, node)]
        table.add_row(
            f"{name} ({node}) " + ", ".join(f"{key} {value:g}" for key, value in parameters.items()),
            "\n".join(f"{effect} ({scope})" for effect, scope in findings) or "nothing",
            "\n".join(", ".join(map(_value, it["parameters"].items())) for it in result["found"]),
            "\n".join(f"{it['confidence']:.3f}" for it in result["found"]),
            "{before:.3f} → {after:.3f}, noise alone {floor:.3f}".format(**result["gap"]),
        )
    Console(width=160).print(table)
    print(f"{right} of {len(names)} named, and nothing else; seeds from {args.seed}")
    return 0


def _value(parameter):
    name, it = parameter
    return f"{name} {it['value']:.3g}" + (f" ± {it['sigma']:.1g}" if it["sigma"] else "")


if __name__ == "__main__":
    sys.exit(main())
