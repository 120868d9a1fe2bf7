"""The check `argocd`: whether managers reach argocd-server as it answers, and its parts have names that the platform
knows."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from robotkube.delivery.preflight.core.findings import FAILED, NOT_CHECKED, OK, ClusterFinding, Unread
from tests.stages.delivery.preflight.preflight_facts import argo_cd, facts, finding, part_of_argo_cd, said

CERTIFICATE = {"argocd": {"server": {"authorities": "-----BEGIN CERTIFICATE-----"}}}


def judged_with(
    parameters: Any = None, ports: Any = frozenset({80, 443}), values: Any = None, **server: Any
) -> ClusterFinding:
    """The finding; `server` is what its container has besides."""
    present = argo_cd()
    for workload in present.workloads:
        if workload["metadata"]["name"] == "argocd-server":
            workload["spec"]["template"]["spec"]["containers"][0].update(server)
    changed = replace(present, parameters={} if parameters is None else parameters, ports=ports)
    return finding("argocd", argocd=changed, settings=facts()["settings"] | (values or {}))


def test_one_by_its_own_manifests_redirects_who_asks_in_clear_text() -> None:
    """Its ConfigMap has no data at all."""
    judged = judged_with()
    assert judged.result == FAILED
    [problem] = judged.problems
    url = "http://argocd-server.argocd.svc.cluster.local"
    assert problem.what == f"it redirects to HTTPS, and managers ask {url}"
    assert problem.where == "Deployment argocd/argocd-server"
    assert "release waits until Argo CD polls" in problem.why
    assert problem.fix.startswith("argocd.server.authorities: the certificate that it shows (kubectl --namespace")
    assert "{.data.tls\\.crt}" in problem.fix


def test_it_is_asked_by_https_where_its_certificate_is_given() -> None:
    judged = judged_with(values=CERTIFICATE)
    assert (judged.result, judged.says) == (OK, "version 3.5 in namespace argocd, asked by HTTPS")


@pytest.mark.parametrize(
    "server",
    [
        {"args": ["--insecure"]},
        {"args": ["--insecure=true"]},
        {"command": ["argocd-server", "--insecure"], "args": ["--loglevel", "info"]},
        {"env": [{"name": "ARGOCD_SERVER_INSECURE", "value": "true"}]},
    ],
)
def test_one_that_is_told_otherwise_to_speak_clear_text(server: Any) -> None:
    judged = judged_with(**server)
    assert (judged.result, judged.says) == (OK, "version 3.5 in namespace argocd, asked by HTTP")
    assert "it speaks no TLS (server.insecure), and managers ask https://" in said(
        judged_with(values=CERTIFICATE, **server)
    )


def test_a_flag_stands_above_the_parameters() -> None:
    judged = judged_with({"server.insecure": "true"}, args=["--insecure=false"])
    assert "it redirects to HTTPS" in said(judged)


def test_a_root_path_belongs_to_the_address() -> None:
    parameters = {"server.insecure": "true", "server.rootpath": "/cd/"}
    host = "argocd-server.argocd.svc.cluster.local"
    assert f"its API is below http://{host}/cd (server.rootpath), and managers ask http://{host} -> " in said(
        judged_with(parameters)
    )
    assert f"-> argocd.server.url: http://{host}/cd" in said(judged_with(parameters))
    given = {"argocd": {"server": {"url": f"http://{host}/cd"}}}
    assert judged_with(parameters, values=given).result == OK
    assert "its API is below" in said(judged_with({}, values=CERTIFICATE, args=["--rootpath", "cd"]))


def test_a_service_that_is_not_there_or_has_other_ports() -> None:
    insecure = {"server.insecure": "true"}
    assert "there is no Service argocd-server -> install Argo CD's own Service" in said(judged_with(insecure, None))
    assert "it has no port 80, at which managers ask" in said(judged_with(insecure, frozenset({443})))
    given = {"argocd": {"server": {"url": "https://argocd-server.argocd.svc:8443"}}}
    assert "it has no port 8443" in said(judged_with({}, values=given))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"parameters": Unread("configmaps is forbidden")}, "configmaps is forbidden"),
        ({"ports": Unread("services is forbidden"), "values": CERTIFICATE}, "services is forbidden"),
        ({"envFrom": [{"configMapRef": {"name": "mine"}}], "env": []}, "may come by envFrom"),
        (
            {
                "env": [
                    {
                        "name": "ARGOCD_SERVER_INSECURE",
                        "valueFrom": {"configMapKeyRef": {"name": "mine", "key": "x"}},
                    }
                ]
            },
            "does not come from ConfigMap argocd-cmd-params-cm",
        ),
    ],
)
def test_what_cannot_be_looked_at_is_said(changes: Any, words: str) -> None:
    judged = judged_with(**changes)
    assert judged.result == NOT_CHECKED
    assert "how argocd-server answers is not known: " in judged.says
    assert words in judged.says


def test_an_address_elsewhere_is_not_tried_from_here() -> None:
    judged = judged_with(values={"argocd": {"server": {"url": "https://argocd.example.com"}}})
    assert judged.result == NOT_CHECKED
    assert "whether managers reach https://argocd.example.com (argocd.server.url) is not tried" in judged.says


def test_names_of_another_release_are_not_known_to_the_platform() -> None:
    server = part_of_argo_cd("server")
    server["metadata"]["name"] = "argo-cd-argocd-server"
    words = said(finding("argocd", argocd=argo_cd(server=server)))
    assert "server has the name argo-cd-argocd-server -> install it from its own manifests, or with Helm as" in words
