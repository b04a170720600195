"""Result of the noise analysis of one stationary channel: JSON, data frame, figure, and text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from hubodo.arrays import Array
from hubodo.html_table import html_lines, html_table
from hubodo.pages.console import print_lines, print_table
from hubodo.pages.plot import Plot
from hubodo.recording import Table
from hubodo.sensors.allan.datasheet import read_datasheet
from hubodo.sensors.allan.deviation import AllanPoints
from hubodo.sensors.allan.figure import allan_figure
from hubodo.sensors.allan.fit import NoiseFit, NoiseTerm
from hubodo.sensors.allan.ieee952 import rate_unit, term_units
from hubodo.sensors.allan.other_deviations import deviation, spectral_density
from hubodo.sensors.allan.other_statistics import other_statistics_json, other_statistics_table
from hubodo.sensors.allan.page import all_term_rows, hidden_terms_table, summarise_allan, terms_table
from hubodo.sensors.allan.sinusoids import Sinusoid
from hubodo.sensors.even_grid import EvenGrid

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console


@dataclass(frozen=True, eq=False, repr=False)
class AllanResult:
    """The Allan deviation of one channel, with its noise terms.

    Attributes
    ----------
    channel : str
        Name of the channel, `gx` to `gz` or `ax` to `az`.
    points : AllanPoints
        Overlapping Allan deviation at P averaging times.
    edf : (P,) array
        Equivalent degrees of freedom.
    sigma : (P,) array
        1σ of the deviation, rad/s or m/s².
    low, high : (P,) array
        95 % confidence interval of the deviation (chi-square).
    fit : NoiseFit
        The fitted noise terms.
    best_tau, best_deviation : float or None
        Averaging time (s) of the smallest fitted deviation, and that deviation; None if the record is too
        short to show a minimum.
    maytag_stop : float or None
        Recommended length of a stop in maytagging, s; None if no drift is visible.
    maytag_turn : float
        Duration of a turn between stops for which `maytag_stop` was computed, s.
    record : EvenGrid
        The samples on an even grid, with gaps, outliers and excluded spans.
    notes : tuple of str
        Remarks for the user.
    node : str
        Name of the node.
    log : str or None
        Path of the log in the result of the verb.
    sinusoids : tuple of Sinusoid
        Lines that were removed: `frequency`, Hz, `amplitude` and `sigma`, rad/s or m/s².
    also : tuple of str
        What table, page and JSON show beside the Allan deviation: `modified`, `hadamard`, `total`, `psd`.
    """

    channel: str
    points: AllanPoints
    edf: Array
    sigma: Array
    low: Array
    high: Array
    fit: NoiseFit
    best_tau: float | None
    best_deviation: float | None
    maytag_stop: float | None
    maytag_turn: float
    record: EvenGrid
    notes: tuple[str, ...] = ()
    node: str = ""
    log: str | None = None
    sinusoids: tuple[Sinusoid, ...] = ()
    also: tuple[str, ...] = ()

    @property
    def tau(self) -> Array:
        """Return the averaging times, (P,) s."""
        return self.points.tau

    @property
    def adev(self) -> Array:
        """Return the overlapping Allan deviation, (P,) rad/s or m/s²."""
        return self.points.adev

    @property
    def terms(self) -> Mapping[str, NoiseTerm]:
        """Return the terms Q, N, B, K, R of IEEE 952 in SI; `value` is None for unobservable terms."""
        return self.fit.terms

    @property
    def report(self) -> AllanResult:
        """Return the result itself, for programs that read its parts through `report`."""
        return self

    @property
    def name(self) -> str:
        """Return node and channel as one name."""
        return f"{self.node} {self.channel}".strip()

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result of `hubodo allan`.

        Returns
        -------
        dict
            The JSON object.
        """
        units_by_term = term_units(self.channel)
        coefficients = {}
        for name, term in self.fit.terms.items():
            unit = units_by_term[name]
            coefficients[name] = {
                "value": term.value,
                "sigma": term.sigma,
                "unit": unit.si,
                "name": unit.name,
                f"value_{_unit_as_key(unit.common)}": None
                if term.value is None
                else term.value * unit.factor,
            }
            if term.value is None:
                coefficients[name] |= {
                    "reason": term.reason,
                    "limit_95": term.limit,
                    "record_needed_s": term.needed,
                }
            else:
                coefficients[name] |= {"low_95": term.low, "high_95": term.high}
        source = {} if self.log is None else {"log": self.log}
        return {
            **source,
            "node": self.node,
            "tau": self.points.tau.tolist(),
            "adev": self.points.adev.tolist(),
            "sigma": self.sigma.tolist(),
            "low_95": self.low.tolist(),
            "high_95": self.high.tolist(),
            "edf": self.edf.tolist(),
            "coefficients": coefficients,
            "unit": rate_unit(self.channel).si,
            "channel": self.channel,
            "optimum_averaging_time": self.best_tau,
            "smallest_deviation": self.best_deviation,
            "maytag": {"stop": self.maytag_stop, "turn": self.maytag_turn},
            "fit": {
                "chi2": self.fit.chi2,
                "dof": self.fit.dof,
                "relative_misfit": self.fit.misfit,
                "tau": (self.fit.factors * self.points.dt).tolist(),
                "band": self.fit.band,
            },
            "record": {
                "samples": int(np.count_nonzero(self.record.present)),
                "interval": self.record.dt,
                "duration": self.record.duration,
                "gaps": [{"t": t, "missing": missing} for t, missing in self.record.gaps],
                "outliers": self.record.outliers.tolist(),
                "jitter_intervals": None if np.isnan(self.record.jitter) else self.record.jitter,
            },
            "markov": None if self.fit.markov is None else self.fit.markov.as_json(),
            "sinusoids": [it.as_json() for it in self.sinusoids],
            "excluded": [{"start": start, "end": end} for start, end in self.record.excluded],
            "notes": list(self.notes),
            **other_statistics_json(self),
        }

    def deviation(self, kind: Literal["modified", "hadamard", "total"]) -> tuple[Array, Array]:
        """Return another deviation of the record, of its longest span without gaps.

        Parameters
        ----------
        kind : {"modified", "hadamard", "total"}
            Modified Allan, overlapping Hadamard, or total deviation.

        Returns
        -------
        tuple of numpy.ndarray
            (P,) averaging times, s, and (P,) deviations, rad/s or m/s².

        Raises
        ------
        InputError
            If the kind is unknown or no span has eight samples.

        References
        ----------
        NIST Special Publication 1065, eq. 14, 17 and 21.
        """
        return deviation(self.record, kind)

    def spectral_density(self) -> tuple[Array, Array]:
        """Return the one-sided root spectral density of the longest span without gaps, by Welch's method.

        Returns
        -------
        tuple of numpy.ndarray
            (F,) frequencies, Hz, and (F,) root densities, rad/s/√Hz or m/s²/√Hz; white noise has √2 N.
        """
        return spectral_density(self.record)

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
        columns = {"adev": self.adev, "sigma": self.sigma, "low_95": self.low, "high_95": self.high}
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
        return Plot(allan_figure([(self.name, self)], f"Allan deviation of {self.name}", sheets))

    def render(self, console: Console) -> None:
        """Print the noise terms with their meaning, then the best averaging time.

        Parameters
        ----------
        console : rich.console.Console
            The console to print to.
        """
        headings, *rows = all_term_rows(self)
        print_table(console, headings, rows, self.name)
        print_lines(console, [summarise_allan(self)])
        if (table := other_statistics_table(self)) is not None:
            print_table(console, table.headings, table.rows, "other deviations")
        print_lines(console, self.notes, label="note")

    def __repr__(self) -> str:
        values = [f"{name} {term.value:.3g}" for name, term in self.terms.items() if term.value is not None]
        return f"AllanResult({self.name}, {self.record.duration:.0f} s: {', '.join(values)})"

    def _repr_html_(self) -> str:
        tables = [table for table in (terms_table(self), hidden_terms_table(self)) if table.rows]
        return (
            html_lines((f"{self.name}: {summarise_allan(self)}",))
            + "".join(html_table(table.headings, table.rows) for table in tables)
            + html_lines(self.notes)
        )


def _unit_as_key(unit: str) -> str:
    """Return a unit as part of a JSON key: deg/√h becomes deg_per_sqrt_h."""
    return unit.replace("/√", "_per_sqrt_").replace("/", "_per_").replace("µ", "micro_").replace("²", "2")
