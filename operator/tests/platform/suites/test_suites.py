"""Suites on the cluster: the install suite and suites of a user's own, on the platform's charts and on wrong ones; what
the runner, and what runs in its test namespaces, can do and cannot. The interface suite: test_interface.py."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from kubernetes import client, config

from ci import publish
from ci.folders import PROJECT
from ci.machine import network_policies
from robotkube.registry.charts.adapters.chart_folders import pack
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.evidence.core.statements import Artefact, SuiteResult
from robotkube.registry.evidence.core.verification_policy import SuiteRule
from robotkube.registry.suites.core.requests import Replaced, SuiteRequest
from tests.stages.platform import suite_namespaces
from tests.stages.platform.running_platform import Platform
from tests.stages.registry.wrong_charts import wrong_chart

RUNNER = "system:serviceaccount:robotkube:suite-runner"
BRIDGE, DETECTOR = "mqtt-bridge", "event-detector"
PAGE = PROJECT / "docs" / "how-to" / "write-a-suite.md"
EXAMPLE = re.compile(r"^```python short_grace\.py\n(.*?)^```$", re.MULTILINE | re.DOTALL)
VERDICT_SECONDS_MAX = 600.0
INSTALL = SuiteRule("install", "3", 240)  # without a soak, which each publication on this platform has
SHORT_INSTALL = SuiteRule("install", "3", 75)  # a chart that never gets ready takes 60 % of it
VERIFIED = "verified"
CHANGED = "takes-changed-settings"
CHECKS = {
    *("installs", "becomes-ready", CHANGED),
    *("stops-within-its-grace", "leaves-nothing-behind", "upgrades"),
}

# Runs in a test namespace and tries what nothing there may do. Prints one check per attempt.
BURGLAR = """
import json, os, pathlib, sys, urllib.error, urllib.request
from concurrent.futures import ThreadPoolExecutor

FORGE, RUNNER, CUT_OFF = sys.argv[1], sys.argv[2], sys.argv[3] == "on"
API = f"https://{os.environ['KUBERNETES_SERVICE_HOST']}"
checks = []

def attempt(name, held, found=""):
    checks.append({"name": name, "passed": bool(held), "found": str(found)[:200], "fix": "close this hole"})

def status(url, method="GET"):
    import ssl
    context = ssl._create_unverified_context()
    try:
        request = urllib.request.Request(url, data=b"{}" if method == "PUT" else None, method=method)
        with urllib.request.urlopen(request, timeout=3 if CUT_OFF else 10, context=context) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        return error.code
    except OSError as error:
        return f"{type(error).__name__}: {error}"

def readable(path):
    try:
        return [str(place) for place in pathlib.Path(path).rglob("*") if place.is_file() and place.read_bytes()]
    except OSError:
        return []

names = {"username", "password", "host", "port", "tls", "server_name", "ca.crt"}
secrets = [path for path in readable("/var/run/secrets") if ".." not in path]
attempt("token", not [path for path in secrets if "token" in path], secrets)
attempt("key", not [path for path in secrets if pathlib.Path(path).name not in names], secrets)
attempt("environment", not [name for name in os.environ if "TOKEN" in name or "PASSWORD" in name])
urls = {
    "deployment-repository": f"{FORGE}/robotkube/deployment.git/info/refs?service=git-upload-pack",
    "catalogue-repository": f"{FORGE}/api/v1/repos/robotkube/catalogue",
    "registry-staging": f"{FORGE}/v2/staging/mqtt-bridge/tags/list",
    "registry-verified": f"{FORGE}/v2/verified/mqtt-bridge/tags/list",
    "secrets": f"{API}/api/v1/namespaces/robotkube-gate/secrets/gate-key",
    "own-secrets": f"{API}/api/v1/namespaces/robotkube-suite-0/secrets",
    "pods": f"{API}/api/v1/namespaces/robotkube-suite-0/pods",
}
with ThreadPoolExecutor() as pool:  # each may have to time out
    run = pool.submit(status, f"{RUNNER}/runs/" + "0" * 32, "PUT")
    answers = list(pool.map(status, urls.values()))
