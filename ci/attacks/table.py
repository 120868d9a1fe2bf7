"""Attacks on the promise that nothing runs that was not verified, and what refuses each at which place.

A cell says the words of the refusal (`…` stands for what differs each time) and the test that reads them off the real
refusal: it calls `tests.stages.attacks.shown`, which compares them, and a test fails when it is named here and does not
(`operator/tests/stages/attacks.py`). Or it says why the attack cannot be seen there. `make reference` makes the table
in docs/explanation/trust.md of it (`ci.reference.attacks`).
"""

from __future__ import annotations

from collections.abc import Iterator

from ci.attacks.around_policies import AROUND_POLICIES
from ci.attacks.at_the_broker import AT_THE_BROKER
from ci.attacks.cells import PLACES, Attack, Refused, Unseen
from ci.attacks.on_servers import ON_SERVERS
from ci.attacks.shared_cells import (
    APPLICATIONS,
    AS_MANAGER,
    BY_DIGEST,
    CHANGED,
    EVIDENCE,
    FOREIGN_IMAGE,
    FROM_MACHINE,
    GLASS,
    IMAGE,
    INSIDE,
    INSPECTION,
    INSPECTOR,
    NO_DEMAND,
    NOT_ON_MAIN,
    NOT_PROPOSED,
    NOTHING_RUNS,
    NOTHING_TO_JUDGE,
    OF_NO_RELEASE,
    ON_THE_MACHINE,
    OTHER_CHART,
    OTHERWISE,
    POLICIES,
    RUNS_FOREIGN_CHART,
    RUNS_FOREIGN_IMAGE,
    SELECTION,
    STATUS,
    TRIALS,
    VERIFIED,
    VERIFIED_OTHERWISE,
)


def attack(key: str) -> Attack:
    """The attack of a key; KeyError when there is none."""
    return {one.key: one for one in ATTACKS}[key]


def refusals() -> Iterator[tuple[str, str, Refused]]:
    """Key, place and cell of every refusal."""
    for one in ATTACKS:
        for place in PLACES:
            cell = one.cell(place)
            if isinstance(cell, Refused):
                yield one.key, place, cell


