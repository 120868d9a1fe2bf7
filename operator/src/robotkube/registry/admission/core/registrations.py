"""Policy for what has the API server change or refuse requests otherwise than it does by itself.

Admission judges what is written in the end, so whoever changes it on the way is not seen: a mutating policy can give a
pod that was verified other commands. One that validates can keep from the cluster what the platform says about it. A
server or a webhook of somebody's own can answer for whole kinds.
"""

from __future__ import annotations

from robotkube.registry.admission.core.documents import Policy, Validation
from robotkube.registry.admission.core.expressions import RESOURCE, WRITER, sentence

ADMISSION = (
    "mutatingadmissionpolicies",
    "mutatingadmissionpolicybindings",
    "mutatingwebhookconfigurations",
    "validatingadmissionpolicies",
    "validatingadmissionpolicybindings",
    "validatingwebhookconfigurations",
)
SERVERS, DEFINITIONS = "apiservices", "customresourcedefinitions"
KINDS = (
    ("admissionregistration.k8s.io", ADMISSION),
    ("apiregistration.k8s.io", (SERVERS,)),
    ("apiextensions.k8s.io", (DEFINITIONS,)),
)


def policy() -> Policy:
    """The policy of a cluster that is all ours: nothing of the platform has such objects, so nobody makes or changes
    one. Only files of the API server can judge policies. What stands there may be deleted."""
    own = f"{RESOURCE} == '{SERVERS}' && !has(object.spec.service)"
    unconverted = f"{RESOURCE} == '{DEFINITIONS}' && object.spec.?conversion.?strategy.orValue('None') == 'None'"
    why = (
        ": in a cluster of the platform alone nobody else changes, refuses or answers requests, since what was "
        "verified would run otherwise, or nobody would see it. To experiment, start a cluster with "
        "ROBOTKUBE_ADMISSION=off"
    )
    says = sentence("", RESOURCE, " ", "object.metadata.name", " written by ", WRITER, why)
    return Policy("robotkube-registrations", KINDS, None, [], [Validation(f"{own} || {unconverted}", says)])
