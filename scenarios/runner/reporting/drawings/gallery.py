"""All drawings of a document: each with the reason where there is none, since no drawing may lose a report."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from scenarios.runner.reporting.drawings import ages, cores, coverage, distances, trajectories, ways
from scenarios.runner.reporting.drawings.drawing import Drawing, NoDrawingError
from scenarios.runner.reporting.drawings.reading import Document

Draw = Callable[[Document], Iterator[Drawing]]
DRAWINGS: Mapping[str, Draw] = {
    "trajectories": trajectories.trajectories,
    "distances": distances.distances,
    "ages": ages.ages,
    "ways": ways.ways,
    "cores": cores.cores,
    "recordings": coverage.coverage,
}
NOTHING = "what report.json has of it cannot be drawn"
OLDER = "this report.json has no data for drawings: an older version made it"


@dataclass(frozen=True)
class Drawn:
    """The drawings of one kind, and why there are none, or not all."""

    drawings: tuple[Drawing, ...]
    missing: str = ""


def gallery(document: Document) -> Mapping[str, Drawn]:
    """The drawings by kind."""
    return {kind: _drawn(draw, document) for kind, draw in DRAWINGS.items()}


def _drawn(draw: Draw, document: Document) -> Drawn:
    if "drawings" not in document:
        return Drawn((), OLDER)
    made: list[Drawing] = []
    try:
        for drawing in draw(document):
            made.append(drawing)  # one by one: those made before an error remain
    except NoDrawingError as reason:
        return Drawn(tuple(made), str(reason))
    except Exception as error:  # of odd data: the tables do not need the drawing
        return Drawn(tuple(made), f"{type(error).__name__}: {error}")
    return Drawn(tuple(made), "" if made else NOTHING)
