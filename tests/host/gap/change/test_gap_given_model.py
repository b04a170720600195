"""The second log is judged with the model of the first where residuals are correlated."""

from types import SimpleNamespace

import pytest

from hubodo.effects import BY_NAME
from hubodo.gap.change import change as change_module
from hubodo.gap.change import given_model
from hubodo.gap.change.change import compare_with_first_log
from hubodo.gap.change.given_model import judge_second_log, model_of_fit
from hubodo.gap.explain.result import BeforeAfter, Estimate, Finding
from hubodo.gap.refit.prior import MIN_GIVEN_TEMPERING
from hubodo.gap.state.terms import ModelTerm
from hubodo.model.model_file import read_model
from vehicles import model_toml

ARM = ModelTerm(BY_NAME["lever_arm"](x=0.01, y=0.0, z=0.0), "left")


# Estimates of the first log: an effect that it has, and effects that it shows too little to name.
IN_FIRST_LOG = {
    "lever_arm": {"x": Estimate(0.01, 3e-4, "m")},
    "gyro_scale_factor": {"z": Estimate(0.004, 3e-4, "1")},
    "time_offset": {"delay": Estimate(0.0, 3e-4, "s")},
}


def finding(effect, **parameters):
    gap = BeforeAfter(2.0, 1.0)
    return Finding(effect, "left", parameters, gap, gap, 1e-4, 0.99, "left.ax", None, (), ())


@pytest.fixture
def first_fit(tmp_path):
    """A stand-in for the fit of a first log, in which the left node has a lever arm."""
    path = tmp_path / "car.toml"
    path.write_text(model_toml(0.3, 1.4), "utf-8")
    problem = SimpleNamespace(model=read_model(path), warnings=("of the first log",))
    state = SimpleNamespace(terms=(ARM,), problem=problem, has_steady_wheels=True)
    state.with_term = lambda term: SimpleNamespace(terms=(ARM, term))
    return SimpleNamespace(
        state=state,
        free_terms=(ARM,),
        tempering=2.0 * MIN_GIVEN_TEMPERING,
        evaluation=SimpleNamespace(with_state=lambda state: state),
    )


@pytest.fixture
def judge(monkeypatch, first_fit):
    """Return the result for findings in the second log."""
    monkeypatch.setattr(given_model, "estimate_parameters", lambda term, fit: IN_FIRST_LOG[term.effect.name])
    monkeypatch.setattr(
        given_model, "refit", lambda evaluation, rounds: SimpleNamespace(free_terms=evaluation.terms)
    )

    def run(*findings):
        null = SimpleNamespace(p_value=lambda gain, freedom: 1e-5)
        hypothesis = SimpleNamespace(p_value=lambda null: null.p_value(100.0, 3))
        rounds = [SimpleNamespace(hypotheses=(hypothesis,), null_distribution=null)]
        named = [one for one in findings if one.effect in BY_NAME]
        terms = tuple(ModelTerm(BY_NAME[one.effect](), one.scope) for one in named)
        final = SimpleNamespace(state=SimpleNamespace(terms=terms))
        search = SimpleNamespace(rounds=rounds, final=final)
        missing = SimpleNamespace(found=findings, search=search, model="after", warnings=("of the second",))

        def search_second_log(problem, *, has_steady_wheels, report_progress):
            assert has_steady_wheels is first_fit.state.has_steady_wheels
            return missing

        monkeypatch.setattr(given_model, "find_problem_gap", search_second_log)
        problem = SimpleNamespace(model=model_of_fit(first_fit))
        return judge_second_log(first_fit, problem, "after", lambda words, share: None)

    return run


def test_the_second_log_is_judged_with_the_named_effects_of_the_first(first_fit):
    unnamed = SimpleNamespace(effect=SimpleNamespace(name="empirical:left.gz ~ spin"))
    first_fit.state.terms = (ARM, unnamed)
    assert [(item.effect, item.node) for item in model_of_fit(first_fit).effects] == [(ARM.effect, "left")]


def test_a_second_log_that_lacks_nothing_is_unchanged(judge):
    result = judge()
    assert not result.has_changed and result.changes == () and result.is_correlated
    assert result.model_after == "after"
    assert result.warnings == ("of the first log", "of the second")


def test_a_change_of_a_known_effect_has_the_sigmas_of_both_logs(judge):
    result = judge(finding("lever_arm", x=Estimate(0.16, 4e-4, "m", model_value=0.01)))
    before, after, change = result.changes[0].values["x"]
    assert (before.value, after.value) == (0.01, 0.16)
    assert (change.value, change.sigma) == pytest.approx((0.15, 5e-4))
    assert result.p_value == 1e-5 and result.changes[0].p_value == 1e-4


@pytest.mark.parametrize(
    ("value", "sigma", "is_change"), [(0.016, 4e-4, True), (0.014, 4e-4, False), (0.016, 1e-3, False)]
)
def test_a_change_exceeds_half_a_usual_size_and_six_sigmas_of_both_logs(value, sigma, is_change, judge):
    """A lever arm has a usual size of 10 mm, and 0.3 mm in the first log."""
    result = judge(finding("lever_arm", x=Estimate(value, sigma, "m", model_value=0.01)))
    assert bool(result.changes) == is_change == result.has_changed


@pytest.mark.parametrize(("value", "is_change"), [(0.010, True), (0.008, False)])
def test_what_the_first_log_may_have_as_well_is_no_change(value, is_change, judge):
    """The first log shows a scale of 0.4 % too little to name it, and the usual size is 1 %."""
    result = judge(finding("gyro_scale_factor", z=Estimate(value, 4e-4, "1")))
    assert bool(result.changes) == is_change == result.has_changed
    for before, after, change in (one.values["z"] for one in result.changes):
        assert (before.value, after.value, change.value) == (0.0, 0.010, 0.010)


def test_an_effect_on_scatter_that_the_first_log_does_not_show_is_absent_there(judge):
    result = judge(finding("sample_repeat", probability=Estimate(0.08, 1e-3, "1")))
    before, _, change = result.changes[0].values["probability"]
    assert (before.value, before.sigma) == (0.0, None)
    assert (change.value, change.sigma) == (0.08, 1e-3)


def test_changes_of_the_vehicle_precede_those_of_the_drive_and_unnamed_terms_are_no_changes(judge):
    offset = finding("time_offset", delay=Estimate(0.02, 1e-4, "s"))
    scale = finding("gyro_scale_factor", z=Estimate(0.02, 1e-4, "1"))
    result = judge(offset, finding("empirical:left.gz ~ spin"), scale)
    assert [change.effect for change in result.changes] == ["gyro_scale_factor", "time_offset"]
    assert result.vehicle_changes == result.changes[:1]
    assert result.unnamed_terms == ("empirical:left.gz ~ spin",)


@pytest.mark.parametrize(
    ("ratio", "is_elsewhere", "expected"),
    [(1.1, False, "model of the first"), (1.1, True, "joint fit"), (0.9, False, "joint fit")],
)
def test_independent_residuals_and_remounted_sensors_need_a_joint_fit(
    ratio, is_elsewhere, expected, first_fit, monkeypatch
):
    first_fit.tempering = ratio * MIN_GIVEN_TEMPERING
    for name, value in {
        "build_problem": None,
        "is_remounted": is_elsewhere,
        "judge_second_log": "model of the first",
        "_compare_jointly": "joint fit",
    }.items():
        monkeypatch.setattr(change_module, name, lambda *arguments, value=value: value)
    assert compare_with_first_log(first_fit, None) == expected
