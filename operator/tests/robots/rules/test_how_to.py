"""The rules in the documentation can be read, with the fields that the types have."""

from __future__ import annotations

import re
from typing import Any

import pytest

from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.robots.ros.core.cdr_readers.readers import Layouts
from robotkube.robots.rules.core import read_rules
from tests.stages.detector.rules import DEFINITIONS
from tests.stages.paths import REPOSITORY

DOCS = REPOSITORY / "docs" / "how-to"
BLOCK = re.compile(r"```yaml\n(.*?)```", re.DOTALL)
KNOWN = {**DEFINITIONS, "sensor_msgs/msg/BatteryState": "float32 temperature\nfloat32 percentage\n"}


def blocks() -> list[Any]:
    pages = [DOCS / "write-a-rule.md", DOCS / "write-a-plugin.md"]
    return [pytest.param(text, id=f"{page.stem}-{n}") for page in pages
            for n, text in enumerate(BLOCK.findall(page.read_text(encoding="utf-8")))]  # fmt: skip


@pytest.mark.parametrize("text", blocks())
def test_the_rules_can_be_read(text: str) -> None:
    document = read_mapping(text, "how-to")
    reader = Reader("how-to")
    items = reader.keys_of(document).mappings("rules", 100)
    types = {topic["name"]: topic["type"] for topic in document["topics"]}
    rules = read_rules(items, types, Layouts(KNOWN.__getitem__), plugins=["closing-speed"])
    assert reader.problems == []
    assert len(rules) == len(document["rules"])


def test_all_blocks_are_found() -> None:
    assert len(blocks()) == 6
