"""Suites on the cluster: the install suite and suites of a user's own, on the platform's charts and on wrong ones; what
the runner, and what runs in its rooms, can do and cannot. The interface suite: test_suite_interface.py."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
import rooms
import yaml
from kubernetes import client, config
from running_platform import Platform
from wrong_charts import wrong_chart

from ci import publish
from ci.folders import PROJECT
from robotkube.adapters.chart_folders import pack
from robotkube.adapters.oci_registry import Registry
from robotkube.domain.evidence import Artefact, SuiteResult
from robotkube.domain.suite_requests import Replaced, SuiteRequest
from robotkube.domain.verification import SuiteRule

RUNNER = "system:serviceaccount:robotkube:suite-runner"
BRIDGE, DETECTOR = "mqtt-bridge", "event-detector"
PAGE = PROJECT / "docs" / "how-to" / "write-a-suite.md"
EXAMPLE = re.compile(r"^```python short_grace\.py\n(.*?)^```$", re.MULTILINE | re.DOTALL)
VERDICT_SECONDS_MAX = 600.0
INSTALL = SuiteRule("install", "1", 240)
SHORT_INSTALL = SuiteRule("install", "1", 75)  # a chart that never gets ready takes 60 % of it
VERIFIED = "verified"
CHECKS = {"installs", "becomes-ready", "stops-within-its-grace", "leaves-nothing-behind", "upgrades"}

# Runs in a room and tries what nothing there may do. Prints one check per attempt.
BURGLAR = """
import json, os, pathlib, urllib.error, urllib.request

FORGE = "http://forge.robotkube.svc.cluster.local:3000"
RUNNER = "http://suite-runner.robotkube.svc.cluster.local:8080"
API = "https://kubernetes.default.svc"
checks = []

def attempt(name, held, found=""):
    checks.append({"name": name, "passed": bool(held), "found": str(found)[:200], "fix": "close this hole"})

def status(url, method="GET"):
    import ssl
    context = ssl._create_unverified_context()
    try:
        request = urllib.request.Request(url, data=b"{}" if method == "PUT" else None, method=method)
        with urllib.request.urlopen(request, timeout=10, context=context) as answer:
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

names = {"username", "password", "host", "port"}
secrets = [path for path in readable("/var/run/secrets") if ".." not in path]
attempt("token", not [path for path in secrets if "token" in path], secrets)
attempt("key", not [path for path in secrets if pathlib.Path(path).name not in names], secrets)
attempt("environment", not [name for name in os.environ if "TOKEN" in name or "PASSWORD" in name])
for name, url in {
    "deployment-repository": f"{FORGE}/robotkube/deployment.git/info/refs?service=git-upload-pack",
    "catalogue-repository": f"{FORGE}/api/v1/repos/robotkube/catalogue",
    "registry-staging": f"{FORGE}/v2/staging/mqtt-bridge/tags/list",
    "registry-verified": f"{FORGE}/v2/verified/mqtt-bridge/tags/list",
    "secrets": f"{API}/api/v1/namespaces/robotkube/secrets/gate-key",
    "own-secrets": f"{API}/api/v1/namespaces/robotkube-suite-0/secrets",
    "pods": f"{API}/api/v1/namespaces/robotkube-suite-0/pods",
}.items():
    found = status(url)
    attempt(f"no {name}", found in (401, 403, 404), f"{url}: {found}")
found = status(f"{RUNNER}/runs/" + "0" * 32, "PUT")
attempt("no runs without the token", found == 401, found)
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
    """A chart of the platform and its entry; those of `earlier` are the versions 0.1.0."""
    version = "0.2.0" if place == "apps" else "0.1.0"
    return PROJECT / "charts" / place / chart, PROJECT / "registry" / "charts" / chart / f"{version}.yaml"


def custom(name: str, script: str, installs: bool = False) -> SuiteRule:
    """A suite of a user's own: the script in an image that the cluster has."""
    return SuiteRule(name, "1", 120, rooms.images()["ros"], ("python3", "-c", script), installs)


def earlier(platform: Platform, chart: str) -> Replaced:
    """The version that the chart replaces, put where published charts are, as the gate does it."""
    folder, entry = own(chart, "earlier")
    document = yaml.safe_load(entry.read_text(encoding="utf-8"))
    forge = publish.find_forge(platform.installer.kubeconfig)
    with Registry(forge.url, "gate", platform.password("gate")) as registry:
        digest = registry.push_chart(VERIFIED, pack(folder, rooms.images(), document["spec"]))
    return Replaced(Artefact(chart, "0.1.0", digest, "linux/amd64"), f"{VERIFIED}/{chart}", document)


@pytest.fixture(scope="module")
def results(platform: Platform, tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, SuiteResult]:
    """All runs of this file, asked for at once."""
    [example] = EXAMPLE.findall(PAGE.read_text(encoding="utf-8"))
    asked: dict[str, SuiteRequest] = {
        **{
            f"upgrade {chart}": rooms.request(platform, *own(chart), INSTALL, replaced=earlier(platform, chart))
            for chart in (BRIDGE, DETECTOR)
        },
        "example": rooms.request(platform, *own(BRIDGE), custom("short-grace", example)),
        "example-failed": rooms.request(platform, *own(DETECTOR), custom("short-grace", example)),
        "burglar": rooms.request(platform, *own(BRIDGE), custom("burglar", BURGLAR, installs=True)),
        "silent": rooms.request(platform, *own(BRIDGE), custom("silent", "print('nothing to say')")),
        "hanging": rooms.request(
            platform, *own(BRIDGE), SuiteRule("hanging", "1", 12, rooms.images()["ros"], ("sleep", "600"))
        ),
    }
    for name, rule in {"never-ready": SHORT_INSTALL, "ignores-sigterm": INSTALL}.items():
        asked[name] = rooms.request(platform, *wrong_chart(name, tmp_path_factory.mktemp(name)), rule)
    return rooms.results(platform, asked, VERDICT_SECONDS_MAX)


