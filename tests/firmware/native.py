"""The firmware's native twins, run by CPython: a pointer is the array itself, integers are not cut."""

import builtins
import importlib.util
from functools import cache
from pathlib import Path


@cache
def load(name="fast"):
    """The module of that name."""
    for pointer in ("ptr8", "ptr16", "ptr32"):
        setattr(builtins, pointer, lambda memory: memory)
    path = Path(__file__).parents[2] / "firmware" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(f"{name}_on_cpython", path)
    fast = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fast)
    return fast
