"""Admission of the embedded cluster: what the provider writes, and the catalogue that it follows on this machine's
disk."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from ci import evidence, installation
from ci.cluster import __main__ as commands
from ci.cluster.embedded.admission import admission_files
from ci.cluster.embedded.admission.catalogue_on_disk import REPOSITORY, CatalogueOnDisk
from ci.cluster.embedded.admission.controller import FIND_SECONDS, ForgeFolder, reconcile
from ci.cluster.embedded.admission.stranded import report, stranded_now
from ci.cluster.embedded.control_plane import programs
from ci.cluster.embedded.control_plane.pki import Authority
from ci.cluster.embedded.control_plane.programs import api_server_command
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.network.addresses import plan_of
from ci.cluster.embedded.provider import Embedded
from ci.cluster_contract import topology
from ci.errors import InputError, SetUpError
from ci.folders import PROJECT
from ci.images.image_lock import Image
from robotkube.errors import UnavailableError
from robotkube.registry.admission.core.expressions import RESOURCES
from robotkube.registry.admission.core.stranded import APPLICATIONS, KINDS
from robotkube.registry.admission.loops.policy_reconciler import CatalogueListing
from robotkube.registry.evidence.adapters.dsse import TrustedKeys
from tests.stages.registry.admission_examples import CHART, CHARTS, application, digest, image, pod, workload
from tests.stages.registry.signed_evidence import artefact, catalogue, published

SCENARIO = PROJECT / "scenarios" / "pose-point-cloud-db-recording" / "scenario.yaml"
LOCK = (Image("platform", image(2), Path("a")), Image("ros", image(4), Path("b")))


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv(admission_files.VARIABLE, raising=False)


@pytest.fixture
def folders() -> ClusterFolders:
    cluster_folders = ClusterFolders("demo")
    admission_files.prepare(cluster_folders, topology.read(SCENARIO, {"vehicles": "2"}), LOCK)
    return cluster_folders


def policies(folders: ClusterFolders) -> dict[str, str]:
    """Name -> all of it as text."""
    items = json.loads(admission_files.policy_files(folders).policies.read_text())["items"]
    return {item["metadata"]["name"]: json.dumps(item) for item in items if not item["kind"].endswith("Binding")}


def test_admission_is_enforced_unless_somebody_switches_it_off(monkeypatch: pytest.MonkeyPatch) -> None:
    assert Embedded("demo", Path()).admission == admission_files.FILES
    monkeypatch.setenv(admission_files.VARIABLE, "off")
    assert Embedded("demo", Path()).admission == admission_files.OFF
    assert Embedded("demo", Path(), "files").admission == admission_files.FILES
    monkeypatch.setenv(admission_files.VARIABLE, "on")
    with pytest.raises(InputError, match="ROBOTKUBE_ADMISSION: 'on' must be one of files, off"):
        Embedded("demo", Path())


def test_another_choice_is_another_cluster(monkeypatch: pytest.MonkeyPatch) -> None:
    wanted = topology.read(SCENARIO, {"vehicles": "2"})
    made = {Embedded("demo", Path(), choice)._specification(wanted) for choice in admission_files.CHOICES}
    assert len(made) == 2
    monkeypatch.setattr(admission_files, "for_files", lambda domain, allowed: [])  # other rules
    assert Embedded("demo", Path(), admission_files.FILES)._specification(wanted) not in made


def test_before_the_api_server_starts_the_platforms_images_are_listed(folders: ClusterFolders) -> None:
    listed = policies(folders)
    assert digest(2) in listed["robotkube-platform.static.k8s.io"]
    assert digest(4) in listed["robotkube-elsewhere.static.k8s.io"]
    assert digest(2) not in listed["robotkube-agents.static.k8s.io"]
    assert '"vehicle-00", "vehicle-01"]' in listed["robotkube-agents.static.k8s.io"]
    assert str(folders.volumes) in listed["robotkube-volumes.static.k8s.io"]
    key = evidence.signing_key()
    assert TrustedKeys(admission_files.folder(folders) / "keys").trusted() == {key.key_id}


def test_the_api_server_is_started_with_the_files_only_where_they_are_enforced(folders: ClusterFolders) -> None:
    options = admission_files.prepare(folders, topology.read(SCENARIO, {"vehicles": "2"}), LOCK)
    words = set(api_server_command(plan_of("demo"), folders, options))
    assert words - set(api_server_command(plan_of("demo"), folders)) == {
        "--feature-gates=ManifestBasedAdmissionControlConfig=true",
        f"--admission-control-config-file={admission_files.folder(folders) / 'admission.yaml'}",
    }


def test_the_gates_namespace_is_judged_where_the_installer_has_it(folders: ClusterFolders) -> None:
    assert installation.GATE in admission_files.surroundings(folders).domain.of_the_platform


def test_who_joins_and_what_is_imported_later_counts(folders: ClusterFolders) -> None:
    admission_files.add(folders, ["vehicle-77"], [Image("new", image(5), Path("c"))])
    around = admission_files.surroundings(folders)
    assert "vehicle-77" in around.domain.agents
    assert set(around.platform) == {digest(2), digest(4), digest(5)}
    other = ClusterFolders("test")
    admission_files.add(other, ["vehicle-77"])  # admission is off there
    assert not admission_files.folder(other).exists()


def test_an_image_without_a_digest_does_not_start_a_cluster() -> None:
    tagged = (Image("platform", "registry.example/robotkube:1.0", Path("a")),)
    with pytest.raises(InputError, match="names no digest; write <repository>@sha256:<digest>"):
        admission_files.prepare(ClusterFolders("demo"), topology.read(SCENARIO, {"vehicles": "2"}), tagged)


class Forge:
    """The forge's repositories on a disk, with a catalogue that is pushed to."""

    def __init__(self, folder: Path) -> None:
        self.repositories = folder / "repositories"
        self.work = folder / "work"
        self.bare = self.repositories / f"{REPOSITORY}.git"

    def install(self) -> None:
        subprocess.run(["git", "init", "-q", "--bare", "-b", "main", str(self.bare)], check=True, timeout=30)
        subprocess.run(["git", "init", "-q", "-b", "main", str(self.work)], check=True, timeout=30)

    def publish(self, files: Mapping[str, str]) -> None:
        for path, text in files.items():
            (self.work / path).parent.mkdir(parents=True, exist_ok=True)
            (self.work / path).write_text(text)
        who = ["-c", "user.name=gate", "-c", "user.email=gate@example.org"]
        for words in (["add", "-A"], [*who, "commit", "-qm", "published"], ["push", "-q", str(self.bare), "main"]):
            subprocess.run(["git", "-C", str(self.work), *words], check=True, timeout=30)


