"""Who makes the certificates of broker, database and forge: what the chart renders for each `tls.mode`, compared with a
kept rendering for cert-manager, which does not run here."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.delivery.certificates.settings import FORMER_KEYS, read_configuration
from robotkube.foundation.runtime.settings_file import read_settings
from tests.stages.paths import CHARTS
from tests.stages.settings_mounted import mounted

pytestmark = pytest.mark.toolchain

PLATFORM = CHARTS / "robotkube"
PROFILES = Path(__file__).parent / "profiles"
OFFICIAL = PROFILES / "official.yaml"
AUTHORITIES = "/etc/robotkube/authorities"
ASKING = {"manager", "gate", "rights", "inspector", "suite-runner", "bootstrap"}
AUTHORITY = "-----BEGIN CERTIFICATE-----\nMIIB\n-----END CERTIFICATE-----\n"
AGENTS = ("vehicle-00", "vehicle-01", "cloud-0")
OURS = {"Deployment/certificates", "ConfigMap/certificates", "Role/certificates", "Secret/tls-authority"}
EMBEDDED = (PLATFORM / "values-embedded.yaml", PROFILES / "embedded.yaml")
KINDS = {"mongo": (OFFICIAL,), "ferretdb": EMBEDDED}


def names(rendered: Any) -> set[str]:
    return {f"{one['kind']}/{one['metadata']['name']}" for one in rendered.objects}


def ports(rendered: Any) -> list[int]:
    """The ports at which the broker listens: the same in its settings, its pod and its Service."""
    text = rendered.one("ConfigMap", "broker")["data"]["mosquitto.conf"]
    numbers = [int(line.split()[1]) for line in text.splitlines() if line.startswith("listener ")]
    [container] = dict(rendered.pods)["Deployment/broker"]["containers"]
    assert [port["containerPort"] for port in container["ports"]] == numbers
    assert [port["port"] for port in rendered.one("Service", "broker")["spec"]["ports"]] == numbers
    assert {container[probe]["tcpSocket"]["port"] for probe in container if probe.endswith("Probe")} == {
        container["ports"][0]["name"]
    }
    return numbers


def accounts(rendered: Any) -> set[tuple[str, str]]:
    """Port and `tls` of everybody's account."""
    secrets = [one["stringData"] for one in rendered.of_kind("Secret") if "host" in one.get("stringData", {})]
    return {(secret["port"], secret["tls"]) for secret in secrets if secret["host"].startswith(("broker.", "mqtt."))}


def reached(rendered: Any, whom: str = "broker", agent: str = "vehicle-00") -> set[int]:
    """The ports at which policies let pods of an agent reach the broker."""
    policies = [one for one in rendered.of_kind("NetworkPolicy") if one["metadata"]["namespace"] == agent]
    egress = [rule for policy in policies for rule in policy["spec"].get("egress", ())]
    return {port["port"] for rule in egress if whom in str(rule.get("to")) for port in rule["ports"]}


def database_listens(rendered: Any) -> tuple[set[int], dict[int, str]]:
    """The database's ports in its pod, each of which its arguments name, and those of its Service with their targets.
    The probes ask the first one."""
    [container] = dict(rendered.pods)["StatefulSet/database"]["containers"]
    opened = {port["name"]: port["containerPort"] for port in container["ports"]}
    arguments = " ".join(container.get("args", ["27017"]))
    assert all(str(port) in arguments for port in opened.values())
    probes = {container[probe]["tcpSocket"]["port"] for probe in container if probe.endswith("Probe")}
    assert probes == {container["ports"][0]["name"]}
    service = rendered.one("Service", "database")["spec"]["ports"]
    return set(opened.values()), {port["port"]: opened[port["targetPort"]] for port in service}


def database_account(rendered: Any) -> tuple[str, str]:
    """Port and `tls` of the recorder's account; the bootstrap Job goes the same way."""
    account = rendered.one("Secret", "database-account", "cloud-0")["stringData"]
    settings = yaml.safe_load(rendered.one("ConfigMap", "bootstrap")["data"]["config.yaml"])["database"]
    assert (settings["port"], settings["host"]) == (int(account["port"]), account["host"])
    assert ("authorities" in settings) == (account["tls"] == "required")
    return account["port"], account["tls"]


