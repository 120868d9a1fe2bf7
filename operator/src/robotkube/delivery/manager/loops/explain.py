"""Explanations of what would become of a task: POST /explain of the manager (docs/reference/contracts.md).

The question is `{"task": "<namespace>/<name>"}` for a task that is there, `{"withdraw": "<namespace>/<name>"}` for what
would go with it, or a TaskDescription with its namespace for one that is not submitted yet. Nothing is changed by it.
One question at a time, so that asking cannot hold planning up.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from robotkube.delivery.deployment.core.releases import RELEASES
from robotkube.delivery.manager.core.composition.inputs import Met
from robotkube.delivery.manager.core.conflicts import Postponed
from robotkube.delivery.manager.core.explanations import Explanation
from robotkube.delivery.tasks.ports.store import TaskStore
from robotkube.errors import RobotKubeError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.yaml_codec import json_problems
from robotkube.foundation.kubernetes.core.objects import object_key

QUESTION_BYTES_MAX = 256 * 1024
BUSY_SECONDS_MAX = 5.0

ExplanationResponse = tuple[int, Mapping[str, Any]]
"""HTTP status and document."""


class Explainer:
    """The handler that answers questions by `what_if`, about tasks of `store` or new ones; it gets the key of a task
    that would be withdrawn, else the document."""

    def __init__(self, what_if: Callable[[Mapping[str, Any] | str], Explanation], store: TaskStore) -> None:
        self._what_if = what_if
        self._store = store
        self._free = threading.Semaphore(1)

    def __call__(self, body: bytes) -> ExplanationResponse:
        """The answer to the question in `body`: 200 with the explanation, or a `message` with 400 (not a
        question), 404 (no such task), 413, 429 (another question is being answered) or 503 (not able to say)."""
        if len(body) > QUESTION_BYTES_MAX:
            return 413, {"message": f"{len(body)} bytes; a task has at most {QUESTION_BYTES_MAX}"}
        try:
            question = read_json(body)
        except ValueError as error:
            return 400, {"message": f"no JSON: {str(error)[:200]}"}
        return self._answer(question)

    def _answer(self, question: Any) -> ExplanationResponse:
        problems = json_problems(question, "") if isinstance(question, dict) else ["must be a JSON object"]
        if problems:
            return 400, {"message": "; ".join(problems)[:2000]}
        withdrawn = "withdraw" in question
        key = question["withdraw"] if withdrawn else question.get("task")
        document = question if key is None and not withdrawn else self._find(key)
        if document is None:
            return 404, {"message": f"there is no task {key!r:.400}"}
        problem = _metadata_problem(document)
        if problem:
            return 400, {"message": problem}
        if not self._free.acquire(timeout=BUSY_SECONDS_MAX):
            return 429, {"message": "other questions are being answered; ask again"}
        try:
            return 200, explanation_document(self._what_if(object_key(document) if withdrawn else document))
        except RobotKubeError as error:
            return 503, {"message": str(error)}
        finally:
            self._free.release()

    def _find(self, key: Any) -> Mapping[str, Any] | None:
        return next((task for task in self._store.tasks() if object_key(task) == key), None)


def _metadata_problem(document: Mapping[str, Any]) -> str:
    """What is wrong with the metadata, whose form the API server would have checked; empty when nothing is."""
    metadata = document.get("metadata")
    if not isinstance(metadata, Mapping) or not _are_texts(metadata.get(key) for key in ("name", "namespace")):
        return "metadata: needs name and namespace, both text"
    annotations = {} if metadata.get("annotations") is None else metadata["annotations"]
    if not isinstance(annotations, Mapping) or not _are_texts(annotations.values()):
        return "metadata.annotations: must be an object with texts"
    if type(metadata.get("generation", 1)) is not int:
        return "metadata.generation: must be a whole number"
    return ""


def _are_texts(values: Iterable[Any]) -> bool:
    return all(isinstance(value, str) for value in values)


def explanation_document(explanation: Explanation) -> dict[str, Any]:
    """The document of an explanation: the outcome, its reason and message, what its changes would wait for, every
    choice in words, and the files that change."""
    outcome = explanation.outcome
    if outcome is None:
        gone = [change.path for change in explanation.changes if change.after is None]
        releases = [p.removeprefix(f"{RELEASES}/").removesuffix(".yaml") for p in gone if p.startswith(f"{RELEASES}/")]
        answer = {"outcome": "Withdrawn", "reason": "Withdrawn", "message": "", "releases": releases}
    elif isinstance(outcome, Met):
        answer = {"outcome": "Accepted", "reason": "Accepted", "message": "", "releases": list(outcome.releases)}
    else:
        word = "Postponed" if isinstance(outcome, Postponed) else "Refused"
        answer = {"outcome": word, "reason": outcome.reason, "message": outcome.message, "releases": []}
    changes = [{"path": c.path, "before": c.before, "after": c.after} for c in explanation.changes]
    return {
        "task": explanation.key,
        **answer,
        "waits": explanation.waits,
        "lines": list(explanation.lines),
        "changes": changes,
    }
