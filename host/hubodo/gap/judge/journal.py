"""The rounds of a search, kept in a file one by one: a search that was stopped goes on where it was.

A search asks for the same rounds again when it begins again with the same log, model and options. Those that
are kept are read, so that it ends as if it had never been stopped, bit for bit.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hubodo.arrays import Array
from hubodo.atomic_files import write_atomically
from hubodo.effects import BY_NAME
from hubodo.effects.empirical import PREFIX, empirical
from hubodo.errors import InputError
from hubodo.gap.judge.rival import Rival
from hubodo.gap.judge.round import Round, Say, look
from hubodo.gap.process_noise.point import Point
from hubodo.gap.scatter import Proposal
from hubodo.gap.screen.candidates import Candidate
from hubodo.gap.screen.null_distribution import NullDistribution
from hubodo.gap.screen.screening import Screened
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ModelTerm
from hubodo.model.forward import NodeInitialState
from hubodo.model.model_file import Model, model_toml
from hubodo.recording import Recording

_VERSION = 2


class Journal:
    """Rounds that were judged, in a file; without one it keeps nothing."""

    def __init__(self, path: Path | None = None, what: str = "", resume: bool = False) -> None:
        """what: fingerprint of all that the rounds hang on. resume: go on with what the file has.

        Raises InputError when there is nothing to go on with, or that of another search.
        """
        self._path = path
        self._kept: list[dict[str, Any]] = []
        if path is None:
            return
        head = {"version": _VERSION, "of": what}
        self._head = "" if resume else json.dumps(head) + "\n"
        if resume:
            self._kept = _read(path, head)

    def look(
        self,
        point: Point,
        reject: Collection[str] = (),
        also: Collection[tuple[str, str]] = (),
        say: Say = lambda words, share: None,
    ) -> Round:
        """One round from a point, as `round.look`: read where it is kept, else judged and kept."""
        asked = {"terms": [list(term.key) for term in point.state.terms], "reject": sorted(reject)}
        if self._kept:
            kept = self._kept.pop(0)
            if kept["asked"] == asked:
                return _round(kept["round"], point)
            self._kept.clear()
        made = look(point, reject, also, say)
        self._keep({"asked": asked, "round": _packed(made)})
        return made

    def _keep(self, line: Mapping[str, Any]) -> None:
        """Add a line; the first one begins the file, in a folder that is made where it does not exist."""
        if self._path is None:
            return
        self._path.parent.mkdir(parents=True, exist_ok=True)
        try:
            if self._head:
                # Not through a link that stands there.
                self._path.unlink(missing_ok=True)
            with self._path.open("x" if self._head else "a", encoding="utf-8") as file:
                file.write(f"{self._head}{json.dumps(line)}\n")
        except OSError as error:
            # Writing does not say what was written to; half a round is of no use.
            self._path.unlink(missing_ok=True)
            raise OSError(error.errno, error.strerror, str(self._path)) from None
        self._head = ""

    def forget(self) -> None:
        """The search is finished: its rounds are needed no more."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)


def fingerprint(recording: Recording, model: Model, *beside: Collection[str]) -> str:
    """Of all that the rounds of a search hang on: the samples, the model, the effects that are known.

    beside: options, the sources of further effects, and the version of the program.
    """
    made = hashlib.sha256(repr((model_toml(model), beside, sorted(BY_NAME))).encode())
    for name, table in recording.files().items():
        for column in table:
            made.update(f"{name}.{column}".encode())
            made.update(np.ascontiguousarray(table[column]).tobytes())
    return made.hexdigest()


def _read(path: Path, head: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The rounds of a file that are whole; what follows the last of them is cut off."""
    if not path.exists():
        raise InputError(f"{path.parent}: no search was stopped there; leave out --resume")
    whole = path.read_text("utf-8").rpartition("\n")[0]
    try:
        first, *rounds = [json.loads(line) for line in whole.splitlines()]
    except ValueError:
        first, rounds = None, []
    if first != head:
        raise InputError(
            f"{path}: is of another log, model, choice of options or version of hubodo; leave out --resume"
        )
    write_atomically(path, whole + "\n")
    return rounds


def _packed(made: Round) -> dict[str, Any]:
    return {
        "rivals": [_packed_rival(rival) for rival in made.rivals],
        "nothing": made.nothing,
        "screened": [[_packed_term(it.candidate.term), it.gain, it.evidence] for it in made.screened],
        "null": _text(made.null.surprises),
        "tempering": made.tempering,
    }


def _packed_rival(rival: Rival) -> dict[str, Any]:
    proposal = rival.proposal
    return {
        "term": _packed_term(rival.term),
        "numbers": [rival.gain, rival.evidence, rival.probability],
        "state": None if rival.state is None else _packed_state(rival.state),
        "proposal": None
        if proposal is None
        else [proposal.gain, proposal.evidence, dict(proposal.sigmas), proposal.where],
    }


def _packed_state(state: State) -> dict[str, Any]:
    return {
        "terms": [_packed_term(term) for term in state.terms],
        "starts": {name: [start.wheel_angle, list(start.attitude)] for name, start in state.starts.items()},
        "paths": {name: _text(path) for name, path in state.paths.items()},
        "late": {name: _text(late) for name, late in state.late.items()},
    }


def _packed_term(term: ModelTerm) -> list[Any]:
    return [term.effect.name, term.effect.values(), term.scope, term.fitted]


def _round(kept: Mapping[str, Any], point: Point) -> Round:
    screened = []
    for term, gain, evidence in kept["screened"]:
        # What the others of its round were judged with went with them.
        candidate = Candidate(_term(term), np.empty((0, 0)))
        screened.append(Screened(candidate, gain, evidence, np.empty(0), np.empty((0, 0))))
    rivals = tuple(_rival(rival, point) for rival in kept["rivals"])
    null = NullDistribution(_array(kept["null"]))
    return Round(point.bare(), rivals, kept["nothing"], tuple(screened), null, kept["tempering"])


def _rival(kept: Mapping[str, Any], point: Point) -> Rival:
    term, state, proposal = _term(kept["term"]), kept["state"], kept["proposal"]
    gain, evidence, probability = kept["numbers"]
    return Rival(
        term,
        gain,
        evidence,
        probability,
        None if state is None else _state(state, point),
        None if proposal is None else Proposal(term, *proposal),
    )


def _state(kept: Mapping[str, Any], point: Point) -> State:
    return State(
        point.problem,
        tuple(_term(term) for term in kept["terms"]),
        {name: NodeInitialState(angle, (x, y, z)) for name, (angle, (x, y, z)) in kept["starts"].items()},
        {name: _array(path) for name, path in kept["paths"].items()},
        {name: _array(late) for name, late in kept["late"].items()},
    )


def _term(kept: Sequence[Any]) -> ModelTerm:
    name, values, scope, fitted = kept
    kind = empirical(name) if name.startswith(PREFIX) else BY_NAME[name]
    return ModelTerm(kind(**values), scope, fitted)


def _text(values: Array) -> str:
    return base64.b64encode(np.asarray(values, "<f8").tobytes()).decode("ascii")


def _array(text: str) -> Array:
    return np.frombuffer(base64.b64decode(text), "<f8").astype(float)
