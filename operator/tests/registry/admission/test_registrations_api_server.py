"""What a real API server under the policies from files lets anybody register that changes or refuses requests."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from robotkube.registry.admission.core.policies import for_files
from tests.stages.attacks import shown
from tests.stages.kubernetes.judged_api_server import MERGE, Api, judged_api_server
from tests.stages.registry.admission_examples import ALLOWED, DOMAIN
from tests.stages.waiting import until

pytestmark = [pytest.mark.toolchain]
GROUP = "/apis/admissionregistration.k8s.io/v1"
SERVERS = "/apis/apiregistration.k8s.io/v1/apiservices"
DEFINITIONS = "/apis/apiextensions.k8s.io/v1/customresourcedefinitions"
CONTROLLER = "system:serviceaccount:kube-system:deployment-controller"
RULE = {"apiGroups": [""], "apiVersions": ["*"], "operations": ["CREATE"], "resources": ["pods"]}
HOOK = {
    "name": "a.example.org",
    "sideEffects": "None",
    "admissionReviewVersions": ["v1"],
    "clientConfig": {"url": "https://127.0.0.1/x"},
    "rules": [RULE],
}
MUTATION = {"patchType": "ApplyConfiguration", "applyConfiguration": {"expression": "Object{}"}}
MATCH = {"resourceRules": [RULE]}
BODIES: dict[str, dict[str, Any]] = {
    "mutatingadmissionpolicies": {
        "spec": {"matchConstraints": MATCH, "mutations": [MUTATION], "reinvocationPolicy": "Never"}
    },
    "mutatingadmissionpolicybindings": {"spec": {"policyName": "other"}},
    "mutatingwebhookconfigurations": {"webhooks": [HOOK]},
    "validatingadmissionpolicies": {
        "spec": {"matchConstraints": MATCH, "validations": [{"expression": "false"}]},
    },
    "validatingadmissionpolicybindings": {"spec": {"policyName": "other", "validationActions": ["Deny"]}},
    "validatingwebhookconfigurations": {"webhooks": [HOOK]},
}


@pytest.fixture(scope="module")
def api(under_policies: Api) -> Api:
    return under_policies


def body(resource: str) -> dict[str, Any]:
    return copy.deepcopy({"metadata": {"name": "other"}, **BODIES[resource]})


@pytest.mark.parametrize("user", ["", CONTROLLER])
@pytest.mark.parametrize("resource", BODIES)
def test_nobody_has_requests_changed_or_refused_otherwise(api: Api, resource: str, user: str) -> None:
    words = api.refusal("POST", f"{GROUP}/{resource}", body(resource), user)
    assert words.startswith(f"{resource} other written by {user or 'administrator'}: in a cluster of the platform")
    assert words.endswith("To experiment, start a cluster with ROBOTKUBE_ADMISSION=off")
    shown("admission", words, "mutating-policy", "report-refused")


def test_one_that_stood_there_is_not_changed_and_may_go(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Made before the policies were: a file that the API server reads later."""
    one = "mutatingwebhookconfigurations"
    whole = for_files(DOMAIN, ALLOWED)
    before = [item for item in whole if "registrations" not in item["metadata"]["name"]]
    with judged_api_server(tmp_path_factory.mktemp("before"), before) as (api, files):
        api.done("POST", f"{GROUP}/{one}", body(one))
        assert files.write(whole)
        change = {"metadata": {"labels": {"a": "b"}}}
        place = f"{GROUP}/{one}/other"
        until(lambda: api.request("PATCH", f"{place}?dryRun=All", change, kind=MERGE)["kind"] == "Status")
        assert f"{one} other written by administrator" in api.refusal("PATCH", place, change, kind=MERGE)
        api.done("DELETE", place)


def test_no_other_server_answers_for_kinds(api: Api) -> None:
    spec = {
        "group": "robotkube.io",
        "version": "v1alpha1",
        "groupPriorityMinimum": 1,
        "versionPriority": 1,
        "service": {"namespace": "default", "name": "mine"},
    }
    words = api.refusal("POST", SERVERS, {"metadata": {"name": "v1alpha1.robotkube.io"}, "spec": spec})
    assert words.startswith("apiservices v1alpha1.robotkube.io written by administrator")


def test_no_webhook_converts_what_is_read(api: Api) -> None:
    """Definitions themselves are anybody's to bring: Argo CD's, the platform's."""
    name = "applications.argoproj.io"
    hook = {"clientConfig": {"url": "https://127.0.0.1/x"}, "conversionReviewVersions": ["v1"]}
    change = {"spec": {"conversion": {"strategy": "Webhook", "webhook": hook}}}
    words = api.refusal("PATCH", f"{DEFINITIONS}/{name}", change, kind=MERGE)
    assert words.startswith(f"customresourcedefinitions {name} written by administrator")
    api.done("PATCH", f"{DEFINITIONS}/{name}", {"metadata": {"labels": {"a": "b"}}}, kind=MERGE)


def test_the_api_server_registers_kinds_by_itself(api: Api) -> None:
    """Which the Applications of the definitions above show: it writes APIServices of its own, at every start too."""
    names = {item["metadata"]["name"] for item in api.done("GET", SERVERS)["items"]}
    assert {"v1alpha1.argoproj.io", "v1.apps"} <= names