def trusted(rendered: Any) -> set[str]:
    """What stands in ConfigMap robotkube-ca of platform and agents, and of the gate where it asks a forge by TLS."""
    by_tls = forge_url(rendered).startswith("https:")
    places = ["robotkube", *(["robotkube-gate"] if by_tls else []), *AGENTS]
    bundles = [rendered.one("ConfigMap", "robotkube-ca", place) for place in places]
    return {bundle.get("data", {}).get("ca.crt", "") for bundle in bundles}


def forge_url(rendered: Any) -> str:
    """The forge's URL: the same in the settings of everybody who asks it, each of which names and mounts who may have
    signed its certificate exactly when it speaks TLS."""
    urls = set()
    there = {one["metadata"]["name"] for one in rendered.of_kind("ConfigMap")}  # no `rights` at somebody else's broker
    for process in ASKING & there:
        namespace = "robotkube-gate" if process == "gate" else None
        settings = yaml.safe_load(rendered.one("ConfigMap", process, namespace)["data"]["config.yaml"])["forge"]
        encrypted = settings["url"].startswith("https:")
        assert settings.get("authorities") == (f"{AUTHORITIES}/ca.crt" if encrypted else None), process
        kind = "Job" if process == "bootstrap" else "Deployment"
        mounts = dict(rendered.pods)[f"{kind}/{process}"]["containers"][0]["volumeMounts"]
        assert not encrypted or AUTHORITIES in {mount["mountPath"] for mount in mounts}, process
        urls.add(settings["url"])
    [url] = urls
    return str(url)


def forge_speaks(rendered: Any) -> tuple[str, str, str]:
    """Its protocol in its own settings, at its Service and by its probes."""
    ini = rendered.one("Secret", "forge")["stringData"]["app.ini"]
    lines = dict(line.split(" = ", 1) for line in ini.splitlines() if " = " in line)
    own = lines.get("PROTOCOL", "http")
    assert {lines[key].partition(":")[0] for key in ("ROOT_URL", "LOCAL_ROOT_URL")} == {own}
    [port] = rendered.one("Service", "forge")["spec"]["ports"]
    [container] = dict(rendered.pods)["StatefulSet/forge"]["containers"]
    assert [opened["name"] for opened in container["ports"]] == [port["targetPort"]]
    [scheme] = {container[probe]["httpGet"].get("scheme", "HTTP") for probe in container if probe.endswith("Probe")}
    return own, port["name"], scheme


def test_by_itself_the_platform_makes_certificates_and_nobody_speaks_in_clear_text(official: Any) -> None:
    assert names(official) >= OURS
    assert (ports(official), accounts(official), reached(official)) == ([8883], {("8883", "required")}, {8883})
    assert trusted(official) == {""}
    assert "1883" not in official.one("ConfigMap", "broker")["data"]["mosquitto.conf"].replace("8883", "")
    assert "PRIVATE KEY" not in official.text
    for name in ("tls-authority", "broker-tls", "database-tls", "forge-tls"):
        assert not {"data", "stringData"} & set(official.one("Secret", name))


def test_the_brokers_pod_waits_for_its_certificate_and_has_no_other_key(official: Any) -> None:
    pod = dict(official.pods)["Deployment/broker"]
    assert pod["automountServiceAccountToken"] is False
    assert "shareProcessNamespace" not in pod
    [volume] = [one for one in pod["volumes"] if one["name"] == "certificate"]
    assert volume["secret"]["secretName"] == "broker-tls"
    assert [item["key"] for item in volume["secret"]["items"]] == ["tls.crt", "tls.key"]
    mounting = {name for name, one in official.pods if "tls-authority" in str(one)}
    assert mounting == set()