for (name, url), found in zip(urls.items(), answers):
    attempt(f"no {name}", "timed out" in str(found) if CUT_OFF else found in (401, 403, 404), f"{url}: {found}")
found = run.result()
attempt("no runs without the token", "timed out" in str(found) if CUT_OFF else found == 401, found)
for name, path in {"no settings": "/etc/planted", "no disk": "/planted"}.items():
    try:
        pathlib.Path(path).write_text("x")
        attempt(name, False, path)
    except OSError:
        attempt(name, True)
attempt("not root", os.getuid() != 0, os.getuid())
print(json.dumps({"checks": checks}))
"""


def own(chart: str, place: str = "apps") -> tuple[Path, Path]:
    """A chart of the platform and its entry; those of `earlier` are the versions 0.1.2."""
    version = "0.2.3" if place == "apps" else "0.1.2"
    return PROJECT / "charts" / place / chart, PROJECT / "registry" / "charts" / chart / f"{version}.yaml"


def custom(name: str, script: str, installs: bool = False) -> SuiteRule:
    """A suite of a user's own: the script in an image that the cluster has."""
    return SuiteRule(name, "1", 120, suite_namespaces.images()["ros"], ("python3", "-c", script), installs)


def burglar(platform: Platform) -> SuiteRule:
    """It knows the addresses, there being no names in a test namespace where network policies are enforced. Nothing
    answers it there; where they are not, everybody does, and refuses."""
    rule = custom("burglar", BURGLAR, installs=True)
    urls = [platform.access.endpoint(name).url for name in ("forge", "suite-runner")]
    return replace(rule, command=(*rule.command, *urls, network_policies.choice()))


def earlier(platform: Platform, chart: str) -> Replaced:
    """The version that the chart replaces, put where published charts are, as the gate does it."""
    folder, entry = own(chart, "earlier")
    document = yaml.safe_load(entry.read_text(encoding="utf-8"))
    forge = publish.find_forge(platform.installer.kubeconfig)
    with OciRegistry(forge.url, "gate", platform.password("gate")) as registry:
        digest = registry.push_chart(VERIFIED, pack(folder, suite_namespaces.images(), document["spec"]))
    return Replaced(Artefact(chart, "0.1.2", digest, "linux/amd64"), f"{VERIFIED}/{chart}", document)


def short_grace() -> str:
    """The suite of the how-to."""
    [example] = EXAMPLE.findall(PAGE.read_text(encoding="utf-8"))
    return str(example)


def upgrade(platform: Platform, chart: str) -> SuiteRequest:
    return suite_namespaces.request(platform, *own(chart), INSTALL, replaced=earlier(platform, chart))


@pytest.fixture(scope="module")
def results(platform: Platform, tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, SuiteResult]:
    """Runs that only a cluster can judge, asked for at once, and such whose verdicts tests of the suites in memory
    show, too."""
    images = suite_namespaces.images()
    stubborn = wrong_chart("ignores-sigterm", tmp_path_factory.mktemp("ignores-sigterm"))
    unready = wrong_chart("never-ready", tmp_path_factory.mktemp("never-ready"))
    asked: dict[str, SuiteRequest] = {
        f"upgrade {BRIDGE}": upgrade(platform, BRIDGE),
        f"upgrade {DETECTOR}": upgrade(platform, DETECTOR),
        "example": suite_namespaces.request(platform, *own(BRIDGE), custom("short-grace", short_grace())),
        "example-failed": suite_namespaces.request(platform, *own(DETECTOR), custom("short-grace", short_grace())),
        "ignores-sigterm": suite_namespaces.request(platform, *stubborn, INSTALL),
        "silent": suite_namespaces.request(platform, *own(BRIDGE), custom("silent", "print('nothing to say')")),
        "hanging": suite_namespaces.request(
            platform, *own(BRIDGE), SuiteRule("hanging", "1", 12, images["ros"], ("sleep", "600"))
        ),
        "never-ready": suite_namespaces.request(platform, *unready, SHORT_INSTALL),
    }
    return suite_namespaces.results(platform, asked, VERDICT_SECONDS_MAX)


