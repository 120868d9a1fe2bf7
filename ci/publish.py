"""Publishes what was built to the forge: images, charts, and the catalogue that names them by digest and state.

    python -m ci.publish --kubeconfig FILE                     the forge of that cluster, by its Service's address
    python -m ci.publish --forge-url URL --password-file FILE  any forge that the bootstrap has set up

Everything is content-addressed: publishing twice changes nothing. A local build never replaces a version in the
registry: its tag is `<version>_<first 12 digits of the manifest digest>` (docs/decisions/0002).
"""

from __future__ import annotations

import argparse
import base64
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import yaml

from ci.cluster.images import Image, lock_file, read_lock
from ci.errors import InputError, SetUpError
from ci.folders import PROJECT
from robotkube.adapters.chart_folders import pack
from robotkube.adapters.git_clones import GitClone
from robotkube.adapters.git_deployment import ProposalWriter
from robotkube.adapters.oci_registry import Registry
from robotkube.domain.charts_packing import PackedChart
from robotkube.domain.errors import RobotKubeError, UnavailableError
from robotkube.domain.texts import read_mapping, write_mapping

NAMESPACE, SERVICE, PORT = "robotkube", "forge", 3000
ACCOUNT, ACCOUNT_SECRET = "publisher", "forge-account-publisher"
STAGING, CATALOGUE = "staging", "robotkube/catalogue"
CHARTS, REGISTRY = PROJECT / "charts" / "apps", PROJECT / "registry"
FOLDERS = ("applications", "charts", "policies")
DIGEST_DIGITS = 12
ATTEMPTS_MAX = 3
WAIT_SECONDS_MAX = 60.0
RETRY_SECONDS = 1.0

T = TypeVar("T")


@dataclass(frozen=True)
class ForgeAccess:
    """Where the forge is reached from here, and the publisher's password."""

    url: str
    password: str


@dataclass(frozen=True)
class PublishedChart:
    """A chart in the registry: `images` are the references it runs."""

    name: str
    version: str
    digest: str
    images: tuple[str, ...]


@dataclass(frozen=True)
class Published:
    """What stands in the forge now; `commit` is the catalogue's main, `changed` whether this run wrote it."""

    images: tuple[str, ...]
    charts: tuple[PublishedChart, ...]
    commit: str
    changed: bool


def publish(kubeconfig: Path, say: Callable[[str], None] = lambda text: None) -> Published:
    """Publish to the forge of the cluster that `kubeconfig` names; SetUpError says what is in the way."""
    return publish_to(find_forge(kubeconfig), read_lock(lock_file()), say)


def find_forge(kubeconfig: Path) -> ForgeAccess:
    """The forge's Service address, which the nodes' host can reach, and the publisher's password."""
    from kubernetes import client, config
    from urllib3.exceptions import HTTPError

    try:
        api = client.CoreV1Api(config.new_client_from_config(str(kubeconfig)))
        service = api.read_namespaced_service(SERVICE, NAMESPACE, _request_timeout=10)
        secret = api.read_namespaced_secret(ACCOUNT_SECRET, NAMESPACE, _request_timeout=10)
    except client.ApiException as error:
        what = f"namespace {NAMESPACE}: Service {SERVICE} or Secret {ACCOUNT_SECRET}: {error.reason}"
        raise SetUpError(f"{what}; install the platform first (charts/robotkube)") from error
    except (config.ConfigException, HTTPError, OSError) as error:
        raise SetUpError(f"{kubeconfig}: no answer from this cluster: {error}") from error
    password = base64.b64decode(secret.data["password"]).decode()
    return ForgeAccess(f"http://{service.spec.cluster_ip}:{PORT}", password)