def test_the_process_reads_the_settings_that_the_chart_writes(official: Any, tmp_path: Path) -> None:
    issuance = read_settings(mounted(official, "certificates", tmp_path), read_configuration).issuance
    assert (issuance.platform, issuance.namespaces) == ("robotkube", ("robotkube", "robotkube-gate", *AGENTS))
    host = official.one("Secret", "broker-account", "vehicle-00")["stringData"]["host"]
    servers = ["broker", "database", "forge", "gate", "manager", "rights", "suite-runner"]
    assert [certificate.secret for certificate in issuance.certificates] == [f"{name}-tls" for name in servers]
    assert {
        certificate.secret: certificate.service for certificate in issuance.certificates if certificate.service
    } == {"forge-tls": "forge"}
    assert {"forge.robotkube.svc.cluster.local", "localhost", "127.0.0.1"} <= set(issuance.certificates[2].names)
    assert issuance.certificates[0].names[0] == host
    assert (
        issuance.certificates[1].names[0] == official.one("Secret", "database-account", "cloud-0")["stringData"]["host"]
    )
    assert {certificate.seconds for certificate in issuance.certificates} == {90 * 86_400}


def test_the_process_reads_the_settings_of_an_earlier_chart(official: Any, tmp_path: Path) -> None:
    path = mounted(official, "certificates", tmp_path)
    document = yaml.safe_load(path.read_text())
    document["certificate"] = document.pop("certificates")[0]
    path.write_text(yaml.safe_dump(document))
    issuance = read_settings(path, read_configuration, FORMER_KEYS).issuance
    assert [certificate.secret for certificate in issuance.certificates] == ["broker-tls"]


@pytest.mark.parametrize("accounts", ["auto", "certificates"])
def test_accounts_are_proved_by_certificates(helm: Any, tmp_path: Path, accounts: str) -> None:
    """The broker takes no password, every account has a certificate to come, and its pod waits for it."""
    rendered = helm.template(PLATFORM, OFFICIAL, tls={"accounts": accounts})
    configuration = rendered.one("ConfigMap", "broker")["data"]["mosquitto.conf"].splitlines()
    assert {"require_certificate true", "use_identity_as_username true"} <= set(configuration)
    [folder] = {line.split()[1].rpartition("/")[0] for line in configuration if line.startswith(("cafile", "crlfile"))}
    broker = dict(rendered.pods)["Deployment/broker"]
    assert folder in {mount["mountPath"] for mount in broker["containers"][0]["volumeMounts"]}
    assert f"{folder}/revoked.crl" in rendered.one("ConfigMap", "broker")["data"]["run.sh"]
    secrets = [one for one in rendered.of_kind("Secret") if "password" in one.get("stringData", {})]
    of_broker = {
        (secret["metadata"].get("namespace", "robotkube"), secret["metadata"]["name"]): secret["stringData"]
        for secret in secrets
        if secret["metadata"]["name"].startswith("broker-account")
    }
    assert {one["identity"] for one in of_broker.values()} == {"certificate"}
    issuance = read_settings(mounted(rendered, "certificates", tmp_path), read_configuration).issuance.accounts
    assert issuance is not None
    assert {(certificate.namespace, certificate.secret) for certificate in issuance.certificates} == set(of_broker)
    assert {certificate.account for certificate in issuance.certificates} == {
        one["username"] for one in of_broker.values()
    }
    assert issuance.shut == "https://rights.robotkube.svc.cluster.local:8080/accounts"
    for name in ("manager", "rights", "console"):
        volumes = str(dict(rendered.pods)[f"Deployment/{name}"]["volumes"])
        assert all(f"broker/{key}" in volumes for key in ("username", "password", "identity", "tls.crt", "tls.key"))
    roles = [one for one in rendered.of_kind("Role") if one["metadata"]["name"] == "certificates"]
    role = {one["metadata"]["namespace"]: one for one in roles}
    for place in AGENTS:
        [of_secrets] = [rule for rule in role[place]["rules"] if "secrets" in rule["resources"]]
        assert (of_secrets["resourceNames"], of_secrets["verbs"]) == (["broker-account"], ["get", "patch"])


