"""The platform chart's admission: a process that writes policies and list, and what it may. The policies are those of
the embedded cluster's files, as objects that an administrator can delete."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ci.cluster.embedded.admission import admission_files
from robotkube.foundation.runtime.settings_file import read_settings
from robotkube.registry.admission import __main__ as process
from robotkube.registry.admission.core.domain import Domain, account
from robotkube.registry.admission.core.policies import API_POLICIES, LIST, PLATFORM_LIST, for_api, platform_entries
from robotkube.setup import bootstrap
from tests.charts.conftest import PLATFORM, PROFILES, Helm, Rendered
from tests.stages.settings_mounted import mounted

pytestmark = pytest.mark.toolchain
FILES = (PLATFORM / "values-embedded.yaml", PROFILES / "embedded.yaml")
VERBS = ["get", "create", "patch", "update", "delete"]


@pytest.fixture(scope="module")
def rendered(helm: Helm) -> Rendered:
    return helm.template(PLATFORM, *FILES, admission={"enabled": True})


def domain(embedded: Rendered, remover: str = "") -> Domain:
    namespaces = [item["metadata"] for item in embedded.of_kind("Namespace")]
    agents = sorted(item["name"] for item in namespaces if "robotkube.io/agent" in item["labels"])
    tests = sorted(item["name"] for item in namespaces if item["name"].startswith("robotkube-suite-"))
    return Domain(tuple(agents), tuple(tests), admission_files.CHARTS, remover=remover)


def of_admission(rendered: Rendered) -> set[tuple[str, str]]:
    labels = [(item, item["metadata"].get("labels", {})) for item in rendered.objects]
    key = "app.kubernetes.io/component"
    return {(item["kind"], item["metadata"]["name"]) for item, own in labels if own.get(key) == "admission"}


def test_without_the_value_there_is_nothing_of_it(embedded: Rendered) -> None:
    assert of_admission(embedded) == set()
    assert not [item for item in embedded.objects if "admission" in item["metadata"]["name"]]


def test_helm_installs_the_process_and_the_platforms_list_and_no_policy(rendered: Rendered) -> None:
    """What the process writes has one writer."""
    assert of_admission(rendered) == {
        ("ServiceAccount", "admission"),
        ("Service", "admission"),
        ("Deployment", "admission"),
        ("ConfigMap", "admission"),
        ("ConfigMap", PLATFORM_LIST),
        ("ClusterRole", "robotkube-admission"),
        ("ClusterRoleBinding", "robotkube-admission"),
        ("Role", "robotkube-admission"),
        ("RoleBinding", "robotkube-admission"),
    }


def test_the_process_reads_what_the_chart_writes_and_judges_this_installation(
    rendered: Rendered, tmp_path: Path
) -> None:
    settings = read_settings(mounted(rendered, "admission", tmp_path), process.read_configuration)
    assert settings.domain == domain(rendered)
    assert settings.forge.account.username == "admission"
    assert (settings.listen.port, settings.listen.health_port) == (8080, 8081)
    keys = rendered.one("ConfigMap", "evidence-keys", None)["data"]
    assert {path.name for path in settings.evidence_keys.iterdir()} == set(keys)


def test_the_remover_is_named_where_it_is_enabled(helm: Helm, tmp_path: Path) -> None:
    """Where it is not, nobody but Argo CD changes a workload."""
    rendering = helm.template(PLATFORM, *FILES, admission={"enabled": True}, remover={"enabled": True})
    read = read_settings(mounted(rendering, "admission", tmp_path), process.read_configuration)
    assert read.domain == domain(rendering, "remover")
    [remover] = [
        item for item in rendering.of_kind("ServiceAccount") if item["metadata"]["name"] == read.domain.remover
    ]
    assert read.domain.remover_account == account(remover["metadata"].get("namespace", "robotkube"), "remover")
    assert read.domain.remover_account in str(for_api(read.domain))


def test_the_gates_namespace_is_judged_as_the_platforms(helm: Helm, tmp_path: Path) -> None:
    rendering = helm.template(PLATFORM, *FILES, admission={"enabled": True}, gate={"namespace": "signing"})
    read = read_settings(mounted(rendering, "admission", tmp_path), process.read_configuration)
    assert read.domain.of_the_platform == ("robotkube", "signing")


def test_without_agents_and_suites_it_judges_none(helm: Helm, tmp_path: Path) -> None:
    values: dict[str, Any] = {"admission": {"enabled": True}, "agents": [], "suites": {"enabled": False}}
    rendering = helm.template(PLATFORM, *FILES, **values)
    read = read_settings(mounted(rendering, "admission", tmp_path), process.read_configuration)
    assert (read.domain.agents, read.domain.tests) == ((), ())


def test_the_forge_knows_its_account_and_calls_it_for_the_catalogue_alone(rendered: Rendered, tmp_path: Path) -> None:
    own = read_settings(mounted(rendered, "admission", tmp_path / "own"), process.read_configuration)
    made = read_settings(mounted(rendered, "bootstrap", tmp_path / "bootstrap"), bootstrap.read_configuration).forge
    assert made is not None
    assert [one.password for one in made.setup.accounts if one.name == "admission"] == [own.forge.account.password]
    access = {repository.name: repository.access.get("admission", "none") for repository in made.setup.repositories}
    assert access == {"robotkube/deployment": "none", "robotkube/catalogue": "read"}
    assert not [organisation for organisation in made.setup.organisations if "admission" in organisation.packages]
    [hook] = [webhook for webhook in made.setup.webhooks if "//admission." in webhook.url]
    assert (hook.repository, hook.url) == (
        "robotkube/catalogue",
        "https://admission.robotkube.svc.cluster.local:8080/webhook",
    )
    assert hook.secret == own.webhook_secret
    assert hook.secret not in [webhook.secret for webhook in made.setup.webhooks if webhook is not hook]


def test_its_account_writes_these_names_and_nothing_else(rendered: Rendered) -> None:
    [writing, watching, parameters, itself] = rendered.one("ClusterRole", "robotkube-admission")["rules"]
    assert (sorted(writing["resourceNames"]), writing["verbs"]) == (sorted(API_POLICIES), VERBS)
    assert watching["verbs"] == ["list", "watch"]
    assert (parameters["resources"], parameters["resourceNames"], parameters["verbs"]) == (
        ["configmaps"],
        ["*"],
        ["get"],
    )
    assert (itself["resourceNames"], itself["verbs"]) == (["robotkube-admission"], ["get"])
    [own, platform] = rendered.one("Role", "robotkube-admission")["rules"]
    assert own["resourceNames"] == [LIST]
    assert (platform["resourceNames"], platform["verbs"]) == ([PLATFORM_LIST], ["get"])


def test_its_pod_holds_no_signing_key_and_is_restricted(rendered: Rendered) -> None:
    pod = dict(rendered.pods)["Deployment/admission"]
    sources = [source for one in pod["volumes"] for source in one.get("projected", {}).get("sources", ())]
    names = {source["secret"]["name"] for source in sources if "secret" in source}
    assert names == {"forge-account-admission", "forge-webhook-admission", "admission-tls"}
    [container] = pod["containers"]
    assert pod["securityContext"]["runAsNonRoot"]
    assert container["securityContext"] == {
        "allowPrivilegeEscalation": False,
        "readOnlyRootFilesystem": True,
        "capabilities": {"drop": ["ALL"]},
    }
    assert {"startupProbe", "readinessProbe", "livenessProbe"} <= set(container)


def test_what_people_set_for_its_pod_reaches_it(helm: Helm) -> None:
    given = {
        "nodeSelector": {"disk": "fast"},
        "podLabels": {"team": "fleet"},
        "podAnnotations": {"example.com/scrape": "true"},
        "extraEnv": [{"name": "HTTP_PROXY", "value": "http://exit.example:3128"}],
        "priorityClassName": "platform-critical",
        "resources": {"requests": {"cpu": "30m"}},
    }
    rendering = helm.template(PLATFORM, *FILES, admission={"enabled": True, **given})
    template = rendering.one("Deployment", "admission")["spec"]["template"]
    assert template["metadata"]["labels"]["team"] == "fleet"
    assert template["metadata"]["annotations"]["example.com/scrape"] == "true"
    spec = template["spec"]
    assert (spec["nodeSelector"], spec["priorityClassName"]) == ({"disk": "fast"}, "platform-critical")
    [container] = spec["containers"]
    assert container["env"][-1]["name"] == "HTTP_PROXY"
    assert container["resources"]["requests"] == {"cpu": "30m", "memory": "96Mi"}


def test_it_reaches_forge_and_api_server_and_the_forge_reaches_it(rendered: Rendered) -> None:
    policy = rendered.one("NetworkPolicy", "admission", "robotkube")["spec"]
    assert policy["podSelector"]["matchLabels"]["app.kubernetes.io/component"] == "admission"
    called = {
        peer["podSelector"]["matchLabels"]["app.kubernetes.io/component"] for peer in policy["ingress"][0]["from"]
    }
    assert (called, policy["ingress"][0]["ports"]) == ({"forge"}, [{"port": 8080, "protocol": "TCP"}])
    assert sorted(port["port"] for rule in policy["egress"] for port in rule["ports"]) == [53, 53, 3000, 6443]


def test_the_platforms_images_are_listed_by_the_chart(rendered: Rendered) -> None:
    """By Helm, and before the Deployments: the process's own pod has to be among them."""
    listed = rendered.one("ConfigMap", PLATFORM_LIST)["data"]
    images = {c["image"] for _, spec in rendered.pods for c in [*spec["containers"], *spec.get("initContainers", [])]}
    assert set(platform_entries(image.partition("@")[2] for image in images)) <= set(listed)


def test_an_image_by_tag_is_refused_with_the_fix(helm: Helm) -> None:
    said = helm.refusal(PLATFORM, PROFILES / "official.yaml", admission={"enabled": True})
    assert 'admission.enabled is true, but images.gitea is "docker.io/gitea/gitea:' in said
    assert "Give <repository>@sha256:<digest>, or set admission.enabled: false." in said
