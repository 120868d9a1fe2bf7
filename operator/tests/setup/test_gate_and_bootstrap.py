"""Gate and bootstrap as processes with their settings files, on a real forge, a real database and a real API server."""

import base64
import json
import os
import secrets
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bcrypt
import httpx
import pytest
import yaml
from kubernetes import client
from pymongo.errors import OperationFailure

from robotkube.cli import main as cli
from robotkube.foundation.runtime.adapters.webhook_server import WebServer
from robotkube.registry.catalogue.core.catalogue import Catalogue
from robotkube.registry.catalogue.loops.verified_catalogue import EvidenceReader
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.suites.adapters.runner_protocol import RunsEndpoint
from robotkube.testing.publishing import ScriptedRunner
from tests.stages.forge.catalogue_evidence import SEED, key_folder, trusted_keys
from tests.stages.forge.gitea import ForgeProcess
from tests.stages.forge.installation import (
    CATALOGUE,
    CHARTS_URL,
    DEPLOYMENT,
    HOOK_SECRET,
    WEBHOOK_SECRET,
    ApplicationSetController,
    Installation,
    manager_secret,
)
from tests.stages.forge.real_charts import PACKED_IMAGE, plan_of, published_bridge
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.kubernetes.argocd_objects import NAMESPACE, bootstrap_kubeconfig, connect, install_argocd
from tests.stages.programs import free_port, program
from tests.stages.recording.database_server import SETUP_PASSWORD, SETUP_USER, DatabaseServer
from tests.stages.registry.publications import Publishing, write_sources
from tests.stages.registry.signed_evidence import signing_key
from tests.stages.registry.submissions import IMAGE
from tests.stages.waiting import until

pytestmark = [pytest.mark.toolchain, pytest.mark.filterwarnings("ignore::urllib3.exceptions.InsecureRequestWarning")]
PROCESS_SECONDS_MAX = 60


def secret_file(folder: Path, name: str, text: str) -> str:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return str(path)


def account_folder(folder: Path, name: str, username: str, password: str) -> str:
    secret_file(folder, f"{name}/username", username)
    secret_file(folder, f"{name}/password", password)
    return str(folder / name)


def write_settings(folder: Path, document: dict[str, Any]) -> dict[str, str]:
    """The environment of a process with these settings."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "config.yaml").write_text(yaml.safe_dump(document))
    return {**os.environ, "ROBOTKUBE_CONFIG": str(folder / "config.yaml"), "ROBOTKUBE_WORK": str(folder / "work")}


def lines(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines() if line.startswith("{")]


def key_file(folder: Path) -> str:
    """The gate's private key."""
    signing_key(folder / "key", SEED)
    return str(folder / "key" / "key.pem")


# -- gate -------------------------------------------------------------------------------------------------------------


def gate_settings(installation: Installation, folder: Path, hook_url: str) -> dict[str, Any]:
    return {
        "listen": {"address": "127.0.0.1", "port": installation.gate_port},
        "log_level": "info",
        "forge": {
            "url": installation.url,
            "credentials": account_folder(folder, "forge", "gate", installation.passwords["gate"]),
            "deployment": "robotkube/deployment",
            "catalogue": "robotkube/catalogue",
            "branch": "main",
            "proposers": [
                {
                    "account": "manager",
                    "namespaces": ["cloud-0"],
                    "secret": secret_file(folder, "proposers/manager/secret", manager_secret()),
                }
            ],
            "publishers": ["publisher"],
        },
        "oci_registry": {"charts": CHARTS_URL, "staging": CHARTS_URL.replace("verified", "staging")},
        "local_builds": False,
        "evidence": {
            "key": key_file(folder),
            "keys": str(key_folder()),
            "verifier": "gate-of-tests",
        },
        "hook": {"url": hook_url, "secret": secret_file(folder, "hook/secret", HOOK_SECRET)},
        "webhook": {"secret": secret_file(folder, "webhook/secret", WEBHOOK_SECRET)},
    }