@pytest.mark.parametrize("more", [{"accounts": "passwords"}, {"accounts": "auto", "plain": True}, {"mode": "off"}])
def test_without_it_the_process_has_no_right_to_accounts_and_reaches_nobody(helm: Any, more: dict[str, Any]) -> None:
    """`auto` is without it where passwords could be sent in clear text, or nobody makes certificates."""
    rendered = helm.template(PLATFORM, OFFICIAL, tls=more)
    assert {
        one["stringData"].get("identity", "password") for one in rendered.of_kind("Secret") if "stringData" in one
    } == {"password"}
    assert "certificate true" not in rendered.one("ConfigMap", "broker")["data"]["mosquitto.conf"]
    roles = [one for one in rendered.of_kind("Role") if one["metadata"]["name"] == "certificates"]
    assert "broker-account" not in str(roles)
    policies = [one for one in rendered.of_kind("NetworkPolicy") if one["metadata"]["name"] == "certificates"]
    assert "rights" not in str([policy["spec"]["egress"] for policy in policies])


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"tls": {"accounts": "certificates", "mode": "off"}}, "tls.accounts is certificates, but tls.mode is off"),
        ({"tls": {"accounts": "certificates", "plain": True}}, "would connect at 1883 without a certificate"),
        (
            {
                "broker": {"kind": "external", "external": {"host": "mqtt.example", "port": 8884}},
                "tls": {"accounts": "certificates", "mode": "off"},
            },
            "broker.kind external: accounts' certificates are made by the process",
        ),
        ({"tls": {"accounts": True}}, "accounts"),
    ],
)
def test_accounts_have_no_certificates_where_nobody_makes_them(helm: Any, values: dict[str, Any], said: str) -> None:
    assert said in " ".join(helm.refusal(PLATFORM, OFFICIAL, **values).split())


def test_in_clear_text_as_well_where_a_value_asks_for_it(helm: Any) -> None:
    both = helm.template(PLATFORM, OFFICIAL, tls={"plain": True})
    assert (ports(both), accounts(both), reached(both)) == ([8883, 1883], {("8883", "required")}, {8883, 1883})


def test_off_is_clear_text_alone(helm: Any) -> None:
    off = helm.template(PLATFORM, OFFICIAL, tls={"mode": "off"})
    assert not names(off) & {*OURS, "Secret/broker-tls", "ConfigMap/robotkube-ca", "NetworkPolicy/certificates"}
    assert (ports(off), accounts(off), reached(off)) == ([1883], {("1883", "off")}, {1883})
    assert "authorities" not in off.one("ConfigMap", "manager")["data"]["config.yaml"]
    [container] = dict(off.pods)["Deployment/broker"]["containers"]
    assert container["command"] == ["mosquitto", "-c", "/etc/mosquitto/mosquitto.conf"]
    assert "/etc/robotkube/authorities" not in off.text


def test_a_provided_certificate_is_mounted_and_whoever_signed_it_told(helm: Any) -> None:
    provided = {
        "mode": "provided",
        "provided": {"secret": "mine", "database": "ours", "forge": "its"},
        "authorities": AUTHORITY,
        "processes": False,
    }
    rendered = helm.template(PLATFORM, OFFICIAL, tls=provided)
    assert not names(rendered) & {*OURS, "Secret/broker-tls", "Secret/database-tls", "Certificate/broker"}
    for workload, secret in (
        ("Deployment/broker", "mine"),
        ("StatefulSet/database", "ours"),
        ("StatefulSet/forge", "its"),
    ):
        [volume] = [v for v in dict(rendered.pods)[workload]["volumes"] if v["name"] == "certificate"]
        assert volume["secret"]["secretName"] == secret
    assert (trusted(rendered), ports(rendered)) == ({AUTHORITY}, [8883])


def test_a_broker_of_somebody_else_is_verified_by_the_authorities_that_are_given(helm: Any) -> None:
    external = {"kind": "external", "external": {"host": "mqtt.example", "port": 8884}}
    database = {"kind": "external", "external": {"host": "mongo.example", "port": 27019, "tls": True}}
    provided = {"mode": "provided", "provided": {"forge": "its"}, "authorities": AUTHORITY, "processes": False}
    rendered = helm.template(PLATFORM, OFFICIAL, broker=external, database=database, tls=provided)
    assert accounts(rendered) == {("8884", "required")}
    assert trusted(rendered) == {AUTHORITY}
    account = rendered.one("Secret", "database-account", "cloud-0")["stringData"]
    assert (account["host"], account["port"], account["tls"]) == ("mongo.example", "27019", "required")


