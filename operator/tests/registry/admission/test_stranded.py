"""What admission would refuse of what runs: said before it is enforced."""

from __future__ import annotations

from typing import Any

import pytest

from robotkube.registry.admission.core.stranded import stranded
from tests.stages.registry.admission_examples import (
    ALLOWED,
    DOMAIN,
    OF_THE_PLATFORM,
    STRANGE,
    VERIFIED,
    application,
    digest,
    pod,
    workload,
)

OWNED = [{"kind": "ReplicaSet", "name": "a", "uid": "1", "apiVersion": "apps/v1", "controller": True}]


def there(made: dict[str, Any], namespace: str, **metadata: Any) -> dict[str, Any]:
    return {**made, "metadata": {**made["metadata"], "namespace": namespace, **metadata}}


def test_what_has_evidence_is_not_named() -> None:
    running = [
        there(pod(), "vehicle-00", ownerReferences=OWNED),
        there(workload("Deployment"), "vehicle-00"),
        there(workload("Deployment", OF_THE_PLATFORM), "robotkube"),
        there(pod(STRANGE), "robotkube-suite-0"),
        there(pod(VERIFIED), "default"),
        application(),
    ]
    assert stranded(running, DOMAIN, ALLOWED) == ()


@pytest.mark.parametrize(
    ("made", "sentence"),
    [
        (there(workload("CronJob", STRANGE), "vehicle-00"),
         f"vehicle-00/cronjob/detector: image {STRANGE} is not listed for this namespace"),
        (there(workload("Deployment", OF_THE_PLATFORM), "cloud-0"),
         f"cloud-0/deployment/detector: image {OF_THE_PLATFORM} is not listed for this namespace"),
        (there(workload("Deployment", VERIFIED), "argocd"),
         f"argocd/deployment/detector: image {VERIFIED} is not listed for this namespace"),
        (there(pod("ros:1.0"), "robotkube-suite-0"),
         "robotkube-suite-0/pod/pod: image ros:1.0 is not listed for this namespace"),
        (there(pod(STRANGE), "default"), f"default/pod/pod: image {STRANGE} is not listed for this namespace"),
        (there(pod(), "vehicle-00"), "vehicle-00/pod/pod: no controller made this pod"),
        (application(source={"repoURL": DOMAIN.charts + "/event-detector", "targetRevision": digest(8)}),
         f"argocd/application/vehicle-00-detector: chart {DOMAIN.charts}/event-detector at {digest(8)} is not "
         "verified on the catalogue's main"),
        (application(destination={"namespace": "robotkube"}),
         "argocd/application/vehicle-00-detector: namespace robotkube is no agent's"),
    ],
)  # fmt: skip
def test_everything_else_is_named_with_the_reason(made: dict[str, Any], sentence: str) -> None:
    assert [str(one) for one in stranded([made], DOMAIN, ALLOWED)] == [sentence]


def test_earlier_revisions_of_a_deployment_run_nothing() -> None:
    earlier = there(workload("ReplicaSet", STRANGE), "vehicle-00")
    earlier["spec"]["replicas"] = 0
    assert stranded([earlier], DOMAIN, ALLOWED) == ()
