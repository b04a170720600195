"""Test of a scaffolded effect: the gap on segments that it was not fitted to."""

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
    """Return the held-out gap without and with an effect, which replaces that of the model file.

    scope: name of a node, `all` or `vehicle`

    Raises InputError, ConfigError or LogError for unusable files.
    """
    problem = build_problem(read_log(log), read_model(model), str(log))
    initial_state = build_initial_state(problem)
    other_terms = [term for term in initial_state.terms if term.effect.name != effect.name]
    # The effect replaces unnamed terms.
    initial_state = initial_state.with_terms(
        [term for term in other_terms if not term.effect.name.startswith(PREFIX)]
    )
    final = refit_with_weights(initial_state.with_term(ModelTerm(effect, scope))).evaluation
    held_out_split = split_held_out(problem)
    trained = replace(final, weights=held_out_split.exclude_from(final.weights))
    without, with_it = (
        compute_gap(
            final.with_state(refit(trained.with_state(state), rounds=4).state).residuals, held_out_split.masks
        )
        for state in (initial_state, initial_state.with_term(ModelTerm(effect, scope)))
    )
    return without, with_it
