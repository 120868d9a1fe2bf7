"""What the charts refuse, and that the message says what to do."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.stages.console_refusals import CONSOLE_REFUSALS
from tests.stages.paths import CHARTS
from tests.stages.tls_refusals import TLS_REFUSALS

pytestmark = pytest.mark.toolchain

PROFILES = Path(__file__).parent / "profiles"
PLATFORM = CHARTS / "robotkube"
APP_CHARTS = ("mqtt-bridge", "event-detector", "bag-player", "object-detection", "object-tracking")
VEHICLE = {"name": "vehicle-00", "role": "vehicle"}
CLOUD = {"name": "cloud-0", "role": "cloud"}
PUBLIC_KEY = "-----BEGIN PUBLIC KEY-----\nMCowBQYDK2VwAyEA\n-----END PUBLIC KEY-----\n"

PODS = {"podSelector": {"matchLabels": {"app": "prometheus"}}}
ANYWHERE = [{"to": [{"ipBlock": {"cidr": "0.0.0.0/0"}}]}]

REFUSALS: dict[str, tuple[dict[str, Any], str]] = {
    **TLS_REFUSALS,
    **CONSOLE_REFUSALS,
    "pods of which namespace": (
        {"networkPolicies": {"metrics": {"from": [PODS]}}},
        "networkPolicies.metrics.from[0]: podSelector alone means pods of whichever namespace a policy stands in.",
    ),
    "pods of which namespace, as clients": (
        {"networkPolicies": {"clients": {"forge": [PODS]}}},
        "networkPolicies.clients.forge[0]: podSelector alone",
    ),
    "addresses and pods in one peer": (
        {"networkPolicies": {"outside": {"to": [{"ipBlock": {"cidr": "10.0.0.0/8"}, "namespaceSelector": {}}]}}},
        "networkPolicies.outside.to[0]: ipBlock and selectors in one peer, which Kubernetes refuses. Make two peers",
    ),
    "rules for pods that are not installed": (
        {"suites": {"enabled": False}, "networkPolicies": {"extraEgress": {"tested": ANYWHERE}}},
        "networkPolicies.extraEgress.tested: these values install no pods of this name. Take the rules out.",
    ),
    "a key in the place of Argo CD's certificate": (
        {"argocd": {"server": {"authorities": "-----BEGIN PRIVATE KEY-----\nMC4=\n-----END PRIVATE KEY-----\n"}}},
        "argocd.server.authorities: holds a private key; it would stand in a ConfigMap. Give the certificate alone",
    ),
    "a file's name in the place of Argo CD's certificate": (
        {"argocd": {"server": {"authorities": "argocd.crt"}}},
        "argocd.server.authorities: must be PEM that begins with -----BEGIN CERTIFICATE-----",
    ),
    "a certificate of an Argo CD that is asked in clear text": (
        {"argocd": {"server": {"url": "http://argocd.example", "authorities": "-----BEGIN CERTIFICATE-----\nMII=\n"}}},
        "argocd.server.authorities is given, but argocd.server.url is http://argocd.example, where nobody would ask",
    ),
    "a remover that nobody tells": (
        {"inspection": {"enabled": False}, "remover": {"enabled": True}},
        "remover.enabled is true, but inspection.enabled is false: nobody names what is to be removed. Set inspection.",
    ),
    "a test in the name of who records nothing": (
        {"agents": [{**CLOUD, "records": True}, VEHICLE], "installationTest": {"agent": "vehicle-00"}},
        'installationTest.agent "vehicle-00": no agent of this name records. Name one with records: true, or leave it',
    ),
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
    "namespace of the gate": (
        {"agents": [CLOUD, {**VEHICLE, "name": "robotkube-gate"}]},
        'agents[1] "robotkube-gate": this namespace belongs to the cluster or the platform.',
    ),
    "a gate beside others": (
        {"gate": {"namespace": "robotkube"}},
        'gate.namespace: "robotkube" is used by others, and who may read Secrets there could sign. Leave it out, or',
    ),
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
        'volume claim "recordings" is made by records: true.',
    ),
    "one person alone": (
        {"forge": {"people": ["operator-team"]}},
        "forge.people: nobody may approve what he proposed himself",
    ),
    "one person twice": ({"forge": {"people": ["one", "one"]}}, "Name two or more, each once."),
    "a person with a name that is no account's": (
        {"forge": {"people": ["one", "Two"]}},
        'forge.people: "Two" becomes an account and a Secret.',
    ),
    "a person who is a program": (
        {"forge": {"people": ["one", "gate"]}},
        'forge.people: "gate" belongs to a part of the platform. Use another name.',
    ),
    "a viewer who is a program": (
        {"forge": {"viewers": ["gate"]}},
        'forge.viewers: "gate" belongs to a part of the platform. Use another name.',
    ),
    "a viewer who may write": (
        {"forge": {"viewers": ["reviewer"]}},
        'forge.viewers: "reviewer" is one of forge.people, who may write.',
    ),
    "a manager who is a person": (
        {"managers": [{"name": "one"}], "forge": {"people": ["one", "two"]}},
        'managers[0] "one": this name belongs to a part of the platform.',
    ),
    "claim declared twice": (
        {"agents": [CLOUD, {**VEHICLE, "claims": [{"name": "bags", "size": "1Gi"}, {"name": "bags", "size": "1Gi"}]}]},
        'volume claim "bags" is declared twice. Remove one.',
    ),
    "claim that is no label": (
        {"agents": [CLOUD, {**VEHICLE, "claims": [{"name": "My Bags", "size": "1Gi"}]}]},
        'volume claim name "My Bags". Use lower case letters, digits and hyphens.',
    ),
    "no platform image": ({"images": {"platform": ""}}, "images.platform is empty. Give the reference"),
    "no FerretDB image": ({"database": {"kind": "ferretdb"}}, "images.ferretdb is empty. Give its reference, or use"),
    "no MongoDB image": ({"images": {"mongo": ""}}, "database.kind is mongo, but images.mongo is empty."),
    "no broker image": ({"images": {"mosquitto": ""}}, "broker.kind is mosquitto, but images.mosquitto is empty."),
    "no forge image": ({"images": {"gitea": ""}}, "forge.kind is gitea, but images.gitea is empty."),
    "external broker without host": (
        {"broker": {"kind": "external"}, "tls": {"mode": "off"}},
        "broker.external.host is empty. Give the host",
    ),
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
    "no image that looks at charts": ({"images": {"ros": ""}}, "images.ros (what observes charts under test) is empty"),
    "no broker image for suites": (
        {
            "images": {"mosquitto": ""},
            "broker": {"kind": "external", "external": {"host": "mqtt.example"}},
            "tls": {"mode": "off"},
        },
        "images.mosquitto, the broker that suites start, is empty.",
    ),
    "no limits of test namespaces": ({"suites": {"testNamespace": None}}, "suites.testNamespace is empty: the pods of"),
    "no limits of test namespaces, and one former one": (
        {"suites": {"testNamespace": None, "room": {"cpu": "2"}}},
        "suites.testNamespace is empty: the pods of",
    ),
    "limits under both names": (
        {"suites": {"testNamespace": {"cpu": "3"}, "room": {"cpu": "2"}}},
        'suites.room.cpu is "2", but suites.testNamespace.cpu, its new name, is "3". Remove suites.room.',
    ),
    "the default limit under the new name, another one under the former": (
        {"suites": {"testNamespace": {"memory": "4Gi"}, "room": {"memory": "8Gi"}}},
        'suites.room.memory is "8Gi", but suites.testNamespace.memory, its new name, is "4Gi". Remove suites.room.',
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
        "evidence.trustedKeys.gate: this name belongs to the key that is made here.",
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
        ({"agents": [{"role": "vehicle"}]}, "at '/agents/0': missing property 'name'"),
        ({"images": {"mongodb": "x"}}, "at '/images': additional properties 'mongodb' not allowed"),
        (
            {"database": {"kind": "postgres"}},
            "at '/database/kind': value must be one of 'mongo', 'ferretdb', 'external'",
        ),
        ({"broker": {"limits": {"queuedMessages": 0}}}, "at '/broker/limits/queuedMessages': minimum"),
        ({"recordings": {"size": "much"}}, "at '/recordings/size': 'much' does not match pattern"),
        ({"suites": {"pool": 0}}, "at '/suites/pool': minimum"),
        ({"suites": {"pool": 13}}, "at '/suites/pool': maximum"),
        (
            {"suites": {"testNamespace": {"cpu": "much"}}},
            "at '/suites/testNamespace/cpu': 'much' does not match pattern",
        ),
        ({"suites": {"testNamespace": {"cpu": None}}}, "at '/suites/testNamespace/cpu': got null, want string"),
        ({"suites": {"room": {"cpu": "much"}}}, "at '/suites/room/cpu': 'much' does not match pattern"),
        ({"evidence": {"trustedKeys": {"My Key": "x"}}}, "'My Key' does not match pattern"),
        ({"networkPolicies": {"metrics": {"from": [{}]}}}, "at '/networkPolicies/metrics/from/0': minProperties"),
        ({"networkPolicies": {"clients": {"gat": []}}}, "at '/networkPolicies/clients': additional properties 'gat'"),
        (
            {"networkPolicies": {"extraIngress": {"application": [{"ports": [{"port": 80}]}]}}},
            "at '/networkPolicies/extraIngress/application/0': missing property 'from'",
        ),
        (
            {"networkPolicies": {"extraEgress": {"aplication": []}}},
            "invalid propertyName 'aplication'",
        ),
        (
            {"networkPolicies": {"dns": {"to": [{"ipBlock": {"cidr": "10.0.0.1"}}]}}},
            "'10.0.0.1' does not match pattern",
        ),
        ({"platform": {"tolerations": [{"kee": "x"}]}}, "at '/platform/tolerations/0': additional properties 'kee'"),
    ],
)
def test_platform_schema_refuses(helm: Any, values: dict[str, Any], at: str) -> None:
    assert at in helm.refusal(PLATFORM, PROFILES / "official.yaml", **values)


TOPIC = {"name": "/a", "type": "std_msgs/msg/String"}


BRIDGE_REFUSALS: list[tuple[dict[str, Any], str]] = [
    ({"out": [{**TOPIC, "name": "pose"}]}, "at '/bridge/out/0/name': 'pose' does not match"),
    ({"out": [{**TOPIC, "type": "std_msgs/msg/string"}]}, "at '/bridge/out/0/type': 'std_msgs/msg/string' does not"),
    ({"out": [{**TOPIC, "format": "json"}]}, "value must be one of 'frames', 'mqtt_client'"),
    (
        {"out": [{**TOPIC, "mqtt_topic": "a/#", "format": "mqtt_client"}]},
        "at '/bridge/out/0/mqtt_topic': 'a/#' does not",
    ),
    ({"out": [{**TOPIC, "mqtt_topic": "a"}]}, "at '/bridge/out/0': missing property 'format'"),
    (
        {"out": [{**TOPIC, "mqtt_topic": "a", "format": "frames"}]},
        "at '/bridge/out/0/format': value must be 'mqtt_client'",
    ),
    ({"in": [{**TOPIC, "inject_timestamp": True}]}, "at '/bridge/in/0': missing property 'format'"),
    ({"trace": "abc"}, "at '/bridge/trace': 'abc' does not match"),
    ({"publish_types": "yes"}, "at '/bridge/publish_types': got string, want boolean"),
    ({"publish_gaps": 1}, "at '/bridge/publish_gaps': got number, want boolean"),
    ({"both": []}, "at '/bridge': additional properties 'both' not allowed"),
]


def rule(kind: str, **keys: Any) -> dict[str, Any]:
    return {"rules": [{"name": "a", "kind": kind, **keys}]}


def reaction(kind: str, **keys: Any) -> dict[str, Any]:
    return {"reactions": [{"rule": "a", "kind": kind, **keys}]}


SQUARE = [[0, 0], [1, 0], [1, 1], [0, 0]]
DETECTOR_REFUSALS: list[tuple[dict[str, Any], str]] = [
    ({"topics": [{**TOPIC, "name": "pose"}]}, "at '/detector/topics/0/name': 'pose' does not match"),
    ({"topics": [{**TOPIC, "type": "PoseStamped"}]}, "at '/detector/topics/0/type': 'PoseStamped' does not match"),
    ({"topics": [{**TOPIC, "source": "kafka"}]}, "value must be one of 'ros', 'mqtt'"),
    ({"topics": [{**TOPIC, "reliability": "good"}]}, "value must be one of 'reliable', 'best_effort'"),
    ({"topics": [{**TOPIC, "liveliness": "manual"}]}, "value must be one of 'automatic', 'manual_by_topic'"),
    ({"topics": [{**TOPIC, "deadline_seconds": 0}]}, "at '/detector/topics/0/deadline_seconds': minimum"),
    ({"topics": [{**TOPIC, "expire_seconds": 0.5}]}, "at '/detector/topics/0/expire_seconds': minimum"),
    ({"topics": [{**TOPIC, "history": 1}]}, "at '/detector/topics/0': additional properties 'history' not allowed"),
    ({"topics": [{**TOPIC, "buffer": {"seconds": 601}}]}, "at '/detector/topics/0/buffer/seconds': maximum"),
    ({"topics": [{**TOPIC, "buffer": {"duplicates": "no"}}]}, "value must be one of 'drop', 'keep'"),
    ({"topics": [{**TOPIC, "buffer": {"jump": "no"}}]}, "value must be one of 'restart', 'keep'"),
    ({"topics": [{**TOPIC, "buffer": {"size": 1}}]}, "/buffer': additional properties 'size' not allowed"),
    (rule("near"), "value must be one of 'proximity'"),
    (rule("proximity"), "missing properties 'topic', 'start_distance_m', 'stop_distance_m'"),
    (rule("threshold", topic="/a", field="x", start_above=1), "'oneOf' failed"),
    (rule("threshold"), "missing properties 'topic', 'field'"),
    (rule("always", topic="/a"), "invalid propertyName 'topic'"),
    (rule("geofence", topic="/a"), "at '/detector/rules/0': missing property 'area'"),
    (rule("geofence", topic="/a", area={"type": "Circle", "coordinates": []}), "value must be one of 'Polygon'"),
    (rule("geofence", topic="/a", area={"type": "Polygon", "coordinates": [SQUARE[:2]]}), "minItems: got 2, want 3"),
    (rule("absence", topic="/a"), "at '/detector/rules/0': missing property 'seconds'"),
    (rule("rate", topic="/a"), "'oneOf' failed"),
    (rule("combination", all=["b"]), "at '/detector/rules/0/all': minItems: got 1, want 2"),
    (rule("cel", topic="/a", fields={"x": "data"}), "at '/detector/rules/0': missing property 'expression'"),
    (rule("python", topics=["/a"]), "at '/detector/rules/0': missing property 'plugin'"),
    (rule("proximity", topic="/a", start_distance_m=1, stop_distance_m=1, scope="all"), "value must be one of 'agent'"),
    (rule("always", sustained_seconds=-1), "at '/detector/rules/0/sustained_seconds': minimum"),
    (reaction("mail"), "value must be one of 'operator', 'recording', 'webhook', 'mqtt', 'python'"),
    (reaction("operator"), "at '/detector/reactions/0': missing property 'application'"),
    (reaction("operator", application="x", lease_seconds=4), "at '/detector/reactions/0/lease_seconds': minimum"),
    (reaction("operator", application="x", url="http://a"), "invalid propertyName 'url'"),
    (reaction("recording"), "missing properties 'recording', 'volume', 'topics'"),
    (reaction("recording", recording="A", volume="v", topics=[]), "at '/detector/reactions/0/recording': 'A' does not"),
    (reaction("recording", recording="a", volume="v", topics=[]), "at '/detector/reactions/0/topics': minItems"),
    (
        reaction("recording", recording="a", volume="v", topics=[{"name": "/a", "storage": "tape"}]),
        "value must be one of 'document', 'segment'",
    ),
    (
        reaction("recording", recording="a", volume="v", topics=[{"name": "/a", "storage": "segment", "before": 1}]),
        "additional properties 'before' not allowed",
    ),
    (reaction("webhook"), "at '/detector/reactions/0': missing property 'url'"),
    (reaction("webhook", url="http://me@host"), "at '/detector/reactions/0/url': 'http://me@host' does not match"),
    (reaction("webhook", url="http://a", timeout_seconds=61), "at '/detector/reactions/0/timeout_seconds': maximum"),
    (reaction("mqtt", topic="a/+"), "at '/detector/reactions/0/topic': 'a/+' does not match"),
    (reaction("python"), "at '/detector/reactions/0': missing property 'plugin'"),
    ({"state": "paused"}, "value must be one of 'active', 'buffering', 'inactive'"),
    ({"buffer": {"bytes": 1}}, "at '/detector/buffer/bytes': minimum"),
    ({"task": "alone"}, "at '/detector/task': 'alone' does not match"),
]


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
        *(("mqtt-bridge", {"bridge": values}, at) for values, at in BRIDGE_REFUSALS),
        *(("event-detector", {"detector": values}, at) for values, at in DETECTOR_REFUSALS),
        ("event-detector", {"detctor": {}}, "additional properties 'detctor' not allowed"),
        ("event-detector", {"recordings": {"claim": "My Claim"}}, "at '/recordings/claim': 'My Claim' does not match"),
        ("event-detector", {"database": {"secret": "x"}}, "at '/database': additional properties 'secret' not allowed"),
        ("event-detector", {"broker": {"existingSecret": "A B"}}, "at '/broker/existingSecret': 'A B' does not match"),
        ("event-detector", {"webhooks": {"key": "x"}}, "at '/webhooks': additional properties 'key' not allowed"),
        ("event-detector", {"bags": {"path": "/"}}, "at '/bags': additional properties 'path' not allowed"),
        ("bag-player", {"bags": {"path": "/"}}, "at '/bags': additional properties 'path' not allowed"),
        ("object-detection", {"detection": {"method": "guess"}}, "value must be one of 'size', 'reflectance'"),
        ("object-detection", {"detection": {"rangeMetres": 501}}, "at '/detection/rangeMetres': maximum"),
        ("object-detection", {"detection": {"cloud": "cloud"}}, "at '/detection/cloud': 'cloud' does not match"),
        ("object-detection", {"detection": {"cloud": ""}}, "at '/detection/cloud': minLength: got 0, want 1"),
        ("object-tracking", {"tracking": {"tracks": ""}}, "at '/tracking/tracks': minLength: got 0, want 1"),
        ("object-detection", {"detection": {"cpu": 1}}, "at '/detection': additional properties 'cpu' not allowed"),
        ("object-tracking", {"tracking": {"motion": "fast"}}, "value must be one of 'still', 'steady'"),
        ("object-tracking", {"tracking": {"gapSeconds": 0}}, "at '/tracking/gapSeconds': minimum"),
        ("bag-player", {"terminationGracePeriodSeconds": 0}, "at '/terminationGracePeriodSeconds': minimum"),
    ],
)
def test_application_schemas_refuse(helm: Any, chart: str, values: dict[str, Any], at: str) -> None:
    assert at in helm.refusal(CHARTS / "apps" / chart, PROFILES / f"{chart}.yaml", **values)


@pytest.mark.parametrize("chart", APP_CHARTS)
def test_application_charts_without_an_image_say_what_to_do(helm: Any, chart: str, tmp_path: Path) -> None:
    shutil.copytree(CHARTS / "apps" / chart, tmp_path / chart)
    said = helm.refusal(tmp_path / chart, PROFILES / f"{chart}.yaml")
    assert f"{chart}: no image. Pack the chart with images.yaml (key {chart})." in said


@pytest.mark.parametrize("chart", APP_CHARTS)
def test_application_charts_without_an_agent_say_what_to_do(helm: Any, chart: str) -> None:
    said = helm.refusal(CHARTS / "apps" / chart, PROFILES / f"{chart}.yaml", placement={"agent": ""})
    assert f"{chart}: no agent. Give placement.agent." in said


@pytest.mark.parametrize("broker", [None, {"existingSecret": None}])
def test_a_bridge_without_an_account_says_what_to_do(helm: Any, broker: Any) -> None:
    said = helm.refusal(CHARTS / "apps" / "mqtt-bridge", PROFILES / "mqtt-bridge.yaml", broker=broker)
    assert "mqtt-bridge: no account at the broker. Give broker.existingSecret." in said


@pytest.mark.parametrize(
    ("chart", "values", "at"),
    [
        ("event-detector", {"detector": {"state": "active"}}, "at '/detector': additional properties 'state' not"),
        ("mqtt-bridge", {"bridge": {"publish_gaps": True}}, "at '/bridge': additional properties 'publish_gaps' not"),
        ("object-detection", {"detection": {"method": "size"}}, "at '/detection': additional properties 'method'"),
        ("object-detection", {"detection": {"rangeMetres": 26}}, "at '/detection/rangeMetres': maximum"),
        ("object-tracking", {"tracking": {"motion": "still"}}, "at '/tracking': additional properties 'motion'"),
    ],
)
def test_schemas_of_earlier_versions_refuse(helm: Any, chart: str, values: dict[str, Any], at: str) -> None:
    own = PROFILES / "earlier" / f"{chart}.yaml"
    profile = own if own.exists() else PROFILES / f"{chart}.yaml"
    assert at in helm.refusal(CHARTS / "earlier" / chart, profile, **values)


NEEDS: dict[str, tuple[dict[str, Any], str]] = {
    "recordings.claim": (
        {"recordings": {"claim": ""}},
        "detector.reactions[1] of rule everything: a recording needs a place for its segments. Give recordings.claim.",
    ),
    "database.existingSecret": (
        {"database": {"existingSecret": ""}},
        "detector.reactions[1] of rule everything: a recording needs a database for its index. Give database.exist",
    ),
    "broker.existingSecret for topics": (
        {"broker": {"existingSecret": ""}},
        "detector.topics[1] /vehicles/{agent}/lidar_center/pointcloud: source mqtt needs an account at the broker.",
    ),
    "broker.existingSecret for reactions": (
        {"broker": {"existingSecret": ""}},
        "detector.reactions[4] of rule in-the-depot: kind mqtt needs an account at the broker. Give broker.existingSec",
    ),
    "sections that were emptied": (
        dict.fromkeys(["recordings", "database", "broker", "webhooks", "bags"]),
        "event-detector: 8 problem(s) in the values, nothing was changed:",
    ),
    "webhooks.existingSecret": (
        {"webhooks": {"existingSecret": ""}},
        "detector.reactions[3] of rule silent: secret hook.key is a key of no Secret. Give webhooks.existingSecret.",
    ),
    "bags.claim": (
        {"bags": {"claim": ""}},
        "detector.buffer.bag /var/lib/robotkube/bags/morning: no claim holds it. Give bags.claim, which is mounted at",
    ),
}


@pytest.mark.parametrize("case", NEEDS)
def test_the_event_detector_says_what_its_settings_need(helm: Any, case: str) -> None:
    values, message = NEEDS[case]
    said = helm.refusal(CHARTS / "apps" / "event-detector", PROFILES / "event-detector.yaml", **values)
    assert "problem(s) in the values, nothing was changed:" in said
    assert message in said


def test_the_event_detector_says_all_problems_at_once(helm: Any) -> None:
    values = {key: value for given, _ in NEEDS.values() for key, value in given.items()}
    said = helm.refusal(CHARTS / "apps" / "event-detector", PROFILES / "event-detector.yaml", **values)
    assert "event-detector: 8 problem(s) in the values" in said
    assert [line.split(".")[0].strip() for line in said.splitlines() if line.startswith("  ")] == list("12345678")


def test_a_packed_chart_takes_its_image_from_images_yaml(helm: Any, tmp_path: Path) -> None:
    chart = tmp_path / "bag-player"
    shutil.copytree(CHARTS / "apps" / "bag-player", chart)  # follows the link to the library chart, as packing must
    (chart / "images.yaml").write_text("bag-player: registry.example/ros@sha256:0123\n")
    rendered = helm.template(chart, PROFILES / "bag-player.yaml")
    [(_, pod)] = rendered.pods
    assert pod["containers"][0]["image"] == "registry.example/ros@sha256:0123"
