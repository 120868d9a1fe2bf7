"""Mistakes in a copy of the project's registry: each is made by one change and has to be found under one key."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from robotkube.foundation.documents.core.yaml_codec import write_mapping

RECORDING = "registry/applications/pose-point-cloud-recording.yaml"
PROXIMITY = "registry/applications/proximity-operator.yaml"
BRIDGE = "registry/charts/mqtt-bridge/0.2.3.yaml"
RELEASE = "registry/policies/release.yaml"
SERVICE = "spec.services[0]"
REACTION = f"{SERVICE}.values.detector.reactions[0]"
GONE = object()

Change = Callable[[Path], object]


@dataclass(frozen=True)
class Mistake:
    """A mistake in the registry: `make` changes the folder; then the finding in `file` under `key` says `text`."""

    name: str
    make: Change
    file: str
    key: str
    text: str


def put(path: str, key: str, value: Any, to: str = "") -> Change:
    """Set (or with GONE remove) the value at a key such as `spec.services[0].release`, perhaps in another file."""

    def change(folder: Path) -> None:
        document = yaml.load((folder / path).read_text(), yaml.CSafeLoader)
        *parents, last = key.replace("[", ".").replace("]", "").split(".")
        place: Any = document
        for part in parents:
            place = place[int(part)] if part.isdecimal() else place[part]
        if value is GONE:
            del place[last]
        else:
            place[last] = value
        (folder / (to or path)).write_text(write_mapping(document))

    return change


def swap(path: str, old: str, new: str) -> Change:
    """Replace the first `old` of a file."""

    def change(folder: Path) -> None:
        text = (folder / path).read_text()
        assert old in text
        (folder / path).write_text(text.replace(old, new, 1))

    return change


def write(path: str, data: bytes) -> Change:
    """Write a file."""
    return lambda folder: (folder / path).write_bytes(data)


def version(number: str, **spec: Any) -> Change:
    """Another version of the bridge."""

    def change(folder: Path) -> None:
        document = yaml.safe_load((folder / BRIDGE).read_text())
        document["spec"].pop("skips", None)
        document["spec"].update(version=number, **spec)
        (folder / f"registry/charts/mqtt-bridge/{number}.yaml").write_text(write_mapping(document))

    return change


def both(*changes: Change) -> Change:
    """All of them."""
    return lambda folder: [change(folder) for change in changes]


def needs(at_most: int, unit: str, **more: Any) -> Change:
    """A requirement on the recorder's chart."""
    wanted = [{"guarantee": "stop-time", "atMost": at_most, "unit": unit, **more}]
    return put(RECORDING, f"{SERVICE}.chart.requirements", wanted)


def parameter(name: str, schema: Any) -> Change:
    """Another parameter of the recording."""
    return put(RECORDING, f"spec.parameters.properties.{name}", schema)


def alike_test_values(folder: Path) -> None:
    """The second set of test values says the same as the first."""
    sets = yaml.safe_load((folder / BRIDGE).read_text())["spec"]["suites"]["sets"]
    put(BRIDGE, "spec.suites.sets[1].values", sets[0]["values"])(folder)


