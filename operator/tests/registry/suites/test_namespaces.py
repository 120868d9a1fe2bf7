"""Test namespaces on a namespace in memory: placing, starting, ending, helpers, emptying; time is the test's own."""

import base64
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.certificates.adapters.issuing import describe, throw_away
from robotkube.foundation.certificates.core.lives import Pair
from robotkube.registry.suites.core.namespace_contents import HELPER, OBJECTS_MAX, password_line
from robotkube.registry.suites.loops.cluster_namespace import ClusterTestNamespace, SuiteNamespaceSettings
from robotkube.registry.suites.loops.namespace_cleanup import ClusterNamespaceCleaner
from robotkube.registry.suites.ports.suites import Object, SuiteAccount
from robotkube.testing.suites import ENDED, RUNNING, MemoryNamespaceObjects, deployment

SETTINGS = SuiteNamespaceSettings(
    "robotkube-suite-0", 91, "cloud-0", "ros@x", "mosquitto@x", "ferretdb", "db@x", ("--a",)
)
CONFIG_MAP = {"apiVersion": "v1", "kind": "ConfigMap", "metadata": {"name": "greeter"}, "data": {"a": "b"}}

MOSQUITTO = (
    "suite:$7$101$AJwpRFrZ7eazyN5k$zB8OMkuug37NOg7SRpmSsQXJj2/BoY"
    "H5R6FsaA0Me93piL5j2sSzRaSgxRkKmSniKVttz1YdTY3yu94juMgNpA==\n"
)


class Clock:
    """Time that goes on by sleeping, and by `step` whenever somebody asks."""

    def __init__(self) -> None:
        self.now = self.step = 0.0

    def __call__(self) -> float:
        self.now += self.step
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


def make_namespace(
    api: MemoryNamespaceObjects,
    seconds: float = 100.0,
    settings: SuiteNamespaceSettings = SETTINGS,
    account: Callable[[SuiteAccount, SuiteAccount], None] = lambda administrator, account: None,
) -> tuple[ClusterTestNamespace, Clock]:
    clock = Clock()
    return ClusterTestNamespace(api, settings, seconds, account, clock, clock.sleep), clock


def terminated(code: int, log: str = "", **more: Any) -> Mapping[str, Any]:
    state = {"terminated": {"exitCode": code, "reason": "Error" if code else "Completed", **more}}
    return {"phase": "Failed" if code else "Succeeded", "containerStatuses": [{"name": "suite-look-1", "state": state}]}


def test_a_charts_objects_are_changed_by_namespace_domain_and_label_only() -> None:
    api = MemoryNamespaceObjects()
    item = deployment(initContainers=[{"name": "first", "env": [{"name": "ROS_DOMAIN_ID", "value": "0"}]}])
    make_namespace(api)[0].apply([item, CONFIG_MAP])
    applied = api.objects["Deployment", "greeter"]
    assert applied["metadata"] == {
        "name": "greeter",
        "namespace": "robotkube-suite-0",
        "labels": {"robotkube.io/suite": "subject", "robotkube.io/peer": "true"},
    }
    template = applied["spec"]["template"]
    assert template["metadata"]["labels"] == {
        "app": "greeter",
        "robotkube.io/suite": "subject",
        "robotkube.io/peer": "true",
    }
    domain = [{"name": "ROS_DOMAIN_ID", "value": "91"}]
    assert template["spec"]["initContainers"] == [{"name": "first", "env": domain}]
    assert template["spec"]["containers"] == [{"name": "main", "image": "i@sha256:0", "env": domain}]
    assert applied["spec"]["selector"] == item["spec"]["selector"]
    assert api.objects["ConfigMap", "greeter"]["data"] == {"a": "b"}


@pytest.mark.parametrize(
    ("pod", "words"),
    [
        (
            {"nodeSelector": {"robotkube.io/agent": "vehicle-00"}},
            "would not run on the test namespace's node, that of cloud-0",
        ),
        ({"nodeSelector": {}}, "would not run on the test namespace's node"),
        ({"nodeSelector": None}, "would not run on the test namespace's node"),
        ({"nodeName": "vehicle-00"}, "would not run on the test namespace's node"),
        ({"priorityClassName": "system-node-critical"}, "it pushes others off the node"),
    ],
)
def test_what_is_under_test_runs_on_the_rooms_node_and_nowhere_else(pod: dict[str, Any], words: str) -> None:
    api = MemoryNamespaceObjects()
    with pytest.raises(InputError, match=words):
        make_namespace(api)[0].apply([CONFIG_MAP, deployment(**pod)])
    assert api.objects == {}


