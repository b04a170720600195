"""Odometry from inertial sensors on wheel hubs: recording, estimation and sim-to-real gap analysis.

Public names are listed in `__all__`; they are imported on first use, so that `import hubodo` is fast.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from hubodo.version import __version__

if TYPE_CHECKING:
    from hubodo.api.files import load_vehicle, read_calibration, read_model, write_calibration, write_model
    from hubodo.api.from_numbers import from_arrays, from_frame
    from hubodo.api.log import LoadedLog
    from hubodo.api.poses import calibrate_means, plan_poses
    from hubodo.api.read import open
    from hubodo.api.simulate import simulate
    from hubodo.api.track import FusedTrack
    from hubodo.calibration.file import Calibration
    from hubodo.errors import CalibrationError, ConfigError, HubodoError, InputError, LogError
    from hubodo.fuse.track import Score
    from hubodo.gap.explain.missing_effects import MissingEffects
    from hubodo.gap.explain.result import Finding
    from hubodo.model.model_file import Model
    from hubodo.pages.plot import Plot
    from hubodo.recording import Event, Recording, Table
    from hubodo.sensors.allan.fit import NoiseTerm
    from hubodo.sensors.allan.result import AllanResult
    from hubodo.sensors.filters.result import FilterComparison
    from hubodo.sensors.heading.result import HeadingResult
    from hubodo.sensors.imu.pose_plan import PosePlan
    from hubodo.sensors.imu.result import ImuCalibration
    from hubodo.sensors.north.result import NorthResult
    from hubodo.sensors.rate_table.result import RateCalibration
    from hubodo.sensors.warmup.result import WarmupResult
    from hubodo.unit_systems import display_units
    from hubodo.vehicle import NodeMount, Vehicle

_NAMES_OF_MODULE = {
    "hubodo.api.files": (
        "load_vehicle",
        "read_calibration",
        "read_model",
        "write_calibration",
        "write_model",
    ),
    "hubodo.api.from_numbers": ("from_arrays", "from_frame"),
    "hubodo.api.log": ("LoadedLog",),
    "hubodo.gap.explain.missing_effects": ("MissingEffects",),
    "hubodo.api.poses": ("calibrate_means", "plan_poses"),
    "hubodo.api.read": ("open",),
    "hubodo.api.simulate": ("simulate",),
    "hubodo.api.track": ("FusedTrack",),
    "hubodo.calibration.file": ("Calibration",),
    "hubodo.unit_systems": ("display_units",),
    "hubodo.errors": ("CalibrationError", "ConfigError", "HubodoError", "InputError", "LogError"),
    "hubodo.fuse.track": ("Score",),
    "hubodo.gap.explain.result": ("Finding",),
    "hubodo.model.model_file": ("Model",),
    "hubodo.pages.plot": ("Plot",),
    "hubodo.recording": ("Event", "Recording", "Table"),
    "hubodo.sensors.allan.fit": ("NoiseTerm",),
    "hubodo.sensors.allan.result": ("AllanResult",),
    "hubodo.sensors.filters.result": ("FilterComparison",),
    "hubodo.sensors.heading.result": ("HeadingResult",),
    "hubodo.sensors.imu.pose_plan": ("PosePlan",),
    "hubodo.sensors.imu.result": ("ImuCalibration",),
    "hubodo.sensors.north.result": ("NorthResult",),
    "hubodo.sensors.rate_table.result": ("RateCalibration",),
    "hubodo.sensors.warmup.result": ("WarmupResult",),
    "hubodo.vehicle": ("NodeMount", "Vehicle"),
}
_MODULE_OF_NAME = {name: module for module, names in _NAMES_OF_MODULE.items() for name in names}

__all__ = [  # noqa: RUF022 - in the order of the reference
    "open",
    "from_frame",
    "from_arrays",
    "simulate",
    "calibrate_means",
    "plan_poses",
    "LoadedLog",
    "Table",
    "Event",
    "Recording",
    "FusedTrack",
    "Score",
    "AllanResult",
    "NoiseTerm",
    "WarmupResult",
    "FilterComparison",
    "HeadingResult",
    "ImuCalibration",
    "NorthResult",
    "RateCalibration",
    "PosePlan",
    "MissingEffects",
    "Finding",
    "Plot",
    "display_units",
    "Vehicle",
    "NodeMount",
    "load_vehicle",
    "Model",
    "read_model",
    "write_model",
    "Calibration",
    "read_calibration",
    "write_calibration",
    "HubodoError",
    "InputError",
    "ConfigError",
    "LogError",
    "CalibrationError",
    "__version__",
]


if not TYPE_CHECKING:  # otherwise a type checker would accept any name

    def __getattr__(name: str) -> Any:
        if name not in _MODULE_OF_NAME:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(import_module(_MODULE_OF_NAME[name]), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
