"""Publishes what was built to the forge: images with their bills of materials, then charts and applications, as any
publisher does: by a submission that the gate verifies. The platform's images have an account of their own.

    python -m ci.publish --kubeconfig FILE                     the forge of that cluster, by its Service's address
    python -m ci.publish --forge-url URL --password-file FILE --image-password-file FILE
                                                               any forge that the bootstrap has set up
    ... --chart object-detection --chart object-tracking@0.1.0 these charts, too

Every chart costs the time of its suites, so only those that the platform needs are published (BASE) and those that
are asked for, the latter with the versions that they replace. Older versions are in charts/earlier. Applications are
published when all charts that they run are.

Everything is content-addressed: publishing twice changes nothing. A local build never replaces a version in the
registry: its tag is `<version>_<first 12 digits of the manifest digest>` (docs/decisions/0002). Evidence is kept, by
default in the user's cache, so that the same digest is not verified again in the next cluster.
"""

from __future__ import annotations

import argparse
import base64
import random
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar
from urllib.parse import urlsplit

import httpx

from ci import evidence
from ci.cluster_contract.provider import Reach, ServicePort, directly
from ci.errors import InputError, SetUpError
from ci.folders import PROJECT
from ci.images.image_lock import Image, lock_file, read_lock
from robotkube.backoffs import backoff
from robotkube.cli.registry.source_problems import check_sources
from robotkube.cli.registry.submit import ACCOUNT, CATALOGUE, ForgeAccess, submit_sources
from robotkube.errors import RobotKubeError, UnavailableError
from robotkube.foundation.certificates.adapters.certificate_authorities import certificate_authorities, trust_text
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.foundation.forge.adapters.relay import by_name
from robotkube.foundation.forge.ports.pull_requests import PullRequest
from robotkube.foundation.kubernetes.core.service_names import port_of, service_of
from robotkube.registry.catalogue.core.catalogue import read_application
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.charts.core.packing import CHART_FILE
from robotkube.registry.images.adapters import bills
from robotkube.registry.publication.adapters import submission_folders as sources
from robotkube.registry.publication.loops.submitting import REFUSED, SubmissionOutcome
from robotkube.registry.publication.ports import ChartSource, SubmittedSources

NAMESPACE = "robotkube"
GATE, GATE_NAMESPACE = "gate", "robotkube-gate"  # whose settings say where the forge is
AUTHORITIES = "robotkube-ca"
IMAGE_ACCOUNT = "image-publisher"
PERSON = "operator-team"
PULL_ACCOUNT = "nodes"  # that nodes pull images with
CHARTS = PROJECT / "charts" / "apps"
REGISTRY = PROJECT / "registry"
EARLIER = PROJECT / "charts" / "earlier"
BASE = ("bag-player", "event-detector", "mqtt-bridge")
WAIT_SECONDS_MAX = 60.0  # for a forge that does not answer
VERDICT_SECONDS_MAX = 900.0  # for the gate's suites
RETRY_SECONDS_FIRST = 1.0
RETRY_SECONDS_MAX = 2.0
LANES = 2  # images on their way at once: the registry hashes each on one core

T = TypeVar("T")


@dataclass(frozen=True)
class PublishingAccounts:
    """Who publishes at the forge: `charts` submits, `images` pushes the platform's images, which no publisher may, and
    `person` approves what runs by itself; without one, the submission waits until somebody does."""

    charts: ForgeAccess
    images: ForgeAccess
    person: ForgeAccess | None = None


@dataclass(frozen=True)
class Published:
    """What stands in the forge now: references of `images`, and what became of the submission."""

    images: tuple[str, ...]
    outcome: SubmissionOutcome


def publish(
    kubeconfig: Path,
    progress: Callable[[str], None] = lambda text: None,
    kept: Path | None = None,
    extra: Sequence[str] = (),
    reach: Reach = directly,
) -> Published:
    """Publish to the forge of the cluster that `kubeconfig` names; SetUpError says what is in the way. `kept`: folder
    of evidence (default: the user's cache), `extra`: charts beside BASE, `<name>` or `<name>@<version>`, `reach`: how
    this process gets to the forge."""
    return publish_to(
        find_accounts(kubeconfig, reach), read_lock(lock_file()), kept or evidence.kept_folder(), progress, extra
    )


def find_accounts(kubeconfig: Path, reach: Reach = directly) -> PublishingAccounts:
    """All accounts, of the cluster that `kubeconfig` names: who is its administrator approves what the folders have."""
    charts, images, person = (find_forge(kubeconfig, name, reach) for name in (ACCOUNT, IMAGE_ACCOUNT, PERSON))
    if charts.url.startswith("https:"):  # of these, the first alone speaks Git
        charts = replace(charts, url=by_name(charts.url))
    return PublishingAccounts(charts, images, person)


