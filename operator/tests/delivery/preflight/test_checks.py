"""Every check of the preflight: ok on a cluster that can take the chart, failed with one thing changed, and never ok
when it could not look."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from robotkube.delivery.preflight.core.argocd import PARTS
from robotkube.delivery.preflight.core.capacity import requests
from robotkube.delivery.preflight.core.checks import CHECKS, findings
from robotkube.delivery.preflight.core.findings import (
    FAILED,
    NOT_CHECKED,
    OK,
    ClusterFinding,
    Problem,
    Unread,
    gathered,
)
from robotkube.delivery.preflight.core.registries import RegistryAnswer, host_of
from robotkube.delivery.preflight.core.releases import HelmRevision, PresentObjects
from robotkube.delivery.preflight.core.renderings import RenderedChart
from robotkube.delivery.preflight.core.storage import Storage
from robotkube.delivery.preflight.core.values import Judgement
from robotkube.foundation.kubernetes.core.service_names import service_of
from tests.stages.delivery.preflight.preflight_facts import (
    AGENTS,
    DEFAULT_CLASS,
    argo_cd,
    facts,
    finding,
    node,
    part_of_argo_cd,
    rendering,
    said,
)

RULE = {"operations": ["CREATE"], "apiGroups": [""], "resources": ["pods"]}
NODES = [node(name, role) for name, role in AGENTS.items()]
VERSIONS_OF_KUBELETS = [
    ("v1.34.9", FAILED),
    ("v1.36.3", OK),
    ("v1.34.1+k3s1", FAILED),
    ("v1.36.0+k3s1", OK),
    ("v1.35.0-rc.1", OK),
    ("", FAILED),
]
DISKS = {"metadata": {"name": "disks"}, "provisioner": "example.com/disks"}


def changed(made: RenderedChart, kind: str, name: str) -> dict[str, Any]:
    """An object of the rendering, to be changed in its place."""
    [item] = [one for one in made.of_kind(kind) if one["metadata"]["name"] == name]
    return dict(item) | {"spec": item["spec"]}


def pod_of(made: RenderedChart, kind: str, name: str) -> dict[str, Any]:
    """The pod of a workload, to be changed in its place."""
    return changed(made, kind, name)["spec"]["template"]["spec"]


def test_all_are_ok_on_a_cluster_that_can_take_the_chart() -> None:
    by_check = findings(facts())
    assert [one for one in by_check if one.result != OK] == []
    assert len(by_check) >= 12


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.name)
def test_what_was_not_read_is_never_ok(check: Any) -> None:
    for name in check.needs:
        judged = check.finding(facts() | {name: Unread("forbidden: nobody may read it")})
        assert (judged.result, "forbidden" in judged.says) == (NOT_CHECKED, True)


class TestValues:
    def test_a_key_that_the_schema_does_not_know(self) -> None:
        judgement = Judgement(
            [(("gate",), "Additional properties are not allowed ('sed' was unexpected)")], "", "--values"
        )
        assert "values, gate: Additional properties" in said(finding("values", judgement=judgement))

    def test_what_the_chart_refuses_is_one_problem_each(self) -> None:
        text = (
            "execution error at (robotkube/templates/refusals.yaml:1:4): robotkube: 2 problem(s) in the values:\n"
            "  1. images.platform is empty. Give its reference.\n"
            "  2. forge.external.url is https://me:secret@forge. Give it without a path."
        )
        judged = finding("values", judgement=Judgement((), text, "--values"))
        words = said(judged)
        assert len(judged.problems) == 2
        assert "images.platform is empty -> Give its reference." in words
        assert "secret" not in words

    def test_another_refusal_is_told_whole(self) -> None:
        assert "no template" in said(
            finding("values", judgement=Judgement((), "parse error: no template x", "--values"))
        )


class TestVersion:
    def test_an_older_one_is_refused(self) -> None:
        assert "v1.28.9+k3s1 is older than >=1.29.0-0" in said(finding("version", version="v1.28.9+k3s1"))
        newer = {"kubeVersion": ">=1.29.10"}
        assert "v1.29.9 is older than >=1.29.10" in said(finding("version", chart=newer, version="v1.29.9"))

    @pytest.mark.parametrize("version", ["v1.34.1+k3s1", "v1.29.0", "v1.29.0-gke.100", "1.30.2-eks-1552ad0"])
    def test_what_a_distribution_adds_to_it_says_nothing_of_its_age(self, version: str) -> None:
        judged = finding("version", version=version)
        assert (judged.result, judged.says) == (OK, f"{version}; the chart asks for >=1.29.0-0")

    def test_one_that_cannot_be_compared_is_not_ok(self) -> None:
        assert finding("version", chart={"kubeVersion": "~1.30 || ~1.32"}).result == NOT_CHECKED


class TestKinds:
    def test_a_kind_that_argo_cd_brings(self) -> None:
        served = dict(facts()["served"]) | {"argoproj.io/v1alpha1": frozenset()}
        words = said(finding("kinds", served=served))
        assert "kind AppProject of argoproj.io/v1alpha1 is not served -> install Argo CD" in words
        assert "TaskDescription" not in words, "the chart defines it itself"

    def test_admission_needs_its_policies(self) -> None:
        served = dict(facts()["served"]) | {"admissionregistration.k8s.io/v1": frozenset()}
        assert finding("kinds", served=served).result == OK
        settings = dict(facts()["settings"]) | {"admission": {"enabled": True}}
        assert "ValidatingAdmissionPolicy" in said(finding("kinds", served=served, settings=settings))


class TestOwners:
    def test_a_definition_of_somebody_else(self) -> None:
        there = {("CustomResourceDefinition", "taskdescriptions.robotkube.io"): {"metadata": {"name": "x"}}}
        words = said(finding("owners", standing=there))
        assert "it is there already, of no Helm release" in words
        assert "meta.helm.sh/release-name=robotkube" in words

    def test_what_another_release_has_and_what_this_one_has(self) -> None:
        def owned(release: str) -> dict[str, Any]:
            annotations = {"meta.helm.sh/release-name": release, "meta.helm.sh/release-namespace": "robotkube"}
            labels = {"app.kubernetes.io/managed-by": "Helm"}
            return {"metadata": {"name": "vehicle-00", "annotations": annotations, "labels": labels}}

        other, own = ({("Namespace", "vehicle-00"): owned(name)} for name in ("other", "robotkube"))
        assert "of release robotkube/other -> rename the agent" in said(finding("owners", standing=other))
        assert finding("owners", standing=own).result == OK

    def test_a_release_needs_its_namespace(self) -> None:
        assert "kubectl create namespace robotkube" in said(finding("owners", namespaces={"argocd": {}}))


class TestRelease:
    DEPLOYED = HelmRevision("0.1.0", "deployed", 3)

    def test_the_same_version_over_itself(self) -> None:
        judged = finding("release", release=self.DEPLOYED)
        assert (judged.result, "revision 3 of robotkube is deployed" in judged.says) == (OK, True)

    def test_an_operation_that_was_broken_off(self) -> None:
        release = HelmRevision("0.1.0", "pending-upgrade", 4)
        assert "helm rollback robotkube" in said(finding("release", release=release))
        assert "it is failed" in said(finding("release", release=HelmRevision("0.1.0", "failed", 4)))

    def test_a_newer_one_that_is_installed(self) -> None:
        assert "version 0.10.0 is installed" in said(finding("release", release=HelmRevision("0.10.0", "deployed", 1)))

    @pytest.mark.parametrize(
        ("installed", "own", "result"),
        [("0.2.0-rc.10", "0.2.0-rc.9", FAILED), ("0.2.0", "0.2.0-rc.10", FAILED), ("0.2.0-rc.9", "0.2.0-rc.10", OK)],
    )
    def test_pre_releases_have_an_order_too(self, installed: str, own: str, result: str) -> None:
        release = HelmRevision(installed, "deployed", 1)
        assert finding("release", release=release, chart={"version": own}).result == result

    def test_the_gate_of_an_earlier_version(self) -> None:
        def runs(replicas: int) -> ClusterFinding:
            gate = {"metadata": {"name": "gate"}, "spec": {"replicas": replicas}}
            return finding("release", release=self.DEPLOYED, namespace=PresentObjects([gate], ()))

        assert "scale deployment gate --replicas=0" in said(runs(1))
        assert runs(0).result == OK

    def test_robots_that_speak_clear_text(self) -> None:
        def serves(name: str, *ports: int) -> ClusterFinding:
            service = {"metadata": {"name": name}, "spec": {"ports": [{"port": port} for port in ports]}}
            return finding("release", release=self.DEPLOYED, namespace=PresentObjects((), [service]))

        for name, encrypted, plain in (("broker", 8883, 1883), ("database", 27018, 27017)):
            assert f"Connections to the {name} are encrypted" in said(serves(name, plain))
            assert serves(name, encrypted).result == OK
            assert serves(name, encrypted, plain).result == OK


class TestStorage:
    def test_no_default_class(self) -> None:
        judged = finding("storage", storage=Storage([DISKS], (), ()))
        assert "there is no default StorageClass -> name one of disks in storage.className" in said(judged)
        [problem] = judged.problems
        assert "volume claim robotkube/forge" in problem.where, "claims with the same problem stand together"

    def test_a_class_that_is_not_there(self) -> None:
        made = rendering("embedded")  # className: local
        assert "there is no StorageClass local" in said(
            finding("storage", rendering=made, storage=Storage([DISKS], (), ()))
        )

    def test_volumes_that_people_make(self) -> None:
        by_hand = {"metadata": DEFAULT_CLASS, "provisioner": "kubernetes.io/no-provisioner"}

        def volume(size: str) -> dict[str, Any]:
            spec = {"storageClassName": "local", "capacity": {"storage": size}, "accessModes": ["ReadWriteOnce"]}
            return {"spec": spec, "status": {"phase": "Available"}}

        assert "none is Available with 10Gi" in said(
            finding("storage", storage=Storage([by_hand], (), [volume("1Gi")]))
        )
        assert finding("storage", storage=Storage([by_hand], (), [volume("20Gi")])).result == OK

    def test_access_modes_that_no_api_tells_of(self) -> None:
        made = rendering()
        for item in made.of_kind("PersistentVolumeClaim"):
            item["spec"]["accessModes"] = ["ReadWriteMany"]  # type: ignore[index]
        judged = finding("storage", rendering=made)
        assert (judged.result, "whether class local gives ReadWriteMany" in judged.says) == (NOT_CHECKED, True)

    def test_a_claim_that_is_there_with_other_modes(self) -> None:
        claim = {
            "metadata": {"namespace": "cloud-0", "name": "recordings"},
            "spec": {"accessModes": ["ReadWriteMany"], "storageClassName": "local"},
        }
        other = {"metadata": {"namespace": "other", "name": "recordings"}}
        present = Storage(facts()["storage"].classes, [claim, other], ())
        assert "6 volume claims, 1 there already" in finding("storage", storage=present).says
        assert "accessModes is ReadWriteMany, the chart wants ReadWriteOnce" in said(
            finding("storage", storage=present)
        )


class TestPodSecurity:
    @pytest.mark.parametrize(("level", "result"), [("restricted", FAILED), ("baseline", FAILED), ("privileged", OK)])
    def test_a_pod_on_the_network_of_its_node(self, level: str, result: str) -> None:
        made = rendering()
        pod_of(made, "Deployment", "broker")["hostNetwork"] = True
        namespaces = {"robotkube": {"pod-security.kubernetes.io/enforce": level}}
        judged = finding("pod-security", rendering=made, namespaces=namespaces)
        assert judged.result == result
        if result == FAILED:
            assert "Deployment robotkube/broker: hostNetwork is true" in said(judged)

    @pytest.mark.parametrize(("level", "result"), [("restricted", FAILED), ("baseline", OK), ("", NOT_CHECKED)])
    def test_a_pod_without_seccomp(self, level: str, result: str) -> None:
        made = rendering()
        del pod_of(made, "Deployment", "broker")["securityContext"]["seccompProfile"]
        namespaces = {"robotkube": {"pod-security.kubernetes.io/enforce": level} if level else {}}
        assert finding("pod-security", rendering=made, namespaces=namespaces).result == result


class TestAdmission:
    def found(self, kind: str, name: str = "mesh", **changes: Any) -> ClusterFinding:
        """With one webhook or policy of somebody else."""
        rules = {"rules": [RULE], **changes}
        item = {"metadata": {"name": name}, "webhooks": [rules]}
        return finding("admission", judges={kind: [item]})

    def test_a_webhook_that_changes_pods_of_agents(self) -> None:
        words = said(self.found("MutatingWebhookConfiguration"))
        assert "MutatingWebhookConfiguration mesh: it changes pods of agents" in words
        assert "inspection.enabled: false" in words

    def test_one_that_is_kept_out_by_its_selectors(self) -> None:
        chosen = {"matchExpressions": [{"key": "robotkube.io/agent", "operator": "DoesNotExist"}]}
        ours = {
            "matchExpressions": [{"key": "app.kubernetes.io/part-of", "operator": "NotIn", "values": ["robotkube"]}]
        }
        others = {"matchLabels": {"injection": "enabled"}}
        assert self.found("MutatingWebhookConfiguration", namespaceSelector=others).result == OK
        assert self.found("MutatingWebhookConfiguration", objectSelector=ours).result == OK
        judged = self.found("MutatingWebhookConfiguration", namespaceSelector=chosen)
        assert (judged.result, "and what they say is not known" in judged.says) == (NOT_CHECKED, True), (
            "the platform's own"
        )

    def test_one_that_judges_alone_is_not_known(self) -> None:
        judged = self.found("ValidatingWebhookConfiguration")
        assert (judged.result, "ValidatingWebhookConfiguration mesh" in judged.says) == (NOT_CHECKED, True)

    @pytest.mark.parametrize(("resource", "result"), [("clusterroles", NOT_CHECKED), ("namespaces", OK)])
    def test_objects_of_the_whole_cluster_are_judged_wherever_a_webhook_looks(self, resource: str, result: str) -> None:
        rule = {"operations": ["*"], "apiGroups": ["*"], "resources": [resource]}
        elsewhere = {"matchLabels": {"team": "payments"}}
        judged = self.found("ValidatingWebhookConfiguration", rules=[rule], namespaceSelector=elsewhere)
        assert judged.result == result

    @pytest.mark.parametrize(("action", "result"), [("Deny", NOT_CHECKED), ("Warn", OK)])
    def test_policies_count_when_they_refuse(self, action: str, result: str) -> None:
        constraints = {"resourceRules": [RULE]}
        policy = {"metadata": {"name": "quotas"}, "spec": {"matchConstraints": constraints}}
        binding = {"metadata": {"name": "b"}, "spec": {"policyName": "quotas", "validationActions": [action]}}
        judges = {"ValidatingAdmissionPolicy": [policy], "ValidatingAdmissionPolicyBinding": [binding]}
        assert finding("admission", judges=judges).result == result

    def test_policies_from_files_are_not_said_to_be_none(self) -> None:
        """The embedded cluster guards all namespaces by such policies, and admission.enabled is false there."""
        judged = finding("admission")
        assert judged.result == OK
        assert "not written by the chart here (admission.enabled); 0 judges of others" in judged.says
        assert judged.says.endswith("policies that the API server reads from files it shows to nobody")

    def test_the_platforms_own_are_there_once_it_is_installed(self) -> None:
        settings = dict(facts()["settings"]) | {"admission": {"enabled": True}}
        assert finding("admission", settings=settings, installed=False).result == OK
        words = said(finding("admission", settings=settings, installed=True))
        assert "there is no policy robotkube-agents -> kubectl --namespace robotkube logs deployment/admission" in words


class TestAgents:
    def test_an_agent_without_a_node(self) -> None:
        words = said(finding("agents", nodes=NODES[1:]))
        assert "agent vehicle-00: no Node has the label robotkube.io/agent=vehicle-00" in words
        assert "robotkube.io/role=vehicle" in words

    def test_a_reserved_agent_needs_no_node_and_has_any_role(self) -> None:
        settings = facts()["settings"]
        reserved = {**settings, "agents": [*settings["agents"], {"name": "vehicle-16", "reserved": True}]}
        for nodes in (NODES, [*NODES, node("vehicle-16", "edge")]):
            judged = finding("agents", settings=reserved, nodes=nodes)
            assert (judged.result, judged.says.partition(",")[0]) == (OK, "4 agents in the values (1 reserved)")

    def test_a_node_of_nobody(self) -> None:
        assert "names no agent of the values -> declare it" in said(finding("agents", nodes=[*NODES, node("stray")]))

    def test_a_role_and_a_capability_that_differ(self) -> None:
        wrong = node("cloud-0", "edge")
        wrong["metadata"]["labels"]["robotkube.io/capability.lidar"] = "yes"
        words = said(finding("agents", nodes=[*NODES[:2], wrong]))
        assert "label robotkube.io/role is edge, the values say cloud" in words
        assert "kubectl label node cloud-0 robotkube.io/capability.lidar=true" in words

    def test_a_node_that_is_not_ready_or_takes_no_pods(self) -> None:
        lost = node("vehicle-00")
        lost["status"]["conditions"] = [{"type": "Ready", "status": "Unknown", "message": "kubelet stopped"}]
        words = said(finding("agents-ready", nodes=[lost, node("vehicle-01", unschedulable=True)]))
        assert "Node vehicle-00: it is not Ready: kubelet stopped" in words
        assert "kubectl uncordon vehicle-01" in words

    def test_no_node_of_an_agent_is_no_ready_one(self) -> None:
        assert finding("agents-ready", nodes=[]).result == NOT_CHECKED

    def test_control_groups_of_version_1(self) -> None:
        words = said(finding("control-groups", control_groups={"old": 1, "new": 2}))
        assert "Node old: control groups are of version 1" in words

    @pytest.mark.parametrize(("version", "result"), VERSIONS_OF_KUBELETS)
    def test_a_kubelet_that_runs_on_version_1_was_told_to(self, version: str, result: str) -> None:
        """Since 1.35 it does not start there by itself, as on the embedded cluster, where it was told."""
        own = node("vehicle-00")
        own["status"]["nodeInfo"] = {"kubeletVersion": version}
        judged = finding("control-groups", control_groups={"vehicle-00": 1}, nodes=[own])
        assert judged.result == result
        assert ("failCgroupV1: false" in judged.says) == (result == OK)

    def test_a_node_of_the_platform_is_no_agents(self) -> None:
        assert finding("agents", nodes=[*NODES, node("platform-0", "platform")]).result == OK

    @pytest.mark.parametrize("groups", [{"a": 2, "b": Unread("forbidden: nodes/proxy")}, {}])
    def test_control_groups_that_nobody_told_of(self, groups: Any) -> None:
        assert finding("control-groups", control_groups=groups).result == NOT_CHECKED


class TestCapacity:
    def test_nothing_left_beside_other_pods(self) -> None:
        containers = [{"resources": {"requests": {"cpu": "100m", "memory": "7900Mi"}}}]
        pods = [
            {"metadata": {"namespace": "other"}, "spec": {"nodeName": name, "containers": containers}}
            for name in AGENTS
        ]
        words = said(finding("capacity", pods=pods))
        assert "none of its Nodes (vehicle-00, vehicle-01, cloud-0) has" in words
        assert "resources.requests" in words

    def test_the_platforms_own_pods_are_counted_once(self) -> None:
        labels = {"app.kubernetes.io/part-of": "robotkube"}
        containers = [{"resources": {"requests": {"memory": "8Gi"}}}]
        own = {"metadata": {"namespace": "robotkube", "labels": labels}}
        pods = [{**own, "spec": {"nodeName": name, "containers": containers}} for name in AGENTS]
        assert finding("capacity", pods=pods).result == OK

    def test_what_a_pod_asks_for(self) -> None:
        def container(memory: str, **more: Any) -> dict[str, Any]:
            return {"resources": {"requests": {"memory": memory}}, **more}

        both = [container("1Gi"), {"resources": {"limits": {"memory": "1Gi"}}}]
        assert requests({"containers": both})["memory"] == 2 * 2**30, "a limit alone is a request as well"
        assert requests({"containers": both, "initContainers": [container("3Gi")]})["memory"] == 3 * 2**30
        sidecar = container("3Gi", restartPolicy="Always")
        assert requests({"containers": both, "initContainers": [sidecar]})["memory"] == 5 * 2**30

    def test_labels_and_taints(self) -> None:
        made = rendering("embedded")  # nodeSelector and toleration of role platform
        assert "robotkube.io/role=platform" in said(finding("capacity", rendering=made))
        taint = {"key": "robotkube.io/role", "value": "platform", "effect": "NoSchedule"}
        platform = node("platform", "platform", taints=[taint])
        assert finding("capacity", rendering=made, nodes=[platform]).result == OK
        other = node("platform", "platform", taints=[taint, {"key": "disk", "effect": "NoExecute"}])
        assert "no taint beyond its tolerations" in said(finding("capacity", rendering=made, nodes=[other]))


class TestArgoCd:
    def test_a_part_that_is_not_there_or_not_ready(self) -> None:
        present = argo_cd(server=None, **{"repo-server": part_of_argo_cd("repo-server", ready=0)})
        words = said(finding("argocd", argocd=present))
        assert "no Deployment or StatefulSet of server -> install Argo CD there, or name its namespace" in words
        assert "no pod of argocd-repo-server is ready" in words

    def test_definitions_that_are_not_there(self) -> None:
        present = argo_cd()
        bare = replace(present, definitions=frozenset())
        assert "there is no definition appprojects.argoproj.io" in said(finding("argocd", argocd=bare))

    @pytest.mark.parametrize("image", ["registry.example/argocd@sha256:12", "quay.io/argoproj/argocd:v2.14.1"])
    def test_a_version_that_nobody_tried_or_knows(self, image: str) -> None:
        parts = {part: part_of_argo_cd(part, image) for part in ("server", "repo-server")}
        controllers = {
            part: part_of_argo_cd(part, image) for part in ("application-controller", "applicationset-controller")
        }
        assert finding("argocd", argocd=argo_cd(**parts, **controllers)).result == NOT_CHECKED

    @pytest.mark.parametrize(("label", "result"), [("v3.5.7", OK), ("v2.14.1", NOT_CHECKED), ("new", NOT_CHECKED)])
    def test_a_version_that_only_labels_say(self, label: str, result: str) -> None:
        """As the embedded cluster's Argo CD, whose images are named by digest."""
        present = argo_cd(**{part: part_of_argo_cd(part, "registry.example/argocd@sha256:12") for part in PARTS})
        for workload in present.workloads:
            workload["metadata"]["labels"]["app.kubernetes.io/version"] = label
        judged = finding("argocd", argocd=present)
        assert judged.result == result
        assert ("version 3.5 (label app.kubernetes.io/version) in namespace argocd" in judged.says) == (result == OK)


