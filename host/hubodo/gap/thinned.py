"""A log that was sampled faster than a search needs: every k-th sample of it, to be searched first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hubodo.gap.problem import NodeData, Problem
from hubodo.model.forward import NodeForward

# Hz: wheels and vehicles do nothing faster that an effect would need to be told from another.
_ENOUGH = 100.0


def thinned(problem: Problem) -> Problem | None:
    """The same problem with nodes at 100 to 200 Hz; None where none is faster. The inputs are left whole."""
    nodes = tuple(_thinned(node) for node in problem.nodes)
    if all(one is node for one, node in zip(nodes, problem.nodes, strict=True)):
        return None
    return replace(problem, nodes=nodes)


def _thinned(node: NodeData) -> NodeData:
    every = int(1.0 / (_ENOUGH * float(np.median(np.diff(node.t)))) + 1e-6)
    if every < 2:
        return node
    t = np.ascontiguousarray(node.t[::every])
    was = node.forward
    forward = NodeForward(was.inputs, t, node.mount, was.wheel_radius, was.track_width, was.power_on)
    return replace(node, t=t, y=np.ascontiguousarray(node.y[:, ::every]), forward=forward)