def held_pods() -> dict[str, Any]:
    item = deployment()
    item["spec"]["template"]["metadata"]["finalizers"] = ["example.com/never"]
    return item


@pytest.mark.parametrize(
    ("item", "words"),
    [
        ({"apiVersion": "v1", "kind": "Secret", "metadata": {"name": "a"}}, "may hold Deployment"),
        ({"apiVersion": "v1", "kind": "Pod", "metadata": {"name": "a"}}, "may hold Deployment"),
        ({**CONFIG_MAP, "apiVersion": "apps/v1"}, "may hold Deployment"),
        ({**CONFIG_MAP, "metadata": {"name": "suite-scratch-used"}}, "is for the test namespace"),
        ({**CONFIG_MAP, "metadata": {"name": "../../secrets"}}, "not a name"),
        ({**CONFIG_MAP, "metadata": {"name": "a", "namespace": "robotkube"}}, "leave it out"),
        ({**CONFIG_MAP, "metadata": {"name": "a", "finalizers": ["example.com/never"]}}, "finalizers: leave them out"),
        ({**CONFIG_MAP, "metadata": {"name": "a", "ownerReferences": [{}]}}, "ownerReferences: leave them out"),
        (held_pods(), "pods of Deployment greeter: finalizers: leave them out"),
        ({}, "may hold Deployment"),
    ],
)
def test_what_a_room_does_not_take(item: dict[str, Any], words: str) -> None:
    api = MemoryNamespaceObjects()
    with pytest.raises(InputError, match=words):
        make_namespace(api)[0].apply([CONFIG_MAP, item])
    assert api.objects == {}, "nothing is made before everything can be"
    with pytest.raises(InputError, match=f"may have {OBJECTS_MAX}"):
        make_namespace(api)[0].apply([CONFIG_MAP] * (OBJECTS_MAX + 1))
    with pytest.raises(InputError, match="not a name"):
        make_namespace(api)[0].provide({"suite-scratch-used": {}})


def test_ready_and_gone() -> None:
    api = MemoryNamespaceObjects()
    test_namespace, _ = make_namespace(api)
    test_namespace.apply([deployment()])
    assert test_namespace.wait_ready("Deployment", "greeter", 10) == ""
    assert test_namespace.leftovers() == ["Deployment greeter", "Pod greeter-1"]
    [end] = test_namespace.delete([deployment()], 10)
    assert (end.gone, end.exit_codes, end.seconds, end.grace_seconds) == (True, {"main": 0}, 1.0, 3.0)
    assert test_namespace.leftovers() == []


def test_a_pod_that_stays_when_its_deployment_is_gone() -> None:
    test_namespace, clock = make_namespace(MemoryNamespaceObjects(finish=lambda pod: None))
    test_namespace.apply([deployment()])
    clock.step = 0.5  # watches in memory take no time
    [end] = test_namespace.delete([deployment()], 10)
    assert not end.gone
    assert test_namespace.leftovers() == ["Pod greeter-1"]


def ending(restarts: int) -> Mapping[str, Any]:
    waiting = {"reason": "CrashLoopBackOff", "message": "back-off 10s restarting failed container"}
    last = {"terminated": {"exitCode": 1, "reason": "Error"}}
    status = {"name": "main", "ready": False, "restartCount": restarts, "state": {"waiting": waiting}}
    return {"phase": "Running", "containerStatuses": [{**status, "lastState": last}]}


def test_a_container_that_ended_once_may_have_come_too_early() -> None:
    test_namespace, clock = make_namespace(MemoryNamespaceObjects(start=lambda pod: ending(0)))
    test_namespace.apply([deployment()])
    words = test_namespace.wait_ready("Deployment", "greeter", 5)
    assert clock.now == pytest.approx(5, abs=1)
    assert words.startswith("Deployment greeter was not ready after 5 s\n")


