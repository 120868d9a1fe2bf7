"""What the stories of Table I do and read: tasks and policies as people and operators give them, main as Git has it,
pods and messages as the cluster has them. What the manager says of itself is not asked."""

from __future__ import annotations

import base64
import json
import struct
import subprocess
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import yaml

from robotkube.robots.ros.core.common_messages import STAMPED_TYPES
from scenarios.generator import messages
from scenarios.runner.inputs import Commit
from scenarios.runner.platform import listening, proposing
from scenarios.runner.platform.deployment import Deployment
from scenarios.runner.playing import policy
from scenarios.runner.playing.acting import task
from scenarios.runner.waiting import RunError
from tests.stages.platform.running_platform import Platform, eventually

DEPLOYED_SECONDS_MAX = 90.0
GONE_SECONDS_MAX = 90.0
DECIDED_SECONDS_MAX = 30.0
RECEIVE_SECONDS_MAX = 30
PUBLISH_SECONDS_MAX = 300
ENDED_SECONDS_MAX = 15
READY_SECONDS_MAX = 120.0
SETTLED_SECONDS_MAX = 120.0
TEXT, NUMBER, POSES = "std_msgs/msg/String", "std_msgs/msg/Float64", "geometry_msgs/msg/PoseArray"
BRIDGE = "mqtt-bridge"
PYTHON = ("python3", "-c")

# Run in a pod of the agent's: everything that speaks ROS there has the module that it imports, and not many others.
PUBLISH = """
import base64, json, select, struct, sys, time
from robotkube.robots.ros.adapters.rclpy_node import RosNode
node, sources = RosNode("table_one_speaker"), []
for topic, kind, text, stamped in json.loads(sys.stdin.readline()):
    sources.append((node.advertise(topic, kind), base64.b64decode(text), stamped))
def restamped(data, stamp):
    order = "<" if data[1] & 1 else ">"
    return data[:4] + struct.pack(order + "iI", *divmod(stamp, 10**9)) + data[12:]
period, end = 1 / float(sys.argv[1]), time.monotonic() + float(sys.argv[2])
while time.monotonic() < end and not select.select([sys.stdin], [], [], 0)[0]:  # its end: nobody wants to hear more
    for publisher, data, stamped in sources:
        publisher.publish(restamped(data, time.time_ns()) if stamped else data)
    time.sleep(period)
"""

Message = tuple[str, str, bytes]
"""Topic, type, serialised message."""


@dataclass(frozen=True)
class Pod:
    """A pod of a release: its identity, where it runs, its containers' images by digest, whether it is ready."""

    name: str
    uid: str
    node: str
    images: tuple[str, ...]
    ready: bool


