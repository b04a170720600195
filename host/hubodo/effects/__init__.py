"""The 28 effects, in the order of the chain; a new one is one class and one line here, or a file outside."""

from collections.abc import Iterable

from hubodo.effects.accel import AccelBias, AccelNonorthogonality, AccelSaturation, AccelScaleFactor
from hubodo.effects.base import Chain, Effect, Geometry, Noise
from hubodo.effects.empirical import empirical
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
    GyroTemperature,
)
from hubodo.effects.mounting import LeverArm, NodeMisalignment
from hubodo.effects.timing import ClockSkew, Outliers, SampleRepeat, TimeOffset
from hubodo.effects.vehicle import RoadGrade, TrackWidth
from hubodo.effects.warmup import GyroWarmup
from hubodo.effects.wheel import TyreGrowth, WheelCamber, WheelEccentricity, WheelRadius, WheelSlip

EFFECTS: tuple[type[Effect], ...] = (
    TrackWidth,
    RoadGrade,
    WheelRadius,
    TyreGrowth,
    WheelSlip,
    WheelEccentricity,
    WheelCamber,
    LeverArm,
    NodeMisalignment,
    GyroLag,
    GyroScaleFactor,
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
    AccelNonorthogonality,
    AccelBias,
    AccelSaturation,
    Outliers,
    SampleRepeat,
    TimeOffset,
    ClockSkew,
)
BY_NAME: dict[str, type[Effect]] = {effect.name: effect for effect in EFFECTS}
"""Every effect that there is: those above, and after them what `loaded.use_effects` added."""


def effect_of(name: str) -> type[Effect]:
    """The effect of a name, empirical ones among them. ValueError where there is none."""
    if name in BY_NAME:
        return BY_NAME[name]
    return empirical(name)


def in_order(effects: Iterable[Effect]) -> list[Effect]:
    """Effects in the order of the chain, those from outside and empirical ones last."""
    place = {effect: k for k, effect in enumerate(EFFECTS)}
    return sorted(effects, key=lambda effect: place.get(type(effect), len(place)))


def told_apart(one: str, other: str) -> str:
    """The manoeuvre that tells two effects apart that a drive may not; "" where neither says one."""
    for name, beside in ((one, other), (other, one)):
        if name in BY_NAME and beside in BY_NAME[name].alike:
            return BY_NAME[name].alike[beside]
    return ""


__all__ = [
    "BY_NAME",
    "EFFECTS",
    "Chain",
    "Effect",
    "Geometry",
    "Noise",
    "effect_of",
    "in_order",
    "told_apart",
]
