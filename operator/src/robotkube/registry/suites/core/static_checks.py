"""The rules of the static suite over a chart's objects and its catalogue entry, with their words.

A rule yields one sentence per problem; a check is a rule over all renderings, with all its problems at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

from robotkube.foundation.documents.core.patterns import IMAGE_BY_DIGEST
from robotkube.foundation.documents.core.quantities import quantity, written
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.suites.core import pod_security
from robotkube.registry.suites.core.pod_security import PROBES, Pod, items, mapping

PROBLEMS_SHOWN = 20
ALLOWED_KINDS = (("apps", "Deployment"), ("", "ConfigMap"))  # what AppProject robotkube-apps lets Argo CD write
SERVICE_ACCOUNTS = ("application", "mqtt-bridge", "event-detector", "bag-player")
AGENT_LABEL = "robotkube.io/agent"
PLAN_ANNOTATION = "robotkube.io/plan"
HOOK_ANNOTATIONS = ("helm.sh/hook", "argocd.argoproj.io/hook")
BELONGS_TO_PLATFORM = {
    "Secret": "Secrets are made per agent by the platform; name one in a value",
    "ServiceAccount": f"use one of the agent's accounts: {', '.join(SERVICE_ACCOUNTS)}",
    "Role": "rights are given by the platform",
    "RoleBinding": "rights are given by the platform",
    "ClusterRole": "rights are given by the platform",
    "ClusterRoleBinding": "rights are given by the platform",
    "PersistentVolumeClaim": "volume claims belong to the agent (values of the platform); name one in a value",
    "Service": "a release is reached over ROS or MQTT",
}

Object = Mapping[str, Any]


@dataclass(frozen=True)
class Rendering:
    """A chart's objects for one set of values: `test_set` names the set, `agent` is its placement.agent."""

    test_set: str
    chart: str
    release: str
    agent: str
    objects: Sequence[Object]

    @property
    def pods(self) -> list[Pod]:
        """Every pod template, whatever kind of object holds it."""
        return [pod for item in self.objects for pod in _templates(item)]


def _templates(item: Object) -> Iterator[Pod]:
    spec = mapping(item.get("spec"))
    template: Any = item if item.get("kind") == "Pod" else spec.get("template")
    if item.get("kind") == "CronJob":
        template = mapping(mapping(spec.get("jobTemplate")).get("spec")).get("template")
    if isinstance(template, Mapping):
        annotations = mapping(mapping(template.get("metadata")).get("annotations"))
        yield Pod(title(item), annotations, mapping(template.get("spec")))


def title(item: Object) -> str:
    """An object's kind and name: `Deployment app`."""
    return f"{item.get('kind', 'object')} {mapping(item.get('metadata')).get('name', '(without a name)')}"


def check(name: str, problems: Iterable[str], fix: str) -> Check:
    """Passed without problems; else what was found, each problem once and at most PROBLEMS_SHOWN, and the fix."""
    distinct = list(dict.fromkeys(problems))
    shown = distinct[:PROBLEMS_SHOWN] + (
        [f"and {len(distinct) - PROBLEMS_SHOWN} more"] if distinct[PROBLEMS_SHOWN:] else []
    )
    return Check(name, not distinct, "; ".join(shown), fix if distinct else "")


def foreign_kinds(rendering: Rendering) -> Iterator[str]:
    """A sentence for each object of a kind that no release may have."""
    for item in rendering.objects:
        group = str(item.get("apiVersion", "")).rpartition("/")[0]
        if (group, item.get("kind")) not in ALLOWED_KINDS:
            why = BELONGS_TO_PLATFORM.get(
                str(item.get("kind")), "the platform's AppProject lets no release have this kind"
            )
            yield f"{title(item)} ({item.get('apiVersion')}): {why}"


def _kinds(rendering: Rendering) -> Iterator[str]:
    yield from foreign_kinds(rendering)
    deployments = [item for item in rendering.objects if item.get("kind") == "Deployment"]
    if len(deployments) != 1:
        yield f"{len(deployments)} Deployments; a service is exactly one"


def _names(rendering: Rendering) -> Iterator[str]:
    seen: set[str] = set()
    for item in rendering.objects:
        metadata = mapping(item.get("metadata"))
        if metadata.get("name") != rendering.release:
            yield f"{title(item)}: is not named as the release, which was {rendering.release}"
        if metadata.get("namespace"):
            yield f"{title(item)}: metadata.namespace is set; the release's namespace counts"
        if title(item) in seen:
            yield f"{title(item)}: stands twice"
        seen.add(title(item))


def _labels(rendering: Rendering) -> Iterator[str]:
    wanted = {"app.kubernetes.io/name": rendering.chart, "app.kubernetes.io/instance": rendering.release}
    wanted |= {AGENT_LABEL: rendering.agent}
    for item in rendering.objects:
        template = mapping(mapping(mapping(item.get("spec")).get("template")).get("metadata"))
        labelled = [(title(item), mapping(item.get("metadata")))]
        labelled += [(f"pod template of {title(item)}", template)] if item.get("kind") == "Deployment" else []
        for place, metadata in labelled:
            labels = mapping(metadata.get("labels"))
            for key, value in wanted.items():
                if labels.get(key) != value:
                    yield f"{place}: label {key} is {labels.get(key)!r}, not {value!r}"


