"""Reading the pages of managers, gate, event detectors and the process certificates into the model: when something
changed that they know more of, and now and then without."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence

from robotkube.delivery.console.core import table as kinds
from robotkube.delivery.console.core.documents import certificate_documents, rule_documents, unchecked_documents
from robotkube.delivery.console.core.recordings import recording_documents
from robotkube.delivery.console.loops.model import ReadModel
from robotkube.delivery.console.ports import Detector, ManagerPages, Pages, Settings
from robotkube.errors import InputError, RobotKubeError
from robotkube.foundation.runtime.loops.wakeups import step_when_woken

RESYNC_SECONDS = 3.0
RETRY_SECONDS_BOUNDS = (RESYNC_SECONDS, 2 * RESYNC_SECONDS)
LEAST_SECONDS = 0.3  # between two readings, however much changes
CATALOGUE_SECONDS = 15.0
SETTINGS_SECONDS = 30.0
CERTIFICATES_SECONDS = 15.0
DETECTORS, GATE_PAGES, CERTIFICATES = "detectors", "gate-pages", "certificates"
MANAGER_ADVICE = "Plans and catalogue are as of then. Look at the pod of component manager."
GATE_ADVICE = "Checks of plans, and what nobody checked, are as of then. Look at the pod of component gate."
CERTIFICATES_ADVICE = "Until when certificates hold is as of then. Look at the pod of component certificates."
NOT_LOOKED = "It has not looked at the certificates of accounts since its start."
NOT_READ = "The gate has not read main since its start."
DETECTOR_ADVICE = "Values of events, rules and recordings are as of then. Look at the pods of the event detectors."
UNREADABLE = (KeyError, TypeError, ValueError, AttributeError, ArithmeticError)


class PageReader(ABC):
    """Reads pages into the model by `step`: when it is woken, and every `seconds` without."""

    seconds = RESYNC_SECONDS

    def __init__(self, model: ReadModel, pages: Pages) -> None:
        self._model = model
        self._pages = pages
        self._woken = threading.Event()

    @abstractmethod
    def step(self) -> bool:
        """Read; False when somebody did not answer, or said that something is wrong."""

    def wake(self) -> None:
        """Something changed, or it is to end."""
        self._woken.set()

    def run(self, stopping: threading.Event) -> None:
        """Read until `stopping` is set, and `wake` called."""
        step_when_woken(_rested(self.step, stopping), self._woken, stopping, self.seconds, RETRY_SECONDS_BOUNDS)

    def _attempt(self, read: Callable[[], str], url: str) -> str:
        """What `read` of the pages below `url` says that is wrong, or why it failed; empty when all is well."""
        try:
            return read()
        except RobotKubeError as error:
            return str(error)
        except UNREADABLE as error:
            return f"{url}: a page that cannot be read: {error!r}"


class ManagerReader(PageReader):
    """Reads one manager's plans, and its catalogue more rarely. `monotonic` in seconds."""

    def __init__(self, model: ReadModel, pages: Pages, manager: ManagerPages, monotonic: Callable[[], float]) -> None:
        super().__init__(model, pages)
        self._manager = manager
        self._monotonic = monotonic
        self._catalogue_at = float("-inf")

    def step(self) -> bool:
        problem = self._attempt(self._read, self._manager.url)
        carries = (kinds.PLANS, kinds.CATALOGUE)
        self._model.put_source(f"manager/{self._manager.name}", problem, MANAGER_ADVICE, carries)
        return not problem

    def _read(self) -> str:
        name, url = self._manager.name, self._manager.url
        self._model.put_plans(self._pages.get(f"{url}/plans"), name)
        if self._monotonic() - self._catalogue_at >= CATALOGUE_SECONDS:
            self._model.put_catalogue(name, self._pages.get(f"{url}/catalogue"))
            self._catalogue_at = self._monotonic()
        else:
            self._model.put_catalogue(name)
        return ""


