"""Changes where residuals are correlated: the second log is judged with the model of the first.

Effects of that model may differ by as much as one drive differs from the next. Effects that it lacks have to
pay on samples to which they were not fitted, as in `workflow.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from hubodo.effects import BY_NAME
from hubodo.effects.empirical import PREFIX
from hubodo.gap.change.result import Change, ChangeResult, subtract_estimates
from hubodo.gap.explain.finding import estimate_parameters
from hubodo.gap.explain.result import Estimate, Finding
from hubodo.gap.judge.round import ReportProgress
from hubodo.gap.judge.search import SearchResult
from hubodo.gap.problem.build import build_problem
from hubodo.gap.refit.refit import Refit
from hubodo.gap.state.terms import ALL, model_of_terms
from hubodo.gap.workflow import find_problem_gap
from hubodo.recording import Recording

# Fraction of the reported progress for the search of the first log.
FIRST_LOG_SHARE = 0.55


def judge_second_log(
    first_fit: Refit, after: Recording, log_name: str, report_progress: ReportProgress
) -> ChangeResult:
    """Return what the model of the first log lacks to explain the second log.

    first_fit: fit of the effects of the first log
    """
    terms = [term for term in first_fit.state.terms if not term.effect.name.startswith(PREFIX)]
    first_problem = first_fit.state.problem
    model = model_of_terms(first_problem.model, terms)
    missing = find_problem_gap(
        build_problem(after, model, log_name),
        report_progress=lambda words, share: report_progress(
            f"{log_name}, {words}", FIRST_LOG_SHARE + (1.0 - FIRST_LOG_SHARE) * share
        ),
    )
    named = [finding for finding in missing.found if not finding.effect.startswith(PREFIX)]
    changes = [_build_change(finding, first_fit) for finding in named]
    return ChangeResult(
        _compute_p_value(missing.search),
        tuple(sorted(changes, key=lambda change: change.belongs_to_drive)),
        tuple(finding.effect for finding in missing.found if finding not in named),
        model,
        missing.model,
        tuple(dict.fromkeys((*first_problem.warnings, *missing.warnings))),
        is_correlated=True,
    )


def _compute_p_value(search: SearchResult) -> float:
    """Return the probability that the best candidate of the first round gains as much by chance."""
    first = search.rounds[0]
    return min((one.p_value(first.null_distribution) for one in first.hypotheses), default=1.0)


def _build_change(finding: Finding, first_fit: Refit) -> Change:
    """Build the change of an effect; one that the first log does not show was absent there."""
    known, kind = _estimate_in_first_log(finding, first_fit), BY_NAME[finding.effect]
    values = {}
    for name, after in finding.parameters.items():
        given = kind.default(name) if after.model_value is None else after.model_value
        before = known.get(name, Estimate(given, None, after.unit))
        after = replace(after, model_value=None)
        values[name] = (before, after, subtract_estimates(before, after))
    return Change(finding.effect, finding.scope, values, finding.p_value, finding.where)


def _estimate_in_first_log(finding: Finding, first_fit: Refit) -> Mapping[str, Estimate]:
    """Return the parameters of an effect in the first log, of its node or of all; empty if it is absent."""
    for scope in (finding.scope, ALL):
        for term in first_fit.free_terms:
            if term.key == (finding.effect, scope):
                return estimate_parameters(term, first_fit)
    return {}
