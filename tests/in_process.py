"""Run the command line in this process, optionally on a virtual computer."""

from __future__ import annotations

import io
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass

import pytest

from hubodo.cli import main
from hubodo.ingest.live import daemon, node_stream
from hubodo.ingest.live.computer import Computer


@dataclass(frozen=True)
class Done:
    """The exit code and output of a run of `hubodo`."""

    code: int
    out: str
    err: str


def hubodo(*words: object, computer: Computer | None = None) -> Done:
    """Run `hubodo` with these arguments. computer: None for the real one."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        for module in (daemon, node_stream) if computer is not None else ():
            patch.setattr(module, "ThisComputer", lambda *scale: computer)
        code = main([str(word) for word in words])
    return Done(code, out.getvalue(), err.getvalue())
