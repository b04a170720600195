"""The verbs of the command line, in the order in which `hubodo --help` lists them."""

from importlib import import_module
from types import ModuleType

VERBS: dict[str, str] = {
    "demo": "show the whole product without hardware: two virtual nodes, a drive, a log, a track, a page",
    "record": "record nodes into a log until ctrl-C, with live odometry",
    "service": "run the recorder as a service of the computer: install, status, uninstall",
    "config": "a commented hubodo.toml, and whether one is right",
    "play": "play a log: a live view, or frames on a pseudo serial port that `hubodo record` can read",
    "import": "turn a folder of CSV files or a rosbag into a log, or decode the raw frames of a log again",
    "export": "turn a log into a folder of CSV or Parquet files, or a rosbag2 for ros2 bag",
    "info": "show streams, rates, gaps, losses, versions and health of a log",
    "fuse": "fuse a log into a track: where the vehicle went, with sigmas",
    "recover": "repair a log that was cut off mid-write or damaged",
    "flash": "put the firmware onto a board, compare every file and wait until it runs",
    "doctor": "look at a board in bring-up order: port, wiring, firmware, sensor, samples, clock",
    "node": "ask a node who it is, change its settings, find its gyro's bias, or restart it",
    "allan": "Allan deviation and noise terms of sensors at rest, with sigmas and units of IEEE 952",
    "warmup": "the bias of a gyro after power-on: C1 (1 - exp(-t/T)) + C2, judged for whiteness",
    "calibrate": "calibrate wheels from a drive with known positions, or a node's triads from poses",
    "north": "find north from Earth rate: maytagging, carouselling, east-seeking",
    "heading": "heading from one upright gyro axis, its warm-up taken out, with a sigma that holds",
    "simulate": "draw a log from a model: what the nodes would measure on a drive, a table, a bench",
    "gap": "what a model lacks to explain a log: the missing effects by name, and the model with them",
    "serve": "the recordings of a folder in the browser: what they hold, their reports, gap on a click",
    "report": "one self-contained HTML page of a log: content, losses, sensors, calibration, drive",
    "batch": "what another verb does with one log, done with folders of them, here or on a Dask cluster",
    "logs": "list, search and sum up the logs that `hubodo batch info` went through, none of which is read",
    "completion": "print the script with which a shell completes verbs, options, ports, nodes and files",
}
"""Each with what it does, in one line. It is a module here (`import` with a trailing "_"): EXAMPLE,
add_arguments(parser), run(args). Names, not modules: a verb starts, and the list is shown, without waiting
for what the others import.
"""


def load(verb: str) -> ModuleType:
    """The module of one of VERBS."""
    return import_module(f"{__name__}.{'import_' if verb == 'import' else verb}")
