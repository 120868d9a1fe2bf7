"""The report whether the newest settings are at work: every order in which texts are given, taken and refused."""

from robotkube.foundation.runtime.loops.settings_report import PENDING, REFUSED, SettingsReport


def report(*steps: tuple[str, ...]) -> SettingsReport:
    made = SettingsReport()
    for name, *words in steps:
        getattr(made, name)(*words)
    return made


def test_a_process_without_settings_has_no_complaint() -> None:
    assert report().complaint is None


def test_settings_are_missing_until_they_are_taken() -> None:
    assert report(("given", "a")).complaint == PENDING
    assert report(("given", "a"), ("taken", "a")).complaint is None
    assert report(("given", "a"), ("taken", "a"), ("given", "b")).complaint == PENDING


def test_refused_settings_are_a_complaint_though_older_ones_are_at_work() -> None:
    refused = report(("given", "a"), ("taken", "a"), ("given", "b"), ("refused", "b", "b: too large"))
    assert (refused.complaint, refused.refusal) == (f"{REFUSED}: b: too large", "b: too large")
    assert refused.at_work == "a"
    assert refused.metrics() == "robotkube_settings_refused 1\n"


def test_settings_of_before_take_the_complaint_away() -> None:
    back = report(("given", "a"), ("taken", "a"), ("given", "b"), ("refused", "b", "no"), ("given", "a"))
    assert (back.complaint, back.metrics()) == (None, "robotkube_settings_refused 0\n")


def test_an_older_text_that_is_taken_late_hides_no_refusal() -> None:
    late = report(("given", "a"), ("given", "b"), ("refused", "b", "no"), ("taken", "a"))
    assert late.complaint == f"{REFUSED}: no"
