"""The command-line parser, which reports errors in one line with exit code 2 and suggests what was meant."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from hubodo.spelling import suggest_spelling

EXIT_REFUSED = 2

_MAX_LISTED_CHOICES = 15
_SYNONYMS: dict[str, tuple[str, ...]] = {
    "--axis": ("--channel g{}",),
    "--channel": ("--axis {}",),
    "--overwrite": ("--force",),
    "--yes": ("--force",),
    "-f": ("--force",),
    "-o": ("--report {}",),
    "--output": ("--report {}",),
    "--out": ("--output {}", "--report {}"),
    "--output-dir": ("--output {}",),
    "--model": ("--vehicle {}",),
    "--config": ("--vehicle {}",),
    "--sensor": ("--node {}",),
    "--frequency": ("--rate {}",),
    "--hz": ("--rate {}",),
    "--time": ("--duration {}", "--moving {}"),
    "--seconds": ("--duration {}", "--moving {}"),
    "--duration": ("--moving {}",),
    "--port": ("--at 127.0.0.1:{}",),
    "--verbose": ("--debug",),
    "-v": ("--vehicle TOML", "--version", "--debug"),
    "--plot": ("--figure {}",),
    "--wheel": ("--diameter {}",),
    "--wheel-diameter": ("--diameter {}",),
    "--wheel-radius": ("--radius {}",),
    "-n": ("--node {}",),
    "-r": ("--rate {}", "--report {}"),
}
"""Option that people try: the options that do it in the verbs, with how its value is written there."""


_ELSEWHERE = {
    "--wheel-radius": "sizes stand in a vehicle file: `hubodo vehicle new` writes it, --vehicle names it",
    "--wheel-diameter": "sizes stand in a vehicle file: `hubodo vehicle new` writes it, --vehicle names it",
    "--track-width": "sizes stand in a vehicle file: `hubodo vehicle new` writes it, --vehicle names it",
    "--report": "`hubodo report LOG` writes the page",
    "--plot": "`hubodo report LOG` writes a page with figures",
    "--sim": "`hubodo demo` records virtual nodes",
    "--simulate": "`hubodo demo` records virtual nodes",
}
"""Option that people try: what does it, in verbs that have no option for it."""
_LOG_PURPOSES = ("--still", "--warmup", "--poses")
"""Options of a verb whose logs have different purposes."""
_VERB_SYNONYMS = {
    "convert": (("import", "export"),),
    "plot": (("report",),),
    "view": (("report", "serve"),),
    "show": (("report", "serve"), ("check",)),
    "open": (("report", "serve"),),
    "replay": (("play",),),
    "run": (("record",),),
    "odometry": (("fuse",),),
    "odom": (("fuse",),),
    "track": (("fuse",),),
    "trajectory": (("fuse",),),
    "list": (("logs",), ("info",)),
    "web": (("serve",),),
}
"""Verb or kind that people try: those that do it, of which the first group applies that the parser has."""


class UsageError(SystemExit):
    """An invalid command line; it exits with EXIT_REFUSED unless it is caught and reported."""

    def __init__(self, text: str) -> None:
        super().__init__(EXIT_REFUSED)
        self.text = text


class Parser(argparse.ArgumentParser):
    """An ArgumentParser that raises UsageError instead of printing the usage."""

    def _parse_optional(self, arg_string: str) -> Any:
        """Treat `-,gx`, a list that begins with an ignored column, as a value and not as an option."""
        return None if arg_string.startswith("-,") else super()._parse_optional(arg_string)

    def error(self, message: str) -> NoReturn:
        """Raise UsageError with the message and a hint at --help.

        A misspelt option is reported instead of the required argument that is missing because of it.
        """
        if message.startswith("the following arguments are required"):
            known = [option for action in self._actions for option in action.option_strings]
            unknown = [word for word in self._words if _is_option(word) and not _is_known(word, known)]
            if unknown:
                message = _describe_unknown(
                    self, argparse.Namespace(), self._words[self._words.index(unknown[0]) :]
                )
            else:
                message += "".join(map(_list_choices, self._actions))
        line = " ".join(message.split())
        raise UsageError(f"{self.prog}: {line}; see {self.prog} --help")

    _words: Sequence[str] = ()

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse as ArgumentParser does; `--origin 47,8` is `--origin 47 8`. Errors name the words."""
        words = None if args is None else self._split_pairs(args)
        self._words = words or []
        return super().parse_known_args(words, namespace)

    def _split_pairs(self, words: Sequence[str]) -> list[str]:
        """Return the words with the value of an option for two values split at a comma or space."""
        pairs = {name for action in self._actions if action.nargs == 2 for name in action.option_strings}
        split: list[str] = []
        for before, word in zip(["", *words], words, strict=False):
            parts = word.replace(",", " ").split()
            split += parts if before in pairs and len(parts) == 2 else [word]
        return split

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Return the parsed arguments; the error for an unknown one suggests the option that was meant."""
        parsed, unknown = self.parse_known_args(args, namespace)
        if unknown:
            verb = _innermost_parser(self, parsed)
            verb.error(_describe_unknown(verb, parsed, unknown))
        return parsed

    def _get_value(self, action: argparse.Action, arg_string: str) -> Any:
        """Return the value of an argument; raise ArgumentError for an empty path."""
        if action.type is Path and not arg_string:
            raise argparse.ArgumentError(action, "is empty; name a file or folder")
        return super()._get_value(action, arg_string)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Raise ArgumentError for a value that is no choice, with the nearest one."""
        if action.choices is None or value in action.choices:
            return
        choices = [str(choice) for choice in action.choices]
        meant = next(
            (verbs for verbs in _VERB_SYNONYMS.get(str(value), ()) if set(verbs) <= set(choices)), None
        )
        nearest = f", write {' or '.join(meant)}" if meant else suggest_spelling(str(value), choices)
        text = f"unknown {value!r}{nearest}"
        if len(choices) <= _MAX_LISTED_CHOICES:
            text += f"; choose from {', '.join(choices)}"
        if not action.option_strings and any(word in choices for word in self._words):
            text += "; check the order of the arguments"
        raise argparse.ArgumentError(action, text)


