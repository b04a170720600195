"""Files of a case: a CSV folder, model.toml without the hidden effects, and hidden.json with the truth."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from gap_matrix import cases
from gap_matrix.cases import Setup
from gap_matrix.effects import SIDES, Effect
from gap_matrix.sensor import Record
from gap_matrix.world import Array


def write_case_files(
    setup: Setup,
    hidden: Sequence[Effect],
    folder: Path,
    truth: dict[str, Any],
    records: Mapping[str, Record] | None = None,
) -> None:
    """Write left.csv, right.csv, reference.csv, model.toml and hidden.json.

    truth: further entries of hidden.json
    records: records of both nodes, default simulated from the setup with the hidden effects
    """
    folder.mkdir(parents=True, exist_ok=True)
    for node in SIDES:
        record = records[node] if records else cases.simulate_node_record(setup, node, hidden)
        # Seven decimals: the quantization step of the gyro is 0.00122 rad/s, and the lattice must survive.
        _write_csv(
            folder / f"{node}.csv",
            "t,gx,gy,gz,ax,ay,az,temperature",
            np.column_stack([record.t, record.values, record.temperature]),
            "%.6f,%.7f,%.7f,%.7f,%.7f,%.7f,%.7f,%.4f",
        )
    _write_csv(
        folder / "reference.csv",
        "t,speed,yaw_rate,temperature",
        cases.simulate_reference(setup),
        "%.6f,%.7f,%.7f,%.4f",
    )
    (folder / "model.toml").write_text(format_model_file(setup), encoding="utf-8")
    noise = {node: asdict(setup.noise[node]) for node in SIDES}
    start_angles = dict(setup.start_angle)
    effects = [asdict(effect) for effect in hidden]
    description = {
        "seed": setup.seed,
        "hidden": effects,
        **truth,
        "noise": noise,
        "start_angle": start_angles,
    }
    (folder / "hidden.json").write_text(json.dumps(description, indent=1), encoding="utf-8")


def format_model_file(setup: Setup) -> str:
    """Return the text of model.toml: nominal vehicle, declared noise and known effects, no hidden ones."""
    noise = setup.noise[SIDES[0]]
    lines = [
        "[vehicle]",
        f"wheel_radius = {setup.radius}",
        f"track_width = {setup.track}",
        "",
        "[imu]",
        f"gyro_noise = {noise.gyro}",
        f"accel_noise = {noise.accel}",
    ]
    for node in SIDES:
        lines += ["", f"[nodes.{node}]", f'side = "{node}"', f'facing = "{setup.facing[node]}"']
    lines += [
        "",
        "[inputs]",
        'speed = "reference.speed"',
        'yaw_rate = "reference.yaw_rate"',
        f"speed_noise = {setup.speed_noise}",
        f"yaw_rate_noise = {setup.yaw_rate_noise}",
    ]
    for effect in setup.known:
        table_prefix = f"nodes.{effect.scope}." if effect.scope in SIDES else ""
        lines += ["", f"[{table_prefix}effects.{effect.name}]"]
        lines += [f"{key} = {value!r}" for key, value in effect.parameters.items()]
    return "\n".join(lines) + "\n"


def _write_csv(path: Path, header: str, rows: Array, row_format: str) -> None:
    """Write rows as CSV."""
    text = "\n".join([row_format] * len(rows)) % tuple((rows + 0.0).ravel().tolist())  # + 0.0 removes -0.0
    path.write_text(f"{header}\n{text}\n", encoding="utf-8")
