"""Gate and bootstrap as processes with their settings files, on a real forge, a real database and a real API server."""

import base64
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bcrypt
import pytest
from kubernetes import client
from pymongo.errors import OperationFailure

from robotkube.foundation.certificates.adapters.issuing import throw_away
from tests.stages import http_calls
from tests.stages.forge.gate_process import (
    PROCESS_SECONDS_MAX,
    account_folder,
    answers,
    gate_settings,
    lines,
    secret_file,
    write_settings,
)
from tests.stages.forge.gitea import ForgeProcess
from tests.stages.forge.installation import (
    CATALOGUE,
    DEPLOYMENT,
    WEBHOOK_SECRET,
    ApplicationSetController,
    Installation,
)
from tests.stages.forge.real_charts import plan_of, published_bridge
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.kubernetes.argocd_objects import NAMESPACE, bootstrap_kubeconfig, connect, install_argocd
from tests.stages.programs import free_port, program
from tests.stages.recording.database_server import SETUP_PASSWORD, SETUP_USER, DatabaseServer
from tests.stages.waiting import until

ADDRESS = "127.0.0.1"
pytestmark = pytest.mark.toolchain


# -- gate -------------------------------------------------------------------------------------------------------------


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
        manager = installation.clone("manager")
        plan = installation.plan()
        with published_bridge(installation, "0.12.0") as bridge:
            commit = plan_of(manager, plan, bridge, "by-process", {})
            number = installation.propose(manager, commit, plan)
            until(lambda: bool(installation.pull_request(number)["merged"]), "merged")
        until(lambda: controller.announced(commit), "announced")
        counted = 'robotkube_gate_proposals_total{verdict="accepted"} 1'
        until(lambda: counted in http_calls.get(f"{url}/metrics").text, "counted, which comes after the announcement")
        assert counted in http_calls.get(f"http://127.0.0.1:{health_port}/metrics").text
        process.send_signal(signal.SIGTERM)
        assert process.wait(PROCESS_SECONDS_MAX) == 0
    finally:
        process.kill()
        process.wait(PROCESS_SECONDS_MAX)
    event = next(line for line in lines((tmp_path / "log").read_text()) if line["event"] == "proposal")
    assert event["verdict"] == "accepted"
    assert event["commit"] == commit[:12]
    assert event["subject"] == "deploy(recording): test"


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
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BootstrapStage]:
    folder = tmp_path_factory.mktemp("bootstrap")
    (folder / "api").mkdir()
    forge = ForgeProcess(folder / "forge")
    api = ApiServerProcess(folder / "api")
    database = DatabaseServer(folder / "database", issued=throw_away(ADDRESS), name=ADDRESS)
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


def repositories(seed: Path) -> list[dict[str, Any]]:
    """Both repositories, whose first files are below `seed`."""
    return [
        {
            "name": "robotkube/deployment",
            "description": "What runs",
            "branch": "main",
            "seed": str(seed / "deployment"),
            "access": {"manager": "read", "gate": "write", "argocd": "read", "operator-team": "write"},
            "main": ["gate"],
        },
        {
            "name": "robotkube/catalogue",
            "description": "What may run",
            "branch": "main",
            "seed": str(seed / "catalogue"),
            "access": {"manager": "read", "gate": "read", "publisher": "write"},
            "main": ["publisher"],
        },
    ]


def bootstrap_settings(stage: BootstrapStage, folder: Path, passwords: dict[str, str]) -> dict[str, Any]:
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
            "url": stage.forge.url,
            "administrator": account_folder(
                folder, "administrator", stage.forge.administrator, stage.forge.administrator_password
            ),
            "accounts": [account(name) for name in ("manager", "gate", "argocd", "publisher", "operator-team")],
            "organisations": [
                {"name": name, "packages": {"publisher": "write", "argocd": "read"}}
                for name in ("robotkube", "staging")
            ],
            "repositories": repositories(folder / "seed"),
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
            "host": ADDRESS,
            "port": stage.database.port,
            "authorities": str(stage.database.folder / "ca.crt"),
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


def run_bootstrap(stage: BootstrapStage, folder: Path, settings: dict[str, Any]) -> tuple[int, list[dict[str, Any]]]:
    environment = write_settings(folder, settings)
    environment |= {"KUBECONFIG": str(stage.kubeconfig), "PYTHONWARNINGS": "ignore"}
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


def test_the_bootstrap_process_makes_everything_once(stage: BootstrapStage, tmp_path: Path) -> None:
    passwords = {name: f"password of {name}" for name in NAMES}
    settings = bootstrap_settings(stage, tmp_path, passwords)
    code, first = run_bootstrap(stage, tmp_path, settings)
    assert code == 0, first
    assert "seed of robotkube/deployment" in changed(first)
    argocd_is_wired(stage, passwords)
    recorders_reach_their_own_database_only(stage, passwords)
    account = http_calls.get(f"{stage.forge.url}/api/v1/user", auth=("gate", passwords["gate"]))
    assert account.status_code == 200
    code, second = run_bootstrap(stage, tmp_path, settings)
    assert code == 0
    assert changed(second) == []
    rotated = passwords | {"recordings_cloud_0": "other", "argocd-manager": "other", "hook": "other"}
    code, third = run_bootstrap(stage, tmp_path, bootstrap_settings(stage, tmp_path, rotated))
    assert code == 0
    assert changed(third) == [
        "database account recordings_cloud_0",
        "password of manager",
        "hook secrets",
        "deployment argocd-server",
        "deployment argocd-applicationset-controller",
    ]
    argocd_is_wired(stage, rotated)
    recorders_reach_their_own_database_only(stage, rotated)


def argocd_is_wired(stage: BootstrapStage, passwords: dict[str, str]) -> None:
    api = connect(stage.api)
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


def recorders_reach_their_own_database_only(stage: BootstrapStage, passwords: dict[str, str]) -> None:
    own, other = "recordings_cloud_0", "recordings_edge_0"
    recorder = stage.database.client(own, passwords[own], own)
    recorder[own]["samples"].insert_one({"x": 1})
    for database in (other, "admin"):
        with pytest.raises(OperationFailure):
            recorder[database]["samples"].insert_one({"x": 1})


def test_the_bootstrap_says_what_is_wrong(stage: BootstrapStage, tmp_path: Path) -> None:
    settings = bootstrap_settings(stage, tmp_path, dict.fromkeys(NAMES, "word"))
    settings["database"]["kind"] = "oracle"
    settings["forge"]["repositories"][0]["seed"] = str(tmp_path / "nowhere")
    settings["forge"]["repositories"][0]["access"]["manager"] = "admin"
    settings["forge"]["organisations"][0]["packages"] = {"manager": "pulls"}
    settings["wait_seconds"] = 0
    code, said = run_bootstrap(stage, tmp_path, settings)
    assert code == 2
    text = said[-1]["error"]
    access = ("access.manager: must be pulls, read or write", "packages.manager: must be read or write")
    for part in ("database.kind: must be one of", "repositories[0].seed", *access):
        assert part in text
    assert "wait_seconds: must be a whole number" in text


def test_the_bootstrap_ends_when_argocd_never_comes(stage: BootstrapStage, tmp_path: Path) -> None:
    settings = bootstrap_settings(stage, tmp_path, dict.fromkeys(NAMES, "word"))
    del settings["forge"], settings["database"]
    settings["argocd"]["namespace"] = "elsewhere"
    settings["wait_seconds"] = 2
    code, said = run_bootstrap(stage, tmp_path, settings)
    assert code in (2, 3)
    assert "Secret argocd-secret in namespace elsewhere" in said[-1]["error"]