FILES = [
    Mistake("no YAML", swap(RECORDING, "spec:", "spec: ["), RECORDING, "document", "not readable as YAML"),
    Mistake("unknown key", put(RECORDING, "spec.surprise", 1), RECORDING, "spec.surprise", "unknown key; remove it"),
    Mistake("missing key", put(BRIDGE, "spec.channel", GONE), BRIDGE, "spec.channel", "missing; write it"),
    Mistake("wrong type", put(RECORDING, "spec.services", "one"), RECORDING, "spec.services", "must be a list"),
    Mistake("no UTF-8", write(BRIDGE, b"a: \xff"), BRIDGE, "file", "byte 3 is not UTF-8; save the file as UTF-8"),
    Mistake("too long", write(BRIDGE, b"#" * 300_000), BRIDGE, "file", "longer than 262144 bytes; split it"),
    Mistake(
        "a link",
        lambda folder: (folder / "registry/applications/x.yaml").symlink_to("y"),
        "registry/applications/x.yaml",
        "file",
        "no ordinary file; put a copy there",
    ),
    Mistake(
        "foreign file",
        write("registry/applications/x.yml", b""),
        "registry/applications/x.yml",
        "file",
        "move it or remove it",
    ),
    Mistake("no policy", lambda folder: (folder / RELEASE).unlink(), RELEASE, "file", "missing; write it"),
    Mistake(
        "broken policy", write(RELEASE, b"assurance: some\n"), RELEASE, "assurance", "must be one of none, verified"
    ),
    Mistake("no version", version("0.02.0"), "registry/charts/mqtt-bridge/0.02.0.yaml", "spec.version", "must match "),
    Mistake("status", put(BRIDGE, "status", {"state": "verified"}), BRIDGE, "status", "is written by the gate"),
    Mistake(
        "unit",
        put(BRIDGE, "spec.guarantees[0].unit", "fortnight"),
        BRIDGE,
        "spec.guarantees[0].unit",
        "is no unit; use one of ms s Hz",
    ),
    Mistake(
        "causes",
        put(BRIDGE, "spec.interfaces[0].causes", "gone"),
        BRIDGE,
        "spec.interfaces[0].causes",
        "is no interface",
    ),
    Mistake(
        "the same version twice",
        put(BRIDGE, "kind", "ChartVersion", to="registry/charts/mqtt-bridge/0.1.9.yaml"),
        "registry/charts/mqtt-bridge/0.1.9.yaml",
        "path",
        "holds the same as charts/mqtt-bridge/0.2.3.yaml",
    ),
]

TAGS = {"type": "array", "minItems": 1, "items": {"type": "string"}}
REFERENCES = [
    Mistake(
        "default that the schema beside it refuses",
        put(RECORDING, "spec.parameters.properties.tags", {**TAGS, "default": []}),
        RECORDING,
        "spec.parameters.properties.tags.default",
        "[] should be non-empty; correct it",
    ),
    Mistake(
        "example that the schema beside it refuses",
        put(RECORDING, "spec.parameters.properties.tags", {**TAGS, "examples": [["a"], "b"]}),
        RECORDING,
        "spec.parameters.properties.tags.examples[1]",
        "'b' is not of type 'array'; correct it",
    ),
    Mistake(
        "nothing to run and nothing to carry",
        both(put(RECORDING, "spec.services", []), put(RECORDING, "spec.links", [])),
        RECORDING,
        "spec.services",
        "neither services nor links",
    ),
    Mistake(
        "chart",
        put(RECORDING, f"{SERVICE}.chart.name", "gone"),
        RECORDING,
        f"{SERVICE}.chart.name",
        "there is no chart 'gone' (there are: bag-player",
    ),
    Mistake(
        "range",
        put(RECORDING, f"{SERVICE}.chart.version", ">=3.0.0"),
        RECORDING,
        f"{SERVICE}.chart.version",
        "(there are 0.1.2, 0.2.3); widen the range",
    ),
    Mistake(
        "capability",
        put(RECORDING, f"{SERVICE}.chart", {"provides": "magic"}),
        RECORDING,
        f"{SERVICE}.chart.provides",
        "no chart provides 'magic' (there is: bridge/mqtt",
    ),
    Mistake(
        "guarantee",
        needs(500, "ms"),
        RECORDING,
        f"{SERVICE}.chart.requirements[0]",
        "10 s (declared), which is not enough",
    ),
    Mistake(
        "verified guarantee",
        needs(11, "s", verified=True),
        RECORDING,
        f"{SERVICE}.chart.requirements[0]",
        "no suite verifies guarantees yet",
    ),
    Mistake(
        "service of a link",
        put(RECORDING, "spec.links[0].to", {"service": "gone"}),
        RECORDING,
        "spec.links[0]",
        "service 'gone' is not among spec.services",
    ),
    Mistake(
        "no bridge",
        lambda folder: (folder / "registry/applications/mqtt-bridge.yaml").unlink(),
        RECORDING,
        "spec.links[0].kind",
        "exactly one application must provide link/mqtt, found none",
    ),
    Mistake(
        "application",
        put(PROXIMITY, "spec.parameters.properties.application.default", "gone"),
        PROXIMITY,
        "spec.parameters.properties.application.default",
        "there is no application 'gone'",
    ),
    Mistake(
        "cycle",
        both(version("0.3.0", replaces="0.2.3"), put(BRIDGE, "spec.replaces", "0.3.0")),
        BRIDGE,
        "spec.replaces",
        "part of a cycle of upgrades with 0.3.0",
    ),
    Mistake(
        "dead end",
        version("0.3.0"),
        BRIDGE,
        "spec.version",
        "no way of upgrades leads from 0.2.3 to 0.3.0, the newest version of channel stable",
    ),
    Mistake(
        "replaces nothing",
        version("0.3.0", replaces="0.2.3", skips=["0.1.5"]),
        "registry/charts/mqtt-bridge/0.3.0.yaml",
        "spec.skips",
        "there is no version 0.1.5 of mqtt-bridge (there are 0.2.3, 0.3.0)",
    ),
    Mistake(
        "backwards",
        both(version("0.3.0"), put(BRIDGE, "spec.skips", ["0.3.0"])),
        BRIDGE,
        "spec.skips",
        "0.3.0 is not older than 0.2.3",
    ),
]

