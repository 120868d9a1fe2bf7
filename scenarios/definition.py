"""What a scenario is: parameters, story, topology and the bounds of its expectations, read once from `scenario.yaml`.

A story is told by players (bags, `parameters.routes`), by steps (`scenarios.steps`), or by both. Everything is checked
before anything is started. `ScenarioError` names the file, the key and the way out.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema
import yaml

from robotkube.foundation.documents.core.yaml_codec import SAFE_LOADER
from scenarios.network import Cable, NetworkError, read_network
from scenarios.steps import Step, read_steps

SCHEMA = Path(__file__).with_name("scenario.schema.json")
SCENARIOS = Path(__file__).parent
FILE_BYTES_MAX = 1_000_000
NO_ROUTES, INTERSECTION = "none", "intersection"


class ScenarioError(ValueError):
    """A scenario, an override or a bag that cannot be run; the message says where and what to do. Never retried."""


@dataclass(frozen=True)
class Parameters:
    """The numbers of a run. Rates in Hz, distances in m, speed in m/s of one vehicle; `points` is the least per
    cloud. `routes` says what is played: `pair` and `three-vehicles` meet, `intersection` passes a road-side unit,
    `none` plays nothing and needs no other number but `vehicles`. `blocked_seconds`: how long the first vehicle stops
    at the intersection since a container blocks its view of the second one; 0: there is none."""

    vehicles: int
    lidar_vehicles: int = 0
    pose_hz: int = 10
    point_cloud_hz: int = 1
    points: int = 1000
    start_distance_m: float = 100
    stop_distance_m: float = 200
    encounters: int = 0
    speed_mps: float = 10
    routes: str = "pair"
    blocked_seconds: float = 0


@dataclass(frozen=True)
class Story:
    """Names of the things the run waits for: accounts of the person and of who approves what that person proposes,
    applications, rule, agent that records.

    `rule`, `application` and `recording_agent` are empty where nothing is recorded; `policies` are further entries that
    the person adds to policies/initial.yaml, as they stand there; `ready` are releases that a run begins with.
    """

    person: str
    approver: str
    player_application: str = ""
    rule: str = ""
    application: str = ""
    recording_agent: str = ""
    policies: tuple[Mapping[str, Any], ...] = ()
    ready: tuple[str, ...] = ()


@dataclass(frozen=True)
class Node:
    """One machine of the topology; `index` counts within its entry."""

    name: str
    role: str
    agent: str
    cpu: str
    memory: str
    capabilities: tuple[str, ...]


@dataclass(frozen=True)
class Bound:
    """A limit on a measured value: `kind` is at_least, at_most or equals."""

    kind: str
    value: float | bool

    def holds(self, measured: float | bool | None) -> bool:
        """Return whether a value is within the bound; a value that could not be measured never is."""
        if measured is None:
            return False
        if self.kind == "at_least":
            return measured >= self.value
        if self.kind == "at_most":
            return measured <= self.value
        return measured == self.value

    def __str__(self) -> str:
        sign = {"at_least": ">=", "at_most": "<=", "equals": "="}[self.kind]
        return f"{sign} {str(self.value).lower() if isinstance(self.value, bool) else format(self.value, 'g')}"


@dataclass(frozen=True)
class Scenario:
    """A scenario with its parameters settled. `network`: what cables are like, of the agents whose cable is not as the
    machine has it."""

    name: str
    description: str
    folder: Path
    parameters: Parameters
    story: Story
    nodes: tuple[Node, ...]
    expectations: Mapping[str, Bound]
    steps: tuple[Step, ...] = ()
    extra_charts: tuple[str, ...] = ()
    network: Mapping[str, Cable] = field(default_factory=dict)

    @property
    def vehicles(self) -> tuple[str, ...]:
        """Agents of role vehicle, in order of their number."""
        return tuple(node.agent for node in self.nodes if node.role == "vehicle")

    @property
    def lidar_vehicles(self) -> tuple[str, ...]:
        """The vehicles that carry a lidar and meet."""
        return self.vehicles[: self.parameters.lidar_vehicles]

    @property
    def players(self) -> tuple[str, ...]:
        """Agents that play a bag: all vehicles, then the road-side units where a vehicle passes them."""
        if self.parameters.routes == NO_ROUTES:
            return ()
        units = tuple(node.agent for node in self.nodes if node.role == "roadside")
        return self.vehicles + (units if self.parameters.routes == INTERSECTION else ())

    @property
    def lidar_agents(self) -> tuple[str, ...]:
        """Players whose bag holds point clouds and the transform of their lidar."""
        return self.lidar_vehicles + self.players[len(self.vehicles) :]

    @property
    def records(self) -> bool:
        """Return whether the story is one of encounters that are recorded."""
        return bool(self.story.rule)


def ros_name(agent: str) -> str:
    """An agent's name inside ROS topics, which take no hyphen."""
    return agent.replace("-", "_")


