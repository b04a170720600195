"""Assessment of a warm-up model by the whiteness of its residual, and selection of the next model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.warmup import TEMPERATURE_PARAMETERS, WARMUP_PARAMETERS, WarmupKind
from hubodo.sensors.even_grid import EvenGrid
from hubodo.sensors.warmup.fit import WarmupFit, fit_warmup
from hubodo.sensors.warmup.whiteness import AutocorrelationTest, LjungBox, autocorrelation_test, ljung_box

# The sequences of the paper: ten of 10 s each; limited in samples to bound the run time.
_SEQUENCES, _SEQUENCE_S, _MAX_SEQUENCE_SAMPLES = 10, 10.0, 2000
# °C; smaller changes of temperature do not determine a coefficient, or a polynomial.
_MIN_TEMPERATURE_SPAN, _MIN_POLYNOMIAL_SPAN = 1.0, 5.0
_CLEARLY_BETTER = 0.8
_PARAMETER_UNITS = {
    "time_constant": "s",
    "time_constant_second": "s",
    **dict(zip(TEMPERATURE_PARAMETERS, ("rad/s/°C", "rad/s/°C²", "rad/s/°C³"), strict=True)),
}


@dataclass(frozen=True)
class AssessedFit:
    """A fitted warm-up model with the whiteness tests of its residual."""

    fit: WarmupFit
    autocorrelation: AutocorrelationTest
    ljung_box: LjungBox

    @property
    def is_white(self) -> bool:
        """Return True if both tests pass: samples over seconds, and means over the whole record."""
        return self.autocorrelation.is_white and self.ljung_box.is_white

    def as_json(self) -> dict[str, Any]:
        """Return parameters and tests as in `next_model` of `hubodo warmup --json`."""
        parameters = {
            name: {
                "value": self.fit.values[name],
                "sigma": self.fit.sigma[name],
                "unit": parameter_unit(name),
            }
            for name in WARMUP_PARAMETERS[self.fit.kind]
        }
        return {
            "kind": self.fit.kind,
            "parameters": parameters,
            "white": self.is_white,
            "whiteness": self.whiteness_json(),
        }

    def whiteness_json(self) -> dict[str, Any]:
        """Return both tests as in `whiteness` of `hubodo warmup --json`."""
        test, box = self.autocorrelation, self.ljung_box
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


def parameter_unit(name: str) -> str:
    """Return the SI unit of a warm-up parameter."""
    return _PARAMETER_UNITS.get(name, "rad/s")


def assess_fit(fit: WarmupFit, record: EvenGrid, age: float, temperature: Array | None) -> AssessedFit:
    """Test the whiteness of the samples in short sequences, and of the means over the whole record.

    record: samples at the gyro's rate. age: time since power-on at the first sample, s. temperature: (N,)
    °C at the samples of the record, or None.
    """
    length = int(np.clip(round(_SEQUENCE_S / record.dt), 200, _MAX_SEQUENCE_SAMPLES))
    length = min(length, len(record.values))
    sequences = max(1, min(_SEQUENCES, len(record.values) // length))
    residuals = []
    for start in np.linspace(0, len(record.values) - length, sequences).astype(int):
        rows = slice(int(start), int(start) + length)
        t = np.asarray(age + np.arange(rows.start, rows.stop) * record.dt, np.float64)
        residual = record.values[rows] - fit.model.bias(t, None if temperature is None else temperature[rows])
        residuals.append(np.where(record.present[rows], residual, 0.0))
    samples = np.concatenate(residuals)
    return AssessedFit(fit, autocorrelation_test(samples, sequences, length), ljung_box(fit.residual))


def is_clearly_smaller(model: AssessedFit, first: AssessedFit) -> bool:
    """Return True if the residual of a model is clearly smaller than that of the first one."""
    return model.fit.noise < _CLEARLY_BETTER * first.fit.noise


def is_sufficient(model: AssessedFit, first: AssessedFit) -> bool:
    """Return True if a model leaves white residuals, or clearly smaller ones than the first model."""
    return model.ljung_box.is_white or is_clearly_smaller(model, first)


def select_next_model(
    first: AssessedFit,
    times: Array,
    means: Array,
    mean_temperatures: Array | None,
    record: EvenGrid,
    t: Array,
    temperature: Array | None,
    age: float,
) -> AssessedFit | None:
    """Return the best model with a white residual, else the smallest or least coloured one, or None.

    Models that are not clearly better than the exponential are not considered.
    """
    kinds: list[WarmupKind] = ["two exponentials"]
    sample_temperatures = None
    if (
        mean_temperatures is not None
        and temperature is not None
        and float(np.ptp(mean_temperatures)) > _MIN_TEMPERATURE_SPAN
    ):
        kinds = ["temperature", "exponential and temperature", *kinds]
        if float(np.ptp(mean_temperatures)) > _MIN_POLYNOMIAL_SPAN:
            kinds += [
                "quadratic temperature",
                "cubic temperature",
                "exponential and quadratic temperature",
            ]
        sample_temperatures = np.interp(
            record.start + np.arange(len(record.values)) * record.dt, t, temperature
        )
    candidates = []
    for kind in kinds:
        uses_temperature = "temperature_coefficient" in WARMUP_PARAMETERS[kind]
        fit = fit_warmup(times, means, kind, mean_temperatures if uses_temperature else None)
        # A model whose parameters are not determined is rejected, however well it fits.
        if fit.is_determined and fit.bic < first.fit.bic - 10.0:
            candidates.append(assess_fit(fit, record, age, sample_temperatures if uses_temperature else None))
    white = [model for model in candidates if model.ljung_box.is_white]
    if white:
        return min(white, key=lambda model: model.fit.bic)
    # Hysteresis leaves a residual as coloured as before, but much smaller.
    smaller = [model for model in candidates if is_clearly_smaller(model, first)]
    if smaller:
        return min(smaller, key=lambda model: model.fit.bic)
    statistic = first.ljung_box.statistic
    better = [model for model in candidates if model.ljung_box.statistic < _CLEARLY_BETTER * statistic]
    return min(better, key=lambda model: model.ljung_box.statistic, default=None)


def describe_next_model(first: AssessedFit, following: AssessedFit | None) -> str:
    """Return a remark on the coloured residual of the exponential and on the next model."""
    box = first.ljung_box
    test = f"Ljung-Box {box.statistic:.3g} over {box.lags} lags, p = {box.p_value:.2g}"
    if following is None:
        return (
            f"the residual of the exponential is not white ({test}) and no other model is significantly "
            "better: the residual is bias instability or random walk, see hubodo allan; the sigmas "
            "include it"
        )
    description = "white" if following.ljung_box.is_white else "still not white, but less so"
    return (
        f"the residual of the exponential is not white ({test}); next model: {following.fit.kind}, whose "
        f"residual is {description} (Ljung-Box {following.ljung_box.statistic:.3g}, p = "
        f"{following.ljung_box.p_value:.2g})"
    )
