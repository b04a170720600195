"""Result of a calibration drive: effects with sigmas, as JSON and as text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from hubodo.calibration.file import CalibratedEffect, Quantity
from hubodo.calibration.parameter_table import format_with_sigma, parameter_headings, parameter_rows
from hubodo.fuse.wheel.calibration.held_out import HeldOutErrors
from hubodo.fuse.wheel.calibration.learnt_parameters import quantities_as_effects, quantities_as_json
from hubodo.pages.console import print_table

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class WheelCalibration:
    """Result of a calibration drive.

    Attributes
    ----------
    nodes : name -> effect -> parameter -> value and sigma, names of the model file, node axes.
    vehicle : effect -> parameter -> value and sigma.
    not_observable : one line for each parameter the drive did not determine, and which manoeuvre would.
    antenna : x and y on the vehicle, m.
    rms : m, between the positions and the track before calibration.
    held_out : errors on held-out segments.
    white_sigma, slow_sigma : m, 1 sigma of the positions' errors, as estimated.
    n_positions, n_jumps : positions used, and jumps of the positions.
    warnings : warnings of the filter, one line each.
    source, output : source of the positions (`truth` or `gnss`) and path of the calibration file, in the
        result of the verb.
    """

    nodes: Mapping[str, Mapping[str, Mapping[str, Quantity]]]
    vehicle: Mapping[str, Mapping[str, Quantity]]
    not_observable: tuple[str, ...]
    antenna: tuple[Quantity, Quantity]
    rms: float
    held_out: HeldOutErrors
    white_sigma: float
    slow_sigma: float
    n_positions: int
    n_jumps: int
    warnings: tuple[str, ...]
    source: str = ""
    output: str = ""

    def effects(self, name: str, **provenance: object) -> dict[str, CalibratedEffect]:
        """Return the effects of one node for a calibration file.

        provenance: other fields of CalibratedEffect.
        """
        return quantities_as_effects(self.nodes[name], **provenance)

    def vehicle_effects(self, **provenance: object) -> dict[str, CalibratedEffect]:
        """Return the effects of the vehicle for a calibration file."""
        return quantities_as_effects(self.vehicle, **provenance)

    def as_json(self) -> dict[str, Any]:
        """Return the calibration as one JSON object, in the units of the model file."""
        return {
            "output": self.output,
            "positions": self.source,
            "fixes": self.n_positions,
            "jumps": self.n_jumps,
            "position_error": {"random": self.white_sigma, "slow": self.slow_sigma},
            "antenna": {name: asdict(q) for name, q in zip("xy", self.antenna, strict=True)},
            "rms_before": self.rms,
            "held_out": asdict(self.held_out),
            "nodes": {name: quantities_as_json(effects) for name, effects in self.nodes.items()},
            "vehicle": quantities_as_json(self.vehicle),
            "unseen": list(self.not_observable),
            "warnings": list(self.warnings),
        }

    def render(self, console: Console) -> None:
        """Print the parameters, the residuals, then the parameters that were not observable."""
        rows = [
            (name, *row)
            for name, effects in (*self.nodes.items(), ("vehicle", self.vehicle))
            for row in parameter_rows(effects)
        ]
        print_table(console, ("scope", *parameter_headings()), rows, f"→ {self.output}")
        for line in self._summary_lines():
            console.print(line, highlight=False, soft_wrap=True)
        for line in self.not_observable:
            console.print(f"not observable: {line}", highlight=False, markup=False, soft_wrap=True)
        for line in self.warnings:
            console.print(f"warning: {line}", highlight=False, markup=False, soft_wrap=True)

    def _summary_lines(self) -> Iterator[str]:
        """Yield lines about residuals, antenna and the held-out check."""
        yield (
            f"{self.n_positions} positions ({self.source}) with {self.white_sigma:.2g} m of white "
            f"noise and {self.slow_sigma:.2g} m of slow error (1σ); before calibration the track "
            f"deviated by {self.rms:.2f} m rms"
        )
        if self.n_jumps:
            yield f"the positions jumped {self.n_jumps} times; the slow error was reset at each jump"
        forward, left = (f"{format_with_sigma(q.value, q.sigma)} m" for q in self.antenna)
        yield f"antenna {forward} forward, {left} to the left"
        check = self.held_out
        if check.n_segments:
            segments = f"{check.n_segments} segments, each predicted from the others"
            yield f"held out: {segments}: {check.description}"
        else:
            yield "held out: the drive is too short for a held-out check; the gain is not verified"
