"""Each row of the table of faults is proven by tests that exist."""

import ast
from functools import cache
from pathlib import Path

import pytest

from faults.faults import TESTS, rows
from faults.table import FAULTS


@cache
def functions(path: Path) -> set[str]:
    return {node.name for node in ast.parse(path.read_text()).body if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize("fault", FAULTS, ids=[fault.what for fault in FAULTS])
def test_the_tests_that_a_fault_names_exist(fault):
    assert fault.tests
    for test in fault.tests:
        file, _, function = test.partition("::")
        assert function in functions(TESTS / file), test


def test_a_row_of_the_table_shows_failed_tests():
    name = FAULTS[0].tests[0].partition("::")[2]
    assert any("1 failure" in line for line in rows(FAULTS[0], {name: ["passed", "failure"]}))
