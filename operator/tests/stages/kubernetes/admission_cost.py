"""`python -m tests.stages.kubernetes.admission_cost DIGESTS PODS`: what admission adds to the creation of a pod.

Two API servers of one run, one with the policies and one without, which collect garbage as seldom as that of the
embedded cluster; pods are created in turns on both, by the account of
the replica set controller. Prints a JSON document: milliseconds of each creation, of the API server's own validation on
average, and seconds from a changed file to its effect.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ci.cluster.embedded.control_plane.programs import SELDOM_COLLECTING
from robotkube.registry.admission.adapters.policy_files import PolicyFiles
from robotkube.registry.admission.core.allowed import Allowed
from robotkube.registry.admission.core.policies import for_files
from tests.stages.kubernetes.judged_api_server import Api, judged_api_server
from tests.stages.registry.admission_examples import CHART, DOMAIN, REPLICA_SETS, digest, image, path, pod

WARMING = 100
RELOADS = 5
METRIC = "apiserver_admission_controller_admission_duration_seconds"
LABELS = ('name="ValidatingAdmissionPolicy"', 'operation="CREATE"', 'type="validate"')


def listed(digests: int, first: int = 1000) -> Allowed:
    """A list of so many images, each of which is a chart's."""
    numbers = range(first, first + digests)
    return Allowed(tuple(map(digest, numbers)), (digest(2),), tuple(f"app@{CHART[:-6]}{n:06x}" for n in numbers))


def create(api: Api, name: str, number: int) -> float:
    """Milliseconds of one creation."""
    made = pod(image(number), name)
    began = time.perf_counter()
    api.done("POST", path("Pod", "vehicle-00"), made, REPLICA_SETS)
    return (time.perf_counter() - began) * 1000


def validation_ms(api: Api) -> tuple[float, float]:
    """Sum and count of the API server's own time for policies."""
    totals = {"sum": 0.0, "count": 0.0}
    for line in api.client.get("/metrics").text.splitlines():
        for part in totals:
            if line.startswith(f"{METRIC}_{part}{{") and all(label in line for label in LABELS):
                totals[part] += float(line.rpartition(" ")[2])
    return totals["sum"] * 1000, totals["count"]


def reload_seconds(api: Api, files: PolicyFiles, digests: int) -> float:
    """From a written file to its effect, asked without a pause."""
    times = []
    for turn in range(RELOADS):
        first = 100_000 * (turn + 1)
        new = pod(image(first))
        files.write(for_files(DOMAIN, listed(digests, first)))
        began = time.perf_counter()
        where = f"{path('Pod', 'vehicle-00')}?dryRun=All"
        while api.request("POST", where, new, REPLICA_SETS)["kind"] != "Pod":
            assert time.perf_counter() < began + 60, "the new list does not come"
        times.append(time.perf_counter() - began)
    return sorted(times)[len(times) // 2]


def measure(digests: int, pods: int, folder: Path) -> dict[str, Any]:
    """Both servers side by side; then the first one's list is changed."""
    with (
        judged_api_server(folder / "with", for_files(DOMAIN, listed(digests)), SELDOM_COLLECTING) as (judged, files),
        judged_api_server(folder / "without", None, SELDOM_COLLECTING) as (free, _),
    ):
        for api in (judged, free):
            api.done("POST", "/api/v1/namespaces", {"metadata": {"name": "vehicle-00"}})
            for number in range(WARMING):
                create(api, f"warming-{number}", 1000 + number % digests)
        before = validation_ms(judged)
        creations: dict[str, list[float]] = {"with": [], "without": []}
        turns: list[tuple[str, Callable[[str, int], float]]] = [
            ("with", lambda name, number: create(judged, name, number)),
            ("without", lambda name, number: create(free, name, number)),
        ]
        for number in range(pods):
            for kind, once in turns if number % 2 else reversed(turns):
                creations[kind].append(once(f"pod-{number}", 1000 + number % digests))
        after = validation_ms(judged)
        mean = (after[0] - before[0]) / (after[1] - before[1])
        reloads = {str(count): reload_seconds(judged, files, count) for count in (digests, 10 * digests)}
    return {"creations_ms": creations, "validation_mean_ms": mean, "reload_s": reloads}


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        print(json.dumps(measure(int(sys.argv[1]), int(sys.argv[2]), Path(folder))))


if __name__ == "__main__":
    main()
