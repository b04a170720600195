"""The whole search from Python."""

from hubodo.gap.workflow import find_gap
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model


def test_a_log_without_hidden_effects_has_no_gap_and_progress_ends_near_the_end(nothing):
    shares = []
    recording, model = read_folder(nothing), read_model(nothing / "model.toml")
    result = find_gap(recording, model, report_progress=lambda words, share: shares.append(share))
    assert result.verdict == "no_gap" and result.found == () and result.is_finished
    assert result.model.effects == model.effects
    # The first report precedes the search, which counts from zero.
    assert shares[1:] == sorted(shares[1:]) and 0.8 < shares[-1] <= 1.0
