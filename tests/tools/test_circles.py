"""Circles of imports: a planted one is reported, at the top and within a function."""

from __future__ import annotations

import pytest

from circles import find_circle

CHAIN = {"a": "import b", "b": "from c import d", "c": "", "c.d": ""}


@pytest.mark.parametrize("line", ["import a", "from a import x", "def f():\n    from a import x"])
def test_a_circle_is_reported_with_its_modules(line: str) -> None:
    circle = find_circle(CHAIN | {"c": line})
    assert circle == []  # b imports the module c.d, not c
    assert set(find_circle(CHAIN | {"c.d": line})) == {"a", "b", "c.d"}


def test_imports_for_type_checkers_do_not_count() -> None:
    assert find_circle(CHAIN | {"c.d": "if TYPE_CHECKING:\n    import a"}) == []
    assert find_circle(CHAIN | {"c.d": "import os"}) == []
