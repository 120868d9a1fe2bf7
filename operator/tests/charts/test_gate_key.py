"""The Job that makes the gate's key, as a process with the rights that the chart gives it, on a real API server: key
and public half in their places, kept by upgrades and by installing again, moved from where the gate stood before."""

from __future__ import annotations

import base64
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml

from robotkube.registry.evidence.adapters.dsse import KeyFile, TrustedKeys
from robotkube.registry.evidence.adapters.key_pairs import new_key_pair
from tests.stages.kubernetes.installed_chart import CHART, Cluster, prepared_cluster
from tests.stages.programs import program
from tests.stages.registry.signed_evidence import Signing, artefact
from tests.stages.secret_words import words
from tests.stages.settings_mounted import GATE

pytestmark = pytest.mark.toolchain

PROFILE = Path(__file__).parent / "profiles" / "official.yaml"
ACCOUNT = "system:serviceaccount:robotkube:gate-key"
COMMAND = ("-m", "robotkube.setup.gate_key")
RUN_SECONDS_MAX = 60
PLATFORM, KEY, PUBLIC = "robotkube", "gate-key", "gate-public-key"


@dataclass(frozen=True)
class Installed:
    """The platform on an API server without nodes, and the Job's process, which calls as its account."""

    cluster: Cluster
    administrator: httpx.Client
    values: Path
    api: str
    folder: Path

    def helm(self, verb: str, *options: str) -> None:
        """Install or upgrade, without the hooks: nothing here runs pods."""
        self.cluster.helm(verb, "robotkube", str(CHART), "-f", str(self.values), "--no-hooks", *options)

    def run(self, former: str = "") -> tuple[int, str]:
        """The process, with that key in the platform's namespace; exit code and log."""
        given = self.read(PLATFORM, "configmaps", KEY)
        assert given is not None
        text = given["data"]["config.yaml"]
        mounted = self.folder / "former" / "key.pem"
        mounted.parent.mkdir(exist_ok=True)
        mounted.write_text(former) if former else mounted.unlink(missing_ok=True)
        settings = self.folder / "config.yaml"
        settings.write_text(text.replace("/var/run/secrets/robotkube/former/key.pem", str(mounted)))
        environment = {
            **os.environ,
            "ROBOTKUBE_CONFIG": str(settings),
            "ROBOTKUBE_API_SERVER": self.api,
            "PYTHONPATH": os.pathsep.join(sys.path),
        }
        done = subprocess.run(
            [sys.executable, *COMMAND], env=environment, capture_output=True, text=True, timeout=RUN_SECONDS_MAX
        )
        return done.returncode, done.stderr

    def key(self) -> dict[str, Any] | None:
        """The Secret, as an administrator reads it."""
        return self.read(GATE, "secrets", KEY)

    def private(self) -> str:
        key = self.key()
        assert key is not None
        return base64.b64decode(key["data"]["key.pem"]).decode()

    def public(self, namespace: str) -> dict[str, str]:
        config_map = self.read(namespace, "configmaps", PUBLIC)
        return dict(config_map["data"]) if config_map else {}

    def read(self, namespace: str, kind: str, name: str) -> dict[str, Any] | None:
        """An object as the administrator reads it."""
        answer = self.administrator.get(f"/api/v1/namespaces/{namespace}/{kind}/{name}")
        return None if answer.status_code == 404 else dict(answer.raise_for_status().json())

    def lose(self, namespace: str, kind: str, name: str) -> None:
        """Delete an object, if it is there."""
        answer = self.administrator.delete(f"/api/v1/namespaces/{namespace}/{kind}/{name}")
        assert answer.is_success or answer.status_code == 404, answer.text

    def believed(self, folder: Path) -> bool:
        """Return whether what the key signs is believed in both namespaces."""
        (folder / "key").write_text(self.private())
        envelopes = Signing(KeyFile(folder / "key")).sign(artefact()).values()
        for namespace in (GATE, PLATFORM):
            trusted = folder / namespace
            trusted.mkdir(exist_ok=True)
            for name, pem in self.public(namespace).items():
                (trusted / name).write_text(pem)
            if not all(TrustedKeys(trusted).verify(envelope) for envelope in envelopes):
                return False
        return True

    def forget(self) -> None:
        self.lose(GATE, "secrets", KEY)
        for namespace in (GATE, PLATFORM):
            self.lose(namespace, "configmaps", PUBLIC)


