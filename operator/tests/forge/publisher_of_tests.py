"""The applications of registry/ in the test's catalogue repository, beside its chart versions."""

from pathlib import Path

from installation import Installation

REGISTRY = Path(__file__).parents[3] / "registry"


def publish_registry(installation: Installation) -> None:
    """Push every application that is not there yet."""
    publisher = installation.clone("publisher", "robotkube/catalogue")
    tip = publisher.tip()
    files: dict[str, str | None] = {
        str(path.relative_to(REGISTRY)): path.read_text() for path in REGISTRY.glob("applications/*.yaml")
    }
    if "applications" in publisher.repository[tip].tree:
        return
    commit = publisher.commit(files, "publish applications", [tip])
    assert publisher.push(commit, "refs/heads/main") == ""
