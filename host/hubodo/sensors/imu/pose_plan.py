"""Plan of the static poses of an accelerometer calibration: which, how long, and to what sigma."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.errors import InputError
from hubodo.html_table import html_lines, html_table
from hubodo.pages.console import print_lines, print_table
from hubodo.pages.page import PageTable, Section
from hubodo.sensors.imu.pose_observability import (
    ACCELEROMETER_TOLERANCE,
    MAX_OBSERVABLE_SIGMA,
    box_directions,
    describe_direction,
    pose_design_matrix,
    posterior_covariance,
)
from hubodo.sensors.imu.standstills import STANDSTILL_MARGIN_S, STANDSTILL_MARGIN_SHARE
from hubodo.sensors.north.drift import DriftNoise
from hubodo.sensors.north.plan import read_drift_noise
from hubodo.unit_systems import ACCELERATION, RATIO, SMALL_ANGLE

if TYPE_CHECKING:
    from rich.console import Console

    from hubodo.sensors.allan.result import AllanResult

POSE_COUNTS = (9, 12, 15, 18, 24)
"""Numbers of poses that are compared; nine determine all parameters, more than twelve show a mistake."""
PLANNED_BIAS_SIGMA = 0.005  # m/s²
PLANNED_TURN_S = 5.0
"""Requested sigma of a bias, and time from pose to pose, of a plan for which nothing else was requested."""
_STANDSTILLS_S = np.array([2.0, 3, 5, 7, 10, 15, 20, 30, 45, 60, 90, 120, 180, 300, 600])


@dataclass(frozen=True)
class PoseProgramme:
    """Poses of one number and standstill with the sigmas to be expected.

    Attributes:
        directions: the side that points up in each pose.
        standstill: s. time: of the whole programme, s.
        bias_sigmas: (3,) sigmas of the biases, m/s².
        scale_sigma, angle_sigma: largest of a scale, and of a difference of two angles, rad.
    """

    directions: tuple[str, ...]
    standstill: float
    time: float
    bias_sigmas: tuple[float, ...]
    scale_sigma: float
    angle_sigma: float

    @property
    def bias_sigma(self) -> float:
        """Return the largest sigma of a bias, m/s²."""
        return max(self.bias_sigmas)

    def as_json(self) -> dict[str, Any]:
        """Return the programme in SI units."""
        return {
            "directions": list(self.directions),
            "standstill": self.standstill,
            "time": self.time,
            "bias_sigma": list(self.bias_sigmas),
            "scale_sigma": self.scale_sigma,
            "angle_sigma": self.angle_sigma,
        }


@dataclass(frozen=True, repr=False)
class PosePlan:
    """The shortest programme for each number of poses.

    Attributes
    ----------
    noise : DriftNoise
        Noise of the accelerometers: n in m/s²/√Hz, b in m/s², k in m/s²/√s.
    target_sigma : float
        Requested sigma of the biases, m/s².
    turn : float
        Time from pose to pose, s.
    programmes : tuple of PoseProgramme
        For each number of poses; those that miss the target stand still for longest.
    """

    noise: DriftNoise
    target_sigma: float
    turn: float
    programmes: tuple[PoseProgramme, ...]

    @property
    def target_programme(self) -> PoseProgramme | None:
        """Return the shortest programme that reaches the requested sigma, or None."""
        reached = [it for it in self.programmes if it.bias_sigma <= self.target_sigma]
        return min(reached, key=lambda it: it.time, default=None)

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result of `hubodo calibrate plan`, in SI units.

        Returns
        -------
        dict
            The JSON object.
        """
        wanted = self.target_programme
        return {
            "noise": {"N": self.noise.n, "B": self.noise.b, "K": self.noise.k},
            "target_bias_sigma": self.target_sigma,
            "turn": self.turn,
            "programmes": [it.as_json() for it in self.programmes],
            "wanted": None if wanted is None else wanted.as_json(),
        }

    def summary(self) -> str:
        """Return the shortest programme for the requested sigma in one sentence.

        Returns
        -------
        str
            The number of poses and their duration.
        """
        wanted, bias = self.target_programme, ACCELERATION.shown()
        target = f"a bias sigma of {bias.number(self.target_sigma, '.3g')} {bias.name}"
        if wanted is None:
            return f"{target} cannot be reached with these accelerometers"
        return (
            f"{target} takes {wanted.time / 60:.1f} minutes: {len(wanted.directions)} poses of "
            f"{wanted.standstill:g} s"
        )

    def render(self, console: Console) -> None:
        """Print the plan for the requested sigma, then the programme of each number of poses.

        Parameters
        ----------
        console : rich.console.Console
            The console to print to.
        """
        print_lines(console, [self.summary(), *self._steps()])
        headings, *rows = self._rows()
        print_table(console, headings, rows)

    def sections(self) -> list[Section]:
        """Return the sections of a page: the poses to set, then the programme of each number of poses.

        Returns
        -------
        list of Section
            The sections.
        """
        headings, *rows = self._rows()
        return [
            Section("Poses", "The side that points up.", listing="\n".join(self._steps())),
            Section("Other numbers of poses", tables=[PageTable(headings, rows)]),
        ]

    def __repr__(self) -> str:
        return f"PosePlan({self.summary()})"

    def _repr_html_(self) -> str:
        headings, *rows = self._rows()
        return html_lines((self.summary(), *self._steps())) + html_table(headings, rows)

    def _steps(self) -> list[str]:
        wanted = self.target_programme
        return [] if wanted is None else [f"{k + 1:2d}. {it}" for k, it in enumerate(wanted.directions)]

    def _rows(self) -> list[tuple[str, ...]]:
        """Return a row of headings, then one for each number of poses."""
        bias, scale, angle = ACCELERATION.shown(), RATIO.shown(), SMALL_ANGLE.shown()
        units = (("bias", bias), ("scale", scale), ("angle", angle))
        return [
            ("poses", "standstill, s", "minutes", *(f"{name} 1σ, {unit.name}" for name, unit in units)),
            *(
                (
                    str(len(it.directions)),
                    f"{it.standstill:g}",
                    f"{it.time / 60:.1f}",
                    bias.number(it.bias_sigma, ".3g"),
                    scale.number(it.scale_sigma, ".3g"),
                    angle.number(it.angle_sigma, ".3g"),
                )
                for it in self.programmes
            ),
        ]


