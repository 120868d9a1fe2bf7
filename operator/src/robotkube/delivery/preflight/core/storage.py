"""StorageClasses and volume claims: whether what the chart claims can be given by the cluster."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.preflight.core.findings import CheckVerdict, Problem, named
from robotkube.delivery.preflight.core.renderings import Object, RenderedChart, annotations_of, metadata_of, name_of
from robotkube.foundation.documents.core.quantities import quantity
from robotkube.registry.suites.core.pod_security import items, mapping

DEFAULT = "storageclass.kubernetes.io/is-default-class"
BY_HAND = "kubernetes.io/no-provisioner"
ONE_NODE = "ReadWriteOnce"
KEYS = "storage.className"
WHY_NO_CLASS = "its pod waits forever for a volume that nobody makes"


@dataclass(frozen=True)
class Storage:
    """StorageClasses, volume claims and volumes of the cluster."""

    classes: Sequence[Object]
    claims: Sequence[Object]
    volumes: Sequence[Object]


@dataclass(frozen=True)
class VolumeClaim:
    """One volume claim of the chart; an empty class is the default one."""

    namespace: str
    name: str
    class_name: str
    modes: frozenset[str]
    size: str

    @property
    def place(self) -> str:
        """It, in words."""
        return f"volume claim {self.namespace}/{self.name}"


def storage(rendering: RenderedChart, present: Storage) -> CheckVerdict:
    """Each volume claim has a class that is there, and what stands under its name is the same."""
    claims = list(_volume_claims(rendering))
    default = next((name_of(one) for one in present.classes if annotations_of(one).get(DEFAULT) == "true"), "")
    classes = {name_of(one): one for one in present.classes}
    standing = {(metadata_of(one).get("namespace"), name_of(one)): one for one in present.claims}
    problems: list[Problem] = []
    unseen = set()
    for claim in claims:
        known = standing.get((claim.namespace, claim.name))
        if known is not None:
            problems += _differences(claim, mapping(known.get("spec")))
            continue
        chosen = claim.class_name or default
        if chosen not in classes:
            problems.append(_no_class(claim, sorted(classes)))
        elif classes[chosen].get("provisioner") == BY_HAND:
            problems += [] if _fitting(claim, chosen, present.volumes) else [_no_volume(claim, chosen)]
        elif claim.modes != {ONE_NODE}:
            unseen.add(f"no API says whether class {chosen} gives {', '.join(sorted(claim.modes))}")
    there = sum((claim.namespace, claim.name) in standing for claim in claims)
    says = f"{len(claims)} volume claims, {there} there already; default class: {default or 'none'}"
    return CheckVerdict(says, problems, "; ".join(sorted(unseen)))


def _volume_claims(rendering: RenderedChart) -> Iterator[VolumeClaim]:
    for item in rendering.of_kind("PersistentVolumeClaim"):
        yield _volume_claim(item, rendering.namespace_of(item), name_of(item))
    for item in rendering.of_kind("StatefulSet"):
        for template in items(mapping(item.get("spec")).get("volumeClaimTemplates")):
            yield _volume_claim(template, rendering.namespace_of(item), f"{name_of(template)}-{name_of(item)}-0")


def _volume_claim(item: Object, namespace: str, name: str) -> VolumeClaim:
    spec = mapping(item.get("spec"))
    size = mapping(mapping(spec.get("resources")).get("requests")).get("storage", "")
    modes = frozenset(map(str, spec.get("accessModes") or ()))
    return VolumeClaim(namespace, name, str(spec.get("storageClassName") or ""), modes, str(size))


def _no_class(claim: VolumeClaim, classes: Sequence[str]) -> Problem:
    what = f"there is no StorageClass {claim.class_name}" if claim.class_name else "there is no default StorageClass"
    there = (
        f"name one of {named(classes)} in {KEYS}" if classes else f"install a provisioner, and name its class in {KEYS}"
    )
    mark = f"kubectl annotate storageclass NAME {DEFAULT}=true"
    return Problem(what, claim.place, WHY_NO_CLASS, there if claim.class_name else f"{there}, or {mark}")


def _no_volume(claim: VolumeClaim, chosen: str) -> Problem:
    modes = ", ".join(sorted(claim.modes))
    what = f"class {chosen} makes no volumes, and none is Available with {claim.size} and {modes}"
    return Problem(what, claim.place, WHY_NO_CLASS, f"make such a PersistentVolume, or name another class in {KEYS}")


def _fitting(claim: VolumeClaim, chosen: str, volumes: Sequence[Object]) -> bool:
    size = quantity(claim.size) or 0
    for volume in volumes:
        spec = mapping(volume.get("spec"))
        phase = mapping(volume.get("status")).get("phase")
        holds = quantity(mapping(spec.get("capacity")).get("storage")) or 0
        modes = set(spec.get("accessModes") or ())
        if phase == "Available" and spec.get("storageClassName") == chosen and holds >= size and claim.modes <= modes:
            return True
    return False


def _differences(claim: VolumeClaim, spec: Mapping[str, Any]) -> Iterator[Problem]:
    """What differs of a claim that is there: Kubernetes changes neither its class nor its access modes."""
    stated = {"accessModes": (sorted(claim.modes), sorted(map(str, spec.get("accessModes") or ())))}
    if claim.class_name:
        stated["storageClassName"] = ([claim.class_name], [str(spec.get("storageClassName") or "")])
    for key, (wanted, present) in stated.items():
        if wanted != present:
            what = f"{key} is {', '.join(present) or 'empty'}, the chart wants {', '.join(wanted)}"
            why = "a volume claim cannot be changed in this, so Helm's upgrade is refused"
            yield Problem(what, claim.place, why, f"keep {KEYS} as it was, or move the data and delete the claim")