@pytest.mark.parametrize("kind", KINDS)
def test_the_database_speaks_tls_alone_and_waits_for_its_certificate(helm: Any, kind: str) -> None:
    rendered = helm.template(PLATFORM, *KINDS[kind])
    assert database_listens(rendered) == ({27018}, {27018: 27018})
    assert (database_account(rendered), reached(rendered, "database", "cloud-0")) == (("27018", "required"), {27018})
    pod = dict(rendered.pods)["StatefulSet/database"]
    [volume] = [one for one in pod["volumes"] if one["name"] == "certificate"]
    assert volume["secret"]["secretName"] == "database-tls"
    assert [item["key"] for item in volume["secret"]["items"]] == ["tls.crt", "tls.key"]
    mounts = {one["mountPath"] for one in pod["containers"][0]["volumeMounts"]}
    named = [
        word.rpartition("=")[2] for word in pod["containers"][0]["args"] if word.startswith(("--listen-tls-", "--tlsC"))
    ]
    assert named
    assert [name for name in named if name.rpartition("/")[0] not in mounts] == []
    assert ("command" in pod["containers"][0]) == (kind == "mongo")  # FerretDB reads a renewed one by itself


@pytest.mark.parametrize(("kind", "targets"), [("mongo", {27018}), ("ferretdb", {27017, 27018})])
def test_the_database_speaks_clear_text_as_well_where_a_value_asks_for_it(
    helm: Any, kind: str, targets: set[int]
) -> None:
    rendered = helm.template(PLATFORM, *KINDS[kind], tls={"plain": True})
    opened, service = database_listens(rendered)
    assert (opened, set(service), set(service.values())) == (targets, {27017, 27018}, targets)
    assert database_account(rendered) == ("27018", "required")
    assert reached(rendered, "database", "cloud-0") == {27017, 27018}


def test_policies_follow_the_database_also_where_the_broker_is_somebody_elses(helm: Any) -> None:
    external = {"kind": "external", "external": {"host": "mqtt.example", "port": 1883}}
    off = helm.template(PLATFORM, OFFICIAL, broker=external, tls={"mode": "off"})
    assert reached(off, "database", "cloud-0") == {27017}
    [rule] = [
        rule
        for rule in off.one("NetworkPolicy", "suite-runner", "robotkube")["spec"]["egress"]
        if "robotkube.io/suite" in str(rule.get("to"))
    ]
    assert [port["port"] for port in rule["ports"]] == [27017]


@pytest.mark.parametrize("kind", KINDS)
def test_off_is_a_database_in_clear_text_as_before(helm: Any, kind: str) -> None:
    off = helm.template(PLATFORM, *KINDS[kind], tls={"mode": "off"})
    assert database_listens(off) == ({27017}, {27017: 27017})
    assert (database_account(off), reached(off, "database", "cloud-0")) == (("27017", "off"), {27017})
    assert not names(off) & {"Secret/database-tls", "ConfigMap/database"}


def test_the_forge_speaks_tls_and_everybody_who_asks_it_verifies_it(official: Any) -> None:
    assert forge_speaks(official) == ("https", "https", "HTTPS")
    url = forge_url(official)
    assert url == "https://forge.robotkube.svc.cluster.local:3000"
    pod = dict(official.pods)["StatefulSet/forge"]
    [volume] = [one for one in pod["volumes"] if one["name"] == "certificate"]
    assert volume["secret"]["secretName"] == "forge-tls"
    assert [item["key"] for item in volume["secret"]["items"]] == ["tls.crt", "tls.key"]
    [container] = pod["containers"]
    assert {"name": "SSL_CERT_DIR", "value": AUTHORITIES} in container["env"]
    assert {AUTHORITIES, "/etc/forge-tls"} <= {mount["mountPath"] for mount in container["volumeMounts"]}


