"""Which images a catalogue lets run: by the gate's signature, through whatever main has seen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pytest

from robotkube.errors import DocumentError, InputError, UnavailableError
from robotkube.foundation.forge.ports.repositories import Commit
from robotkube.registry.admission.adapters.listing_file import ListingFile
from robotkube.registry.admission.core.allowed import Allowed, digests_of
from robotkube.registry.admission.core.domain import Domain
from robotkube.registry.admission.core.listing import AllowedVersions
from robotkube.registry.admission.core.policies import for_files, list_entries, platform_entries
from robotkube.registry.admission.loops.policy_reconciler import CatalogueListing, PolicyReconciler, Surroundings
from robotkube.registry.evidence.adapters.dsse import KeyFile
from robotkube.registry.evidence.core.statements import Artefact
from tests.stages.attacks import shown
from tests.stages.registry.admission_examples import DOMAIN, digest, image
from tests.stages.registry.signed_evidence import (
    POLICY_TEXT,
    artefact,
    catalogue,
    entry,
    published,
    signing_key,
    trusting,
)

Files = Mapping[str, str]
NO_DIGEST = '{"charts": [], "images": ["sha256:1"]}'
OTHER_POLICY = POLICY_TEXT.replace("seconds: 60", "seconds: 61")


class Main:
    """Port CatalogueHistory, in memory: main as the trees that it had."""

    def __init__(self, *trees: Files) -> None:
        self.trees = list(trees)
        self.away = False
        self.unreadable: set[str] = set()

    def fetch(self) -> str:
        if self.away:
            raise UnavailableError("the forge is away")
        return f"{len(self.trees):040x}" if self.trees else ""

    def files(self, commit: str, folders: Sequence[str]) -> Files:
        tree = self.trees[int(commit, 16) - 1]
        return {path: text for path, text in tree.items() if path.split("/")[0] in folders}

    def irregular(self, commit: str, folders: Sequence[str]) -> Sequence[str]:
        return ()

    def headers(self, since: str, commits_max: int) -> Iterator[tuple[str, str]]:
        first = int(since, 16) if since else 0
        return iter([(f"{number:040x}", "") for number in range(len(self.trees), first, -1)][:commits_max])

    def commit(self, commit: str) -> Commit:
        if commit in self.unreadable:
            raise DocumentError(f"commit {commit}", ["changes more than 1000 files"])
        number = int(commit, 16)
        before = self.trees[number - 2] if number > 1 else {}
        after = self.trees[number - 1]
        changes = {path: after.get(path) for path in {*before, *after} if before.get(path) != after.get(path)}
        return Commit(commit, (), "", "gate", changes)


@pytest.fixture(scope="module")
def key(tmp_path_factory: pytest.TempPathFactory) -> KeyFile:
    return signing_key(tmp_path_factory.mktemp("key"))


class Stage:
    def __init__(self, key: KeyFile, folder: Path, *trees: Files) -> None:
        self.main = Main(*trees)
        self.keys = folder
        self.listing = CatalogueListing(self.main, trusting(folder, key))

    def listed(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Charts and images."""
        versions = self.listing.read()
        assert versions is not None
        return versions.charts, versions.verified


APP = artefact()
AGAIN = artefact(content="built again")
CHARTS = (f"app@{APP.digest}",)


def version(key: KeyFile, about: Artefact = APP, number: int = 1) -> dict[str, str]:
    return published(key, about, images=(image(number),))


def test_a_verified_version_brings_its_chart_and_its_images(key: KeyFile, tmp_path: Path) -> None:
    stage = Stage(key, tmp_path, catalogue(version(key)))
    assert stage.listed() == (CHARTS, (digest(1),))
    assert stage.listing.read() is None  # nothing changed


@pytest.mark.parametrize("state", ["withdrawn", "staged"])
def test_no_other_state_does(key: KeyFile, tmp_path: Path, state: str) -> None:
    files = version(key)
    path = "charts/app/0.1.0.yaml"
    changed = {path: files[path].replace("state: verified", f"state: {state}")}
    assert Stage(key, tmp_path, catalogue(files, changed)).listed() == ((), ())


def test_a_withdrawal_takes_every_digest_of_the_version(key: KeyFile, tmp_path: Path) -> None:
    first, second = catalogue(version(key)), catalogue(version(key), version(key, AGAIN, 2))
    path = "charts/app/0.1.0.yaml"
    withdrawn = {**second, path: second[path].replace("state: verified", "state: withdrawn")}
    stage = Stage(key, tmp_path, first, second)
    assert stage.listed()[1] == (digest(1), digest(2))
    stage.main.trees.append(withdrawn)
    assert stage.listed() == ((), ())


