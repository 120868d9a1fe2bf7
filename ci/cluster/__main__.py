"""`python -m ci.cluster`: start, stop and inspect the embedded cluster, or take Nodes of a cluster that is there."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from ci import packages
from ci.cluster import choosing
from ci.cluster.embedded.admission import admission_files
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.provider import Embedded
from ci.cluster.existing.provider import Existing
from ci.cluster_contract import topology
from ci.errors import InputError, SetUpError
from ci.folders import PROJECT
from ci.images import image_lock
from ci.machine import preflight

SCENARIO = PROJECT / "scenarios" / "pose-point-cloud-db-recording" / "scenario.yaml"
INTERRUPTED = 130  # as of a shell


def arguments() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m ci.cluster", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    for name, text in (
        (
            "up",
            "start the cluster, or use the running one if it equals; of one that is there: its Nodes become agents'",
        ),
        ("down", "remove the cluster and prove it; of one that is there: what was added"),
        ("status", "nodes, pods that are not ready, cost of the cluster's processes, what runs beside the kubelets"),
        ("run-dir", "print the folder of the cluster's files"),
    ):
        command = commands.add_parser(name, help=text)
        choosing.add_arguments(command)
    up = commands.choices["up"]
    up.add_argument("--topology", type=Path, default=SCENARIO, help="a scenario.yaml")
    up.add_argument("--set", action="append", default=[], metavar="PARAMETER=VALUE", help="for example vehicles=3")
    up.add_argument("--images", type=Path, default=None, help="lock file of the images")
    up.add_argument("--binaries", type=Path, default=None, help="folder of the tool chain's programs")
    up.add_argument(
        "--admission", choices=admission_files.CHOICES, default="", help="enforce admission (default: from files)"
    )
    up.add_argument(
        "--dry-run",
        action="store_true",
        help="start nothing; list what of the running cluster admission would strand (exit code 1: something); of one "
        "that is there: what would be written",
    )
    return parser


def run(options: argparse.Namespace) -> None:
    """Do one command; raises SetUpError."""
    chosen = choosing.choice(options)
    if options.command == "run-dir":
        print(ClusterFolders(chosen.name).base)
    elif options.command == "down":
        down(chosen)
    elif options.command == "status":
        print(choosing.provider(chosen).status())
    elif chosen.kind in choosing.TAKEN:
        take(choosing.taken(chosen.kind, chosen.given), options.dry_run)
    elif options.dry_run:
        dry_run(options, chosen)
    else:
        up(options, chosen)


def dry_run(options: argparse.Namespace, chosen: choosing.Choice) -> None:
    """List what could not be made again under enforced admission; InputError when there is something."""
    if chosen.kind != Embedded.kind:
        raise InputError(f"--dry-run: says nothing of a cluster of kind {chosen.kind}, which is made anew or used")
    from ci.cluster.embedded.admission.stranded import stranded_now

    wanted = topology.read(options.topology, topology.overrides(options.set))
    lock = image_lock.read_lock(options.images or image_lock.lock_file())
    report = stranded_now(ClusterFolders(options.name), wanted, lock)
    print("\n".join(report.lines))
    if report.stranded:
        raise InputError(
            f"admission would strand {len(report.stranded)} objects: publish what they run, or remove them"
        )


def down(chosen: choosing.Choice) -> None:
    """Remove the cluster, and print what that was."""
    provider = choosing.provider(chosen)
    removed = provider.down()
    if not removed:
        print(f"cluster {provider.name}: nothing to remove")
        return
    print("\n".join([f"cluster {provider.name}: removed", *(f"  {line}" for line in removed)]))
    print("".join(f"  kept: {line}\n" for line in provider.kept()), end="")


def take(given: Existing, dry_run: bool) -> None:
    """Make Nodes of a cluster that is there agents', or list what that would write; and say what this kind of cluster
    cannot give."""
    if dry_run:
        print("\n".join(given.planned()) or f"cluster {given.name}: nothing would be written")
        return
    written = given.take()
    lines = [f"cluster {given.name}: {len(written) or 'no'} Nodes changed", *(f"  {line}" for line in written)]
    print("\n".join([*lines, *(f"  not given: {text}" for text in given.lacks)]))
    print(f"values for the platform's chart: {given.values_file}")


def up(options: argparse.Namespace, chosen: choosing.Choice) -> None:
    """Check everything that can be wrong first, then start."""
    wanted = topology.read(options.topology, topology.overrides(options.set))
    if chosen.kind == Embedded.kind:
        preflight.require()
        packages.ensure("cluster")
    lock = image_lock.read_lock(options.images or image_lock.lock_file())
    binaries = options.binaries
    if binaries is None:
        from ci.toolchain import ensure

        binaries = ensure().binaries
    made = chosen.kind == Embedded.kind
    cluster = Embedded(chosen.name, binaries, options.admission) if made else choosing.provider(chosen, binaries)
    cluster.up(wanted, lock)
    print(f"export KUBECONFIG={cluster.kubeconfig()}")


def main() -> int:
    """Exit code 0 done, 1 input refused, 2 usage, 3 the machine cannot."""
    try:
        run(arguments().parse_args())
    except SetUpError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("interrupted; the next start, or `down`, removes what was begun", file=sys.stderr)
        return INTERRUPTED
    return 0


if __name__ == "__main__":
    sys.exit(main())
