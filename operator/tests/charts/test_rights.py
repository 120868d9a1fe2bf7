"""What every service account may do, as the API server says it: exactly this, and nothing else."""

from __future__ import annotations

import functools
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml
from kubernetes import client

from robotkube.delivery.console.adapters.peoples_tasks import ImpersonatedTasks
from robotkube.delivery.console.core.asking import read_request
from robotkube.delivery.console.core.signing_in import Person
from robotkube.delivery.tasks.adapters.kubernetes_tasks import KubernetesTasks
from robotkube.errors import InputError, RefusalError
from robotkube.foundation.documents.core.yaml_codec import write_mapping
from robotkube.foundation.kubernetes.adapters.client import api_client, call
from robotkube.registry.admission.core.policies import API_POLICIES
from tests.stages.attacks import shown
from tests.stages.detector.process import COMMAND, is_up, read
from tests.stages.detector.proximity_settings import SETTINGS as DETECTOR
from tests.stages.kubernetes.installed_chart import CHART, Cluster, prepared_cluster
from tests.stages.programs import free_port, program
from tests.stages.ros.ros_domains import domain as ros_domain
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain  # a server of its own
PROFILES = Path(__file__).parent / "profiles"
INSTALLED = ("official", "managers", "admission", "forge-sign-in", "writers")
Rights = dict[str, str]

READ = "get list watch"
WATCHED = "list watch"
RULES_OF_DETECTORS = {"configmaps": "get"}
WRITERS = "robotkube:console:robotkube:operators"
IN_THE_NAME_OF_PEOPLE = {
    "users robotkube:console": "impersonate",
    f"groups {WRITERS}": "impersonate",
    "userextras/robotkube.io/person.authentication.k8s.io": "impersonate",
}
TASKS, STATUS = "taskdescriptions.robotkube.io", "taskdescriptions/status.robotkube.io"
EVENTS, LEASES = "events.events.k8s.io", "leases.coordination.k8s.io"
GROUP = "robotkube.io"
INSPECTIONS = f"inspections.{GROUP}"
NODES = {"nodes": READ}
LOOKED_AT = dict.fromkeys(
    [
        *(f"{kind}.apps" for kind in ("daemonsets", "deployments", "replicasets", "statefulsets")),
        *(f"{kind}.batch" for kind in ("cronjobs", "jobs")),
        *("configmaps", "podtemplates", "replicationcontrollers"),
    ],
    "list",
)
ANSWERS = {TASKS: "create delete get list patch watch", STATUS: "patch update", EVENTS: "create", "pods": READ}
APPLICATIONS = {"applications.argoproj.io": READ}
SETTINGS = {"configmaps": READ}
REMOVING = {"pods": "delete get", "deployments.apps": "get patch"}
CLUSTER_WIDE = {"configmaps": READ, "deployments.apps": READ, "pods": READ, "replicasets.apps": READ}
RELEASES = dict.fromkeys(("configmaps", "deployments.apps"), "create delete get list patch watch")
EVERY_VERB = "create delete get list patch update watch"
OWN_OBJECTS = {f"{kind}.argoproj.io": EVERY_VERB for kind in ("applications", "applicationsets", "appprojects")}
AUTHOR = {**SETTINGS, TASKS: "create delete get list patch watch", EVENTS: "create"}
ROOM = {
    "configmaps": "create delete get list patch watch",
    "deployments.apps": "create delete get list patch watch",
    "events": "list",
    "pods": "create delete get list watch",
    "pods/log": "get",
    "secrets": "create delete",
}


def lease(manager: str) -> Rights:
    return {EVENTS: "create", f"{LEASES} robotkube-manager-{manager}": "get patch"}


