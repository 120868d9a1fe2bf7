"""The port of the probe to a cluster."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from robotkube.delivery.preflight.core.renderings import Object


class ProbeCluster(Protocol):
    """The one namespace of a probe at the API server. UnavailableError when it does not answer, InputError when it
    refuses."""

    def lacking(self) -> Sequence[str]:
        """The rights that the account lacks for all of this, as people say them."""
        ...

    def open(self) -> None:
        """Make the namespace with its account and its policy; InputError when one of its name is there already."""
        ...

    def start(self, pod: Object) -> None:
        """Make a pod."""
        ...

    def pods(self) -> Mapping[str, Object]:
        """The pods that are there, by their names."""
        ...

    def events(self) -> Sequence[Object]:
        """The Events of the namespace."""
        ...

    def close(self) -> bool:
        """Ask that the namespace, when this probe made it, go with all that is in it; whether it is gone."""
        ...
