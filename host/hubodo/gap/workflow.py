"""The workflow: search, reconsider each name beside its rivals, measure what shrank on data not fitted."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from hubodo.effects.empirical import PREFIX
from hubodo.gap.judge.held_out import Split, split
from hubodo.gap.judge.journal import Journal
from hubodo.gap.judge.reconsider import Rounds, beyond_chance, reconsider
from hubodo.gap.judge.round import Say
from hubodo.gap.judge.search import SearchResult, Watch, initial_state, search
from hubodo.gap.problem.build import build
from hubodo.gap.problem.problem import Problem
from hubodo.gap.process_noise.point import Point
from hubodo.gap.process_noise.residual import floor, gap
from hubodo.gap.refit.refit import refit
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ALL, VEHICLE, ModelTerm
from hubodo.gap.tell.finding import finding
from hubodo.gap.tell.remaining import remaining
from hubodo.gap.tell.result import BeforeAfter, GapResult, Verdict, by_channel
from hubodo.model.model_file import Model, ScopedEffect
from hubodo.recording import Recording

# A gap so much larger than that of noise alone is not explained, whatever was found.
_NOISE_ALONE = 1.5


def find_gap(
    recording: Recording,
    model: Model,
    *,
    accept: Collection[str] = (),
    reject: Collection[str] = (),
    where: str = "log",
    say: Say = lambda words, share: None,
    journal: Journal | None = None,
) -> GapResult:
    """Where a log and a model disagree, what is missing, and the model with it: see `find_gap_in`.

    Raises InputError when the log has not what the model needs.
    """
    problem = build(recording, model, where)
    return find_gap_in(problem, accept=accept, reject=reject, say=say, journal=journal)


def find_gap_in(
    problem: Problem,
    *,
    accept: Collection[str] = (),
    reject: Collection[str] = (),
    say: Say = lambda words, share: None,
    journal: Journal | None = None,
) -> GapResult:
    """What is missing in the model of a problem, and the model with it. The log itself is not needed for it.

    accept: names of effects that are added before anything is searched. reject: names not considered.
    journal: keeps the rounds of the search, and has those of one that was stopped. With one, a
    KeyboardInterrupt ends the search with what it has found, where it has found anything.
    """
    say("following the wheels", 0.02)
    begin, found = initial_state(problem), list[SearchResult]()
    watch = Watch(journal or Journal(), say, found.append)
    try:
        found.append(search(begin, accept, reject, watch))
        last, rounds = reconsider(found[-1], accept, reject, watch)
        last, rounds = beyond_chance(last, rounds, accept)
        last = replace(last, final=last.final.bare())
    except KeyboardInterrupt:
        if journal is None or not found:
            raise
        return _unfinished(begin, found[-1], say)
    say("measuring on what was not fitted", 0.9)
    there = {term.effect.name for term in last.final.state.terms}
    unseen = [f"{name}: accepted, but nothing in this log shows it" for name in accept if name not in there]
    return _result(begin, last, rounds, (*problem.warnings, *unseen))


def _unfinished(begin: State, found: SearchResult, say: Say) -> GapResult:
    """What a search had found when it was stopped, each name as it was found."""
    say("stopped; measuring what was found so far", 0.9)
    rounds = {made.best.label: made for made in found.rounds if made.best is not None}
    here = replace(begin, problem=found.final.state.problem)
    words = "the search was stopped: more may be missing, and no name was looked at a second time"
    return replace(_result(here, found, rounds, (*begin.problem.warnings, words)), finished=False)


def _result(begin: State, found: SearchResult, rounds: Rounds, warnings: tuple[str, ...]) -> GapResult:
    problem, final = begin.problem, found.final.point.bare()
    held = split(problem)
    terms = [term for term in final.state.terms if term.fitted]
    given = [term for term in final.state.terms if not term.fitted]
    stages = [_stage(begin, terms[:k], final) for k in range(len(terms))]
    outside = [_trained(one.bare(), held) for one in (*stages, final)]
    steps = [*(one.bare().residuals for one in stages), final.residuals]
    left, structured = remaining(final, steps[-1])
    del final  # What was worked out of it is large.
    findings = []
    for k, term in enumerate(terms):
        one = finding(term, found, rounds, steps[k : k + 2], outside[k : k + 2])
        findings += by_channel(one) if one.effect.startswith(PREFIX) else [one]
    whole = BeforeAfter(gap(steps[0]), gap(steps[-1]), floor(steps[-1]))
    unexplained = structured or whole.after > _NOISE_ALONE * floor(steps[-1])
    verdict: Verdict
    if findings:
        verdict = "partly_explained" if unexplained else "explained"
    else:
        verdict = "unexplained" if unexplained else "no_gap"
    return GapResult(
        verdict,
        whole,
        BeforeAfter(outside[0], outside[-1]),
        held.kind,
        tuple(findings),
        tuple(left),
        warnings,
        _with(problem.model, [*given, *terms]),
        found,
        tuple(steps),
    )


def _stage(begin: State, terms: Sequence[ModelTerm], final: Point) -> Point:
    """The model as it was with only the first effects found, fitted anew."""
    keys = {term.key for term in terms}
    kept = [term for term in begin.terms if term.key not in keys]
    return refit(final.at(begin.with_terms([*kept, *terms])), rounds=2).point.bare()


def _trained(point: Point, held: Split) -> float:
    """The gap on what was held out, with the terms fitted to the rest."""
    trained = refit(replace(point, weights=held.without(point.weights)), rounds=2).bare()
    return gap(point.at(trained.state).residuals, held.inside)


def _with(model: Model, terms: Sequence[ModelTerm]) -> Model:
    scoped = [
        ScopedEffect(term.effect, None if term.scope in (ALL, VEHICLE) else term.scope) for term in terms
    ]
    return replace(model, effects=()).with_effects(*scoped)
