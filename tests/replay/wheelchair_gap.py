"""Run `gap` on a real wheelchair, starting from a model without effects: both wheels and frame, 400 Hz.

    python tests/replay/wheelchair_gap.py [-o out/wheelchair-gap] [--track-width 0.92]

The model is driven by the gyros of the log only: speed from both wheels, yaw rate from the frame.
"""

# ruff: noqa: E402 (the tests' own modules lie one folder up)

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from gap_runs import wheelchair_model
from hubodo.cli import main as hubodo
from script_arguments import script_parser
from wanted import SHARED


def main(argv=None):
    parser = script_parser(__doc__)
    parser.add_argument("-o", dest="out", type=Path, default=Path("out/wheelchair-gap"))
    parser.add_argument("--track-width", type=float, default=0.92, help="m, between the contacts")
    args = parser.parse_args(argv)
    folder = SHARED / "data" / "wheelchair"
    if not folder.is_dir():
        print(
            f"{folder}: no recording there; set HUBODO_SHARED to the folder that holds data/", file=sys.stderr
        )
        return 2
    args.out.mkdir(parents=True, exist_ok=True)
    model = args.out / "start.toml"
    model.write_text(wheelchair_model(args.track_width), "utf-8")
    return hubodo(["gap", str(model), str(folder), "-o", str(args.out)])


if __name__ == "__main__":
    sys.exit(main())
