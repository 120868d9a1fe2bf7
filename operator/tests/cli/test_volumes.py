"""Folders in which segments are looked for: what the option says, else the claim's folder on this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from robotkube.cli.recordings.volumes import folders_here, volume_place
from robotkube.errors import InputError


def volume(path: Path, node: str, claim: str = "recordings", kind: str = "local") -> dict[str, Any]:
    expression = {"key": "kubernetes.io/hostname", "operator": "In", "values": [node]}
    affinity = {"required": {"nodeSelectorTerms": [{"matchExpressions": [expression]}]}}
    return {"spec": {kind: {"path": str(path)}, "claimRef": {"name": claim}, "nodeAffinity": affinity}}


def test_a_claims_folder_on_this_machine_is_found(tmp_path: Path) -> None:
    volumes = [volume(tmp_path, "cloud-0"), volume(tmp_path, "edge-0", "other", "hostPath")]
    assert folders_here(volumes) == {"cloud-0/recordings": tmp_path, "edge-0/other": tmp_path}


def test_a_folder_that_is_elsewhere_is_left_out(tmp_path: Path) -> None:
    assert folders_here([volume(tmp_path / "on-another-machine", "cloud-0")]) == {}


def test_two_claims_of_one_name_on_one_node_are_not_guessed_between(tmp_path: Path) -> None:
    assert folders_here([volume(tmp_path, "cloud-0"), volume(tmp_path, "cloud-0")]) == {}


def test_a_volume_without_claim_folder_or_node_says_nothing(tmp_path: Path) -> None:
    unbound, without_node = volume(tmp_path, "a"), volume(tmp_path, "b")
    del unbound["spec"]["claimRef"], without_node["spec"]["nodeAffinity"]
    assert folders_here([unbound, without_node, {"spec": {"csi": {}}}]) == {}


def test_an_option_names_a_volume_and_its_folder(tmp_path: Path) -> None:
    assert volume_place(f"cloud-0/recordings={tmp_path}") == ("cloud-0/recordings", tmp_path)


def test_an_option_that_is_no_place_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"must be <node>/<claim>=<existing folder>"):
        volume_place(f"recordings={tmp_path}")
