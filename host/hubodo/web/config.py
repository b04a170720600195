"""`[web]` of hubodo.toml: where the page listens and who may see it."""

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

PORT = 8642
FOXGLOVE_PORT = 8765
TOKEN_VARIABLE = "HUBODO_WEB_TOKEN_FILE"
_SHORTEST_TOKEN, _FEWEST_DISTINCT = 16, 6


@dataclass(frozen=True, slots=True)
class WebConfig:
    """``[web]`` of hubodo.toml; the command line goes before it."""

    listen: str | None = setting(
        None, "HOST:PORT of the live page; without it there is none", example=f"{LOOPBACK}:{PORT}"
    )
    foxglove: str | None = setting(
        None, "HOST:PORT of the same topics for Foxglove", example=f"{LOOPBACK}:{FOXGLOVE_PORT}"
    )
    token_file: str | None = setting(
        None,
        "a file, readable by its owner alone, whose first line visitors must know; needed beyond this "
        f"computer; the variable {TOKEN_VARIABLE} may name it too",
        example="token.txt",
    )
    cert: str | None = setting(None, "PEM file of a certificate, for https", example="cert.pem")
    key: str | None = setting(None, "PEM file of its private key", example="key.pem")
    hosts: tuple[str, ...] = setting(
        (), "names besides its own under which browsers reach this computer", example=("recorder.lan",)
    )
    job_limit: float = setting(
        3600.0,
        "s after which a verb is stopped that the page started on a recording",
        above=0,
    )


@dataclass(frozen=True, slots=True)
class Site:
    """Where a page is served, and to whom. token: None, anybody on this computer. cert, key: both or none."""

    address: Address
    token: str | None = None
    cert: Path | None = None
    key: Path | None = None
    hosts: frozenset[str] = frozenset()
    job_limit: float = 3600.0
    """s that a verb may take which the page started."""

    @property
    def url(self) -> str:
        """For the user to open; it names no token."""
        return f"{'http' if self.cert is None else 'https'}://{self.address}/"


def load_web_config(path: Path) -> WebConfig:
    """Read ``[web]`` of a hubodo.toml; paths in it are relative to the file. Raises ConfigError."""
    table = load_toml(path)
    check_known_keys(table, CONFIG_TABLES, str(path))
    config = read_table(table.get("web", {}), WebConfig, f"{path}: [web]")
    folder = path.parent.absolute()

    def beside(name: str | None) -> str | None:
        return None if name is None else str(folder / name)

    return replace(
        config,
        token_file=beside(config.token_file),
        cert=beside(config.cert),
        key=beside(config.key),
    )


def make_site(config: WebConfig, environment: Mapping[str, str] = os.environ) -> Site | None:
    """The page of a config, None where none is asked for.

    Raises InputError where it would be open to others without a token, or one of the files is not there.
    """
    if config.listen is None:
        return None
    address = parse_address(config.listen, PORT)
    given = config.token_file or environment.get(TOKEN_VARIABLE)
    token = None if not given else read_token(Path(given))
    if token is None and not address.loopback:
        raise InputError(
            f"{address}: others can reach that; give --token-file FILE with a secret of "
            f"{_SHORTEST_TOKEN} characters or more, or listen on 127.0.0.1"
        )
    if (config.cert is None) != (config.key is None):
        raise InputError("https needs both --cert and --key; give the other one too")
    files = [None if name is None else Path(name) for name in (config.cert, config.key)]
    for file in files:
        if file is not None and not file.is_file():
            raise InputError(f"{file}: is not there; --cert and --key name PEM files")
    if files[1] is not None:
        check_private(files[1], "the private key")
    hosts = frozenset(name.lower() for name in config.hosts)
    return Site(address, token, files[0], files[1], hosts, config.job_limit)


def read_token(path: Path) -> str:
    """The first line of a file that nobody else may read. Raises InputError, never with what is in it."""
    try:
        token = read_private(path, "the token", "ascii").partition("\n")[0].strip()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "its token is not plain ASCII"
        raise InputError(f"{path}: no token to be read: {reason}") from None
    if len(token) < _SHORTEST_TOKEN or len(set(token)) < _FEWEST_DISTINCT:
        raise InputError(
            f"{path}: a token has {_SHORTEST_TOKEN} characters or more, {_FEWEST_DISTINCT} of them distinct; "
            f"openssl rand -hex 16 > {path} makes one"
        )
    return token


def foxglove_address(config: WebConfig) -> Address | None:
    """Where Foxglove is served, None where it is not."""
    return None if config.foxglove is None else parse_address(config.foxglove, FOXGLOVE_PORT)
