"""The command `robotkube registry admission`: what may run by the catalogue's main, as the ConfigMap that the
admission policies of charts/robotkube ask; with `--stranded`, what of a cluster they would not let start again.

It reads the catalogue, believes what a trusted key signed, and changes nothing. Entries that call themselves verified
and are not go to stderr.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from robotkube.cli.output import Table
from robotkube.cli.platform import Platform
from robotkube.cli.registry.submit import CATALOGUE, choosing_forge, forge_access
from robotkube.errors import InputError
from robotkube.foundation.documents.core.patterns import IMAGE_BY_DIGEST, TEST_NAMESPACE
from robotkube.foundation.forge.adapters.git import GitClone
from robotkube.registry.admission.core.allowed import digests_of
from robotkube.registry.admission.core.domain import PROJECT, Domain
from robotkube.registry.admission.core.list_objects import list_object
from robotkube.registry.admission.core.listing import AllowedVersions
from robotkube.registry.admission.core.stranded import APPLICATIONS, KINDS, counted, stranded
from robotkube.registry.admission.loops.policy_reconciler import CatalogueListing
from robotkube.registry.evidence.adapters.dsse import TrustedKeys

NAMESPACE = "robotkube"
COLUMNS = ("namespace", "kind", "name", "why")


def listing_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("--keys", type=Path, required=True, metavar="FOLDER", help="public keys (*.pem) that count")
    parser.add_argument("--target", default=NAMESPACE, metavar="NAMESPACE", help=f"of the ConfigMap ({NAMESPACE})")
    parser.add_argument(
        "--stranded", action="store_true", help="list instead what of the cluster the policies would not let start"
    )
    choosing_forge(parser)


def show_list(options: argparse.Namespace) -> Table:
    """The ConfigMap, or with --stranded what it would strand; InputError when there is no catalogue yet, or more than a
    ConfigMap holds."""
    allowed = _listed(options)
    document = list_object(options.target, allowed)
    print(f"robotkube: {len(allowed.charts)} charts, {len(allowed.verified)} images", file=sys.stderr)
    if options.stranded:
        return _stranded(Platform(options), options, allowed)
    return Table("list", (), [document], single=True)


def _listed(options: argparse.Namespace) -> AllowedVersions:
    access = forge_access(options)
    with tempfile.TemporaryDirectory(prefix="robotkube-admission-") as folder:
        clone = GitClone(access.url, CATALOGUE, access.username, access.password, Path(folder))
        allowed = CatalogueListing(clone, TrustedKeys(options.keys)).read()
    if allowed is None:
        raise InputError(f"{CATALOGUE} at {access.url} has no main branch yet: publish a chart first")
    for problem in allowed.problems:
        print(f"robotkube: {problem}", file=sys.stderr)
    return allowed


def _stranded(platform: Platform, options: argparse.Namespace, verified: AllowedVersions) -> Table:
    """What of the cluster would be refused if it were made now; refused when there is any."""
    images = {name: reference for name, reference in platform.images().items() if reference}
    if not images:
        raise InputError(f"no ConfigMap platform-images in {options.platform_namespace}; is the platform installed?")
    by_digest = {name: reference for name, reference in images.items() if IMAGE_BY_DIGEST.fullmatch(reference)}
    for name in images.keys() - by_digest.keys():
        text = f"images.{name} of the platform's chart: {images[name]!r} names no digest, so nothing of it would start"
        print(f"robotkube: {text}; write <repository>@sha256:<digest>", file=sys.stderr)
    allowed = verified.with_platform(digests_of(by_digest.values()))
    objects = stranded(_objects(platform), _domain(platform, options), allowed)
    verdict = counted(objects, allowed)
    rows = [asdict(one) for one in objects]
    text = "".join(f"{one}\n" for one in objects) or f"{verdict}\n"
    return Table("stranded", COLUMNS, rows, refusal=verdict if objects else "", text=text)


def _domain(platform: Platform, options: argparse.Namespace) -> Domain:
    """The domain of the platform that is installed, as its namespaces and its project say."""
    tests = tuple(name for name in platform.namespaces() if TEST_NAMESPACE.fullmatch(name))
    sources = platform.project(PROJECT)["spec"].get("sourceRepos") or [""]
    charts = str(sources[0]).removesuffix("/*")
    own = options.platform_namespace
    gate = platform.gate_namespace()
    argocd = options.argocd_namespace
    return Domain(tuple(platform.agents()), tests, charts, own, gate, argocd)


def _objects(platform: Platform) -> Iterator[Mapping[str, Any]]:
    """Items of lists, which do not say their kind."""
    for path, kind in {**KINDS, APPLICATIONS: "Application"}.items():
        yield from ({**item, "kind": kind} for item in platform.everything(path))
