"""A calibration file as effects of the forward model: a node simulated with the errors found in it."""

from hubodo.calibration.file import CalibratedEffect, Calibration
from hubodo.effects import BY_NAME
from hubodo.model.model_file import Model, Scoped


def with_calibration(model: Model, calibration: Calibration) -> tuple[Model, tuple[str, ...]]:
    """The model with what a calibration says of its nodes and vehicle, in the place of what it said itself.

    The second part has a line for each thing that the model has no word for. What was not determined is zero.
    """
    added: list[Scoped] = []
    notes: list[str] = []

    def take(name: str, found: CalibratedEffect, node: str | None) -> None:
        kind = BY_NAME[name]
        if node is not None and kind.level == "vehicle":
            notes.append(f"{node}.{name}: an effect of the vehicle; left out")
            return
        values = {key: q.value for key, q in found.parameters.items() if key in kind.parameters()}
        further = [key for key, q in found.parameters.items() if key not in values and q.value]
        if further:
            notes.append(f"{node}.{name}: the model has no {', '.join(further)}; left out")
        if values:
            added.append(Scoped(kind(**values), node))

    for name, found in calibration.vehicle.items():
        take(name, found, None)
    for node, known in calibration.nodes.items():
        if node not in model.vehicle.nodes:
            notes.append(f"{node}: in the calibration, not in the model; left out")
            continue
        for name, found in known.effects.items():
            take(name, found, node)
    return model.with_effects(*added), tuple(notes)
