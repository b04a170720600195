"""All that is said of one heading: course, what it rests on, its rivals and its score."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from hubodo.effects.warmup import WarmupModel
from hubodo.fuse.heading_filter import BiasNoise
from hubodo.sensors.heading.score import HeadingScore
from hubodo.sensors.heading.track import HeadingTrack


@dataclass(frozen=True)
class HeadingReport:
    """Heading of one axis. upwards: the axis points up. rests: s, (from, to) of each standstill."""

    node: str
    axis: str
    upwards: bool
    rests: tuple[tuple[float, float], ...]
    warmup: WarmupModel
    noise: BiasNoise
    scale_sigma: float
    lag: float
    track: HeadingTrack
    score: HeadingScore | None
    notes: tuple[str, ...]

    @property
    def start(self) -> float:
        """rad, the truth's heading at the first sample, 0 where there is none."""
        return 0.0 if self.score is None else self.score.start

    @property
    def duration(self) -> float:
        """s."""
        return float(self.track.t[-1] - self.track.t[0])

    def ends(self) -> dict[str, float]:
        """rad turned from the first sample to the last, by each estimate."""
        ends = {"heading": float(self.track.heading[-1])}
        return ends | {name: float(values[-1]) for name, values in self.track.rivals.items()}

    def as_json(self) -> dict[str, Any]:
        """Rates in rad/s, times in s, angles in rad unless the name says degrees."""
        track, noise, model = self.track, self.noise, self.warmup
        warmup: dict[str, Any] = {"c1": model.c1, "time_constant": model.time_constant}
        if model.c1_second:
            warmup |= {"c1_second": model.c1_second, "time_constant_second": model.time_constant_second}
        warmup["sigma"] = dict(noise.warmup)
        return {
            "node": self.node,
            "axis": self.axis,
            "upwards": self.upwards,
            "duration": self.duration,
            "rests": [list(rest) for rest in self.rests],
            "heading": float(track.heading[-1]) + self.start,
            "turned_deg": {name: math.degrees(end) for name, end in self.ends().items()},
            "sigma": float(track.sigma[-1]),
            "sigma_deg": math.degrees(float(track.sigma[-1])),
            "bias": {"value": float(track.bias[-1]), "sigma": float(track.sigma_bias[-1])},
            "noise": {"N": noise.angle_random_walk, "B": noise.bias_instability, "K": noise.rate_random_walk},
            "warmup": warmup if model.c1 else None,
            "scale_sigma": self.scale_sigma,
            "lag": self.lag,
            "gaps": [list(gap) for gap in track.gaps],
            "score": None if self.score is None else self._scored(self.score),
            "notes": list(self.notes),
        }

    def _scored(self, score: HeadingScore) -> dict[str, Any]:
        made: dict[str, Any] = {"against": score.source, "end_in_sigma": score.end_in_sigma}
        for name, error in score.errors.items():
            made[name] = {
                "rms_deg": math.degrees(error.rms),
                "end_deg": math.degrees(error.end),
                "worst_deg": math.degrees(error.worst),
            }
        return made
