"""Rules over a bag with a type that no packaged image knows: read by the bag's definition, and told."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from robotkube.cli import main as cli
from robotkube.robots.bags.adapters.writing import BagWriter
from robotkube.robots.bags.core.playback import BagTopic
from tests.stages.detector.rules import number

OWN = "rover_msgs/msg/Level"
TOPIC = "/vehicles/vehicle_00/level"
SECOND = 1_000_000_000
RULE = {"name": "high", "kind": "threshold", "topic": "/vehicles/{agent}/level", "field": "data", "start_above": 5}


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    topics = [BagTopic(TOPIC, OWN, "reliable", "volatile", 10)]
    with BagWriter(tmp_path / "bag", topics, definitions={OWN: "float64 data\n"}) as writer:
        for step in range(20):
            writer.add(TOPIC, (1_795_250_000 + step) * SECOND, number(step))
        writer.finish()
    return tmp_path / "bag"


def test_a_type_that_no_packaged_detector_knows_is_read_from_the_bag_and_told(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rules = tmp_path / "rules.yaml"
    rules.write_text(json.dumps({"rules": [{**RULE, "stop_below": 4}]}))
    code = cli.main(["rule", "test", str(rules), str(bag)])
    said = capsys.readouterr()
    assert code == 0, said.err
    assert "high" in said.out
    assert (
        f"robotkube: /vehicles/{{agent}}/level: type {OWN}: none of the packaged images has the message package "
        "rover_msgs: read here by the bags' definition, refused by the packaged event-detector; take another type"
    ) in said.err