def test_the_gate_process_takes_a_proposal_and_ends_when_asked(
    installation: Installation, controller: ApplicationSetController, tmp_path: Path
) -> None:
    settings = gate_settings(installation, tmp_path, controller.url)
    settings["listen"]["health_port"] = health_port = free_port()
    environment = {**write_settings(tmp_path, settings), "ROBOTKUBE_RENDERER": program("chart-renderer")}
    command = [sys.executable, "-m", "robotkube.delivery.gate"]
    with (tmp_path / "log").open("wb") as log:
        process = subprocess.Popen(command, env=environment, stderr=log)
    try:
        url = f"http://127.0.0.1:{installation.gate_port}"
        until(lambda: answers(f"http://127.0.0.1:{health_port}/readyz") == 200, "ready")
        assert answers(f"{url}/readyz") == 200
        manager, plan = installation.clone("manager"), installation.plan()
        with published_bridge(installation, "0.12.0") as bridge:
            commit = plan_of(manager, plan, bridge, "by-process", {})
            number = installation.propose(manager, commit, plan)
            until(lambda: bool(installation.pull_request(number)["merged"]), "merged")
        until(lambda: controller.announced(commit), "announced")
        counted = 'robotkube_gate_proposals_total{verdict="accepted"} 1'
        until(lambda: counted in httpx.get(f"{url}/metrics").text, "counted, which comes after the announcement")
        assert counted in httpx.get(f"http://127.0.0.1:{health_port}/metrics").text
        process.send_signal(signal.SIGTERM)
        assert process.wait(PROCESS_SECONDS_MAX) == 0
    finally:
        process.kill()
        process.wait(PROCESS_SECONDS_MAX)
    found = next(line for line in lines((tmp_path / "log").read_text()) if line["event"] == "proposal")
    assert found["verdict"] == "accepted"
    assert found["commit"] == commit[:12]
    assert found["subject"] == "deploy(recording): test"


SUITES_TOKEN = "suites token"  # noqa: S105


@pytest.fixture
def runner() -> Iterator[tuple[ScriptedRunner, str]]:
    """A suite-runner's HTTP side whose verdicts the test gives, and its URL."""
    scripted = ScriptedRunner()
    server = WebServer("127.0.0.1", 0, list, str, put=RunsEndpoint(SUITES_TOKEN, scripted.run).put)
    server.start()
    yield scripted, f"http://127.0.0.1:{server.port}"
    server.stop()


@pytest.fixture
def gate_url(
    installation: Installation,
    controller: ApplicationSetController,
    runner: tuple[ScriptedRunner, str],
    tmp_path: Path,
) -> Iterator[str]:
    """The gate as a process, with that suite-runner."""
    token = secret_file(tmp_path, "suites/token", SUITES_TOKEN)
    settings = gate_settings(installation, tmp_path, controller.url) | {"suites": {"url": runner[1], "token": token}}
    command = [sys.executable, "-m", "robotkube.delivery.gate"]
    environment = {**write_settings(tmp_path, settings), "ROBOTKUBE_RENDERER": program("chart-renderer")}
    with (tmp_path / "log").open("wb") as log:
        process = subprocess.Popen(command, env=environment, stderr=log)
    try:
        url = f"http://127.0.0.1:{installation.gate_port}"
        until(lambda: answers(f"{url}/readyz") == 200, "ready")
        yield url
        process.send_signal(signal.SIGTERM)
        assert process.wait(PROCESS_SECONDS_MAX) == 0
    finally:
        process.kill()
        process.wait(PROCESS_SECONDS_MAX)


def submit(installation: Installation, folder: Path, *more: str) -> int:
    """The command's exit code."""
    password = secret_file(folder, "publisher", installation.passwords["publisher"])
    images = secret_file(folder, "images.yaml", f"ros: {IMAGE}\n")
    where = ["--charts", str(folder / "charts" / "apps"), "--registry", str(folder / "registry"), "--images", images]
    account = [
        "--forge-url",
        installation.url,
        "--password-file",
        password,
        "--kept",
        str(folder / "kept"),
        "--wait",
        "60",
    ]
    return cli.main(["registry", "submit", *where, *account, *more])