def upgraded(result: SuiteResult, changed_to: str) -> None:
    assert (result.outcome, suite_namespaces.said(result)) == ("passed", "")
    assert {check.name for check in result.checks} == CHECKS
    words = {check.name: check.found for check in result.checks}
    assert words["upgrades"] == "from 0.1.2"
    assert words[CHANGED].startswith(f"it opened the topics of {changed_to}, and its pod stayed; shown to be at work: ")


@pytest.mark.thorough
def test_a_chart_of_the_platform_passes_and_upgrades(results: Mapping[str, SuiteResult]) -> None:
    upgraded(results[f"upgrade {BRIDGE}"], "cloud")


@pytest.mark.thorough
def test_another_chart_of_the_platform_passes_and_upgrades(results: Mapping[str, SuiteResult]) -> None:
    upgraded(results[f"upgrade {DETECTOR}"], "patterns")


@pytest.mark.thorough
def test_a_chart_that_never_gets_ready(results: Mapping[str, SuiteResult]) -> None:
    result = results["never-ready"]
    assert result.outcome == "failed", suite_namespaces.said(result)
    [check] = result.failed
    assert check.name == "becomes-ready"
    for words in ("Deployment never-ready was not ready after 4", "runs but is not ready", "event Unhealthy"):
        assert words in check.found
    assert "readiness probe" in check.fix


@pytest.mark.thorough
def test_a_chart_that_ignores_sigterm(results: Mapping[str, SuiteResult]) -> None:
    result = results["ignores-sigterm"]
    assert result.outcome == "failed", suite_namespaces.said(result)
    [check] = result.failed
    assert check.name == "stops-within-its-grace"
    assert re.search(r"container ignores-sigterm did not end on SIGTERM within \d+ s and was killed", check.found)
    assert "handle SIGTERM" in check.fix


@pytest.mark.thorough
def test_the_example_of_the_how_to_judges(results: Mapping[str, SuiteResult]) -> None:
    assert results["example"].outcome == "passed", suite_namespaces.said(results["example"])
    [check] = results["example"].checks
    assert (check.name, check.found) == ("short-grace", "terminationGracePeriodSeconds is 3")


@pytest.mark.thorough
def test_the_example_of_the_how_to_refuses(results: Mapping[str, SuiteResult]) -> None:
    assert results["example-failed"].outcome == "failed"
    assert "terminationGracePeriodSeconds is 10" in suite_namespaces.said(results["example-failed"])


@pytest.mark.thorough
def test_suites_without_a_result_are_unfinished(results: Mapping[str, SuiteResult]) -> None:
    assert results["silent"].outcome == results["hanging"].outcome == "unfinished"
    assert "no JSON object" in suite_namespaces.said(results["silent"])
    assert "nothing to say" in suite_namespaces.said(results["silent"])
    assert "did not end in its time" in suite_namespaces.said(results["hanging"])


def test_what_runs_in_a_test_namespace_reads_neither_token_nor_key_nor_forge(platform: Platform) -> None:
    asked = suite_namespaces.request(platform, *own(BRIDGE), burglar(platform))
    [result] = suite_namespaces.results(platform, {"burglar": asked}, VERDICT_SECONDS_MAX).values()
    assert (result.outcome, suite_namespaces.said(result)) == ("passed", "")
    assert len(result.checks) == 14
    suite_namespaces.await_empty(platform)


@pytest.mark.thorough
def test_the_test_namespaces_are_empty_afterwards(platform: Platform, results: Mapping[str, SuiteResult]) -> None:
    assert results
    suite_namespaces.await_empty(platform)


@pytest.fixture
def reviews(platform: Platform) -> Iterator[client.AuthorizationV1Api]:
    """The question behind `kubectl auth can-i`, asked often over one connection."""
    connection = config.new_client_from_config(str(platform.installer.kubeconfig))
    yield client.AuthorizationV1Api(connection)
    connection.close()