TEMPLATES = [
    Mistake(
        "type of a link",
        put(RECORDING, "spec.links[0].topics[0].type", "rover_msgs/msg/Fix"),
        RECORDING,
        "spec.links[0].topics[0].type",
        "none of the packaged images has the message package rover_msgs, so no bridge carries it; take a type of",
    ),
    Mistake(
        "message of a link",
        put(RECORDING, "spec.links[0].topics[0].type", "geometry_msgs/msg/PosesStamped"),
        RECORDING,
        "spec.links[0].topics[0].type",
        "geometry_msgs has no message PosesStamped (it has Pose, Pose2D, PoseArray, PoseStamped, PoseWithCovariance,",
    ),
    Mistake(
        "schema",
        parameter("vehicles.type", "liste"),
        RECORDING,
        "spec.parameters",
        "no JSON Schema: $.properties.vehicles",
    ),
    Mistake("expression", parameter("vehicles.items.pattern", "("), RECORDING, "spec.parameters", "no JSON Schema: "),
    Mistake(
        "no sample",
        parameter("plate", {"type": "string", "pattern": "^(?=b)a$"}),
        RECORDING,
        "spec.parameters.properties.plate",
        "add `examples: [...]` with one that fits",
    ),
    Mistake(
        "syntax",
        put(RECORDING, f"{SERVICE}.release", "{{ a"),
        RECORDING,
        f"{SERVICE}.release",
        "unexpected end of template",
    ),
    Mistake(
        "statement",
        put(RECORDING, f"{SERVICE}.release", "{% set a = 1 %}x"),
        RECORDING,
        f"{SERVICE}.release",
        "Assign is not allowed; use expressions",
    ),
    Mistake(
        "unknown name",
        put(RECORDING, f"{REACTION}.recording", "{{ nothing.name }}"),
        RECORDING,
        f"{REACTION}.recording",
        "unknown name 'nothing'; the names are agent, agents, chart, parameters, placement, task",
    ),
    Mistake(
        "unknown parameter",
        put(RECORDING, f"{REACTION}.recording", "{{ parameters.title | default('x') }}"),
        RECORDING,
        f"{REACTION}.recording",
        "parameters has no 'title'; it has vehicles",
    ),
    Mistake(
        "unknown list of agents",
        put(PROXIMITY, f"{SERVICE}.release", "{{ agents.radars | first }}"),
        PROXIMITY,
        f"{SERVICE}.release",
        "agents has no 'radars'; it has lidars",
    ),
    Mistake(
        "list of agents that may be empty",
        put(PROXIMITY, f"{SERVICE}.release", "x-{{ agents.lidars | first }}"),
        PROXIMITY,
        f"{SERVICE}.release",
        "No first item, sequence was empty",
    ),
    Mistake(
        "list of all agents",
        put(PROXIMITY, "spec.agents.lidars", {}),
        PROXIMITY,
        "spec.agents.lidars",
        "needs `role`, `capabilities` or both",
    ),
    Mistake(
        "unknown key of a task",
        put(RECORDING, f"{REACTION}.trace", "{{ task.tracee }}"),
        RECORDING,
        f"{REACTION}.trace",
        "task has no 'tracee'",
    ),
    Mistake(
        "unknown name in a branch",
        put(RECORDING, f"{SERVICE}.release", "{{ 'x' if true else hidden }}"),
        RECORDING,
        f"{SERVICE}.release",
        "unknown name 'hidden'",
    ),
    Mistake(
        "optional parameter",
        both(
            parameter("title", {"type": "string"}),
            put(RECORDING, f"{SERVICE}.release", "x-{{ parameters.title | lower }}"),
        ),
        RECORDING,
        f"{SERVICE}.release",
        "has no attribute 'title'",
    ),
    Mistake(
        "release name",
        put(RECORDING, f"{SERVICE}.release", "R {{ parameters.vehicles | first }}"),
        RECORDING,
        f"{SERVICE}.release",
        "which is no name of a release",
    ),
    Mistake(
        "loop",
        put(RECORDING, "spec.links[0].forEach.vehicle", "{{ parameters.vehicles | first }}"),
        RECORDING,
        "spec.links[0].forEach",
        "must give a list",
    ),
    Mistake(
        "agent",
        put(RECORDING, f"{SERVICE}.placement", {"agent": "{{ parameters.vehicles }}"}),
        RECORDING,
        f"{SERVICE}.placement.agent",
        "it must give the name of one agent",
    ),
    Mistake(
        "interface",
        put(BRIDGE, "spec.interfaces[0].forEach.topic", "{{ valves.bridge.out }}"),
        BRIDGE,
        "spec.interfaces[0].forEach.topic",
        "unknown name 'valves'",
    ),
    Mistake(
        "test values",
        put(BRIDGE, "spec.suites.sets[0].values.placement.agent", "{{ agents }}"),
        BRIDGE,
        "spec.suites.sets[0].values.placement.agent",
        "unknown name 'agents'; the names are agent, start_ns",
    ),
]

