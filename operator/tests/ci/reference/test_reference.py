"""The generated reference is that of the schemas as they are."""

from __future__ import annotations

import copy

import pytest

from ci.docs import markdown
from ci.reference import (
    architecture,
    charts,
    commands,
    detector,
    message_types,
    metrics,
    monitoring,
    network,
    rules,
    schemas,
)


def test_the_page_is_current() -> None:
    assert schemas.PAGE.read_text(encoding="utf-8") == schemas.page(schemas.read_schemas()), "run: make reference"


def test_the_page_of_metrics_is_current() -> None:
    assert metrics.PAGE.read_text(encoding="utf-8") == metrics.page(), "run: make reference"


def test_the_list_of_message_types_is_current() -> None:
    types = message_types.installed_types()
    versions = message_types.locked_versions()
    assert set(versions) == set(types), "a wheel with messages is installed here that operator/requirements has not"
    assert message_types.MODULE.read_text(encoding="utf-8") == message_types.module(types), "run: make reference"
    assert message_types.PAGE.read_text(encoding="utf-8") == message_types.page(types, versions), "run: make reference"


def test_the_page_of_rules_is_current() -> None:
    assert rules.PAGE.read_text(encoding="utf-8") == rules.page(), "run: make reference"


def test_the_metrics_of_the_detector_are_current() -> None:
    text = detector.PAGE.read_text(encoding="utf-8")
    assert text == detector.page(text), "run: make reference"
    with pytest.raises(ValueError, match="needs both marks"):
        detector.page("nothing")


def test_the_tables_of_who_may_reach_whom_are_current() -> None:
    text = network.PAGE.read_text(encoding="utf-8")
    assert text == network.page(text), "run: make reference"
    with pytest.raises(ValueError, match="needs both marks"):
        network.page("nothing")


def test_the_table_of_alerts_is_current() -> None:
    text = monitoring.PAGE.read_text(encoding="utf-8")
    assert text == monitoring.page(text), "run: make reference"
    with pytest.raises(ValueError, match="needs both marks"):
        monitoring.page("nothing")


def test_every_edge_leads_from_known_pods_to_known_pods_for_a_reason() -> None:
    table = network.read_table()
    known = {*table["parties"], "api-server", "metrics", "clients"}
    for edge in table["edges"]:
        assert edge["to"] in {*table["parties"], *network.AT}, edge
        assert set(edge["from"]) <= known, edge
        assert ("port" in edge) == (edge["to"] not in network.AT), edge
        assert edge["reason"], edge


@pytest.mark.parametrize("chart", charts.DESCRIBED)
def test_the_readmes_of_charts_are_current(chart: str) -> None:
    text = (charts.CHARTS / chart / "README.md").read_text(encoding="utf-8")
    assert text == charts.readme(chart, text), "run: make reference"


def test_every_chart_but_the_earlier_ones_is_described() -> None:
    every_chart = {str(path.parent.relative_to(charts.CHARTS)) for path in charts.CHARTS.glob("**/Chart.yaml")}
    assert set(charts.DESCRIBED) == {chart for chart in every_chart if not chart.startswith("earlier/")}


def test_what_people_wrote_in_a_readme_stays() -> None:
    begin, end = charts.BEGIN, charts.END
    readme = charts.readme("robotkube", f"before\n{begin}\nstale\n{end}\nafter\n")
    assert readme.startswith(f"before\n{begin}\n| value | default | meaning |\n")
    assert readme.endswith(f"{end}\nafter\n")
    assert "stale" not in readme
    with pytest.raises(ValueError, match="needs both marks"):
        charts.readme("apps/mqtt-bridge", "nothing")


def test_what_every_component_takes_stands_once() -> None:
    readme = charts.readme("robotkube", f"{charts.BEGIN}{charts.END}")
    assert readme.count("| `podLabels` |") == 1
    assert "gate.podLabels" not in readme
    parts = ("managers[]", "gate", "suites", "broker", "certificates", "rights", "database", "forge")
    parts += ("admission", "inspection", "remover", "console", "bootstrap", "installationTest", "teardown")
    assert f"Each of {', '.join(f'`{part}`' for part in parts)} takes" in " ".join(readme.split())
    assert "| `managers[].replicas` | `1` |" in readme


def test_the_commands_are_current() -> None:
    text = commands.PAGE.read_text(encoding="utf-8")
    assert text == commands.page(text), "run: make reference"


def test_commands_are_written_between_the_marks_only() -> None:
    begin, end = commands.BEGIN, commands.END
    page = commands.page(f"before\n{begin}\nold\n{end}\nafter\n")
    assert page.startswith(f"before\n{begin}\n")
    assert page.endswith(f"{end}\nafter\n")
    assert "old\n" not in page.partition(begin)[2].partition("###")[0]
    assert "### robotkube task submit" in page
    assert "`--policy Reject\\|Postpone\\|Offload\\|Preempt`" in page
    with pytest.raises(ValueError, match="needs both marks"):
        commands.page("nothing")


def test_every_schema_has_a_chapter() -> None:
    assert set(schemas.ORDER) == set(schemas.read_schemas())


def test_a_new_key_is_on_the_page() -> None:
    changed = copy.deepcopy(schemas.read_schemas())
    changed["release-policy"]["properties"]["colour"] = {"enum": ["red", "blue"], "description": "of the report"}  # type: ignore[index]
    assert "| `colour` | | `red`, `blue` | of the report |" in schemas.page(changed)


def test_text_is_written_in_lines_of_120() -> None:
    changed = copy.deepcopy(schemas.read_schemas())
    changed["release-policy"]["description"] = "word " * 100  # type: ignore[index]
    assert [line.text for line in markdown.too_long(schemas.page(changed))] == []


def test_the_picture_of_packages_is_current() -> None:
    text = architecture.PAGE.read_text(encoding="utf-8")
    assert text == architecture.rewritten(text), "run: make reference"


def test_every_subject_stands_in_the_picture() -> None:
    shown = architecture.section()
    for floor in architecture.FLOORS:
        for name in architecture.subjects(floor):
            assert f"| `{floor}.{name}` |" in shown
    assert "| `delivery.gate` | The gate: it checks what is proposed and alone moves main |" in shown
