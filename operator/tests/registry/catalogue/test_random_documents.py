"""Random documents: each is taken or refused with words, in bounded time, and nothing crashes."""

from __future__ import annotations

import shutil
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from robotkube.delivery.manager.core.composition.composer import Demand, Inputs, compose
from robotkube.delivery.manager.core.placement.placement import Agent, NodeState, fleet
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.adapters.json_schema import check_schema, validate, violations
from robotkube.registry.catalogue.adapters.source_folders import read_sources
from robotkube.registry.catalogue.core.catalogue import read_catalogue
from robotkube.registry.catalogue.core.entry_documents import entry_documents
from robotkube.registry.catalogue.core.search import Criteria, search, upgrade_rows
from robotkube.registry.catalogue.core.sources import CatalogueSources, Tools
from robotkube.registry.catalogue.core.validation import validate_sources
from tests.stages.examples import EXAMPLES
from tests.stages.paths import REPOSITORY
from tests.stages.registry.random_documents import random_document

FILES = {str(p.relative_to(REPOSITORY / "registry")): p.read_text() for p in (REPOSITORY / "registry").rglob("*.yaml")}
CASE_SECONDS_MAX = 10  # of the processor
BLOCK = 20
CASES = 1000
NORMAL = range(EXAMPLES)
FINDING_CHARACTERS_MAX = 900
TEMPLATES = Jinja2Templates()
TOOLS = Tools(TEMPLATES.render, TEMPLATES.references, check_schema, validate, violations)
AGENT = Agent("vehicle-00", "cloud", "vehicle-00")
FLEET = fleet([AGENT], [NodeState("n", AGENT.name, AGENT.role, frozenset({"recording"}), True)])


@contextmanager
def at_most(seconds: int, what: str) -> Iterator[None]:
    """Fails when it takes more of the processor: what else the machine does does not count."""

    def stop(*_: Any) -> None:
        raise AssertionError(f"{what} did not end within {seconds} s")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def try_case(number: int, registry: Path, everything: bool) -> bool:
    """Whether the document was taken without a finding. Unless `everything` is looked at, applications beside a random
    application are not: what is found in them does not depend on it, and takes the most time."""
    path, data = random_document(number, FILES)
    (registry / path).write_bytes(data)
    try:
        sources = read_sources(registry, REPOSITORY / "charts" / "apps")
        problems = validate_sources(sources if everything else without_others(sources, path), TOOLS)
        for finding in problems:
            assert finding.file
            assert finding.key
            assert 0 < len(finding.text) <= FINDING_CHARACTERS_MAX, finding
        use(dict(sources.files))
    finally:
        (registry / path).write_text(FILES[path])
    return not problems


def without_others(sources: CatalogueSources, path: str) -> CatalogueSources:
    """Without the other applications, when `path` is one."""
    if not path.startswith("applications/"):
        return sources
    kept = {name: text for name, text in sources.files.items() if name == path or not name.startswith("applications/")}
    return replace(sources, files=kept)


def use(files: dict[str, str]) -> None:
    """What manager, gate and command line do with a catalogue: it must not crash on what they could read."""
    published = {
        path: f"{text}\nstatus: {{state: staged, digest: 'sha256:{'0' * 64}'}}\n" for path, text in files.items()
    }
    mixed = {path: published[path] if path.startswith("charts/") else text for path, text in files.items()}
    for value in (
        read_catalogue(files, published=False),
        read_catalogue({**mixed, "policies/release.yaml": "assurance: none\n"}),
    ):
        entries = entry_documents(value)
        search(entries, Criteria(text="a", provides="b", guarantee="c"))
        upgrade_rows(entries)
        demands = [Demand(name, name, {"vehicles": ["vehicle-00"]}, agent="vehicle-00") for name in value.applications]
        compose(demands, Inputs(value, FLEET, {}, TEMPLATES.render, validate))


def try_cases(numbers: range, tmp_path: Path, everything: bool) -> None:
    shutil.copytree(REPOSITORY / "registry", tmp_path / "registry")
    valid = 0
    for number in numbers:
        with at_most(CASE_SECONDS_MAX, f"case {number}"):
            valid += try_case(number, tmp_path / "registry", everything)
    assert valid < len(numbers) / 2


@pytest.mark.parametrize("start", range(NORMAL.start, NORMAL.stop, BLOCK))
def test_random_documents(start: int, tmp_path: Path) -> None:
    try_cases(range(start, min(start + BLOCK, NORMAL.stop)), tmp_path, everything=False)


@pytest.mark.thorough
@pytest.mark.parametrize("start", range(NORMAL.start, CASES, BLOCK))
def test_more_random_documents(start: int, tmp_path: Path) -> None:
    try_cases(range(start, start + BLOCK), tmp_path, everything=True)
