"""The complete search, called from Python."""

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
