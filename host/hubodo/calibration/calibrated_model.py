"""A calibration added to a model, to simulate a node with its calibrated errors."""

from hubodo.calibration.file import Calibration, build_effects
from hubodo.model.model_file import Model, ScopedEffect


def add_calibration_to_model(model: Model, calibration: Calibration) -> tuple[Model, tuple[str, ...]]:
    """Return the model with the calibrated effects of its nodes and vehicle in place of its own.

    The second value has a line for each calibrated node that the model lacks. Raises CalibrationError for a
    value that its parameter cannot have.
    """
    added = [ScopedEffect(effect) for effect in build_effects(calibration.vehicle)]
    for node, node_calibration in calibration.nodes.items():
        if node in model.vehicle.nodes:
            added += [ScopedEffect(effect, node) for effect in build_effects(node_calibration.effects)]
    missing = [node for node in calibration.nodes if node not in model.vehicle.nodes]
    notes = (f"{node}: in the calibration, not in the model; ignored" for node in missing)
    return model.with_effects(*added), tuple(notes)
