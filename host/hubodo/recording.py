"""A recording in memory, the common input of all estimators, checks and exports."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hubodo.errors import InputError
from hubodo.html_table import html_lines, html_table
from hubodo.safe_text import printable

if TYPE_CHECKING:
    import pandas as pd

Column = NDArray[np.float64]

NODE_COLUMNS = ("t", "gx", "gy", "gz", "ax", "ay", "az")
NODE_OPTIONAL_COLUMNS = ("temperature", "supply")
"""Optional columns of a node's table, °C and V; NaN where the value is unknown."""
HIGH_G_COLUMNS = ("t", "ax", "ay", "az")
HIGH_G_SUFFIX = ".high_g"
"""Ending of the file of a node's second accelerometer, `<node>.high_g.csv`."""
BIAS_FILTER_COLUMNS = (
    "t",
    "state",
    "samples",
    "saturations",
    *(f"{what}_{axis}" for what in ("rate", "bias", "noise", "sigma") for axis in "xyz"),
)
"""sigma is of the initial bias, computed from `samples` samples; noise is 1 sigma of a stationary sample."""


@dataclass(frozen=True)
class Table:
    """Columns of equal length, in the order of their file; column `t`, in seconds, strictly increases.

    Raises ValueError where these conditions are not met.

    Attributes
    ----------
    columns : name -> (N,) float64, in SI units; read-only.
    t_ns : (N,) exact times in ns if float64 cannot hold them (seconds since 1970 with nine decimals), else
        None.
    """

    columns: Mapping[str, Column]
    t_ns: NDArray[np.int64] | None = None

    def __post_init__(self) -> None:
        columns: dict[str, Column] = {}
        for name, values in self.columns.items():
            column = np.asarray(values, np.float64).view()
            column.flags.writeable = False
            columns[name] = column
        if "t" not in columns:
            raise ValueError(f"a table needs a column t, it has {sorted(columns)}")
        t = columns["t"]
        if any(column.shape != (len(t),) for column in columns.values()):
            raise ValueError(f"columns differ in length: { {k: v.shape for k, v in columns.items()} }")
        if self.t_ns is not None and self.t_ns.shape != t.shape:
            raise ValueError(f"t_ns has shape {self.t_ns.shape}, t has {t.shape}")
        if len(t) > 1 and not bool((np.diff(t) > 0).all()):
            raise ValueError("column t does not strictly increase")
        object.__setattr__(self, "columns", MappingProxyType(columns))

    def __getitem__(self, name: str) -> Column:
        return self.columns[name]

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __len__(self) -> int:
        return len(self.columns["t"])

    @property
    def t(self) -> Column:
        """Return the times, (N,) s, strictly increasing."""
        return self.columns["t"]

    @property
    def gyro(self) -> Column:
        """Return a copy of the rates, (N, 3) rad/s in node axes. Raises KeyError if there are none."""
        return np.column_stack([self.columns[name] for name in ("gx", "gy", "gz")])

    @property
    def accel(self) -> Column:
        """Return a copy of the specific force, (N, 3) m/s² in node axes. Raises KeyError as `gyro`."""
        return np.column_stack([self.columns[name] for name in ("ax", "ay", "az")])

    def frame(self) -> pd.DataFrame:
        """Return the columns as a pandas data frame.

        Returns
        -------
        pandas.DataFrame
            The columns, indexed by `t`.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError:
            raise InputError("a data frame needs pandas: pip install 'hubodo[frames]'") from None
        return pd.DataFrame({name: column.copy() for name, column in self.columns.items()}).set_index("t")

    def __repr__(self) -> str:
        span = f"{self.t[0]:.3f} to {self.t[-1]:.3f} s, " if len(self) else ""
        return f"Table({len(self)} rows, {span}{' '.join(self)})"

    def _repr_html_(self) -> str:
        return html_table(
            ("column", "first", "lowest", "highest"), [_column_summary(self, name) for name in self]
        )

    def __getstate__(self) -> dict[str, Any]:
        return {"columns": dict(self.columns), "t_ns": self.t_ns}

    def __setstate__(self, state: dict[str, Any]) -> None:
        object.__setattr__(self, "columns", state["columns"])
        object.__setattr__(self, "t_ns", state["t_ns"])
        self.__post_init__()


def missing_channels(table: Table) -> tuple[str, ...]:
    """Return the channels of a node that hold no finite value."""
    return tuple(name for name in NODE_COLUMNS[1:] if not np.isfinite(table[name]).any())


def _column_summary(table: Table, name: str) -> tuple[str, ...]:
    """Return name, first, lowest and highest value of a column as text."""
    column = table[name]
    known = column[np.isfinite(column)]
    if not len(known):
        return name, "", "", ""
    return name, *(f"{value:.6g}" for value in (known[0], known.min(), known.max()))


@dataclass(frozen=True)
class Event:
    """An event during a recording, such as a gap or a reset.

    Attributes
    ----------
    t_ns : ns, host time on the clock of the log.
    kind : one lower-case word, such as `gap`, `connected`, `disconnected`, `reset`, `damage`, `repaired`.
    source : node or link concerned, "" for the whole log.
    text : one line for people.
    data : numbers for programs; for `gap`: node, samples_lost, frames_lost, cause, duration_s.
    """

    t_ns: int
    kind: str
    source: str
    text: str
    data: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        # Texts of events come from users and other programs, so control characters must not reach a terminal.
        for name in ("kind", "source", "text"):
            object.__setattr__(self, name, printable(getattr(self, name)))


@dataclass(frozen=True)
class Recording:
    """The content of a log or a CSV folder, on one clock.

    Attributes
    ----------
    nodes : tables by node name, columns `t,gx,gy,gz,ax,ay,az[,temperature][,supply]` and any others.
    reference, wheels, gnss, heading, table, truth : tables of the CSV folder's files of that name, or None.
    magnetometers : tables by node name, `t,mx,my,mz` in tesla.
    high_g : tables by node name of a second accelerometer with a larger range, `t,ax,ay,az` in m/s².
    bias_filters : gyro bias as estimated by the firmware, by node name, columns `BIAS_FILTER_COLUMNS`: rad/s,
        node axes; state as in the wire's FilterState; NaN where the node does not know a sigma.
    odometry : `t,x,y,heading,speed,yaw_rate` as recorded live.
    events : oldest first.
    metadata : key -> text; keys of metadata records other than `hubodo` are written `record.key`.
    t_zero_ns : host time of t = 0.
    warnings : one line for each item that was damaged or left out when the log was read.
    """

    nodes: Mapping[str, Table]
    reference: Table | None = None
    wheels: Table | None = None
    gnss: Table | None = None
    heading: Table | None = None
    table: Table | None = None
    truth: Table | None = None
    magnetometers: Mapping[str, Table] = field(default_factory=dict)
    high_g: Mapping[str, Table] = field(default_factory=dict)
    bias_filters: Mapping[str, Table] = field(default_factory=dict)
    odometry: Table | None = None
    events: tuple[Event, ...] = ()
    metadata: Mapping[str, str] = field(default_factory=dict)
    t_zero_ns: int = 0
    warnings: tuple[str, ...] = ()

    def files(self) -> dict[str, Table]:
        """Return the tables of the CSV folder by file name without suffix, those of nodes first.

        Returns
        -------
        dict of str to Table
            The tables that the recording has.
        """
        named = {name: getattr(self, name) for name in TABLE_FILE_COLUMNS}
        high_g = {name + HIGH_G_SUFFIX: table for name, table in self.high_g.items()}
        return {**self.nodes, **high_g, **{name: table for name, table in named.items() if table is not None}}

    def __repr__(self) -> str:
        return f"Recording({', '.join(f'{name}: {len(table)}' for name, table in self.files().items())})"

    def _repr_html_(self) -> str:
        rows = [
            (
                name,
                str(len(table)),
                f"{(len(table) - 1) / (table.t[-1] - table.t[0]):.4g}" if len(table) > 1 else "",
                f"{table.t[0]:.3f} to {table.t[-1]:.3f}",
                " ".join(table),
            )
            for name, table in self.files().items()
        ]
        return html_table(("", "rows", "Hz", "t, s", "columns"), rows) + html_lines(self.warnings)


TABLE_FILE_COLUMNS: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "reference": (("t", "speed", "yaw_rate"), ("temperature",)),
    "wheels": (("t", "left", "right"), ()),
    "gnss": (("t", "latitude_deg", "longitude_deg", "altitude"), ("sigma",)),
    "heading": (("t", "heading"), ("sigma",)),
    "table": (("t", "angle", "moving"), ()),
    "truth": (("t", "x", "y"), ("heading",)),
}
"""Required and optional columns of the files of a CSV folder that are not nodes."""


def is_node_file(name: str) -> bool:
    """Return True if a file of the CSV folder, without suffix, holds the samples of a node."""
    return name not in TABLE_FILE_COLUMNS and not name.endswith(HIGH_G_SUFFIX)


def file_columns(name: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the required and the optional columns of a file of the CSV folder, without suffix."""
    node = (HIGH_G_COLUMNS, ()) if name.endswith(HIGH_G_SUFFIX) else (NODE_COLUMNS, NODE_OPTIONAL_COLUMNS)
    return TABLE_FILE_COLUMNS.get(name, node)


def split_high_g(tables: Mapping[str, Table]) -> tuple[dict[str, Table], dict[str, Table]]:
    """Return tables by file name without those of second accelerometers, and these by node."""
    others = {name: table for name, table in tables.items() if not name.endswith(HIGH_G_SUFFIX)}
    high_g = {name.removesuffix(HIGH_G_SUFFIX): table for name, table in tables.items() if name not in others}
    return others, high_g