ATTACKS = (
    Attack(
        "image-by-manager",
        "The manager's account proposes a plan whose values lead to a foreign image",
        AS_MANAGER,
        FOREIGN_IMAGE,
        IMAGE,
        RUNS_FOREIGN_IMAGE,
    ),
    Attack(
        "image-by-publisher",
        "A publisher submits an application whose values lead to a foreign image",
        Refused(
            "release …: a pod would run image …, which was not verified with chart …",
            f"{SELECTION}::test_a_task_that_leads_to_a_foreign_image_is_refused_and_nothing_is_proposed",
        ),
        Refused(
            "spec.services[…]: with parameters …: a pod would run image …, which was not verified with chart …",
            f"{TRIALS}::test_a_parameter_that_leads_where_no_release_may_go_is_named_with_its_value",
            "the trial, before it is published",
        ),
        IMAGE,
        RUNS_FOREIGN_IMAGE,
    ),
    Attack(
        "application-to-the-machine",
        "A parameter of an application leads to its machine's files, or to privileges",
        NOT_ON_MAIN,
        Refused(
            "spec.services[…]: with parameters …: …: type hostPath: a folder of the node",
            f"{TRIALS}::test_a_parameter_that_leads_where_no_release_may_go_is_named_with_its_value",
            "the trial, before it is published",
        ),
        Refused(
            "in namespace … ask for a way to their machine (its network, processes, files, or privileges)",
            f"{POLICIES}::test_no_pod_gets_a_way_to_its_machine",
        ),
        ON_THE_MACHINE,
    ),
    Attack(
        "application-edited",
        "Who may write the catalogue's main edits an application after it was signed",
        Refused(
            "no valid evidence: applications/….yaml is not what was verified",
            "registry/catalogue/test_verified_applications.py::"
            "test_one_edited_after_signing_is_forbidden_also_in_transition",
        ),
        Refused(
            "application …: no valid evidence: applications/….yaml is not what was verified",
            "delivery/gate/test_proposal_checks.py::"
            "test_a_task_of_an_application_that_is_not_what_was_verified_is_refused",
        ),
        VERIFIED_OTHERWISE,
        VERIFIED_OTHERWISE,
    ),
    Attack(
        "runs-by-itself",
        "A publisher alone submits an application that runs by itself (`initialFor`)",
        NOT_ON_MAIN,
        Refused(
            "runs by itself on every agent of role … (initialFor). Somebody with write rights who is no",
            "registry/publication/test_approvals.py::test_it_waits_and_is_published_with_a_persons_approval",
        ),
        VERIFIED_OTHERWISE,
        VERIFIED_OTHERWISE,
    ),
    Attack(
        "merge-against-the-gate",
        "A person merges what the gate refuses, with `edits: respect` in the same commit",
        NO_DEMAND,
        Refused(
            "it cannot be merged.…Main moves by the gate alone, so nobody can merge it",
            "delivery/gate/test_people.py::"
            "test_what_the_gate_refuses_reaches_main_by_nobody_though_edits_are_to_be_respected",
        ),
        IMAGE,
        RUNS_FOREIGN_IMAGE,
    ),
    Attack(
        "entry-called-verified",
        "Who may write the catalogue calls an entry verified that no suite has tried",
        Refused(
            "no valid evidence: suite static: there is no evidence; a missing suite is not a passed one",
            f"{VERIFIED}::test_an_entry_edited_to_verified_is_not_selected",
        ),
        Refused(
            "suite static: there is no evidence; a missing suite is not a passed one",
            f"{EVIDENCE}::test_evidence_that_does_not_hold_is_refused",
        ),
        Refused(
            "is not listed: summary: ",
            "registry/admission/test_listing.py::test_without_its_signature_a_version_is_not_listed",
            "the list",
        ),
        RUNS_FOREIGN_CHART,
    ),
    Attack(
        "verdict-overwritten",
        "A suite's verdict is overwritten with that of another build",
        Refused(
            "summary: it lists another envelope of suite static",
            f"{VERIFIED}::test_a_summary_signed_for_other_envelopes_does_not_count",
        ),
        Refused(
            "it lists another envelope of suite static", f"{EVIDENCE}::test_evidence_that_does_not_hold_is_refused"
        ),
        Unseen("only the summary is looked up, which is one signature over the chart with its images"),
        Unseen("only the summary is looked up, which is one signature over the chart with its images"),
    ),
    Attack(
        "status-forged",
        "An account with write rights posts the gate's verdict as a commit status",
        NO_DEMAND,
        Refused("a plan may only touch", "delivery/gate/test_gate.py::test_a_forged_status_changes_nothing"),
        OTHER_CHART,
        RUNS_FOREIGN_CHART,
    ),
    Attack(
        "withdrawn-version",
        "A version that was withdrawn is deployed once more",
        Refused(
            "state withdrawn is not allowed",
            f"{VERIFIED}::test_a_withdrawn_version_is_not_selected",
        ),
        Refused(
            "state withdrawn is not allowed",
            "delivery/gate/test_gate.py::test_what_the_catalogue_withdrew_is_refused_when_both_are_told_at_once",
        ),
        OTHER_CHART,
        RUNS_FOREIGN_CHART,
    ),
    Attack(
        "tag-moves",
        "A tag leads to other bytes between check and use",
        BY_DIGEST,
        Refused(
            "a pod would run image …, which was not verified with chart …",
            "delivery/gate/test_image_checks.py::test_any_other_image_is_refused",
        ),
        Refused(
            "a tag can be moved after it was checked, a digest cannot",
            f"{POLICIES}::test_a_test_namespace_takes_any_image_by_digest_from_the_suite_runner",
        ),
        Refused(
            "container … of pod … runs image …, which is not listed for this namespace",
            f"{INSPECTION}::test_a_tag_that_has_moved",
        ),
    ),
    Attack(
        "application-by-argocd",
        "The ApplicationSet controller's account writes an Application of its own",
        NO_DEMAND,
        NOT_PROPOSED,
        OTHER_CHART,
        OF_NO_RELEASE,
    ),
    Attack(
        "operation-with-source",
        "Argo CD is told by `operation.sync` to apply another source, or manifests",
        NO_DEMAND,
        NOT_PROPOSED,
        Refused(
            "operation.sync names another source or revision than the Application, or manifests of its own",
            f"{APPLICATIONS}::test_an_operation_brings_nothing_of_its_own",
        ),
        OF_NO_RELEASE,
    ),
    Attack(
        "project-widened",
        "Argo CD's server widens the project that limits releases",
        NO_DEMAND,
        NOT_PROPOSED,
        Refused(
            "AppProject robotkube-apps changed by …: who installs the platform says what releases may be made of",
            f"{APPLICATIONS}::test_argo_cd_does_not_widen_the_project_of_releases",
        ),
        NOTHING_RUNS,
    ),
    Attack(
        "pod-by-administrator",
        "An administrator starts a pod of an agent",
        NO_DEMAND,
        NOT_PROPOSED,
        Refused(
            "pods made by …: in an agent's namespace Argo CD's application controller alone makes workloads, and "
            "controllers make their pods",
            f"{POLICIES}::test_nobody_but_controllers_makes_pods_of_an_agent",
        ),
        Refused(
            "pod … is not of …release … that main of the deployment has", f"{INSPECTION}::test_a_pod_of_no_release"
        ),
    ),
    Attack("sidecar", "A sidecar is added to a release's Deployment", NO_DEMAND, NOT_PROPOSED, CHANGED, OTHERWISE),
    Attack(
        "annotation", "An annotation is added to a release's Deployment", NO_DEMAND, NOT_PROPOSED, CHANGED, OTHERWISE
    ),
    Attack(
        "pod-changed-as-made",
        "A mutating policy or webhook gives pods of a release a probe, a mount or a volume more (other clusters)",
        NO_DEMAND,
        NOT_PROPOSED,
        Unseen("who asks for it is the controller that makes the pod, and its images are verified ones"),
        Refused(
            "pod … is not what the chart of its release renders",
            f"{INSPECTION}::test_a_pod_that_was_changed_as_it_was_made",
        ),
    ),
    Attack(
        "settings-past-main",
        "A release gets settings that main does not have: by the ApplicationSet's values, or while Argo CD is told to "
        "ignore the difference",
        NO_DEMAND,
        NOT_PROPOSED,
        VERIFIED_OTHERWISE,
        Refused(
            "ConfigMap … is not what the chart of release … renders: data.…",
            f"{INSPECTOR}::test_settings_that_main_does_not_have_are_named_in_time",
        ),
    ),
    Attack(
        "ephemeral-container",
        "A container is added to a pod that runs (`kubectl debug`)",
        NO_DEMAND,
        NOT_PROPOSED,
        Refused(
            "no container may be added to a pod that runs in namespace …: nobody verified the pod with it",
            f"{POLICIES}::test_containers_are_not_added_to_pods_of_an_agent",
        ),
        Refused(
            "container … was added to pod … while it ran (kubectl debug)",
            f"{INSPECTION}::test_a_container_added_to_a_pod_that_runs",
        ),
    ),
    Attack(
        "image-volume",
        "A foreign image comes as a volume of a pod",
        Refused(
            "a pod would run image …, which was not verified with chart …",
            f"{SELECTION}::test_an_image_that_is_a_volume_is_refused_as_well",
        ),
        Refused(
            "a pod would run image …, which was not verified with chart …",
            "delivery/gate/test_image_checks.py::test_an_image_that_is_a_volume_is_refused_as_well",
        ),
        IMAGE,
        Refused(
            "has image … as a volume, which may not run here", f"{INSPECTION}::test_an_image_as_a_volume"
        ),
    ),
    Attack(
        "way-to-the-machine",
        "A pod asks for its machine's files, network, processes or privileges",
        NOT_ON_MAIN,
        Refused(
            "volume …: type hostPath: a folder of the",
            "registry/suites/test_static.py::test_a_pod_that_breaks_pod_security",
            "the static suite",
        ),
        Refused(
            "in namespace … ask for a way to their machine (its network, processes, files, or privileges)",
            f"{POLICIES}::test_no_pod_gets_a_way_to_its_machine",
        ),
        ON_THE_MACHINE,
    ),
    Attack(
        "policy-deleted",
        "An administrator deletes the admission policies (embedded cluster)",
        NO_DEMAND,
        NOT_PROPOSED,
        Refused(
            '"robotkube-agents.static.k8s.io" not found',
            f"{POLICIES}::test_a_policy_in_files_can_be_neither_seen_nor_deleted",
        ),
        NOTHING_RUNS,
    ),
    Attack(
        "policy-deleted-elsewhere",
        "An administrator deletes an admission policy, its binding or the list (other clusters)",
        NO_DEMAND,
        NOT_PROPOSED,
        Refused(
            "admission object restored kind=… name=…",
            "charts/test_admission_process.py::test_what_an_administrator_deletes_comes_back",
            "the process that writes it again, while it runs",
        ),
        NOTHING_RUNS,
    ),
    Attack(
        "verifier-off",
        "The gate, or what follows the catalogue, is switched off",
        NOT_ON_MAIN,
        Refused(
            "Not allowed to push to protected branch main",
            f"{GLASS}::test_two_commits_a_merge_another_branch_and_no_option_are_refused",
            "the forge",
        ),
        Refused(
            "image … may not run in namespace …",
            "ci/cluster/embedded/admission/test_admission_api_server.py::"
            "test_a_publication_is_at_work_without_a_request_to_the_server",
        ),
        Refused(
            "container … of pod … runs image …, which is not listed for this namespace",
            "delivery/inspection/test_permitted.py::test_while_the_forge_is_away_the_last_list_counts",
        ),
    ),
    Attack(
        "inspection-forged",
        "Somebody writes into an Inspection that nothing is strange, or deletes it",
        NO_DEMAND,
        NOT_PROPOSED,
        NOTHING_TO_JUDGE,
        Refused(
            "inspection restored name=… was=…",
            f"{INSPECTOR}::test_a_stranger_that_somebody_made_unnamed_is_named_again",
            "the inspector's log, within 5 s",
        ),
    ),
    Attack(
        "inspection-changed-by-policy",
        "A mutating policy or webhook changes what the inspector writes (other clusters)",
        NO_DEMAND,
        NOT_PROPOSED,
        NOTHING_TO_JUDGE,
        Refused(
            "the API server has something else than what was written, so do not believe it",
            f"{INSPECTOR}::test_admission_that_changes_what_is_written_is_said",
            "the inspector, which is not ready then",
        ),
    ),
    Attack(
        "static-pod",
        "A static pod is put on a machine",
        NO_DEMAND,
        NOT_PROPOSED,
        FROM_MACHINE,
        Refused("static pod …: a file of the machine names it", f"{INSPECTION}::test_a_static_pod"),
    ),
    Attack(
        "container-into-a-pod",
        "A container is put into a pod that runs, by the machine's own runtime",
        NO_DEMAND,
        NOT_PROPOSED,
        FROM_MACHINE,
        Refused(
            "container … runs in pod …, which does not name it. It was started on the machine",
            f"{INSPECTION}::test_a_container_that_the_runtime_was_told_to_put_into_a_pod",
        ),
    ),
    Attack(
        "beside-the-kubelet",
        "A container is started beside the kubelet, by the machine's own runtime",
        NO_DEMAND,
        NOT_PROPOSED,
        FROM_MACHINE,
        Refused(
            "container … on node …: containerd's namespace … is not k8s.io, which is that of kubelets. It was started "
            "beside the kubelet, through the machine's own runtime",
            "ci/cluster/embedded/containers/test_containers_runtime.py::test_a_container_beside_the_kubelet_is_named_until_it_ends",
            "on the embedded cluster the machine's own process, within 15 s (elsewhere it cannot be seen)",
        ),
    ),
    Attack(
        "main-moved-past-the-gate",
        "Who can write the forge's disk moves main past the gate",
        NO_DEMAND,
        Refused(
            "unchecked commit stands commit=… how=no-record",
            f"{GLASS}::test_it_stands_out_until_a_checked_commit_has_replaced_it_or_accepted_it",
            "its log, afterwards",
        ),
        OTHER_CHART,
        RUNS_FOREIGN_CHART,
        Refused(
            "has no record of the gate: main was moved past it, or the record was taken away",
            f"{STATUS}::test_each_kind_has_words_of_its_own",
            "`robotkube status`, afterwards",
        ),
    ),
    Attack(
        "break-glass-claimed",
        "A commit is put on main that only says that it is break-glass",
        NO_DEMAND,
        NOT_PROPOSED,
        OTHER_CHART,
        RUNS_FOREIGN_CHART,
        Refused(
            "only says that it is break-glass: its signatures do not hold, so main was moved past gate and hook",
            f"{STATUS}::test_each_kind_has_words_of_its_own",
            "`robotkube status`, afterwards",
        ),
    ),
    *AROUND_POLICIES,
    *ON_SERVERS,
    *AT_THE_BROKER,
    Attack(
        "exec",
        "A command is run in a container that runs (`kubectl exec`)",
        NO_DEMAND,
        NOT_PROPOSED,
        INSIDE,
        INSIDE,
    ),
    Attack(
        "controller-impersonated",
        "An administrator impersonates Argo CD's application controller to run a verified image otherwise",
        NO_DEMAND,
        NOT_PROPOSED,
        Unseen("who may impersonate an account is that account: the rules on images and machines hold, those on who "
        "asks do not"),
        OF_NO_RELEASE,
    ),
)  # fmt: skip