def test_an_entry_with_a_foreign_image_is_not_listed(key: KeyFile, tmp_path: Path) -> None:
    """Users may write main; what main had before with the signature goes on."""
    files = catalogue(version(key))
    path = "charts/app/0.1.0.yaml"
    changed = {**files, path: files[path].replace(digest(1), digest(3))}
    assert Stage(key, tmp_path, changed).listed() == ((), ())
    stage = Stage(key, tmp_path, files, changed)
    versions = stage.listing.read()
    assert versions is not None
    assert versions.verified == (digest(1),)
    assert "the entry with its images is not what was verified" in " ".join(versions.problems)


@pytest.mark.parametrize("missing", ["evidence", "signature", "statement"])
def test_without_its_signature_a_version_is_not_listed(key: KeyFile, tmp_path: Path, missing: str) -> None:
    files = version(key)
    if missing == "evidence":
        files |= entry(APP, images=(image(1),))
    elif missing == "signature":
        files = version(signing_key(tmp_path / "other"))
    else:
        files = {path: text for path, text in files.items() if not path.endswith("summary.json")}
    versions = Stage(key, tmp_path / "keys", catalogue(files)).listing.read()
    assert versions is not None
    assert (versions.charts, versions.verified) == ((), ())
    assert versions.problems[0].startswith(f"app@0.1.0@{APP.digest} is not listed: summary: ")
    shown("admission", versions.problems[0], "entry-called-verified")


def test_evidence_of_another_version_is_none(key: KeyFile, tmp_path: Path) -> None:
    mine, other = version(key), version(key, artefact("other"), 3)
    path, named = "charts/app/0.1.0.yaml", "charts/other/0.1.0.yaml"
    evidence = [text.partition("evidence: ")[2].split("\n")[0] for text in (mine[path], other[named])]
    assert evidence[0] != evidence[1]
    stolen = {path: mine[path].replace(evidence[0], evidence[1])}
    assert Stage(key, tmp_path, catalogue(mine, other, stolen)).listed()[1] == (digest(3),)


def test_what_was_verified_under_an_earlier_policy_goes_on_running(key: KeyFile, tmp_path: Path) -> None:
    """Manager and gate deploy it no more."""
    stage = Stage(key, tmp_path, catalogue(version(key)))
    stage.listed()
    stage.main.trees.append(catalogue(version(key), policy=OTHER_POLICY))
    assert stage.listed() == (CHARTS, (digest(1),))


def test_a_version_that_was_built_again_keeps_what_runs(key: KeyFile, tmp_path: Path) -> None:
    before, after = catalogue(version(key)), catalogue(version(key, AGAIN, 2))
    for trees in ([before, after], [after, before, after]):
        stage = Stage(key, tmp_path, *trees)
        assert stage.listed()[1] == (digest(1), digest(2))
    stage = Stage(key, tmp_path, before)
    stage.listed()
    stage.main.trees.append(after)
    assert stage.listed()[1] == (digest(1), digest(2))


def test_a_broken_file_is_no_withdrawal_and_a_removed_one_is(key: KeyFile, tmp_path: Path) -> None:
    files = catalogue(version(key), version(key, artefact("other"), 3))
    stage = Stage(key, tmp_path, files, {**files, "charts/app/0.1.0.yaml": "state: ["})
    assert stage.listed()[1] == (digest(1), digest(3))
    stage.main.trees.append({path: text for path, text in files.items() if path != "charts/app/0.1.0.yaml"})
    assert stage.listed()[1] == (digest(3),)


def test_a_commit_that_cannot_be_read_hides_nothing_of_main(key: KeyFile, tmp_path: Path) -> None:
    stage = Stage(key, tmp_path, catalogue(version(key)), catalogue(version(key, AGAIN, 2)))
    stage.main.unreadable = {f"{2:040x}"}
    assert stage.listed()[1] == (digest(1), digest(2))


def test_a_key_that_is_trusted_no_more_takes_what_it_signed(key: KeyFile, tmp_path: Path) -> None:
    stage = Stage(key, tmp_path / "keys", catalogue(version(key)))
    assert stage.listed()[1] == (digest(1),)
    trusting(tmp_path / "keys", signing_key(tmp_path / "other"))
    assert stage.listed()[1] == ()


