"""Attacks on who may say and hear what at the broker (`ci.attacks`)."""

from __future__ import annotations

from ci.attacks.cells import Attack, Refused, Unseen
from ci.attacks.shared_cells import NO_DEMAND, NOT_PROPOSED, NOTHING_TO_JUDGE

SAID_OR_HEARD = Unseen("pods are what they were: nothing else runs, messages are said or heard")
BY_CLIENT = Unseen("no link asks for it: a client with the agent's account does it")
BRIDGES = "delivery/rights/test_bridges.py"

AT_THE_BROKER = (
    Attack(
        "topic-of-another",
        "An agent, or who has its account, says something in another agent's name",
        Refused(
            "may not write it at the broker",
            "delivery/manager/composition/test_links.py::test_where_no_agent_may_the_link_is_refused",
        ),
        NOT_PROPOSED,
        NOTHING_TO_JUDGE,
        SAID_OR_HEARD,
        Refused(
            "…: the broker refuses a message (reason 0x87 of MQTT 5)",
            "charts/test_broker.py::test_a_bridge_that_may_not_says_so",
            "the broker",
        ),
    ),
    Attack(
        "heard-without-a-link",
        "An agent, or who has its account, listens to what no link on main gives it",
        BY_CLIENT,
        NOT_PROPOSED,
        NOTHING_TO_JUDGE,
        SAID_OR_HEARD,
        Refused(
            "…: the broker refuses the subscription: Not authorized",
            f"{BRIDGES}::test_a_link_from_vehicle_to_vehicle",
            "the broker",
        ),
    ),
    Attack(
        "heard-over-a-border",
        "A link lets an agent hear what agents of another manager's scope say, which has not consented",
        Refused(
            "topic … is said by … of scope …: a link over this border needs the consent of both, and main lacks …",
            "delivery/manager/test_links_across_scopes.py::"
            "test_a_link_over_a_border_is_refused_without_the_consent_of_both",
        ),
        Refused(
            "spec.values.…: topic … is said by … of scope …: a link over this border needs the consent of both",
            "delivery/gate/test_link_consents.py::test_what_another_scope_says_is_heard_with_the_consent_of_both",
        ),
        NOTHING_TO_JUDGE,
        SAID_OR_HEARD,
        Refused(
            "the subscription: reason 0x87 of MQTT 5",
            "delivery/rights/test_borders.py::test_a_link_that_only_one_scope_wants_is_no_right",
            "the broker",
        ),
    ),
    Attack(
        "session-taken-over",
        "Who has one agent's account connects with the client id of another agent's bridge, to end its connection and "
        "get what waits in its session",
        BY_CLIENT,
        NOT_PROPOSED,
        NOTHING_TO_JUDGE,
        SAID_OR_HEARD,
        Refused(
            "session present 0",
            "delivery/rights/test_sessions.py::test_who_guesses_the_id_of_a_bridge_gets_no_session_of_it",
            "the broker, to whoever names an id that he can guess (CONNACK of MQTT 5), and the bridge stays connected",
        ),
    ),
    Attack(
        "revoked-comes-back",
        "Who has the account of an agent that main revokes goes on with his connections, or makes another one",
        BY_CLIENT,
        NOT_PROPOSED,
        NOTHING_TO_JUDGE,
        SAID_OR_HEARD,
        Refused(
            "reason 0x87 of MQTT 5",
            "delivery/rights/test_revocation.py::test_what_it_has_ends_and_nothing_new_begins",
            "the broker ends them within 5 s of the merge, and takes none",
        ),
    ),
    Attack(
        "not-enrolled",
        "Who has the account of a reserved agent that main does not enroll, or no more, connects with it",
        BY_CLIENT,
        NOT_PROPOSED,
        NOTHING_TO_JUDGE,
        SAID_OR_HEARD,
        Refused(
            "reason 0x87 of MQTT 5",
            "delivery/rights/test_enrollment.py::test_enrolled_it_takes_part",
            "the broker, where it is shut from its first start on",
        ),
    ),
    Attack(
        "rights-changed",
        "Who got the password of the account `rights` gives himself rights, a role or an account at the broker",
        NO_DEMAND,
        NOT_PROPOSED,
        NOTHING_TO_JUDGE,
        SAID_OR_HEARD,
        Refused(
            "rights restored about=… was=…",
            "delivery/rights/test_broker.py::test_a_change_by_another_hand_is_put_right_and_told",
            "the process that keeps rights, within 5 s, in its log",
        ),
    ),
)