def read_accelerometer_noise(path: Path) -> DriftNoise:
    """Read the noise of an accelerometer axis from `hubodo allan --json`; raise InputError for a gyro."""
    noise = read_drift_noise(path)
    channel = str(json.loads(path.read_text("utf-8")).get("channel", ""))
    if not channel.startswith("a"):
        raise InputError(f"{path}: is of {channel or 'no channel'}; give that of ax, ay or az")
    return noise


def noise_of_accelerometers(results: Sequence[AllanResult]) -> DriftNoise:
    """Return the largest noise of accelerometer axes; raise InputError for a gyro or without white noise."""
    for it in results:
        if not it.channel.startswith("a") or it.terms["N"].value is None:
            raise InputError(f"{it.name}: give an accelerometer axis whose record shows white noise (N)")
    n, b, k = (max(it.terms[name].value or 0.0 for it in results) for name in "NBK")
    return DriftNoise(n, b, k)


def plan_poses(noise: DriftNoise, target_sigma: float, turn: float) -> PosePlan:
    """Return the plan for a requested sigma of the biases, m/s²; turn: time from pose to pose, s."""
    programmes = []
    for count in POSE_COUNTS:
        chosen = choose_directions(count)
        trials = [_programme(chosen, noise, float(standstill), turn) for standstill in _STANDSTILLS_S]
        usable = [it for it in trials if it.scale_sigma <= MAX_OBSERVABLE_SIGMA]
        reached = [it for it in usable if it.bias_sigma <= target_sigma]
        if usable:
            programmes.append(reached[0] if reached else min(usable, key=lambda it: it.bias_sigma))
    return PosePlan(noise, target_sigma, turn, tuple(programmes))


def choose_directions(count: int) -> list[Array]:
    """Return the faces, edges and corners of a box that determine the parameters best, chosen greedily."""
    chosen: list[Array] = []
    candidates = box_directions()
    while len(chosen) < count:
        traces = [float(np.trace(_covariance([*chosen, candidate], 1e-3))) for candidate in candidates]
        chosen.append(candidates.pop(int(np.argmin(traces))))
    return chosen


def _covariance(directions: Sequence[Array], noise: float) -> Array:
    """Return the (9, 9) covariance relative to gravity for a relative noise of the means."""
    unit = np.array([it / np.linalg.norm(it) for it in directions])
    return posterior_covariance(pose_design_matrix(unit) / noise, ACCELEROMETER_TOLERANCE)


def _programme(
    directions: Sequence[Array], noise: DriftNoise, standstill: float, turn: float
) -> PoseProgramme:
    margin = float(np.clip(standstill * STANDSTILL_MARGIN_SHARE, *STANDSTILL_MARGIN_S))
    mean_sigma = float(noise.allan_deviation(np.array([standstill - 2 * margin]))[0])
    sigma = np.sqrt(np.diag(_covariance(directions, mean_sigma / STANDARD_GRAVITY)))
    return PoseProgramme(
        tuple(describe_direction(it) for it in directions),
        standstill,
        len(directions) * (standstill + turn) - turn,
        tuple(float(it) * STANDARD_GRAVITY for it in sigma[:3]),
        float(sigma[3:6].max()),
        float(sigma[6:].max()),
    )