def test_the_gate_process_publishes_what_the_command_submits(
    installation: Installation,
    gate_url: str,
    runner: tuple[ScriptedRunner, str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    name, scripted = f"text-{secrets.token_hex(3)}", runner[0]
    write_sources(tmp_path, name)
    scripted.checks["static"] = (Check("probes", False, "no readinessProbe", "add one"),)
    capsys.readouterr()
    assert submit(installation, tmp_path, name, "--application", name) == 1
    told = capsys.readouterr()
    assert f"static of {name} failed" in told.err
    assert "found: `no readinessProbe`" in told.err
    assert "do: add one" in told.err
    scripted.checks.clear()
    assert submit(installation, tmp_path, name, "--application", name, "--output", "json") == 0
    told = capsys.readouterr()
    rows = json.loads(told.out)["submitted"]
    assert [(row["kind"], row["verdict"]) for row in rows] == [("chart", "published"), ("application", "published")]
    assert rows[0]["evidence"].startswith(f"evidence/{name}/0.1.0_")
    assert (tmp_path / "kept" / rows[0]["evidence"]).is_file()
    published_application = catalogue_of(installation).applications[name]
    assert (published_application.assured, published_application.evidence_problem) == (True, "")
    assert submit(installation, tmp_path, name, "--application", name) == 0
    assert f"{name} 0.1.0: published already with this digest" in capsys.readouterr().err
    published = 'robotkube_gate_publications_total{verdict="published"} 1'
    until(lambda: published in httpx.get(f"{gate_url}/metrics").text, "counted, which comes after the push to main")
    metrics = httpx.get(f"{gate_url}/metrics").text
    assert 'robotkube_gate_publications_total{verdict="refused"} 1' in metrics
    assert 'robotkube_gate_suite_runs_total{suite="static"} 2' in metrics

    def submissions() -> list[dict[str, Any]]:
        return [line for line in lines((tmp_path / "log").read_text()) if line["event"] == "submission"]

    until(lambda: len(submissions()) == 2, "the second submission logged")
    found = submissions()
    assert [line["verdict"] for line in found] == ["refused", "published"]
    assert f"{name} 0.1.0" in found[1]["subject"]


def catalogue_of(installation: Installation) -> Catalogue:
    """The catalogue as managers see it."""
    return EvidenceReader(trusted_keys()).read(Publishing(installation, Path()).main())


def test_the_gate_process_refuses_an_application_whose_parameter_leads_to_a_foreign_image(
    installation: Installation,
    gate_url: str,
    runner: tuple[ScriptedRunner, str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    name, foreign = f"text-{secrets.token_hex(3)}", "docker.io/library/busybox@sha256:" + "2" * 64
    write_sources(tmp_path, name)
    image_by_value(tmp_path / "charts" / "apps", name)
    path = tmp_path / "registry" / "applications" / f"{name}.yaml"
    document = yaml.safe_load(path.read_text())
    choices = {"type": "string", "enum": [IMAGE, foreign], "default": IMAGE}
    document["spec"]["parameters"]["properties"]["image"] = choices
    document["spec"]["services"][0]["values"]["image"] = {"reference": "{{ parameters.image }}"}
    path.write_text(yaml.safe_dump(document))
    capsys.readouterr()
    assert submit(installation, tmp_path, name, "--application", name) == 1
    told = capsys.readouterr().err
    assert f"applications/{name}.yaml: spec.services[0]: with parameters {{'" in told
    assert f"'image': '{foreign}'" in told
    assert f": a pod would run image {foreign}, which was not verified with chart" in told
    assert runner[0].runs == []
    assert name not in catalogue_of(installation).applications


def image_by_value(charts: Path, name: str) -> None:
    """Let the value `image.reference` of a chart name its image, by its library chart."""
    library = charts / "robotkube-app" / "templates" / "_app.tpl"
    text = library.read_text()
    assert PACKED_IMAGE in text
    library.write_text(text.replace(PACKED_IMAGE, f"(.root.Values.image).reference | default ({PACKED_IMAGE})"))
    schema = json.loads((charts / name / "values.schema.json").read_text())
    reference = {"type": "string", "description": "The image."}
    schema["properties"]["image"] = {
        "type": "object",
        "description": "The image.",
        "additionalProperties": False,
        "properties": {"reference": reference},
    }
    (charts / name / "values.schema.json").write_text(json.dumps(schema))


def test_wrong_sources_are_told_before_anything_is_sent(
    installation: Installation, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = f"text-{secrets.token_hex(3)}"
    write_sources(tmp_path, name)
    path = tmp_path / "registry" / "charts" / name / "0.1.0.yaml"
    path.write_text(path.read_text().replace("  channel: ", "  chanel: "))
    assert submit(installation, tmp_path, name) == 2
    told = capsys.readouterr().err
    assert f"{path}: spec.chanel: unknown key; remove it" in told
    assert f"{path}: spec.channel: missing" in told
    assert "nothing was submitted" in told
    assert submit(installation, tmp_path) == 2
    assert "name charts, applications (--application NAME), or --all" in capsys.readouterr().err


def answers(url: str) -> int:
    try:
        return httpx.get(url, timeout=2).status_code
    except httpx.HTTPError:
        return 0


def test_every_problem_of_the_gates_settings_is_named(installation: Installation, tmp_path: Path) -> None:
    settings = gate_settings(installation, tmp_path, "http://127.0.0.1:9/")
    settings["log_level"] = "loud"
    settings["listen"]["port"] = "http"
    settings["colour"] = "red"
    settings["webhook"]["secret"] = str(tmp_path / "nowhere")
    del settings["forge"]["proposers"]
    environment = write_settings(tmp_path, settings)
    command = [sys.executable, "-m", "robotkube.delivery.gate"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 2
    for part in (
        "config.yaml",
        "log_level: must be one of",
        "listen.port",
        "colour: unknown key",
        "nowhere",
        "forge.proposers",
    ):
        assert part in done.stderr
    assert installation.passwords["gate"] not in done.stderr


# -- bootstrap --------------------------------------------------------------------------------------------------------


@dataclass
class BootstrapStage:
    """Forge, database and API server with nothing of ours on them yet."""

    forge: ForgeProcess
    database: DatabaseServer
    api: ApiServerProcess
    kubeconfig: Path


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BootstrapStage]:
    folder = tmp_path_factory.mktemp("world")
    (folder / "api").mkdir()
    forge, api = ForgeProcess(folder / "forge"), ApiServerProcess(folder / "api")
    database = DatabaseServer(folder / "database")
    try:
        database.start()
        forge.start()
        api.start()
        install_argocd(api)
        yield BootstrapStage(forge, database, api, bootstrap_kubeconfig(api, folder))
    finally:
        api.stop()
        forge.remove()
        database.close()


def bootstrap_settings(world: BootstrapStage, folder: Path, passwords: dict[str, str]) -> dict[str, Any]:
    def account(name: str, username: str = "") -> dict[str, str]:
        return {"name": name, "credentials": account_folder(folder, name, username or name, passwords[name])}

    for repository, files in (("deployment", DEPLOYMENT), ("catalogue", CATALOGUE)):
        for path, text in files.items():
            secret_file(folder, f"seed/{repository}/{path}", text)
    webhook = secret_file(folder, "webhook/secret", WEBHOOK_SECRET)
    return {
        "log_level": "info",
        "wait_seconds": 60,
        "forge": {
            "url": world.forge.url,
            "administrator": account_folder(
                folder, "administrator", world.forge.administrator, world.forge.administrator_password
            ),
            "accounts": [account(name) for name in ("manager", "gate", "argocd", "publisher", "operator-team")],
            "organisations": [
                {"name": name, "packages": {"publisher": "write", "argocd": "read"}}
                for name in ("robotkube", "staging")
            ],
            "repositories": [
                {
                    "name": "robotkube/deployment",
                    "description": "What runs",
                    "branch": "main",
                    "seed": str(folder / "seed" / "deployment"),
                    "access": {"manager": "read", "gate": "write", "argocd": "read", "operator-team": "write"},
                    "main": ["gate"],
                },
                {
                    "name": "robotkube/catalogue",
                    "description": "What may run",
                    "branch": "main",
                    "seed": str(folder / "seed" / "catalogue"),
                    "access": {"manager": "read", "gate": "read", "publisher": "write"},
                    "main": ["publisher"],
                },
            ],
            "webhooks": [
                {
                    "repository": "robotkube/deployment",
                    "url": "http://127.0.0.1:9/webhook",
                    "events": ["push", "pull_request"],
                    "secret": webhook,
                }
            ],
        },
        "database": {
            "kind": "ferretdb",
            "host": "127.0.0.1",
            "port": world.database.port,
            "administrator": account_folder(folder, "database-administrator", SETUP_USER, SETUP_PASSWORD),
            "accounts": [
                {
                    "username": name,
                    "database": name,
                    "credentials": account_folder(folder, name, name, passwords[name]),
                }
                for name in ("recordings_cloud_0", "recordings_edge_0")
            ],
        },
        "argocd": {
            "namespace": NAMESPACE,
            "account": account("argocd-manager", "manager") | {"name": "manager"},
            "rbac": "p, role:x, applications, get, robotkube-apps/*, allow\ng, manager, role:x\n",
            "hook": {"secret": secret_file(folder, "hook/secret", passwords["hook"])},
            "closed_project": "default",
            "hook_readers": ["argocd-server", "argocd-applicationset-controller"],
        },
    }


def run_bootstrap(world: BootstrapStage, folder: Path, settings: dict[str, Any]) -> tuple[int, list[dict[str, Any]]]:
    environment = write_settings(folder, settings)
    environment |= {"KUBECONFIG": str(world.kubeconfig), "PYTHONWARNINGS": "ignore"}
    command = [sys.executable, "-m", "robotkube.setup.bootstrap"]
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=PROCESS_SECONDS_MAX, check=False
    )
    return done.returncode, lines(done.stderr)


def changed(found: list[dict[str, Any]]) -> list[str]:
    return [line["step"] for line in found if line.get("changed") == "true"]


NAMES = (
    *("manager", "gate", "argocd", "publisher", "operator-team"),
    *("recordings_cloud_0", "recordings_edge_0", "argocd-manager", "hook"),
)


def test_the_bootstrap_process_makes_everything_once(world: BootstrapStage, tmp_path: Path) -> None:
    passwords = {name: f"password of {name}" for name in NAMES}
    settings = bootstrap_settings(world, tmp_path, passwords)
    code, first = run_bootstrap(world, tmp_path, settings)
    assert code == 0, first
    assert "seed of robotkube/deployment" in changed(first)
    argocd_is_wired(world, passwords)
    recorders_reach_their_own_database_only(world, passwords)
    account = httpx.get(f"{world.forge.url}/api/v1/user", auth=("gate", passwords["gate"]))
    assert account.status_code == 200
    code, second = run_bootstrap(world, tmp_path, settings)
    assert code == 0
    assert changed(second) == []
    rotated = passwords | {"recordings_cloud_0": "other", "argocd-manager": "other", "hook": "other"}
    code, third = run_bootstrap(world, tmp_path, bootstrap_settings(world, tmp_path, rotated))
    assert code == 0
    assert changed(third) == [
        "database account recordings_cloud_0",
        "password of manager",
        "hook secrets",
        "deployment argocd-server",
        "deployment argocd-applicationset-controller",
    ]
    argocd_is_wired(world, rotated)
    recorders_reach_their_own_database_only(world, rotated)


def argocd_is_wired(world: BootstrapStage, passwords: dict[str, str]) -> None:
    api = connect(world.api)
    core = client.CoreV1Api(api)
    settings = core.read_namespaced_config_map("argocd-cm", NAMESPACE).data
    assert settings == {"url": "http://x", "accounts.manager": "login"}
    rights = core.read_namespaced_config_map("argocd-rbac-cm", NAMESPACE).data
    assert "g, manager, role:x" in rights["policy.robotkube.csv"]
    secret = {k: decoded(v) for k, v in core.read_namespaced_secret("argocd-secret", NAMESPACE).data.items()}
    assert secret["webhook.github.secret"] == passwords["hook"]
    assert bcrypt.checkpw(passwords["argocd-manager"].encode(), secret["accounts.manager.password"].encode())
    assert secret["accounts.manager.passwordMtime"].endswith("Z")
    place = ("argoproj.io", "v1alpha1", NAMESPACE, "appprojects", "default")
    spec = client.CustomObjectsApi(api).get_namespaced_custom_object(*place)["spec"]
    assert {key: value for key, value in spec.items() if value} == {
        "namespaceResourceBlacklist": [{"group": "*", "kind": "*"}]
    }


def decoded(value: str) -> str:
    return base64.b64decode(value).decode()


def recorders_reach_their_own_database_only(world: BootstrapStage, passwords: dict[str, str]) -> None:
    own, other = "recordings_cloud_0", "recordings_edge_0"
    recorder = world.database.client(own, passwords[own], own)
    recorder[own]["samples"].insert_one({"x": 1})
    for database in (other, "admin"):
        with pytest.raises(OperationFailure):
            recorder[database]["samples"].insert_one({"x": 1})


def test_the_bootstrap_says_what_is_wrong(world: BootstrapStage, tmp_path: Path) -> None:
    settings = bootstrap_settings(world, tmp_path, dict.fromkeys(NAMES, "word"))
    settings["database"]["kind"] = "oracle"
    settings["forge"]["repositories"][0]["seed"] = str(tmp_path / "nowhere")
    settings["forge"]["repositories"][0]["access"]["manager"] = "admin"
    settings["wait_seconds"] = 0
    code, found = run_bootstrap(world, tmp_path, settings)
    assert code == 2
    text = found[-1]["error"]
    for part in ("database.kind: must be one of", "repositories[0].seed", "access.manager: must be read or write"):
        assert part in text
    assert "wait_seconds: must be a whole number" in text


def test_the_bootstrap_ends_when_argocd_never_comes(world: BootstrapStage, tmp_path: Path) -> None:
    settings = bootstrap_settings(world, tmp_path, dict.fromkeys(NAMES, "word"))
    del settings["forge"], settings["database"]
    settings["argocd"]["namespace"] = "elsewhere"
    settings["wait_seconds"] = 2
    code, found = run_bootstrap(world, tmp_path, settings)
    assert code in (2, 3)
    assert "Secret argocd-secret in namespace elsewhere" in found[-1]["error"]
