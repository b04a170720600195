"""Cases of rosbags whose values, types, tables and compression are changed one by one."""

from __future__ import annotations

import random

from fuzz import seeds
from fuzz.case import Case
from fuzz.mutate_bag import mutated_database, mutated_rosbag1, packed_database
from fuzz.mutate_mcap import torn
from fuzz.settings import SETTINGS
from fuzz.words import at

BAG_READERS = (
    ("info", "LOG", "--json"),
    ("info", "LOG"),
    ("export", "LOG", "-o", "FOLDER/out"),
    ("export", "LOG", "--format", "rosbag2", "-o", "FOLDER/out"),
    ("import", "LOG", "-o", "FOLDER/out.mcap"),
    ("report", "LOG", "-o", "FOLDER/r.html"),
)


def bag_value_case(rng: random.Random) -> Case:
    """A rosbag2 folder or a bag of ROS 1, changed."""
    words = rng.choice(BAG_READERS)
    if rng.random() < 0.3:
        data = mutated_rosbag1(rng, seeds.ros1_bag())
        return Case(at(words, "FOLDER/log.bag"), {**SETTINGS, "log.bag": data})
    data, mode, suffix = seeds.bag_database(), "", ""
    if rng.random() < 0.2:
        mode, data = packed_database(rng, data)
        suffix = ".zstd" if mode == "FILE" else ""
    else:
        data = mutated_database(rng, data)
    metadata = seeds.BAG_METADATA.format(mode=mode, form="zstd" if mode else "").encode()
    if rng.random() < 0.1:
        metadata = bytes(torn(rng, metadata))
    files = {f"bag/bag_0.db3{suffix}": data, "bag/metadata.yaml": metadata}
    return Case(at(words, "FOLDER/bag"), {**SETTINGS, **files})
