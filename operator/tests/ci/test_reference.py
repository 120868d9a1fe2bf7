"""The generated reference is that of the schemas as they are."""

from __future__ import annotations

import copy

import pytest

from ci import (
    architecture,
    chart_reference,
    command_reference,
    detector_reference,
    markdown,
    message_types,
    monitoring_reference,
    network_reference,
    reference,
    rule_reference,
)


def test_the_page_is_current() -> None:
    assert reference.PAGE.read_text(encoding="utf-8") == reference.page(reference.read_schemas()), "run: make reference"


def test_the_page_of_metrics_is_current() -> None:
    assert reference.METRICS_PAGE.read_text(encoding="utf-8") == reference.metrics_page(), "run: make reference"


def test_the_list_of_message_types_is_current() -> None:
    types, versions = message_types.installed_types(), message_types.locked_versions()
    assert set(versions) == set(types), "a wheel with messages is installed here that operator/requirements has not"
    assert message_types.MODULE.read_text(encoding="utf-8") == message_types.module(types), "run: make reference"
    assert message_types.PAGE.read_text(encoding="utf-8") == message_types.page(types, versions), "run: make reference"


def test_the_page_of_rules_is_current() -> None:
    assert rule_reference.PAGE.read_text(encoding="utf-8") == rule_reference.page(), "run: make reference"


def test_the_metrics_of_the_detector_are_current() -> None:
    text = detector_reference.PAGE.read_text(encoding="utf-8")
    assert text == detector_reference.page(text), "run: make reference"
    with pytest.raises(ValueError, match="needs both marks"):
        detector_reference.page("nothing")


def test_the_tables_of_who_may_reach_whom_are_current() -> None:
    text = network_reference.PAGE.read_text(encoding="utf-8")
    assert text == network_reference.page(text), "run: make reference"
    with pytest.raises(ValueError, match="needs both marks"):
        network_reference.page("nothing")


def test_the_table_of_alerts_is_current() -> None:
    text = monitoring_reference.PAGE.read_text(encoding="utf-8")
    assert text == monitoring_reference.page(text), "run: make reference"
    with pytest.raises(ValueError, match="needs both marks"):
        monitoring_reference.page("nothing")


def test_every_edge_leads_from_known_pods_to_known_pods_for_a_reason() -> None:
    table = network_reference.read_table()
    known = {*table["parties"], "api-server", "metrics", "clients"}
    for edge in table["edges"]:
        assert edge["to"] in {*table["parties"], *network_reference.AT}, edge
        assert set(edge["from"]) <= known, edge
        assert ("port" in edge) == (edge["to"] not in network_reference.AT), edge
        assert edge["reason"], edge


@pytest.mark.parametrize("chart", chart_reference.DESCRIBED)
def test_the_readmes_of_charts_are_current(chart: str) -> None:
    text = (chart_reference.CHARTS / chart / "README.md").read_text(encoding="utf-8")
    assert text == chart_reference.readme(chart, text), "run: make reference"


def test_every_chart_but_the_earlier_ones_is_described() -> None:
    found = {
        str(path.parent.relative_to(chart_reference.CHARTS)) for path in chart_reference.CHARTS.glob("**/Chart.yaml")
    }
    assert set(chart_reference.DESCRIBED) == {chart for chart in found if not chart.startswith("earlier/")}


def test_what_people_wrote_in_a_readme_stays() -> None:
    begin, end = chart_reference.BEGIN, chart_reference.END
    found = chart_reference.readme("robotkube", f"before\n{begin}\nstale\n{end}\nafter\n")
    assert found.startswith(f"before\n{begin}\n| value | default | meaning |\n")
    assert found.endswith(f"{end}\nafter\n")
    assert "stale" not in found
    with pytest.raises(ValueError, match="needs both marks"):
        chart_reference.readme("apps/mqtt-bridge", "nothing")


def test_what_every_component_takes_stands_once() -> None:
    found = chart_reference.readme("robotkube", f"{chart_reference.BEGIN}{chart_reference.END}")
    assert found.count("| `podLabels` |") == 1
    assert "gate.podLabels" not in found
    parts = ("managers[]", "gate", "suites", "broker", "certificates", "rights", "database", "forge")
    parts += ("admission", "inspection", "remover", "console", "bootstrap", "installationTest", "teardown")
    assert f"Each of {', '.join(f'`{part}`' for part in parts)} takes" in " ".join(found.split())
    assert "| `managers[].replicas` | `1` |" in found


def test_the_commands_are_current() -> None:
    text = command_reference.PAGE.read_text(encoding="utf-8")
    assert text == command_reference.page(text), "run: make reference"


def test_commands_are_written_between_the_marks_only() -> None:
    begin, end = command_reference.BEGIN, command_reference.END
    found = command_reference.page(f"before\n{begin}\nold\n{end}\nafter\n")
    assert found.startswith(f"before\n{begin}\n")
    assert found.endswith(f"{end}\nafter\n")
    assert "old\n" not in found.partition(begin)[2].partition("###")[0]
    assert "### robotkube task submit" in found
    assert "`--policy Reject\\|Postpone\\|Offload\\|Preempt`" in found
    with pytest.raises(ValueError, match="needs both marks"):
        command_reference.page("nothing")


def test_every_schema_has_a_chapter() -> None:
    assert set(reference.ORDER) == set(reference.read_schemas())


def test_a_new_key_is_on_the_page() -> None:
    schemas = copy.deepcopy(reference.read_schemas())
    schemas["release-policy"]["properties"]["colour"] = {"enum": ["red", "blue"], "description": "of the report"}  # type: ignore[index]
    assert "| `colour` | | `red`, `blue` | of the report |" in reference.page(schemas)


def test_text_is_written_in_lines_of_120() -> None:
    schemas = copy.deepcopy(reference.read_schemas())
    schemas["release-policy"]["description"] = "word " * 100  # type: ignore[index]
    assert [line.text for line in markdown.too_long(reference.page(schemas))] == []


def test_the_picture_of_packages_is_current() -> None:
    text = architecture.PAGE.read_text(encoding="utf-8")
    assert text == architecture.rewritten(text), "run: make reference"


def test_every_subject_stands_in_the_picture() -> None:
    shown = architecture.section()
    for floor in architecture.FLOORS:
        for name in architecture.subjects(floor):
            assert f"| `{floor}.{name}` |" in shown
    assert "| `delivery.gate` | The gate: it checks what is proposed and alone moves main |" in shown
