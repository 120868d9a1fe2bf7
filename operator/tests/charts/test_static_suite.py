"""The static suite over charts that the real helm renders: the packaged ones, a new one, and wrong ones."""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from robotkube.cli import main as cli
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.adapters.json_schema import violations
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.suites.loops.static import StaticSuite
from robotkube.registry.suites.ports.suites import Subject
from tests.stages.paths import REPOSITORY
from tests.stages.registry import wrong_interfaces
from tests.stages.registry.charts_under_test import subject_of
from tests.stages.registry.publications import write_sources
from tests.stages.registry.wrong_charts import APP, MISTAKES, wrong_chart

pytestmark = pytest.mark.toolchain

PACKAGED = [
    ("apps", "bag-player", "0.1.3"),
    *(("apps", name, "0.2.3") for name in ("mqtt-bridge", "event-detector", "object-detection", "object-tracking")),
    *(
        pytest.param("earlier", name, "0.1.2", marks=pytest.mark.thorough)
        for name in ("mqtt-bridge", "event-detector", "object-detection", "object-tracking")
    ),
]
STATIC = [name for name, mistake in MISTAKES.items() if mistake.suite == "static"]
OTHERS = [name for name, mistake in MISTAKES.items() if mistake.suite != "static"]

Read = Callable[[Path, Path], Subject]


@pytest.fixture
def read(tmp_path: Path) -> Read:
    return lambda chart, entry: subject_of(chart, entry, tmp_path)


def checks_of(subject: Subject) -> dict[str, Check]:
    checks = StaticSuite(violations, Jinja2Templates().render).run(subject)
    assert len({check.name for check in checks}) == len(checks)
    return {check.name: check for check in checks}


def failed(subject: Subject) -> dict[str, str]:
    return {name: check.found for name, check in checks_of(subject).items() if not check.passed}


@pytest.mark.parametrize(("place", "chart", "version"), PACKAGED)
def test_the_packaged_charts_pass(read: Read, place: str, chart: str, version: str) -> None:
    folder = REPOSITORY / "charts" / place / chart
    assert failed(read(folder, REPOSITORY / "registry" / "charts" / chart / f"{version}.yaml")) == {}


def test_a_new_application_passes_as_it_is(read: Read, tmp_path: Path) -> None:
    checks = checks_of(read(*wrong_interfaces.write_chart("text-relay", {}, tmp_path / "new")))
    assert [check for check in checks.values() if not check.passed] == []
    assert len(checks) >= 35
    assert checks["strategy"].found == ""


def test_every_chart_of_a_new_chain_passes_as_it_is(read: Read, tmp_path: Path) -> None:
    write_sources(tmp_path, "delivery", "--services", "order,plan,drive")
    for service in ("order", "plan", "drive"):
        name = f"delivery-{service}"
        chart, entries = tmp_path / "charts" / "apps" / name, tmp_path / "registry" / "charts"
        subject = read(chart, entries / name / "0.1.0.yaml")
        assert failed(subject) == {}
        assert not {path for path in subject.files if path.startswith(("tests", "Dockerfile", "."))}


@pytest.mark.parametrize("name", STATIC)
def test_a_wrong_chart_fails_in_words(read: Read, name: str, tmp_path: Path) -> None:
    mistake = MISTAKES[name]
    checks = checks_of(read(*wrong_chart(name, tmp_path / "wrong")))
    assert [one for one, check in checks.items() if not check.passed] == [mistake.check]
    assert mistake.found in checks[mistake.check].found
    assert mistake.fix in checks[mistake.check].fix


@pytest.mark.thorough
@pytest.mark.parametrize("name", [*OTHERS, *wrong_interfaces.MISTAKES])
def test_what_other_suites_must_find_passes_this_one(read: Read, name: str, tmp_path: Path) -> None:
    write = wrong_chart if name in MISTAKES else wrong_interfaces.wrong_chart
    assert failed(read(*write(name, tmp_path / "wrong"))) == {}


@pytest.mark.parametrize("name", MISTAKES)
def test_only_a_suite_sees_the_mistake(name: str, tmp_path: Path) -> None:
    chart, entry = wrong_chart(name, tmp_path)
    shutil.copytree(REPOSITORY / "registry" / "policies", entry.parents[2] / "policies")
    folders = ["--registry", str(entry.parents[2]), "--charts", str(chart.parent)]
    assert cli.main(["registry", "validate", *folders]) == 0


def changed(subject: Subject, path: str, change: Callable[[Any], Any]) -> Subject:
    """The subject with another entry: `change` gets and gives the value at `spec.<path>`."""
    spec: dict[str, Any] = json.loads(json.dumps(subject.entry["spec"]))
    spec[path] = change(spec.get(path))
    return dataclasses.replace(subject, entry={**subject.entry, "spec": spec})


@pytest.fixture
def relay(read: Read, tmp_path: Path) -> Subject:
    return read(*wrong_interfaces.write_chart("text-relay", {}, tmp_path / "new"))


