"""Result of the warm-up analysis of one gyro axis: model, forecast, JSON, figure, and text."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import CalibratedEffect
from hubodo.effects.warmup import TEMPERATURE_PARAMETERS, WARMUP_PARAMETERS, warmup_fraction
from hubodo.errors import InputError
from hubodo.html_table import html_lines, html_table
from hubodo.pages.console import print_lines, print_table
from hubodo.pages.plot import Plot
from hubodo.sensors.even_grid import EvenGrid
from hubodo.sensors.warmup.assess import AssessedFit, parameter_unit
from hubodo.sensors.warmup.bias_method import BiasMethodChoice, choose_bias_method
from hubodo.sensors.warmup.effects import effects_of_fit
from hubodo.sensors.warmup.figure import warmup_figure
from hubodo.sensors.warmup.fit import WarmupFit
from hubodo.sensors.warmup.forecast import (
    SIGMA_HORIZON_S,
    BiasForecast,
    StatedForm,
    fit_forecast,
    forecast_inflation,
)
from hubodo.sensors.warmup.hysteresis import Hysteresis, find_hysteresis
from hubodo.sensors.warmup.page import (
    TEST_HEADINGS,
    forecast_headings,
    forecast_rows,
    parameter_headings,
    parameter_rows,
    summarise_warmup,
    warmup_advice,
    whiteness_rows,
)
from hubodo.sensors.warmup.profile_interval import ProfileIntervals, profile_intervals
from hubodo.sensors.warmup.remarks import NOTED_INFLATION, forecast_remarks

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True, eq=False, repr=False)
class WarmupResult:
    """The bias of one gyro axis after power-on.

    Attributes
    ----------
    channel : str
        Name of the channel, `gx`, `gy` or `gz`.
    exponential : AssessedFit
        The single exponential, with its whiteness tests.
    reason : str
        Reason why c1 and time constant of the exponential are not given, empty if they are.
    next_model : AssessedFit or None
        The next model; None if the exponential is white or no other model is better.
    accepted : AssessedFit or None
        The model that the record supports.
    age : float
        Time since power-on at the first sample, s.
    t, means : (M,) array
        Times since power-on (s) and block means (rad/s) that were fitted.
    mean_temperatures : (M,) array or None
        Temperatures of the block means, °C.
    record : EvenGrid
        The samples on an even grid, with gaps and outliers.
    notes : tuple of str
        Remarks for the user.
    node : str
        Name of the node.
    ages : tuple of float
        Times since power-on to forecast, s; by default within and after the record.
    log, output : str or None
        Path of the log and of the calibration file in the result of the verb.
    rounding : float
        1σ of the error of all means that rounding to steps causes, rad/s.
    form : str or None
        Form that the user stated, in place of the average of all forms.
    """

    channel: str
    exponential: AssessedFit
    reason: str
    next_model: AssessedFit | None
    accepted: AssessedFit | None
    age: float
    t: Array
    means: Array
    mean_temperatures: Array | None
    record: EvenGrid
    notes: tuple[str, ...]
    node: str = ""
    ages: tuple[float, ...] = ()
    log: str | None = None
    output: str | None = None
    rounding: float = 0.0
    form: StatedForm | None = None

    @property
    def values(self) -> Mapping[str, float]:
        """Return the accepted model's parameters (c1, c2, time_constant, ...), rad/s and s, or no entry."""
        return {} if self.accepted is None else self.accepted.fit.values

    @property
    def white(self) -> bool:
        """Return True if the residual of the accepted model is white."""
        return self.accepted is not None and self.accepted.is_white

    @property
    def report(self) -> WarmupResult:
        """Return the result itself, for programs that read its parts through `report`."""
        return self

    @property
    def name(self) -> str:
        """Return node and channel as one name."""
        return f"{self.node} {self.channel}".strip()

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
        row = self.predict([age])[0]
        return row["bias"], row["sigma"]

    @cached_property
    def intervals(self) -> ProfileIntervals:
        """Return 95 % intervals of c1 and time constant of the exponential by its profile likelihood."""
        fit = self.exponential.fit
        return profile_intervals(self.t, self.means, fit.noise**2 * fit.variance_inflation)

    @cached_property
    def forecast(self) -> BiasForecast:
        """Return the forecast of the bias at any age, averaged over all candidate forms."""
        span = float(self.t[-1] - self.t[0])
        fit = (self.accepted or self.exponential).fit
        values, order = fit.values, max(fit.temperature_order, 1)
        constants = [values[name] for name in ("time_constant", "time_constant_second") if name in values]
        initial = [min(max(constant, span / 50.0), 10.0 * span) for constant in constants]
        for candidate in (span / 4.0, span / 20.0):
            if len(initial) < 2 and all(abs(math.log(candidate / one)) > 0.5 for one in initial):
                initial.append(candidate)
        constants_at_start = (*initial, span / 8.0)[:2]
        forecast = fit_forecast(
            self.t,
            self.means,
            self.mean_temperatures,
            constants_at_start,
            temperature_order=order,
            stated_form=self.form,
        )
        inflation = forecast_inflation(
            self.t, self.means, self.mean_temperatures, constants_at_start, order, self.form
        )
        if self.form is not None and inflation < NOTED_INFLATION:
            # The test of three means exceeds 1 by chance; a stated form is doubted only if clearly wrong.
            inflation = 1.0
        return replace(forecast, rounding=self.rounding, inflation=inflation)

    @cached_property
    def hysteresis(self) -> Hysteresis | None:
        """Return the difference between rising and falling temperature, if it is significant."""
        if self.accepted is None or self.mean_temperatures is None or not self.accepted.fit.temperature_order:
            return None
        return find_hysteresis(
            self.t, self.mean_temperatures, self.accepted.fit.residual, self.accepted.fit.temperature_order
        )

    @property
    def remarks(self) -> tuple[str, ...]:
        """Return the notes, and whether the record forecasts itself."""
        return (*self.notes, *forecast_remarks(self.form, self.hysteresis, self.forecast.inflation))

    @cached_property
    def sigma(self) -> dict[str, float]:
        """Return the sigmas of the accepted model's parameters, including the uncertainty of its form.

        They are inflated such that the bias sigma that follows from them is at least that of `forecast`,
        up to `SIGMA_HORIZON_S` beyond the record: c2 by the error of the form within the record, the c1 of
            the slower exponential by its error beyond. The result is empty without an accepted model.
        """
        if self.accepted is None:
            return {}
        fit, end = self.accepted.fit, float(self.t[-1])
        constants = {name: value for name, value in fit.values.items() if name.startswith("time_constant")}
        result = dict(fit.sigma)
        form_variance = self._form_variance(np.linspace(self.t[0], end, 9))
        result["c2"] = math.hypot(result["c2"], math.sqrt(float(form_variance.mean())))
        if self.hysteresis is not None:
            result["c2"] = math.hypot(result["c2"], 0.5 * self.hysteresis.size)
        if fit.temperature_order:
            names = TEMPERATURE_PARAMETERS[: fit.temperature_order]
            errors = self.forecast.polynomial_error(np.array([fit.values[name] for name in names]))
            result |= {name: max(result[name], float(e)) for name, e in zip(names, errors, strict=True)}
        if not constants:
            return result
        slowest = max(constants, key=lambda name: constants[name])
        ages_beyond = end + SIGMA_HORIZON_S * np.linspace(0.0, 1.0, 7)
        warmup_share = np.maximum(warmup_fraction(ages_beyond, fit.values[slowest]), 0.3)
        c1_sigma = float(np.sqrt(np.max(self._form_variance(ages_beyond) / warmup_share**2)))
        name = slowest.replace("time_constant", "c1")
        result[name] = math.hypot(result[name], c1_sigma)
        return result

    def _form_variance(self, age: Array) -> Array:
        """Return the (M,) variance of the accepted model's error, (rad/s)², beyond that of its parameters."""
        assert self.accepted is not None
        fit = self.accepted.fit
        temperatures = (
            None if self.mean_temperatures is None else np.interp(age, self.t, self.mean_temperatures)
        )
        error_sigma = self.forecast.model_error(age, fit.model.bias(age, temperatures), temperatures)
        return np.maximum(error_sigma**2 - fit.bias_sigma(age, temperatures) ** 2, 0.0)

    @cached_property
    def bias_method(self) -> BiasMethodChoice | None:
        """Return the best bias estimator after a standstill, judged with the accepted model removed."""
        record = self.record
        t = np.asarray(self.age + np.arange(len(record.values)) * record.dt, np.float64)
        values = record.values
        if self.accepted is not None:
            temperatures = (
                None
                if self.mean_temperatures is None
                else np.asarray(np.interp(t, self.t, self.mean_temperatures))
            )
            values = values - self.accepted.fit.model.bias(t, temperatures)
        return choose_bias_method(values[record.present], record.dt)

    def predict(self, ages: Sequence[float] = ()) -> list[dict[str, float]]:
        """Return the forecast bias with its sigma, and the accepted model, at several ages.

        Parameters
        ----------
        ages : sequence of float
            Times since power-on, s; by default within and after the record.

        Returns
        -------
        list of dict
            `age`, `bias`, `sigma`, and `accepted`, `accepted_sigma` if there is an accepted model.
        """
        t = np.asarray(ages, np.float64)
        if not len(t):
            initial, end = float(self.t[0]), float(self.t[-1])
            t = np.array([initial, 0.5 * (initial + end), end, end + 3600.0, end + SIGMA_HORIZON_S])
        temperatures = (
            None if self.mean_temperatures is None else np.interp(t, self.t, self.mean_temperatures)
        )
        bias, sigma = self.forecast.predict(t, temperatures)
        rows = [
            {"age": float(x), "bias": float(y), "sigma": float(z)}
            for x, y, z in zip(t, bias, sigma, strict=True)
        ]
        if self.accepted is not None:
            accepted_bias = self.accepted.fit.model.bias(t, temperatures)
            error_sigma = self.forecast.model_error(t, accepted_bias, temperatures)
            for row, value, spread in zip(rows, accepted_bias, error_sigma, strict=True):
                row |= {"accepted": float(value), "accepted_sigma": float(spread)}
        return rows

    def calibrated_effects(self) -> dict[str, CalibratedEffect]:
        """Return the accepted model as effects of the calibration file, for this axis.

        Returns
        -------
        dict
            The effects by name.

        Raises
        ------
        InputError
            If no model is accepted.
        """
        if self.accepted is None:
            raise InputError(f"nothing to write to a calibration file: {self.reason}")
        return effects_of_fit(self.accepted.fit, self.sigma, self.channel[1])

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result of `hubodo warmup`.

        c1, c2 and time_constant are those of the accepted model if it has one exponential, with sigmas
        that include the uncertainty of its form. Without an accepted model, c2 of the exponential is given,
        and 95 % intervals of c1 and time_constant, an open end as null.

        Returns
        -------
        dict
            The JSON object.
        """
        fit = (self.accepted or self.exponential).fit
        sigma = self.sigma or fit.sigma
        single = self.accepted is not None and "c1" in fit.values and "c1_second" not in fit.values
        result: dict[str, Any] = {} if self.log is None else {"log": self.log}
        result["node"] = self.node
        if self.log is not None:
            result["output"] = self.output
        for name in WARMUP_PARAMETERS["exponential"]:
            is_given = single or name == "c2"
            result[name] = {
                "value": fit.values[name] if is_given else None,
                "sigma": sigma[name] if is_given else None,
                "unit": parameter_unit(name),
            }
            if is_given and name != "time_constant":
                result[name] |= {"value_deg_per_s": math.degrees(fit.values[name])}
            if not is_given:
                result[name] |= {"reason": self.reason or next_model_reason(fit)}
            if self.accepted is None and name != "c2":
                result[name] |= {"interval": self.intervals.ends(name)}
        return result | {
            "white": self.exponential.is_white,
            "whiteness": self.exponential.whiteness_json(),
            "next_model": None if self.next_model is None else self.next_model.as_json(),
            "accepted": None if self.accepted is None else fit.kind,
            "prediction": self.predict(self.ages),
            "bias_filter": None if self.bias_method is None else asdict(self.bias_method),
            "channel": self.channel,
            "age_at_start": self.age,
            "duration": self.record.duration,
            "residual_noise": fit.noise,
            "form": self.form,
            "forecast_inflation": self.forecast.inflation,
            "hysteresis": None if self.hysteresis is None else asdict(self.hysteresis),
            "notes": list(self.remarks),
        }

    def plot(self) -> Plot:
        """Plot record, models, residual and forecast.

        Returns
        -------
        Plot
            The figure.
        """
        return Plot(warmup_figure(self, f"Warm-up of {self.name}"))

    def render(self, console: Console) -> None:
        """Print the accepted model, the whiteness tests and the forecast bias.

        Parameters
        ----------
        console : rich.console.Console
            The console to print to.
        """
        if self.accepted is not None:
            title = f"{self.name}: {self.accepted.fit.kind}"
            print_table(console, parameter_headings(), parameter_rows(self.accepted, self.sigma), title)
        print_table(console, TEST_HEADINGS, whiteness_rows(self.exponential), "exponential")
        if self.next_model is not None:
            print_table(console, TEST_HEADINGS, whiteness_rows(self.next_model), self.next_model.fit.kind)
        print_table(console, forecast_headings(), forecast_rows(self, self.ages), "forecast bias")
        print_lines(console, [summarise_warmup(self)])
        print_lines(console, self.remarks, label="note")
        print_lines(console, warmup_advice(self))
        if self.output:
            print_lines(console, [f"written to {self.output}"])

    def __repr__(self) -> str:
        values = ", ".join(f"{name} {value:.3g}" for name, value in self.values.items())
        return f"WarmupResult({self.name}: {values or self.reason})"

    def _repr_html_(self) -> str:
        html = html_lines((summarise_warmup(self),))
        if self.accepted is not None:
            html += html_table(parameter_headings(), parameter_rows(self.accepted, self.sigma))
        return html + html_table(forecast_headings(), forecast_rows(self)) + html_lines(self.remarks)


def next_model_reason(fit: WarmupFit) -> str:
    """Return the reason why a single exponential is not given; empty if the next model contains it."""
    if fit.kind == "exponential and temperature":
        return ""
    return f"a single exponential does not describe this record; see next model: {fit.kind}"
