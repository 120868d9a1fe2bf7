"""What the charts refuse, and that the message says what to do."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

CHARTS = Path(__file__).resolve().parents[3] / "charts"
PROFILES = Path(__file__).parent / "profiles"
PLATFORM = CHARTS / "robotkube"
APP_CHARTS = ("mqtt-bridge", "event-detector", "bag-player", "object-detection", "object-tracking")
EARLIER_CHARTS = ("object-detection", "object-tracking")  # versions 0.1.0
VEHICLE = {"name": "vehicle-00", "role": "vehicle"}
CLOUD = {"name": "cloud-0", "role": "cloud"}
PUBLIC_KEY = "-----BEGIN PUBLIC KEY-----\nMCowBQYDK2VwAyEA\n-----END PUBLIC KEY-----\n"

REFUSALS: dict[str, tuple[dict[str, Any], str]] = {
    "name that is no label": (
        {"agents": [CLOUD, {**VEHICLE, "name": "Vehicle_1"}]},
        'agents[1] "Vehicle_1": the name becomes a namespace and a ROS name. Use lower case letters',
    ),
    "name that starts with a digit": (
        {"agents": [CLOUD, {**VEHICLE, "name": "1-car"}]},
        "a letter first, such as vehicle-00",
    ),
    "name that is too long": (
        {"agents": [CLOUD, {**VEHICLE, "name": "a-vehicle-with-long-name"}]},
        "24 characters; Argo CD's <namespace>-<release> has 53, of which a release needs up to 30. Use at most 22.",
    ),
    "name declared twice": ({"agents": [CLOUD, VEHICLE, VEHICLE]}, 'agents[2] "vehicle-00": declared twice.'),
    "namespace of the platform": ({"agents": [CLOUD, {**VEHICLE, "name": "robotkube"}]}, "Use another name."),
    "namespace of Argo CD": (
        {"agents": [CLOUD, {**VEHICLE, "name": "argocd"}]},
        "this namespace belongs to the cluster",
    ),
    "unknown role": (
        {"agents": [CLOUD, {**VEHICLE, "role": "drone"}]},
        'agents[1] "vehicle-00": unknown role "drone". Use one of: cloud, edge, roadside, vehicle.',
    ),
    "claim recordings": (
        {"agents": [CLOUD, {**VEHICLE, "claims": [{"name": "recordings", "size": "1Gi"}]}]},
        'claim "recordings" is made by records: true.',
    ),
    "claim declared twice": (
        {"agents": [CLOUD, {**VEHICLE, "claims": [{"name": "bags", "size": "1Gi"}, {"name": "bags", "size": "1Gi"}]}]},
        'claim "bags" is declared twice. Remove one.',
    ),
    "claim that is no label": (
        {"agents": [CLOUD, {**VEHICLE, "claims": [{"name": "My Bags", "size": "1Gi"}]}]},
        'claim name "My Bags". Use lower case letters, digits and hyphens.',
    ),
    "no platform image": ({"images": {"platform": ""}}, "images.platform is empty. Give the reference"),
    "no FerretDB image": ({"database": {"kind": "ferretdb"}}, "images.ferretdb is empty. Give its reference, or use"),
    "no MongoDB image": ({"images": {"mongo": ""}}, "database.kind is mongo, but images.mongo is empty."),
    "no broker image": ({"images": {"mosquitto": ""}}, "broker.kind is mosquitto, but images.mosquitto is empty."),
    "no forge image": ({"images": {"gitea": ""}}, "forge.kind is gitea, but images.gitea is empty."),
    "external broker without host": ({"broker": {"kind": "external"}}, "broker.external.host is empty. Give the host"),
    "external database without host": ({"database": {"kind": "external"}}, "database.external.host is empty."),
    "host of a broker that is not external": (
        {"broker": {"external": {"host": "mqtt.example"}}},
        "broker.external.host is given, but broker.kind is mosquitto. Set the kind to external, or leave the host out.",
    ),
    "API of a forge that has none of its own": (
        {
            "forge": {
                "kind": "external",
                "external": {"url": "https://git.example.com", "api": "https://git.example.com/x"},
            }
        },
        "forge.external.api is given, but forge.external.protocol is gitea, whose API stands below its url.",
    ),
    "API with a slash at the end": (
        {
            "forge": {
                "kind": "external",
                "external": {"url": "https://gitlab.com", "protocol": "gitlab", "api": "https://gitlab.com/api/v4/"},
            }
        },
        'forge.external.api is "https://gitlab.com/api/v4/". Give http(s)://<host>[:<port>]/<path> without a slash',
    ),
    "external forge without URL": ({"forge": {"kind": "external"}}, 'forge.external.url is "". Give http(s)://<host>'),
    "external forge with a slash": (
        {"forge": {"kind": "external", "external": {"url": "https://git.example/"}}},
        "without a path or a slash at the end",
    ),
    "URL of a forge that is not external": (
        {"forge": {"external": {"url": "https://git.example"}}},
        "forge.external.url is given, but forge.kind is gitea.",
    ),
    "no image of the suite-runner": (
        {"images": {"suites": ""}},
        "suites.enabled is true, but images.suites (the suite-runner's image) is empty. Give its reference, or set",
    ),
    "no image that looks at charts": ({"images": {"ros": ""}}, "images.ros (what looks at charts under test) is empty"),
    "no broker image for suites": (
        {"images": {"mosquitto": ""}, "broker": {"kind": "external", "external": {"host": "mqtt.example"}}},
        "images.mosquitto, the broker that suites start, is empty.",
    ),
    "no agent for suites": (
        {"agents": [VEHICLE]},
        "no agent has role cloud and suites.agent is empty: suites need an agent to run on. Declare one, name one of",
    ),
    "suites on an unknown agent": (
        {"suites": {"agent": "cloud-7"}},
        'suites.agent: "cloud-7" is none of agents. Use one of: vehicle-00, vehicle-01, cloud-0.',
    ),
    "namespace of a suite": ({"agents": [CLOUD, {**VEHICLE, "name": "robotkube-suite-1"}]}, "Use another name."),
    "key without its public key": (
        {"evidence": {"existingSecret": "my-key"}},
        'evidence.existingSecret is "my-key", but evidence.trustedKeys is empty: nobody would believe what that key',
    ),
    "private key among the public ones": (
        {"evidence": {"trustedKeys": {"mine": "-----BEGIN PRIVATE KEY-----\nMC4C\n-----END PRIVATE KEY-----\n"}}},
        "evidence.trustedKeys.mine: is a private key; it would stand in a ConfigMap. Give the public one",
    ),
    "trusted key that is no key": (
        {"evidence": {"trustedKeys": {"mine": "MCowBQYDK2Vw"}}},
        "evidence.trustedKeys.mine: must be PEM that begins with -----BEGIN PUBLIC KEY-----",
    ),
    "trusted key with the name of the made one": (
        {"evidence": {"trustedKeys": {"gate": PUBLIC_KEY}}},
        "evidence.trustedKeys.gate: this name belongs to the key that the chart makes.",
    ),
    "short seed": ({"secrets": {"seed": "too short"}}, "secrets.seed is shorter than 32 characters."),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_platform_refuses(helm: Any, case: str) -> None:
    values, message = REFUSALS[case]
    said = helm.refusal(PLATFORM, PROFILES / "official.yaml", **values)
    assert "robotkube: 1 problem(s) in the values, nothing was changed:" in said
    assert message in said


def test_platform_says_all_problems_at_once(helm: Any) -> None:
    agents = [CLOUD, {**VEHICLE, "role": "drone"}, {**VEHICLE, "name": "X", "role": "boat"}]
    said = helm.refusal(PLATFORM, PROFILES / "official.yaml", agents=agents, images={"platform": ""})
    assert "4 problem(s)" in said
    assert [line.split(".")[0].strip() for line in said.splitlines() if line.startswith("  ")] == ["1", "2", "3", "4"]


@pytest.mark.parametrize(
    ("values", "at"),
    [
        ({"mangaer": {}}, "additional properties 'mangaer' not allowed"),
        (
            {"agents": [CLOUD, {**VEHICLE, "recrods": True}]},
            "at '/agents/1': additional properties 'recrods' not allowed",
        ),
        ({"agents": [{"name": "vehicle-00"}]}, "at '/agents/0': missing property 'role'"),
        ({"images": {"mongodb": "x"}}, "at '/images': additional properties 'mongodb' not allowed"),
        (
            {"database": {"kind": "postgres"}},
            "at '/database/kind': value must be one of 'mongo', 'ferretdb', 'external'",
        ),
        ({"broker": {"limits": {"queuedMessages": 0}}}, "at '/broker/limits/queuedMessages': minimum"),
        ({"recordings": {"size": "much"}}, "at '/recordings/size': 'much' does not match pattern"),
        ({"suites": {"pool": 0}}, "at '/suites/pool': minimum"),
        ({"suites": {"pool": 13}}, "at '/suites/pool': maximum"),
        ({"suites": {"room": {"cpu": "much"}}}, "at '/suites/room/cpu': 'much' does not match pattern"),
        ({"evidence": {"trustedKeys": {"My Key": "x"}}}, "'My Key' does not match pattern"),
        ({"platform": {"tolerations": [{"kee": "x"}]}}, "at '/platform/tolerations/0': additional properties 'kee'"),
    ],
)
def test_platform_schema_refuses(helm: Any, values: dict[str, Any], at: str) -> None:
    assert at in helm.refusal(PLATFORM, PROFILES / "official.yaml", **values)


TOPIC = {"name": "/a", "type": "std_msgs/msg/String"}


@pytest.mark.parametrize(
    ("chart", "values", "at"),
    [
        ("mqtt-bridge", {"bridge": {"out": [{**TOPIC, "qos": 1}]}}, "additional properties 'qos' not allowed"),
        ("mqtt-bridge", {"bridge": {"in": [{"name": "/a"}]}}, "at '/bridge/in/0': missing property 'type'"),
        ("mqtt-bridge", {"serviceAccount": "admin"}, "additional properties 'serviceAccount' not allowed"),
        ("mqtt-bridge", {"placement": {"zone": "x"}}, "at '/placement': additional properties 'zone' not allowed"),
        ("mqtt-bridge", {"placement": {"agent": "Vehicle 1"}}, "at '/placement/agent': 'Vehicle 1' does not match"),
        ("mqtt-bridge", {"global": {"image": "x"}}, "at '/global': additional properties 'image' not allowed"),
        ("mqtt-bridge", {"robotkube-app": {"x": 1}}, "at '/robotkube-app': additional properties 'x' not allowed"),
        ("event-detector", {"detector": {"topics": [{**TOPIC, "name": "pose"}]}}, "at '/detector/topics/0/name'"),
        (
            "event-detector",
            {"detector": {"rules": [{"name": "a", "kind": "near"}]}},
            "value must be one of 'proximity'",
        ),
        (
            "event-detector",
            {"detector": {"rules": [{"name": "a", "kind": "proximity"}]}},
            "missing properties 'agents'",
        ),
        (
            "event-detector",
            {
                "detector": {
                    "rules": [{"name": "a", "kind": "threshold", "topic": "/a", "field": "x", "start_above": 1}]
                }
            },
            "'oneOf' failed",
        ),
        ("event-detector", {"detector": {"rules": [{"name": "a", "kind": "threshold"}]}}, "missing properties 'topic'"),
        ("event-detector", {"detector": {"task": "alone"}}, "at '/detector/task': 'alone' does not match"),
        ("event-detector", {"detector": {"reactions": [{"rule": "a", "kind": "operator"}]}}, "'application'"),
        ("event-detector", {"detector": {"reactions": [{"rule": "a", "kind": "recording"}]}}, "'recording'"),
        ("bag-player", {"bags": {"path": "/"}}, "at '/bags': additional properties 'path' not allowed"),
        ("object-detection", {"detection": {"method": "guess"}}, "value must be one of 'size', 'reflectance'"),
        ("object-detection", {"detection": {"rangeMetres": 501}}, "at '/detection/rangeMetres': maximum"),
        ("object-detection", {"detection": {"cloud": "cloud"}}, "at '/detection/cloud': 'cloud' does not match"),
        ("object-detection", {"detection": {"cpu": 1}}, "at '/detection': additional properties 'cpu' not allowed"),
        ("object-tracking", {"tracking": {"motion": "fast"}}, "value must be one of 'still', 'steady'"),
        ("object-tracking", {"tracking": {"gapSeconds": 0}}, "at '/tracking/gapSeconds': minimum"),
        ("bag-player", {"terminationGracePeriodSeconds": 0}, "at '/terminationGracePeriodSeconds': minimum"),
    ],
)
def test_application_schemas_refuse(helm: Any, chart: str, values: dict[str, Any], at: str) -> None:
    assert at in helm.refusal(CHARTS / "apps" / chart, PROFILES / f"{chart}.yaml", **values)


@pytest.mark.parametrize("chart", APP_CHARTS)
def test_application_charts_without_an_image_say_what_to_do(helm: Any, chart: str) -> None:
    said = helm.refusal(CHARTS / "apps" / chart, PROFILES / f"{chart}.yaml", image={"reference": ""})
    assert f"{chart}: no image. Pack the chart with images.yaml (key ros), or give image.reference." in said


@pytest.mark.parametrize(
    "chart", ["robotkube", *(f"apps/{name}" for name in APP_CHARTS), *(f"earlier/{name}" for name in EARLIER_CHARTS)]
)
def test_charts_pass_lint(helm: Any, chart: str) -> None:
    name = Path(chart).name
    profile = PROFILES / ("official.yaml" if name == "robotkube" else f"{name}.yaml")
    done = helm.run("lint", "--strict", str(CHARTS / chart), "-f", str(profile))
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("chart", "values", "at"),
    [
        ("object-detection", {"detection": {"method": "size"}}, "at '/detection': additional properties 'method'"),
        ("object-detection", {"detection": {"rangeMetres": 26}}, "at '/detection/rangeMetres': maximum"),
        ("object-tracking", {"tracking": {"motion": "still"}}, "at '/tracking': additional properties 'motion'"),
    ],
)
def test_schemas_of_earlier_versions_refuse(helm: Any, chart: str, values: dict[str, Any], at: str) -> None:
    assert at in helm.refusal(CHARTS / "earlier" / chart, PROFILES / f"{chart}.yaml", **values)


def test_every_value_has_prose() -> None:
    def silent(schema: Any, path: str) -> list[str]:
        if not isinstance(schema, dict):
            return []
        found = []
        for key, value in schema.get("properties", {}).items():
            described = "description" in value or "$ref" in value or "enum" in value or set(value) <= {"type"}
            found += [] if described else [f"{path}.{key}"]
            found += silent(value, f"{path}.{key}")
        return found + silent(schema.get("items"), f"{path}[]")

    for schema in CHARTS.glob("**/values.schema.json"):
        if not schema.parent.is_symlink():
            assert silent(json.loads(schema.read_text()), schema.parent.name) == []


def test_a_packed_chart_takes_its_image_from_images_yaml(helm: Any, tmp_path: Path) -> None:
    chart = tmp_path / "bag-player"
    shutil.copytree(CHARTS / "apps" / "bag-player", chart)  # follows the link to the library chart, as packing must
    (chart / "images.yaml").write_text("ros: registry.example/ros@sha256:0123\n")
    rendered = helm.template(chart, PROFILES / "bag-player.yaml", image={"reference": ""})
    [(_, pod)] = rendered.pods
    assert pod["containers"][0]["image"] == "registry.example/ros@sha256:0123"
