"""`python -m ci.bundle`: the platform in one file, below build/bundle; what is missing for it is built before."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from ci import bundle
from ci.errors import SetUpError
from robotkube.errors import RobotKubeError


def main() -> int:
    """Exit code 0 written, 3 something is missing."""
    parser = argparse.ArgumentParser(prog="python -m ci.bundle", description=__doc__)
    parser.add_argument("--folder", type=Path, default=bundle.FOLDER, help="where it goes (default: build/bundle)")
    given = parser.parse_args()
    try:
        print(bundle.make(given.folder))
    except SetUpError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except RobotKubeError as error:
        print(f"error: {error}", file=sys.stderr)
        return SetUpError.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
