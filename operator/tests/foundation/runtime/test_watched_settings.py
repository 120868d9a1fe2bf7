"""Settings that a service of somebody's own watches: every change reaches its program, a refused one its readiness."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from robotkube.errors import InputError
from robotkube.services import WatchedSettings
from robotkube.testing.api_server import ApiServerInMemory
from tests.stages.waiting import until


class Service:
    """A program that takes any settings but a rate of 0."""

    def __init__(self, folder: Path, api: ApiServerInMemory) -> None:
        self.api = api
        self.rates: list[int] = []
        file = folder / "config.yaml"
        file.write_text("rate: 10\n")
        self.change("rate: 10\n")
        environment = {
            "ROBOTKUBE_CONFIG": str(file),
            "ROBOTKUBE_CONFIGMAP": "vehicle-00/own",
            "ROBOTKUBE_API_SERVER": api.url,
        }
        self.settings = WatchedSettings(self.apply, environment)

    def change(self, text: str) -> None:
        self.api.put_config_map("vehicle-00", "own", {"config.yaml": text})

    def apply(self, settings: Mapping[str, Any]) -> None:
        self.rates.append(100 // settings["rate"])

    def until_told(self) -> None:
        until(lambda: self.settings.complaint == "changed settings are not at work yet")
        self.settings.apply_changes()


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Service]:
    with ApiServerInMemory() as api:
        made = Service(tmp_path, api)
        yield made
        made.settings.close()


def test_the_first_settings_and_every_change_reach_the_program(service: Service) -> None:
    assert (service.rates, service.settings.complaint) == ([10], None)
    service.change("rate: 20\n")
    service.until_told()
    assert (service.rates, service.settings.complaint) == ([10, 5], None)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("rate: 0\n", "ZeroDivisionError"),
        ("speed: 1\n", "KeyError: 'rate'"),
        ("rate: [\n", "config.yaml: "),
    ],
)
def test_changed_settings_that_the_program_refuses_are_a_complaint(service: Service, text: str, why: str) -> None:
    service.change(text)
    service.until_told()
    assert why in str(service.settings.complaint)
    assert service.rates == [10]
    service.change("rate: 10\n")
    until(lambda: service.settings.complaint is None)
    service.settings.apply_changes()
    assert service.rates == [10]


def test_first_settings_that_are_wrong_are_the_program_s_own_error(tmp_path: Path) -> None:
    file = tmp_path / "config.yaml"
    with pytest.raises(InputError, match="cannot be read"):
        WatchedSettings(print, {"ROBOTKUBE_CONFIG": str(file)})
    file.write_text("rate: 1\n")

    def refuse(settings: Mapping[str, Any]) -> None:
        raise ValueError("no rate")

    with pytest.raises(ValueError, match="no rate"):
        WatchedSettings(refuse, {"ROBOTKUBE_CONFIG": str(file)})
    alone = WatchedSettings(lambda settings: None, {"ROBOTKUBE_CONFIG": str(file)})
    alone.apply_changes()
    assert alone.complaint is None
    alone.close()
