"""What `make bench` says of the suites' times: those of the newest evidence that is kept."""

import os
from pathlib import Path

from signed_evidence import PLATFORM, Signing, signing_key

from ci.benchmarks.publication import suite_seconds
from robotkube.domain.evidence import Artefact, Check, SuiteResult, suite_statement


def keep(folder: Path, signing: Signing, chart: str, digit: str, seconds: float, age: int) -> None:
    """Evidence of one suite of a chart, written `age` seconds after the first."""
    about = Artefact(chart, "0.1.0", f"sha256:{digit * 64}", PLATFORM)
    result = SuiteResult("static", "1", "passed", (Check("probes", True),), seconds)
    for name in ("static", "summary"):
        path = folder / about.folder / f"{name}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(signing.key.sign(suite_statement(about, signing.policy.digest, result)))
        os.utime(path, (1_000_000 + age, 1_000_000 + age))


def test_the_longest_of_each_charts_newest_counts(tmp_path: Path) -> None:
    signing = Signing(signing_key(tmp_path / "key"))
    keep(tmp_path, signing, "relay", "a", 99.0, age=0)
    keep(tmp_path, signing, "relay", "b", 2.5, age=1)
    keep(tmp_path, signing, "other", "c", 3.5, age=2)
    assert suite_seconds(tmp_path) == {"static": 3.5}


def test_without_evidence_there_are_none(tmp_path: Path) -> None:
    assert suite_seconds(tmp_path) == {}
