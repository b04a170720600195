"""The effects in the order of the sensor chain. A new effect is one class, and one line in `EFFECTS`."""

from collections.abc import Iterable

from hubodo.effects.accel import AccelBias, AccelNonorthogonality, AccelSaturation, AccelScaleFactor
from hubodo.effects.base import Effect
from hubodo.effects.empirical import empirical_class
from hubodo.effects.gyro import (
    GyroBias,
    GyroCubic,
    GyroGSensitivity,
    GyroLag,
    GyroNonorthogonality,
    GyroQuantization,
    GyroRateRandomWalk,
    GyroSaturation,
    GyroScaleFactor,
)
from hubodo.effects.mounting import LeverArm, NodeMisalignment
from hubodo.effects.sensor_chain import Geometry, Noise, SensorChain
from hubodo.effects.temperature import (
    AccelScaleTemperature,
    AccelTemperature,
    GyroScaleTemperature,
    GyroTemperature,
)
from hubodo.effects.timing import ClockSkew, Outliers, SampleRepeat, TimeOffset
from hubodo.effects.vehicle import RoadBank, RoadGrade, TrackWidth
from hubodo.effects.warmup import GyroWarmup
from hubodo.effects.wheel import TyreGrowth, WheelCamber, WheelEccentricity, WheelRadius, WheelSlip

EFFECTS: tuple[type[Effect], ...] = (
    TrackWidth,
    RoadGrade,
    RoadBank,
    WheelRadius,
    TyreGrowth,
    WheelSlip,
    WheelEccentricity,
    WheelCamber,
    LeverArm,
    NodeMisalignment,
    GyroLag,
    GyroScaleFactor,
    GyroScaleTemperature,
    GyroNonorthogonality,
    GyroCubic,
    GyroBias,
    GyroWarmup,
    GyroTemperature,
    GyroGSensitivity,
    GyroRateRandomWalk,
    GyroSaturation,
    GyroQuantization,
    AccelScaleFactor,
    AccelScaleTemperature,
    AccelNonorthogonality,
    AccelBias,
    AccelTemperature,
    AccelSaturation,
    Outliers,
    SampleRepeat,
    TimeOffset,
    ClockSkew,
)
BY_NAME: dict[str, type[Effect]] = {effect.name: effect for effect in EFFECTS}
"""Every effect that there is: those above, and after them what `loaded.use_effects` added."""


def effect_of(name: str) -> type[Effect]:
    """Return the class of an effect by name, also an empirical one; raise ValueError if there is none."""
    if name in BY_NAME:
        return BY_NAME[name]
    return empirical_class(name)


def count_fitted_effects() -> int:
    """Return the number of effects that a fit to a drive may move; the others come from a bench record."""
    return sum(bool(kind.fitted_parameters()) for kind in BY_NAME.values())


def sort_effects(effects: Iterable[Effect]) -> list[Effect]:
    """Return the effects in the order of the sensor chain; user-defined and empirical ones come last."""
    order = {effect: k for k, effect in enumerate(EFFECTS)}
    return sorted(effects, key=lambda effect: order.get(type(effect), len(order)))


def distinguishing_manoeuvre(first: str, second: str) -> str:
    """Return the manoeuvre that distinguishes two confusable effects; "" if neither class lists the other."""
    for name, confusable in ((first, second), (second, first)):
        if name in BY_NAME and confusable in BY_NAME[name].confusable_with:
            return BY_NAME[name].confusable_with[confusable]
    return ""


__all__ = [
    "BY_NAME",
    "EFFECTS",
    "Effect",
    "Geometry",
    "Noise",
    "SensorChain",
    "count_fitted_effects",
    "distinguishing_manoeuvre",
    "effect_of",
    "sort_effects",
]
