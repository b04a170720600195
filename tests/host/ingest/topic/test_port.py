"""Ports that are topics: roles, names and joints."""

import pytest

from hubodo.errors import InputError
from hubodo.ingest.link.ports import parse_port
from hubodo.ingest.link.topic_name import is_topic
from hubodo.ingest.topic.port import TopicPort, match_vehicle_nodes, parse_topic_port
from hubodo.vehicle import load_vehicle
from vehicles import vehicle_toml


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("ros2:/left_wheel/imu", TopicPort("left_wheel", "/left_wheel/imu", "node")),
        ("left=ros2:/imu/data_raw", TopicPort("left", "/imu/data_raw", "node")),
        ("gnss=ros2:/fix", TopicPort("gnss", "/fix", "gnss")),
        ("wheels=ros2:/joint_states", TopicPort("wheels", "/joint_states", "wheels")),
        ("wheels=ros2:/js:fl,fr", TopicPort("wheels", "/js", "wheels", ("fl", "fr"))),
    ],
)
def test_the_name_of_a_port_decides_what_its_topic_is(text, expected):
    assert is_topic(text)
    assert parse_topic_port(parse_port(text)) == expected


def test_the_option_for_gnss_makes_a_topic_a_receiver():
    assert parse_topic_port(parse_port("ros2:/fix"), is_gnss=True) == TopicPort("gnss", "/fix", "gnss")


@pytest.mark.parametrize("text", ["wheels=ros2:/js:fl", "ros2:/imu:a,b"])
def test_joints_that_are_not_two_wheels_are_refused(text):
    with pytest.raises(InputError, match="LEFT,RIGHT"):
        parse_topic_port(parse_port(text))


@pytest.mark.parametrize("text", ["ros2://imu", "ros2:/", "ros2:/a//b", "ros2:/1a", "ros2:/a b"])
def test_names_that_ros_does_not_allow_are_refused(text):
    with pytest.raises(InputError, match=r"ros2:/TOPIC"):
        parse_port(text)


def test_unnamed_topics_take_the_names_of_the_vehicles_nodes(tmp_path):
    (tmp_path / "v.toml").write_text(vehicle_toml(0.15, 0.5))
    vehicle = load_vehicle(tmp_path / "v.toml")

    def labels(*texts):
        ports = [parse_port(text) for text in texts]
        return [it.label for it in match_vehicle_nodes([(p, parse_topic_port(p)) for p in ports], vehicle)]

    assert labels("ros2:/left_wheel/imu", "ros2:/wheel_right/data") == ["left", "right"]
    assert labels("ros2:/left_wheel/imu", "left=ros2:/other/imu") == ["left_wheel", "left"]
    assert labels("ros2:/body/imu", "ros2:/left/imu") == ["body", "left"]
