"""The verbs of the command line, in the order in which `hubodo --help` lists them."""

from importlib import import_module
from types import ModuleType

VERBS: dict[str, str] = {
    "demo": "show the whole product without hardware: two virtual nodes, a drive, a log, a track, a page",
    "record": "record nodes into a log until ctrl-C, with live odometry",
    "service": "run the recorder as a service of the computer: install, status, uninstall",
    "vehicle": "write a vehicle file by answering questions, or check one by a push over a tape",
    "example": "write the files that the documents use: vehicle, models, a drive, a night at standstill",
    "config": "print a commented hubodo.toml, or check one",
    "play": "replay a log: in a live view, or as frames on a pseudo serial port for `hubodo record`",
    "import": "convert a folder of CSV files or a rosbag into a log, or decode the raw frames of a log again",
    "export": "convert a log into a folder of CSV or Parquet files, or into a rosbag2 for ros2 bag",
    "info": "show streams, rates, gaps, losses, versions and health of a log",
    "fuse": "fuse a log into a track: position, heading and speed over time, with sigmas",
    "recover": "repair a log that is truncated or damaged",
    "flash": "install the firmware on a board, verify every file and wait until it runs",
    "doctor": "diagnose this computer, or a board: port, wiring, firmware, sensor, samples, clock",
    "node": "identify a node, change its settings, initialise its gyro bias, or restart it",
    "allan": "Allan deviation and noise terms (IEEE 952) of stationary sensors, with sigmas",
    "warmup": "fit the gyro bias after power-on, C1 (1 - exp(-t/T)) + C2, and test the residual",
    "calibrate": "calibrate wheels from a drive with known positions, or sensors from poses or a rate table",
    "sheet": "write the test sheet of a sensor: noise, warm-up and calibration on two printed pages",
    "north": "find north from Earth rate: maytagging, carouselling, east-seeking",
    "heading": "estimate the heading from one vertical gyro axis, corrected for warm-up, with its sigma",
    "filters": "compare filters of a gyro axis on a log, with the settings of the best one for the node",
    "simulate": "simulate a log from a model file: a drive, a turntable or a bench test",
    "gap": "find the effects that a model lacks to explain a log, and write the model with them added",
    "serve": "show the recordings of a folder in the browser, with their reports and `gap` on a click",
    "report": "write one self-contained HTML page about a log: content, losses, sensors, calibration, drive",
    "batch": "run another verb on many logs, on this computer or on a Dask cluster",
    "logs": "list, search and summarise logs from the index that `hubodo batch info` wrote",
    "completion": "print the shell completion script for verbs, options, ports, nodes and files",
}
"""One line of help for each verb, by name.

Each verb is a module of this package with the same name (`import` is `import_`), which defines
`EXAMPLE: str`, `add_arguments(parser)` and `run(args)`. `run` returns None or a result with `as_json()`
and `render(console)`; a result may have a property `failed`, for exit code 1. Modules are loaded only when
their verb runs, so that `hubodo --help` is fast.
"""


def load_verb(verb: str) -> ModuleType:
    """Import and return the module of a verb in `VERBS`."""
    return import_module(f"{__name__}.{'import_' if verb == 'import' else verb}")
