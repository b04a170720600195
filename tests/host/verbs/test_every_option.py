"""Every option of every verb is exercised by a command line that is run, and ends as it should."""

import argparse
import threading
from contextlib import ExitStack, contextmanager, suppress

import pytest
from option_runs import RUNS, fill

from fakes.fake_node import FakeNode
from hubodo.cli import build_parser
from hubodo.effects import BY_NAME
from hubodo.ingest.live.virtual_computer import VirtualComputer
from hubodo.verbs import VERBS
from in_process import hubodo

BATCH = "batch"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("options")
    fill(made)
    return made


@pytest.fixture(autouse=True)
def as_before(monkeypatch, folder):
    """In the folder, with a server that is stopped at once; effects that a run adds are forgotten."""
    known = dict(BY_NAME)
    monkeypatch.chdir(folder)
    monkeypatch.setattr("hubodo.verbs.serve.stop_on_signals", stopped)
    yield
    BY_NAME.clear()
    BY_NAME.update(known)


@contextmanager
def stopped(stopping: threading.Event):
    stopping.set()
    yield stopping


def commands(parser, words):
    """(words of a verb and what stands below it, its parser), for all of them."""
    below = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    yield words, parser
    for action in below:
        for name, child in action.choices.items():
            # The verbs of batch read their options when they parse for the first time.
            with suppress(SystemExit):
                child.parse_known_args([])
            yield from commands(child, (*words, name))


def of_verb(verb):
    """The parser of a verb alone."""
    return next(action for action in build_parser([verb])._actions if action.dest == "verb").choices[verb]


def options(parser):
    """{destination: (default, spelling)} of the options of one parser, but for those that every verb has."""
    return {
        action.dest: (action.default, action.option_strings[-1])
        for action in parser._actions
        if action.option_strings
        and not isinstance(action, argparse._HelpAction)
        and action.dest not in ("json", "debug")
    }


def wanted():
    """(verb, destination, spelling) of every option; what batch hands to another verb is exercised there."""
    every = set()
    for verb in VERBS:
        for words, parser in commands(of_verb(verb), (verb,)):
            given_options = options(parser)
            if words[0] == BATCH and len(words) > 1:
                elsewhere = {
                    dest for _, child in commands(of_verb(words[1]), words[1:]) for dest in options(child)
                }
                given_options = {
                    dest: option for dest, option in given_options.items() if dest not in elsewhere
                }
            every |= {
                (words[0] if words[0] == BATCH else words, dest, shown)
                for dest, (_, shown) in given_options.items()
            }
    return every


def exercised(words):
    """Yield (verb, destination, spelling) of each option whose value a command line changes."""
    verb = words[0]
    parsed = build_parser(words).parse_args(words)
    for below, parser in commands(of_verb(verb), (verb,)):
        if below == tuple(words[: len(below)]):
            for dest, (default, shown) in options(parser).items():
                if getattr(parsed, dest, default) != default:
                    yield verb if verb == BATCH else below, dest, shown


def test_every_option_of_every_verb_has_a_command_line_that_changes_it(capsys):
    left = wanted()
    for run in RUNS:
        for words in run.words.format(n=0, port="port").split(" ; "):
            left -= set(exercised(words.split()))
    capsys.readouterr()
    assert not left, "add a command line to option_runs.py for " + ", ".join(
        f"{words if isinstance(words, str) else ' '.join(words)} {shown}"
        for words, _, shown in sorted(left, key=str)
    )


@pytest.mark.parametrize("number", range(len(RUNS)), ids=[run.words.partition("{")[0][:60] for run in RUNS])
def test_a_command_line_ends_as_it_should(number):
    run = RUNS[number]
    with ExitStack() as stack:
        port = computer = None
        if "{port}" in run.words:
            # A node that is recorded lives in virtual time; one that is asked answers in its own.
            computer = VirtualComputer() if run.words.startswith("record") else None
            port = stack.enter_context(FakeNode(computer=computer)).path
        for words in run.words.format(n=number, port=port).split(" ; "):
            done = hubodo(*words.split(), computer=computer)
    assert done.code == run.code, done.err
    assert run.says in done.err
    assert "defect of hubodo" not in done.err
    assert ("Traceback" in done.err) <= ("--debug" in run.words), done.err
