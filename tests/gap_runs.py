"""Cases of the matrix and runs of the verb, shared by the tests of `hubodo gap`."""

import io
import json
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import pytest

from hubodo.cli import main
from hubodo.log.csv_folder import read_folder, write_folder
from hubodo.recording import Recording, Table
from vehicles import model_toml

_FROM_NODES = 'speed = "nodes"\nyaw_rate = "frame.gz"\n'


CAR = model_toml(0.2924, 1.42, inputs=_FROM_NODES, facing={"left": "left", "right": "right"})
"""A car of which only radius and track (by tape measure) are known, driven by its gyros."""


def wheelchair_model(track_width: float) -> str:
    """Return the model of a wheelchair with known radius and track only, driven by its gyros."""
    return model_toml(track_width=track_width, inputs=_FROM_NODES)


@dataclass(frozen=True)
class Run:
    """The result of a run: exit code, both output streams and the output folder."""

    code: int
    out: str
    err: str
    folder: Path

    @property
    def result(self):
        """Return the content of gap.json."""
        return json.loads((self.folder / "gap.json").read_text("utf-8"))

    @property
    def names(self):
        """Return effect name and scope of each finding."""
        return [(it["effect"], it["scope"]) for it in self.result["found"]]


def run_gap(folder, model, log, *options, page=False):
    """Run `hubodo gap` in this process; page: write the page, which takes a sixth of the time, not a stub."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        if not page:
            patch.setattr("hubodo.gap.explain.files.gap_page", lambda result, model_text: "")
        code = main(["gap", str(model), str(log), "-o", str(folder), *options])
    return Run(code, out.getvalue(), err.getvalue(), Path(folder))


def write_changed_log(case, folder, nodes=lambda name, columns: columns, reference=lambda columns: columns):
    """Write a copy of a case's CSV folder with changed columns of nodes and reference."""
    log = read_folder(case)
    recording = Recording(
        {name: Table(nodes(name, dict(table.columns))) for name, table in log.nodes.items()},
        reference=Table(reference(dict(log.reference.columns))),
    )
    write_folder(recording, folder)
    return folder


def write_changed_model(case, path, *replacements):
    """Write a copy of a case's model.toml with each text of (old, new) pairs replaced."""
    text = (Path(case) / "model.toml").read_text("utf-8")
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text, "utf-8")
    return path
