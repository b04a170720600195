"""The firmware's native twins, run by CPython: a pointer is the array itself, integers are not cut."""

import builtins
import importlib.util
from functools import cache
from pathlib import Path


@cache
def load():
    """The module fast.py."""
    names = ("ptr8", "ptr16", "ptr32")
    for name in names:
        setattr(builtins, name, lambda memory: memory)
    path = Path(__file__).parents[2] / "firmware" / "fast.py"
    spec = importlib.util.spec_from_file_location("fast_on_cpython", path)
    fast = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fast)
    return fast
