"""What an effect from outside is worth in a log: the gap on stretches that it was not fitted to."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hubodo.effects import Effect
from hubodo.effects.empirical import PREFIX
from hubodo.gap.judge.held_out import split_held_out
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.residual import compute_gap
from hubodo.gap.refit.refit import refit, refit_with_weights
from hubodo.gap.state.terms import ModelTerm
from hubodo.log.any_log import read_log
from hubodo.model.model_file import read_model


def held_out_gaps(log: Path, model: Path, effect: Effect, scope: str) -> tuple[float, float]:
    """Without and with an effect, each fitted to the other stretches, whatever the model file has of it.

    scope: a node, all or vehicle. Raises InputError, ConfigError or LogError where the files do not do.
    """
    problem = build_problem(read_log(log), read_model(model), str(log))
    begin = build_initial_state(problem)
    kept = [term for term in begin.terms if term.effect.name != effect.name]
    # Terms without a name stand for what has one now.
    begin = begin.with_terms([term for term in kept if not term.effect.name.startswith(PREFIX)])
    final = refit_with_weights(begin.with_term(ModelTerm(effect, scope))).evaluation
    held = split_held_out(problem)
    trained = replace(final, weights=held.exclude_from(final.weights))
    without, with_it = (
        compute_gap(final.with_state(refit(trained.with_state(state), rounds=4).state).residuals, held.masks)
        for state in (begin, begin.with_term(ModelTerm(effect, scope)))
    )
    return without, with_it
