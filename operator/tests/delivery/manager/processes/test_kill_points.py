"""The manager killed at each of its writes, before and after: the next one ends at the same main, nothing twice.

The points are the methods that carry `@writes`: one that has no process here, or a write without the mark, fails.
"""

import ast
import contextlib
import importlib
import inspect
import json
import subprocess
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from robotkube.delivery.deployment.core.commit_messages import read_message
from tests.stages.delivery.manager.manager_process import Pod, conditions, write_settings
from tests.stages.forge.installation import ApplicationSetController, Installation, outside, start_gate
from tests.stages.kubernetes.api_calls import TASKS, Api
from tests.stages.programs import free_port
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain
PACKAGE = "robotkube."
MANAGER = (  # what the manager writes in the story below
    "foundation.forge.adapters.git.proposals.ProposalWriter.propose",
    "foundation.forge.adapters.hosts.gitea.GiteaForge.comment",
    "foundation.forge.adapters.hosts.gitea.GiteaForge.close",
    "delivery.manager.adapters.kubernetes_cluster.KubernetesCluster.patch_status",
    "delivery.manager.adapters.kubernetes_cluster.KubernetesCluster.report_on_task",
    "foundation.kubernetes.adapters.lease.LeaseElection._write",
)
CLUSTER = "delivery.manager.adapters.kubernetes_cluster.KubernetesCluster."
FORGE = "foundation.forge.adapters.hosts.gitea.GiteaForge."
ELSEWHERE = {  # what other processes and tests answer for, by the start of the name
    "foundation.forge.adapters.git.clones.GitClone.push_main": "delivery/gate/test_gate.py",
    "foundation.forge.adapters.git.notes.": "delivery/gate/test_plan_notes.py",
    "foundation.forge.adapters.git.working_clones.": "foundation/forge/test_break_glass.py",
    f"{FORGE}edit_comment": "registry/publication/test_publication_on_forge.py",
    "foundation.forge.adapters.hosts.github.": "recorded protocol only",
    "foundation.forge.adapters.hosts.gitlab.": "recorded protocol only",
    f"{CLUSTER}report_on_node": "an Event about a Node: the same name every time",
    f"{CLUSTER}withdraw": "children of a chain, again at every step: delivery/manager/test_operators.py",
    "delivery.tasks.adapters.kubernetes_tasks.": "delivery/tasks/test_mqtt_gateway_processes.py",
    "delivery.tasks.adapters.paho_gateway.": "delivery/tasks/test_mqtt_gateway.py",
}
STORY_SECONDS_MAX = 60.0
PRIMITIVES = frozenset({"push", "publish", "ack"})
METHODS = frozenset({"POST", "PUT", "PATCH", "DELETE"})
MEETING = {"application": "pose-point-cloud-recording", "parameters": {"vehicles": ["vehicle-00", "vehicle-01"]}}
OTHER = {"application": "pose-point-cloud-recording", "parameters": {"vehicles": ["vehicle-00"]}}
NAMES = ("first", "meeting", "wrong")


LOADED = """
import json, sys
import robotkube.delivery.gate.__main__, robotkube.delivery.manager.__main__
from robotkube.writes import WRITES
ours = [name for name in sys.modules if name.startswith("robotkube.")]
print(json.dumps([sorted(WRITES), sorted(name for name in ours if ".adapters." in name)]))
"""


@cache
def loaded() -> tuple[frozenset[str], tuple[str, ...]]:
    """Marked writes and adapters of the manager's and the gate's processes, as a process of its own loads them."""
    done = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, timeout=60, check=True)
    writes, adapters = json.loads(done.stdout)
    return frozenset(name.removeprefix(PACKAGE) for name in writes), tuple(adapters)


def test_every_write_has_its_point() -> None:
    marked, _ = loaded()
    unknown = {name for name in marked if name not in MANAGER and not name.startswith(tuple(ELSEWHERE))}
    assert unknown == set()
    assert set(MANAGER) <= marked