@pytest.fixture
def forge(tmp_path: Path) -> Forge:
    return Forge(tmp_path / "forge")


def test_policies_follow_what_is_published_on_this_machine(folders: ClusterFolders, forge: Forge) -> None:
    """From a platform that is not installed to a version that was built again, with the user's own key."""
    key = evidence.signing_key()
    app = artefact()
    on_disk = CatalogueOnDisk(lambda: forge.repositories, admission_files.folder(folders) / "clones")
    listing = CatalogueListing(on_disk, TrustedKeys(admission_files.folder(folders) / "keys"))
    reconciler = admission_files.policy_reconciler(folders, listing)
    with pytest.raises(UnavailableError, match="the forge has no catalogue yet"):
        reconciler.step()
    forge.install()
    assert not reconciler.step()
    forge.publish(catalogue(published(key, app, images=(image(1),))))
    assert reconciler.step()
    assert not reconciler.step()
    listed = policies(folders)
    assert digest(1) in listed["robotkube-agents.static.k8s.io"]
    assert f"app@{app.digest}" in listed["robotkube-applications.static.k8s.io"]
    forge.publish(catalogue(published(key, artefact(content="again"), images=(image(6),))))
    assert reconciler.step()
    assert {word for word in (digest(1), digest(6)) if word in policies(folders)["robotkube-agents.static.k8s.io"]} == {
        digest(1),
        digest(6),
    }