def _list_choices(action: argparse.Action) -> str:
    """Return the choices of a required argument that has no option, such as the kind of `hubodo vehicle`."""
    if action.option_strings or not action.choices or len(list(action.choices)) > _MAX_LISTED_CHOICES:
        return ""
    return f"; choose from {', '.join(map(str, action.choices))}"


def _innermost_parser(parser: argparse.ArgumentParser, parsed: argparse.Namespace) -> argparse.ArgumentParser:
    """Return the parser of the verb, and of its kind, that a command line names."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            below = action.choices.get(getattr(parsed, action.dest, ""))
            if below is not None:
                return _innermost_parser(below, parsed)
    return parser


def _is_option(word: str) -> bool:
    """Return True for a word that can only be an option: no negative number, and no list such as `-,gx`."""
    return word.startswith("--") or (len(word) == 2 and word[0] == "-" and word[1].isalpha())


def _is_known(word: str, known: Sequence[str]) -> bool:
    """Return True for an option or the beginning of one."""
    return any(option.startswith(word.partition("=")[0]) for option in known)


def _describe_unknown(
    parser: argparse.ArgumentParser, parsed: argparse.Namespace, unknown: Sequence[str]
) -> str:
    """Return the error for arguments that a verb does not have, with the argument that was meant."""
    known = [option for action in parser._actions for option in action.option_strings]
    option = next((word for word in unknown if word.startswith("-")), None)
    if option is None:
        return f"unexpected argument {unknown[0]!r}{_suggest_order(known, parsed, unknown[0])}"
    name, _, value = option.partition("=")
    following = unknown[unknown.index(option) + 1 :]
    value = value or (following[0] if following and not following[0].startswith("-") else "")
    if not value and name == "--axis":  # argparse has taken its value for LOG
        log = getattr(parsed, "log", "")
        log = str(log[0] if isinstance(log, list) and log else log)
        value = log if log in ("x", "y", "z") else "z"
    for synonym in _SYNONYMS.get(name, ()):
        if synonym.split()[0] in known:
            return f"unknown option {name}, write {synonym.format(value).rstrip()}"
    if name in _ELSEWHERE:
        return f"unknown option {name}: {_ELSEWHERE[name]}"
    return f"unknown option {name}{suggest_spelling(name, known)}"


def _suggest_order(known: Sequence[str], parsed: argparse.Namespace, extra: str) -> str:
    """Return the command line to write where a vehicle file or an option stands in the place of the log."""
    if purposes := [option for option in known if option in _LOG_PURPOSES]:
        return f", write {' or '.join(f'{option} {extra}' for option in purposes)}"
    log = str(getattr(parsed, "log", getattr(parsed, "source", "")))
    if "--vehicle" in known and log.endswith(".toml") and getattr(parsed, "vehicle", None) is None:
        return f": {log} is no log, write {extra} --vehicle {log}"
    if "--vehicle" in known and extra.endswith(".toml") and getattr(parsed, "vehicle", None) is None:
        return f", write --vehicle {extra}"
    if log and (Path(extra).exists() or extra.endswith((".csv", ".mcap"))):
        return "; one log at a time: `hubodo batch` takes several, `hubodo import FOLDER` joins one drive"
    return ""