def publish_to(
    forge: ForgeAccess, images: Sequence[Image], say: Callable[[str], None] = lambda text: None
) -> Published:
    """Images, then charts, then the catalogue: each names only what is already there."""
    try:
        with Registry(forge.url, ACCOUNT, forge.password) as registry:
            references = {image.name: image.reference for image in images}
            for image in images:
                _patiently(lambda image=image: push_image(registry, image))  # type: ignore[misc]
                say(f"image {image.reference}")
            charts = tuple(push_chart(registry, entry, references) for entry in chart_entries(REGISTRY))
            for chart in charts:
                say(f"chart {STAGING}/{chart.name} {chart.version} {chart.digest}")
        with tempfile.TemporaryDirectory(prefix="robotkube-catalogue-") as folder:
            clone = GitClone(forge.url, CATALOGUE, ACCOUNT, forge.password, Path(folder))
            writer = ProposalWriter(Path(folder), ACCOUNT, forge.password, ACCOUNT, time.time)
            commit, changed = write_catalogue(clone, writer, charts)
    except RobotKubeError as error:
        raise SetUpError(f"publishing to {forge.url}: {error}") from error
    say(f"catalogue {CATALOGUE} {commit[:12]} {'written' if changed else 'unchanged'}")
    return Published(tuple(references.values()), charts, commit, changed)


def _patiently(call: Callable[[], T]) -> T:
    """The call's answer; a forge that does not answer is asked again within WAIT_SECONDS_MAX."""
    end = time.monotonic() + WAIT_SECONDS_MAX
    while True:
        try:
            return call()
        except UnavailableError:
            if time.monotonic() >= end:
                raise
            time.sleep(RETRY_SECONDS)


def push_image(registry: Registry, image: Image) -> str:
    """Push by digest to the repository that the image's reference names; the digest must come out the same."""
    repository = image.repository.partition("/")[2]
    digest = registry.push_image(repository, image.archive)
    if not image.reference.endswith(f"@{digest}"):
        raise InputError(f"{image.archive}: holds {digest}, the lock says {image.reference}; build the images again")
    return digest


@dataclass(frozen=True)
class ChartEntry:
    """A chart version of the sources: `text` of its file, and the names of the images it uses."""

    name: str
    version: str
    images: tuple[str, ...]
    document: Mapping[str, Any]


def chart_entries(registry: Path) -> tuple[ChartEntry, ...]:
    """Every `charts/<chart>/<version>.yaml` of the sources whose version is the one in charts/apps."""
    entries = []
    for path in sorted((registry / "charts").glob("*/*.yaml")):
        document = read_mapping(path.read_text(encoding="utf-8"), str(path))
        if "status" in document:
            raise InputError(f"{path}: status: is written by the publisher only; remove it")
        spec = document.get("spec") or {}
        entry = ChartEntry(path.parent.name, path.stem, tuple(spec.get("images") or ()), document)
        if entry.version == _chart_version(CHARTS / entry.name):
            entries.append(entry)
    missing = {folder.name for folder in _chart_folders()} - {entry.name for entry in entries}
    if missing:
        first = sorted(missing)[0]
        wanted = registry / "charts" / first / f"{_chart_version(CHARTS / first)}.yaml"
        raise InputError(f"{wanted}: missing; every chart of {CHARTS} needs an entry for its version")
    return tuple(entries)


def _chart_folders() -> list[Path]:
    folders = [path.parent for path in sorted(CHARTS.glob("*/Chart.yaml"))]
    return [folder for folder in folders if _chart(folder).get("type", "application") == "application"]


def _chart(folder: Path) -> Mapping[str, Any]:
    path = folder / "Chart.yaml"
    if not path.is_file():
        raise InputError(f"{path}: missing; the registry names a chart that is not in {CHARTS}")
    return yaml.safe_load(path.read_text(encoding="utf-8")) or {}


def _chart_version(folder: Path) -> str:
    return str(_chart(folder).get("version", ""))


def push_chart(registry: Registry, entry: ChartEntry, references: Mapping[str, str]) -> PublishedChart:
    """Pack with the images it uses and push it to staging under the tag of a local build."""
    unknown = [name for name in entry.images if name not in references]
    if unknown:
        where = f"registry/charts/{entry.name}/{entry.version}.yaml"
        raise InputError(f"{where}: spec.images: no image {unknown[0]!r}; there are {', '.join(sorted(references))}")
    used = {name: references[name] for name in entry.images}
    packed = pack(CHARTS / entry.name, used)
    digest = registry.push_chart(STAGING, _LocalBuild(packed))
    return PublishedChart(entry.name, entry.version, digest, tuple(used[name] for name in sorted(used)))


