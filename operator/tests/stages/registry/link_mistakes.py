"""Links that the charts at their ends do not take, or do not send, in copies of the packaged applications."""

from __future__ import annotations

from tests.stages.registry.registry_mistakes import RECORDING, Mistake, put

PERCEPTION = "registry/applications/environment-perception.yaml"

LINKS = [
    Mistake(
        "type that the chart behind a link does not take",
        put(RECORDING, "spec.links[0].topics[0].type", "geometry_msgs/msg/PoseArray"),
        RECORDING,
        "spec.links[0].topics[0].type",
        "is geometry_msgs/msg/PoseArray here, and interface watched of chart event-detector (service recorder) takes "
        "geometry_msgs/msg/PoseStamped: nothing would arrive; write geometry_msgs/msg/PoseStamped, or correct",
    ),
    Mistake(
        "type that the chart before a link does not send",
        put(PERCEPTION, "spec.links[1].topics[1].type", "std_msgs/msg/Float64"),
        PERCEPTION,
        "spec.links[1].topics[1].type",
        "is std_msgs/msg/Float64 here, and interface tracks of chart object-tracking (service tracking) sends "
        "std_msgs/msg/String: nothing would arrive; write std_msgs/msg/String, or correct the chart",
    ),
    Mistake(
        "reliability that is less than the chart behind a link requests",
        put(RECORDING, "spec.links[0].topics[0].reliability", "best_effort"),
        RECORDING,
        "spec.links[0].topics[0].reliability",
        "the link offers best_effort, and interface watched of chart event-detector (service recorder) requests "
        "reliable: ROS does not connect who requests reliable with who offers best_effort; write reliable, or",
    ),
    Mistake(
        "durability that is less than the chart behind a link requests",
        put(RECORDING, "spec.links[0].topics[2].durability", "volatile"),
        RECORDING,
        "spec.links[0].topics[2].durability",
        "the link offers volatile, and interface watched of chart event-detector (service recorder) requests",
    ),
    Mistake(
        "durability that is more than the chart before a link offers",
        put(PERCEPTION, "spec.links[1].topics[1].durability", "transient_local"),
        PERCEPTION,
        "spec.links[1].topics[1].durability",
        "the link requests transient_local, and interface tracks of chart object-tracking (service tracking) offers "
        "volatile: ROS does not connect who requests transient_local with who offers volatile; write volatile, or",
    ),
    Mistake(
        "topic that the chart behind a link does not take",
        put(RECORDING, "spec.links[0].topics[0].name", "/vehicles/{{ vehicle | ros }}/posed"),
        RECORDING,
        "spec.links[0].topics[0].name",
        "no interface of chart event-detector (service recorder) takes /vehicles/",
    ),
    Mistake(
        "topic that the chart before a link does not send",
        put(PERCEPTION, "spec.links[1].topics[1].name", "/vehicles/{{ parameters.sensor | ros }}/track"),
        PERCEPTION,
        "spec.links[1].topics[1].name",
        "no interface of chart object-tracking (service tracking) sends /vehicles/roadside_0/track in ROS (direction "
        "out): it has /vehicles/roadside_0/tracks; name one of them, give the service values with this topic, or",
    ),
]