SET_UP = {
    "appprojects.argoproj.io default": "get patch",
    "configmaps argocd-cm": "get patch",
    "configmaps argocd-rbac-cm": "get patch",
    "configmaps argocd-tls-certs-cm": "get patch",
    **{f"deployments.apps argocd-{one}": "get patch" for one in ("applicationset-controller", "repo-server", "server")},
    "secrets argocd-secret": "get patch",
}
TEARING_DOWN = {"applications.argoproj.io": "list", "applicationsets.argoproj.io releases": "delete get"}
GENERATING = {
    "applications.argoproj.io": EVERY_VERB,
    "applicationsets.argoproj.io": EVERY_VERB,
    "applicationsets/finalizers.argoproj.io": EVERY_VERB,
    "applicationsets/status.argoproj.io": "get patch update",
    "appprojects.argoproj.io": READ,
    "configmaps": READ,
    "events": "create get list patch watch",
    LEASES: "create",
    f"{LEASES} 58ac56fa.applicationsets.argoproj.io": "create get update",
    "secrets": READ,
}
POLICIES = [f"validatingadmission{kind}.admissionregistration.k8s.io" for kind in ("policies", "policybindings")]
PUBLISHING = {"configmaps": "create", "configmaps gate-public-key": "get patch"}
TRUSTED = {"configmaps robotkube-ca": "get patch"}
SERVING = ("broker", "database", "forge", "manager", "manager-north", "rights", "admission", "suite-runner")
REGISTER = {"configmaps broker-certificates": "get patch"}
CERTIFIED = [f"secrets broker-account-{name}" for name in ("observer", "rights", "manager", "manager-north")]
CERTIFICATES = ["secrets tls-authority", *(f"secrets {name}-tls" for name in SERVING), *CERTIFIED]
AGENTS = ("vehicle-00", "vehicle-01", "cloud-0")
NAMESPACES = ("robotkube", "robotkube-gate", "argocd", "default", *AGENTS, "robotkube-suite-0")
# account -> namespace -> what it may do there; what it may do everywhere stands under "*"
EXACTLY: dict[str, dict[str, Rights]] = {
    "robotkube:manager": {
        "*": NODES,
        "vehicle-00": ANSWERS,
        "cloud-0": ANSWERS,
        "argocd": APPLICATIONS,
        "robotkube": lease("manager"),
    },
    "robotkube:manager-north": {
        "*": NODES,
        "vehicle-01": ANSWERS,
        "default": ANSWERS,
        "argocd": APPLICATIONS,
        "robotkube": lease("manager-north"),
    },
    "robotkube:inspector": {
        "*": {"nodes": "list", "nodes/pods": "get"},
        **dict.fromkeys(("vehicle-00", "vehicle-01", "cloud-0"), LOOKED_AT),
        "robotkube": {INSPECTIONS: "create delete get list", f"inspections/status.{GROUP}": "patch", EVENTS: "create"},
    },
    "robotkube-gate:gate": {},
    "robotkube-gate:default": {},
    "robotkube:gate-key": {
        "robotkube": PUBLISHING,
        "robotkube-gate": {**PUBLISHING, "secrets": "create"},
    },
    "robotkube:admission": {
        "*": {
            **dict.fromkeys(POLICIES, "list watch"),
            **{f"{kind} {name}": "create delete get patch update" for kind in POLICIES for name in API_POLICIES},
            "clusterroles.rbac.authorization.k8s.io robotkube-admission": "get",
            "configmaps *": "get",
        },
        "robotkube": {
            "configmaps admission-list": EVERY_VERB,
            "configmaps admission-platform": "get",
        },
    },
    "robotkube:certificates": {
        **{agent: {**TRUSTED, "secrets broker-account": "get patch"} for agent in AGENTS},
        "robotkube-gate": {**TRUSTED, "secrets gate-tls": "get patch"},
        "robotkube": {**TRUSTED, **dict.fromkeys(CERTIFICATES, "get patch"), "services forge": "get"} | REGISTER,
    },
    "robotkube:default": {},
    "robotkube:suite-runner": {"*": {"nodes/stats": "get"}, "robotkube-suite-0": ROOM},
    "robotkube:remover": {
        "robotkube": {INSPECTIONS: "list", f"inspections/status.{GROUP}": "patch", EVENTS: "create"},
        **dict.fromkeys(AGENTS, REMOVING),
    },
    "robotkube:console": {
        "*": {**dict.fromkeys(("nodes", "pods", TASKS), WATCHED), **IN_THE_NAME_OF_PEOPLE},
        **dict.fromkeys(AGENTS, RULES_OF_DETECTORS),
        "argocd": {"applications.argoproj.io": WATCHED},
        "robotkube": {INSPECTIONS: WATCHED},
    },
    "robotkube:bootstrap": {"argocd": SET_UP, "robotkube": {"configmaps console-sign-in": "get patch"}},
    "robotkube:teardown": {"argocd": TEARING_DOWN},
    "robotkube:installation-test": {"cloud-0": {TASKS: "create delete get"}},
    "robotkube-suite-0:application": {"robotkube-suite-0": SETTINGS},
    "robotkube-suite-0:event-detector": {"robotkube-suite-0": SETTINGS},
    "robotkube-suite-0:default": {},
    "cloud-0:event-detector": {"cloud-0": AUTHOR},
    "vehicle-00:event-detector": {"vehicle-00": AUTHOR},
    "vehicle-00:application": {"vehicle-00": SETTINGS},
    "vehicle-00:mqtt-bridge": {"vehicle-00": SETTINGS},
    "vehicle-00:bag-player": {"vehicle-00": SETTINGS},
    "vehicle-00:default": {},
    "argocd:default": {},
    "argocd:argocd-application-controller": {
        "*": CLUSTER_WIDE,
        **dict.fromkeys(AGENTS, RELEASES),
        "argocd": {**OWN_OBJECTS, "events": "create list", "secrets": READ},
    },
    "argocd:argocd-applicationset-controller": {"argocd": GENERATING},
    "argocd:argocd-redis": {"argocd": {"secrets": "create", "secrets argocd-redis": "get"}},
    "argocd:argocd-repo-server": {},
    "argocd:argocd-server": {
        "argocd": {**OWN_OBJECTS, "configmaps": EVERY_VERB, "events": "create list", "secrets": EVERY_VERB}
    },
}
GATE, KEY = "robotkube-gate", "gate-key"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory, argocd: list[dict[str, Any]]) -> Iterator[Cluster]:
    """Argo CD as in the embedded cluster, two managers with disjoint scopes, and admission by a process."""
    with prepared_cluster(tmp_path_factory.mktemp("api")) as prepared:
        manifests = yaml.dump_all([o for o in argocd if o["kind"] != "CustomResourceDefinition"])
        prepared.kubectl("apply", "--server-side", "-n", "argocd", "-f", "-", text=manifests)
        files = [option for name in INSTALLED for option in ("-f", str(PROFILES / f"{name}.yaml"))]
        prepared.helm("install", "robotkube", str(CHART), *files, "--no-hooks")
        yield prepared


