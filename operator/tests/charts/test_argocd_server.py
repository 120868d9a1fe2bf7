"""How managers reach argocd-server, as the values say: address, certificate, and where that is mounted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.delivery.manager.__main__ import read_configuration
from robotkube.foundation.runtime.settings_file import read_settings
from tests.stages.paths import CHARTS
from tests.stages.settings_mounted import mounted, pod_of

pytestmark = pytest.mark.toolchain

FOLDER = Path(__file__).parent / "profiles"
PLATFORM, PROFILE = CHARTS / "robotkube", FOLDER / "official.yaml"
CERTIFICATE = "-----BEGIN CERTIFICATE-----\nMIIDJDCCAgygAwIBAgIR\n-----END CERTIFICATE-----\n"


def test_an_argo_cd_that_speaks_https_renders_as_committed(
    helm: Any, official: Any, golden: Callable[[str, str], None]
) -> None:
    """What differs from the platform whose Argo CD answers in clear text."""
    known = set(official.text.split("---\n"))
    shown = helm.template(PLATFORM, PROFILE, FOLDER / "argocd-server.yaml").text.split("---\n")
    golden("argocd-server", "---\n".join(["", *(part for part in shown if part not in known)]))


@pytest.mark.parametrize(
    ("given", "url"),
    [
        ({}, "http://argocd-server.argocd.svc.cluster.local"),
        ({"authorities": CERTIFICATE}, "https://argocd-server.argocd.svc.cluster.local"),
        ({"url": "https://argocd.example.com/cd"}, "https://argocd.example.com/cd"),
        ({"url": "https://cd.example.com:8443", "authorities": CERTIFICATE}, "https://cd.example.com:8443"),
    ],
)
def test_managers_reach_argocd_server_as_the_values_say(helm: Any, given: dict[str, str], url: str) -> None:
    """Its certificate is mounted where the settings name it, as a folder, so that another one arrives by itself."""
    rendered = helm.template(PLATFORM, PROFILE, argocd={"server": given})
    data = rendered.one("ConfigMap", "manager")["data"]
    settings = yaml.safe_load(data["config.yaml"])["argocd"]
    assert settings["url"] == url
    pod = pod_of(rendered, "manager")
    mounts = [one for one in pod["containers"][0]["volumeMounts"] if one["name"] == "argocd"]
    if "authorities" not in given:
        assert ("authorities" in settings, "argocd.crt" in data, mounts) == (False, False, [])
        return
    [volume] = [one for one in pod["volumes"] if one["name"] == "argocd"]
    [item] = volume["configMap"]["items"]
    assert (volume["configMap"]["name"], data[item["key"]]) == ("manager", CERTIFICATE)
    assert [f"{one['mountPath']}/{item['path']}" for one in mounts] == [settings["authorities"]]
    assert "subPath" not in mounts[0]


def test_the_manager_reads_what_the_chart_writes(helm: Any, tmp_path: Path) -> None:
    rendered = helm.template(PLATFORM, PROFILE, FOLDER / "argocd-server.yaml")
    settings = read_settings(mounted(rendered, "manager", tmp_path), read_configuration)
    assert settings.argocd_url == "https://argocd-server.argocd.svc.cluster.local"
    assert settings.argocd_authorities == Path("/etc/robotkube/argocd/ca.crt")
