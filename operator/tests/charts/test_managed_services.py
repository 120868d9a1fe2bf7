"""The values that pages give for a broker, a database and a forge of others: what is installed then, and where
everybody connects."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.delivery.preflight.core.values import merged
from tests.stages.paths import CHARTS, DOCS

pytestmark = pytest.mark.toolchain

PLATFORM = CHARTS / "robotkube"
OFFICIAL = Path(__file__).parent / "profiles" / "official.yaml"
PAGES = [DOCS / "how-to" / name for name in ("use-a-managed-broker-and-database.md", "use-another-forge.md")]
BLOCK = re.compile(r"^```yaml\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INSTALLED = {"broker": "Deployment/broker", "database": "StatefulSet/database", "forge": "StatefulSet/forge"}


def example(*parts: str) -> dict[str, Any]:
    """The one example that is about these, and about nothing else that is installed."""
    blocks = [yaml.safe_load(text) for page in PAGES for text in BLOCK.findall(page.read_text(encoding="utf-8"))]
    [found] = [one for one in blocks if INSTALLED.keys() & one.keys() == set(parts)]
    return dict(found)


@pytest.mark.parametrize("part", INSTALLED)
def test_nothing_is_installed_of_what_others_have(helm: Any, official: Any, part: str) -> None:
    workloads = {name for name, _ in helm.template(PLATFORM, OFFICIAL, **example(part)).pods}
    before = {name for name, _ in official.pods}
    assert INSTALLED[part] in before - workloads
    assert {name for other, name in INSTALLED.items() if other != part} <= workloads


def test_everybody_connects_to_the_broker_of_others(helm: Any) -> None:
    rendered = helm.template(PLATFORM, OFFICIAL, **example("broker"))
    accounts = [one for one in rendered.of_kind("Secret") if one["metadata"]["name"].startswith("broker-account")]
    assert {(one["stringData"]["host"], one["stringData"]["port"]) for one in accounts} == {
        ("mqtt.example.com", "8883")
    }
    settings = yaml.safe_load(rendered.one("ConfigMap", "manager")["data"]["config.yaml"])
    assert (settings["broker"]["host"], settings["broker"]["port"]) == ("mqtt.example.com", 8883)
    assert opened(rendered, "manager", 8883) == ["198.51.100.7/32"]
    assert "Deployment/rights" not in {name for name, _ in rendered.pods}


def test_everybody_connects_to_the_database_of_others(helm: Any) -> None:
    rendered = helm.template(PLATFORM, OFFICIAL, **example("database"))
    account = rendered.one("Secret", "database-account", "cloud-0")["stringData"]
    assert (account["host"], account["port"], account["tls"]) == ("mongo.example.com", "27017", "required")
    assert "Job/installation-test" not in {name for name, _ in rendered.pods}


def test_broker_and_database_of_others_in_one_file(helm: Any) -> None:
    rendered = helm.template(PLATFORM, OFFICIAL, **example("broker", "database"))
    workloads = {name for name, _ in rendered.pods}
    assert {
        INSTALLED["broker"],
        INSTALLED["database"],
        "Deployment/rights",
        "Deployment/certificates",
    } & workloads == set()
    account = rendered.one("Secret", "broker-account", "cloud-0")["stringData"]
    assert (account["host"], account["port"], account["tls"]) == ("mqtt.example.com", "8883", "required")
    assert (account["identity"], account["username"]) == ("password", "cloud-0")
    both = ["198.51.100.7/32", "198.51.100.8/32"]
    assert (opened(rendered, "manager", 8883), opened(rendered, "recorder", 27017)) == (both, both)
    refused = helm.refusal(PLATFORM, OFFICIAL, **merged(example("broker"), example("database")))
    assert "tls.provided.database is given, but tls.mode is provided and database.kind external" in refused


def test_everybody_connects_to_the_forge_of_others(helm: Any) -> None:
    rendered = helm.template(PLATFORM, OFFICIAL, **example("forge"))
    forge = yaml.safe_load(rendered.one("ConfigMap", "manager")["data"]["config.yaml"])["forge"]
    assert forge["url"] == "https://gitlab.example.com"
    assert (forge["kind"], forge["api"]) == ("gitlab", "https://gitlab.example.com/api/v4")


def test_what_one_makes_there_is_what_the_chart_makes_on_its_own(official: Any) -> None:
    blocks = [yaml.safe_load(text) for text in BLOCK.findall(PAGES[1].read_text(encoding="utf-8"))]
    [page] = [one for one in blocks if "packages" in one]
    made = yaml.safe_load(official.one("ConfigMap", "bootstrap")["data"]["config.yaml"])["forge"]
    assert page["repositories"] == {one["name"]: one["access"] for one in made["repositories"]}
    assert page["packages"] == {one["name"]: one["packages"] for one in made["organisations"]}
    hooks = [(hook["repository"], hook["url"].split("/")[2].split(".")[0], hook["events"]) for hook in made["webhooks"]]
    assert sorted(hooks) == sorted(
        (name, to, events) for name, of in page["webhooks"].items() for to, events in of.items()
    )
    named = {
        account for accounts in (*page["repositories"].values(), *page["packages"].values()) for account in accounts
    }
    assert named == {one["name"] for one in made["accounts"]}


def opened(rendered: Any, name: str, port: int) -> list[str]:
    """The addresses outside of the cluster to which the policy of this name lets its pods, at a port."""
    [rules] = [one["spec"]["egress"] for one in rendered.of_kind("NetworkPolicy") if one["metadata"]["name"] == name]
    return [
        peer["ipBlock"]["cidr"]
        for rule in rules
        if port in [one["port"] for one in rule.get("ports", ())]
        for peer in rule.get("to", ())
        if "ipBlock" in peer
    ]