@dataclass
class Stage:
    """The platform, and a clone of the deployment repository as the person's account sees it."""

    platform: Platform
    deployment: Deployment
    submitted: list[str] = field(default_factory=list)

    # tasks and policies ----------------------------------------------------------------------------------------------

    def submit(self, namespace: str, name: str, **spec: Any) -> str:
        """A task as an operator of `namespace` gives it; its key. `spec`: application or provides, parameters, ..."""
        self.platform.access.create_task(task({"namespace": namespace, "name": name, **spec}))
        self.submitted.append(f"{namespace}/{name}")
        return self.submitted[-1]

    def withdraw(self, key: str) -> None:
        """The demand ends; one that is not there is fine."""
        self.platform.access.delete_task(*key.split("/", 1))

    def tasks(self, namespace: str) -> dict[str, Mapping[str, Any]]:
        """The tasks of a namespace by key."""
        documents = [one for one in self.platform.access.tasks() if one["metadata"]["namespace"] == namespace]
        return {f"{namespace}/{document['metadata']['name']}": document for document in documents}

    def standing(self) -> set[str]:
        """Releases on main; fails while one names a task that is gone: the next plan takes it away."""
        metadata = [one["metadata"] for one in self.platform.access.tasks()]
        there = {f"{one['namespace']}/{one['name']}" for one in metadata}
        releases = set(self.releases())
        if gone := {task for release in releases for task in self.annotation_of(release).split()} - there:
            raise RunError(f"main has releases of {sorted(gone)}")
        return releases

    def condition(self, key: str, kind: str = "Accepted") -> Mapping[str, str]:
        """A condition of a task, empty while it has none: what its submitter reads."""
        description = self.platform.access.task(*key.split("/", 1)) or {}
        conditions = description.get("status", {}).get("conditions", [])
        return next((one for one in conditions if one["type"] == kind), {})

    def await_reason(self, key: str, reason: str) -> Mapping[str, str]:
        """The condition Accepted once it has `reason`."""
        eventually(
            f"task {key} has the reason {reason}",
            lambda: self.condition(key).get("reason") == reason,
            DECIDED_SECONDS_MAX,
        )
        return self.condition(key)

    @contextmanager
    def asked_by_a_person(
        self, *entries: Mapping[str, Any], instead_of: Sequence[Mapping[str, Any]] = ()
    ) -> Iterator[None]:
        """Entries of policies/initial.yaml by a person's pull request, without what they stand for, and afterwards
        another pull request that brings it back."""
        self._put_policy(lambda kept: [*kept, *entries], lambda kept: [*kept, *instead_of])
        try:
            yield
        finally:
            self._put_policy(
                lambda kept: [entry for entry in kept if entry not in entries],
                lambda kept: [entry for entry in kept if entry not in instead_of],
            )

    def ask_otherwise(self, entry: Mapping[str, Any], other: Mapping[str, Any]) -> None:
        """Another entry of policies/initial.yaml in the place of one, by a person's pull request."""
        self._put_policy(lambda kept: [other if one == entry else one for one in kept])

    def _put_policy(self, add: Any, remove: Any = list) -> None:
        self.deployment.fetch()
        document = yaml.safe_load(self.deployment.file(policy.PATH)) or {}
        changed = {"add": add(list(document.get("add") or [])), "remove": remove(list(document.get("remove") or []))}
        text = yaml.safe_dump(document | changed, sort_keys=True)
        topic = f"table-one-{time.time_ns()}"
        proposing.change(self.deployment, policy.PATH, text, "policy(initial): a story of Table I", topic)

    # main ------------------------------------------------------------------------------------------------------------

    def releases(self) -> dict[str, Mapping[str, Any]]:
        """Release files of main by <namespace>/<release>."""
        self.deployment.fetch()
        return self.deployment.releases()

    def annotation(self, release: str, name: str) -> str:
        """An annotation of a release on main, such as chart-version or tasks; empty when it is not there."""
        document = self.releases().get(release, {})
        return str(document.get("metadata", {}).get("annotations", {}).get(f"robotkube.io/{name}", ""))

    def releases_of(self, key: str) -> set[str]:
        """Releases on main that name a task, but for the bridges, which are everybody's."""
        return {
            release
            for release in self.releases()
            if key in self.annotation_of(release).split() and release.rpartition("/")[2] != BRIDGE
        }

    def await_releases_of(self, key: str) -> set[str]:
        """`releases_of` once there are any: a task is accepted before its plan is on main."""
        return set(eventually(f"{key} has its releases on main", lambda: self.releases_of(key)))

    def annotation_of(self, release: str) -> str:
        """Tasks that a release names, in the clone as it was fetched last."""
        document = self.deployment.releases().get(release, {})
        return str(document.get("metadata", {}).get("annotations", {}).get("robotkube.io/tasks", ""))

    def commits(self) -> Sequence[Commit]:
        """Main's commits, newest first, with their trailers."""
        self.deployment.fetch()
        return self.deployment.commits()

    def commit_of(self, release: str) -> Commit:
        """The last commit that touched a release's file."""
        path = f"releases/{release}.yaml"
        return next(commit for commit in self.commits() if path in commit.paths)

    def message(self, commit: Commit) -> str:
        """The whole message of a commit: what was decided, and why."""
        return self.deployment.message(commit.sha)

    # the cluster -----------------------------------------------------------------------------------------------------

    def pods(self, release: str) -> list[Pod]:
        """Pods of a release (`<namespace>/<name>`), those that end included."""
        namespace, name = release.split("/", 1)
        items = self.platform.get("-n", namespace, "pods", "-l", f"app.kubernetes.io/instance={name}")["items"]
        return [_pod(item) for item in items]

    def await_running(self, *releases: str, seconds: float = DEPLOYED_SECONDS_MAX) -> dict[str, Pod]:
        """The one ready pod of each release, once all of them are on main and run."""

        def running() -> dict[str, Pod]:
            pods_by_release = {release: self.pods(release) for release in releases if release in self.releases()}
            ready = {release: pods[0] for release, pods in pods_by_release.items() if len(pods) == 1 and pods[0].ready}
            return ready if len(ready) == len(releases) else {}

        return dict(eventually(f"{', '.join(releases)} run", running, seconds, lambda: self.state_of(*releases)))

    def state_of(self, *releases: str) -> Mapping[str, object]:
        """Versions on main and pods of these releases, and what is said of all tasks: why they do not run."""
        versions = {release: self.annotation(release, "chart-version") for release in releases}
        tasks = self.platform.get("-A", "taskdescriptions")["items"]
        said = {
            f"{task['metadata']['namespace']}/{task['metadata']['name']}": [
                f"{one['type']} {one['status']} {one['reason']}: {one['message']}"
                for one in task.get("status", {}).get("conditions", ())
            ]
            for task in tasks
        }
        return {"main": versions, "pods": {release: self.pods(release) for release in releases}, "tasks": said}

    def await_gone(self, *releases: str, seconds: float = GONE_SECONDS_MAX) -> None:
        """No file on main, no Application and no pod of these releases."""

        def gone() -> bool:
            known = self.releases()
            applications = self.platform.access.applications()
            here = [one for one in releases if one in known or one.replace("/", "-") in applications]
            return not here and not any(self.pods(release) for release in releases)

        eventually(f"{', '.join(releases)} are gone", gone, seconds)

    def node_labels(self, node: str) -> Mapping[str, str]:
        """Labels of a node."""
        return dict(self.platform.get("node", node)["metadata"]["labels"])

    @contextmanager
    def stopped(self, node: str) -> Iterator[None]:
        """A node's machine is ended, and started again afterwards."""
        self.platform.provider.stop_node(node)
        try:
            yield
        finally:
            self.platform.provider.start_node(node)
            eventually(f"node {node} is back", lambda: self._is_ready(node), READY_SECONDS_MAX)

    def _is_ready(self, node: str) -> bool:
        return any(one.name == node and one.ready for one in self.platform.provider.nodes())

    # messages --------------------------------------------------------------------------------------------------------

    def receive(self, release: str, topic: str, kind: str, count: int = 1) -> list[Any]:
        """`count` messages of a topic on the node of a release's pod, read there; fails when there are fewer."""
        command = self._inside(release, *listening.arguments(topic, kind, count, RECEIVE_SECONDS_MAX))
        done = subprocess.run(command, capture_output=True, text=True, timeout=RECEIVE_SECONDS_MAX + 30, check=False)
        heard = listening.messages(done.stdout)
        assert len(heard) >= count, f"{topic}: {len(heard)} of {count} messages\n{done.stderr[-2000:]}"
        return [messages.store.deserialize_cdr(data, kind) for data in heard[:count]]

    @contextmanager
    def publishing(self, release: str, *published: Message, hertz: float = 10) -> Iterator[None]:
        """Messages published on the node of a release's pod as if a service there did, again and again, stamped
        with the present time where they have a header."""
        command = self._inside(release, *PYTHON, PUBLISH, str(hertz), str(PUBLISH_SECONDS_MAX), stdin=True)
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
        assert process.stdin is not None
        try:
            lines = [
                (topic, kind, base64.b64encode(data).decode(), kind in STAMPED_TYPES) for topic, kind, data in published
            ]
            process.stdin.write(json.dumps(lines) + "\n")
            process.stdin.flush()
            yield
            assert process.poll() is None, f"the publisher beside {release} ended with {process.returncode}"
        finally:
            process.stdin.close()
            _end(process)

    def run(self, release: str, program: str, *arguments: str, seconds: float) -> list[str]:
        """Lines that a Python program prints beside a release's process, in its pod; fails when the program does."""
        command = self._inside(release, *PYTHON, program, *arguments)
        done = subprocess.run(command, capture_output=True, text=True, timeout=seconds, check=False)
        assert done.returncode == 0, f"{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
        return done.stdout.splitlines()

    def _inside(self, release: str, *command: str, stdin: bool = False) -> list[str]:
        namespace, pod = release.partition("/")[0], self.await_running(release)[release]  # not one that is ending
        kubectl = [str(self.platform.installer.binaries / "kubectl"), f"--kubeconfig={self.platform.access.kubeconfig}"]
        words = [*kubectl, "-n", namespace, "exec", *(["-i"] if stdin else []), pod.name, "--"]
        return [*words, *command]


