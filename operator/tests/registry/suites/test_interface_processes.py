"""The interface suite on real processes: the bridge over a real broker, charts as `registry new` writes them, and the
same ones with a mistake each."""

from __future__ import annotations

import json
import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.registry.catalogue.adapters.skeletons import new_application, new_chain
from robotkube.registry.catalogue.core.chart_versions import read_chart_version
from robotkube.registry.catalogue.core.expected_topics import ExpectedTopic
from robotkube.registry.charts.core.values_schemas import overlay
from robotkube.registry.evidence.core.statements import Artefact, Check
from robotkube.registry.suites.core.interface_observations import read_observation
from robotkube.registry.suites.loops.installation import filled_sets, install
from robotkube.registry.suites.loops.installed.changing import SettingsChange
from robotkube.registry.suites.loops.installed.soak import Soak
from robotkube.registry.suites.loops.interface import InterfaceSuite
from robotkube.registry.suites.loops.interface_observer import InterfaceObserver, ObserverPorts, ObserverTimeouts
from robotkube.registry.suites.ports.suites import Subject
from tests.stages.paths import REPOSITORY
from tests.stages.registry.local_namespace import SOURCE, LocalTestNamespace, deployment
from tests.stages.registry.wrong_interfaces import LIBRARY, MISTAKES, wrong_chart
from tests.stages.ros.ros_domains import domain as ros_domain

pytestmark = pytest.mark.processes

MESSENGER = REPOSITORY / "operator" / "tests" / "stages" / "ros" / "text_messenger.py"
HEALTH_PORT = '"", 8081'
READY = "    ready.set()\n"
FOLLOWING = "        settings.apply_changes()\n"

Render = Callable[[Mapping[str, Any], str], list[dict[str, Any]]]


@pytest.fixture
def namespace(tmp_path: Path) -> Iterator[LocalTestNamespace]:
    made = LocalTestNamespace(tmp_path)
    yield made
    made.close()


WHOLE, SHORT = ObserverTimeouts(), ObserverTimeouts(settle=3.0, answer=3.0, watch=4.0)
"""For charts that are right, which cost no more than they take, and for those of which something is missed in vain."""


def suite(bounds: ObserverTimeouts = WHOLE) -> InterfaceSuite:
    return InterfaceSuite("observer", Jinja2Templates().render, time.time_ns, lambda: secrets.token_hex(8), bounds)


def subject(chart: Path, entry: Mapping[str, Any], render: Render) -> Subject:
    artefact = Artefact(chart.name, "0.1.2", "sha256:" + "0" * 64, "linux/amd64")
    values = (chart / "values.yaml").read_bytes()
    return Subject(artefact, entry, {"values.yaml": values}, b"", {chart.name: f"{chart.name}@sha256:0"}, render)


