"""A journal of the rounds of a search, from which an interrupted search resumes.

A search restarted with the same log, model and options requests the same rounds. Stored rounds are read back,
so that the result equals that of an uninterrupted search bit by bit.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import astuple, fields
from pathlib import Path
from typing import Any

import numpy as np

from hubodo.arrays import Array
from hubodo.atomic_files import write_atomically
from hubodo.effects import BY_NAME
from hubodo.effects.empirical import PREFIX, empirical_class
from hubodo.errors import InputError
from hubodo.gap.judge.hypothesis import Hypothesis
from hubodo.gap.judge.round import ReportProgress, Round, judge_round
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.refit.cross_validation import HeldOutGain
from hubodo.gap.scatter import Proposal
from hubodo.gap.screen.candidates import Candidate
from hubodo.gap.screen.null_distribution import NullDistribution
from hubodo.gap.screen.screening import ScreenedCandidate
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ModelTerm
from hubodo.model.forward import NodeInitialState
from hubodo.model.model_file import Model
from hubodo.model.model_text import model_toml
from hubodo.recording import Recording

_JOURNAL_VERSION = 6
# Numbers of a hypothesis that the journal stores.
_NUMBERS = ("gain", "evidence", "probability", "surprise", "agreement_sigmas")


class Journal:
    """A file of judged rounds; without a path nothing is stored."""

    def __init__(self, path: Path | None = None, search_fingerprint: str = "", resume: bool = False) -> None:
        """Open a journal.

        search_fingerprint: hash of everything that the rounds depend on
        resume: True to continue with the rounds of the file

        Raises InputError if there is no file to resume, or it belongs to another search.
        """
        self._path = path
        self._stored: list[dict[str, Any]] = []
        if path is None:
            return
        head = {"version": _JOURNAL_VERSION, "of": search_fingerprint}
        self._head = "" if resume else json.dumps(head) + "\n"
        if resume:
            self._stored = _read(path, head)

    def judge_round(
        self,
        evaluation: Evaluation,
        reject: Collection[str] = (),
        always_refit: Collection[tuple[str, str]] = (),
        report_progress: ReportProgress = lambda words, share: None,
    ) -> Round:
        """Judge a round as `round.judge_round`, or read it back if it is stored."""
        request = {"terms": [list(term.key) for term in evaluation.state.terms], "reject": sorted(reject)}
        if self._stored:
            entry = self._stored.pop(0)
            if entry["asked"] == request:
                return _round_from_json(entry["round"], evaluation)
            self._stored.clear()
        judged = judge_round(evaluation, reject, always_refit, report_progress)
        self._append({"asked": request, "round": _round_to_json(judged)})
        return judged

    def _append(self, entry: Mapping[str, Any]) -> None:
        """Append an entry; the first one creates the file and its folder."""
        if self._path is None:
            return
        self._path.parent.mkdir(parents=True, exist_ok=True)
        try:
            if self._head:
                # Replace an existing link instead of writing through it.
                self._path.unlink(missing_ok=True)
            with self._path.open("x" if self._head else "a", encoding="utf-8") as file:
                file.write(f"{self._head}{json.dumps(entry)}\n")
        except OSError as error:
            # Remove the incomplete round, and add the path, which the error of a write lacks.
            self._path.unlink(missing_ok=True)
            raise OSError(error.errno, error.strerror, str(self._path)) from None
        self._head = ""

    def delete(self) -> None:
        """Delete the file of a finished search."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)


def compute_fingerprint(recording: Recording, model: Model, *options: Collection[str]) -> str:
    """Return a fingerprint of everything a search depends on: samples, model and known effects.

    options: options of the search, sources of additional effects, version of the program
    """
    digest = hashlib.sha256(repr((model_toml(model), options, sorted(BY_NAME))).encode())
    for name, table in recording.files().items():
        for column in table:
            digest.update(f"{name}.{column}".encode())
            digest.update(np.ascontiguousarray(table[column]).tobytes())
    return digest.hexdigest()