@pytest.fixture(scope="module")
def asking(installed: Cluster) -> Iterator[httpx.Client]:
    """One connection, for the questions about all accounts: thousands."""
    with installed.client() as made:
        yield made


def review(asking: httpx.Client, kind: str, spec: Any, **headers: str) -> Any:
    """The answer to a question about rights, as it is behind `kubectl auth can-i`."""
    document = {"apiVersion": "authorization.k8s.io/v1", "kind": kind, "spec": spec}
    answer = asking.post(f"/apis/authorization.k8s.io/v1/{kind.lower()}s", json=document, headers=headers)
    return answer.raise_for_status().json()["status"]


def rights(asking: httpx.Client, namespace: str, account: str) -> Rights:
    """`<resource>[ <name>]` -> verbs, of what this account may do in a namespace: `kubectl auth can-i --list`."""
    user = {"Impersonate-User": f"system:serviceaccount:{account}"}
    answer = review(asking, "SelfSubjectRulesReview", {"namespace": namespace}, **user)
    assert not answer["incomplete"]
    verbs_of: dict[str, set[str]] = {}
    for rule in answer["resourceRules"]:
        kinds = [f"{kind}.{group}".strip(".") for group in rule["apiGroups"] for kind in rule["resources"]]
        for key in [f"{kind} {name}".strip() for kind in kinds for name in rule.get("resourceNames") or [""]]:
            verbs_of.setdefault(key, set()).update(rule["verbs"])
    return {key: " ".join(sorted(verbs)) for key, verbs in verbs_of.items()}


@pytest.fixture(scope="module")
def everybody(asking: httpx.Client) -> Rights:
    """What Kubernetes allows to whoever is known: asking about oneself, and public addresses."""
    return rights(asking, "default", "nowhere:nobody")


@pytest.mark.parametrize("account", EXACTLY)
def test_an_account_may_do_exactly_this(asking: httpx.Client, everybody: Rights, account: str) -> None:
    expected, allowed = {}, {}
    for namespace in NAMESPACES:
        wanted = {**EXACTLY[account].get("*", {}), **EXACTLY[account].get(namespace, {})}
        said = rights(asking, namespace, account)
        expected[namespace] = wanted
        allowed[namespace] = {key: verbs for key, verbs in said.items() if everybody.get(key) != verbs}
    assert allowed == expected


