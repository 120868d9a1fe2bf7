"""Searching, showing and drawing: from sources, and from what the platform's manager gives."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from robotkube.cli import main as cli
from robotkube.delivery.manager.loops.main_reader import catalogue_page
from robotkube.errors import InputError, RefusalError
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.registry.catalogue.core.catalogue import Catalogue, read_catalogue
from robotkube.registry.catalogue.core.chart_versions import ChartVersion
from robotkube.registry.catalogue.core.entry_documents import entry_documents
from robotkube.registry.catalogue.core.guarantees import Guarantee, GuaranteeRequirement, shortfall
from robotkube.registry.catalogue.core.search import Criteria, dot, find, read_guarantee, search, upgrade_rows
from tests.stages.paths import REPOSITORY

REGISTRY = REPOSITORY / "registry"
FILES = {str(path.relative_to(REGISTRY)): path.read_text() for path in REGISTRY.rglob("*.yaml")}
ENTRIES = entry_documents(read_catalogue(FILES, published=False))


@pytest.mark.parametrize(
    ("criteria", "names"),
    [
        (Criteria(provides="recording"), ["pose-point-cloud-recording", "event-detector", "event-detector"]),
        (Criteria(provides="recording/pose"), ["pose-point-cloud-recording"]),
        (Criteria(provides="record"), []),
        (
            Criteria(needs="link/mqtt"),
            [
                "environment-perception",
                "intersection-operator",
                "object-detection",
                "pose-point-cloud-recording",
                "pose-telemetry",
                "proximity-operator",
                "task-door",
            ],
        ),
        (Criteria(needs="event-detector", text="WATCHES"), ["intersection-operator", "proximity-operator"]),
        (Criteria(guarantee=read_guarantee("range>=40m")), ["object-detection"]),
        (Criteria(needs="mqtt"), ["event-detector", "mqtt-bridge", "mqtt-bridge"]),
        (Criteria(guarantee="stop-time", text="bridge"), ["mqtt-bridge", "mqtt-bridge"]),
        (Criteria(guarantee=read_guarantee("stop-time<=5000ms")), ["bag-player", "mqtt-bridge", "mqtt-bridge"]),
        (Criteria(guarantee=read_guarantee("stop-time>=1 s")), []),
        (Criteria(channel="candidate"), []),
        (Criteria(state="source", text="buffers"), ["event-detector", "event-detector"]),
    ],
)
def test_search(criteria: Criteria, names: list[str]) -> None:
    assert [entry["name"] for entry in search(ENTRIES, criteria)] == names


@pytest.mark.parametrize("text", ["Stop", "stop-time<=", "stop-time<=3", "stop-time<=3fortnights", "stop-time=3s", ""])
def test_guarantees_that_are_none(text: str) -> None:
    with pytest.raises(InputError, match="write name, name<=3s or name>=10Hz"):
        read_guarantee(text)


@pytest.mark.parametrize(
    ("bound", "number", "unit", "verified", "text"),
    [
        ("atMost", 3, "s", False, ""),
        ("atMost", 3000, "ms", False, ""),
        ("atMost", 2.9, "s", False, "which is not enough"),
        ("atLeast", 1, "s", False, "cannot be compared"),
        ("atMost", 3, "m", False, "cannot be compared"),
        ("atMost", 3, "s", True, "no suite verifies guarantees yet"),
    ],
)
def test_what_a_guarantee_is_worth(bound: str, number: float, unit: str, verified: bool, text: str) -> None:
    missing = shortfall(
        GuaranteeRequirement("stop", bound, number, unit, verified), [Guarantee("stop", "atMost", 3, "s")]
    )
    assert (text in missing) if text else missing == ""
    assert "(declared)" in missing or not text


def test_find() -> None:
    assert [(e["kind"], e.get("version", "")) for e in find(ENTRIES, "mqtt-bridge")] == [
        ("application", ""),
        ("chart", "0.2.3"),
    ]
    assert [e["kind"] for e in find(ENTRIES, "mqtt-bridge@0.1.2")] == ["chart"]
    assert find(ENTRIES, "mqtt-bridge@0.1.2")[0]["guarantees"][0]["status"] == "declared"
    with pytest.raises(RefusalError, match=r"versions of mqtt-bridge: 0\.1\.2, 0\.2\.3"):
        find(ENTRIES, "mqtt-bridge@9.0.0")
    with pytest.raises(RefusalError, match="there are bag-player, "):
        find(ENTRIES, "nothing")


def versions() -> Catalogue:
    listed = [
        ChartVersion("x", "0.1.0", "verified", ""),
        ChartVersion("x", "0.2.0", "withdrawn", "", replaces="0.1.0"),
        ChartVersion("x", "0.10.0", "verified", "", replaces="0.2.0", skips=("0.1.0",)),
    ]
    return Catalogue(charts={"x": tuple(listed)})


def test_the_graph() -> None:
    rows = upgrade_rows(entry_documents(versions()))
    assert [(row["version"], row["upgrades_to"]) for row in rows] == [
        ("0.1.0", ["0.2.0", "0.10.0"]), ("0.2.0", ["0.10.0"]), ("0.10.0", []),
    ]  # fmt: skip
    drawn = dot(rows)
    assert '  "x 0.1.0" -> "x 0.2.0";\n' in drawn
    assert '  "x 0.1.0" -> "x 0.10.0" [style=dashed];\n' in drawn


def test_the_managers_page_says_the_same() -> None:
    page = catalogue_page(versions(), "a" * 40)
    assert json.loads(json.dumps(page)) == page
    assert (page["commit"], page["assurance"]) == ("a" * 40, "verified")
    assert page["entries"] == entry_documents(versions())
    assert [e["evidence_problem"] for e in page["entries"]] == ["its evidence was not assessed"] * 3


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    code = cli.main(["registry", *words])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_the_command_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    sources = ("--registry", str(REGISTRY))
    assert "stop-time<=10s" in run(capsys, "search", "--provides", "recording", *sources)[1]
    shown: dict[str, Any] = read_mapping(run(capsys, "show", "event-detector", *sources)[1], "shown")
    assert shown["guarantees"][0]["status"] == "declared"
    assert (
        json.loads(run(capsys, "graph", "mqtt-bridge", "--output", "json", *sources)[1])["versions"][0]["chart"]
        == "mqtt-bridge"
    )
    assert run(capsys, "graph", "--dot", *sources)[1].startswith("digraph upgrades {")
    code, out, err = run(capsys, "graph", "nothing", *sources)
    assert (code, out, "no chart nothing" in err) == (1, "", True)
    assert run(capsys, "show", "nothing", *sources)[0] == 1
    assert run(capsys, "search", "--registry", str(tmp_path / "none"))[0] == 2


@pytest.mark.parametrize(
    "criteria", [("--provides", "bridge"), ("--needs", "mqtt"), ("--guarantee", "stop-time<=5s", "--channel", "stable")]
)
@pytest.mark.parametrize("form", ["table", "yaml", "json"])
def test_every_search_has_every_form(capsys: pytest.CaptureFixture[str], criteria: tuple[str, ...], form: str) -> None:
    code, out, _ = run(capsys, "search", *criteria, "--registry", str(REGISTRY), "--output", form)
    assert code == 0
    if form == "table":
        assert "DECLARED" in out.splitlines()[0]
        assert "mqtt-bridge" in out
    else:
        by_name = {entry["name"]: entry for entry in read_mapping(out, "found")["entries"]}
        assert {guarantee["status"] for guarantee in by_name["mqtt-bridge"]["guarantees"]} == {"declared"}


def test_validate_on_the_command_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, out, err = run(capsys, "validate", "--registry", str(REGISTRY))
    assert (code, out) == (0, "no mistakes\n")
    assert "5 charts beside them, 0 mistakes" in err
    (tmp_path / "applications").mkdir()
    (tmp_path / "applications" / "a.yaml").write_text("kind: [\n")
    code, out, err = run(capsys, "validate", "--registry", str(tmp_path))
    assert code == 1
    assert f"{tmp_path}/applications/a.yaml: document: not readable as YAML" in out
    assert "3 mistakes" in err
    assert len(json.loads(run(capsys, "validate", "--registry", str(tmp_path), "--output", "json")[1])["mistakes"]) == 3


def test_broken_sources_are_left_out_and_said(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "applications").mkdir()
    (tmp_path / "applications" / "pose-telemetry.yaml").write_text(FILES["applications/pose-telemetry.yaml"])
    (tmp_path / "applications" / "a.yaml").write_text("kind: [\n")
    code, out, err = run(capsys, "search", "--registry", str(tmp_path))
    assert (code, "pose-telemetry" in out) == (0, True)
    assert "left out: " in err