def test_nothing_is_written_without_the_mark() -> None:
    unmarked: set[str] = set()
    for name in loaded()[1]:
        if not name.removeprefix(PACKAGE).startswith(UNCHECKED):
            source = inspect.getsource(importlib.import_module(name))
            unmarked |= {f"{name}.{function}" for function in unmarked_writes(source)}
    assert unmarked == set()


UNCHECKED = (  # by the start of the name
    "registry.charts.adapters.oci",  # publication's own points
    "foundation.forge.adapters.push_hooks",  # these ask others to look or to begin, and change nothing
    "delivery.manager.adapters.argocd",
    "foundation.forge.adapters.git.histories",  # what it pushes are commits into a walk: it reads
    "registry.suites.adapters.runner_protocol",
)


def unmarked_writes(source: str) -> Iterable[str]:
    """Names of public functions that write, themselves or by private ones, and do not carry the mark."""
    functions = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FunctionDef)]
    marked = {f.name for f in functions if any("writes" in ast.dump(d) for d in f.decorator_list)}
    writing = {f.name for f in functions if _writes(f)}
    for _ in functions:
        private = {name for name in writing if name.startswith("_") and name not in marked}
        writing |= {f.name for f in functions if private & {_called(call) for call in _calls(f)}}
    return {name for name in writing - marked if not name.startswith("_")}


def _calls(function: ast.FunctionDef) -> list[ast.Call]:
    return [node for node in ast.walk(function) if isinstance(node, ast.Call)]


def _called(call: ast.Call) -> str:
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")


def _writes(function: ast.FunctionDef) -> bool:
    for call in _calls(function):
        words = {argument.value for argument in call.args if isinstance(argument, ast.Constant)}
        attributes = {
            node.attr for argument in call.args for node in ast.walk(argument) if isinstance(node, ast.Attribute)
        }
        if words & METHODS or _called(call) in PRIMITIVES:
            return True
        if any(word.startswith(("create_namespaced", "replace_namespaced", "patch_namespaced")) for word in attributes):
            return True
    return False


def test_the_search_for_unmarked_writes_finds_them() -> None:
    source = "def a(x):\n    _b(x)\ndef _b(x):\n    x.push(1)\n"
    source += "@writes('git')\ndef c(x):\n    _b(x)\ndef d(x):\n    x('POST')\n"
    assert unmarked_writes(source) == {"a", "d"}


