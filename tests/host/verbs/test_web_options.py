"""Options of the live page, of Foxglove and of nodes on UDP: command line over file over default."""

import argparse
from pathlib import Path

import pytest

from hubodo.verbs.key_options import add_key_arguments, key_settings
from hubodo.verbs.web_options import add_web_arguments, live_views, web_config


def _parse(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument("--config", type=Path)
    parser.add_argument("--vehicle", type=Path)
    add_web_arguments(parser)
    add_key_arguments(parser)
    return parser.parse_args(words)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A configuration file with a page and a token."""
    path = tmp_path / "hubodo.toml"
    path.write_text('[web]\nlisten = "127.0.0.1:9000"\ntoken_file = "secret"\n')
    return path


def test_an_option_replaces_the_setting_of_the_file_and_leaves_the_others(file: Path) -> None:
    config = web_config(_parse("--config", str(file), "--web", "127.0.0.1:9001"))
    assert config.listen == "127.0.0.1:9001"
    assert config.token_file is not None and "secret" in str(config.token_file)
    assert web_config(_parse("--config", str(file))).listen == "127.0.0.1:9000"


def test_an_option_without_address_asks_for_the_default_and_is_not_the_same_as_none() -> None:
    assert web_config(_parse("--web")).listen == ""
    assert web_config(_parse()).listen is None
    assert web_config(_parse("--foxglove")).foxglove == ""


def test_without_page_and_foxglove_there_is_no_audience(tmp_path: Path) -> None:
    config = tmp_path / "hubodo.toml"
    config.write_text("")
    for words in ((), ("--config", str(config))):
        with live_views(_parse(*words), tmp_path / "log.mcap", None) as audience:
            assert audience is None


def test_key_settings_are_none_where_nothing_is_given_so_that_the_file_counts() -> None:
    assert key_settings(_parse()) == {"key_file": None, "insecure_udp": None, "insecure_ble": None}
    settings = key_settings(_parse("--key-file", "keys.toml", "--insecure-udp"))
    assert settings == {"key_file": "keys.toml", "insecure_udp": True, "insecure_ble": None}