def _placement(rendering: Rendering) -> Iterator[str]:
    for pod in rendering.pods:
        value = mapping(pod.spec.get("nodeSelector")).get(AGENT_LABEL)
        if value != rendering.agent:
            yield f"{pod.place}: nodeSelector {AGENT_LABEL} is {value!r}, not {rendering.agent!r}"
        if pod.spec.get("nodeName"):
            yield f"{pod.place}: nodeName is set: it would pass by the scheduler"
        if pod.spec.get("priorityClassName"):
            yield f"{pod.place}: priorityClassName is set: it would push others off the node"


def _hooks(rendering: Rendering) -> Iterator[str]:
    for item in rendering.objects:
        for key in HOOK_ANNOTATIONS:
            if key in mapping(mapping(item.get("metadata")).get("annotations")):
                yield f"{title(item)}: annotation {key}: hooks are no part of a release"


def _resources(rendering: Rendering) -> Iterator[str]:
    for pod in rendering.pods:
        for place, container in pod.containers:
            given = mapping(container.get("resources"))
            wanted = (("requests", "cpu"), ("requests", "memory"), ("limits", "memory"))
            for kind, name in wanted:
                if mapping(given.get(kind)).get(name) in (None, ""):
                    yield f"{place}: resources.{kind}.{name} is missing"


def _probes(rendering: Rendering) -> Iterator[str]:
    for pod in rendering.pods:
        for container in items(pod.spec.get("containers")):
            for key in PROBES:
                if not mapping(container.get(key)):
                    yield f"{pod.place}: container {container.get('name')}: {key} is missing"


def _images(rendering: Rendering) -> Iterator[str]:
    for pod in rendering.pods:
        for place, container in pod.containers:
            image = str(container.get("image") or "")
            if not IMAGE_BY_DIGEST.fullmatch(image):
                yield f"{place}: image {image or '(none)'} is not named by its digest: another one could run tomorrow"


def _accounts(rendering: Rendering) -> Iterator[str]:
    for pod in rendering.pods:
        name = pod.spec.get("serviceAccountName") or pod.spec.get("serviceAccount") or "default"
        if name not in SERVICE_ACCOUNTS:
            yield f"{pod.place}: serviceAccountName is {name}: no agent's namespace has rights for it"


def _read_only_root(rendering: Rendering) -> Iterator[str]:
    for pod in rendering.pods:
        for place, container in pod.containers:
            if mapping(container.get("securityContext")).get("readOnlyRootFilesystem") is not True:
                yield f"{place}: readOnlyRootFilesystem is not true: a change inside the image would go unseen"


Look = Callable[[Rendering], Iterator[str]]
RULES: tuple[tuple[str, Look, str], ...] = (
    ("kinds", _kinds, "make one Deployment of apps/v1 and ConfigMaps of v1, and leave everything else out"),
    ("names", _names, "write metadata.name: {{ .Release.Name }} and no metadata.namespace"),
    (
        "labels",
        _labels,
        "take names and labels from the library chart: robotkube-app.metadata and robotkube-app.labels",
    ),
    (
        "placement",
        _placement,
        "write nodeSelector: {robotkube.io/agent: {{ .Values.placement.agent }}}, no nodeName and no priorityClassName",
    ),
    ("hooks", _hooks, "leave the annotation out; what must be done before is done by the process when it starts"),
    ("resources", _resources, "give every container requests of cpu and memory and a limit of memory"),
    ("probes", _probes, "give the container a startup, a readiness and a liveness probe"),
    ("images-by-digest", _images, "name it <repository>@sha256:<digest>; images.yaml, which packing adds, has it"),
    ("service-account", _accounts, f"use one of {', '.join(SERVICE_ACCOUNTS)}"),
    ("read-only-root", _read_only_root, "write readOnlyRootFilesystem: true, and mount an emptyDir where it writes"),
)


def object_checks(renderings: Sequence[Rendering]) -> list[Check]:
    """A check per rule and per rule of Pod Security, over all renderings."""
    checks = [
        check(name, (p for rendering in renderings for p in inspect(rendering)), fix) for name, inspect, fix in RULES
    ]
    pods = [pod for rendering in renderings for pod in rendering.pods]
    for rule in pod_security.RULES:
        problems = (problem for pod in pods for problem in rule.inspect(pod))
        checks.append(check(f"pod-security/{rule.name}", problems, rule.fix))
    return [*checks, strategy_advice(renderings)]


