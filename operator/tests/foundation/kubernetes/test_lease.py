"""The election of a leader while the API server is away: it goes on, sooner than by the usual time, and not in step
with the other candidates."""

from __future__ import annotations

from datetime import UTC, datetime

from kubernetes import client

from robotkube.errors import UnavailableError
from robotkube.foundation.kubernetes.adapters.lease import RENEW_SECONDS, LeaseElection
from tests.stages.pauses import Pauses


class Election(LeaseElection):
    """An election whose API server answers as often as `answers` says."""

    def __init__(self, *answers: bool) -> None:
        super().__init__(
            client.ApiClient(), "robotkube", "manager", "a_127.0.0.1:1", lambda: 0.0, lambda: datetime.now(UTC),
            lambda: None, lambda: 0.5,
        )  # fmt: skip
        self._answers = iter(answers)
        self._woken = self.pauses = Pauses(len(answers), self._stopping)

    def try_to_lead(self) -> None:
        if not next(self._answers):
            raise UnavailableError("the API server is away")


def test_failures_are_repeated_after_a_back_off() -> None:
    election = Election(True, False, False, False, False, True)
    election._run()
    assert election.pauses.seconds == [RENEW_SECONDS, 0.25, 0.5, 1.0, RENEW_SECONDS / 2, RENEW_SECONDS]
