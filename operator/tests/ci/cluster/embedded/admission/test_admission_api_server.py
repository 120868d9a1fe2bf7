"""The provider's files on a real API server: it starts with them, and a publication on this machine's disk is at work
without anything being asked of the server."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from ci import evidence
from ci.cluster.embedded.admission import admission_files
from ci.cluster.embedded.admission.catalogue_on_disk import CatalogueOnDisk
from ci.cluster.embedded.admission.controller import POLL_SECONDS, reconcile
from ci.cluster.embedded.host import followers
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster_contract import topology
from ci.images.image_lock import Image
from robotkube.registry.admission.adapters.policy_files import PolicyFiles
from robotkube.registry.admission.loops.policy_reconciler import CatalogueListing
from robotkube.registry.evidence.adapters.dsse import TrustedKeys
from tests.ci.cluster.embedded.admission.test_admission import SCENARIO, Forge
from tests.stages import programs
from tests.stages.attacks import shown
from tests.stages.kubernetes.judged_api_server import Api, served
from tests.stages.registry.admission_examples import (
    APPLICATION_CONTROLLER,
    APPLICATIONS,
    GENERATOR,
    OF_THE_PLATFORM,
    REPLICA_SETS,
    application,
    image,
    path,
    pod,
    workload,
)
from tests.stages.registry.signed_evidence import artefact, catalogue, published
from tests.stages.waiting import until

pytestmark = [pytest.mark.toolchain]
LOCK = (Image("platform", OF_THE_PLATFORM, Path("a")),)
DRY = "?dryRun=All"


@pytest.fixture
def forge(tmp_path: Path) -> Forge:
    return Forge(tmp_path / "forge")


@pytest.fixture
def looks() -> list[int]:
    """One for each time that the catalogue was looked at."""
    return []


@pytest.fixture
def api(tmp_path: Path, forge: Forge, looks: list[int], monkeypatch: pytest.MonkeyPatch) -> Iterator[Api]:
    """The API server with what the provider prepared, and the catalogue followed as the host's process does."""
    programs.folder()  # before the cache is another
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folders = ClusterFolders("demo")
    admission_files.prepare(folders, topology.read(SCENARIO, {"vehicles": "2"}), LOCK)
    own = admission_files.folder(folders)
    listing = CatalogueListing(CatalogueOnDisk(lambda: forge.repositories, own / "clones"), TrustedKeys(own / "keys"))
    reconciler = admission_files.policy_reconciler(folders, listing)
    end = threading.Event()

    def pause() -> None:
        looks.append(1)
        if end.wait(POLL_SECONDS):
            raise EOFError

    def run() -> None:
        with pytest.raises(EOFError):
            reconcile(reconciler, pause)

    thread = threading.Thread(target=run)
    with served(tmp_path / "server", PolicyFiles(own)) as api:
        for name in ("vehicle-00", "robotkube", "argocd"):
            api.done("POST", "/api/v1/namespaces", {"metadata": {"name": name}})
        thread.start()
        yield api
        end.set()
        thread.join(30)
    assert not thread.is_alive()


def test_a_publication_is_at_work_without_a_request_to_the_server(api: Api, forge: Forge, looks: list[int]) -> None:
    """Also while the forge is away: the last list stays."""
    pods = path("Pod", "vehicle-00") + DRY
    assert api.refusal("POST", pods, pod(image(1)), REPLICA_SETS).startswith(f"image {image(1)} may not run")
    api.done("POST", path("Deployment", "robotkube") + DRY, workload("Deployment", OF_THE_PLATFORM))
    forge.install()
    app = artefact("event-detector")
    forge.publish(catalogue(published(evidence.signing_key(), app, images=(image(1),))))
    began = time.monotonic()
    until(lambda: api.request("POST", pods, pod(image(1)), REPLICA_SETS)["kind"] == "Pod")
    print(f"at work {time.monotonic() - began:.2f} s after its publication")
    made = application()
    made["spec"]["source"]["targetRevision"] = app.digest
    api.done("POST", APPLICATIONS + DRY, made, GENERATOR)
    api.done("POST", path("Deployment", "vehicle-00") + DRY, workload("Deployment", image(1)), APPLICATION_CONTROLLER)
    forge.bare.rename(forge.bare.with_name("away"))
    seen = len(looks)
    until(lambda: len(looks) > seen + 2)
    api.done("POST", pods, pod(image(1)), REPLICA_SETS)
    shown("admission", api.refusal("POST", pods, pod(image(3)), REPLICA_SETS), "verifier-off")


def test_the_process_that_follows_is_started_again_when_it_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed, say: nothing that is published would run until the cluster is made anew."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folders = ClusterFolders("demo")
    log = tmp_path / "log"
    command = [*followers.STARTED_AGAIN, *followers.command(admission_files.MODULE, folders)]
    environment = {"PATH": os.environ["PATH"], **followers.environment()}
    with log.open("w") as said:  # without what admission prepares it ends by itself, and says why
        guard = subprocess.Popen(command, env=environment, stdout=said, stderr=said, start_new_session=True)
    try:
        until(lambda: log.read_text().count(": started again in 1 s") >= 2, "started again, and again")
    finally:
        os.killpg(guard.pid, signal.SIGKILL)
        guard.wait(10)