def find_forge(kubeconfig: Path, account: str = ACCOUNT, reach: Reach = directly) -> ForgeAccess:
    """The forge's address by `reach` (else its Service's, which nodes reach), and an account of it. One of others that
    is no Service is reached at its URL, and its certificate is of the usual authorities."""
    from kubernetes import client, config
    from urllib3.exceptions import HTTPError

    account_secret = f"forge-account-{account}"
    try:
        api = client.CoreV1Api(config.new_client_from_config(str(kubeconfig)))
        settings = api.read_namespaced_config_map(GATE, GATE_NAMESPACE, _request_timeout=10).data["config.yaml"]
        url = str(read_mapping(settings, f"configmap {GATE_NAMESPACE}/{GATE}")["forge"]["url"])
        namespace, name = service_of(urlsplit(url).netloc) or ("", "")
        service = api.read_namespaced_service(name, namespace, _request_timeout=10) if name else None
        secret = api.read_namespaced_secret(account_secret, NAMESPACE, _request_timeout=10)
    except client.ApiException as error:
        of_gate, of_account = f"ConfigMap {GATE_NAMESPACE}/{GATE}", f"Secret {NAMESPACE}/{account_secret}"
        what = f"{of_gate}, {of_account} or the forge's Service: {error.reason}"
        raise SetUpError(f"{what}; install the platform first (charts/robotkube)") from error
    except (config.ConfigException, HTTPError, OSError) as error:
        raise SetUpError(f"{kubeconfig}: no answer from this cluster: {error}") from error
    password = base64.b64decode(secret.data["password"]).decode()
    if service is None:
        return ForgeAccess(url, account, password)
    if url.startswith("https:"):
        trust_text(authorities(kubeconfig))
    host, port = reach(ServicePort(namespace, name, service.spec.cluster_ip, port_of(url)))
    return ForgeAccess(f"{urlsplit(url).scheme}://{host}:{port}", account, password)


def authorities(kubeconfig: Path) -> str:
    """The authority that signs the certificates of the platform's servers, as PEM."""
    from kubernetes import client, config

    api = client.CoreV1Api(config.new_client_from_config(str(kubeconfig)))
    try:
        config_map = api.read_namespaced_config_map(AUTHORITIES, NAMESPACE, _request_timeout=10)
    except client.ApiException as error:
        raise SetUpError(f"namespace {NAMESPACE}: ConfigMap {AUTHORITIES}: {error.reason}") from error
    return str((config_map.data or {}).get("ca.crt", ""))


def publish_to(
    accounts: PublishingAccounts,
    images: Sequence[Image],
    kept: Path,
    progress: Callable[[str], None] = lambda text: None,
    extra: Sequence[str] = (),
) -> Published:
    """The images that charts run, then the submission, which names only what is already there; all other images go
    beside it. `kept`: evidence of earlier publications, taken from and written to this folder. `extra`: as above."""
    forge, pusher = accounts.charts, accounts.images
    try:
        references = {image.name: image.reference for image in images}
        submitted = read_all(references, kept, extra)
        with OciRegistry(pusher.url, pusher.username, pusher.password) as registry, ThreadPoolExecutor(LANES) as lanes:
            first, others = _needed_first(images, submitted)
            for image in first:
                push_image(registry, image)
            pushed = [lanes.submit(push_image, registry, image) for image in others]
            outcome = submit_sources(forge, submitted, progress, VERDICT_SECONDS_MAX, opened=approval(accounts.person))
            for push in pushed:
                push.result()
        progress(f"{len(images)} images with their bills of materials")
        sources.write_kept(kept, outcome.evidence)
    except RobotKubeError as error:
        raise SetUpError(f"publishing to {forge.url}: {error}") from error
    if outcome.verdict == REFUSED:
        raise SetUpError(f"the gate refused to publish, see {outcome.url}:\n{outcome.text}")
    return Published(tuple(references.values()), outcome)


def read_all(references: Mapping[str, str], kept: Path, extra: Sequence[str] = ()) -> SubmittedSources:
    """The charts of BASE, those of `extra` with the versions they replace, the applications that all these can run, and
    the evidence that is kept; InputError names every mistake."""
    newest = dict.fromkeys(sources.all_charts(CHARTS), CHARTS)
    earlier = {f"{name}@{_version(EARLIER, name)}": EARLIER for name in sources.all_charts(EARLIER)}
    places = newest | {f"{name}@{_version(CHARTS, name)}": CHARTS for name in newest} | earlier
    unknown = [name for name in extra if name not in places]
    if unknown:
        raise InputError(f"no chart {', '.join(unknown)}; there are {', '.join(sorted([*newest, *earlier]))}")
    charts: dict[tuple[str, str], ChartSource] = {}
    waiting = [*BASE, *extra]
    while waiting:  # a version is read once
        name = waiting.pop()
        chart = sources.read_chart(name.partition("@")[0], places[name], REGISTRY, references)
        if (chart.packed.name, chart.packed.version) not in charts:
            charts[chart.packed.name, chart.packed.version] = chart
            spec = chart.document["spec"]
            older = [f"{chart.packed.name}@{version}" for version in (spec.get("replaces"), *spec.get("skips", ()))]
            waiting += [version for version in older if version in places and name not in BASE]
    return _checked([charts[key] for key in sorted(charts)], kept)


