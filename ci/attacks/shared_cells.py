"""Cells that several attacks share, and the files of tests that they name (`ci.attacks`)."""

from __future__ import annotations

from ci.attacks.cells import Refused, Unseen

AS_MANAGER = Unseen("who has the manager's account does not ask the manager's selection")
NOT_ON_MAIN = Unseen("main does not have it: only what main has is selected")
NOT_PROPOSED = Unseen("nothing is proposed: the gate reads pull requests and main")
NOTHING_TO_JUDGE = Unseen("no pod, workload or Application is written: there is nothing to judge")
NOTHING_RUNS = Unseen("nothing runs by it")
NO_DEMAND = Unseen("no demand leads to it")
FROM_MACHINE = Unseen("it is started from its machine: the API server is not asked")
INSIDE = Unseen("it happens inside of a container that runs")
BY_DIGEST = Unseen("charts and images are named by digest, and no tag is followed")
VERIFIED_OTHERWISE = Unseen("chart and images are verified ones")

POLICIES = "registry/admission/test_policies_api_server.py"
APPLICATIONS = "registry/admission/test_application_policies.py"
RIGHTS = "foundation/forge/test_rights.py"
PACKAGE_RIGHTS = "foundation/forge/test_package_rights.py"
ARGOCD = "charts/test_argocd_processes.py"
GLASS = "foundation/forge/test_break_glass.py"
STATUS = "cli/test_status.py"
EVIDENCE = "delivery/gate/test_evidence.py"
VERIFIED = "registry/catalogue/test_verified_catalogue.py"

IMAGE = Refused(
    "image … may not run in namespace …: only images of chart versions that are verified on the catalogue's main run "
    "in an agent's namespace, by digest",
    f"{POLICIES}::test_a_pod_with_an_image_that_is_not_listed_is_refused",
)
FOREIGN_IMAGE = Refused(
    "a pod would run image …, which was not verified with chart …",
    "delivery/gate/test_images.py::"
    "test_a_plan_with_a_foreign_image_is_refused_and_one_with_the_verified_image_is_merged",
)
SELECTION = "delivery/manager/test_verified_images.py"
TRIALS = "delivery/gate/test_application_trials.py"
OTHER_CHART = Refused(
    "Application … is of … at …: only charts of … that are verified on the catalogue's main are applied, by digest",
    f"{APPLICATIONS}::test_an_application_of_anything_else_is_refused",
)
CHANGED = Refused(
    "deployments … changed by …: in an agent's namespace nothing runs but what main says. Change the release on main",
    f"{POLICIES}::test_nobody_else_changes_a_workload_of_an_agent",
)
INSPECTION = "delivery/inspection/test_attacks.py"
INSPECTOR = "delivery/inspection/test_inspector.py"
RUNS_FOREIGN_IMAGE = Refused(
    "container … of pod … runs image …, which is not listed for this namespace",
    f"{INSPECTION}::test_a_pod_with_an_image_that_is_not_listed",
)
ON_THE_MACHINE = Refused("has a way to its machine: …", f"{INSPECTION}::test_a_way_to_the_machine")
RUNS_FOREIGN_CHART = Refused(
    "its chart … is not verified on the catalogue's main",
    f"{INSPECTION}::test_a_release_of_a_chart_that_is_not_verified",
)
OF_NO_RELEASE = Refused("no release that main has renders it", f"{INSPECTION}::test_a_workload_that_main_does_not_have")
OTHERWISE = Refused(
    "is not what the chart of release … renders",
    "delivery/inspection/test_workloads_api_server.py::test_what_somebody_adds_to_a_workload_is_named",
)
RESERVED = Refused(
    "only the account gate writes notes, tags and whatever else is no branch",
    f"{RIGHTS}::test_a_person_writes_nothing_but_branches",
    "the forge's hook",
)
