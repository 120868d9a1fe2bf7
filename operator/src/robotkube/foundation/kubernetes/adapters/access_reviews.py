"""Access reviews: what the API server says that the account of the kubeconfig may do. Nothing is stored by them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from robotkube.foundation.documents.core.json_codec import read_json_shortened
from robotkube.foundation.kubernetes.core.access_rights import ApiRight

ApiCall = Callable[..., Any]
API = "authorization.k8s.io/v1"
ACCESS = f"/apis/{API}/selfsubjectaccessreviews"
RULES = f"/apis/{API}/selfsubjectrulesreviews"


def may(call: ApiCall, right: ApiRight) -> bool:
    """Return whether the account has the right."""
    status = _ask(call, ACCESS, "SelfSubjectAccessReview", {"resourceAttributes": right.attributes})
    return status.get("allowed") is True


def rules_in(call: ApiCall, namespace: str) -> tuple[Sequence[Mapping[str, Any]], bool]:
    """The rules that the account has in a namespace, which need not be there, and whether these are all."""
    status = _ask(call, RULES, "SelfSubjectRulesReview", {"namespace": namespace})
    return status.get("resourceRules") or (), not status.get("incomplete")


def _ask(call: ApiCall, path: str, kind: str, spec: Mapping[str, Any]) -> Mapping[str, Any]:
    body = {"apiVersion": API, "kind": kind, "spec": spec}
    return read_json_shortened(call("POST", path, (), body).data).get("status") or {}