class Place:
    """Port PolicyPlace."""

    def __init__(self) -> None:
        self.documents: list[Mapping[str, object]] = []

    def write(self, documents: Sequence[Mapping[str, object]]) -> bool:
        changed = self.documents != list(documents)
        self.documents = list(documents)
        return changed

    def intact(self) -> bool:
        return True


def test_policies_follow_the_list_and_stay_while_the_forge_is_away(key: KeyFile, tmp_path: Path) -> None:
    stage = Stage(key, tmp_path)
    place = Place()
    agents = ["vehicle-00"]
    reconciler = PolicyReconciler(
        stage.listing,
        place,
        lambda: Surroundings(Domain(tuple(agents), (), DOMAIN.charts), (digest(2),)),
        ListingFile(tmp_path / "listing.json"),
    )
    assert reconciler.step()  # before there is a catalogue: what the platform needs
    around = Domain(("vehicle-00",), (), DOMAIN.charts)
    assert place.documents == for_files(around, Allowed(platform=(digest(2),)))
    stage.main.trees.append(catalogue(version(key)))
    assert reconciler.step()
    whole = Allowed((digest(1),), (digest(2),), CHARTS)
    assert place.documents == for_files(around, whole)
    assert not reconciler.step()
    stage.main.away = True
    agents.append("vehicle-01")  # joins meanwhile
    with pytest.raises(UnavailableError):
        reconciler.step()
    assert place.documents == for_files(Domain(("vehicle-00", "vehicle-01"), (), DOMAIN.charts), whole)


def test_a_process_that_starts_again_goes_on_with_the_last_list(key: KeyFile, tmp_path: Path) -> None:
    """Also when it cannot read the catalogue yet: nothing that runs is stranded meanwhile."""
    stage = Stage(key, tmp_path / "keys", catalogue(version(key)))
    place = Place()
    memory = ListingFile(tmp_path / "l")
    around = Surroundings(Domain(("vehicle-00",), (), DOMAIN.charts), (digest(2),))
    PolicyReconciler(stage.listing, place, lambda: around, memory).step()
    whole = place.documents
    again = Stage(key, tmp_path / "keys", catalogue(version(key)))
    again.main.away = True
    reconciler = PolicyReconciler(again.listing, place, lambda: around, memory)
    with pytest.raises(UnavailableError):
        reconciler.step()
    assert place.documents == whole == for_files(around.domain, Allowed((digest(1),), (digest(2),), CHARTS))
    again.main.away = False
    again.main.trees.append(catalogue())
    assert reconciler.step()
    assert place.documents == for_files(around.domain, Allowed(platform=(digest(2),)))


@pytest.mark.parametrize("text", ["", "[", "[]", '{"charts": []}', '{"charts": ["a"], "images": [1]}', NO_DIGEST])
def test_a_list_that_cannot_be_read_is_none(tmp_path: Path, text: str, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "listing.json").write_text(text)
    assert ListingFile(tmp_path / "listing.json").load() == AllowedVersions()
    assert "admission: the last list is unusable" in caplog.text
    assert ListingFile(tmp_path / "none").load() == AllowedVersions()


@pytest.mark.parametrize("word", ["sha256:12", "x']", f"{digest(1)}\n", digest(1).upper()])
def test_nothing_but_digests_becomes_part_of_a_policy(word: str) -> None:
    for made in ({"verified": (word,)}, {"platform": (word,)}, {"charts": (f"app@{word}",)}):
        with pytest.raises(InputError):
            Allowed(**made)
    with pytest.raises(InputError, match="names no digest; write <repository>@sha256"):
        digests_of([f"registry.example/a@{word}"])


@pytest.mark.parametrize(
    "wrong",
    [{"agents": ("a'b",)}, {"tests": ("A",)}, {"charts": "oci://a/b'"}, {"platform": ""}, {"volumes": "/a'"}],
)
def test_nothing_but_names_becomes_part_of_a_policy(wrong: dict[str, object]) -> None:
    right: dict[str, object] = {"agents": ("a",), "tests": (), "charts": DOMAIN.charts}
    with pytest.raises(InputError):
        Domain(**{**right, **wrong})  # type: ignore[arg-type]


def test_the_lists_as_entries_of_config_maps() -> None:
    number = digest(0).removeprefix("sha256:")[:-1]
    listed = list_entries((f"event-detector@{digest(9)}",), (digest(1),))
    assert listed == {f"image.{number}1": "", f"chart.event-detector.{number}9": ""}
    assert platform_entries((digest(2),)) == {f"platform.{number}2": ""}
