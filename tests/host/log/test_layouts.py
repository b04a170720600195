"""The layouts for Foxglove and PlotJuggler show fields that exist in logs of hubodo."""

import json
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from hubodo.log import ros2, topics

FOLDER = Path(__file__).resolve().parents[3] / "tools" / "layouts"
TYPES = {topics.ODOM: ros2.ODOMETRY, topics.EVENTS: ros2.STRING}
for node in ("left", "right"):
    TYPES |= {topics.imu_topic(node): ros2.IMU, topics.temperature_topic(node): ros2.TEMPERATURE}


def foxglove() -> list[str]:
    text = (FOLDER / "foxglove.json").read_text("utf-8")
    return re.findall(r'"(?:value|topicPath)": "([^"]+)"', text)


def plotjuggler() -> list[str]:
    root = ElementTree.parse(FOLDER / "plotjuggler.xml").getroot()
    named = [curve.attrib for curve in root.iter("curve")]
    return [
        path for it in named for path in ([it["curve_x"], it["curve_y"]] if "curve_x" in it else [it["name"]])
    ]


def test_every_foxglove_panel_is_placed_in_the_layout():
    layout = json.loads((FOLDER / "foxglove.json").read_text("utf-8"))

    def placed(part) -> list[str]:
        return [part] if isinstance(part, str) else placed(part["first"]) + placed(part["second"])

    assert sorted(placed(layout["layout"])) == sorted(layout["configById"])


@pytest.mark.parametrize(("paths", "separator"), [(foxglove(), "."), (plotjuggler(), "/")])
def test_every_curve_is_a_field_of_a_hubodo_topic(paths, separator):
    assert len(paths) > 8
    for path in paths:
        topic = next(topic for topic in TYPES if path.startswith(topic + separator))
        kind = TYPES[topic]
        for name in path.removeprefix(topic + separator).split(separator):
            kind = {field.name: field.type for field in ros2.message_fields(kind)}[name]
        assert kind in ("float64", "string"), path
