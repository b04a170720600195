"""Every option of every verb is exercised by a command line, which ends as expected."""

import argparse
import threading
from contextlib import ExitStack, contextmanager, suppress
from functools import cache

import pytest
from option_runs import RUNS, create_files

from fakes.fake_node import FakeNode
from hubodo.cli import build_parser
from hubodo.effects import BY_NAME
from hubodo.ingest.live.virtual_computer import VirtualComputer
from hubodo.verbs import VERBS
from in_process import hubodo

BATCH = "batch"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("options")
    create_files(root)
    return root


@pytest.fixture(autouse=True)
def isolated_run(monkeypatch, folder):
    """Run in the folder, stop servers at once, and remove the effects that a run adds."""
    known = dict(BY_NAME)
    monkeypatch.chdir(folder)
    monkeypatch.setattr("hubodo.verbs.serve.stop_on_signals", stop_at_once)
    yield
    BY_NAME.clear()
    BY_NAME.update(known)


@contextmanager
def stop_at_once(stopping: threading.Event):
    stopping.set()
    yield stopping


def commands(parser, words):
    """Yield the words and the parser of a verb and of all its subcommands."""
    below = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    yield words, parser
    for action in below:
        for name, child in action.choices.items():
            # The subcommands of batch create their options when they first parse.
            with suppress(SystemExit):
                child.parse_known_args([])
            yield from commands(child, (*words, name))


@cache
def parser_of_verb(verb):
    """Return the parser of one verb."""
    return next(action for action in build_parser([verb])._actions if action.dest == "verb").choices[verb]


def options(parser):
    """Return {destination: (default, spelling)} of a parser, without the options common to all verbs."""
    return {
        action.dest: (action.default, action.option_strings[-1])
        for action in parser._actions
        if action.option_strings
        and not isinstance(action, argparse._HelpAction)
        and action.dest not in ("json", "debug")
    }


def all_options():
    """Return (verb, destination, spelling) of every option, without those that batch passes to a verb."""
    every = set()
    for verb in VERBS:
        for words, parser in commands(parser_of_verb(verb), (verb,)):
            given_options = options(parser)
            if words[0] == BATCH and len(words) > 1:
                elsewhere = {
                    dest
                    for _, child in commands(parser_of_verb(words[1]), words[1:])
                    for dest in options(child)
                }
                given_options = {
                    dest: option for dest, option in given_options.items() if dest not in elsewhere
                }
            every |= {
                (words[0] if words[0] == BATCH else words, dest, shown)
                for dest, (_, shown) in given_options.items()
            }
    return every


def exercised_options(words):
    """Yield (verb, destination, spelling) of each option whose value a command line changes."""
    verb = words[0]
    parsed = build_parser(words).parse_args(words)
    for below, parser in commands(parser_of_verb(verb), (verb,)):
        if below == tuple(words[: len(below)]):
            for dest, (default, shown) in options(parser).items():
                if getattr(parsed, dest, default) != default:
                    yield verb if verb == BATCH else below, dest, shown


def test_every_option_of_every_verb_has_a_command_line_that_changes_it(capsys):
    missing = all_options()
    for run in RUNS:
        for words in run.command_lines.format(n=0, port="port").split(" ; "):
            missing -= set(exercised_options(words.split()))
    capsys.readouterr()
    assert not missing, "add a command line to option_runs.py for " + ", ".join(
        f"{words if isinstance(words, str) else ' '.join(words)} {shown}"
        for words, _, shown in sorted(missing, key=str)
    )


@pytest.mark.parametrize(
    "number", range(len(RUNS)), ids=[run.command_lines.partition("{")[0][:60] for run in RUNS]
)
def test_a_command_line_ends_as_expected(number):
    run = RUNS[number]
    with ExitStack() as stack:
        port = computer = None
        if "{port}" in run.command_lines:
            # A recorded node runs in virtual time; a queried one runs in real time.
            computer = VirtualComputer() if run.command_lines.startswith("record") else None
            port = stack.enter_context(FakeNode(computer=computer)).path
        for words in run.command_lines.format(n=number, port=port).split(" ; "):
            done = hubodo(*words.split(), computer=computer)
    assert done.code == run.code, done.err
    assert run.message in done.err
    assert "defect of hubodo" not in done.err
    assert ("Traceback" in done.err) <= ("--debug" in run.command_lines), done.err
