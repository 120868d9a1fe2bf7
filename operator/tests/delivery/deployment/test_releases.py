"""Release and source files: what is written reads back equal; everything else is refused with every problem named."""

from __future__ import annotations

from dataclasses import replace

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from robotkube.delivery.deployment.core.releases import (
    Release,
    Source,
    TaskCause,
    application_name,
    chart_of,
    read_release,
    read_source,
    read_tree,
    source_of,
    write_release,
    write_source,
)
from robotkube.errors import DocumentError
from robotkube.foundation.documents.adapters.json_schema import violations
from robotkube.foundation.documents.core.yaml_codec import read_mapping, write_mapping

DIGEST = "sha256:" + "12e4567890ab" + "0" * 52
CAUSE = TaskCause(
    "cloud-0/meeting-3f2a9c",
    "3f2a9c",
    "lidar-proximity",
    "1" * 32,
    "pose-point-cloud-recording",
    '{"a":[1.5],"b":"\\u00e9"}',
)
RELEASE = Release(
    "vehicle-00",
    "mqtt-bridge",
    "mqtt-bridge",
    "0.1.0",
    DIGEST,
    {"a": [1, {"b": None}]},
    (CAUSE,),
    "20261121-100000-1a2b3c",
)
SOURCE = Source(
    "vehicle-00", "mqtt-bridge", DIGEST, "oci://forge.robotkube.svc.cluster.local:3000/verified/mqtt-bridge"
)

json_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**53), 2**53)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)


# What Flux' own definitions (HelmRelease v2, OCIRepository v1) say of the keys that are written here. An API server
# drops keys that a definition does not have, so each has to be one of these.
FLUX_DURATION = {"type": "string", "pattern": r"^([0-9]+(\.[0-9]+)?(ms|s|m|h))+$"}
FLUX_NAME = {"type": "string", "minLength": 1, "maxLength": 253}
FLUX = {
    "HelmRelease": {
        "required": ["interval", "chartRef"],
        "properties": {
            "interval": FLUX_DURATION,
            "chartRef": {
                "type": "object",
                "required": ["kind", "name"],
                "properties": {"kind": {"enum": ["OCIRepository", "HelmChart"]}, "name": FLUX_NAME},
                "additionalProperties": False,
            },
            "values": {"type": "object"},
        },
    },
    "OCIRepository": {
        "required": ["interval", "url"],
        "properties": {
            "interval": FLUX_DURATION,
            "url": {"type": "string", "pattern": "^oci://.*$"},
            "ref": {"type": "object", "properties": {"digest": {"type": "string"}}, "additionalProperties": False},
            "insecure": {"type": "boolean"},
        },
    },
}
ANNOTATIONS_BYTES_MAX = 256 * 1024  # of Kubernetes


@pytest.mark.parametrize("text", [write_release(RELEASE), write_source(SOURCE)], ids=["release", "source"])
def test_flux_can_read_what_is_written(text: str) -> None:
    document = yaml.safe_load(text)
    assert set(document) == {"apiVersion", "kind", "metadata", "spec"}
    assert document["apiVersion"] in ("helm.toolkit.fluxcd.io/v2", "source.toolkit.fluxcd.io/v1")
    schema = {"type": "object", "additionalProperties": False, **FLUX[document["kind"]]}
    assert violations(schema, document["spec"]) == []
    annotations = document["metadata"].get("annotations", {})
    assert all(isinstance(value, str) for value in annotations.values())
    assert sum(len(key) + len(value.encode()) for key, value in annotations.items()) < ANNOTATIONS_BYTES_MAX


def test_release_reads_back_equal() -> None:
    text = write_release(RELEASE)
    assert read_release(text, RELEASE.path) == RELEASE
    assert write_release(read_release(text, RELEASE.path)) == text


def test_initial_release_has_no_task_annotations() -> None:
    text = write_release(replace(RELEASE, causes=()))
    assert "robotkube.io/tasks" not in text
    assert read_release(text, RELEASE.path).causes == ()


def test_source_reads_back_equal() -> None:
    assert read_source(write_source(SOURCE), SOURCE.path) == SOURCE
    assert SOURCE.path == "sources/vehicle-00/mqtt-bridge-12e4567890ab.yaml"


def test_a_source_that_is_read_is_the_object_that_a_release_needs() -> None:
    registry = SOURCE.url.rpartition("/")[0]
    assert read_source(write_source(SOURCE), SOURCE.path) is source_of(chart_of(RELEASE), registry)


