"""A calibration file as effects of the forward model: a node simulated with the errors found in it."""

from hubodo.calibration.file import Calibration, build_effects
from hubodo.model.model_file import Model, ScopedEffect


def add_calibration_to_model(model: Model, calibration: Calibration) -> tuple[Model, tuple[str, ...]]:
    """The model with what a calibration says of its nodes and vehicle, in the place of what it said itself.

    The second part has a line for each node that the model does not have. Raises CalibrationError for a value
    that its parameter cannot have.
    """
    added = [ScopedEffect(effect) for effect in build_effects(calibration.vehicle)]
    for node, known in calibration.nodes.items():
        if node in model.vehicle.nodes:
            added += [ScopedEffect(effect, node) for effect in build_effects(known.effects)]
    missing = [node for node in calibration.nodes if node not in model.vehicle.nodes]
    notes = (f"{node}: in the calibration, not in the model; left out" for node in missing)
    return model.with_effects(*added), tuple(notes)
