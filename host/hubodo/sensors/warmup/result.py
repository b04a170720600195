"""Result of the warm-up analysis of one gyro axis: accepted model, its sigmas, forecast and JSON form."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import CalibratedEffect, Quantity
from hubodo.effects.warmup import WARMUP_PARAMETERS, warmup_fraction
from hubodo.errors import InputError
from hubodo.sensors.even_grid import EvenGrid
from hubodo.sensors.warmup.assess import AssessedFit
from hubodo.sensors.warmup.bias_method import BiasMethodChoice, choose_bias_method
from hubodo.sensors.warmup.fit import WarmupFit
from hubodo.sensors.warmup.forecast import BiasForecast, fit_forecast

SIGMA_HORIZON_S = 3.0 * 3600.0
"""The sigmas of an accepted model hold up to this time beyond the record, s."""
_PARAMETER_UNITS = {"time_constant": "s", "time_constant_second": "s", "temperature_coefficient": "rad/s/°C"}


@dataclass(frozen=True)
class WarmupAnalysis:
    """The warm-up of one gyro axis as shown by a record.

    Attributes:
        channel: gx, gy or gz.
        exponential: the single exponential of the paper, with its tests.
        reason: reason why c1 and time constant of the exponential are not given, empty if they are.
        next_model: the next model, None if the exponential is white or no other model is better.
        accepted: the model that the record supports, or None.
        age: time since power-on at the first sample, s.
        t, means: (M,) times since power-on (s) and block means (rad/s) that were fitted.
        mean_temperatures: (M,) °C or None.
        record: the samples on an even grid, with gaps and outliers.
        notes: remarks for the user.
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

    @cached_property
    def forecast(self) -> BiasForecast:
        """Return the forecast of the bias at any age, averaged over all candidate forms."""
        span = float(self.t[-1] - self.t[0])
        values = (self.accepted or self.exponential).fit.values
        constants = [values[name] for name in ("time_constant", "time_constant_second") if name in values]
        initial = [min(max(constant, span / 50.0), 10.0 * span) for constant in constants]
        for candidate in (span / 4.0, span / 20.0):
            if len(initial) < 2 and all(abs(math.log(candidate / one)) > 0.5 for one in initial):
                initial.append(candidate)
        return fit_forecast(self.t, self.means, self.mean_temperatures, (*initial, span / 8.0)[:2])

    @cached_property
    def sigma(self) -> dict[str, float]:
        """Return the sigmas of the accepted model's parameters, including the uncertainty of its form.

        They are inflated such that the bias sigma that follows from them is at least that of `forecast`,
        up to `SIGMA_HORIZON_S` beyond the record: c2 by the error of the form within the record, the c1 of
        the slower exponential by its error beyond. Empty without an accepted model.
        """
        if self.accepted is None:
            return {}
        fit, end = self.accepted.fit, float(self.t[-1])
        constants = {name: value for name, value in fit.values.items() if name.startswith("time_constant")}
        result = dict(fit.sigma)
        form_variance = self._form_variance(np.linspace(self.t[0], end, 9))
        result["c2"] = math.hypot(result["c2"], math.sqrt(float(form_variance.mean())))
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
        """Return the best bias estimator after a standstill (mean or filter), beside the accepted model."""
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
        """Return bias, sigma and accepted model at ages (s), by default within and after the record."""
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

        Raises InputError without an accepted model.
        """
        axis = self.channel[1]
        if self.accepted is None:
            raise InputError(f"nothing to write to a calibration file: {self.reason}")
        fit = self.accepted.fit

        def quantity(name: str) -> Quantity:
            return Quantity(fit.values[name], self.sigma[name])

        method = f"warm-up at rest, {fit.kind}"
        result = {"gyro_bias": CalibratedEffect({axis: quantity("c2")}, method)}
        temperatures = {}
        for suffix in ("", "_second"):
            if f"c1{suffix}" in fit.values:
                temperatures[axis + suffix] = quantity(f"c1{suffix}")
                temperatures[f"time_constant{suffix}"] = quantity(f"time_constant{suffix}")
        if temperatures:
            result["gyro_warmup"] = CalibratedEffect(temperatures, method)
        if "temperature_coefficient" in fit.values:
            result["gyro_temperature"] = CalibratedEffect({axis: quantity("temperature_coefficient")}, method)
        return result

    def as_json(self, ages: Sequence[float] = ()) -> dict[str, Any]:
        """Return the result as in `hubodo warmup --json`; ages: s, as in `predict`.

        c1, c2 and time_constant are those of the accepted model if it has one exponential, with sigmas
        that include the uncertainty of its form. Without an accepted model, only c2 of the exponential is
        given.
        """
        fit = (self.accepted or self.exponential).fit
        sigma = self.sigma or fit.sigma
        single = self.accepted is not None and "c1" in fit.values and "c1_second" not in fit.values
        result: dict[str, Any] = {}
        for name in WARMUP_PARAMETERS["exponential"]:
            is_given = single or name == "c2"
            result[name] = {
                "value": fit.values[name] if is_given else None,
                "sigma": sigma[name] if is_given else None,
                "unit": _PARAMETER_UNITS.get(name, "rad/s"),
            }
            if is_given and name != "time_constant":
                result[name] |= {"value_deg_per_s": math.degrees(fit.values[name])}
            if not is_given:
                result[name] |= {"reason": self.reason or next_model_reason(fit)}
        return result | {
            "white": self.exponential.is_white,
            "whiteness": _whiteness_json(self.exponential),
            "next_model": None if self.next_model is None else _model_json(self.next_model),
            "accepted": None if self.accepted is None else fit.kind,
            "prediction": self.predict(ages),
            "bias_filter": None if self.bias_method is None else asdict(self.bias_method),
            "channel": self.channel,
            "age_at_start": self.age,
            "duration": self.record.duration,
            "residual_noise": fit.noise,
            "notes": list(self.notes),
        }


def next_model_reason(fit: WarmupFit) -> str:
    """Return the reason why a single exponential is not given; empty if the next model contains it."""
    if fit.kind == "exponential and temperature":
        return ""
    return f"a single exponential does not describe this record; see next model: {fit.kind}"


def _whiteness_json(assessed: AssessedFit) -> dict[str, Any]:
    test, box = assessed.autocorrelation, assessed.ljung_box
    return {
        "autocorrelation": {
            "white": test.is_white,
            "p_value": test.p_value,
            "sequences": test.sequences,
            "length": test.length,
            "standard_error": test.standard_error,
            "inside_one": test.share_within_one_sigma,
            "inside_two": test.share_within_two_sigma,
            "expected_one": test.expected_share_within_one_sigma,
            "expected_two": test.expected_share_within_two_sigma,
        },
        "ljung_box": {
            "white": box.is_white,
            "p_value": box.p_value,
            "statistic": box.statistic,
            "lags": box.lags,
        },
    }


def _model_json(assessed: AssessedFit) -> dict[str, Any]:
    fit = assessed.fit
    parameters = {
        name: {
            "value": fit.values[name],
            "sigma": fit.sigma[name],
            "unit": _PARAMETER_UNITS.get(name, "rad/s"),
        }
        for name in WARMUP_PARAMETERS[fit.kind]
    }
    return {
        "kind": fit.kind,
        "parameters": parameters,
        "white": assessed.is_white,
        "whiteness": _whiteness_json(assessed),
    }