CHARTS = [
    Mistake(
        "unknown value",
        put(RECORDING, f"{SERVICE}.values.detector.typo", 1),
        RECORDING,
        f"{SERVICE}.values.detector",
        "'typo' was unexpected",
    ),
    Mistake(
        "wrong value",
        put(RECORDING, f"{SERVICE}.values.recordings.claim", []),
        RECORDING,
        f"{SERVICE}.values.recordings.claim",
        "is not of type 'string'",
    ),
    Mistake(
        "wrong test value",
        put(BRIDGE, "spec.suites.sets[1].values.extra", 1),
        BRIDGE,
        "spec.suites.sets[1].values",
        "'extra' was unexpected",
    ),
    Mistake(
        "topic of a rate that the chart does not declare",
        put(BRIDGE, "spec.success", {"rates": [{"topic": "/vehicles/{agent}/cloud", "atLeastHz": 8}], "seconds": 60}),
        BRIDGE,
        "spec.success.rates[0].topic",
        "is no ROS topic that an interface of direction out gives",
    ),
    Mistake("equal test values", alike_test_values, BRIDGE, "spec.interfaces", "the test sets give different topics"),
    Mistake(
        "type that a detector subscribes to",
        put(PROXIMITY, f"{SERVICE}.values.detector.topics[0].type", "rover_msgs/msg/Fix"),
        PROXIMITY,
        f"{SERVICE}.values.detector.topics[0].type",
        "has the message package rover_msgs, and the chart runs event-detector; take a type of docs/reference/",
    ),
    Mistake(
        "type of an interface",
        put(BRIDGE, "spec.suites.sets[0].values.bridge.out[0].type", "rover_msgs/msg/Fix"),
        BRIDGE,
        "spec.interfaces[0].type",
        "and the chart runs mqtt-bridge; take a type of docs/reference/message-types.md",
    ),
    Mistake(
        "images",
        put(BRIDGE, "spec.images", ["python"]),
        BRIDGE,
        "spec.images",
        "python here, mqtt-bridge in the annotation",
    ),
    Mistake(
        "version of the chart",
        swap("charts/mqtt-bridge/Chart.yaml", "\nversion: 0.2.3", "\nversion: 0.4.0"),
        "charts/mqtt-bridge/Chart.yaml",
        "version",
        "0.4.0 has no entry in the catalogue (entries: 0.2.3)",
    ),
    Mistake(
        "schema of the chart",
        write("charts/mqtt-bridge/values.schema.json", b"{"),
        "charts/mqtt-bridge/values.schema.json",
        "document",
        "not readable as JSON",
    ),
    Mistake(
        "chart twice",
        lambda folder: shutil.copytree(folder / "charts/mqtt-bridge", folder / "charts/other"),
        "charts/other/Chart.yaml",
        "name",
        "rename one of the charts",
    ),
]