@contextmanager
def on_stage(platform: Platform) -> Iterator[Stage]:
    """A stage that begins with everything as main asks for and nothing on main that is being taken away, and ends with
    main asking for what it did before."""
    eventually("all Applications synced and healthy", platform.settled, SETTLED_SECONDS_MAX)
    forge = platform.access.forge()
    story = platform.scenario.story
    person, approver = (platform.access.forge_account(name) for name in (story.person, story.approver))
    with Deployment(forge, *person, approver=approver) as deployment:
        stage = Stage(platform, deployment)
        before = eventually("main has releases of no task that is gone", stage.standing, SETTLED_SECONDS_MAX)
        yield stage
        for key in stage.submitted:
            stage.withdraw(key)
        eventually("main asks for what it did before", lambda: _same(stage.releases(), before), SETTLED_SECONDS_MAX)


def _same(names: Iterable[str], before: set[str]) -> bool:
    """True; RunError names what is different."""
    releases = set(names)
    if releases != before:
        raise RunError(f"more: {sorted(releases - before)}; fewer: {sorted(before - releases)}")
    return True


def _end(process: subprocess.Popen[str]) -> None:
    try:
        process.wait(ENDED_SECONDS_MAX)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _pod(item: Mapping[str, Any]) -> Pod:
    status = item["status"]
    conditions = {one["type"]: one["status"] for one in status.get("conditions", [])}
    ready = conditions.get("Ready") == "True" and "deletionTimestamp" not in item["metadata"]
    images = tuple(container["image"] for container in item["spec"]["containers"])
    return Pod(item["metadata"]["name"], item["metadata"]["uid"], item["spec"].get("nodeName", ""), images, ready)


def pose(x: float, y: float = 0.0) -> bytes:
    """A geometry_msgs/PoseStamped in frame map, in m."""
    return messages.PoseWriter().message(0, x, y, 0.0)


def number(value: float) -> bytes:
    """A std_msgs/Float64."""
    return b"\0\1\0\0" + struct.pack("<d", value)
