"""What the reference says of metrics is what the detector serves."""

from __future__ import annotations

from pathlib import Path

from detector_stage import DetectorStage, MemoryTasks
from proximity import SETTINGS

from robotkube.services.detector.status import METRICS

PAGE = Path(__file__).parents[3] / "docs" / "reference" / "event-detector.md"


def test_the_reference_lists_every_metric() -> None:
    rows = [line for line in PAGE.read_text().partition("## Metrics")[2].splitlines() if line.startswith("| `")]
    expected = [
        f"| `{name}` | {kind} | {f'`{label}`' if label else '-'} | {text} |"
        for name, (kind, label, text) in METRICS.items()
    ]
    assert rows == expected


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
