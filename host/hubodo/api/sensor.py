"""What a sensor at rest is worth, as Python programs use it: Allan deviation and warm-up of one channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hubodo.api.plot import Plot
from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.html_table import html_lines, html_table
from hubodo.recording import Table
from hubodo.report.allan import allan_lead, missing_grid, terms_grid
from hubodo.report.allan_figure import allan_figure
from hubodo.report.warmup import parameter_rows, prediction_rows, warmup_lead
from hubodo.report.warmup_figure import warmup_figure
from hubodo.sensors.allan.characterise import AllanReport, characterise_noise
from hubodo.sensors.allan.datasheet import read_datasheet
from hubodo.sensors.allan.fit import NoiseTerm
from hubodo.sensors.standstill_channel import StandstillRecord
from hubodo.sensors.warmup.characterise import characterise_warmup
from hubodo.sensors.warmup.result import WarmupReport

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False, repr=False)
class AllanResult:
    """The Allan deviation of one channel with its noise terms.

    Attributes:
        node: whose channel it is.
        report: everything, with gaps, cut-out stretches and 95 % intervals.
    """

    node: str
    report: AllanReport

    @property
    def tau(self) -> Array:
        """(P,) averaging times, s."""
        return self.report.points.tau

    @property
    def adev(self) -> Array:
        """(P,) overlapping Allan deviation, rad/s or m/s²."""
        return self.report.points.adev

    @property
    def sigma(self) -> Array:
        """(P,) 1 sigma of `adev`."""
        return self.report.sigma

    @property
    def terms(self) -> Mapping[str, NoiseTerm]:
        """Q, N, B, K, R of IEEE 952 in SI; where the record cannot show one its `value` is None."""
        return self.report.fit.terms

    def as_json(self) -> dict[str, Any]:
        """The form of `hubodo allan --json`."""
        return {"node": self.node, **self.report.as_json()}

    def frame(self) -> pd.DataFrame:
        """Deviation, sigma and 95 % interval with `tau` as the index. Raises InputError without pandas."""
        report = self.report
        columns = {"adev": self.adev, "sigma": self.sigma, "low_95": report.low, "high_95": report.high}
        return Table({"t": self.tau, **columns}).frame().rename_axis("tau")

    def plot(self, datasheets: Sequence[str] = ()) -> Plot:
        """The log-log figure with fit and asymptotes.

        Args:
            datasheets: files, or names of chips that are known, to draw beside it.
        """
        sheets = tuple(read_datasheet(name) for name in datasheets)
        return Plot(allan_figure([(self._name, self.report)], f"Allan deviation of {self._name}", sheets))

    @property
    def _name(self) -> str:
        return f"{self.node} {self.report.channel}"

    def __repr__(self) -> str:
        shown = [f"{name} {term.value:.3g}" for name, term in self.terms.items() if term.value is not None]
        return f"AllanResult({self._name}, {self.report.record.duration:.0f} s: {', '.join(shown)})"

    def _repr_html_(self) -> str:
        grids = [grid for grid in (terms_grid(self.report), missing_grid(self.report)) if grid.rows]
        tables = "".join(html_table(grid.headings, grid.rows) for grid in grids)
        return (
            html_lines((f"{self._name}: {allan_lead(self.report)}",)) + tables + html_lines(self.report.notes)
        )


@dataclass(frozen=True, eq=False, repr=False)
class WarmupResult:
    """The bias of one gyro axis after power-on.

    Attributes:
        node: whose axis it is.
        report: everything: the models tried, their tests for whiteness, the forecast.
    """

    node: str
    report: WarmupReport

    @property
    def values(self) -> Mapping[str, float]:
        """c2, c1, time_constant and so on of the accepted model, rad/s and s; empty where none holds."""
        return {} if self.report.accepted is None else self.report.accepted.fit.values

    @property
    def sigma(self) -> Mapping[str, float]:
        """1 sigma of `values`, with what the model's form may be wrong by."""
        return self.report.sigma

    @property
    def white(self) -> bool:
        """Whether the residual of the accepted model is white."""
        return self.report.accepted is not None and self.report.accepted.is_white

    def bias(self, age: float) -> tuple[float, float]:
        """The bias so many seconds after power-on and its 1 sigma, rad/s, over all forms of warm-up."""
        row = self.report.predict([age])[0]
        return row["bias"], row["sigma"]

    def as_json(self) -> dict[str, Any]:
        """The form of `hubodo warmup --json`."""
        return {"node": self.node, **self.report.as_json(())}

    def plot(self) -> Plot:
        """Record, models, residual and forecast."""
        return Plot(warmup_figure(self.report, f"Warm-up of {self.node} {self.report.channel}"))

    def __repr__(self) -> str:
        values = ", ".join(f"{name} {value:.3g}" for name, value in self.values.items())
        return f"WarmupResult({self.node} {self.report.channel}: {values or self.report.reason})"

    def _repr_html_(self) -> str:
        accepted = self.report.accepted
        made = html_lines((warmup_lead(self.report),))
        if accepted is not None:
            rows = parameter_rows(accepted, self.report.sigma)
            made += html_table(("parameter", "SI", "customary"), rows)
        heads = ("since power-on", "all forms, deg/s", "accepted model, deg/s")
        return made + html_table(heads, prediction_rows(self.report)) + html_lines(self.report.notes)


def allan_of(
    rest: StandstillRecord, log: str, *, turn: float, per_octave: int, every_sample: bool
) -> AllanResult:
    """Of a channel that was checked; log: named in errors."""
    try:
        report = characterise_noise(
            rest.t,
            rest.values,
            rest.channel,
            turn=turn,
            per_octave=per_octave,
            temperature_step=rest.temperature_step,
            excluded=rest.disturbances,
            keep_all_samples=every_sample,
        )
    except InputError as error:
        raise InputError(f"{log}, node {rest.node}, {rest.channel}: {error}") from None
    return AllanResult(rest.node, report)


def warmup_of(rest: StandstillRecord, log: str, *, age: float) -> WarmupResult:
    """Of a gyro axis that was checked; log: named in errors."""
    try:
        report = characterise_warmup(
            rest.t,
            rest.values,
            rest.channel,
            temperature=rest.temperature,
            age=age,
            temperature_step=rest.temperature_step,
        )
    except InputError as error:
        raise InputError(f"{log}, node {rest.node}, {rest.channel}: {error}") from None
    return WarmupResult(rest.node, report)