@pytest.fixture(scope="module")
def values(helm: Any) -> Path:
    """The official profile, with agents whose namespaces stay: no controller removes one here."""
    profile = yaml.safe_load(PROFILE.read_text())
    profile["agents"] = [agent for agent in profile["agents"] if agent.get("records") or agent.get("claims")]
    return Path(helm.values(profile))


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory, values: Path) -> Iterator[Installed]:
    with prepared_cluster(tmp_path_factory.mktemp("api")) as cluster:
        environment = {**os.environ, "KUBECONFIG": str(cluster.kubeconfig), "HOME": str(cluster.kubeconfig.parent)}
        proxy = subprocess.Popen(
            [program("kubectl"), "proxy", "--port=0", f"--as={ACCOUNT}"],
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert proxy.stdout is not None
        api = "http://" + proxy.stdout.readline().split()[-1]
        with cluster.client() as administrator:
            stage = Installed(cluster, administrator, values, api, tmp_path_factory.mktemp("job"))
            stage.helm("install")
            yield stage
        proxy.kill()
        proxy.communicate(timeout=10)


@pytest.fixture
def without_key(installed: Installed) -> Installed:
    installed.forget()
    return installed


def test_the_key_is_made_once_and_believed(without_key: Installed, tmp_path: Path) -> None:
    code, log = without_key.run()
    assert (code, '"origin": "made", "trusted": 1' in log) == (0, True), log
    assert without_key.believed(tmp_path)
    assert without_key.private().splitlines()[1] not in log
    before = without_key.key()
    code, log = without_key.run()
    assert (code, '"origin": "kept", "trusted": 1' in log) == (0, True), log
    assert without_key.key() == before


@pytest.mark.thorough
def test_upgrade_removal_and_installing_again_keep_the_key(without_key: Installed, tmp_path: Path) -> None:
    assert without_key.run()[0] == 0
    before = without_key.key()
    cluster = without_key.cluster
    without_key.helm("upgrade")
    without_key.helm("upgrade", "--set", "logLevel=debug")
    assert without_key.key() == before
    cluster.helm("uninstall", "robotkube", "--no-hooks")
    assert without_key.key() == before
    without_key.helm("install")
    assert without_key.run()[0] == 0
    assert without_key.key() == before
    assert without_key.believed(tmp_path)


def test_an_upgrade_keeps_the_key_which_stands_in_its_secret_and_in_no_other(without_key: Installed) -> None:
    assert without_key.run()[0] == 0
    before = without_key.key()
    body = without_key.private().splitlines()[1]
    without_key.helm("upgrade")
    assert without_key.key() == before
    secrets = json.loads(without_key.cluster.kubectl("get", "secrets", "-A", "-o", "json"))["items"]
    assert len([secret for secret in secrets if secret["type"] == "helm.sh/release.v1"]) >= 2
    assert [secret["metadata"]["name"] for secret in secrets if body in words(secret)] == [KEY]


def test_the_key_of_an_older_installation_moves(without_key: Installed, tmp_path: Path) -> None:
    former = new_key_pair()
    code, log = without_key.run(former.private)
    assert (code, '"origin": "moved"' in log) == (0, True), log
    assert without_key.private() == former.private
    assert without_key.believed(tmp_path)
    code, log = without_key.run(former.private)
    assert code == 0
    assert "the same key stands where the gate was before: remove it there" in log


@pytest.mark.parametrize("lost", [GATE, PLATFORM])
def test_public_keys_that_were_lost_come_back(without_key: Installed, lost: str, tmp_path: Path) -> None:
    assert without_key.run()[0] == 0
    without_key.lose(lost, "configmaps", PUBLIC)
    assert without_key.run()[0] == 0
    assert without_key.believed(tmp_path)


def test_a_key_that_nobody_knows_is_said_with_the_way_out(without_key: Installed, tmp_path: Path) -> None:
    """The way out is that of docs/reference/charts.md."""
    assert without_key.run()[0] == 0
    for namespace in (GATE, PLATFORM):
        without_key.lose(namespace, "configmaps", PUBLIC)
    code, log = without_key.run()
    assert (code, "no ConfigMap (of namespaces robotkube-gate, robotkube)" in log) == (2, True), log
    (tmp_path / "key.pem").write_text(without_key.private())
    public = tmp_path / "gate.pem"
    public.write_text(KeyFile(tmp_path / "key.pem").public_key)
    without_key.cluster.kubectl("create", "configmap", PUBLIC, "-n", PLATFORM, f"--from-file={public}")
    assert without_key.run()[0] == 0
    assert without_key.believed(tmp_path)


def test_who_makes_the_key_cannot_read_it(without_key: Installed) -> None:
    assert without_key.run()[0] == 0
    for call in (("get",), ("get", "-o", "yaml"), ("patch", "-p", "{}"), ("delete", "--cascade=foreground")):
        command = (call[0], "secret", KEY, "-n", GATE, *call[1:], f"--as={ACCOUNT}")
        done = without_key.cluster.run("kubectl", *command)
        assert done.returncode == 1
        assert f'secrets "{KEY}" is forbidden' in done.stderr
    assert without_key.key() is not None


def test_a_given_key_in_the_former_place_alone_is_refused(installed: Installed) -> None:
    given = new_key_pair()
    values = {"evidence": {"existingSecret": "my-key", "trustedKeys": {"mine": given.public}}}
    file = installed.folder / "given.yaml"
    file.write_text(json.dumps(values))
    files = ("-f", str(installed.values), "-f", str(file))
    command = ("upgrade", "robotkube", str(CHART), *files, "--no-hooks", "--dry-run=server")
    literal = f"--from-literal=key.pem={given.private}"
    installed.cluster.kubectl("create", "secret", "generic", "my-key", literal)
    done = installed.cluster.run("helm", "-n", PLATFORM, *command)
    assert done.returncode != 0
    assert 'Secret "my-key" stands in namespace robotkube, but the gate runs in robotkube-gate now' in done.stderr
    installed.cluster.kubectl("create", "secret", "generic", "my-key", literal, "-n", GATE)
    assert "kind: Job\nmetadata:\n  name: gate-key" not in installed.cluster.helm(*command)
    for namespace in (GATE, PLATFORM):
        installed.lose(namespace, "secrets", "my-key")
