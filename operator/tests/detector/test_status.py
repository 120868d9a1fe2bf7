"""The metrics that a detector serves."""

from __future__ import annotations

from detector_stage import DetectorStage, MemoryTasks
from proximity import SETTINGS


def test_labels_are_patterns_rules_and_reactions_never_agents() -> None:
    stage = DetectorStage(MemoryTasks())
    stage.apply(SETTINGS)
    stage.send("vehicle-00", 0)
    stage.send("vehicle-01", 0)
    stage.close()
    lines = [line for line in stage.status.metrics().splitlines() if not line.startswith("#")]
    assert 'robotkube_detector_received_total{topic="/vehicles/{agent}/pose"} 2' in lines
    assert 'robotkube_detector_active_events{rule="near"} 1' in lines
    assert any(line.startswith('robotkube_detector_reaction_delivered_total{reaction="operator"}') for line in lines)
    assert not any("vehicle" in line.replace("/vehicles/{agent}/pose", "") for line in lines)