class _LocalBuild(PackedChart):
    """A packed chart under the tag of a local build; content and digest are the same."""

    def __init__(self, packed: PackedChart) -> None:
        super().__init__(packed.name, packed.version, packed.archive, packed.config, packed.manifest)

    @property
    def tag(self) -> str:
        return local_tag(self.version, self.digest)


def local_tag(version: str, digest: str) -> str:
    """`0.1.0_1a2b3c4d5e6f`: a registry's tag cannot have `+`, so `_` stands for it as Helm writes it."""
    return f"{version}_{digest.removeprefix('sha256:')[:DIGEST_DIGITS]}"


def write_catalogue(clone: GitClone, writer: ProposalWriter, charts: Sequence[PublishedChart]) -> tuple[str, bool]:
    """One commit with what differs from the sources; the branch's tip and whether it was written now."""
    for _ in range(ATTEMPTS_MAX):
        tip = _patiently(clone.fetch)
        present = clone.files(tip, FOLDERS)
        wanted = catalogue_files(REGISTRY, charts, present)
        changes: dict[str, str | None] = {path: text for path, text in wanted.items() if present.get(path) != text}
        changes |= {path: None for path in present if path not in wanted and not path.startswith("charts/")}
        if not changes:
            return tip, False
        commit = writer.commit(tip, changes, commit_message(charts, present, changes))
        if clone.push_main(commit):
            return commit, True
    raise InputError(f"{CATALOGUE}: main moved {ATTEMPTS_MAX} times while it was written; publish once at a time")


def catalogue_files(registry: Path, charts: Sequence[PublishedChart], present: Mapping[str, str]) -> dict[str, str]:
    """Path -> text of the catalogue repository's three folders. Chart versions that the sources no longer have stay:
    releases may still name them."""
    files: dict[str, str] = {}
    for folder in ("applications", "policies"):
        for source in sorted((registry / folder).glob("*.yaml")):
            files[f"{folder}/{source.name}"] = source.read_text(encoding="utf-8")
    for entry in chart_entries(registry):
        published = next(chart for chart in charts if chart.name == entry.name)
        path = f"charts/{entry.name}/{entry.version}.yaml"
        files[path] = write_mapping({**entry.document, "status": chart_status(published, present.get(path, ""))})
    return files


def chart_status(chart: PublishedChart, present: str) -> dict[str, Any]:
    """The status of a chart version: a digest that is known keeps its state and evidence, a new one is staged."""
    known = (yaml.safe_load(present) or {}).get("status") or {} if present else {}
    if known.get("digest") == chart.digest:
        return {**known, "images": list(chart.images)}
    return {"state": "staged", "digest": chart.digest, "images": list(chart.images)}


def commit_message(
    charts: Sequence[PublishedChart], present: Mapping[str, str], changes: Mapping[str, str | None]
) -> str:
    """`publish: <charts>`, and a line per chart version that changes."""
    moved = [chart for chart in charts if f"charts/{chart.name}/{chart.version}.yaml" in changes]
    names = ", ".join(f"{chart.name} {chart.version}" for chart in moved) or "applications and policies"
    lines = [f"RobotKube-Chart: {chart.name}@{chart.version}@{chart.digest}" for chart in moved]
    verb = "publish" if moved or present else "begin"
    return "\n".join([f"{verb}: {names}", "", *lines]).rstrip() + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m ci.publish", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--kubeconfig", type=Path)
    where.add_argument("--forge-url")
    parser.add_argument("--password-file", type=Path, help="the publisher's password, with --forge-url")
    given = parser.parse_args()
    if given.forge_url and not given.password_file:
        parser.error("--forge-url needs --password-file")
    try:
        if given.kubeconfig:
            publish(given.kubeconfig, print)
        else:
            access = ForgeAccess(given.forge_url.rstrip("/"), given.password_file.read_text(encoding="utf-8").strip())
            publish_to(access, read_lock(lock_file()), print)
    except OSError as error:
        print(f"error: {error}", file=sys.stderr)
        return SetUpError.exit_code
    except SetUpError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
