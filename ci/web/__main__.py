"""`make web`: build the forge's pages if the cache lacks them."""

from __future__ import annotations

import argparse
import sys

from ci import web
from ci.errors import SetUpError


def main() -> int:
    """Exit code 0 built or cached, 3 it cannot be built."""
    argparse.ArgumentParser(prog="make web", description=__doc__).parse_args()
    try:
        print(web.build())
    except SetUpError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    print("the next `make demo` or `make cluster` serves the forge's pages", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