def test_the_console_writes_tasks_as_a_listed_group_alone(installed: Cluster, tmp_path: Path) -> None:
    """By trying, with the console's own token: not by itself, not as another group, not in another namespace."""
    with console_api(installed, tmp_path) as api:
        tasks = ImpersonatedTasks(api)
        anna = Person("Änna B", ("robotkube:operators",))
        asked = read_request({"namespace": "cloud-0", "application": "pose-telemetry"})
        document = asked.document("asked", anna.name, "2026-11-21T10:00:00Z")
        assert tasks.submit(anna, WRITERS, document)
        assert not tasks.submit(anna, WRITERS, document)
        assert tasks.withdraw(anna, WRITERS, "cloud-0", "asked")
        assert not tasks.withdraw(anna, WRITERS, "cloud-0", "asked")
        elsewhere = {**document, "metadata": {"namespace": "vehicle-00", "name": "asked"}}
        with pytest.raises(RefusalError, match=r"console\.signIn\.writers"):
            tasks.submit(anna, WRITERS, elsewhere)
        for group in ("robotkube:console:others", "system:masters"):
            with pytest.raises(RefusalError, match="impersonate"):
                tasks.submit(anna, group, document)
        with pytest.raises(InputError, match="cannot create resource"):
            KubernetesTasks(functools.partial(call, api)).create(document)
        with pytest.raises(InputError, match="colour"):
            tasks.submit(anna, WRITERS, {**document, "spec": {**document["spec"], "colour": "red"}})


@contextmanager
def console_api(cluster: Cluster, folder: Path) -> Iterator[client.ApiClient]:
    """The API server as the console's pod has it: by its account's token."""
    document = yaml.safe_load(cluster.kubeconfig.read_text())
    document["users"][0]["user"] = {"token": cluster.kubectl("create", "token", "console").strip()}
    path = folder / "kubeconfig"
    path.write_text(write_mapping(document))
    api = api_client(str(path))
    try:
        yield api
    finally:
        api.rest_client.pool_manager.clear()


def test_every_account_of_the_platform_is_listed(installed: Cluster) -> None:
    ours = ("robotkube:", "robotkube-gate:", "argocd:")
    assert {account for account in accounts(installed) if account.startswith(ours)} <= set(EXACTLY)


def accounts(cluster: Cluster) -> list[str]:
    """Every service account as `<namespace>:<name>`; `default` is made by a controller, which does not run here."""
    made = json.loads(cluster.kubectl("get", "serviceaccounts", "-A", "-o", "json"))["items"]
    names = {f"{one['metadata']['namespace']}:{one['metadata']['name']}" for one in made}
    return sorted(names | {f"{namespace}:default" for namespace in namespaces(cluster)})


def namespaces(cluster: Cluster) -> list[str]:
    return [name.partition("/")[2] for name in cluster.kubectl("get", "namespaces", "-o", "name").split()]


READING = ("get", "list", "watch")
WRITING = ("update", "patch", "delete", "deletecollection")  # the API server may answer with what was there


def may(asking: httpx.Client, account: str, verb: str, namespace: str, resource: str, name: str = "") -> bool:
    """What the API server says about a request of an account; `resource` may have a subresource."""
    groups = ["system:serviceaccounts", f"system:serviceaccounts:{account.partition(':')[0]}", "system:authenticated"]
    kind, _, subresource = resource.partition("/")
    group, _, kind = kind.rpartition(".")
    attributes = {"group": group, "resource": kind, "subresource": subresource, "verb": verb, "name": name}
    user = {"user": f"system:serviceaccount:{account}", "groups": groups}
    spec = {**user, "resourceAttributes": {**attributes, "namespace": namespace}}
    return bool(review(asking, "SubjectAccessReview", spec)["allowed"])


def reads_secrets(asking: httpx.Client, account: str, namespace: str, name: str = "") -> bool:
    """Return whether the account may read this Secret, or any of the namespace, by any verb."""
    return any(may(asking, account, verb, namespace, "secrets", name) for verb in READING)


def test_no_account_at_all_may_read_the_key_of_the_gate(installed: Cluster, asking: httpx.Client) -> None:
    """The gate itself has it from its volume."""
    everyone = accounts(installed)
    assert len(everyone) > 30
    processes = ("gate-key", "inspector", "remover", "admission")
    assert {"robotkube-gate:gate", *(f"robotkube:{name}" for name in processes)} <= set(everyone)
    assert [
        (account, verb)
        for account in everyone
        for verb in (*READING, *WRITING)
        if may(asking, account, verb, GATE, "secrets", KEY) or may(asking, account, verb, GATE, "secrets")
    ] == []