def strategy_advice(renderings: Sequence[Rendering]) -> Check:
    """A check that always passes: it advises against what would double messages for a moment."""
    advice = []
    for item in [item for rendering in renderings for item in rendering.objects if item.get("kind") == "Deployment"]:
        spec = mapping(item.get("spec"))
        if mapping(spec.get("strategy")).get("type") != "Recreate" or spec.get("replicas", 1) != 1:
            advice.append(f"advice: {title(item)}: two pods of it can run at once, and would double every message")
    fix = "write replicas: 1 and strategy: {type: Recreate}"
    return Check("strategy", True, "; ".join(dict.fromkeys(advice)), fix if advice else "")


def plan_problems(without: Rendering, planned: Rendering, plan: str) -> list[str]:
    """Problems of a rendering with a plan: `planned` was rendered with `global.plan`, so only annotations of the
    objects themselves may differ, and one object carries it. Which ones is the chart's choice: every plan writes each
    of them."""
    problems = []
    if [_bare(item) for item in without.objects] != [_bare(item) for item in planned.objects]:
        problems.append(
            f"set {planned.test_set}: global.plan changes more than annotations: every plan would restart pods"
        )
    annotated = [
        (item, mapping(mapping(item.get("metadata")).get("annotations")).get(PLAN_ANNOTATION))
        for item in planned.objects
    ]
    problems += [
        f"set {planned.test_set}: {title(item)}: annotation {PLAN_ANNOTATION} is {value!r}, not {plan!r}"
        for item, value in annotated
        if value not in (None, plan)
    ]
    if all(value is None for _, value in annotated):
        problems.append(
            f"set {planned.test_set}: no object has the annotation {PLAN_ANNOTATION}: nothing says whose plan runs"
        )
    return problems


def same_but_plan(rendering: Rendering, other: Rendering) -> bool:
    """Return whether two renderings differ in nothing but the plan's annotation."""
    return [_unplanned(object_) for object_ in rendering.objects] == [_unplanned(object_) for object_ in other.objects]


def _unplanned(item: Object) -> Object:
    annotations = mapping(mapping(item.get("metadata")).get("annotations"))
    kept = {key: value for key, value in annotations.items() if key != PLAN_ANNOTATION}
    return {**_bare(item), "annotations": kept}


def _bare(item: Object) -> Object:
    metadata = {key: value for key, value in mapping(item.get("metadata")).items() if key != "annotations"}
    return {**item, "metadata": metadata}


def identity_problems(metadata: Mapping[str, Any], entry: Mapping[str, Any]) -> Iterator[str]:
    """Differences of name and version between Chart.yaml and the catalogue entry."""
    pairs = (
        ("name", metadata.get("name"), "metadata.name", mapping(entry.get("metadata")).get("name")),
        ("version", metadata.get("version"), "spec.version", mapping(entry.get("spec")).get("version")),
    )
    for key, own, entry_key, declared in pairs:
        if own != declared:
            yield f"Chart.yaml has {key} {own}, the entry has {entry_key} {declared}"


def image_problems(packed: Iterable[str], entry: Mapping[str, Any]) -> Iterator[str]:
    """The difference between the names in images.yaml and the entry's `spec.images`."""
    here = sorted(packed)
    declared = sorted(map(str, mapping(entry.get("spec")).get("images") or ()))
    if here != declared:
        yield f"the chart was packed with the images {here}, the entry has spec.images {declared}"


def resource_problems(rendering: Rendering, entry: Mapping[str, Any]) -> Iterator[str]:
    """Differences between the requests of one pod and the entry's `spec.resources`, by which releases are placed."""
    declared = mapping(mapping(entry.get("spec")).get("resources"))
    for name in ("cpu", "memory"):
        requested = [_request(pod.spec, name) for pod in rendering.pods]
        total = sum((amount for amount in requested if amount is not None), Decimal(0))
        given = quantity(declared.get(name))
        if given is None or given != total or None in requested:
            here = f"the pod requests {written(total, name)} of {name}"
            yield f"{here}, the entry has spec.resources.{name} {declared.get(name)}"


def unanswered_probes(renderings: Sequence[Rendering], entry: Mapping[str, Any]) -> Iterator[str]:
    """A sentence for each container in the entry's `spec.success.probesOf` that no pod has, or without a readiness
    probe: nobody would ask it."""
    named = mapping(mapping(entry.get("spec")).get("success")).get("probesOf") or ()
    for rendering in renderings:
        containers = [one for pod in rendering.pods for one in items(pod.spec.get("containers"))]
        probed = [str(container.get("name")) for container in containers if container.get("readinessProbe")]
        for name in named:
            if name not in probed:
                has = ", ".join(probed) or "none"
                yield f"spec.success.probesOf: no container {name} with a readiness probe (those with one: {has})"


def _request(spec: Mapping[str, Any], name: str) -> Decimal | None:
    """What the scheduler counts: the sum of the containers, or the largest init container."""

    def of(kind: str) -> list[Decimal | None]:
        values = [
            mapping(mapping(container.get("resources")).get("requests")).get(name)
            for container in items(spec.get(kind))
        ]
        return [quantity(value) for value in values]

    running, starting = of("containers"), of("initContainers")
    if None in running or None in starting:
        return None
    return max(sum(filter(None, running), Decimal(0)), *filter(None, starting), Decimal(0))