@given(st.dictionaries(st.text(max_size=8), json_values, max_size=4))
def test_any_json_values_survive(values: dict[str, object]) -> None:
    text = write_release(replace(RELEASE, values=values))
    assert read_release(text, RELEASE.path).values == values
    assert yaml.safe_load(text)["spec"]["values"] == values


@pytest.mark.parametrize(
    "value",
    ["12e45", "0x1f", "1_000", "yes", "n", "Off", "null", "~", "2026-11-21", "1:30", ".inf", "0o7", "", "a: b", "# x"],
)
def test_text_that_looks_like_something_else_is_quoted(value: str) -> None:
    assert write_mapping({"a": value}) == f'a: "{value}"\n'


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (("  values:", "  suspend: true\n  values:"), "spec.suspend: unknown key"),
        (("kind: HelmRelease", "kind: Pod"), "kind: 'Pod' must be 'HelmRelease'"),
        (("name: mqtt-bridge\n  namespace", "name: other\n  namespace"), "path: "),
        (("robotkube.io/rules: lidar-proximity", "robotkube.io/rules: lidar-proximity b"), "must be equally many"),
        (("robotkube.io/evidence: none", "x: y"), "robotkube.io/evidence: missing"),
        (
            ("robotkube.io/evidence: none", "robotkube.io/evidence: signed"),
            "robotkube.io/evidence: 'signed' must match",
        ),
        (("robotkube.io/parameters: ", "x: "), "tasks 1, events 1, rules 1, traces 1, applications 1, parameters 0"),
        (("[{", "[1,{"), "robotkube.io/parameters: must be a JSON list of objects"),
        (("[{", "[ {"), "robotkube.io/parameters: must be a JSON list of objects, keys sorted, without spaces"),
        (("[{", "[[{"), "robotkube.io/parameters: must be a JSON list of objects"),
        (("name: mqtt-bridge-12e4567890ab", "name: mqtt-bridge-000000000000"), "spec.chartRef"),
        (("namespace: vehicle-00", "namespace: Vehicle_00"), "metadata.namespace"),
        (("apiVersion", "---\n---\napiVersion"), "exactly one YAML document"),
        (("kind: HelmRelease", "kind: HelmRelease\nkind: HelmRelease"), "stands twice"),
        (("values:", "values: &a"), "anchors"),
        (("b: null", "b: 9007199254740993"), "2^53"),
        (("b: null", "b: .nan"), "not a JSON number"),
        (("b: null", "b: !!python/name:os.system x"), "is not allowed; write a plain value"),
    ],
)
def test_release_refusals(change: tuple[str, str], problem: str) -> None:
    text = write_release(RELEASE)
    assert change[0] in text
    with pytest.raises(DocumentError) as caught:
        read_release(text.replace(*change, 1), RELEASE.path)
    assert problem in str(caught.value)
    assert RELEASE.path in str(caught.value)


def test_all_problems_are_named_at_once() -> None:
    with pytest.raises(DocumentError) as caught:
        read_release("kind: x\n", "releases/a/b.yaml")
    assert len(caught.value.problems) >= 4


@given(st.text(max_size=200))
def test_any_text_is_read_or_refused(text: str) -> None:
    try:
        read_mapping(text, "somewhere")
    except DocumentError as error:
        assert error.problems  # noqa: PT017 - either outcome is right, an unnamed problem is not


def test_application_name_bound() -> None:
    assert application_name("cloud-0", "recorder-vehicle-00-vehicle-01") == "cloud-0-recorder-vehicle-00-vehicle-01"
    with pytest.raises(DocumentError, match="at most 53"):
        application_name("vehicle-00", "x" * 60)


def test_tree_relations() -> None:
    files = {RELEASE.path: write_release(RELEASE), SOURCE.path: write_source(SOURCE)}
    assert read_tree(files).problems == ()
    assert "is missing" in read_tree({RELEASE.path: files[RELEASE.path]}).problems[0]
    twin = replace(RELEASE, namespace="vehicle", name="00-mqtt-bridge")
    twin_source = replace(SOURCE, namespace="vehicle")
    problems = read_tree(
        {**files, twin.path: write_release(twin), twin_source.path: write_source(twin_source)}
    ).problems
    assert any("is taken by" in problem for problem in problems)
    assert read_tree({"releases/a/b.yaml": ":"}).problems