def pose_topic(agent: str) -> str:
    """Topic of a vehicle's geometry_msgs/PoseStamped."""
    return f"/vehicles/{ros_name(agent)}/pose"


def cloud_topic(agent: str) -> str:
    """Topic of a vehicle's sensor_msgs/PointCloud2."""
    return f"/vehicles/{ros_name(agent)}/lidar_center/pointcloud"


def transform_topic(agent: str) -> str:
    """Topic of the geometry_msgs/TransformStamped that says where the lidar sits, sent once and latched."""
    return f"/vehicles/{ros_name(agent)}/lidar_center/transform"


def find(name: str) -> Path:
    """The folder of a scenario by its path or by its name below scenarios/."""
    path = Path(name)
    return path if (path / "scenario.yaml").is_file() or not (SCENARIOS / name).is_dir() else SCENARIOS / name


def load(folder: Path, overrides: Sequence[str] = (), variant: str | None = None) -> Scenario:
    """Reads `folder`/scenario.yaml, lays a variant over its parameters, steps, network and expectations, then
    `key=value` overrides over its parameters, and checks it all.

    Raises `ScenarioError` with file, key and fix.
    """
    file = folder / "scenario.yaml"
    document = _document(file)
    varied = dict(_variant(file, document, variant))
    steps = varied.pop("steps", document["story"].get("steps", []))
    network = varied.pop("network", document.get("network", []))
    expectations = document["expectations"] | varied.pop("expectations", {})
    parameters = dict(document["parameters"]) | varied | _overrides(file, overrides)
    story = document["story"] | {"steps": steps}
    document = document | {"parameters": parameters, "story": story, "expectations": expectations, "network": network}
    _check(file, document)
    _check_distances(file, parameters)
    nodes = _nodes(file, document["topology"]["nodes"], parameters["vehicles"])
    return Scenario(
        name=document["name"],
        description=document["description"],
        folder=folder,
        parameters=Parameters(**parameters),
        story=_story(document["story"]),
        nodes=nodes,
        expectations={name: _bound(bound, parameters) for name, bound in document["expectations"].items()},
        steps=read_steps(steps),
        extra_charts=tuple(document.get("publish", {}).get("charts", ())),
        network=_network(file, network, nodes),
    )


def _network(file: Path, entries: Sequence[Mapping[str, Any]], nodes: Sequence[Node]) -> dict[str, Cable]:
    try:
        return read_network(entries, {node.agent: node.role for node in nodes})
    except NetworkError as error:
        raise ScenarioError(f"{file}: {error}") from error


def _story(given: Mapping[str, Any]) -> Story:
    words = {key: str(value) for key, value in given.items() if isinstance(value, str)}
    return Story(**words, policies=tuple(given.get("policies", ())), ready=tuple(given.get("ready", ())))


def _bound(given: Mapping[str, Any], parameters: Mapping[str, Any]) -> Bound:
    """A bound as written, or as a share of a parameter when it says `of`."""
    kind, value = next((key, value) for key, value in given.items() if key != "of")
    return Bound(kind, value * parameters[given["of"]] if "of" in given else value)


def _document(file: Path) -> dict[str, Any]:
    if not file.is_file():
        raise ScenarioError(
            f"{file}: there is no such file; give the folder of a scenario, such as "
            f"scenarios/pose-point-cloud-db-recording"
        )
    if file.stat().st_size > FILE_BYTES_MAX:
        raise ScenarioError(f"{file}: larger than {FILE_BYTES_MAX} bytes, which no scenario is")
    try:
        document = yaml.load(file.read_text(), SAFE_LOADER)  # noqa: S506 - a safe one
    except yaml.YAMLError as error:
        raise ScenarioError(f"{file}: not valid YAML ({' '.join(str(error).split())})") from error
    if not isinstance(document, dict):
        raise ScenarioError(f"{file}: must be a mapping with the keys parameters, story, topology, expectations")
    _check(file, document)
    return document


