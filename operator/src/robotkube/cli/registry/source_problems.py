"""Mistakes in a catalogue's sources: those that validation names, and those that composing the applications shows."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

from robotkube.delivery.gate.core.source_compositions import compose_sources
from robotkube.errors import InputError
from robotkube.registry.catalogue.adapters.source_folders import read_sources
from robotkube.registry.catalogue.core.sources import CatalogueSources, SourceProblem
from robotkube.registry.catalogue.core.validation import validate_sources
from robotkube.registry.publication.adapters.submission_folders import validation_tools

SECONDS_MAX = 60.0  # of composing all applications


def source_problems(sources: CatalogueSources) -> list[SourceProblem]:
    """Every mistake, by file. Applications for which there is no time are named on stderr."""
    tools = validation_tools()
    findings = validate_sources(sources, tools)
    until = time.monotonic() + SECONDS_MAX
    composed = compose_sources(sources, findings, tools, lambda: time.monotonic() > until)
    if composed.untried:
        names = ", ".join(composed.untried)
        print(f"robotkube: not composed, since {SECONDS_MAX:.0f} s were over: {names}", file=sys.stderr)
    return sorted([*findings, *composed.problems], key=lambda problem: problem.file)


def check_sources(names: Sequence[str], applications: Sequence[str], charts: Path, registry: Path, undone: str) -> None:
    """InputError names every mistake in these charts and applications (`robotkube registry validate` names those of
    everything else too); `undone` is the word for what was not done with them."""
    findings = source_problems(read_sources(registry, charts))
    places = [f"{registry}/charts/{name}/" for name in names] + [f"{charts / name}/" for name in names]
    places += [f"{registry}/applications/{name}.yaml/" for name in applications]
    problems = [str(finding) for finding in findings if f"{finding.file}/".startswith(tuple(places))]
    if places and problems:
        mistakes = "1 mistake" if len(problems) == 1 else f"{len(problems)} mistakes"
        raise InputError("\n".join([f"{mistakes} in the sources, nothing was {undone}:", *problems]))
