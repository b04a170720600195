"""Names of test files: two with the same name are reported, as pytest would collect neither."""

import house


def test_two_test_files_of_one_name_are_reported_with_their_folders(tmp_path):
    for name in ("a/test_noise.py", "b/test_noise.py", "b/test_bias.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    lines = list(house._equal_test_names(tmp_path))
    assert lines == ["test_noise.py is the name of 2 test files: in a, b"]
