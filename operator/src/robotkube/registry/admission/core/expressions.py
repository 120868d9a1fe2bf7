"""Expressions (CEL) that several policies share: the pod in whatever object, its images, what an update adds."""

from __future__ import annotations

from robotkube.registry.admission.core.lists import Variable, texts

# Where the pod stands in each kind: a pod itself, a template, or a template in the template of a job.
POD_OF = (
    "request.resource.resource == 'pods' ? {0}.spec : "
    "request.resource.resource == 'podtemplates' ? {0}.template.spec : "
    "request.resource.resource == 'cronjobs' ? {0}.spec.jobTemplate.spec.template.spec : {0}.spec.template.spec"
)
LISTS_OF_CONTAINERS = ("containers", "initContainers", "ephemeralContainers")
RESOURCES = (
    ("", ("pods", "pods/ephemeralcontainers", "podtemplates", "replicationcontrollers")),
    ("apps", ("daemonsets", "deployments", "replicasets", "statefulsets")),
    ("batch", ("cronjobs", "jobs")),
)
# What becomes shorter when something is taken away from a container, entry by entry; and what limits pods and
# containers, so that it is no addition and still must not be taken away.
PARTS_OF_CONTAINERS = ("env", "envFrom", "ports", "volumeDevices", "volumeMounts")
LISTS_OF_PODS = ("hostAliases", "imagePullSecrets", "tolerations", "topologySpreadConstraints", "volumes")
LIMITS_OF_PODS = ("automountServiceAccountToken", "hostUsers", "runtimeClassName", "securityContext")
LIMITS_OF_CONTAINERS = ("securityContext",)
# As Pod Security has them (restricted). Others are folders, disks and file systems that the machine mounts.
VOLUMES_OF_PODS = (
    "configMap",
    "csi",
    "downwardAPI",
    "emptyDir",
    "ephemeral",
    "image",
    "persistentVolumeClaim",
    "projected",
    "secret",
)
WORDS = ("labels", "annotations")
CREATING = "request.operation == 'CREATE'"
EPHEMERAL = "has(request.subResource) && request.subResource == 'ephemeralcontainers'"
WRITER = "request.userInfo.username"
RESOURCE = "request.resource.resource"


def image_variables() -> list[Variable]:
    """`containers` and `images`, references, of the object; `known`: those of the one before it. What is there already
    may be changed otherwise: a pod that lost its evidence must still be let go."""
    return [
        {"name": "pod", "expression": POD_OF.format("object")},
        {"name": "before", "expression": f"{CREATING} ? {{}} : ({POD_OF.format('oldObject')})"},
        {"name": "containers", "expression": _containers("variables.pod")},
        {"name": "images", "expression": _images("variables.containers", "variables.pod")},
        {"name": "known", "expression": _images(f"({_containers('variables.before')})", "variables.before")},
    ]


def _containers(pod: str) -> str:
    return " + ".join(f"{pod}.?{name}.orValue([])" for name in LISTS_OF_CONTAINERS)


def _images(containers: str, pod: str) -> str:
    """References of a pod's containers of every kind and of its volumes that are images; one that is missing is ''."""
    volumes = f"{pod}.?volumes.orValue([]).filter(v, has(v.image)).map(v, v.image.?reference.orValue(''))"
    return f"{containers}.map(c, c.?image.orValue('')) + {volumes}"


def on_host() -> str:
    """Return whether the pod asks for a way to its machine: its namespaces, its files, its devices."""
    pod = "variables.pod"
    shared = " || ".join(f"{pod}.?{name}.orValue(false)" for name in ("hostPID", "hostIPC", "hostNetwork"))
    context = "c.?securityContext"
    other = f"v.exists(k, k != 'name' && !(k in {texts(VOLUMES_OF_PODS)}))"
    return (
        f"{shared} || {pod}.?volumes.orValue([]).exists(v, {other}) || variables.containers.exists(c, "
        f"{context}.?privileged.orValue(false) || {context}.?procMount.orValue('Default') != 'Default' || "
        f"{context}.?capabilities.?add.orValue([]).exists(a, a != 'NET_BIND_SERVICE'))"
    )


def changed(parts: tuple[str, ...]) -> str:
    """Return whether an update changes one of these parts (`spec`, `metadata.labels`)."""
    return " || ".join(f"object.{_optional(part)} != oldObject.{_optional(part)}" for part in parts)


def _optional(part: str) -> str:
    return ".".join(f"?{word}" for word in part.split("."))


def only_taken_away() -> str:
    """Return whether an update of a Deployment does nothing but take away what was there: containers, entries of their
    lists and of the pod's, whole fields, labels and annotations. Nothing comes, no value changes, an image least of
    all, and what limits the pod stays."""
    container = " && ".join(
        [
            "c.name == o.name",
            _fewer("c", "o", "n", _fewer_entries(PARTS_OF_CONTAINERS, "c", "o", "n")),
            *(f"c.?{name} == o.?{name}" for name in LIMITS_OF_CONTAINERS),
        ]
    )
    lists = _fewer_entries(LISTS_OF_PODS, "variables.pod", "variables.before", "k")
    each = f"variables.pod[k].all(c, variables.before[k].exists(o, {container}))"
    containers = f"k in {texts(LISTS_OF_CONTAINERS)} && {each}"
    return " && ".join(
        [
            *(_fewer_words(f"metadata.?{name}") for name in WORDS),
            *(_fewer_words(f"spec.template.metadata.?{name}") for name in WORDS),
            _fewer("object.spec", "oldObject.spec", "k", "k == 'template'"),
            _fewer("object.spec.template.metadata", "oldObject.spec.template.metadata", "k", f"k in {texts(WORDS)}"),
            _fewer("variables.pod", "variables.before", "k", f"{lists} || {containers}"),
            *(f"variables.pod.?{name} == variables.before.?{name}" for name in LIMITS_OF_PODS),
        ]
    )


def _fewer(new: str, old: str, key: str, otherwise: str) -> str:
    """Return whether every key of one mapping is one of the other, with the same value or `otherwise`."""
    return f"{new}.all({key}, {key} in {old} && ({new}[{key}] == {old}[{key}] || {otherwise}))"


def _fewer_words(place: str) -> str:
    new, old = (f"{whole}.{place}.orValue({{}})" for whole in ("object", "oldObject"))
    return f"{new}.all(k, k in {old} && {new}[k] == {old}[k])"


def _fewer_entries(names: tuple[str, ...], new: str, old: str, key: str) -> str:
    """Return whether the value of `key` is a list, one of `names`, that has only entries which it had before."""
    return f"{key} in {texts(names)} && {new}[{key}].all(e, e in {old}[{key}])"


def one_of(names: tuple[str, ...]) -> str:
    """Return whether the request's user is one of these."""
    return f"{WRITER} in {texts(names)}"


def sentence(*parts: str) -> str:
    """Texts and expressions in turn, a text first, as one expression: what a refusal says."""
    return " + ".join(part if number % 2 else literal(part) for number, part in enumerate(parts))


def literal(text: str) -> str:
    """The text as an expression."""
    escaped = text.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"
