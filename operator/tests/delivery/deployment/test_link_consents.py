"""policies/links/<manager>.yaml: what may be heard over the border between the scopes of two managers."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.delivery.deployment.core.borders import Borders, said_as, scopes_of, speaker
from robotkube.delivery.deployment.core.policies.links import (
    LinkConsents,
    covers,
    path_of,
    read_consent,
    read_consents,
    scope_of,
)
from robotkube.errors import DocumentError

NORTH, SOUTH = path_of("north"), path_of("south")
SCOPES = scopes_of([("north", ["cloud-1", "vehicle-02"]), ("south", ["cloud-0", "vehicle-00"])])
POSE, POSES = "/vehicles/vehicle_00/pose", "/vehicles/{agent}/pose"
SENDS = "sends:\n- {to: north, topics: ['%s']}\n"
RECEIVES = "receives:\n- {from: south, topics: ['%s']}\n"


def borders(**files: str) -> Borders:
    consents, problems = read_consents({path_of(name): text for name, text in files.items()}, LinkConsents())
    assert problems == ()
    return Borders(SCOPES, consents)


@pytest.mark.parametrize("topic", [POSE, POSES])
def test_both_sides_consent_or_nothing_is_heard(topic: str) -> None:
    gives, takes = SENDS % topic, RECEIVES % topic
    lacks_sends = f"{SOUTH} sends: {{to: north, topics: [{POSE}]}}"
    lacks_receives = f"{NORTH} receives: {{from: south, topics: [{POSE}]}}"
    assert borders(north=takes, south=gives).missing(POSE, "cloud-1") == ()
    assert borders(south=gives).missing(POSE, "cloud-1") == (lacks_receives,)
    assert borders(north=takes).missing(POSE, "cloud-1") == (lacks_sends,)
    assert borders().missing(POSE, "cloud-1") == (lacks_sends, lacks_receives)
    swapped = borders(north=gives.replace("north", "south"), south=takes.replace("south", "north"))
    assert swapped.missing(POSE, "cloud-1") == (lacks_sends, lacks_receives), "the other way round is another link"


def test_what_is_missing_is_said_with_both_agents_and_scopes() -> None:
    assert borders(south=SENDS % POSE).obstacle(POSE, "cloud-1") == (
        f"topic {POSE} is said by vehicle-00 of scope south, and cloud-1 is of scope north: a link over this border "
        f"needs the consent of both, and main lacks {NORTH} receives: {{from: south, topics: [{POSE}]}}; people add it "
        "by pull request"
    )


def test_within_a_scope_and_without_scopes_there_is_no_border() -> None:
    assert borders().missing(POSE, "cloud-0") == ()
    assert Borders().missing(POSE, "cloud-1") == ()
    assert scopes_of([("manager", ["*"])]) == {}


def test_any_agent_is_those_that_may_be_heard() -> None:
    assert borders().missing(POSES, "cloud-1") == ()
    own = ["/vehicles/cloud_1/pose", "/vehicles/vehicle_02/pose"]
    assert list(borders().heard_of(POSES, "cloud-1")) == own
    consented = borders(north=RECEIVES % POSE, south=SENDS % POSES)
    assert sorted(consented.heard_of(POSES, "cloud-1")) == sorted([*own, POSE])


@pytest.mark.parametrize(
    ("topic", "agent"),
    [
        (POSE, "vehicle-00"),
        ("/agents/cloud_0/vehicles/vehicle_02/objects", "cloud-0"),
        (POSES, "{agent}"),
        ("/{agent}/vehicle_00/pose", "vehicle-00"),
        ("/vehicles/vehicle_00", "vehicle-00"),
        ("/vehicles", ""),
        ("/tf", ""),
        ("", ""),
    ],
)
def test_a_topics_name_says_whose_it_is(topic: str, agent: str) -> None:
    assert speaker(topic) == agent


def test_a_pattern_in_the_place_of_vehicles_is_no_way_around() -> None:
    everywhere = borders(north=RECEIVES % POSE, south=SENDS % POSE)
    assert len(everywhere.missing("/{agent}/vehicle_00/pose", "cloud-1")) == 2


def test_names_at_the_broker() -> None:
    assert said_as("mqtt/vehicles/+/pose") == POSES
    assert said_as("mqtt/vehicles/vehicle_00/pose") == POSE
    assert said_as("pingpong/ros") == ""


parts = st.sampled_from(["a", "b"])


@given(
    st.lists(parts | st.just("{agent}"), min_size=1, max_size=4),
    st.lists(parts, min_size=1, max_size=4),
)
def test_a_consent_covers_what_it_is_with_any_agent_put_in(consented: list[str], topic: list[str]) -> None:
    pairs = list(zip(consented, topic, strict=False))
    fits = len(consented) == len(topic) and all(one in ("{agent}", part) for one, part in pairs)
    assert covers("/".join(consented), "/".join(topic)) is fits


def test_files_are_called_by_managers() -> None:
    assert scope_of(NORTH) == "north"
    for other in ("policies/links.yaml", "policies/links/north.yml", "policies/links/a/b.yaml", "policies/links/.yaml"):
        assert scope_of(other) is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("sends: [{to: north}]", "sends[0].topics: missing"),
        ("sends: [{from: north, topics: []}]", "sends[0]"),
        ("receives: [{from: North, topics: [/a]}]", "receives[0].from"),
        ("receives: [{from: south, topics: ['a b']}]", "receives[0].topics[0]"),
        ("gives: []", "gives"),
    ],
)
def test_a_mistake_is_named_with_its_key(text: str, words: str) -> None:
    with pytest.raises(DocumentError) as caught:
        read_consent(text, NORTH)
    assert any(words in problem for problem in caught.value.problems), caught.value.problems


def test_a_file_that_cannot_be_read_says_what_it_said_before() -> None:
    before = borders(south=SENDS % POSE).consents
    now, problems = read_consents({SOUTH: "sends: 7"}, before)
    assert now == before
    assert "what south consented to stays so" in problems[0]
    assert read_consents({SOUTH: "sends: 7"}, LinkConsents())[0].scopes == {}
    assert read_consents({}, before)[0].scopes == {}, "a file that is gone consents to nothing"
