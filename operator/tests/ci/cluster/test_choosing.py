"""Which cluster a command line means, and what is said of those that are not there or give only a part."""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
from pathlib import Path

import pytest

from ci.cluster import choosing
from ci.cluster.choosing import Choice
from ci.cluster.embedded.provider import Embedded
from ci.cluster.existing.nodes import GivenCluster
from ci.errors import InputError
from ci.folders import PROJECT
from robotkube.errors import InputError as WrongInput
from robotkube.foundation.kubernetes.adapters.client import api_client

SECONDS_MAX = 20


def chosen(*words: str) -> Choice:
    parser = argparse.ArgumentParser()
    choosing.add_arguments(parser)
    return choosing.choice(parser.parse_args(words))


def test_without_a_word_it_is_the_one_that_needs_nothing() -> None:
    assert chosen() == Choice("demo", "embedded")
    provider = choosing.provider(chosen("--name", "test"))
    assert isinstance(provider, Embedded)
    assert (provider.name, provider.kind, provider.lacks) == ("test", "embedded", ())


def test_how_a_cluster_that_is_there_is_reached() -> None:
    words = ("--kubeconfig", "k", "--context", "c", "--registry", "example.com/r", "--agents", "a.yaml", "--yes")
    given = GivenCluster("k", "c", "example.com/r", Path("a.yaml"), Path("v.yaml"), True, Path("ca.pem"))
    words = (*words, "--values", "v.yaml", "--registry-ca", "ca.pem")
    assert chosen("--cluster", "existing", *words) == Choice("demo", "existing", given)


@pytest.mark.parametrize("kind", ["minikube", "k3d", ""])
def test_kinds_that_are_not_offered_are_refused_with_those_that_are(kind: str) -> None:
    with pytest.raises(InputError, match=f"CLUSTER={kind}: there is no such kind .* embedded: .*; k3s: .*; existing: "):
        chosen("--cluster", kind)


def test_a_k3s_is_a_cluster_that_is_there(tmp_path: Path) -> None:
    words = ("--cluster", "k3s", "--kubeconfig", str(tmp_path / "none"))
    assert chosen(*words) == Choice("demo", "k3s", GivenCluster(str(tmp_path / "none")))
    with pytest.raises(InputError, match="give KUBECONFIG and CONTEXT"):
        choosing.provider(chosen(*words))


def test_the_chart_is_told_what_the_embedded_cluster_needs() -> None:
    profile = choosing.provider(Choice()).chart_profile()
    assert profile.files == ("values-embedded.yaml",)
    assert profile.values == {"suites": {"pool": 3}}


@pytest.mark.processes
def test_make_passes_words_on_as_they_are() -> None:
    """Names of contexts and files may have spaces and quotes; what is empty is no option."""
    said = {"CONTEXT": "my team's context", "KUBECONFIG": "/a b/one:/two", "AGENTS": "my agents.yaml", "VALUES": ""}
    said |= {"CLUSTER": "existing", "REGISTRY": "registry.example.com:5000/a/b/robotkube", "YES": "1"}
    words = ["make", "--dry-run", "status", *(f"{name}={value}" for name, value in said.items())]
    alone = {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MAKELEVEL")}
    asked = subprocess.run(words, cwd=PROJECT, env=alone, capture_output=True, text=True, timeout=SECONDS_MAX)
    assert asked.returncode == 0, asked.stderr
    _, module, *rest = shlex.split(asked.stdout)[1:]
    assert (module, rest.pop(0)) == ("ci.cluster", "status")
    files = (said["KUBECONFIG"], said["CONTEXT"], said["REGISTRY"], Path(said["AGENTS"]))
    assert chosen(*rest) == Choice("demo", "existing", GivenCluster(*files, agreed=True))


@pytest.mark.parametrize("text", [b"not: [yaml", b"- a list", b"\xff\xfe", b"text", None])
def test_a_file_that_is_no_kubeconfig_is_named(tmp_path: Path, text: bytes | None) -> None:
    path = tmp_path / "kubeconfig"
    path.mkdir() if text is None else path.write_bytes(text)
    with pytest.raises(InputError) as refused:
        choosing.provider(chosen("--cluster", "existing", "--kubeconfig", str(path)))
    assert str(refused.value).startswith(f"{path}: is no kubeconfig (")
    assert str(refused.value).endswith("give KUBECONFIG and CONTEXT")
    with pytest.raises(WrongInput, match=f"no access to a cluster: {path} is no kubeconfig .*; run in a pod, or name"):
        api_client(str(path))