def bridge_objects(values: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    settings = {"agent": values["placement"]["agent"], **values["bridge"]}
    command = ["robotkube-bridge"]
    return deployment(name, command, {"config.yaml": yaml.safe_dump(settings)}, "broker-account")


def relay(chart: Path) -> Render:
    """The objects of a chart that `registry new` wrote. Its health port is moved: many run on this machine."""
    defaults = yaml.safe_load((chart / "values.yaml").read_text())
    node = (chart / "files" / "node.py").read_text()
    assert HEALTH_PORT in node
    answers = (chart / "files" / "answers.py").read_text()
    node = "import os\n" + node.replace(HEALTH_PORT, '"", int(os.environ["ROBOTKUBE_HEALTH_PORT"])')

    def objects(values: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
        settings = yaml.safe_dump(overlay(defaults, values)["relay"])
        files = {"config.yaml": settings, "node.py": node, "answers.py": answers}
        return deployment(name, ["python3", "/etc/robotkube/node.py"], files)

    return objects


def said(checks: list[Check]) -> str:
    return "\n".join(f"{check.name}: {check.found} -> {check.fix}" for check in checks)


def test_the_bridge_is_what_its_entry_declares(namespace: LocalTestNamespace) -> None:
    chart = REPOSITORY / "charts" / "apps" / "mqtt-bridge"
    entry = yaml.safe_load((REPOSITORY / "registry/charts/mqtt-bridge/0.2.3.yaml").read_text())
    checks = list(suite().run(subject(chart, entry, bridge_objects), namespace))
    assert said([check for check in checks if not check.passed]) == ""
    names = {check.name for check in checks}
    assert "set vehicle: ros in /vehicles/suite_a/transform leads to an output" in names
    assert "set cloud: mqtt in mqtt/vehicles/suite_b/pointcloud leads to an output" in names
    assert {f"set {name}: no undeclared topics" for name in ("vehicle", "cloud")} <= names
    assert (namespace.leftovers(), namespace.deleted) == ([], ["mqtt-bridge", "mqtt-bridge"])


def test_a_bridge_with_another_entry_is_refused(namespace: LocalTestNamespace) -> None:
    """Qualities, the type inside the frames, a topic that is not declared, at the broker."""
    chart = REPOSITORY / "charts" / "apps" / "mqtt-bridge"
    entry = yaml.safe_load((REPOSITORY / "registry/charts/mqtt-bridge/0.2.3.yaml").read_text())
    interfaces = {item["name"]: item for item in entry["spec"]["interfaces"]}
    interfaces["mqtt-out"] |= {"type": "nav_msgs/msg/Odometry", "qos": {"qos": 0, "retain": True}}
    interfaces["mqtt-in"] |= {"topic": "other{{ topic.name }}", "qos": {"qos": 2, "retain": False}}
    entry["spec"]["suites"]["sets"].pop()
    failed = [check for check in suite(SHORT).run(subject(chart, entry, bridge_objects), namespace) if not check.passed]
    text = said(failed)
    pose, route = "mqtt/vehicles/suite_a/pose", "mqtt/vehicles/suite_a/route"
    for part in (
        f"mqtt out {pose}: wrong QoS: it is published with QoS 1, declared is 0 -> publish with QoS 0",
        f"mqtt out {pose}: wrong retain flag: it is published without the retain flag, declared is with it",
        f"mqtt out {pose}: wrong type: its messages are no nav_msgs/msg/Odometry: 76 bytes cannot be read as one",
        "mqtt in other/vehicles/suite_a/route: declared but absent: the broker saw no subscription of",
        f"it subscribed to {route}",
        f"undeclared topic mqtt in {route}: topic {route} was subscribed, which no interface declares",
        "mqtt in other/vehicles/suite_a/route leads to an output: after messages (nav_msgs/msg/Path) were sent to",
    ):
        assert part in text, f"{part}\n--- is not in\n{text}"


def player_objects(values: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    command = ["robotkube-player"]
    return deployment(name, command, {"config.yaml": yaml.safe_dump(values["player"])})


@pytest.mark.thorough
def test_the_player_opens_the_topics_of_a_bag_of_its_own_image(namespace: LocalTestNamespace) -> None:
    chart = REPOSITORY / "charts" / "apps" / "bag-player"
    entry = yaml.safe_load((REPOSITORY / "registry/charts/bag-player/0.1.3.yaml").read_text())
    checks = list(suite().run(subject(chart, entry, player_objects), namespace))
    assert said([check for check in checks if not check.passed]) == ""
    names = {check.name for check in checks}
    assert "set second: ros out /vehicles/suite_b/lidar_center/transform" in names
    ledgers = sorted(path.parent.name for path in namespace.folder.glob("scratch/ledger/*/*pose.jsonl"))
    assert ledgers == ["suite-first", "suite-second"], "the ordered runs were not played"


# Those that the entry or the observer alone decides are shown by test_interface_observations.py as well.
IN_EVERY_RUN = ("undeclared-topic", "unused-input")
ALSO = [name for name in MISTAKES if name not in IN_EVERY_RUN]
PERCEPTION = {"object-detection": "detection", "object-tracking": "tracking"}
OLDER: dict[str, dict[str, Any]] = {"object-detection": {"method": "size"}, "object-tracking": {"motion": "still"}}


@pytest.mark.thorough
@pytest.mark.parametrize(("place", "version"), [("apps", "0.2.3"), ("earlier", "0.1.2")])
@pytest.mark.parametrize("name", PERCEPTION)
def test_perception_is_what_its_entry_declares(
    namespace: LocalTestNamespace, name: str, place: str, version: str
) -> None:
    chart = REPOSITORY / "charts" / place / name
    entry = yaml.safe_load((REPOSITORY / f"registry/charts/{name}/{version}.yaml").read_text())
    defaults = yaml.safe_load((chart / "values.yaml").read_text())

    def objects(values: Mapping[str, Any], release: str) -> list[dict[str, Any]]:
        settings = {**(OLDER[name] if place == "earlier" else {}), **overlay(defaults, values)[PERCEPTION[name]]}
        command = [f"robotkube-{name}"]
        return deployment(release, command, {"config.yaml": yaml.safe_dump(settings)})

    checks = list(suite().run(subject(chart, entry, objects), namespace))
    assert said([check for check in checks if not check.passed]) == ""
    source = "lidar_center/pointcloud" if name == "object-detection" else "objects"
    assert f"set second: ros in /vehicles/suite_b/{source} leads to an output" in {check.name for check in checks}
    assert namespace.leftovers() == []


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for place in ("charts", "registry/applications", "registry/charts"):
        (tmp_path / "source" / place).mkdir(parents=True)
    (tmp_path / "source/charts/robotkube-app").symlink_to(LIBRARY, target_is_directory=True)
    return tmp_path / "source"


def test_what_registry_new_writes_passes(namespace: LocalTestNamespace, folder: Path) -> None:
    new_application("relay", "relay/text", folder / "charts", folder / "registry")
    chart = folder / "charts" / "relay"
    entry = yaml.safe_load((folder / "registry/charts/relay/0.1.0.yaml").read_text())
    checks = list(suite().run(subject(chart, entry, relay(chart)), namespace))
    assert said([check for check in checks if not check.passed]) == ""
    assert len(checks) > 8


def test_a_text_goes_through_all_services_that_registry_new_writes(namespace: LocalTestNamespace, folder: Path) -> None:
    services = ["order", "plan", "drive"]
    new_chain("delivery", services, "delivery/relay", folder / "charts", folder / "registry")
    spec = yaml.safe_load((folder / "registry/applications/delivery.yaml").read_text())["spec"]
    parameters = {name: schema["default"] for name, schema in spec["parameters"]["properties"].items()}
    render = Jinja2Templates().render
    for service in spec["services"]:
        topics = service["values"]["relay"]
        values = {"relay": {key: render(text, {"parameters": parameters}) for key, text in topics.items()}}
        name = service["release"]
        namespace.apply(relay(folder / "charts" / name)(values, name))
        assert namespace.wait_ready("Deployment", name, 30.0) == ""
    command = ["python3", str(MESSENGER), parameters["input"], parameters["output"], "hello"]
    run = namespace.run_pod("messenger", "ros", command, {}, 60.0)
    assert (run.exit_code, run.log) == (0, "heard: ['hello']\n")


DYING = """heard = []


def repeat(publisher, message):
    publisher.publish(message)
    heard.append(message)
    len(heard) < 20 or os._exit(3)


class Relay"""


def test_a_chart_that_ends_after_some_messages_passes_the_interface_suite_and_not_the_soak(
    namespace: LocalTestNamespace, folder: Path
) -> None:
    new_application("relay", "relay/text", folder / "charts", folder / "registry")
    chart = folder / "charts" / "relay"
    node = chart / "files" / "node.py"
    text = (
        node.read_text()
        .replace("answering(publisher), QOS", "lambda message: repeat(publisher, message), QOS")
        .replace("class Relay", DYING)
    )
    node.write_text(text.replace("import signal", "import os\nimport signal", 1))
    entry = yaml.safe_load((folder / "registry/charts/relay/0.1.0.yaml").read_text())
    del entry["spec"]["suites"]["sets"][1:]  # the others would say the same
    tested = subject(chart, entry, relay(chart))
    assert said([check for check in suite().run(tested, namespace) if not check.passed]) == ""
    render = Jinja2Templates().render
    first = filled_sets(entry, namespace.agent, time.time_ns(), render)[0]
    assert install(tested, namespace, first).ready
    [check] = Soak("observer", render, lambda: secrets.token_hex(8), 6).checks(tested, namespace, first)
    assert (check.name, check.passed) == ("keeps-running", False)
    assert "pod relay: container relay ended with 3 (Error)" in check.found


NO_NAME = "    node.create_timer(1.0, lambda: offset + 1)\n"


def test_a_chart_that_ends_a_second_after_its_start(namespace: LocalTestNamespace, folder: Path) -> None:
    new_application("relay", "relay/text", folder / "charts", folder / "registry")
    chart = folder / "charts" / "relay"
    node = chart / "files" / "node.py"
    text = node.read_text()
    assert text.count(READY) == 1
    node.write_text(text.replace(READY, READY + NO_NAME))
    entry = yaml.safe_load((folder / "registry/charts/relay/0.1.0.yaml").read_text())
    del entry["spec"]["suites"]["sets"][1:]
    bounds = ObserverTimeouts(settle=1.0, answer=1.0, watch=3.0)
    checks = suite(bounds).run(subject(chart, entry, relay(chart)), namespace)
    runs, keeps_running = [check for check in checks if check.name.startswith("set first: ")][:2]
    assert (runs.name, runs.passed) == ("set first: runs", True)
    assert (keeps_running.name, keeps_running.passed) == ("set first: keeps running", False)
    assert keeps_running.found.startswith("pod relay: container relay ended with 1 (Error)\n")
    assert keeps_running.found.endswith("NameError: name 'offset' is not defined")


@pytest.mark.parametrize(
    ("follows", "words"),
    [
        (True, "it opened the topics of second, and its pod stayed; shown to be at work: values.relay.input, values."),
        pytest.param(
            *(False, "still open, as with the settings before: ros in /first/in, ros out /first/out"),
            marks=pytest.mark.thorough,
        ),
    ],
)
def test_changed_settings_are_seen_at_work(
    namespace: LocalTestNamespace, folder: Path, follows: bool, words: str
) -> None:
    new_application("relay", "relay/text", folder / "charts", folder / "registry")
    chart = folder / "charts" / "relay"
    node = chart / "files" / "node.py"
    text = node.read_text()
    for line in () if follows else (FOLLOWING, "    Health.complaint = staticmethod(lambda: settings.complaint)\n"):
        assert line in text
        text = text.replace(line, "")
    node.write_text(text)
    entry = yaml.safe_load((folder / "registry/charts/relay/0.1.0.yaml").read_text())
    check = changed_settings(subject(chart, entry, relay(chart)), namespace)
    assert (check.passed, words in check.found) == (follows, True), check.found


def changed_settings(tested: Subject, namespace: LocalTestNamespace) -> Check:
    """The check of a chart that is installed with its first set, and then given other settings."""
    render = Jinja2Templates().render
    sets = filled_sets(tested.entry, namespace.agent, time.time_ns(), render)
    installed = install(tested, namespace, sets[0])
    assert installed.ready, installed.problem
    change = SettingsChange("observer", render, lambda: secrets.token_hex(8))
    [check], _ = change.checks(tested, namespace, installed, sets)
    return check


def restarting(render: Render) -> Render:
    """The objects with the settings in the pod template, as the library chart has their hash there."""

    def objects(values: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
        config_map, made = render(values, name)
        made["spec"]["template"]["metadata"] = {"annotations": {"robotkube.io/settings": str(config_map["data"])}}
        return [config_map, made]

    return objects


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "version", "render"),
    [("mqtt-bridge", "0.2.3", bridge_objects), ("bag-player", "0.1.3", restarting(player_objects))],
)
def test_packaged_charts_take_changed_settings(
    namespace: LocalTestNamespace, name: str, version: str, render: Render
) -> None:
    entry = yaml.safe_load((REPOSITORY / "registry" / "charts" / name / f"{version}.yaml").read_text())
    check = changed_settings(subject(REPOSITORY / "charts" / "apps" / name, entry, render), namespace)
    assert check.passed, check.found


@pytest.mark.parametrize("name", [*IN_EVERY_RUN, *(pytest.param(name, marks=pytest.mark.thorough) for name in ALSO)])
def test_each_mistake_fails_with_words_that_say_it(namespace: LocalTestNamespace, folder: Path, name: str) -> None:
    mistake = MISTAKES[name]
    chart, path = wrong_chart(name, folder)
    read_chart_version(path.read_text(), f"charts/{name}/{path.name}", published=False)
    entry = yaml.safe_load(path.read_text())
    if mistake.per_set:
        del entry["spec"]["suites"]["sets"][1:]  # the others say the same, in ten seconds more
    failed = [check for check in suite(SHORT).run(subject(chart, entry, relay(chart)), namespace) if not check.passed]
    wanted = f"set first: {mistake.check}" if mistake.per_set else mistake.check
    [check] = [check for check in failed if check.name == wanted] or pytest.fail(said(failed))
    assert mistake.found in check.found
    assert mistake.fix in check.fix
    assert not mistake.alone or len(failed) == 1, said(failed)


def test_a_chart_that_never_gets_ready_is_said_so(namespace: LocalTestNamespace, folder: Path) -> None:
    new_application("relay", "relay/text", folder / "charts", folder / "registry")
    chart = folder / "charts" / "relay"
    (chart / "files" / "node.py").write_text(f"print('no settings', {HEALTH_PORT!r})\n")
    entry = yaml.safe_load((folder / "registry/charts/relay/0.1.0.yaml").read_text())
    failed = [check for check in suite(SHORT).run(subject(chart, entry, relay(chart)), namespace) if not check.passed]
    assert [check.name for check in failed] == ["set first: runs", "set second: runs"]
    assert "was not ready: no settings" in failed[0].found
    assert namespace.leftovers() == []


def test_a_type_that_is_not_installed_is_said_so(namespace: LocalTestNamespace, folder: Path) -> None:
    new_application("relay", "relay/text", folder / "charts", folder / "registry")
    chart = folder / "charts" / "relay"
    text = (folder / "registry/charts/relay/0.1.0.yaml").read_text()
    entry = yaml.safe_load(text.replace("std_msgs/msg/String", "nowhere_msgs/msg/Thing"))
    del entry["spec"]["suites"]["sets"][1:]
    (check,) = (c for c in suite(SHORT).run(subject(chart, entry, relay(chart)), namespace) if not c.passed)
    assert check.name == "set first: runs"
    assert "the observer could not observe the chart: exit code 2" in check.found
    assert "message package nowhere_msgs is not installed in this image" in check.found
    assert namespace.leftovers() == []


def test_an_observer_that_shall_end_makes_no_more_messages() -> None:
    """The first one of a type costs seconds of imports on a busy machine: more than the observer has then."""
    topic = ExpectedTopic("input", "ros", "in", "/suite/never", "std_msgs/msg/String", "reliable", "volatile")
    network: Any = SimpleNamespace(advertise=lambda *_: SimpleNamespace(matched=0), endpoints=lambda: ())
    messages: Any = SimpleNamespace(payload=lambda _: pytest.fail("a message was made"))
    seen = InterfaceObserver(
        [topic], ObserverPorts(network, messages, time.monotonic, time.sleep, lambda: True), 60.0
    ).run()
    assert [(answer.input, answer.output) for answer in seen.answers] == [(0, None)]


def test_the_observer_ends_on_sigterm_with_what_it_saw(tmp_path: Path) -> None:
    topic = ExpectedTopic("input", "ros", "in", "/suite/never", "std_msgs/msg/String", "reliable", "volatile")
    config = {
        "topics": [asdict(topic)], "node": "suite_observer_test", "client": "", "broker": False, "database": None,
        "clear": False, "load_seconds": 0.0, "seconds_max": 60.0, "bounds": asdict(ObserverTimeouts(settle=60.0)),
    }  # fmt: skip
    (tmp_path / "config.json").write_text(json.dumps(config))
    environment = {
        **os.environ,
        "ROBOTKUBE_SUITE_CONFIG": str(tmp_path / "config.json"),
        "ROS_DOMAIN_ID": ros_domain(),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(tmp_path / "ros"),
        "PYTHONPATH": str(SOURCE),
    }
    command = [sys.executable, "-m", "robotkube.registry.suites.observer"]
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    assert '"observing"' in process.stderr.readline()
    process.send_signal(signal.SIGTERM)
    output, errors = process.communicate(timeout=10)
    assert process.returncode == 0, errors
    seen = read_observation(json.loads(output.splitlines()[-1])["observation"], "observer")
    assert [(answer.input, answer.output) for answer in seen.answers] == [(0, None)]
    assert seen.endpoints == ()
