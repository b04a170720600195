"""The complete search, called from Python."""

from gap_matrix.make_case import write_case
from hubodo.gap.workflow import find_gap
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model


def test_a_clean_log_has_no_gap_and_the_reported_progress_increases(clean_log):
    shares = []
    recording, model = read_folder(clean_log), read_model(clean_log / "model.toml")
    result = find_gap(recording, model, report_progress=lambda text, share: shares.append(share))
    assert result.verdict == "no_gap" and result.found == () and result.is_finished
    assert result.model.effects == model.effects
    assert shares == sorted(shares) and 0.8 < shares[-1] <= 1.0


def test_progress_increases_from_the_search_of_decimated_samples_to_that_of_all_samples(tmp_path):
    write_case(tmp_path, 3, [], duration=40.0, rate_hz=250.0, vibration=0.0)
    recording, model = read_folder(tmp_path), read_model(tmp_path / "model.toml")
    reports = []
    find_gap(recording, model, accept=["track_width"], report_progress=lambda *report: reports.append(report))
    texts, shares = zip(*reports, strict=True)
    assert texts.count("round 1: every effect in every scope") == 2
    assert list(shares) == sorted(shares) and shares[0] == 0.0