def test_what_is_said_of_a_pod_that_ends_again_and_again() -> None:
    event = {"type": "Warning", "reason": "BackOff", "message": "Back-off restarting"}
    said = [event, {"type": "Normal", "reason": "Pulled"}]
    api = MemoryNamespaceObjects(start=lambda pod: ending(2), said=said)
    api.texts["greeter-1"] = "starting\nno greeting given\n"
    test_namespace, clock = make_namespace(api)
    test_namespace.apply([deployment()])
    words = test_namespace.wait_ready("Deployment", "greeter", 90)
    assert clock.now < 2
    assert words.splitlines() == [
        "Deployment greeter cannot get ready",
        "pod greeter-1: container main was restarted 2 times; it ended with 1 (Error)",
        "pod greeter-1: container main waits: CrashLoopBackOff",
        "event BackOff: Back-off restarting",
        "last lines of its log:",
        "  starting",
        "  no greeting given",
    ]


def test_the_log_of_what_is_in_trouble_comes_last() -> None:
    """Texts are cut in their middle, so what stands last is what everybody reads."""
    api = MemoryNamespaceObjects(start=lambda pod: ending(2))
    test_namespace, _ = make_namespace(api)
    test_namespace.apply([deployment()])
    sidecar = {"name": "a-sidecar", "ready": True, "state": {"running": {}}}
    api.objects["Pod", "greeter-1"]["status"]["containerStatuses"].append(sidecar)
    api.objects["Pod", "greeter-2"] = {**api.objects["Pod", "greeter-1"], "status": dict(RUNNING)}
    api.objects["Pod", "greeter-2"]["metadata"] = {**api.objects["Pod", "greeter-1"]["metadata"], "name": "greeter-2"}
    api.texts |= {"greeter-1 main": "no map", "greeter-1 a-sidecar": "proxy is up\n", "greeter-2": "good day"}
    assert test_namespace.wait_ready("Deployment", "greeter", 90).splitlines()[-5:] == [
        "last lines of its log:",
        "  good day",
        "last lines of its log:",
        "  proxy is up",
        "  no map",
    ]


def test_two_pods_that_end_alike_say_it_once() -> None:
    api = MemoryNamespaceObjects(start=lambda pod: ending(2))
    test_namespace, _ = make_namespace(api)
    test_namespace.apply([deployment()])
    other = api.objects["Pod", "greeter-1"]
    api.objects["Pod", "greeter-2"] = {**other, "metadata": {**other["metadata"], "name": "greeter-2"}}
    api.texts |= {"greeter-1": "twice\ntwice\nno map\n", "greeter-2": "twice\ntwice\nno map\n"}
    lines = test_namespace.wait_ready("Deployment", "greeter", 90).splitlines()
    assert lines[-4:] == ["last lines of its log:", "  twice", "  twice", "  no map"]
    assert lines.count("  no map") == 1


def test_the_log_of_a_container_that_runs_again_is_that_of_its_end() -> None:
    status = {"name": "main", "ready": True, "restartCount": 1, "state": {"running": {}}}
    api = MemoryNamespaceObjects(start=lambda pod: {**RUNNING, "containerStatuses": [status]})
    test_namespace, _ = make_namespace(api)
    test_namespace.apply([deployment()])
    api.texts |= {"greeter-1": "starting", "greeter-1 main before": "no map"}
    assert test_namespace.logs("greeter-1") == "no map\n"


@pytest.mark.parametrize("reason", ["ImagePullBackOff", "InvalidImageName", "CreateContainerConfigError"])
def test_what_no_waiting_ends_fails_at_once(reason: str) -> None:
    status = {"name": "main", "ready": False, "state": {"waiting": {"reason": reason, "message": "it is not there"}}}
    api = MemoryNamespaceObjects(start=lambda pod: {"phase": "Pending", "containerStatuses": [status]})
    test_namespace, clock = make_namespace(api)
    test_namespace.apply([deployment()])
    words = test_namespace.wait_ready("Deployment", "greeter", 60)
    assert clock.now < 2
    assert words.splitlines()[:2] == [
        "Deployment greeter cannot get ready",
        f"pod greeter-1: container main waits: {reason}: it is not there",
    ]