class GateReader(PageReader):
    """Reads what the gate checked and decided, and what came to main without it. `url` is the address in front of its
    pages."""

    def __init__(self, model: ReadModel, pages: Pages, url: str) -> None:
        super().__init__(model, pages)
        self._url = url

    def step(self) -> bool:
        problem = self._attempt(self._read, self._url)
        self._model.put_source(GATE_PAGES, problem, GATE_ADVICE, (kinds.PLANS, kinds.UNCHECKED))
        return not problem

    def _read(self) -> str:
        self._model.put_decisions(self._pages.get(f"{self._url}/decisions"))
        page = self._pages.get(f"{self._url}/unchecked")
        if not page["tip"]:
            return NOT_READ
        self._model.replace(kinds.UNCHECKED, unchecked_documents(page))
        return ""


class CertificateReader(PageReader):
    """Reads until when the certificates of accounts hold. `url` is the address in front of the page."""

    seconds = CERTIFICATES_SECONDS

    def __init__(self, model: ReadModel, pages: Pages, url: str) -> None:
        super().__init__(model, pages)
        self._url = url

    def step(self) -> bool:
        problem = self._attempt(self._read, self._url)
        self._model.put_source(CERTIFICATES, problem, CERTIFICATES_ADVICE, (kinds.CERTIFICATES,))
        return not problem

    def _read(self) -> str:
        page = self._pages.get(f"{self._url}/accounts")
        if page["accounts"] is None:
            return str(page["problem"]) or NOT_LOOKED
        self._model.replace(kinds.CERTIFICATES, certificate_documents(page))
        return str(page["problem"])


class DetectorReader(PageReader):
    """Reads what event detectors say of events, and the rules in their settings more rarely. `detectors` are those that
    run now."""

    def __init__(
        self,
        model: ReadModel,
        pages: Pages,
        settings: Settings,
        detectors: Callable[[], Sequence[Detector]],
        monotonic: Callable[[], float],
    ) -> None:
        super().__init__(model, pages)
        self._settings = settings
        self._detectors = detectors
        self._monotonic = monotonic
        self._settings_at: dict[str, float] = {}

    def step(self) -> bool:
        """Read all of them; False when one did not answer."""
        detectors = self._detectors()
        problems = [problem for detector in detectors if (problem := self._read(detector))]
        for gone in set(self._settings_at) - {detector.release for detector in detectors}:
            del self._settings_at[gone]
            self._model.replace(kinds.RULES, {}, f"{gone}/")
        self._model.leave_recordings({detector.pod for detector in detectors})
        carries = (kinds.EVENTS, kinds.RULES, kinds.RECORDINGS)
        self._model.put_source(DETECTORS, "; ".join(problems[:3]), DETECTOR_ADVICE, carries)
        return not problems

    def _read(self, detector: Detector) -> str:
        """Read one; why that failed, else empty."""
        try:
            self._model.put_events(self._pages.get(f"http://{detector.host}:8081/events"), detector.pod)
            self._read_recordings(detector)
            if self._monotonic() - self._settings_at.get(detector.release, float("-inf")) >= SETTINGS_SECONDS:
                document = self._settings.read(detector.release.partition("/")[0], detector.config_map)
                self._model.replace(
                    kinds.RULES, rule_documents(_rules_of(document), detector.release), f"{detector.release}/"
                )
                self._settings_at[detector.release] = self._monotonic()
        except RobotKubeError as error:
            return f"{detector.pod}: {error}"
        except UNREADABLE as error:
            return f"{detector.pod}: a page that cannot be read: {error!r}"
        return ""

    def _read_recordings(self, detector: Detector) -> None:
        try:
            page = self._pages.get(f"http://{detector.host}:8081/recordings")
        except InputError:  # a detector of a version that has no such page
            return
        self._model.put_recordings(recording_documents(page, detector.pod.partition("/")[0], detector.pod))


def _rules_of(document: Mapping[str, object]) -> Mapping[str, object]:
    if not isinstance(document, Mapping):
        raise InputError("its settings are no mapping")
    return document


def _rested(step: Callable[[], bool], stopping: threading.Event) -> Callable[[], bool]:
    """The step with a rest behind it, so that what changes all the time is not read all the time."""

    def rested() -> bool:
        done = step()
        stopping.wait(LEAST_SECONDS)
        return done

    return rested
