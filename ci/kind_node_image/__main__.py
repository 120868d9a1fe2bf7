"""`make kind-node-image`: an image of kind's nodes for machines on which kind's own cannot be pulled, given to the
Docker or podman that kind finds, or written to a file. What was made is kept below the user's cache folder.

python -m ci.kind_node_image [--archive FILE]
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

from ci.errors import InputError, SetUpError
from ci.kind_node_image import engines, naming
from ci.kind_node_image.building import ensure
from robotkube.errors import RobotKubeError
from robotkube.registry.images.adapters.docker import Docker

NO_ENGINE = (
    "kind finds neither Docker nor podman here: install one of them (Debian: apt-get install docker.io), or have the "
    "image written to a file: make kind-node-image ARCHIVE=FILE"
)


def main() -> int:
    """Exit code 0 done, 1 when the file cannot be written there, 3 when the machine cannot, or has no engine."""
    parser = argparse.ArgumentParser(
        prog="make kind-node-image",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--archive",
        type=Path,
        metavar="FILE",
        help="write it there; docker load reads it",
    )
    given = parser.parse_args()
    try:
        said = _write(given.archive) if given.archive else _load()
    except (SetUpError, RobotKubeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return getattr(error, "exit_code", 1)
    except KeyboardInterrupt:
        print(
            "interrupted; programs and packages that were finished are kept",
            file=sys.stderr,
        )
        return 130
    print(said)
    return 0


def _load() -> str:
    """Give it to the engine; what is said then."""
    engine = engines.found()
    if not engine:  # before anything is built
        raise SetUpError(NO_ENGINE)
    if said := engines.problem(engine):
        raise SetUpError(f"{engine} is there and cannot be used: {said}")
    reference = naming.reference()
    if not engines.has(engine, reference):
        Docker(naming.cache_folder() / "build.log", engine).load(ensure(), reference)
    return (
        f"{reference}\n{engine} has it, and make demo CLUSTER=kind takes it; from another state of the sources: "
        f"KIND_NODE_IMAGE={reference} make demo CLUSTER=kind"
    )


def _write(target: Path) -> str:
    """Copy the archive; what is said then."""
    if not target.parent.is_dir():
        raise InputError(f"--archive {target}: there is no folder {target.parent}; make it, or name another file")
    shutil.copyfile(ensure(), target)
    reference = naming.reference()
    return (
        f"{reference}\nis in {target}. After docker load --input {target} (or podman load): make demo CLUSTER=kind, "
        f"or KIND_NODE_IMAGE={reference} make demo CLUSTER=kind from another state of the sources"
    )


if __name__ == "__main__":
    sys.exit(main())