def test_what_is_said_when_no_pod_may_be_made() -> None:
    api = MemoryNamespaceObjects()
    test_namespace, _ = make_namespace(api)
    test_namespace.apply([deployment()])
    refused = 'pods "greeter-1" is forbidden: violates PodSecurity "restricted:latest": privileged'
    condition = {"type": "ReplicaFailure", "status": "True", "reason": "FailedCreate", "message": refused}
    api.objects["Deployment", "greeter"]["status"] = {"conditions": [condition]}
    del api.objects["Pod", "greeter-1"]
    assert f"Deployment greeter: FailedCreate: {refused}" in test_namespace.wait_ready("Deployment", "greeter", 1)
    assert "is not there" in test_namespace.wait_ready("Deployment", "other", 1)


def test_a_helper_pod_runs_to_its_end() -> None:
    api = MemoryNamespaceObjects(start=lambda pod: terminated(3))
    api.texts["suite-look-1"] = "seen\n"
    test_namespace, _ = make_namespace(api)
    run = test_namespace.run_pod("look", "image@x", ["look"], {"a.json": b"{}"}, 30, volume_claim=True, accounts=True)
    assert (run.log, run.exit_code, run.succeeded) == ("seen\n", 3, False)
    assert api.created == ["ConfigMap suite-look-1", "Pod suite-look-1"]
    assert ("ConfigMap", "suite-scratch-used") in api.objects
    assert api.objects["ConfigMap", "suite-look-1"]["binaryData"] == {"a.json": "e30="}
    assert test_namespace.leftovers() == []


def test_the_helper_pod_is_restricted_and_has_no_token() -> None:
    seen: list[Object] = []

    def start(pod: Object) -> Mapping[str, Any]:
        seen.append(pod)
        return terminated(0)

    make_namespace(MemoryNamespaceObjects(start=start))[0].run_pod("look", "i@x", [], {}, 30)
    [pod] = seen
    spec, [container] = pod["spec"], pod["spec"]["containers"]
    assert (spec["automountServiceAccountToken"], spec["restartPolicy"]) == (False, "Never")
    assert spec["nodeSelector"] == {"robotkube.io/agent": "cloud-0"}
    assert spec["securityContext"]["runAsNonRoot"]
    assert container["securityContext"]["capabilities"] == {"drop": ["ALL"]}
    assert "command" not in container
    assert {"name": "ROS_DOMAIN_ID", "value": "91"} in container["env"]
    assert container["resources"]["limits"]["memory"]
    assert pod["metadata"]["labels"] == {"robotkube.io/suite": HELPER, "robotkube.io/peer": "true"}


def test_a_helper_pod_that_does_not_end() -> None:
    test_namespace, clock = make_namespace(MemoryNamespaceObjects())
    run = test_namespace.run_pod("look", "i@x", [], {}, 8)
    assert (run.exit_code, run.succeeded) == (None, False)
    assert "did not end in its time" in run.problem
    assert clock.now == pytest.approx(8, abs=1)


def test_files_beyond_the_bound_are_refused() -> None:
    with pytest.raises(InputError, match="a pod takes at most"):
        make_namespace(MemoryNamespaceObjects())[0].run_pod("look", "i@x", [], {"chart.tgz": bytes(1_000_000)}, 8)


def test_the_time_of_the_whole_run_ends_every_wait() -> None:
    test_namespace, clock = make_namespace(MemoryNamespaceObjects(start=lambda pod: ending(0)), seconds=4)
    test_namespace.apply([deployment()])
    with pytest.raises(UnavailableError, match="time of the whole run is over"):
        test_namespace.wait_ready("Deployment", "greeter", 60)
    assert clock.now < 6
    assert test_namespace.seconds_left == 0


def test_a_broker_with_an_account_of_its_own() -> None:
    api = MemoryNamespaceObjects()
    api.texts["suite-broker"] = "mosquitto running"
    test_namespace, _ = make_namespace(api)
    assert test_namespace.broker_log() == ""
    account = test_namespace.start_broker()
    assert test_namespace.start_broker() == account
    assert (account.host, account.port) == ("10.0.0.9", 1883)
    assert api.secrets["broker-account"] == {
        "username": "suite", "password": account.password, "host": "10.0.0.9", "port": "1883", "tls": "off",
    }  # fmt: skip
    line = api.secrets["suite-broker"]["passwords"]
    assert line.startswith("suite:$7$101$")
    assert account.password not in line
    assert "log_type all" in api.secrets["suite-broker"]["mosquitto.conf"]
    assert test_namespace.broker_log() == "mosquitto running"
    api.texts["suite-broker"] += "\nReceived PUBLISH"
    assert test_namespace.broker_log() == "mosquitto running\nReceived PUBLISH"
    api.texts["suite-broker"] = "\nReceived PUBLISH" * 100
    with pytest.raises(InputError, match="wrote more than 4 MiB about what the chart does"):
        test_namespace.broker_log()


