"""The examples in the documentation of the public names run as they stand, and show what they say."""

import doctest
from importlib import import_module

import pytest

import hubodo

MODULES = ["hubodo.api.log", "hubodo.api.read", "hubodo.api.simulate"]


@pytest.mark.parametrize("module", MODULES)
def test_the_examples_of_a_module_run(module, examples, monkeypatch):
    monkeypatch.chdir(examples)
    done = doctest.testmod(import_module(module))
    assert done.attempted and not done.failed


def test_what_is_public_is_listed_once_and_can_be_had():
    homes = set(hubodo._HOME) | {"__version__"}
    assert sorted(hubodo.__all__) == sorted(homes)
    for name in hubodo.__all__:
        assert getattr(hubodo, name) is not None
    assert set(hubodo.__all__) <= set(dir(hubodo))
    with pytest.raises(AttributeError, match="no attribute 'opne'"):
        hubodo.opne  # noqa: B018
