"""The table of rights: what accounts may whatever main says, and what releases on main give them to read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.delivery.deployment.core.borders import Borders
from robotkube.delivery.deployment.core.policies.agents import PATH as AGENTS_PATH
from robotkube.delivery.deployment.core.policies.agents import write_enrolled
from robotkube.delivery.deployment.core.policies.links import path_of
from robotkube.delivery.deployment.core.policies.revoked import PATH as REVOKED_PATH
from robotkube.delivery.deployment.core.policies.revoked import write_revoked
from robotkube.delivery.deployment.core.releases import Release, read_tree
from robotkube.delivery.rights.core.accounts import (
    ASK,
    OWNER,
    READ,
    WRITE,
    AgentAccount,
    ManagerAccount,
    Right,
    fixed_rights,
)
from robotkube.delivery.rights.core.control import (
    DEFAULTS,
    RECEIVE,
    SUBSCRIBE,
    Client,
    Password,
    Standing,
    first_file,
    wanted_roles,
)
from robotkube.delivery.rights.core.differences import access_changes, foreign_changes, missing, role_changes
from robotkube.delivery.rights.core.grants import MainTable, granted, main_table, rights_of
from robotkube.errors import DocumentError
from robotkube.robots.bridge.core.rights import IN, OUT, may, may_anybody
from robotkube.robots.bridge.core.settings import GATEWAY_TOPICS
from tests.stages.delivery.rights.main_of_links import POSE_00, POSE_01, bridge, release, texts
from tests.stages.delivery.rights.rights_broker import ACCOUNTS

FIXED = fixed_rights(ACCOUNTS)
ROLES = wanted_roles(FIXED)


def table(*releases: Release, before: MainTable | None = None, revoked: str | None = None) -> MainTable:
    policies = {} if revoked is None else {REVOKED_PATH: revoked}
    return main_table("c" * 40, read_tree(texts(*releases)), ACCOUNTS, before, policies)


def given_to(agent: str, main: MainTable) -> set[str]:
    """The MQTT topics that main gives an agent to read, without what says their types."""
    rights = main.table[agent] - FIXED[agent]
    assert all(right.direction == READ for right in rights)
    return {right.topic for right in rights if right.topic.startswith("mqtt/") or "/" not in right.topic}


def test_an_agent_writes_below_its_own_places_only() -> None:
    written = {agent.name: {r.topic for r in FIXED[agent.name] if r.direction == WRITE} for agent in ACCOUNTS.agents}
    gateway = {n: {f"robotkube/{k}/{n}" for k in ("tasks", "holds")} | {f"robotkube/links/{n}/+"} for n in written}
    kinds = ("", "robotkube/types/", "mqtt_client/ros_msg_type/")
    assert written["vehicle-00"] - gateway["vehicle-00"] == {
        f"{kind}mqtt/{place}/vehicle_00/#" for kind in kinds for place in ("agents", "vehicles")
    }
    assert written["cloud-0"] - gateway["cloud-0"] == {f"{kind}mqtt/agents/cloud_0/#" for kind in kinds}


def test_everything_that_robots_say_is_for_the_observer_alone() -> None:
    readers = {name for name, rights in FIXED.items() if Right("mqtt/#", READ) in rights}
    assert readers == {"observer"}
    assert not [right for right in FIXED["observer"] if right.direction == WRITE]


def test_nobody_but_the_owner_may_change_rights() -> None:
    assert [name for name, listed in ROLES.items() if any("$" in topic for _, topic, _ in listed)] == [OWNER]


def test_links_on_main_give_to_read() -> None:
    main = table(bridge("vehicle-00", POSE_01, "/agents/cloud_0/plan"), bridge("cloud-0", "/vehicles/{agent}/pose"))
    assert given_to("vehicle-00", main) == {"mqtt/vehicles/vehicle_01/pose", "mqtt/agents/cloud_0/plan"}
    assert given_to("cloud-0", main) == {"mqtt/vehicles/+/pose"}
    assert given_to("vehicle-01", main) == set()
    kinds = {"robotkube/types/mqtt/vehicles/+/pose", "mqtt_client/ros_msg_type/mqtt/vehicles/+/pose"}
    assert {Right(topic, READ) for topic in kinds} <= main.table["cloud-0"]


def test_a_detector_that_reads_the_broker_is_given_its_topics() -> None:
    topics = [{"name": "/vehicles/{agent}/pose", "type": "a", "source": "mqtt"}, {"name": "/other", "type": "a"}]
    main = table(release("cloud-0", "watch", {"detector": {"topics": topics}}, chart="event-detector"))
    assert given_to("cloud-0", main) == {"mqtt/vehicles/+/pose"}


def test_a_release_gives_to_the_agent_of_its_namespace_whatever_it_says() -> None:
    main = table(bridge("vehicle-01", POSE_00, agent="cloud-0"))
    assert given_to("vehicle-01", main) == {"mqtt/vehicles/vehicle_00/pose"}
    assert main.table["cloud-0"] == FIXED["cloud-0"]
    assert table(bridge("elsewhere", POSE_00)).table == FIXED


def test_the_task_gateway_needs_no_grant_and_is_given_to_nobody_else() -> None:
    main = table(bridge("vehicle-00", "/robotkube/task_status"))
    assert main.table == FIXED
    assert main.problems == ()


@pytest.mark.parametrize(
    "item",
    [
        {"name": "/a", "mqtt_topic": "robotkube/tasks/vehicle-01"},
        {"name": "/a", "mqtt_topic": "robotkube/task_status/vehicle-01"},
        {"name": "/a", "mqtt_topic": "$CONTROL/dynamic-security/v1/response"},
        {"name": "/a", "mqtt_topic": "$share/g/mqtt/vehicles/vehicle_01/pose"},
        {"name": "/a", "mqtt_topic": "#"},
        {"name": "/a", "mqtt_topic": "mqtt/+/x"},
        {"name": "/a", "mqtt_topic": "{agent}/tasks/vehicle-01"},
        {"name": "/a", "mqtt_topic": "{agent}/vehicles/vehicle_01/pose"},
        {"name": "/a/#"},
        {"name": "/+"},
        {"name": "/{agent}/{agent}"},
        {"name": 7},
        "/a",
        None,
    ],
)
def test_what_is_no_topic_gives_nothing_and_is_said(item: Any) -> None:
    values = {"bridge": {"in": [item, {"name": POSE_01}]}}
    main = table(release("vehicle-00", "mqtt-bridge", values))
    assert given_to("vehicle-00", main) == {"mqtt/vehicles/vehicle_01/pose"}
    assert [problem.split(": ")[:2] for problem in main.problems] == [
        ["releases/vehicle-00/mqtt-bridge.yaml", "bridge.in[0]"]
    ]


def test_another_name_at_the_broker() -> None:
    main = table(bridge("vehicle-00", {"name": "/ping", "mqtt_topic": "pingpong/ros"}))
    assert Right("pingpong/ros", READ) in main.table["vehicle-00"]
    assert Right("mqtt/ping", READ) not in main.table["vehicle-00"]


def test_a_broken_file_is_not_a_withdrawal() -> None:
    first = table(bridge("vehicle-00", POSE_01), bridge("cloud-0", POSE_00))
    files = {**texts(bridge("vehicle-00", POSE_01)), "releases/vehicle-00/mqtt-bridge.yaml": "no release"}
    main = main_table("d" * 40, read_tree(files), ACCOUNTS, first, {})
    assert given_to("vehicle-00", main) == {"mqtt/vehicles/vehicle_01/pose"}
    assert given_to("cloud-0", main) == set()
    assert "cannot be read; what it gave before stays" in main.problems[0]
    assert main_table("d" * 40, read_tree(files), ACCOUNTS, None, {}).table == FIXED


PARTS = ["/", "$", "+", "#", "{agent}", "a", "robotkube/tasks", "mqtt", "/vehicles/vehicle_01"]
words = st.lists(st.sampled_from(PARTS), max_size=4).map("".join)
items = st.fixed_dictionaries({"name": words | st.none()}, optional={"mqtt_topic": words, "source": st.just("mqtt")})
lists = st.lists(items | words, max_size=3) | words


@given(lists, lists)
def test_whatever_anybody_deploys_gives_nothing_of_the_platform(incoming: Any, topics: Any) -> None:
    deployed = release("vehicle-00", "any", {"bridge": {"in": incoming}, "detector": {"topics": topics}})
    for grant in granted(deployed, ACCOUNTS).grants:
        assert grant.agent == "vehicle-00"
        for right in rights_of(grant, Borders()):
            assert right.direction == READ
            assert not right.topic.startswith(("$", "#", "+", "robotkube/task", "robotkube/holds"))
            assert "#" not in right.topic


TOPIC_WORDS = st.sampled_from(["agents", "vehicles", "vehicle_00", "cloud_0", "a"])


@given(st.sampled_from(ACCOUNTS.agents), st.lists(TOPIC_WORDS, max_size=5))
def test_what_may_be_composed_is_what_may_be_written(agent: Any, words: list[str]) -> None:
    topic = "/" + "/".join(words)
    places = [right.topic.removesuffix("#") for right in FIXED[agent.name] if right.direction == WRITE]
    assert may(agent, OUT, topic) == any(f"mqtt{topic}/".startswith(place) for place in places)


ANY_TOPIC = st.lists(TOPIC_WORDS | st.just("{agent}"), max_size=5).map(lambda words: "/" + "/".join(words))


@given(st.sampled_from([IN, OUT]), ANY_TOPIC | st.sampled_from(sorted(GATEWAY_TOPICS)))
def test_what_anybody_may_be_given_each_agent_may(direction: str, topic: str) -> None:
    """Of whom a plan asks nothing there: 4 million questions in 60 plans before."""
    assert not may_anybody(direction, topic) or all(may(agent, direction, topic) for agent in ACCOUNTS.agents)
    assert may_anybody(IN, "/vehicles/vehicle_00/pose")
    assert may_anybody(OUT, "/agents/{agent}/plan")
    assert not may_anybody(OUT, "/agents/vehicle_00/plan")


# -- what stands at the broker ----------------------------------------------------------------------------------------

CLIENTS = {name: Client((name,)) for name in ROLES}


def test_nothing_to_do_where_all_is_as_it_shall_be() -> None:
    standing = Standing(ROLES, CLIENTS)
    assert role_changes(standing, ROLES) == []
    assert list(foreign_changes(standing, ROLES)) == []


def test_rights_change_by_whole_lists_and_nothing_else() -> None:
    main = table(bridge("vehicle-00", POSE_01))
    [change] = role_changes(Standing(ROLES, CLIENTS), wanted_roles(main.table))
    assert (change.request["command"], change.request["rolename"]) == ("modifyRole", "vehicle-00")
    assert "without publishClientReceive mqtt/vehicles/vehicle_01/pose" in change.was.replace(
        "mqtt_client/ros_msg_type/", ""
    )


@pytest.mark.parametrize(
    ("changed", "command", "was"),
    [
        (
            {"defaults": {**DEFAULTS, "publishClientReceive": True}},
            "setDefaultACLAccess",
            "publishClientReceive allowed",
        ),
        ({"anonymous": "all"}, "setAnonymousGroup", "group all"),
        ({"groups": ("all",)}, "deleteGroup", "a group"),
        ({"roles": {**ROLES, "x": frozenset()}}, "deleteRole", "a role that is not ours"),
        ({"roles": {k: v for k, v in ROLES.items() if k != "cloud-0"}}, "createRole", "no role of the account's name"),
        ({"clients": {**CLIENTS, "x": Client(("x",))}}, "deleteClient", "an account that is not ours"),
        ({"clients": {**CLIENTS, "cloud-0": Client(("cloud-0", "x"))}}, "modifyClient", "the roles cloud-0, x"),
        ({"clients": {**CLIENTS, "cloud-0": Client(("cloud-0",), ("g",))}}, "modifyClient", "group g"),
    ],
)
def test_what_only_another_hand_can_have_done(changed: Mapping[str, Any], command: str, was: str) -> None:
    standing = Standing(**{"roles": ROLES, "clients": CLIENTS, **changed})
    [change] = foreign_changes(standing, ROLES)
    assert change.request["command"] == command
    assert was in change.was


def test_who_is_revoked_has_no_rights_and_a_shut_account() -> None:
    main = table(bridge("vehicle-00", POSE_01), revoked=write_revoked({"vehicle-00": "stolen"}))
    assert main.table == {**FIXED, "vehicle-00": frozenset()}
    assert (main.revoked, main.problems) == ({"vehicle-00": "stolen"}, ())
    assert table(bridge("vehicle-00", POSE_01)).table["vehicle-00"] > FIXED["vehicle-00"]


@pytest.mark.parametrize(
    ("shut", "revoked", "requests"),
    [
        ((), (), []),
        ((), ("cloud-0",), [("disableClient", "cloud-0", "an account that was open")]),
        (("cloud-0",), ("cloud-0",), []),
        (("cloud-0",), (), [("enableClient", "cloud-0", "an account that was disabled")]),
        (("cloud-0", "vehicle-00"), ("vehicle-00", "x"), [("enableClient", "cloud-0", "an account that was disabled")]),
        (("cloud-0",), None, []),
    ],
)
def test_accounts_are_shut_as_main_says(shut: Sequence[str], revoked: Sequence[str] | None, requests: object) -> None:
    standing = Standing(ROLES, {**CLIENTS, **{name: Client((name,), (), True) for name in shut}})
    changes = access_changes(standing, ROLES, revoked)
    assert [(change.request["command"], change.request["username"], change.was) for change in changes] == requests


RESERVED = replace(ACCOUNTS, agents=(*ACCOUNTS.agents, AgentAccount("vehicle-16", "", "vehicle-16")))
ENROLLED = {AGENTS_PATH: write_enrolled({"vehicle-16": "vehicle"})}


def of_reserved(*releases: Release, before: MainTable | None = None, **policies: str) -> MainTable:
    return main_table("c" * 40, read_tree(texts(*releases)), RESERVED, before, policies)


def test_who_is_enrolled_has_the_rights_of_its_role_and_who_is_not_has_none() -> None:
    links = (bridge("vehicle-16", POSE_01), bridge("vehicle-01", "/vehicles/vehicle_16/pose"))
    without, main = of_reserved(*links), of_reserved(*links, **ENROLLED)
    assert (without.table["vehicle-16"], without.shut) == (frozenset(), {"vehicle-16"})
    assert (main.enrolled, main.shut, main.problems) == ({"vehicle-16": "vehicle"}, frozenset(), ())
    assert Right("mqtt/vehicles/vehicle_16/#", WRITE) in main.table["vehicle-16"]
    assert Right("mqtt/vehicles/vehicle_01/pose", READ) in main.table["vehicle-16"]
    assert {name: main.table[name] for name in FIXED} == {name: without.table[name] for name in FIXED}
    revoked = of_reserved(*links, **ENROLLED, **{REVOKED_PATH: write_revoked({"vehicle-16": "stolen"})})
    assert (revoked.table["vehicle-16"], revoked.shut) == (frozenset(), {"vehicle-16"})


def test_who_is_enrolled_stays_so_while_the_file_is_broken() -> None:
    first = of_reserved(bridge("vehicle-16", POSE_01), **ENROLLED)
    broken = of_reserved(bridge("vehicle-16", POSE_01), before=first, **{AGENTS_PATH: "agents: [{name: vehicle-16}]"})
    assert (broken.table, broken.shut) == (first.table, frozenset())
    assert broken.problems == (
        "policies/agents.yaml: agents[0].role: missing; who is enrolled stays so until it is mended",
    )
    with pytest.raises(DocumentError):  # its role was never known: nothing at the broker changes
        of_reserved(**{AGENTS_PATH: "agents: [{name: vehicle-16}]"})


def test_only_a_reserved_agent_is_enrolled() -> None:
    named = {"vehicle-16": "vehicle", "vehicle-00": "cloud", "vehicle-99": "vehicle"}
    main = of_reserved(**{AGENTS_PATH: write_enrolled(named)})
    assert main.enrolled == {"vehicle-16": "vehicle"}
    assert main.table["vehicle-00"] == FIXED["vehicle-00"]
    assert "vehicle-99" not in main.table
    assert [problem.split(" ")[2] for problem in main.problems] == ["vehicle-00", "vehicle-99"]


def test_a_withdrawn_agent_has_nothing_of_a_broken_release_either() -> None:
    first = of_reserved(bridge("vehicle-16", POSE_01), **ENROLLED)
    tree = read_tree({"releases/vehicle-16/mqtt-bridge.yaml": "no release"})
    assert main_table("d" * 40, tree, RESERVED, first, {}).table["vehicle-16"] == frozenset()


def test_agents_begin_shut_and_those_that_are_open_stay_so() -> None:
    accounts = fixed_rights(RESERVED)
    hashed = dict.fromkeys(wanted_roles(accounts), Password("d", "s", 101))

    def shut(document: Mapping[str, Any]) -> set[str]:
        return {one["username"] for one in document["clients"] if one.get("disabled")}

    agents = {agent.name for agent in RESERVED.agents}
    first = first_file(accounts, hashed, None, agents)
    assert shut(first) == agents
    opened = {**first, "clients": [{**one, "disabled": one["username"] == "vehicle-16"} for one in first["clients"]]}
    assert shut(first_file(accounts, hashed, opened, agents)) == {"vehicle-16"}


def test_a_policy_that_cannot_be_read_lets_nobody_in_again() -> None:
    first = table(revoked=write_revoked({"vehicle-00": "stolen"}))
    broken = table(revoked="revoked: [{agent: vehicle-00}]", before=first)
    assert broken.revoked == first.revoked
    assert broken.table["vehicle-00"] == frozenset()
    assert broken.problems == (
        "policies/revoked.yaml: revoked[0].reason: missing; who is revoked stays so until it is mended or gone",
    )
    assert table(revoked="no policy").revoked is None  # nothing is known: whoever is shut stays so
    assert table(before=broken).revoked == {}


def test_an_agent_that_is_not_declared_is_named() -> None:
    main = table(revoked=write_revoked({"vehicle-000": "mistyped", "rights": "not an agent"}))
    assert (main.revoked, main.table) == ({}, FIXED)
    assert [problem.split(";")[0] for problem in main.problems] == [
        f"policies/revoked.yaml: no agent {name} is declared" for name in ("rights", "vehicle-000")
    ]


def test_an_account_that_is_gone_cannot_be_made_here() -> None:
    assert missing(Standing(ROLES, {k: v for k, v in CLIENTS.items() if k != "cloud-0"}), ROLES) == ["cloud-0"]


def test_the_first_file_keeps_lists_and_makes_accounts_anew() -> None:
    passwords = {name: Password(f"digest of {name}", "salt", 101) for name in ROLES}
    main = table(bridge("vehicle-00", POSE_01))
    before = first_file(main.table, passwords, None, ())
    before["roles"].append({"rolename": "stranger", "acls": []})
    [own] = [role for role in before["roles"] if role["rolename"] == OWNER]
    own["acls"] = []
    for client in before["clients"]:
        client["disabled"] = client["username"] in ("vehicle-01", OWNER)
    anew = {name: Password("another", "salt", 101) for name in ROLES}
    file = first_file(FIXED, anew, before, ())
    assert file["roles"] == first_file(main.table, anew, None, ())["roles"]
    assert {client["password"] for client in file["clients"]} == {"another"}
    assert [client["username"] for client in file["clients"] if client.get("disabled")] == ["vehicle-01"]
    assert first_file(FIXED, anew, {"roles": "broken"}, ()) == first_file(FIXED, anew, None, ())


# -- borders ------------------------------------------------------------------------------------------------------

SPLIT = replace(
    ACCOUNTS,
    managers=(
        ManagerAccount("south", ("vehicle-00", "roadside-0")),
        ManagerAccount("north", ("vehicle-01", "cloud-0")),
    ),
)
CONSENTS = {
    path_of("south"): "sends: [{to: north, topics: ['/vehicles/{agent}/pose']}]\n",
    path_of("north"): f"receives: [{{from: south, topics: [{POSE_00}]}}]\n",
}


def split_table(*releases: Release, before: MainTable | None = None, **policies: str) -> MainTable:
    return main_table("c" * 40, read_tree(texts(*releases)), SPLIT, before, {**CONSENTS, **policies})


def heard_by(agent: str, main: MainTable) -> set[str]:
    """The topics that an agent may receive beside its own, without what says their types."""
    rights = main.table[agent] - fixed_rights(SPLIT)[agent]
    return {right.topic for right in rights if right.direction == READ and right.topic.startswith("mqtt/")}


def test_another_scopes_topic_is_given_where_both_consent() -> None:
    link = bridge("cloud-0", POSE_00)
    assert heard_by("cloud-0", split_table(link)) == {f"mqtt{POSE_00}"}
    for scope in ("south", "north"):
        main = split_table(link, **{path_of(scope): "{}\n"})
        assert heard_by("cloud-0", main) == set()
        [problem] = main.problems
        assert problem.startswith(f"releases/cloud-0/mqtt-bridge.yaml: topic {POSE_00} is said by vehicle-00 of ")
        assert f"main lacks {path_of(scope)} " in problem
    assert heard_by("cloud-0", table(link)) == {f"mqtt{POSE_00}"}, "one manager has no borders"


def test_any_agent_is_asked_for_and_only_those_that_may_be_heard_are() -> None:
    main = split_table(bridge("cloud-0", "/vehicles/{agent}/pose"))
    poses = {f"mqtt/vehicles/{name}/pose" for name in ("vehicle_00", "vehicle_01", "cloud_0")}
    assert heard_by("cloud-0", main) == poses
    assert Right("mqtt/vehicles/+/pose", ASK) in main.table["cloud-0"]
    assert (SUBSCRIBE, "mqtt/vehicles/+/pose", True) in wanted_roles(main.table)["cloud-0"]
    assert (RECEIVE, "mqtt/vehicles/+/pose", True) not in wanted_roles(main.table)["cloud-0"]
    assert main.problems == ()


def test_a_withdrawn_consent_ends_a_right_that_a_broken_release_keeps() -> None:
    before = split_table(bridge("cloud-0", POSE_00))
    files = {**texts(bridge("cloud-0", POSE_00)), "releases/cloud-0/mqtt-bridge.yaml": "no release"}
    kept = main_table("d" * 40, read_tree(files), SPLIT, before, CONSENTS)
    assert heard_by("cloud-0", kept) == {f"mqtt{POSE_00}"}
    assert heard_by("cloud-0", main_table("d" * 40, read_tree(files), SPLIT, before, {})) == set()
    broken = {**CONSENTS, path_of("south"): "sends: 7"}
    still = main_table("d" * 40, read_tree(files), SPLIT, before, broken)
    assert heard_by("cloud-0", still) == {f"mqtt{POSE_00}"}, "a consent that cannot be read is not withdrawn"


FOREIGN = ("mqtt/vehicles/vehicle_01/pose", "mqtt/vehicles/vehicle_01", "mqtt/agents/cloud_0/plan")
levels = st.lists(st.sampled_from(["mqtt", "vehicles", "agents", "vehicle_01", "{agent}", "pose"]), max_size=5)
odd_names = levels.map(lambda parts: "/" + "/".join(parts))
odd_items = st.fixed_dictionaries({"name": odd_names}, optional={"mqtt_topic": odd_names.map(lambda name: name[1:])})


def matches(topic_filter: str, topic: str) -> bool:
    """Return whether a filter without `#` stands for the topic."""
    mine, parts = topic_filter.split("/"), topic.split("/")
    return len(mine) == len(parts) and all(one in ("+", part) for one, part in zip(mine, parts, strict=True))


@given(st.lists(odd_items, max_size=4))
def test_whatever_anybody_deploys_hears_nothing_over_a_border_without_consent(incoming: Any) -> None:
    deployed = release("vehicle-00", "any", {"bridge": {"in": incoming}})
    main = main_table("c" * 40, read_tree(texts(deployed)), SPLIT, None, {})
    heard = heard_by("vehicle-00", main)
    assert not [(one, topic) for one in heard for topic in FOREIGN if matches(one, topic)]
