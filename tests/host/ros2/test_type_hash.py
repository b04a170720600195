"""Type hashes, compared with those that ROS 2 packages install."""

import pytest

from hubodo.log import ros2
from hubodo.ros2.type_hash import service_hash, type_hash

PUBLISHED = {
    # From /opt/ros/jazzy/share/<package>/msg/<Type>.json of osrf/ros:jazzy-desktop, as quoted in the tests of
    # CARLA (LibCarla, "GoldenValuesMatchCanonicalPackages").
    "std_msgs/Header": "f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01",
    ros2.STRING: "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    ros2.IMU: "7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
    ros2.NAV_SAT_FIX: "62223ab3fe210a15976021da7afddc9e200dc9ec75231c1b6a557fc598a65404",
    ros2.ODOMETRY: "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    ros2.TF: "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    # From the generated sources of ROS 2 Kilted in hpm_sdk (middleware/microros/kilted).
    ros2.JOINT_STATE: "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    ros2.MAGNETIC_FIELD: "e80f32f56a20486c9923008fc1a1db07bbb273cbbf6a5b3bfa00835ee00e4dff",
    # From public code that exchanges messages with ROS 2 Jazzy.
    ros2.DIAGNOSTICS: "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
}


@pytest.mark.parametrize("message_type", PUBLISHED)
def test_hashes_of_types_equal_those_that_ros_2_installs(message_type):
    assert type_hash(message_type) == f"RIHS01_{PUBLISHED[message_type]}"


def test_the_hash_of_a_service_equals_the_one_in_its_zenoh_key():
    # From public code that calls a service of a ROS 2 node over Zenoh.
    trigger = "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
    assert service_hash(ros2.TRIGGER_SERVICE) == f"RIHS01_{trigger}"
