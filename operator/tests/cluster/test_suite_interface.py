"""The interface suite on the cluster: charts with a mistake are installed in rooms, seen from beside, and refused in
words. What is right about the platform's own charts is proved by their publication."""

from __future__ import annotations

import secrets
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
import yaml
from running_platform import Platform, eventually
from wrong_interfaces import MISTAKES, wrong_chart

from ci import publish
from ci.cluster.images import lock_file, read_lock
from robotkube.adapters.chart_folders import pack
from robotkube.adapters.oci_registry import Registry
from robotkube.adapters.suite_runner_http import SuiteRunnerClient
from robotkube.domain.evidence import Artefact, SuiteResult
from robotkube.domain.suite_requests import SuiteRequest
from robotkube.domain.verification import SuiteRule

NAMES = ("undeclared-topic", "wrong-type", "unused-input")
STAGING = "staging"
SECONDS = 240
VERDICT_SECONDS_MAX = 2 * SECONDS + 60.0
RULE = SuiteRule("interface", "1", SECONDS)


@pytest.fixture(scope="module")
def results(platform: Platform, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Mapping[str, SuiteResult]]:
    """What the suite-runner says of each chart; all are asked for at once and run in the rooms of the pool."""
    where = platform.access.endpoint("suite-runner")
    token = platform.access.secret("robotkube", "suite-runner-token")["token"]
    requests = {name: request(platform, name, tmp_path_factory.mktemp(name)) for name in NAMES}
    runner = SuiteRunnerClient(f"http://{where.host}:{where.port}", token)
    found: dict[str, SuiteResult] = {}

    def finished() -> bool:
        for name, asked in requests.items():
            progress = runner.run(asked)
            if progress.result is not None:
                found[name] = progress.result
        return len(found) == len(requests)

    eventually("the suite-runner has run the interface suite on all charts", finished, VERDICT_SECONDS_MAX)
    yield found
    runner.disconnect()


def request(platform: Platform, name: str, folder: Path) -> SuiteRequest:
    """The chart in staging, and what the gate would ask about it."""
    chart, path = wrong_chart(name, folder)
    entry = yaml.safe_load(path.read_text(encoding="utf-8"))
    images = {image.name: image.reference for image in read_lock(lock_file())}
    forge = publish.find_forge(platform.installer.kubeconfig)
    with Registry(forge.url, forge.username, forge.password) as registry:
        digest = registry.push_chart(STAGING, pack(chart, images, entry["spec"]))
    artefact = Artefact(name, "0.1.0", digest, "linux/amd64")
    return SuiteRequest(artefact, f"{STAGING}/{name}", "sha256:" + "0" * 64, RULE, entry, attempt=secrets.token_hex(8))


@pytest.mark.parametrize("name", NAMES)
def test_a_wrong_chart_is_refused_with_words_that_say_it(results: Mapping[str, SuiteResult], name: str) -> None:
    result, mistake = results[name], MISTAKES[name]
    said = "\n".join(f"{check.name}: {check.found}" for check in result.failed)
    assert result.outcome == "failed", said
    found = {check.name: check for check in result.failed}
    assert f"set first: {mistake.check}" in found, said
    check = found[f"set first: {mistake.check}"]
    assert mistake.found in check.found
    assert mistake.fix in check.fix
    assert all(check.name.startswith(("set first: ", "set second: ")) for check in result.failed), said
    assert "set second: runs" in {check.name for check in result.checks if check.passed}


def test_the_rooms_are_empty_afterwards(platform: Platform, results: Mapping[str, SuiteResult]) -> None:
    rooms = [item["metadata"]["name"] for item in platform.get("namespaces")["items"]]
    rooms = [name for name in rooms if name.startswith("robotkube-suite-")]
    assert rooms

    def empty() -> bool:
        return not any(platform.get("-n", room, "deployments,pods,secrets")["items"] for room in rooms)

    eventually("no pod, Deployment or Secret is left in any room", empty)
