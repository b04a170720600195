"""Settings of a node derived from its calibration, for its /config.json.

The node does not correct the samples that it sends: they stay raw, beside its own bias estimate. The
correction of a log by the same calibration in `calibration/apply.py` is therefore applied only once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from hubodo.calibration.file import CalibratedEffect, NodeCalibration, Quantity
from hubodo.effects.triad import XYZ
from hubodo.errors import CalibrationError

Setting = int | list[int]

# Defaults of firmware/settings.py; a test compares them.
_DEFAULT_NOISE_UDPS, _DEFAULT_GAIN_RATE_Q20, _DEFAULT_RATE_HZ = 75000, 314573, 416

FROM_CALIBRATION = (
    "bias_udps",
    "warmup_udps",
    "warmup_s",
    "warmup_second",
    "gyro_scale_ppm",
    "gyro_scale_sigma_ppm",
    "arm_mm",
    "gain_bias_q30",
)
"""Settings determined by a calibration; those that it lacks return to their defaults."""

_MAX_UDPS, _MAX_PPM, _MAX_MM, _MAX_GAIN_Q30 = 30_000_000, 200_000, 1000, (1 << 20) - 1
_MIN_TIME_CONSTANT_S, _MAX_TIME_CONSTANT_S = 10, 100_000


def node_settings(node: NodeCalibration, config: Mapping[str, object]) -> dict[str, Setting]:
    """Return the settings of FROM_CALIBRATION for a calibrated node.

    config: present settings of the node, for its rate, noise and gain of the rate. gyro_bias and gyro_warmup
    give the initial bias; gyro_scale_factor z and lever_arm serve the bias from gravity; the random walk k of
    gyro_rate_random_walk gives the bias gain: eq. 6-8 of Shah et al. converge to K_b / K_w = q_b / q_w and
    (q_w + q_b) / q_n = K^2 / (1 - K), so K_b = (k^2 dt / q_n) (1 - K) / K. K: gain of the rate; K_b, K_w:
    gains of bias and rate; q_b, q_w, q_n: variances of bias walk, rate walk and sample noise; dt: sample
    period. Raises CalibrationError for numbers out of the node's range.
    """
    effects, settings = node.effects, dict[str, Setting]()
    if "gyro_bias" in effects:
        settings["bias_udps"] = _udps("gyro_bias", effects["gyro_bias"])
    if "gyro_warmup" in effects:
        settings |= _warm_up(effects["gyro_warmup"])
    if "gyro_scale_factor" in effects:
        scale = effects["gyro_scale_factor"].parameters.get("z", Quantity(0.0, 0.0))
        ppm = scale.value * 1e6
        settings["gyro_scale_ppm"] = _within("gyro_scale_factor z", ppm, "ppm", -_MAX_PPM, _MAX_PPM)
        if scale.sigma:
            settings["gyro_scale_sigma_ppm"] = min(math.ceil(scale.sigma * 1e6), _MAX_PPM)
    if "lever_arm" in effects:
        arm = effects["lever_arm"]
        settings["arm_mm"] = [
            _within(f"lever_arm {axis}", arm.value(axis) * 1e3, "mm", -_MAX_MM, _MAX_MM) for axis in XYZ[:2]
        ]
    if "gyro_rate_random_walk" in effects:
        gain = _bias_gain(effects["gyro_rate_random_walk"].value("k"), config)
        settings["gain_bias_q30"] = min(round(gain * 2**30), _MAX_GAIN_Q30)
    return settings


def _warm_up(effect: CalibratedEffect) -> dict[str, Setting]:
    """Return the settings of the first exponential, and of the second if there is one."""

    def constant(name: str) -> int:
        return _within(
            f"gyro_warmup {name}", effect.value(name), "s", _MIN_TIME_CONSTANT_S, _MAX_TIME_CONSTANT_S
        )

    settings: dict[str, Setting] = {
        "warmup_udps": _udps("gyro_warmup", effect),
        "warmup_s": constant("time_constant"),
    }
    if any(name.endswith("_second") for name in effect.parameters):
        second = _udps("gyro_warmup", effect, "_second")
        settings["warmup_second"] = [*second, constant("time_constant_second")]
    return settings


def apply_calibration_to_config(config: Mapping[str, object], node: NodeCalibration) -> dict[str, object]:
    """Return a node's /config.json with the settings of one calibration and none of another."""
    other_settings = {name: value for name, value in config.items() if name not in FROM_CALIBRATION}
    return other_settings | node_settings(node, other_settings)


def _bias_gain(walk: float, config: Mapping[str, object]) -> float:
    """Return the gain of the bias; `walk` is the rate random walk k in rad/s/√s."""
    noise_udps, gain_q20, rate_hz = (
        _number(config.get(name), default)
        for name, default in (
            ("noise_udps", _DEFAULT_NOISE_UDPS),
            ("gain_rate_q20", _DEFAULT_GAIN_RATE_Q20),
            ("rate_hz", _DEFAULT_RATE_HZ),
        )
    )
    gain = gain_q20 / 2**20
    if not gain:
        return 0.0
    return (walk / math.radians(noise_udps * 1e-6)) ** 2 / rate_hz * (1.0 - gain) / gain


def _number(value: object, default: int) -> int:
    return value if isinstance(value, int) and not isinstance(value, bool) and value > 0 else default


def _udps(name: str, effect: CalibratedEffect, suffix: str = "") -> list[int]:
    return [
        _within(
            f"{name} {axis}{suffix}",
            math.degrees(effect.value(axis + suffix)) * 1e6,
            "1e-6 deg/s",
            -_MAX_UDPS,
            _MAX_UDPS,
        )
        for axis in XYZ
    ]


def _within(name: str, value: float, unit: str, low: int, high: int) -> int:
    if not low <= value <= high:
        raise CalibrationError(
            f"the calibration's {name} = {value:.6g} {unit} is outside the range of a node, {low} to {high}; "
            "calibrate this node again"
        )
    return round(value)
