"""Result of a comparison of filters: scores, recommended filter, JSON, figures, and text."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from hubodo.arrays import Array
from hubodo.html_table import html_lines, html_table
from hubodo.pages.console import print_lines, print_table
from hubodo.pages.plot import Plot
from hubodo.sensors.filters.bias import BiasEstimate
from hubodo.sensors.filters.candidates import FilterCandidate, StaticState
from hubodo.sensors.filters.page import (
    bias_headings,
    bias_rows,
    filter_figure,
    recommend_filter,
    score_headings,
    score_rows,
    summarise_comparison,
)
from hubodo.sensors.filters.reference import Reference, unit_of_scale

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True, eq=False)
class FilterScore:
    """The errors of one filter.

    Attributes
    ----------
    candidate : FilterCandidate
        Kind and constants of the filter.
    rates : numpy.ndarray
        (N,) estimated rates, rad/s.
    errors : numpy.ndarray
        Error after each sample, rad/s; without a reference that of predicting the next sample.
    tuning_error, error : float
        RMS of the errors in the first half, on which the constants were chosen, and in the second, rad/s.
    delay : float or None
        Delay beyond that of the raw samples, s, by the reference if there is one; None without motion.
    run_time : float
        Run time on this computer per sample, s.
    """

    candidate: FilterCandidate
    rates: Array = field(repr=False)
    errors: Array = field(repr=False)
    tuning_error: float
    error: float
    delay: float | None
    run_time: float

    def as_json(self) -> dict[str, Any]:
        """Return the score as one element of `filters` in the JSON result."""
        return {
            "kind": self.candidate.kind,
            "constants": dict(self.candidate.constants),
            "settings": self.candidate.settings,
            "tuning_error": self.tuning_error,
            "error": self.error,
            "delay": self.delay,
            "run_time_us": self.run_time * 1e6,
        }


@dataclass(frozen=True, eq=False)
class FilterComparison:
    """Filters of one gyro axis, compared on a log.

    Attributes
    ----------
    node, channel : str
        Node and channel.
    dt : float
        Sample interval, s.
    t, samples : numpy.ndarray
        (N,) times, s, and raw samples, rad/s.
    truth : numpy.ndarray or None
        (N,) rates of the reference, rad/s, NaN where it has none.
    reference : Reference or None
        The reference with the delay and scale that were removed.
    standstills : tuple
        (from, to) of each standstill, s.
    standstill_samples : numpy.ndarray
        Raw samples in them, rad/s.
    biases : tuple of BiasEstimate
        Static bias by each method.
    initial : StaticState
        Bias and noise that all filters start from.
    scores : tuple of FilterScore
        One for each filter, raw first.
    is_moving : bool
        True if the axis rotates in both halves.
    chosen : FilterScore or None
        The filter to set on the node.
    notes : tuple of str
        Remarks.
    log : str or None
        Path of the log.
    """

    node: str
    channel: str
    dt: float
    t: Array = field(repr=False)
    samples: Array = field(repr=False)
    truth: Array | None = field(repr=False)
    reference: Reference | None = field(repr=False)
    standstills: tuple[tuple[float, float], ...]
    standstill_samples: Array = field(repr=False)
    biases: tuple[BiasEstimate, ...]
    initial: StaticState
    scores: tuple[FilterScore, ...]
    is_moving: bool
    chosen: FilterScore | None
    notes: tuple[str, ...]
    log: str | None = None

    @property
    def name(self) -> str:
        """Return node and channel as one name."""
        return f"{self.node} {self.channel}"

    @property
    def recommendation(self) -> str:
        """Return the recommended filter in one sentence."""
        return recommend_filter(self)

    @property
    def settings(self) -> dict[str, int] | None:
        """Return the settings of the node for the recommended filter; None if no filter is recommended."""
        return None if self.chosen is None else self.chosen.candidate.settings

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result of `hubodo filters`.

        Returns
        -------
        dict
            The JSON object; rates in rad/s, times in s unless the key says otherwise.
        """
        reference = self.reference
        return {
            "log": self.log,
            "node": self.node,
            "channel": self.channel,
            "duration": float(self.t[-1] - self.t[0]),
            "rate_hz": 1.0 / self.dt,
            "reference": None
            if reference is None
            else {
                "name": reference.name,
                "delay": reference.delay,
                "scale": reference.scale,
                "scale_unit": unit_of_scale(reference),
                "offset": reference.offset,
            },
            "standstills": [list(span) for span in self.standstills],
            "bias": self.initial.bias,
            "noise": self.initial.noise,
            "biases": [
                {"method": it.method, "value": it.bias, "sigma": it.sigma, "held_out": it.held_out}
                for it in self.biases
            ],
            "filters": [score.as_json() for score in self.scores],
            "chosen": None if self.chosen is None else self.chosen.candidate.kind,
            "settings": self.settings,
            "recommendation": self.recommendation,
            "notes": list(self.notes),
        }

    def plot(self) -> Plot:
        """Plot rate, error, bias histogram and autocorrelation of the error.

        Returns
        -------
        Plot
            The figure.
        """
        return Plot(filter_figure(self, f"Filters of {self.name}"))

    def render(self, console: Console) -> None:
        """Print the errors of all filters, the biases, and the settings to use.

        Parameters
        ----------
        console : rich.console.Console
            The console to print to.
        """
        print_lines(console, [summarise_comparison(self)])
        print_table(console, score_headings(self), score_rows(self), self.name)
        if self.biases:
            print_table(console, bias_headings(), bias_rows(self), "static bias")
        print_lines(console, self.notes, label="note")
        print_lines(console, [self.recommendation])

    def __repr__(self) -> str:
        errors = ", ".join(f"{it.candidate.name} {math.degrees(it.error):.3g}" for it in self.scores)
        return f"FilterComparison({self.name}: rms in deg/s: {errors})"

    def _repr_html_(self) -> str:
        return (
            html_lines((summarise_comparison(self),))
            + html_table(score_headings(self), score_rows(self))
            + html_lines((*self.notes, self.recommendation))
        )