def approval(person: ForgeAccess | None) -> Callable[[PullRequest], None]:
    """The approval of a submission by `person`, of exactly the commit that was submitted."""

    def approve(pull: PullRequest) -> None:
        if person is None:
            return
        url = f"{person.url}/api/v1/repos/{CATALOGUE}/pulls/{pull.number}/reviews"
        review = {"event": "APPROVED", "commit_id": pull.head, "body": "What the folders of this installation have."}
        try:
            answer = httpx.post(
                url,
                json=review,
                auth=(person.username, person.password),
                verify=certificate_authorities(),
                timeout=WAIT_SECONDS_MAX,
            )
            answer.raise_for_status()
        except httpx.HTTPError as error:
            raise UnavailableError(f"{person.username} cannot approve {pull.url}: {error}") from error

    return approve


def _version(charts: Path, name: str) -> str:
    return str(read_mapping((charts / name / CHART_FILE).read_text(encoding="utf-8"), name)["version"])


def _checked(charts: Sequence[ChartSource], kept: Path) -> SubmittedSources:
    """The charts with the applications that they can run, both checked."""
    names = {chart.packed.name for chart in charts}
    provided = {word for chart in charts for word in chart.document["spec"].get("provides", ())}
    texts = {
        name: (REGISTRY / "applications" / f"{name}.yaml").read_text() for name in sources.all_applications(REGISTRY)
    }
    read = {name: read_application(text, f"applications/{name}.yaml") for name, text in texts.items()}
    needed = {name: [service.chart for service in one.services] for name, one in read.items()}
    runnable = [
        name for name, wanted in needed.items() if all(c.name in names or c.provides in provided for c in wanted)
    ]
    check_sources(sorted(names), runnable, CHARTS, REGISTRY, "submitted")
    applications = {f"applications/{name}.yaml": texts[name] for name in runnable}
    return SubmittedSources(tuple(charts), applications, sources.read_kept(kept))


def _needed_first(images: Sequence[Image], submitted: SubmittedSources) -> tuple[list[Image], list[Image]]:
    """The images that charts run, and all others."""
    needed = {reference for chart in submitted.charts for reference in chart.images}
    return [i for i in images if i.reference in needed], [i for i in images if i.reference not in needed]


def push_image(registry: OciRegistry, image: Image) -> str:
    """Push by digest to the repository that the image's reference names, with its bill of materials; the digest must
    come out the same."""
    repository = image.repository.partition("/")[2]
    digest = _patiently(lambda: registry.push_image(repository, image.archive, ground=image.ground))
    if not image.reference.endswith(f"@{digest}"):
        raise InputError(f"{image.archive}: holds {digest}, the lock says {image.reference}; build the images again")
    _patiently(lambda: bills.attach_bill(registry, repository, digest, image.archive))
    return digest


def _patiently(call: Callable[[], T]) -> T:
    """The call's answer; a forge that does not answer is asked again within WAIT_SECONDS_MAX."""
    end = time.monotonic() + WAIT_SECONDS_MAX
    attempts = 0
    while True:
        try:
            return call()
        except UnavailableError:
            if time.monotonic() >= end:
                raise
            time.sleep(backoff(attempts, RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX, random.random))
            attempts += 1


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m ci.publish", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--kubeconfig", type=Path)
    where.add_argument("--forge-url")
    parser.add_argument("--password-file", type=Path, help=f"password of {ACCOUNT}, with --forge-url")
    parser.add_argument("--image-password-file", type=Path, help=f"password of {IMAGE_ACCOUNT}, with --forge-url")
    parser.add_argument("--person-password-file", type=Path, help=f"of {PERSON}, who approves what runs by itself")
    parser.add_argument("--kept", type=Path, help="folder of evidence (default: the user's cache)")
    parser.add_argument("--chart", action="append", default=[], metavar="NAME[@VERSION]", help="publish it as well")
    given = parser.parse_args()
    if given.forge_url and not (given.password_file and given.image_password_file):
        parser.error("--forge-url needs --password-file and --image-password-file")
    try:
        images = read_lock(lock_file())
        kept = given.kept or evidence.kept_folder()
        published = publish_to(_accounts(given), images, kept, print, given.chart)
    except OSError as error:
        print(f"error: {error}", file=sys.stderr)
        return SetUpError.exit_code
    except SetUpError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    print(published.outcome.verdict)
    return 0


def _accounts(given: argparse.Namespace) -> PublishingAccounts:
    if given.kubeconfig:
        return find_accounts(given.kubeconfig)
    approving = given.person_password_file
    return PublishingAccounts(
        _account(given.forge_url, ACCOUNT, given.password_file),
        _account(given.forge_url, IMAGE_ACCOUNT, given.image_password_file),
        _account(given.forge_url, PERSON, approving) if approving else None,
    )


def _account(url: str, name: str, password_file: Path) -> ForgeAccess:
    return ForgeAccess(url.rstrip("/"), name, password_file.read_text(encoding="utf-8").strip())


if __name__ == "__main__":
    sys.exit(main())