def _read(path: Path, header: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the complete rounds of a file; an incomplete one at its end is cut off."""
    if not path.exists():
        raise InputError(f"{path.parent}: contains no interrupted search; leave out --resume")
    complete = path.read_text("utf-8").rpartition("\n")[0]
    try:
        first, *rounds = [json.loads(line) for line in complete.splitlines()]
    except ValueError:
        first, rounds = None, []
    if first != header:
        raise InputError(
            f"{path}: is of another log, model, choice of options or version of hubodo; leave out --resume"
        )
    write_atomically(path, complete + "\n")
    return rounds


def _round_to_json(judged: Round) -> dict[str, Any]:
    return {
        "rivals": [_hypothesis_to_json(hypothesis) for hypothesis in judged.hypotheses],
        "nothing": judged.null_probability,
        "screened": [
            [_term_to_json(candidate.candidate.term), candidate.gain, candidate.evidence]
            for candidate in judged.screened
        ],
        "null": _array_to_text(judged.null_distribution.surprises),
        "tempering": judged.tempering,
    }


def _hypothesis_to_json(hypothesis: Hypothesis) -> dict[str, Any]:
    proposal = hypothesis.proposal
    return {
        "term": _term_to_json(hypothesis.term),
        "numbers": [
            hypothesis.gain,
            hypothesis.evidence,
            hypothesis.probability,
            hypothesis.surprise,
            hypothesis.agreement_sigmas,
        ],
        "state": None if hypothesis.state is None else _state_to_json(hypothesis.state),
        "held_out": None if hypothesis.held_out_gain is None else list(astuple(hypothesis.held_out_gain)),
        "objection": hypothesis.objection,
        "proposal": None
        if proposal is None
        else [getattr(proposal, one.name) for one in fields(proposal) if one.name != "term"],
    }


def _state_to_json(state: State) -> dict[str, Any]:
    return {
        "terms": [_term_to_json(term) for term in state.terms],
        "starts": {name: [start.wheel_angle, list(start.attitude)] for name, start in state.starts.items()},
        "paths": {name: _array_to_text(path) for name, path in state.phase_offsets.items()},
        "late": {name: _array_to_text(late) for name, late in state.stamp_delays.items()},
        "measured": {name: _array_to_text(path) for name, path in state.measured_offsets.items()},
    }


def _term_to_json(term: ModelTerm) -> list[Any]:
    return [term.effect.name, term.effect.values(), term.scope, term.is_fitted, term.repeatability]


def _round_from_json(entry: Mapping[str, Any], point: Evaluation) -> Round:
    screened = []
    for term, gain, evidence in entry["screened"]:
        # Only name, gain and evidence of screened candidates are stored.
        candidate = Candidate(_term_from_json(term), np.empty((0, 0)))
        screened.append(ScreenedCandidate(candidate, gain, evidence, np.empty(0), np.empty((0, 0))))
    hypotheses = tuple(_hypothesis_from_json(hypothesis, point) for hypothesis in entry["rivals"])
    null = NullDistribution(_array_from_text(entry["null"]))
    return Round(
        point.without_cache(), hypotheses, entry["nothing"], tuple(screened), null, entry["tempering"]
    )


def _hypothesis_from_json(entry: Mapping[str, Any], point: Evaluation) -> Hypothesis:
    term, state, proposal = _term_from_json(entry["term"]), entry["state"], entry["proposal"]
    held_out = entry["held_out"]
    return Hypothesis(
        term,
        state=None if state is None else _state_from_json(state, point),
        proposal=None if proposal is None else Proposal(term, *proposal),
        held_out_gain=None if held_out is None else HeldOutGain(*held_out),
        objection=entry["objection"],
        **dict(zip(_NUMBERS, entry["numbers"], strict=True)),
    )


def _state_from_json(entry: Mapping[str, Any], point: Evaluation) -> State:
    return State(
        point.problem,
        tuple(_term_from_json(term) for term in entry["terms"]),
        {name: NodeInitialState(angle, (x, y, z)) for name, (angle, (x, y, z)) in entry["starts"].items()},
        {name: _array_from_text(values) for name, values in entry["paths"].items()},
        {name: _array_from_text(values) for name, values in entry["late"].items()},
        {name: _array_from_text(values) for name, values in entry["measured"].items()},
        # A round does not change the evaluation.
        point.state.has_steady_wheels,
        point.state.has_correlated_noise,
    )


def _term_from_json(entry: Sequence[Any]) -> ModelTerm:
    name, values, scope, fitted, repeatability = entry
    effect_class = empirical_class(name) if name.startswith(PREFIX) else BY_NAME[name]
    return ModelTerm(effect_class(**values), scope, fitted, repeatability=repeatability)


def _array_to_text(values: Array) -> str:
    return base64.b64encode(np.asarray(values, "<f8").tobytes()).decode("ascii")


def _array_from_text(text: str) -> Array:
    return np.frombuffer(base64.b64decode(text), "<f8").astype(float)