def test_a_forge_with_another_volume_is_followed_there(forge: Forge, tmp_path: Path) -> None:
    other = Forge(tmp_path / "other")
    places = [forge.repositories]
    for one, name in ((forge, "first"), (other, "second")):
        one.install()
        one.publish({"charts/a.txt": name})
    on_disk = CatalogueOnDisk(lambda: places[-1], tmp_path / "clones")
    assert on_disk.files(on_disk.fetch(), ["charts"]) == {"charts/a.txt": "first"}
    places.append(other.repositories)
    assert on_disk.files(on_disk.fetch(), ["charts"]) == {"charts/a.txt": "second"}


def test_main_is_fetched_when_it_moved_and_not_otherwise(
    forge: Forge, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    forge.install()
    forge.publish({"charts/a.txt": "1"})
    on_disk = CatalogueOnDisk(lambda: forge.repositories, tmp_path / "clones")
    first = on_disk.fetch()
    subprocess.run(["git", "-C", str(forge.bare), "pack-refs", "--all"], check=True, timeout=30)
    assert on_disk.fetch() == first  # packed: read again, to the same end
    monkeypatch.setattr(
        "ci.cluster.embedded.admission.catalogue_on_disk.GitClone.fetch", lambda self: pytest.fail("main stands still")
    )
    assert on_disk.fetch() == first


def test_the_forges_folder_is_asked_now_and_then_and_the_last_answer_counts() -> None:
    now, answers = [0.0], [SetUpError("no volume"), Path("/one"), SetUpError("the API server is away"), Path("/two")]

    def ask() -> Path:
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    place = ForgeFolder(ask, lambda: now[0])
    for _ in range(2):  # in the same words, or each would be logged
        with pytest.raises(UnavailableError, match=r"^the forge is not installed yet: no volume$"):
            place()
    now[0] += FIND_SECONDS
    assert place() == Path("/one")
    now[0] += FIND_SECONDS
    assert (place(), place()) == (Path("/one"), Path("/one"))
    now[0] += FIND_SECONDS
    assert place() == Path("/two")


class Failing:
    """A reconciler whose steps fail, one after the other."""

    def __init__(self, problems: Sequence[str]) -> None:
        self.problems = list(problems)

    def step(self) -> bool:
        problem = self.problems.pop(0)
        if problem:
            raise UnavailableError(problem)
        return False


def test_a_problem_is_logged_when_it_comes_and_when_it_changes(caplog: pytest.LogCaptureFixture) -> None:
    failing: Any = Failing(["away", "away", "gone", "", "gone"])

    def pause() -> None:
        if not failing.problems:
            raise EOFError

    with pytest.raises(EOFError):
        reconcile(failing, pause)
    stays = "admission: the policies stay as they are"
    said = [record.getMessage() for record in caplog.records]
    assert said == [f"{stays}: {word}" for word in ("away", "gone", "gone")]


def test_the_process_of_the_host_waits_for_a_platform(folders: ClusterFolders) -> None:
    """It writes what it knows, says once what it waits for, and goes on."""
    programs.write_credentials(Authority(folders.pki), plan_of(folders.name), folders)
    admission_files.add(folders, ["vehicle-77"])
    command = [sys.executable, "-m", "ci.cluster.embedded.admission.controller", "--name", folders.name]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        lines = [process.stderr.readline() for _ in range(2)]
        alive = process.poll() is None
        process.kill()
    assert alive
    assert "admission policies written charts=0 images=0 platform_images=2" in lines[0]
    assert "admission: the policies stay as they are: the forge is not installed yet" in lines[1]
    assert '"vehicle-77"' in policies(folders)["robotkube-agents.static.k8s.io"]


class Cluster:
    """Reads of an API server that has these objects."""

    def __init__(self, *made: tuple[str, dict[str, Any]]) -> None:
        self.objects: dict[str, list[dict[str, Any]]] = {place: [] for place in KINDS}
        self.volume = ""
        for place, item in made:
            self.objects.setdefault(place, []).append(item)

    def get(self, path: str) -> dict[str, Any]:
        if path in self.objects:
            return {
                "items": [{key: value for key, value in one.items() if key != "kind"} for one in self.objects[path]]
            }
        if self.volume and path.endswith("/persistentvolumeclaims/forge"):
            return {"spec": {"volumeName": "cloud-0-0"}}
        if self.volume and path.endswith("/persistentvolumes/cloud-0-0"):
            return {"spec": {"local": {"path": self.volume}}}
        raise SetUpError(f"GET {path}: 404")


def in_namespace(made: dict[str, Any], namespace: str) -> dict[str, Any]:
    return {**made, "metadata": {**made["metadata"], "namespace": namespace}}


def test_the_dry_run_names_what_could_not_be_made_again(forge: Forge) -> None:
    """Before there is a platform, and then by what the forge of the cluster has on this machine."""
    pods = "/api/v1/pods"
    deployments = "/apis/apps/v1/deployments"
    applications = APPLICATIONS
    bare = in_namespace(pod(), "vehicle-00")
    running = in_namespace(workload("Deployment"), "vehicle-00")
    of_the_platform = in_namespace(workload("Deployment", image(4)), "robotkube")
    cluster = Cluster(
        (pods, bare), (deployments, running), (deployments, of_the_platform), (applications, application())
    )
    wanted = topology.read(SCENARIO, {"vehicles": "2"})
    stranded = report(cluster, ClusterFolders("demo"), wanted, LOCK)
    not_listed = f"image {image(1)} is not listed for this namespace"
    assert [str(one) for one in stranded.stranded] == [
        f"argocd/application/vehicle-00-detector: chart {CHARTS}/event-detector at {CHART} is not verified on the "
        "catalogue's main",
        f"vehicle-00/deployment/detector: {not_listed}",
        f"vehicle-00/pod/pod: {not_listed}",
        "vehicle-00/pod/pod: no controller made this pod",
    ]
    assert "the forge is not installed yet" in stranded.lines[0]
    assert stranded.lines[-1] == "4 objects would be stranded (0 charts, 0 images, 2 of the platform listed)"
    forge.install()
    app = artefact("event-detector")
    forge.publish(catalogue(published(evidence.signing_key(), app, images=(image(1),))))
    cluster.volume = str(forge.repositories.parent)
    cluster.objects[pods] = []
    cluster.objects[applications][0]["spec"]["source"]["targetRevision"] = app.digest
    stranded = report(cluster, ClusterFolders("demo"), wanted, LOCK)
    assert stranded.lines == ("nothing would be stranded (1 charts, 1 images, 2 of the platform listed)",)


def test_a_dry_run_that_cannot_ask_says_so(tmp_path: Path) -> None:
    class Away(Cluster):
        def get(self, path: str) -> dict[str, Any]:
            if path == APPLICATIONS:
                raise SetUpError("the API server does not answer")
            return super().get(path)

    wanted = topology.read(SCENARIO, {"vehicles": "2"})
    assert report(Cluster(), ClusterFolders("demo"), wanted, LOCK).stranded == ()  # without Argo CD
    with pytest.raises(SetUpError, match="the API server does not answer"):
        report(Away(), ClusterFolders("demo"), wanted, LOCK)


def test_a_dry_run_needs_a_cluster() -> None:
    with pytest.raises(SetUpError, match="cluster demo is not running: start it with make cluster"):
        stranded_now(ClusterFolders("demo"), topology.read(SCENARIO, {"vehicles": "2"}), LOCK)


def test_the_dry_run_asks_for_every_kind_that_the_policies_judge() -> None:
    judged = {resource for _, resources in RESOURCES for resource in resources if "/" not in resource}
    assert {path.rpartition("/")[2] for path in KINDS} == judged


def test_the_command_line_knows_both(capsys: pytest.CaptureFixture[str]) -> None:
    options = commands.arguments().parse_args(["up", "--admission", "files", "--dry-run"])
    assert (options.admission, options.dry_run) == ("files", True)
    with pytest.raises(SystemExit):
        commands.arguments().parse_args(["up", "--admission", "maybe"])
    assert "invalid choice: 'maybe'" in capsys.readouterr().err