def test_a_broker_proves_who_it_is_where_the_platforms_does() -> None:
    """By a name, since there is no name service: the account has the address of the pod."""
    api = MemoryNamespaceObjects()
    test_namespace, _ = make_namespace(api, settings=replace(SETTINGS, certify=throw_away))
    assert test_namespace.start_broker().port == 8883
    account, files = api.secrets["broker-account"], api.secrets["suite-broker"]
    assert (account["tls"], account["server_name"], account["host"]) == ("required", "suite-broker", "10.0.0.9")
    assert "listener 8883\ncertfile /etc/mosquitto/tls.crt\nkeyfile /etc/mosquitto/tls.key\n" in files["mosquitto.conf"]
    assert "1883" not in files["mosquitto.conf"].replace("8883", "")
    trusted = api.objects["ConfigMap", "robotkube-ca"]
    assert trusted["metadata"]["labels"] == {"robotkube.io/suite": HELPER, "robotkube.io/peer": "true"}
    shown = Pair(files["tls.crt"], files["tls.key"])
    assert describe(shown, Pair(trusted["data"]["ca.crt"], files["tls.key"])).signed
    assert "PRIVATE" not in trusted["data"]["ca.crt"]


def test_a_chart_does_not_say_who_signs_certificates() -> None:
    item = {**CONFIG_MAP, "metadata": {"name": "robotkube-ca"}}
    with pytest.raises(InputError, match="this name is the platform's"):
        make_namespace(MemoryNamespaceObjects())[0].apply([item])


def test_the_password_line_is_mosquittos() -> None:
    """Its mosquitto_passwd 2.0.11 gave this for `a password`."""
    salt = base64.b64decode(MOSQUITTO.split("$")[3])
    assert password_line("suite", "a password", salt) == MOSQUITTO


def test_a_database_with_an_account_of_its_own() -> None:
    api = MemoryNamespaceObjects()
    made = []
    test_namespace, _ = make_namespace(
        api, account=lambda administrator, account: made.append((administrator, account))
    )
    account = test_namespace.start_database()
    assert test_namespace.start_database() == account
    [(administrator, given)] = made
    assert given == account
    assert (administrator.username, administrator.host) == ("administrator", "10.0.0.9")
    assert api.secrets["suite-database"]["password"] == administrator.password != account.password
    assert set(api.secrets["database-account"]) == {
        "username", "password", "database", "host", "port", "authenticationDatabase", "tls",
    }  # fmt: skip
    assert (account.port, account.authority, api.secrets["database-account"]["tls"]) == (27017, "", "off")
    container = api.objects["Pod", "suite-database"]["spec"]["containers"][0]
    assert (container["image"], container["args"]) == ("db@x", ["--a", "--listen-addr=:27017"])


@pytest.mark.parametrize("kind", ["ferretdb", "mongo"])
def test_a_database_proves_who_it_is_where_the_platforms_does(kind: str) -> None:
    """By a name and an authority of its own; the broker's stays trusted."""
    api = MemoryNamespaceObjects()
    made = []
    settings = replace(SETTINGS, certify=throw_away, database_kind=kind)
    test_namespace, _ = make_namespace(api, settings=settings, account=lambda *accounts: made.extend(accounts))
    test_namespace.start_broker()
    before = api.objects["ConfigMap", "robotkube-ca"]["data"]["ca.crt"]
    account = test_namespace.start_database()
    database, files = api.secrets["database-account"], api.secrets["suite-database"]
    assert (database["tls"], database["server_name"], database["port"]) == ("required", "suite-database", "27018")
    assert [(one.server_name, one.authority, one.port) for one in made] == [
        ("suite-database", files["ca.crt"], 27018)
    ] * 2
    assert made[1] == account
    assert describe(Pair(files["tls.crt"], files["tls.key"]), Pair(files["ca.crt"], files["tls.key"])).signed
    assert files["tls.pem"] == files["tls.crt"] + files["tls.key"]
    assert api.objects["ConfigMap", "robotkube-ca"]["data"]["ca.crt"] == before + files["ca.crt"]
    pod = api.objects["Pod", "suite-database"]["spec"]
    [container] = pod["containers"]
    mounted = {
        item["path"] for one in pod["volumes"] if one["name"] == "certificate" for item in one["secret"]["items"]
    }
    named = {Path(word.rpartition("=")[2]).name for word in container["args"] if "/etc/database-tls/" in word}
    assert named <= mounted
    assert container["readinessProbe"]["tcpSocket"]["port"] == 27018
    assert "27017" not in str(container["args"])


