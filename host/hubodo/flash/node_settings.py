"""A node's part of the calibration file as settings of the node: what /config.json takes over from it.

The node takes nothing off the samples that it sends: they stay raw, and its own estimate of the bias stands
beside them. What `calibration/apply.py` takes out of a log by the same calibration is thus taken out once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from hubodo.calibration.file import CalibratedEffect, NodeCalibration, Quantity
from hubodo.effects.triad import XYZ
from hubodo.errors import CalibrationError

Setting = int | list[int]

# Of firmware/settings.py; a test compares.
_NOISE_UDPS, _GAIN_RATE_Q20, _RATE_HZ = 75000, 314573, 416

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
"""Settings that a calibration decides: what it does not hold goes back to the default."""

_LARGEST_UDPS, _LARGEST_PPM, _LARGEST_MM, _GAIN_LIMIT = 30_000_000, 200_000, 1000, (1 << 20) - 1
_SHORTEST_S, _LONGEST_S = 10, 100_000


def node_settings(node: NodeCalibration, config: Mapping[str, object]) -> dict[str, Setting]:
    """The settings of FROM_CALIBRATION that a node's calibration gives.

    config: of the node, for its rate, noise and gain of the rate. gyro_bias and gyro_warmup become what the
    node begins with; gyro_scale_factor z and lever_arm serve the bias from gravity; gyro_rate_random_walk k
    gives the gain of the bias: eq. 6-8 of Shah et al. settle at K_b / K_w = q_b / q_w, and at
    (q_w + q_b) / q_n = K^2 / (1 - K), so K_b = (k^2 dt / q_n) (1 - K) / K with K the gain of the rate.
    Raises CalibrationError for numbers that no node takes.
    """
    effects, made = node.effects, dict[str, Setting]()
    if "gyro_bias" in effects:
        made["bias_udps"] = _udps("gyro_bias", effects["gyro_bias"])
    if "gyro_warmup" in effects:
        made |= _warm_up(effects["gyro_warmup"])
    if "gyro_scale_factor" in effects:
        scale = effects["gyro_scale_factor"].parameters.get("z", Quantity(0.0, 0.0))
        ppm = scale.value * 1e6
        made["gyro_scale_ppm"] = _within("gyro_scale_factor z", ppm, "ppm", -_LARGEST_PPM, _LARGEST_PPM)
        if scale.sigma:
            made["gyro_scale_sigma_ppm"] = min(math.ceil(scale.sigma * 1e6), _LARGEST_PPM)
    if "lever_arm" in effects:
        arm = effects["lever_arm"]
        made["arm_mm"] = [
            _within(f"lever_arm {axis}", arm.value(axis) * 1e3, "mm", -_LARGEST_MM, _LARGEST_MM)
            for axis in XYZ[:2]
        ]
    if "gyro_rate_random_walk" in effects:
        gain = _bias_gain(effects["gyro_rate_random_walk"].value("k"), config)
        made["gain_bias_q30"] = min(round(gain * 2**30), _GAIN_LIMIT)
    return made


def _warm_up(effect: CalibratedEffect) -> dict[str, Setting]:
    """Its first exponential, and the second where there is one."""

    def constant(name: str) -> int:
        return _within(f"gyro_warmup {name}", effect.value(name), "s", _SHORTEST_S, _LONGEST_S)

    made: dict[str, Setting] = {
        "warmup_udps": _udps("gyro_warmup", effect),
        "warmup_s": constant("time_constant"),
    }
    if any(name.endswith("_second") for name in effect.parameters):
        second = _udps("gyro_warmup", effect, "_second")
        made["warmup_second"] = [*second, constant("time_constant_second")]
    return made


def merged(config: Mapping[str, object], node: NodeCalibration) -> dict[str, object]:
    """A node's /config.json with one calibration in it, and nothing left of another."""
    kept = {name: value for name, value in config.items() if name not in FROM_CALIBRATION}
    return kept | node_settings(node, kept)


def _bias_gain(walk: float, config: Mapping[str, object]) -> float:
    """walk: rad/s per root of a second."""
    noise_udps, gain_q20, rate_hz = (
        _number(config.get(name), default)
        for name, default in (
            ("noise_udps", _NOISE_UDPS),
            ("gain_rate_q20", _GAIN_RATE_Q20),
            ("rate_hz", _RATE_HZ),
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
            -_LARGEST_UDPS,
            _LARGEST_UDPS,
        )
        for axis in XYZ
    ]


def _within(name: str, value: float, unit: str, least: int, most: int) -> int:
    if not least <= value <= most:
        raise CalibrationError(
            f"the calibration's {name} = {value:.6g} {unit} is beyond {least} to {most}, what a node takes; "
            "calibrate this node anew"
        )
    return round(value)