class TestRegistries:
    @pytest.mark.parametrize(
        ("answer", "result"),
        [
            (RegistryAnswer(200), OK),
            (RegistryAnswer(401, 'Basic realm="registry"'), OK),
            (RegistryAnswer(401, 'Bearer realm="https://auth.example/token?account=me",service="r"'), OK),
            (RegistryAnswer(401, ""), FAILED),
            (RegistryAnswer(404), FAILED),
            (RegistryAnswer(refused="certificate verify failed"), FAILED),
            (RegistryAnswer(silent="timed out: no answer within 4 s"), NOT_CHECKED),
        ],
    )
    def test_what_it_answers(self, answer: RegistryAnswer, result: str) -> None:
        judged = finding("registries", registries={"registry.example": answer})
        assert judged.result == result
        assert "account=me" not in judged.says
        if result == FAILED:
            said(judged)

    def test_hosts_of_images(self) -> None:
        assert host_of("mongo:8") == host_of("library/mongo:8") == "docker.io"
        assert host_of("registry.example:5000/a/b@sha256:1") == "registry.example:5000"
        assert service_of("forge.robotkube.svc.cluster.local:3000") == ("robotkube", "forge")
        assert service_of("registry.example:5000") is None


def test_problems_that_differ_in_their_places_alone_are_one() -> None:
    same = [Problem("what", f"place {number}", "why", "fix") for number in range(8)]
    problems = gathered([*same, same[0], Problem("else", "place 1", "why", "fix")])
    assert [problem.where for problem in problems] == [
        ", ".join(f"place {number}" for number in range(6)) + " and 2 more",
        "place 1",
    ]
