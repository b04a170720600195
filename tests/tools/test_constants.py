"""`tools/constants.py` reports private constants of one name with two values."""

import ast

import constants


def test_private_constants_are_collected_with_their_values():
    source = "_A = 1\n_B: int = const(2)\nC = 3\n_d = 4\n_E: int\nclass K:\n    _F = 5\n"
    assert list(constants.constants(ast.parse(source))) == [(1, "_A", "1"), (2, "_B", "2")]


def test_a_name_with_two_values_is_reported_where_a_folder_defines_it():
    defined = {
        "_LIMIT": {"3": ["host/hubodo/a/x.py:1"], "4": ["host/hubodo/b/y.py:2"]},
        "_SAME": {"3": ["host/hubodo/a/x.py:2", "host/hubodo/b/y.py:3"]},
    }
    expected = "_LIMIT has 2 values: host/hubodo/a/x.py:1, host/hubodo/b/y.py:2"
    assert list(constants.collisions(defined, ["host/hubodo/a"])) == [expected]
    assert list(constants.collisions(defined, ["firmware"])) == []
