"""`python -m ci.toolchain`: build what is missing, print the folder of the programs."""

from __future__ import annotations

import argparse
import sys

from ci.errors import SetUpError
from ci.toolchain import ensure


def main() -> int:
    """Exit code 0 built or cached, 3 a program failed."""
    argparse.ArgumentParser(prog="python -m ci.toolchain", description=__doc__).parse_args()
    try:
        print(ensure().binaries)
    except SetUpError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