class Story:
    """A proposal that is withdrawn while the gate is away, a task that is refused, one that is merged."""

    def __init__(self, installation: Installation, manager_api: Api, hook: str, folder: Path) -> None:
        self.installation, self.api, self.hook, self.folder = installation, manager_api, hook, folder
        self.lease = manager_api.lease()
        self.pods = list[Pod]()

    def start(self, point: str = "") -> Pod:
        port = free_port()
        folder = self.folder / f"pod-{len(self.pods)}"
        folder.mkdir(parents=True)
        config = write_settings(outside(self.installation), folder, port, self.lease)
        self.pods.append(Pod(config, self.api.kubeconfig, port, "manager-0", point))
        return self.pods[-1]

    def until(self, condition: Any, what: str) -> None:
        """As soon as it holds; a process that was killed is followed by another, as a kubelet does it."""

        def holds() -> bool:
            if self.pods[-1].process.poll() is not None:
                self.start()
            return bool(condition())

        try:
            until(holds, what, STORY_SECONDS_MAX)
        except AssertionError as error:
            raise AssertionError(f"{error}\n{self.pods[-1].log.read_text()[-3000:]}") from error

    def condition(self, name: str, kind: str) -> tuple[str, str]:
        return conditions(self.api.get(f"{TASKS}/{name}")).get(kind, ("", ""))

    def open(self) -> list[dict[str, Any]]:
        query = {"state": "open", "poster": "manager"}
        return list(self.installation.client("gate").get("/pulls", params=query).json())

    def run(self, point: str) -> None:
        self.start(point)
        self.api.task("first", **MEETING)
        self.api.task("wrong", application="nothing")
        self.until(lambda: any("vehicle-00" in pull["title"] or pull["body"] for pull in self.open()), "proposed")
        self.until(lambda: self.condition("wrong", "Accepted") == ("False", "UnknownApplication"), "refused")
        self.until(lambda: self.condition("first", "Committed")[0] == "False", "the first waits")
        self.api.delete(f"{TASKS}/first")
        self.api.task("meeting", **OTHER)
        self.until(lambda: self.condition("meeting", "Committed") == ("False", "Proposed"), "the second is proposed")
        self.until(lambda: len(self.open()) == 1, "the first proposal is closed")
        gate = start_gate(self.installation, self.hook, self.folder / "gate")
        try:
            self.until(lambda: self.condition("meeting", "Committed") == ("True", "Merged"), "merged")
            self.until(lambda: not self.open(), "nothing is left open")
        finally:
            gate.stop()

    def plans(self, task: str) -> list[str]:
        """Plans on main that name the task."""
        clone = self.installation.clone("argocd")
        at = clone.repository[clone.tip()]
        identifiers = []
        while at is not None:
            if f"RobotKube-Task: cloud-0/{task}\n" in at.message:
                identifiers.append(read_message(at.message).plan)
            at = at.parents[0] if at.parents else None
        return identifiers

    def clear(self) -> None:
        """Everything the story asked for is withdrawn, and its processes are gone."""
        before = len(self.plans("meeting"))  # as long as no gate is there
        for name in NAMES:
            with contextlib.suppress(KeyError):
                self.api.delete(f"{TASKS}/{name}")
        gate = start_gate(self.installation, self.hook, self.folder / "last-gate")
        try:
            self.until(lambda: len(self.plans("meeting")) == before + 1, "withdrawn")
        finally:
            gate.stop()
            for pod in self.pods:
                pod.kill()


@pytest.fixture(scope="module")
def begun(own_installation: Installation, manager_api: Api, tmp_path_factory: pytest.TempPathFactory) -> Installation:
    """The initial configuration is on main."""
    controller = ApplicationSetController()
    folder = tmp_path_factory.mktemp("begun")
    story = Story(own_installation, manager_api, controller.url, folder)
    gate = start_gate(own_installation, controller.url, folder / "gate")
    try:
        pod = story.start()
        until(lambda: pod.ready() and pod.plans() and all(plan["on_main"] for plan in pod.plans()), "begun", 60)
        assert pod.end() == 0
    finally:
        gate.stop()
        controller.stop()
        for one in story.pods:
            one.kill()
    return own_installation


@pytest.fixture
def story(
    begun: Installation, manager_api: Api, controller: ApplicationSetController, tmp_path: Path
) -> Iterator[Story]:
    prepared = Story(begun, manager_api, controller.url, tmp_path)
    yield prepared
    prepared.clear()


POINTS = [f"kill {when} {PACKAGE}{name}" for name in MANAGER for when in ("before", "after")]


@pytest.mark.thorough
@pytest.mark.parametrize("point", POINTS)
def test_killed_at_any_write_nothing_is_lost_and_nothing_done_twice(story: Story, point: str) -> None:
    before = len(story.plans("meeting"))
    story.run(point)
    assert story.pods[0].hit, f"the story does not come to: {point}"
    assert len(story.pods) == 2
    assert len(story.plans("meeting")) == before + 1
    assert story.plans("first") == []
    events = story.api.get("/apis/events.k8s.io/v1/namespaces/cloud-0/events")["items"]
    uid = story.api.get(f"{TASKS}/wrong")["metadata"]["uid"]
    assert [e["reason"] for e in events if e["regarding"].get("uid") == uid] == ["UnknownApplication"]