def _check(file: Path, document: Mapping[str, Any]) -> None:
    """Checks the JSON Schema and reports the first error by its key."""
    errors = sorted(_validator().iter_errors(document), key=lambda error: [str(part) for part in error.absolute_path])
    if errors:
        error = errors[0]
        key = ".".join(str(part) for part in error.absolute_path) or "(top)"
        raise ScenarioError(f"{file}: {key}: {error.message}; allowed: {_allowed(error)}")


@cache
def _validator() -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(json.loads(SCHEMA.read_text()))


def _allowed(error: jsonschema.ValidationError) -> str:
    """The way out of a schema error, in few words."""
    if error.validator == "additionalProperties" and isinstance(error.schema, dict):
        known = error.schema.get("properties") or error.schema.get("required") or []
        return "the keys " + ", ".join(sorted(known))
    return f"{error.validator} {json.dumps(error.validator_value)}"[:300]


def _variant(file: Path, document: Mapping[str, Any], name: str | None) -> dict[str, Any]:
    variants: dict[str, dict[str, Any]] = document.get("variants", {})
    if name is None:
        return {}
    if name not in variants:
        raise ScenarioError(
            f"{file}: variants: there is no variant {name!r}; there is: {', '.join(sorted(variants)) or 'none'}"
        )
    return variants[name]


def _overrides(file: Path, overrides: Sequence[str]) -> dict[str, Any]:
    """Parses `key=value` texts; the value is YAML, so that numbers are numbers."""
    result = {}
    for text in overrides:
        key, sign, value = text.partition("=")
        if not sign or not key:
            raise ScenarioError(f"--set {text}: must have the form key=value, such as vehicles=3")
        if key not in Parameters.__dataclass_fields__:
            known = ", ".join(Parameters.__dataclass_fields__)
            raise ScenarioError(f"--set {text}: {file} has no parameter {key!r}; it has: {known}")
        try:
            result[key] = yaml.safe_load(value)
        except yaml.YAMLError as error:
            raise ScenarioError(f"--set {text}: {value} is no number") from error
    return result


def _check_distances(file: Path, parameters: Mapping[str, Any]) -> None:
    if "stop_distance_m" in parameters and parameters["stop_distance_m"] <= parameters["start_distance_m"]:
        raise ScenarioError(
            f"{file}: parameters.stop_distance_m: {parameters['stop_distance_m']} must be greater than "
            f"start_distance_m "
            f"({parameters['start_distance_m']}), else the rule would start and stop at once"
        )


def _nodes(file: Path, entries: Sequence[Mapping[str, Any]], vehicles: int) -> tuple[Node, ...]:
    """Expands entries with a count; parameter `vehicles` is the count of role vehicle."""
    nodes = []
    for entry in entries:
        count = vehicles if entry["role"] == "vehicle" and "count" in entry else entry.get("count", 1)
        nodes += [_node(file, entry, index) for index in range(count)]
    names = [node.name for node in nodes]
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise ScenarioError(
            f"{file}: topology.nodes: {', '.join(doubled)} occurs twice; put {{index:02}} into the name of an entry "
            f"with count"
        )
    vehicle_count = sum(node.role == "vehicle" for node in nodes)
    if vehicle_count != vehicles:
        raise ScenarioError(
            f"{file}: topology.nodes: {vehicle_count} nodes of role vehicle, but parameter vehicles is {vehicles}; "
            f"give that entry a count"
        )
    return tuple(nodes)


def _capabilities(entries: Sequence[str | Mapping[str, int]], index: int) -> Iterator[str]:
    """Those of the node with this number in its entry: `lidar` is every node's, `{lidar: 2}` the first two's."""
    for entry in entries:
        if isinstance(entry, str):
            yield entry
        else:
            yield from (name for name, count in entry.items() if index < count)


def _node(file: Path, entry: Mapping[str, Any], index: int) -> Node:
    try:
        name, agent = entry["name"].format(index=index), entry["agent"].format(index=index)
    except (LookupError, ValueError) as error:
        raise ScenarioError(
            f"{file}: topology.nodes: {entry['name']}: only {{index}} can stand in braces, such as {{index:02}}"
        ) from error
    return Node(
        name=name,
        role=entry["role"],
        agent=agent,
        cpu=entry["capacity"]["cpu"],
        memory=entry["capacity"]["memory"],
        capabilities=tuple(_capabilities(entry["capabilities"], index)),
    )
