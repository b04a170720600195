"""Results of the sensor analyses: Allan deviation and warm-up of one channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hubodo.api.plot import Plot
from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.html_table import html_lines, html_table
from hubodo.recording import Table
from hubodo.report.allan import hidden_terms_table, summarise_allan, terms_table
from hubodo.report.allan_figure import allan_figure
from hubodo.report.warmup import forecast_rows, parameter_rows, summarise_warmup
from hubodo.report.warmup_figure import warmup_figure
from hubodo.sensors.allan.characterise import AllanAnalysis, characterise_noise
from hubodo.sensors.allan.datasheet import read_datasheet
from hubodo.sensors.allan.fit import NoiseTerm
from hubodo.sensors.standstill_channel import StandstillRecord
from hubodo.sensors.warmup.characterise import characterise_warmup
from hubodo.sensors.warmup.result import WarmupAnalysis

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False, repr=False)
class AllanResult:
    """The Allan deviation of one channel, with its noise terms.

    Attributes
    ----------
    node : str
        Name of the node.
    report : AllanReport
        The complete result, with gaps, excluded spans and 95 % intervals.
    """

    node: str
    report: AllanAnalysis

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
        """(P,) 1σ of `adev`."""
        return self.report.sigma

    @property
    def terms(self) -> Mapping[str, NoiseTerm]:
        """Noise terms Q, N, B, K, R of IEEE 952 in SI units; `value` is None if a term is not observable."""
        return self.report.fit.terms

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result of `hubodo allan`.

        Returns
        -------
        dict
            The JSON object.
        """
        return {"node": self.node, **self.report.as_json()}

    def frame(self) -> pd.DataFrame:
        """Return deviation, sigma and 95 % interval as a pandas data frame.

        Returns
        -------
        pandas.DataFrame
            Columns `adev`, `sigma`, `low_95`, `high_95`, indexed by `tau`.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        report = self.report
        columns = {"adev": self.adev, "sigma": self.sigma, "low_95": report.low, "high_95": report.high}
        return Table({"t": self.tau, **columns}).frame().rename_axis("tau")

    def plot(self, datasheets: Sequence[str] = ()) -> Plot:
        """Plot the Allan deviation (log-log) with the fit and its asymptotes.

        Parameters
        ----------
        datasheets : sequence of str
            Data sheet files or known chips to draw for comparison.

        Returns
        -------
        Plot
            The figure.
        """
        sheets = tuple(read_datasheet(name) for name in datasheets)
        return Plot(allan_figure([(self._name, self.report)], f"Allan deviation of {self._name}", sheets))

    @property
    def _name(self) -> str:
        return f"{self.node} {self.report.channel}"

    def __repr__(self) -> str:
        values = [f"{name} {term.value:.3g}" for name, term in self.terms.items() if term.value is not None]
        return f"AllanResult({self._name}, {self.report.record.duration:.0f} s: {', '.join(values)})"

    def _repr_html_(self) -> str:
        grids = [grid for grid in (terms_table(self.report), hidden_terms_table(self.report)) if grid.rows]
        tables = "".join(html_table(grid.headings, grid.rows) for grid in grids)
        return (
            html_lines((f"{self._name}: {summarise_allan(self.report)}",))
            + tables
            + html_lines(self.report.notes)
        )


@dataclass(frozen=True, eq=False, repr=False)
class WarmupResult:
    """The bias of one gyro axis after power-on.

    Attributes
    ----------
    node : str
        Name of the node.
    report : WarmupReport
        The complete result: fitted models, whiteness tests and forecasts.
    """

    node: str
    report: WarmupAnalysis

    @property
    def values(self) -> Mapping[str, float]:
        """Parameters (c1, c2, time_constant, ...) of the accepted model, rad/s and s; empty without one."""
        return {} if self.report.accepted is None else self.report.accepted.fit.values

    @property
    def sigma(self) -> Mapping[str, float]:
        """1σ of `values`, including the uncertainty of the model form."""
        return self.report.sigma

    @property
    def white(self) -> bool:
        """True if the residual of the accepted model is white."""
        return self.report.accepted is not None and self.report.accepted.is_white

    def bias(self, age: float) -> tuple[float, float]:
        """Forecast the bias, averaged over the candidate models.

        Parameters
        ----------
        age : float
            Time since power-on, s.

        Returns
        -------
        tuple of float
            The bias and its 1σ, rad/s.
        """
        row = self.report.predict([age])[0]
        return row["bias"], row["sigma"]

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result of `hubodo warmup`.

        Returns
        -------
        dict
            The JSON object.
        """
        return {"node": self.node, **self.report.as_json(())}

    def plot(self) -> Plot:
        """Plot record, models, residual and forecast.

        Returns
        -------
        Plot
            The figure.
        """
        return Plot(warmup_figure(self.report, f"Warm-up of {self.node} {self.report.channel}"))

    def __repr__(self) -> str:
        values = ", ".join(f"{name} {value:.3g}" for name, value in self.values.items())
        return f"WarmupResult({self.node} {self.report.channel}: {values or self.report.reason})"

    def _repr_html_(self) -> str:
        accepted = self.report.accepted
        html = html_lines((summarise_warmup(self.report),))
        if accepted is not None:
            rows = parameter_rows(accepted, self.report.sigma)
            html += html_table(("parameter", "SI", "common unit"), rows)
        headings = ("since power-on", "all models, deg/s", "accepted model, deg/s")
        return html + html_table(headings, forecast_rows(self.report)) + html_lines(self.report.notes)


def analyse_allan(
    standstill: StandstillRecord, log: str, *, turn: float, per_octave: int, every_sample: bool
) -> AllanResult:
    """Return the Allan analysis of a checked channel; `log` is named in errors."""
    try:
        report = characterise_noise(
            standstill.t,
            standstill.values,
            standstill.channel,
            turn=turn,
            per_octave=per_octave,
            temperature_step=standstill.temperature_step,
            excluded=standstill.disturbances,
            keep_all_samples=every_sample,
        )
    except InputError as error:
        raise InputError(f"{log}, node {standstill.node}, {standstill.channel}: {error}") from None
    return AllanResult(standstill.node, report)


def analyse_warmup(standstill: StandstillRecord, log: str, *, age: float) -> WarmupResult:
    """Return the warm-up model of a checked gyro axis; `log` is named in errors."""
    try:
        report = characterise_warmup(
            standstill.t,
            standstill.values,
            standstill.channel,
            temperature=standstill.temperature,
            age=age,
            temperature_step=standstill.temperature_step,
        )
    except InputError as error:
        raise InputError(f"{log}, node {standstill.node}, {standstill.channel}: {error}") from None
    return WarmupResult(standstill.node, report)