@pytest.mark.parametrize("chart", [BRIDGE, DETECTOR])
def test_a_chart_of_the_platform_passes_and_upgrades(results: Mapping[str, SuiteResult], chart: str) -> None:
    result = results[f"upgrade {chart}"]
    assert (result.outcome, rooms.said(result)) == ("passed", "")
    assert {check.name for check in result.checks} == CHECKS
    assert "from 0.1.0" in [check.found for check in result.checks]


def test_a_chart_that_never_gets_ready(results: Mapping[str, SuiteResult]) -> None:
    result = results["never-ready"]
    assert result.outcome == "failed", rooms.said(result)
    [check] = result.failed
    assert check.name == "becomes-ready"
    for words in ("Deployment never-ready was not ready after 4", "runs but is not ready", "event Unhealthy"):
        assert words in check.found
    assert "readiness probe" in check.fix


def test_a_chart_that_ignores_sigterm(results: Mapping[str, SuiteResult]) -> None:
    result = results["ignores-sigterm"]
    assert result.outcome == "failed", rooms.said(result)
    [check] = result.failed
    assert check.name == "stops-within-its-grace"
    assert re.search(r"container ignores-sigterm did not end on SIGTERM within \d+ s and was killed", check.found)
    assert "handle SIGTERM" in check.fix


def test_the_example_of_the_how_to_judges(results: Mapping[str, SuiteResult]) -> None:
    assert results["example"].outcome == "passed", rooms.said(results["example"])
    [check] = results["example"].checks
    assert (check.name, check.found) == ("short-grace", "terminationGracePeriodSeconds is 3")
    assert results["example-failed"].outcome == "failed"
    assert "terminationGracePeriodSeconds is 10" in rooms.said(results["example-failed"])


def test_suites_without_a_result_are_unfinished(results: Mapping[str, SuiteResult]) -> None:
    assert results["silent"].outcome == results["hanging"].outcome == "unfinished"
    assert "no JSON object" in rooms.said(results["silent"])
    assert "nothing to say" in rooms.said(results["silent"])
    assert "did not end in its time" in rooms.said(results["hanging"])


def test_what_runs_in_a_room_reads_neither_token_nor_key_nor_forge(results: Mapping[str, SuiteResult]) -> None:
    result = results["burglar"]
    assert (result.outcome, rooms.said(result)) == ("passed", "")
    assert len(result.checks) == 14


def test_the_rooms_are_empty_afterwards(platform: Platform, results: Mapping[str, SuiteResult]) -> None:
    assert results
    rooms.await_empty(platform)


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
IN_A_ROOM = {
    "pods/": {"create", "get", "list", "watch", "delete"},
    "pods/log": {"get"},
    "configmaps/": {"create", "get", "list", "watch", "patch", "delete"},
    "deployments/": {"create", "get", "list", "watch", "patch", "delete"},
    "secrets/": {"create", "delete"},
}


def allowed(reviews: client.AuthorizationV1Api, namespace: str) -> dict[str, set[str]]:
    """Resource/subresource -> verbs that the runner may use on it in a namespace (empty: everywhere)."""
    found: dict[str, set[str]] = {}
    for group, resource, subresource in RESOURCES:
        for verb in VERBS:
            attributes = client.V1ResourceAttributes(
                group=group, resource=resource, subresource=subresource, verb=verb, namespace=namespace
            )
            groups = ["system:serviceaccounts", "system:serviceaccounts:robotkube", "system:authenticated"]
            spec = client.V1SubjectAccessReviewSpec(user=RUNNER, groups=groups, resource_attributes=attributes)
            if reviews.create_subject_access_review(client.V1SubjectAccessReview(spec=spec)).status.allowed:
                found.setdefault(f"{resource}/{subresource}", set()).add(verb)
    return found


def test_the_runner_may_do_what_its_rooms_need_and_nothing_elsewhere(
    platform: Platform, reviews: client.AuthorizationV1Api
) -> None:
    pool = rooms.pool(platform)
    assert [allowed(reviews, namespace) for namespace in pool] == [IN_A_ROOM] * len(pool)
    others = ["", "robotkube", "argocd", "default", "kube-system", *platform.agents[:2]]
    assert {namespace: allowed(reviews, namespace) for namespace in others} == {name: {} for name in others}


@pytest.mark.parametrize(
    ("question", "expected"),
    [
        ("create pods -n robotkube-suite-0", "yes"),
        ("get secrets -n robotkube-suite-0", "no"),
        ("create pods -n robotkube", "no"),
        ("get secrets/gate-key -n robotkube", "no"),
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


def test_no_account_of_a_room_may_do_more_than_read_configuration(platform: Platform) -> None:
    for room in rooms.pool(platform):
        for account in platform.get("-n", room, "serviceaccounts")["items"]:
            if account["metadata"]["name"] != "default":
                assert account.get("automountServiceAccountToken") is False, account["metadata"]["name"]
        for binding in platform.get("-n", room, "rolebindings")["items"]:
            names = {subject["name"] for subject in binding["subjects"]}
            role = platform.get("-n", room, f"role/{binding['roleRef']['name']}")
            if names != {"suite-runner"}:
                assert role["rules"] == [
                    {"apiGroups": [""], "resources": ["configmaps"], "verbs": ["get", "list", "watch"]}
                ], json.dumps(role)
