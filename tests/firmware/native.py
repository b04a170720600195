"""Load the native code of the firmware in CPython: pointers are arrays, and integers do not overflow."""

import builtins
import importlib.util
from functools import cache
from pathlib import Path


@cache
def load(name="fast"):
    """Import a file with native code as a plain Python module."""
    for pointer in ("ptr8", "ptr16", "ptr32"):
        setattr(builtins, pointer, lambda memory: memory)
    path = Path(__file__).parents[2] / "firmware" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(f"{name}_on_cpython", path)
    fast = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fast)
    return fast
