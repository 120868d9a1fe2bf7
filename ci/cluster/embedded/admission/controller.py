"""`python -m ci.cluster.embedded.admission.controller`: keeps the policies of an embedded cluster to what its
catalogue lists.

A process of the host, beside the API server: whoever administers the cluster through its API has no way to it. What it
cannot read it says once in its log, and the policies stay as they are.
"""

from __future__ import annotations

import argparse
import logging
import time
from collections.abc import Callable
from pathlib import Path

from ci.cluster.api_server.client import Api
from ci.cluster.embedded import first_objects
from ci.cluster.embedded.admission import admission_files
from ci.cluster.embedded.admission.catalogue_on_disk import CatalogueOnDisk
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.network.addresses import plan_of
from ci.errors import SetUpError
from robotkube.errors import RobotKubeError, UnavailableError
from robotkube.registry.admission.loops.follower import Follower
from robotkube.registry.admission.loops.policy_reconciler import CatalogueListing, PolicyReconciler
from robotkube.registry.evidence.adapters.dsse import TrustedKeys

POLL_SECONDS = 0.2  # a publication is followed within a second
FIND_SECONDS = 5.0  # how long the forge's volume is taken to be the same
NAMESPACE, CLAIM, REPOSITORIES = "robotkube", "forge", "repositories"  # where charts/robotkube has the forge's files


class ForgeFolder:
    """The folder of the forge's repositories on this machine, asked of the API server now and then; the last answer
    counts while it is away."""

    def __init__(self, ask: Callable[[], Path], clock: Callable[[], float] = time.monotonic) -> None:
        self._ask = ask
        self._clock = clock
        self._place: Path | None = None
        self._why = ""
        self._asked = float("-inf")

    def __call__(self) -> Path:
        """The folder; UnavailableError while the forge has no volume."""
        if self._clock() >= self._asked + FIND_SECONDS:
            self._asked = self._clock()
            try:
                self._place = self._ask()
            except SetUpError as error:
                self._why = str(error).strip()
        if self._place is None:
            raise UnavailableError(f"the forge is not installed yet: {self._why}")
        return self._place


def forge_folder(api: first_objects.ObjectReader) -> ForgeFolder:
    """The folder of the cluster's own forge."""
    return ForgeFolder(lambda: first_objects.volume_path(api, NAMESPACE, CLAIM) / REPOSITORIES)


def reconcile(reconciler: PolicyReconciler, pause: Callable[[], None]) -> None:
    """Step for ever; a problem is logged when it comes and when it is another one."""
    follower = Follower(reconciler, time.monotonic, (RobotKubeError, SetUpError))
    while True:
        follower.step()
        pause()


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m ci.cluster.embedded.admission.controller", description=__doc__)
    parser.add_argument("--name", required=True, help="of the cluster")
    folders = ClusterFolders(parser.parse_args().name)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s")
    place = forge_folder(Api(str(plan_of(folders.name).gateway), folders.pki))
    own = admission_files.folder(folders)
    listing = CatalogueListing(CatalogueOnDisk(place, own / "clones"), TrustedKeys(own / "keys"))
    reconcile(admission_files.policy_reconciler(folders, listing), lambda: time.sleep(POLL_SECONDS))


if __name__ == "__main__":
    main()