@pytest.mark.parametrize(
    ("key", "value", "check", "found"),
    [
        ("version", "0.2.0", "identity", "Chart.yaml has version 0.1.0, the entry has spec.version 0.2.0"),
        ("resources", {"cpu": "30m", "memory": "32Mi"}, "entry-resources", "64Mi of memory, the entry has"),
        ("resources", None, "entry-resources", "requests 30m of cpu, the entry has spec.resources.cpu None"),
        (
            "images",
            ["platform"],
            "entry-images",
            "packed with the images ['ros'], the entry has spec.images ['platform']",
        ),
    ],
)
def test_an_entry_that_differs_from_its_chart(relay: Subject, key: str, value: Any, check: str, found: str) -> None:
    problems = failed(changed(relay, key, lambda _: value))
    assert list(problems) == [check]
    assert found in problems[check]


def test_equal_quantities_may_be_written_differently(relay: Subject) -> None:
    assert failed(changed(relay, "resources", lambda _: {"cpu": 0.03, "memory": 64 * 1024 * 1024})) == {}


def test_a_chart_may_have_its_results_asked_by_the_readiness_probe(read: Read, tmp_path: Path) -> None:
    asks = "{exec: {command: [python3, /etc/robotkube/node.py, check]}, failureThreshold: 1}"
    app = {"charts/{name}/templates/_app.tpl": [("settings: watched", f"settings: watched\nresults: {asks}")]}
    subject = read(*wrong_interfaces.write_chart("text-relay", app, tmp_path / "new"))
    measured = changed(subject, "success", lambda _: {"probesOf": ["text-relay"], "seconds": 60})
    assert failed(measured) == {}
    sets = measured.entry["spec"]["suites"]["sets"]
    objects = measured.render({**sets[0]["values"], "placement": {"agent": "agent-00"}}, "one")
    [container] = next(one for one in objects if one["kind"] == "Deployment")["spec"]["template"]["spec"]["containers"]
    command = {"command": ["python3", "/etc/robotkube/node.py", "check"]}
    bounds = {"periodSeconds": 5, "timeoutSeconds": 3, "failureThreshold": 1}
    assert container["readinessProbe"] == {"exec": command, **bounds}
    assert container["startupProbe"]["httpGet"]["path"] == "/readyz"
    problems = failed(changed(subject, "success", lambda _: {"probesOf": ["relay"], "seconds": 60}))
    assert list(problems) == ["entry-success"]
    assert problems["entry-success"].endswith("no container relay with a readiness probe (those with one: text-relay)")


def sets_with(**values: Any) -> Callable[[Any], Mapping[str, Any]]:
    sets = [{"name": name, "values": {"placement": {"agent": "{{ agent }}"}, **values}} for name in ("one", "two")]
    return lambda _: {"sets": sets}


def test_test_values_that_the_schema_refuses(relay: Subject) -> None:
    problems = failed(changed(relay, "suites", sets_with(relay={"input": "no topic"})))
    assert "set one: values.relay.input: 'no topic' does not match" in problems["test-sets"]
    assert "set two" in problems["renders"]
    assert "input" in problems["renders"]


@pytest.mark.parametrize(
    ("suites", "found"),
    [
        (None, "the entry has no test values; write spec.suites.sets with two sets"),
        ({"sets": [{"name": "a", "values": {"placement": {"agent": "x"}}}]}, "one test set, two are needed"),
        ({"sets": [{"name": "a", "values": {"placement": {"agent": "{{ nobody }}"}}}]}, "nobody"),
    ],
)
def test_sets_that_cannot_be_used(relay: Subject, suites: Any, found: str) -> None:
    assert found in failed(changed(relay, "suites", lambda _: suites))["test-sets"]


def template(text: str) -> tuple[str, str]:
    """A change of the Deployment's template: more text behind it."""
    return '(dict "root" .)) }}', '(dict "root" .)) }}' + text


MORE = "\n---\napiVersion: v1\nkind: Secret\nmetadata: {name: account}\n"
TIME = '(dict "root" .)) | replace "replicas: 1" (printf "replicas: %s" (randNumeric 9)) }}'
NO_PLAN = '(dict "root" .)) | replace "robotkube.io/plan" "example.org/plan" }}'
OTHER_PLAN = '(dict "root" .)) | replace "robotkube.io/plan: \\"" "robotkube.io/plan: \\"x" }}'
PLAN = '(dict "root" .)) | replace "replicas: 1" (printf "replicas: %v" (.Values.global | default dict | len)) }}'