RESOURCES = (
    ("", "pods", ""), ("", "pods", "log"), ("", "pods", "exec"), ("", "configmaps", ""), ("", "secrets", ""),
    ("", "services", ""), ("", "serviceaccounts", "token"), ("", "persistentvolumeclaims", ""), ("", "namespaces", ""),
    ("apps", "deployments", ""), ("apps", "statefulsets", ""), ("apps", "daemonsets", ""), ("batch", "jobs", ""),
    ("rbac.authorization.k8s.io", "roles", ""), ("rbac.authorization.k8s.io", "rolebindings", ""),
    ("rbac.authorization.k8s.io", "clusterroles", ""), ("argoproj.io", "applications", ""),
    ("robotkube.io", "taskdescriptions", ""),
)  # fmt: skip
VERBS = ("create", "get", "list", "watch", "update", "patch", "delete", "deletecollection", "bind", "escalate")
IN_A_TEST_NAMESPACE = {
    "pods/": {"create", "get", "list", "watch", "delete"},
    "pods/log": {"get"},
    "configmaps/": {"create", "get", "list", "watch", "patch", "delete"},
    "deployments/": {"create", "get", "list", "watch", "patch", "delete"},
    "secrets/": {"create", "delete"},
}


def allowed(reviews: client.AuthorizationV1Api, namespace: str) -> dict[str, set[str]]:
    """Resource/subresource -> verbs that the runner may use on it in a namespace (empty: everywhere)."""
    verbs: dict[str, set[str]] = {}
    for group, resource, subresource in RESOURCES:
        for verb in VERBS:
            attributes = client.V1ResourceAttributes(
                group=group, resource=resource, subresource=subresource, verb=verb, namespace=namespace
            )
            groups = ["system:serviceaccounts", "system:serviceaccounts:robotkube", "system:authenticated"]
            spec = client.V1SubjectAccessReviewSpec(user=RUNNER, groups=groups, resource_attributes=attributes)
            if reviews.create_subject_access_review(client.V1SubjectAccessReview(spec=spec)).status.allowed:
                verbs.setdefault(f"{resource}/{subresource}", set()).add(verb)
    return verbs


@pytest.mark.thorough
def test_the_runner_may_do_what_its_test_namespaces_need_and_nothing_elsewhere(
    platform: Platform, reviews: client.AuthorizationV1Api
) -> None:
    pool = suite_namespaces.pool(platform)
    assert [allowed(reviews, namespace) for namespace in pool] == [IN_A_TEST_NAMESPACE] * len(pool)
    others = ["", "robotkube", "robotkube-gate", "argocd", "default", "kube-system", *platform.agents[:2]]
    assert {namespace: allowed(reviews, namespace) for namespace in others} == {name: {} for name in others}


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("question", "expected"),
    [
        ("create pods -n robotkube-suite-0", "yes"),
        ("get secrets -n robotkube-suite-0", "no"),
        ("create pods -n robotkube", "no"),
        ("get secrets/gate-key -n robotkube-gate", "no"),
        ("create deployments.apps -n cloud-0", "no"),
        ("create namespaces", "no"),
    ],
)
def test_kubectl_says_the_same(platform: Platform, question: str, expected: str) -> None:
    program = [str(platform.installer.binaries / "kubectl"), "--kubeconfig", str(platform.installer.kubeconfig)]
    done = subprocess.run(
        [*program, "auth", "can-i", *question.split(), "--as", RUNNER],
        capture_output=True, text=True, timeout=30, check=False,
    )  # fmt: skip
    assert (done.stdout.strip(), done.returncode) == (expected, 0 if expected == "yes" else 1), done.stderr


def test_no_account_of_a_test_namespace_may_do_more_than_read_configuration(platform: Platform) -> None:
    for namespace in suite_namespaces.pool(platform):
        for account in platform.get("-n", namespace, "serviceaccounts")["items"]:
            if account["metadata"]["name"] != "default":
                assert account.get("automountServiceAccountToken") is False, account["metadata"]["name"]
        for binding in platform.get("-n", namespace, "rolebindings")["items"]:
            names = {subject["name"] for subject in binding["subjects"]}
            role = platform.get("-n", namespace, f"role/{binding['roleRef']['name']}")
            if names != {"suite-runner"}:
                assert role["rules"] == [
                    {"apiGroups": [""], "resources": ["configmaps"], "verbs": ["get", "list", "watch"]}
                ], json.dumps(role)