AROUND = [  # other ways to what a pod of a namespace mounts
    *((verb, "pods") for verb in ("create", "update", "patch")),
    *((verb, f"pods/{way}") for verb in ("create", "get") for way in ("exec", "attach", "portforward", "proxy")),
    *((verb, "pods/ephemeralcontainers") for verb in ("update", "patch")),
    *((verb, f"apps.{kind}") for verb in ("create", "patch") for kind in ("deployments", "replicasets", "daemonsets")),
    *((verb, f"batch.{kind}") for verb in ("create", "patch") for kind in ("jobs", "cronjobs")),
    ("create", "serviceaccounts/token"),
    ("create", "rbac.authorization.k8s.io.rolebindings"),
    ("escalate", "rbac.authorization.k8s.io.roles"),
    ("patch", "configmaps"),
]


def test_no_account_at_all_has_another_way_to_the_key(installed: Cluster, asking: httpx.Client) -> None:
    """Not by a pod of its own there, nor into that of the gate."""
    asked = [(account, *question) for account in accounts(installed) for question in AROUND]
    assert [question for question in asked if may(asking, question[0], question[1], GATE, question[2])] == []


def test_everybody_is_refused_the_key_of_the_gate(installed: Cluster) -> None:
    """By trying, each account; an administrator gets it."""
    installed.kubectl("create", "secret", "generic", KEY, "-n", GATE, "--from-literal=key.pem=x")
    assert installed.kubectl("get", "secret", KEY, "-n", GATE, "-o", "name").strip() == f"secret/{KEY}"
    secrets = f"/api/v1/namespaces/{GATE}/secrets"
    merge = {"Content-Type": "application/merge-patch+json"}
    try:
        for account in accounts(installed):
            with installed.client(account) as client:
                answers = [
                    client.get(f"{secrets}/{KEY}"),
                    client.get(secrets),
                    client.patch(f"{secrets}/{KEY}", content=b"{}", headers=merge),
                    client.delete(f"{secrets}/{KEY}", params={"propagationPolicy": "Foreground"}),
                ]
            assert [answer.status_code for answer in answers] == [403] * 4, account
    finally:
        installed.kubectl("delete", "secret", KEY, "-n", GATE)


@pytest.mark.parametrize("program", ["server", "applicationset-controller", "application-controller", "repo-server"])
def test_argo_cd_is_refused_the_key_of_the_gate(installed: Cluster, program: str) -> None:
    """By trying."""
    account = f"system:serviceaccount:argocd:argocd-{program}"
    done = installed.run("kubectl", "get", "secret", KEY, "-n", GATE, "--as", account)
    assert (done.returncode, done.stdout) == (1, "")
    shown("elsewhere", done.stderr, "key-read")


def test_argo_cd_reads_secrets_of_its_own_namespace_only(installed: Cluster, asking: httpx.Client) -> None:
    own = [account for account in accounts(installed) if account.startswith("argocd:")]
    assert reads_secrets(asking, "argocd:argocd-server", "argocd")
    reached = {
        (account, namespace)
        for account in own
        for namespace in namespaces(installed)
        if namespace != "argocd" and reads_secrets(asking, account, namespace)
    }
    assert reached == set()


@pytest.mark.parametrize(
    "question",
    [
        ("robotkube:manager", "get", "vehicle-01", "robotkube.io.taskdescriptions"),
        ("robotkube:manager", "get", "vehicle-01", "pods"),
        ("robotkube:manager", "update", "robotkube", "coordination.k8s.io.leases", "robotkube-manager-manager-north"),
        ("robotkube:manager", "create", "robotkube", "coordination.k8s.io.leases"),
        ("robotkube:manager-north", "patch", "cloud-0", "robotkube.io.taskdescriptions/status"),
        ("robotkube:manager-north", "patch", "", "nodes"),
        ("argocd:argocd-application-controller", "create", "robotkube", "apps.deployments"),
        ("argocd:argocd-application-controller", "patch", "robotkube", "configmaps"),
        ("argocd:argocd-application-controller", "delete", "robotkube-suite-0", "apps.deployments"),
        ("argocd:argocd-application-controller", "create", "vehicle-00", "pods"),
        ("argocd:argocd-application-controller", "create", "vehicle-00", "rbac.authorization.k8s.io.rolebindings"),
        ("argocd:argocd-server", "delete", "vehicle-00", "pods"),
        ("cloud-0:event-detector", "create", "vehicle-00", "robotkube.io.taskdescriptions"),
        ("cloud-0:event-detector", "patch", "cloud-0", "robotkube.io.taskdescriptions/status"),
    ],
    ids=" ".join,
)
def test_no_account_reaches_into_anothers_scope(asking: httpx.Client, question: tuple[str, ...]) -> None:
    assert not may(asking, *question)


