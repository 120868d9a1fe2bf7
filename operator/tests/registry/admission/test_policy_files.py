"""The files that the API server reads: whole at every moment, and never none."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from robotkube.errors import InputError
from robotkube.registry.admission.adapters.policy_files import PolicyFiles
from robotkube.registry.admission.core.allowed import Allowed
from robotkube.registry.admission.core.documents import CHARACTERS_MAX
from robotkube.registry.admission.core.lists import CHUNK
from robotkube.registry.admission.core.policies import FILE_SUFFIX, for_files
from tests.stages.registry.admission_examples import ALLOWED, DOMAIN, digest


def test_a_list_is_written_once_and_replaced_as_a_whole(tmp_path: Path) -> None:
    files = PolicyFiles(tmp_path / "admission")
    assert files.write(for_files(DOMAIN, ALLOWED))
    before = files.policies.stat().st_ino
    assert not files.write(for_files(DOMAIN, ALLOWED))
    assert files.write(for_files(DOMAIN, Allowed()))
    assert files.policies.stat().st_ino != before  # renamed, not written in place
    assert [path.name for path in files.policies.parent.iterdir()] == ["policies.json"]
    configuration = json.loads(files.configuration.read_text())
    assert configuration["plugins"][0]["configuration"]["staticManifestsDir"] == str(files.policies.parent)
    assert files.options["admission-control-config-file"] == str(files.configuration)


def test_no_policies_at_all_are_never_written(tmp_path: Path) -> None:
    """The API server would start with none, and let everything in."""
    files = PolicyFiles(tmp_path)
    files.write(for_files(DOMAIN, ALLOWED))
    before = files.policies.read_text()
    with pytest.raises(InputError, match="0 policies in"):
        files.write([])
    assert files.policies.read_text() == before


def test_every_name_is_one_that_only_files_may_have() -> None:
    documents = for_files(DOMAIN, ALLOWED)
    assert {document["metadata"]["name"].endswith(FILE_SUFFIX) for document in documents} == {True}
    assert not any("paramKind" in document["spec"] or "paramRef" in document["spec"] for document in documents)


def policies(allowed: Allowed) -> dict[str, dict[str, Any]]:
    """Their specifications by name."""
    documents = [each for each in for_files(DOMAIN, allowed) if each["kind"] == "ValidatingAdmissionPolicy"]
    return {document["metadata"]["name"].removesuffix(FILE_SUFFIX): document["spec"] for document in documents}


def test_each_rule_is_part_of_what_is_asked_before_the_rules() -> None:
    """What that lets through, no rule sees."""
    for spec in policies(ALLOWED).values():
        [condition] = spec["matchConditions"]
        assert condition["expression"].startswith("!(")
        for rule in spec["validations"]:
            for part in re.split(r"variables\.\w+", f"({rule['expression']})"):
                assert part in condition["expression"]


@pytest.mark.parametrize(("digests", "fits"), [(CHUNK, True), (CHUNK + 500, False)])
def test_a_list_that_is_too_long_for_one_expression_is_asked_by_the_rules_alone(digests: int, fits: bool) -> None:
    specs = policies(Allowed(tuple(map(digest, range(digests)))))
    assert ("matchConditions" in specs["robotkube-agents"]) == fits
    if fits:
        [condition] = specs["robotkube-agents"]["matchConditions"]
        assert len(condition["expression"]) <= CHARACTERS_MAX
