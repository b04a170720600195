"""The verbs of the command line, in the order in which `hubodo --help` lists them."""

from importlib import import_module
from types import ModuleType

# Each is a module here (`import` with a trailing "_"): HELP, EXAMPLE, add_arguments(parser), run(args).
# Names, not modules: a verb starts without waiting for what the others import.
VERBS: tuple[str, ...] = (
    "demo",
    "record",
    "play",
    "import",
    "export",
    "info",
    "fuse",
    "recover",
    "flash",
    "doctor",
    "node",
    "allan",
    "warmup",
    "calibrate",
    "north",
    "heading",
    "simulate",
    "gap",
    "report",
)


def load(verb: str) -> ModuleType:
    """The module of one of VERBS."""
    return import_module(f"{__name__}.{'import_' if verb == 'import' else verb}")
