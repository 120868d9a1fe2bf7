"""The command `robotkube bundle push FILE --to HOST/PATH`: everything in a bundle is copied to an OCI registry, every
digest as it is, so that references and evidence stay valid. Afterwards the registry is asked for all of it.

The same again changes nothing and copies only what is missing. Ends with 0 when all is there, 1 when something is not,
2 when something is wrong or may not be done, 3 when the registry does not answer.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from robotkube.cli.bundles.reading import choosing, opened
from robotkube.cli.output import Table
from robotkube.registry.bundles.adapters.accounts import given_account, kept_account
from robotkube.registry.bundles.adapters.oras import Oras, find_oras
from robotkube.registry.bundles.core.contents import PLATFORM_CHART
from robotkube.registry.bundles.core.places import RegistryPlace, read_place
from robotkube.registry.bundles.loops.comparing import differences
from robotkube.registry.charts.adapters.oci import OciRegistry

COLUMNS = ("kind", "name", "reference", "attached")


def pushing(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `push`."""
    choosing(parser)
    parser.add_argument("--to", required=True, metavar="HOST/PATH", help="where everything goes")
    parser.add_argument(
        "--ca", type=Path, metavar="FILE", help="PEM of an authority that the registry's certificate has"
    )
    parser.add_argument("--username", default="", help="account (default: that of `docker login`, if there is one)")
    parser.add_argument("--password-file", type=Path, metavar="FILE", help="its password or token")
    parser.add_argument("--plain-http", action="store_true", help="the registry speaks HTTP")
    parser.add_argument("--oras", metavar="FILE", help="the program that copies (default: oras on PATH)")


def push_bundle(options: argparse.Namespace) -> Table:
    """Copy, and compare what is there."""
    bundle = opened(options)
    place = read_place(options.to)
    account = given_account(options.username, options.password_file) or kept_account(place.host)
    oras = Oras(options.oras or find_oras(), account, options.ca, options.plain_http)
    items = [bundle.contents.listing(bundle.digest), *bundle.contents.items]
    for number, item in enumerate(items, 1):
        print(f"robotkube: [{number}/{len(items)}] {item.kind} {item.name}", file=sys.stderr, flush=True)
        oras.copy(bundle.path, item, place)
    url = f"{'http' if options.plain_http else 'https'}://{place.host}"
    with OciRegistry(url, account.user, account.password, authority=options.ca) as registry:
        problems = differences(registry, place, items)
    _say_next(place, bundle.contents.version)
    rows = [
        {
            "kind": item.kind,
            "name": item.name,
            "reference": place.reference(item),
            "attached": len(item.attached),
        }
        for item in items
    ]
    return Table("pushed", COLUMNS, rows, refusal="; ".join(problems))


def _say_next(place: RegistryPlace, version: str) -> None:
    command = f"helm install robotkube oci://{place}/{PLATFORM_CHART} --version {version}"
    print(f"robotkube: {command} --set global.imageRegistry={place} ...", file=sys.stderr)
