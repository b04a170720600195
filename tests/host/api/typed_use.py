"""A typed program that uses the package; tools/check runs mypy on it."""

from typing import assert_type

import numpy as np
from numpy.typing import NDArray

import hubodo


def use(path: str) -> float:
    """Use the public interface; this function is only type-checked."""
    log = hubodo.open(path, vehicle="vehicle.toml")
    assert_type(log, hubodo.LoadedLog)
    assert_type(log["left"]["gz"], NDArray[np.float64])
    track = log.fuse(smooth="full")
    assert_type(track, hubodo.FusedTrack)
    assert_type(track.x, NDArray[np.float64])
    assert_type(track.score, hubodo.Score | None)
    allan = log.allan("left", "gz")
    assert_type(allan.terms["N"], hubodo.NoiseTerm)
    assert_type(allan.plot(), hubodo.Plot)
    assert_type(log.warmup("left").bias(600.0), tuple[float, float])
    gap = hubodo.simulate(hubodo.read_model("model.toml")).gap("model.toml")
    assert_type(gap.found, tuple[hubodo.Finding, ...])
    hubodo.write_model(gap.model, "found.toml")
    hubodo.opne(path)  # type: ignore[attr-defined]
    return gap.after
