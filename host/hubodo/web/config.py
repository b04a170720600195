"""Settings `[web]` of hubodo.toml: listening address, access and limits of the page."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from hubodo.errors import InputError
from hubodo.ingest.live.record_config import CONFIG_TABLES
from hubodo.private_files import check_private, read_private
from hubodo.settings_table import setting
from hubodo.toml_file import check_known_keys, load_toml, read_table
from hubodo.web.address import LOOPBACK, Address, parse_address

WEB_PORT = 8642
FOXGLOVE_PORT = 8765
TOKEN_VARIABLE = "HUBODO_WEB_TOKEN_FILE"
_MIN_TOKEN_LENGTH, _MIN_DISTINCT_CHARACTERS = 16, 6


@dataclass(frozen=True, slots=True)
class WebConfig:
    """Settings of ``[web]`` in hubodo.toml; the command line overrides them."""

    listen: str | None = setting(
        None, "HOST:PORT of the live page; by default there is no page", example=f"{LOOPBACK}:{WEB_PORT}"
    )
    foxglove: str | None = setting(
        None, "HOST:PORT of the live connection of Foxglove", example=f"{LOOPBACK}:{FOXGLOVE_PORT}"
    )
    token_file: str | None = setting(
        None,
        "file, readable only by its owner, whose first line is the token of visitors; required for access "
        f"from other computers; the variable {TOKEN_VARIABLE} may name it too",
        example="token.txt",
    )
    cert: str | None = setting(None, "PEM file of the certificate, for https", example="cert.pem")
    key: str | None = setting(None, "PEM file of the private key", example="key.pem")
    hosts: tuple[str, ...] = setting(
        (), "further host names under which browsers reach this computer", example=("recorder.lan",)
    )
    job_limit: float = setting(
        3600.0,
        "time limit in s of a verb that the page runs on a recording",
        above=0,
    )


@dataclass(frozen=True, slots=True)
class Site:
    """The address of the page and its access rules.

    Attributes
    ----------
    address
        Where the server listens.
    token
        Secret of the visitors; None allows anybody on this computer.
    cert, key
        PEM files for https, both or neither.
    hosts
        Further host names of this computer.
    job_limit
        Time limit in s of a verb that the page runs.
    """

    address: Address
    token: str | None = None
    cert: Path | None = None
    key: Path | None = None
    hosts: frozenset[str] = frozenset()
    job_limit: float = 3600.0

    @property
    def url(self) -> str:
        """Return the URL for the user to open; it holds no token."""
        return f"{'http' if self.cert is None else 'https'}://{self.address}/"


def load_web_config(path: Path) -> WebConfig:
    """Read ``[web]`` of a hubodo.toml, with paths relative to the file; raise ConfigError."""
    table = load_toml(path)
    check_known_keys(table, CONFIG_TABLES, str(path))
    config = read_table(table.get("web", {}), WebConfig, f"{path}: [web]")
    folder = path.parent.absolute()

    def absolute(name: str | None) -> str | None:
        return None if name is None else str(folder / name)

    return replace(
        config,
        token_file=absolute(config.token_file),
        cert=absolute(config.cert),
        key=absolute(config.key),
    )


def web_site(config: WebConfig, environment: Mapping[str, str] = os.environ) -> Site | None:
    """Return the page as configured, or None if none is.

    Raises InputError if other computers could reach it without a token, or a file does not exist.
    """
    if config.listen is None:
        return None
    address = parse_address(config.listen, WEB_PORT)
    token_file = config.token_file or environment.get(TOKEN_VARIABLE)
    token = None if not token_file else read_token(Path(token_file))
    if token is None and not address.is_loopback:
        raise InputError(
            f"{address}: other computers can reach it; give --token-file FILE with a secret of "
            f"{_MIN_TOKEN_LENGTH} characters or more, or listen on 127.0.0.1"
        )
    if (config.cert is None) != (config.key is None):
        raise InputError("https needs both --cert and --key; give both")
    files = [None if name is None else Path(name) for name in (config.cert, config.key)]
    for file in files:
        if file is not None and not file.is_file():
            raise InputError(f"{file}: does not exist; --cert and --key take PEM files")
    if files[1] is not None:
        check_private(files[1], "the private key")
    hosts = frozenset(name.lower() for name in config.hosts)
    return Site(address, token, files[0], files[1], hosts, config.job_limit)


def read_token(path: Path) -> str:
    """Return the first line of a private file; raise InputError, whose text never holds the content."""
    try:
        token = read_private(path, "the token", "ascii").partition("\n")[0].strip()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "its token is not plain ASCII"
        raise InputError(f"{path}: no token could be read: {reason}") from None
    if len(token) < _MIN_TOKEN_LENGTH or len(set(token)) < _MIN_DISTINCT_CHARACTERS:
        raise InputError(
            f"{path}: a token needs {_MIN_TOKEN_LENGTH} characters, {_MIN_DISTINCT_CHARACTERS} distinct"
            f": openssl rand -hex 16 > {path}"
        )
    return token


def foxglove_address(config: WebConfig) -> Address | None:
    """Return the address of the Foxglove server, or None."""
    return None if config.foxglove is None else parse_address(config.foxglove, FOXGLOVE_PORT)
