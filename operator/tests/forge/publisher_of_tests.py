"""The applications of registry/ in the test's catalogue repository, beside its chart versions."""

from pathlib import Path

from installation import Installation

REGISTRY = Path(__file__).parents[3] / "registry"


def publish_registry(installation: Installation) -> None:
    """Push every application that is not there yet."""
    gate = installation.clone("gate", "robotkube/catalogue")
    tip = gate.tip()
    files: dict[str, str | None] = {
        str(path.relative_to(REGISTRY)): path.read_text() for path in REGISTRY.glob("applications/*.yaml")
    }
    if "applications" in gate.repository[tip].tree:
        return
    commit = gate.commit(files, "publish applications", [tip])
    assert gate.push(commit, "refs/heads/main") == ""
