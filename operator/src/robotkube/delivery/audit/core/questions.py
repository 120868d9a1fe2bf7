"""What is asked about: a release, task, trace, event, plan, commit, pod or digest; and what of main it concerns."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from robotkube.delivery.audit.core.main_replay import MainChange, MainReplay, ReleaseRun
from robotkube.delivery.audit.core.outcomes import Observed
from robotkube.errors import InputError
from robotkube.foundation.documents.core.patterns import COMMIT, COMMIT_START, DIGEST_START, POD_NAME

WORD_CHARACTERS_MAX = 512


@dataclass(frozen=True)
class Answered:
    """What a question concerns: its word was understood `as` these (several can hold: a task may have the name of a
    release); `runs` and `changes` in the order of main."""

    word: str
    as_: tuple[str, ...]
    runs: tuple[ReleaseRun, ...]
    changes: tuple[MainChange, ...]


@dataclass(frozen=True)
class Known:
    """What questions are answered from. `images`: chart digest -> references of its images, as the catalogue pins them;
    `observed`: commit -> release -> what a manager saw."""

    main: MainReplay
    images: Mapping[str, Sequence[str]]
    observed: Mapping[str, Mapping[str, Observed]]


def answer(word: str, known: Known) -> Answered:
    """What `word` concerns; all of main when it is empty. InputError when nothing on main has to do with it."""
    if not word:
        return Answered("", ("all of main",), known.main.runs, known.main.changes)
    if len(word) > WORD_CHARACTERS_MAX:
        raise InputError(f"{word[:40]!r}...: longer than {WORD_CHARACTERS_MAX} characters; that names nothing")
    places: set[int] = set()
    commits: set[str] = set()
    kinds: list[str] = []
    for kind, (matching_run, matching_change) in _readings(word, known).items():
        matching = {place for place, run in enumerate(known.main.runs) if matching_run(run)}
        named = [change for change in known.main.changes if matching_change(change)]
        if matching or named:
            kinds.append(kind)
            places |= matching
            commits |= {change.commit.id for change in named}
    if not kinds:
        raise InputError(
            f"nothing on main has to do with {word!r}; give a release or task (<namespace>/<name>), the id of an "
            "event, trace or plan, a commit, a pod (<namespace>/<name>), or a digest (sha256:..., 7 digits or more)"
        )
    runs = tuple(known.main.runs[place] for place in sorted(places))
    commits |= {commit for run in runs for commit in (run.began, run.ended)}
    changes = tuple(change for change in known.main.changes if change.commit.id in commits)
    return Answered(word, tuple(kinds), runs, changes)


Reading = tuple[Callable[[ReleaseRun], bool], Callable[[MainChange], bool]]


def _readings(word: str, known: Known) -> dict[str, Reading]:
    """How a word can be meant -> which runs and which commits it then concerns."""
    readings: dict[str, Reading] = {
        "release": (lambda run: run.release.key == word, lambda change: word in change.releases),
        "task": (_asked(lambda cause: cause.task, word), _named(lambda cause: cause.task, word)),
        "trace": (_asked(lambda cause: cause.trace, word), _named(lambda cause: cause.trace, word)),
        "event": (_asked(lambda cause: cause.event, word), _named(lambda cause: cause.event, word)),
        "plan": (
            lambda run: run.release.plan == word,
            lambda change: change.message is not None and change.message.plan == word,
        ),
    }
    if COMMIT_START.fullmatch(word):
        exact = bool(COMMIT.fullmatch(word))
        ids = [
            c.commit.id for c in known.main.changes if (c.commit.id == word if exact else c.commit.id.startswith(word))
        ]
        readings["commit"] = (lambda run: run.began in ids, lambda change: change.commit.id in ids)
    if match := DIGEST_START.fullmatch(word):
        readings |= _digests(f"sha256:{match['digits']}", known)
    releases = {run.release.key for run in known.main.runs}
    pod = release_of_pod(word, releases)
    if pod and word not in releases:
        readings["pod"] = (lambda run: run.release.key == pod, lambda change: False)
    return readings


def _asked(part: Callable[..., str], word: str) -> Callable[[ReleaseRun], bool]:
    return lambda run: any(part(cause) == word for cause in run.release.causes)


def _named(part: Callable[..., str], word: str) -> Callable[[MainChange], bool]:
    return lambda change: change.message is not None and any(part(cause) == word for cause in change.message.causes)


def _digests(start: str, known: Known) -> dict[str, Reading]:
    """Readings of a digest, whole or as tables shorten it."""

    def nothing(change: MainChange) -> bool:
        return False

    def runs_image(run: ReleaseRun) -> bool:
        pinned = known.images.get(run.release.digest, ())
        seen = known.observed.get(run.began, {}).get(run.release.key)
        return any(f"@{start}" in image for image in (*pinned, *(seen.images if seen else ())))

    return {
        "chart digest": (lambda run: run.release.digest.startswith(start), nothing),
        "evidence digest": (lambda run: run.release.evidence.startswith(start), nothing),
        "image digest": (runs_image, nothing),
    }


def release_of_pod(word: str, releases: Iterable[str]) -> str:
    """The key of the release that a pod belongs to by its name, `<namespace>/<release>-<hash>-<hash>`, the namespace
    may be left out where only one fits; empty when there is none."""
    namespace, _, name = word.rpartition("/")
    match = POD_NAME.fullmatch(name)
    if not match:
        return ""
    wanted = match["deployment"]
    fitting = [
        key for key in releases if key.partition("/")[2] == wanted and key.startswith(f"{namespace}/" * bool(namespace))
    ]
    return fitting[0] if len(fitting) == 1 else ""
