"""What the scenario takes from release files and from the catalogue's summaries, also from broken ones."""

from __future__ import annotations

import base64
import hashlib
import json
from typing import Any

import pytest

from scenarios.runner import evidence
from scenarios.runner.inputs import ReleasedChart

HEX = "d" * 64


def envelope(statement: Any) -> bytes:
    payload = base64.b64encode(json.dumps(statement).encode()).decode()
    return json.dumps({"payload": payload, "payloadType": "application/vnd.in-toto+json", "signatures": []}).encode()


def digest_of(data: bytes) -> str:
    return f"sha256:{hashlib.sha256(data).hexdigest()}"


def test_summaries_are_known_by_their_bytes_and_name_the_chart() -> None:
    data = envelope({"subject": [{"name": "bridge", "digest": {"sha256": HEX}}]})
    files = {"evidence/bridge/0.1.0_dddddddddddd/summary.json": data, "evidence/bridge/x/static.json": data}
    assert evidence.summaries(files) == {digest_of(data): f"sha256:{HEX}"}


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xff\xfe",
        b"[]",
        b"{}",
        b'{"payload": 1}',
        b'{"payload": "no base64"}',
        b"[" * 100_000,
        envelope([]),
        envelope({"subject": []}),
        envelope({"subject": [{"digest": {}}]}),
        envelope({"subject": ["a", "b"]}),
    ],
)
def test_a_broken_summary_is_about_nothing(data: bytes) -> None:
    assert evidence.summaries({"evidence/a/b/summary.json": data}) == {digest_of(data): ""}


def test_releases_without_annotations_have_no_evidence() -> None:
    keys = {"chart": "bridge", "chart-version": "0.1.0", "chart-digest": f"sha256:{HEX}", "evidence": "none"}
    good = {"metadata": {"annotations": {f"robotkube.io/{key}": value for key, value in keys.items()}}}
    nothing = ReleasedChart("", "", "", "", "b/x")
    found = evidence.released([("a/bridge", good), ("a/bridge", good), *(("b/x", bad) for bad in (None, [], {}, "x"))])
    assert found == (nothing, ReleasedChart("bridge", "0.1.0", f"sha256:{HEX}", "none", "a/bridge"))
