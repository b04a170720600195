"""`LoadedLog.gap`: search the effects that a model lacks to explain a log."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from hubodo.api.arguments import StrPath, as_model
from hubodo.effects import BY_NAME
from hubodo.errors import InputError
from hubodo.gap.explain.missing_effects import MissingEffects
from hubodo.gap.judge.round import EMPIRICAL
from hubodo.gap.problem.assumed import assume_model
from hubodo.gap.workflow import find_gap
from hubodo.model.model_file import Model
from hubodo.progress import progress_line
from hubodo.spelling import suggest_spelling

if TYPE_CHECKING:
    from hubodo.api.log import LoadedLog


def search_gap(
    log: LoadedLog, model: StrPath | Model | None, accept: Sequence[str], reject: Sequence[str]
) -> MissingEffects:
    """Search the effects that a model lacks to explain a log; see `LoadedLog.gap`."""
    check_effects(accept, reject)
    if model is not None:
        used_model = as_model(model)
    elif log.vehicle is not None:
        used_model = assume_model(log.recording, log.vehicle, str(log.path))
    else:
        raise InputError(f"{log.path}: holds no vehicle; give a model file")
    with progress_line() as show:
        result = find_gap(
            log.recording,
            used_model,
            accept=accept,
            reject=reject,
            log_name=str(log.path),
            report_progress=show,
        )
    if not result.is_finished:
        raise KeyboardInterrupt("the search was interrupted")
    model_name = Path(model).name if isinstance(model, str | os.PathLike) else "the model"
    return replace(result, log=log.path.name, given=model_name)


def check_effects(accept: Iterable[str], reject: Iterable[str]) -> None:
    """Raise InputError for a name that is no effect."""
    for argument, names, known in (
        ("accept", accept, (*BY_NAME,)),
        ("reject", reject, (*BY_NAME, EMPIRICAL)),
    ):
        for name in names:
            if name not in known:
                hint = suggest_spelling(name, known) or f"; they are {', '.join(known)}"
                raise InputError(f"{argument} {name!r}: no such effect{hint}")
