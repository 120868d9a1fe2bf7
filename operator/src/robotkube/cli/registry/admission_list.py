"""The command `robotkube registry admission`: what may run by the catalogue's main, as the ConfigMap that the
admission policies of charts/robotkube ask.

It reads the catalogue, believes what a trusted key signed, and changes nothing: who runs it applies what it prints.
Entries that call themselves verified and are not go to stderr.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from robotkube.cli.output import Table
from robotkube.cli.registry.submit import CATALOGUE, choosing_forge, forge_access
from robotkube.errors import InputError
from robotkube.foundation.forge.adapters.git import GitClone
from robotkube.registry.admission.core.policies import LIST, list_entries
from robotkube.registry.admission.loops.following import CatalogueListing
from robotkube.registry.evidence.adapters.dsse import TrustedKeys

NAMESPACE = "robotkube"
ENTRIES_MAX = 8000  # a ConfigMap holds 1 MiB


def listing_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("--keys", type=Path, required=True, metavar="FOLDER", help="public keys (*.pem) that count")
    parser.add_argument("--target", default=NAMESPACE, metavar="NAMESPACE", help=f"of the ConfigMap ({NAMESPACE})")
    choosing_forge(parser)


def show_list(options: argparse.Namespace) -> Table:
    """The ConfigMap; InputError when there is no catalogue yet, or more than a ConfigMap holds."""
    access = forge_access(options)
    with tempfile.TemporaryDirectory(prefix="robotkube-admission-") as folder:
        clone = GitClone(access.url, CATALOGUE, access.username, access.password, Path(folder))
        found = CatalogueListing(clone, TrustedKeys(options.keys)).read()
    if found is None:
        raise InputError(f"{CATALOGUE} at {access.url} has no main branch yet: publish a chart first")
    for problem in found.problems:
        print(f"robotkube: {problem}", file=sys.stderr)
    data = list_entries(found.charts, found.verified)
    if len(data) > ENTRIES_MAX:
        raise InputError(f"{len(data)} entries do not fit into a ConfigMap ({ENTRIES_MAX}): withdraw old versions")
    print(f"robotkube: {len(found.charts)} charts, {len(found.verified)} images", file=sys.stderr)
    head = {"apiVersion": "v1", "kind": "ConfigMap", "metadata": {"name": LIST, "namespace": options.target}}
    return Table("list", (), [{**head, "data": data}], single=True)
