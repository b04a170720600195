"""`tools/constants.py` reports private constants of one name with two values."""

import ast

import constants


def test_private_constants_are_collected_with_their_values():
    source = "_A = 1\n_B: int = const(2)\nC = 3\n_d = 4\n_E: int\nclass K:\n    _F = 5\n"
    assert list(constants.constants(ast.parse(source))) == [(1, "_A", "1"), (2, "_B", "2")]


def test_constants_assigned_together_have_their_own_values():
    source = "_A, _B = 1, const(2)\n(_C, d), [_E] = (3, 4), [5]\n_F = _G = 6\n_H, _I = range(2)\n"
    assert list(constants.constants(ast.parse(source))) == [
        (1, "_A", "1"),
        (1, "_B", "2"),
        (2, "_C", "3"),
        (2, "_E", "5"),
        (3, "_F", "6"),
        (3, "_G", "6"),
        (4, "_H", "range(2), item 0"),
        (4, "_I", "range(2), item 1"),
    ]


def test_a_name_with_two_values_is_reported_where_a_folder_defines_it():
    defined = {
        "_LIMIT": {"3": ["host/hubodo/a/x.py:1"], "4": ["host/hubodo/b/y.py:2"]},
        "_SAME": {"3": ["host/hubodo/a/x.py:2", "host/hubodo/b/y.py:3"]},
    }
    expected = "_LIMIT has 2 values: host/hubodo/a/x.py:1, host/hubodo/b/y.py:2"
    assert list(constants.collisions(defined, ["host/hubodo/a"])) == [expected]
    assert list(constants.collisions(defined, ["firmware"])) == []