def test_argocd_reads_the_forge_by_tls(official: Any) -> None:
    charts = official.one("Secret", "robotkube-charts", "argocd")["stringData"]
    repository = official.one("Secret", "robotkube-deployment", "argocd")["stringData"]
    assert charts["insecureOCIForceHttp"] == "false"
    assert repository["url"] == f"{forge_url(official)}/robotkube/deployment.git"
    sets = official.one("ApplicationSet", "releases", "argocd")["spec"]["generators"]
    assert sets[0]["git"]["repoURL"] == repository["url"]


@pytest.mark.parametrize("values", [{"forge": {"tls": False}}, {"tls": {"mode": "off"}}], ids=["a value", "off"])
def test_the_forge_speaks_http_where_nothing_else_is_asked_for(helm: Any, values: dict[str, Any]) -> None:
    plain = helm.template(PLATFORM, OFFICIAL, **values)
    assert forge_speaks(plain) == ("http", "http", "HTTP")
    assert forge_url(plain).startswith("http://")
    assert plain.one("Secret", "robotkube-charts", "argocd")["stringData"]["insecureOCIForceHttp"] == "true"
    [container] = dict(plain.pods)["StatefulSet/forge"]["containers"]
    assert container["command"] == ["gitea", "--config", "/etc/gitea/app.ini", "web"]
    assert not names(plain) & {"Secret/forge-tls"}


def test_what_cert_manager_is_asked_for(helm: Any, golden: Callable[[str, str], None]) -> None:
    rendered = helm.template(PLATFORM, OFFICIAL, PROFILES / "cert-manager.yaml")
    assert not names(rendered) & OURS
    asked = {one["metadata"]["name"]: one for one in rendered.of_kind("Certificate")}
    for name, workload in (
        ("broker", "Deployment/broker"),
        ("database", "StatefulSet/database"),
        ("forge", "StatefulSet/forge"),
    ):
        [volume] = [v for v in dict(rendered.pods)[workload]["volumes"] if v["name"] == "certificate"]
        assert volume["secret"]["secretName"] == asked[name]["spec"]["secretName"]
    kept = [*asked.values(), rendered.one("ConfigMap", "robotkube-ca", "vehicle-00")]
    text = yaml.safe_dump_all(kept, sort_keys=False)
    golden("cert-manager", text)


def test_an_upgrade_that_reuses_values_of_before_has_certificates_made(helm: Any) -> None:
    values = yaml.safe_load((PLATFORM / "values.yaml").read_text(encoding="utf-8"))
    assert values["tls"]["mode"] == "made"
    rendered = helm.template(PLATFORM, OFFICIAL, tls=None, certificates=None, forge={"tls": None, "names": None})
    assert names(rendered) >= OURS
    assert forge_speaks(rendered) == ("http", "http", "HTTP")


@pytest.mark.parametrize(
    ("place", "chart"),
    [("apps", "mqtt-bridge"), ("apps", "event-detector"), ("earlier", "mqtt-bridge"), ("earlier", "event-detector")],
)
def test_charts_mount_the_account_and_whom_to_trust_into_one_folder(helm: Any, place: str, chart: str) -> None:
    profile = PROFILES / ("earlier" if place == "earlier" else "") / f"{chart}.yaml"
    named = {"broker": (place, chart) != ("earlier", "event-detector"), "database": chart == "event-detector"}
    accounts = {name: f"{name}-account" for name, mounted in named.items() if mounted}
    given = {name: {"existingSecret": account} for name, account in accounts.items()}
    rendered = helm.template(CHARTS / place / chart, profile, release=chart, **given)
    [(_, pod)] = rendered.pods
    for name, account in accounts.items():
        [volume] = [one for one in pod["volumes"] if one["name"] == name]
        secret, authorities = volume["projected"]["sources"]
        assert secret == {"secret": {"name": account}}
        assert authorities["configMap"]["optional"] is True
        assert authorities["configMap"]["items"] == [{"key": "ca.crt", "path": "ca.crt"}]
