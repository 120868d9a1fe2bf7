"""`ci/python -m ci.reference.walks`: the walks with the files they touch, and those that are looked up on the way.

The exit code is 1 when a walk is longer than its bound, or when its value does not come to its end.
"""

from __future__ import annotations

import sys

from ci.reference.walks.page import Count, counted, module_of


def text(count: Count) -> str:
    """A walk in lines."""
    walked = [f"  {module_of(station.path)}  {station.entered}" for station in count.stations]
    title = f"{count.walk.title}: {len(walked)} files, at most {count.walk.files_max}"
    return "\n".join([title, *walked, f"  looked up: {len(count.looked_up)}", *(f"    {f}" for f in count.looked_up)])


def main() -> int:
    """Count and print; the problems on the error stream."""
    counts = counted()
    print("\n\n".join(text(count) for count in counts))
    problems = [problem for count in counts for problem in count.problems]
    for problem in problems:
        print(problem, file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