@pytest.mark.parametrize(
    ("file", "change", "check", "found"),
    [
        ("templates/deployment.yaml", template(MORE), "kinds", "Secret account (v1): Secrets are made per agent"),
        ("templates/deployment.yaml", template(MORE), "names", "is not named as the release"),
        ("templates/deployment.yaml", ('(dict "root" .)) }}', TIME), "renders-the-same-twice", "set first: two"),
        ("templates/deployment.yaml", ('(dict "root" .)) }}', PLAN), "plan", "every plan would restart pods"),
        ("templates/configmap.yaml", ('(dict "root" .)) }}', NO_PLAN), "plan", "nothing says whose plan runs"),
        ("templates/configmap.yaml", ('(dict "root" .)) }}', OTHER_PLAN), "plan", "annotation robotkube.io/plan is 'x"),
        ("templates/_app.tpl", ("serviceAccount: application", "serviceAccount: admin"), "service-account", "is admin"),
        ("templates/_app.tpl", ("image: ros", "image: rose"), "renders", "no image. Pack the chart with images.yaml"),
        ("values.yaml", ("limits: {memory: 256Mi}", "limits: {}"), "resources", "resources.limits.memory is missing"),
        ("values.yaml", ("terminationGracePeriodSeconds: 5", "grace: 5"), "values-documented", "values.grace: is in"),
        ("values.yaml", ("PeriodSeconds: 5", "PeriodSeconds: 90"), "values-valid", "90 is"),
        ("values.yaml", ("terminationGracePeriodSeconds: 5", "- x"), "files", "values.yaml: not readable as YAML"),
        ("values.schema.json", ('"description": "The topics.",', ""), "values-documented", "values.relay: no"),
        ("values.schema.json", ("draft-07/schema#", "draft-03/schema#"), "schema-strict", "$schema: "),
        ("values.schema.json", ('"maximum": 60', '"$ref": "http://x.invalid/x"'), "schema-strict", "not in this file"),
        ("values.schema.json", ('"title"', "'title'"), "files", "values.schema.json: not readable"),
    ],
)  # fmt: skip
def test_other_mistakes_in_a_chart(
    read: Read, tmp_path: Path, file: str, change: tuple[str, str], check: str, found: str
) -> None:
    changes = {f"charts/{{name}}/{file}": [change]}
    problems = failed(read(*wrong_interfaces.write_chart("text-relay", changes, tmp_path / "new")))
    assert found in problems[check]


RESTARTS, WATCHES = "settings: restart", "settings: watched"
HASHED = '(dict "root" .)) }}'
ONE_ALONE = HASHED.replace(" }}", ' | replace "robotkube.io/files: " (printf "x: %s #" .Values.relay.input) }}')


@pytest.mark.parametrize(
    ("file", "change", "found"),
    [
        ("values.yaml", ("/in ", "/in "), "values.relay.input, values.relay.output: a change leaves"),
        ("templates/_app.tpl", (f"{WATCHES}\n", ""), "values.relay.input, values.relay.output: a change leaves"),
        ("templates/deployment.yaml", (HASHED, ONE_ALONE), "values.relay.output: a change leaves"),
    ],
)
def test_a_pod_that_stays_though_its_entry_says_restart(
    read: Read, tmp_path: Path, file: str, change: tuple[str, str], found: str
) -> None:
    changes = {f"charts/{{name}}/{file}": [change], wrong_interfaces.ENTRY: [(WATCHES, RESTARTS)]}
    problems = failed(read(*wrong_interfaces.write_chart("text-relay", changes, tmp_path / "new")))
    assert list(problems) == ["settings"]
    assert problems["settings"].startswith(found)


def test_a_chart_that_restarts_as_its_entry_says(read: Read, tmp_path: Path) -> None:
    changes = {path: [(WATCHES, RESTARTS)] for path in (APP, wrong_interfaces.ENTRY)}
    assert failed(read(*wrong_interfaces.write_chart("text-relay", changes, tmp_path / "new"))) == {}


def test_a_type_that_the_suites_cannot_publish(relay: Subject) -> None:
    def own(interfaces: Any) -> Any:
        return [
            {**interface, "type": "rover_msgs/msg/Fix"} if interface["direction"] == "in" else interface
            for interface in interfaces
        ]

    problems = failed(changed(changed(relay, "interfaces", own), "images", lambda _: ["rover"]))
    assert "none of the packaged images has the message package rover_msgs" in problems["message-types"]
    assert "the suite interface must publish one" in problems["message-types"]


def test_a_pod_that_is_replaced_though_its_entry_says_watched(read: Read, tmp_path: Path) -> None:
    changes = {APP: [(WATCHES, RESTARTS)]}
    problems = failed(read(*wrong_interfaces.write_chart("text-relay", changes, tmp_path / "new")))
    words = "values.relay.input, values.relay.output: a change is a new pod template, so nothing is watched"
    assert problems == {"settings": words}


def test_an_entry_that_says_nothing_of_settings_passes_with_advice(relay: Subject) -> None:
    entry = json.loads(json.dumps(relay.entry))
    del entry["spec"]["settings"]
    check = checks_of(dataclasses.replace(relay, entry=entry))["settings"]
    assert (check.passed, check.found[:7]) == (True, "advice:")


def test_no_other_word_says_how_settings_are_taken(read: Read, tmp_path: Path) -> None:
    changes = {APP: [(WATCHES, "settings: sometimes")]}
    problems = failed(read(*wrong_interfaces.write_chart("text-relay", changes, tmp_path / "new")))
    assert 'settings "sometimes". Write watched or restart in templates/_app.tpl.' in problems["renders"]