def test_no_database_where_the_platform_has_none() -> None:
    settings = SuiteNamespaceSettings("robotkube-suite-0", 91, "cloud-0", "ros@x", "mosquitto@x")
    with pytest.raises(InputError, match="no image of one"):
        make_namespace(MemoryNamespaceObjects(), settings=settings)[0].start_database()


def test_a_helper_that_does_not_start_makes_the_run_unfinished() -> None:
    with pytest.raises(UnavailableError, match="Pod suite-broker was not ready"):
        make_namespace(MemoryNamespaceObjects(start=lambda pod: ending(0)), seconds=500)[0].start_broker()


def make_keeper(api: MemoryNamespaceObjects) -> tuple[ClusterNamespaceCleaner, Clock]:
    clock = Clock()
    return ClusterNamespaceCleaner(api, SETTINGS, clock, clock.sleep), clock


def test_emptying_takes_everything_but_what_kubernetes_puts_there() -> None:
    api = MemoryNamespaceObjects()
    api.objects["ConfigMap", "kube-root-ca.crt"] = {"metadata": {"name": "kube-root-ca.crt"}}
    test_namespace, _ = make_namespace(api)
    test_namespace.provide({"simulation": {"start": "1"}})
    test_namespace.apply([deployment(), CONFIG_MAP])
    test_namespace.start_broker()
    keeper, _ = make_keeper(api)
    keeper.empty(30)
    assert list(api.objects) == [("ConfigMap", "kube-root-ca.crt")]
    assert api.secrets == {}
    assert keeper.name == "robotkube-suite-0"


def test_a_used_claim_is_cleaned_and_one_that_was_not_used_is_left_alone() -> None:
    api = MemoryNamespaceObjects(start=lambda pod: {**terminated(0), "containerStatuses": clean_status(0)})
    keeper, _ = make_keeper(api)
    keeper.empty(30)
    assert api.created == []
    claim = [{"name": "s", "persistentVolumeClaim": {"claimName": "scratch"}}]
    make_namespace(api)[0].apply([deployment(volumes=claim)])
    keeper.empty(30)
    assert api.created[-1] == "Pod suite-clean"
    assert api.objects == {}


def clean_status(code: int) -> list[dict[str, Any]]:
    return [{"name": "suite-clean", "state": {"terminated": {"exitCode": code}}}]


def test_a_claim_that_cannot_be_cleaned_keeps_the_namespace_from_use() -> None:
    api = MemoryNamespaceObjects(start=lambda pod: {"phase": "Failed", "containerStatuses": clean_status(1)})
    api.objects["ConfigMap", "suite-scratch-used"] = {"metadata": {"name": "suite-scratch-used"}}
    with pytest.raises(UnavailableError, match="could not be emptied"):
        make_keeper(api)[0].empty(30)
    assert ("ConfigMap", "suite-scratch-used") in api.objects
    with pytest.raises(UnavailableError, match="could not be emptied"):
        make_keeper(api)[0].empty(30)


def test_a_namespace_that_does_not_get_empty() -> None:
    api = MemoryNamespaceObjects(finish=lambda pod: None)
    api.objects["Pod", "stuck"] = {"metadata": {"name": "stuck"}, "status": RUNNING}
    keeper, clock = make_keeper(api)
    with pytest.raises(UnavailableError, match="still there after the time for emptying: Pod stuck"):
        keeper.empty(9)
    assert clock.now == pytest.approx(9, abs=1)
    assert ENDED["phase"] == "Succeeded"
