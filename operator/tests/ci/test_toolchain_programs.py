"""The list of programs: stamped, smoke-tested, and built from what is committed."""

from __future__ import annotations

from ci.toolchain import building
from ci.toolchain.programs import FOLDER, HELM, KUBERNETES, PROGRAMS, helm_stamps, kubernetes_stamps

VERSIONS = {KUBERNETES: "v1.36.3", HELM: "v3.21.4"}


def test_every_name_of_every_program_has_a_smoke_test_or_is_a_link_of_one() -> None:
    for program in PROGRAMS:
        assert program.smoke
        assert set(program.smoke) <= {program.name, *program.links}
        assert (program.folder / "go.mod").exists()


def test_kubernetes_knows_its_version_in_server_and_client() -> None:
    stamps = kubernetes_stamps(VERSIONS)
    assert stamps["k8s.io/component-base/version.gitVersion"] == "v1.36.3"
    assert stamps["k8s.io/client-go/pkg/version.gitMinor"] == "36"


def test_helm_assumes_the_clusters_version() -> None:
    assert helm_stamps(VERSIONS)[f"{HELM}/pkg/chartutil.k8sVersionMinor"] == "36"


def test_the_key_covers_modules_sources_and_patches_but_no_prose() -> None:
    names = {str(path.relative_to(FOLDER)) for path in building.inputs()}
    assert {"go.mod", "go.sum", "gitea/go.sum", "programs.py", "cmd/kubernetes/main.go", "ferretdb/go.sum"} <= names
    assert not {"README.md", "building.py"} & names