@pytest.fixture
def as_detector(installed: Cluster) -> Iterator[str]:
    """The way to the API server on which calls are those of the detector's account in cloud-0."""
    environment = {**os.environ, "KUBECONFIG": str(installed.kubeconfig), "HOME": str(installed.kubeconfig.parent)}
    account = "--as=system:serviceaccount:cloud-0:event-detector"
    proxy = subprocess.Popen(
        [program("kubectl"), "proxy", "--port=0", account], env=environment, stdout=subprocess.PIPE, text=True
    )
    assert proxy.stdout is not None
    yield "http://" + proxy.stdout.readline().split()[-1]
    proxy.kill()
    proxy.communicate(timeout=10)


def test_a_detector_tells_of_a_bad_rule_file_by_its_own_account(
    installed: Cluster, as_detector: str, tmp_path: Path
) -> None:
    """As an Event of its ConfigMap, which says key and fix; the settings before go on, and good ones are taken."""

    def configure(verb: str, **changes: Any) -> None:
        data = {"config.yaml": write_mapping({**DETECTOR, **changes})}
        metadata = {"name": "event-detector", "namespace": "cloud-0"}
        document = {"apiVersion": "v1", "kind": "ConfigMap", "metadata": metadata, "data": data}
        installed.kubectl(verb, "-n", "cloud-0", "-f", "-", text=json.dumps(document))

    def warnings() -> list[dict[str, Any]]:
        listed = installed.kubectl("get", "events.events.k8s.io", "-n", "cloud-0", "-o", "json")
        return [item for item in json.loads(listed)["items"] if item["reason"] == "SettingsRefused"]

    configure("create")
    (tmp_path / "config.yaml").write_text(write_mapping(DETECTOR))
    port = free_port()
    variables = {
        "ROBOTKUBE_API_SERVER": as_detector,
        "ROBOTKUBE_CONFIG": str(tmp_path / "config.yaml"),
        "ROBOTKUBE_CONFIGMAP": "cloud-0/event-detector",
        "ROBOTKUBE_HEALTH_PORT": str(port),
        "ROS_DOMAIN_ID": ros_domain(),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    detector = subprocess.Popen([sys.executable, *COMMAND], env={**os.environ, **variables})
    try:
        until(lambda: is_up(port) and json.loads(read(port, "/status"))["not_ready"] == "")
        configure("replace", rules=[{**DETECTOR["rules"][0], "stop_distance_m": 1}])
        until(warnings)
        [warning] = warnings()
        assert (warning["type"], warning["regarding"]["kind"], warning["regarding"]["name"]) == (
            "Warning", "ConfigMap", "event-detector")  # fmt: skip
        expected = "config.yaml: rules[0].stop_distance_m: must not be less than start_distance_m"
        assert warning["note"].startswith(expected)
        assert warning["note"].endswith("the settings before go on")
        status = json.loads(read(port, "/status"))
        assert (status["rules"]["names"], status["settings"]["refused"][: len(expected)]) == (["near"], expected)
        configure("replace", rules=[{**DETECTOR["rules"][0], "name": "nearer"}], reactions=[])
        until(lambda: json.loads(read(port, "/status"))["rules"]["names"] == ["nearer"])
        assert len(warnings()) == 1
    finally:
        detector.kill()
        detector.wait(10)


def test_one_manager_of_everything_may_answer_everywhere(helm: Any) -> None:
    rendered = helm.template(CHART, PROFILES / "official.yaml")
    rules = rendered.one("ClusterRole", "robotkube-manager")["rules"]
    assert {resource: " ".join(sorted(r["verbs"])) for r in rules for resource in r["resources"]} == {
        "nodes": READ,
        "taskdescriptions": "create delete get list patch watch",
        "taskdescriptions/status": "patch update",
        "events": "create",
        "pods": READ,
    }
