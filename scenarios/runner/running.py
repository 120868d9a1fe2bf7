"""One run of a scenario on a running platform: prepare, play, do the story's steps, watch, wait, collect, report."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import urlsplit

from ci.cluster_contract.provider import Provider, Volumes
from ci.errors import SetUpError
from ci.folders import PROJECT
from robotkube.foundation.kubernetes.core.service_names import port_of
from scenarios import definition
from scenarios.definition import Scenario, cloud_topic, pose_topic
from scenarios.generator import bags, checking, coverage, routes
from scenarios.runner.inputs import (
    NANOSECONDS,
    STORY,
    AuditGap,
    Edge,
    InputCounters,
    NetworkOfRun,
    Plan,
    Recording,
    ReleasedChart,
    RunInputs,
    Stored,
)
from scenarios.runner.judging import evidence
from scenarios.runner.observing import collecting
from scenarios.runner.observing.broker import BrokerObserver
from scenarios.runner.observing.cpu import CpuSampler
from scenarios.runner.observing.pods import PodWatch
from scenarios.runner.observing.tasks import TaskWatch
from scenarios.runner.platform import inspection, proposing
from scenarios.runner.platform.access import PLATFORM, Access, Endpoint
from scenarios.runner.platform.deployment import CATALOGUE, Deployment, specification_digests
from scenarios.runner.platform.placing import place_bags
from scenarios.runner.playing import cables, driving, needs, policy
from scenarios.runner.playing.acting import Actor, merge_plans
from scenarios.runner.playing.cables import Cables, UntouchedCables
from scenarios.runner.playing.readiness import Readiness
from scenarios.runner.reporting import report, timeline
from scenarios.runner.reporting.page import page, value
from scenarios.runner.reporting.showing import Showing, showing
from scenarios.runner.waiting import RunError, wait_for

REPORTS = PROJECT / "build" / "reports"
EVIDENCE_FOLDER, EVIDENCE_KEYS = "evidence", "evidence-keys"
START_DELAY_SECONDS = 3
READY_SECONDS_MAX = 600.0
REST_CORES_MAX, REST_SECONDS_MAX = 1.0, 60.0
"""A run begins when the cluster takes no more cores than that: the start of all its pods is not part of the story."""
PLAY_SECONDS_MARGIN = 60.0
REMOVAL_SECONDS_MAX = 60.0
OBSERVE_SECONDS_AFTER_REMOVAL = 6.0

StoredOfRun = tuple[tuple[Recording, ...], tuple[Stored, ...], tuple[AuditGap, ...]]


@dataclass
class Run:
    """A run under way: the tools it uses and what it has noted. `provider` is the kind of cluster, `nodes` has
    the names of its nodes by those of the scenario, `progress` shows people a line, on standard error."""

    scenario: Scenario
    access: Access
    provider: str
    volumes: Volumes
    nodes: Mapping[str, str]
    deployment: Deployment
    catalogue: Deployment
    observer: BrokerObserver
    pods: PodWatch
    tasks: TaskWatch
    sampler: CpuSampler
    name: str
    progress: Callable[[str], None]
    set_up_seconds: dict[str, float]
    actor: Actor
    cables: Cables
    showing: Showing
    releases_before: Mapping[str, str] = field(default_factory=dict)
    main_before: str = ""
    input_before: InputCounters | None = None
    plans_before: tuple[Plan, ...] = ()
    started: int = 0
    broke_off: bool = False
    warnings: list[str] = field(default_factory=list)

    @property
    def namespaces(self) -> list[str]:
        """Release namespaces of all agents that are not the platform."""
        return [node.agent for node in self.scenario.nodes if node.role != "platform"]

    def keep_plans(self) -> None:
        """Notes the plans that the manager remembers: one that is killed forgets them."""
        reading = collecting.Collecting(self.warn)
        self.plans_before = merge_plans(self.plans_before, collecting.plans(self.access, reading))

    def warn(self, text: str) -> None:
        """Notes something for the report and says it."""
        self.warnings.append(text)
        self.progress(f"warning: {text}")


def run(
    folder: Path,
    provider: Provider,
    settings: Mapping[str, str],
    variant: str | None = None,
    set_up_seconds: Mapping[str, float] | None = None,
    reports: Path = REPORTS,
) -> int:
    """Runs the scenario in `folder` on the cluster of `provider`; returns 0 only if every expectation holds, else 1.
    The report is written to `reports`/<scenario>/.

    Raises `ScenarioError` for a bad scenario or bag before anything has been touched.
    """
    scenario = definition.load(folder, [f"{key}={text}" for key, text in settings.items()], variant)
    began = time.monotonic()
    if scenario.players:
        routes.duration_seconds(scenario.parameters)
    coverage.coverage_holes(scenario)
    made = bags.make_bags(scenario, progress=_print_progress) if scenario.players else {}
    for agent, bag in made.items():
        checking.check_bag(bag, scenario, agent)
    seconds = dict(set_up_seconds or {}) | {"bags": round(time.monotonic() - began, 2)}
    needs.require_machines(scenario, provider)
    try:
        return _run(scenario, provider, made, seconds, reports)
    except RunError as error:
        _print_progress(f"error: {error}")
        return 1


def _print_progress(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _run(
    scenario: Scenario, provider: Provider, made: Mapping[str, Path], seconds: dict[str, float], reports: Path
) -> int:
    access = Access(provider.kubeconfig(), provider.reach)
    machines = provider.machines()
    nodes = needs.nodes_by_name(scenario, provider)
    forge = access.forge()
    story = scenario.story
    account_of_person, approver = access.forge_account(story.person), access.forge_account(story.approver)
    with (
        Deployment(forge, *account_of_person, approver=approver) as deployment,
        Deployment(forge, *account_of_person, CATALOGUE) as catalogue,
        TemporaryDirectory(prefix="robotkube-observer-") as mounted,
        provider.volumes() as volumes,
    ):
        actor = Actor(access, machines, lambda: _fetched(deployment), _print_progress, nodes=nodes)
        going = Run(
            scenario=scenario,
            access=access,
            provider=provider.kind,
            volumes=volumes,
            nodes=nodes,
            deployment=deployment,
            catalogue=catalogue,
            observer=BrokerObserver(partial(access.broker_account, "broker-account-observer", Path(mounted))),
            pods=PodWatch(access, [node.agent for node in scenario.nodes], _print_progress),
            tasks=TaskWatch(access, _print_progress),
            sampler=CpuSampler(machines.cpu_folder() if machines else None),
            name=f"run-{time.strftime('%Y%m%d-%H%M%S', time.gmtime())}",
            progress=_print_progress,
            set_up_seconds=seconds,
            actor=actor,
            cables=Cables(scenario, machines.emulator() if machines else UntouchedCables(), _print_progress),
            showing=showing(access.kubeconfig, _print_progress),
            warnings=lacking(provider, _print_progress),
        )
        actor.before_kill = going.keep_plans
        going.cables.check()
        try:
            with going.showing.going_on():
                done = execute(going, made)
        finally:
            going.cables.reset()
        show(going, done, reports)
        print("\n".join(inspection.lines(scenario, access.kubeconfig, *_forge_of_a_person(access, provider))))
    return 0 if done.passed else 1


def lacking(provider: Provider, progress: Callable[[str], None]) -> list[str]:
    """What this kind of cluster cannot give: said before the run, and the first warnings of its report."""
    lacks = [f"a cluster of kind {provider.kind}: {text}" for text in provider.lacks]
    for text in lacks:
        progress(f"warning: {text}")
    return lacks


def _fetched(deployment: Deployment) -> Mapping[str, Any]:
    deployment.fetch()
    return deployment.releases()


def _forge_of_a_person(access: Access, provider: Provider) -> tuple[Endpoint, str]:
    """The address at which a person finds the forge after the run, and the command that has to run meanwhile."""
    service, url = access.forge_service()
    encrypted = url.startswith("https:")
    if service is None:
        return Endpoint(urlsplit(url).hostname or "", port_of(url), encrypted), ""
    way = provider.way_of_a_person(service)
    return Endpoint(way.host, way.port, encrypted), way.command


def execute(going: Run, made: Mapping[str, Path]) -> report.Report:
    """The run itself. What fails after the players have started is reported together with what is known."""
    prepare(going, made)
    going.pods.start()
    going.tasks.start()
    going.observer.start()
    going.sampler.start()
    try:
        going.cables.begin()
        play(going)
        going.actor.perform(going.scenario.steps)
        wait_for_end(going)
    except Exception as error:
        if not going.started:
            going.observer.stop()
            going.pods.stop()
            going.tasks.stop()
            raise
        _note(going, error)
    return report.report(going.scenario, collect(going))


def _note(going: Run, error: Exception) -> None:
    """What was waited for in vain is judged by the expectations; anything else has broken the story off."""
    awaited = isinstance(error, RunError | SetUpError)
    going.broke_off = not awaited
    going.warn(str(error) if awaited else f"the run broke off: {type(error).__name__}: {error}")


def prepare(going: Run, made: Mapping[str, Path]) -> None:
    """Bags into the volume claims, the person's pull request, all releases ready; nothing is played yet."""
    going.cables.reset()
    driving.stop(going.access, going.scenario, going.progress)
    began = time.monotonic()
    place_bags(going.access, going.volumes, made, going.progress)
    ask(going)
    readiness = Readiness(going.access, going.deployment, going.scenario)
    wait_for(
        "all releases to be ready",
        READY_SECONDS_MAX,
        readiness.reached,
        lambda: f"{readiness.missing()}\n{going.access.state(going.namespaces)}",
        poll_seconds=2.0,
        progress=going.progress,
    )
    going.set_up_seconds["players and releases ready"] = round(time.monotonic() - began, 2)
    settle(going)
    going.main_before = going.deployment.fetch()
    going.releases_before = specification_digests(going.deployment.releases())


def settle(going: Run) -> None:
    """Lets the cluster finish what the start of its pods has left to do; a run on a busy one goes on with a warning."""
    began = time.monotonic()
    used = 0.0

    def rested() -> bool:
        nonlocal used
        used = going.sampler.cores_used() or 0.0
        return used <= REST_CORES_MAX

    try:
        wait_for("the cluster to be at rest", REST_SECONDS_MAX, rested, lambda: f"it takes {used:.2f} cores", 0.0)
    except RunError as error:
        going.warn(f"the run begins all the same: {error}")
    going.set_up_seconds["cluster at rest"] = round(time.monotonic() - began, 2)


def ask(going: Run) -> None:
    """The person's pull request on policies/initial.yaml; none when the file says it already."""
    going.deployment.fetch()
    text = policy.changed(going.deployment.file(policy.PATH), going.scenario)
    if text is None:
        going.progress(f"{policy.PATH} asks for everything already")
        return
    subject = f"policy(initial): {going.scenario.name} with {going.scenario.parameters.vehicles} vehicles"
    number = proposing.change(going.deployment, policy.PATH, text, subject, going.name)
    going.progress(f"pull request #{number} of {going.scenario.story.person} on {policy.PATH} is merged")


def play(going: Run) -> None:
    """Tells all players to start on one whole second; a story without players begins at once."""
    if not going.scenario.players:
        going.started = time.time_ns()
        going.showing.begin(going.started)
        going.cables.play(going.started)
        return
    if going.scenario.records:
        going.input_before = collecting.input_counters(going.access, going.scenario)
    going.started = (time.time_ns() // NANOSECONDS + 1 + START_DELAY_SECONDS) * NANOSECONDS
    going.cables.play(going.started)
    for agent in going.scenario.players:
        going.access.put_simulation(agent, going.name, going.started)
    if time.time_ns() > going.started:
        going.warn("starting the players took longer than the start was ahead: they began late")
    going.showing.begin(going.started)
    length = routes.duration_seconds(going.scenario.parameters)
    players = f"{len(going.scenario.players)} players start in {START_DELAY_SECONDS} s"
    going.progress(f"{going.name}: {players} and play for {length} s")


def wait_for_end(going: Run) -> None:
    """Wait until all ledgers have their end and everything that the events led to is gone again, and a little
    longer."""
    if going.scenario.players:
        _wait_for_players(going)

    def gone() -> bool:
        return not _left(going)

    wait_for(
        "everything the events led to, to be gone", REMOVAL_SECONDS_MAX, gone, lambda: "\n".join(_left(going)), 1.0
    )
    time.sleep(OBSERVE_SECONDS_AFTER_REMOVAL)


def _wait_for_players(going: Run) -> None:
    length = routes.duration_seconds(going.scenario.parameters)
    files = [(agent, collecting.ledger_file(going.name, topic)) for agent, topic in _played(going.scenario)]
    due = going.started + length * NANOSECONDS  # before, no ledger has an end, and looking costs time

    def ended() -> bool:
        return time.time_ns() >= due and all(collecting.ledger_ended(going.volumes, *file) for file in files)

    def open_ledgers() -> str:
        open_files = [file for agent, file in files if not collecting.ledger_ended(going.volumes, agent, file)]
        return f"{len(open_files)} of {len(files)} ledgers have no end yet: {', '.join(open_files[:3])}"

    limit = START_DELAY_SECONDS + length + PLAY_SECONDS_MARGIN
    wait_for("the players to finish", limit, ended, open_ledgers, poll_seconds=1.0)


def _played(scenario: Scenario) -> list[tuple[str, str]]:
    """Agents and their topics that are played to the end."""
    return [
        *((agent, pose_topic(agent)) for agent in scenario.players),
        *((agent, cloud_topic(agent)) for agent in scenario.lidar_agents),
    ]


def _left(going: Run) -> list[str]:
    """Pods of releases that were not there before, and plans that are not finished."""
    owners = [release.split("/", 1) for release in going.releases_before]
    pods = [
        f"pod {pod.namespace}/{pod.name}"
        for pod in going.pods.pods()
        if pod.created > going.started
        and pod.deleted is None
        and not any(pod.namespace == namespace and pod.name.startswith(f"{name}-") for namespace, name in owners)
    ]
    plans = collecting.plans(going.access, collecting.Collecting(lambda _: None))
    return pods + [f"plan {plan.plan}" for plan in plans if plan.observed is None and plan.error is None]


def collect(going: Run) -> RunInputs:
    """Everything the report is computed from; what cannot be read is a warning and fails its expectations."""
    ended = time.time_ns()
    scenario = going.scenario
    reading = collecting.Collecting(going.warn)
    read = reading.read
    records = scenario.records
    cables_of_run = _cables(going, reading)
    input_after = _input_after(going, reading) if records else None
    broker = read("observer of the broker", going.observer.stop, None, "broker")
    cpu = read("CPU time", lambda: going.sampler.stop(going.pods.labels), {}, "cpu_core_seconds")
    cores = read("CPU time by second", lambda: going.sampler.cores(going.pods.labels), None, "cores")
    _stop_watches(going, reading)
    edges = _edges(going, reading) if records else ()
    recordings, stored, gaps = _stored(going, reading, edges) if records else ((), (), ())
    read("deployment repository", going.deployment.fetch, "", "commits", "releases_after", "released", "history")
    released = read("releases of the run", lambda: evidence.released(_releases_of_the_run(going)), (), "released")
    return RunInputs(
        run=going.name,
        provider=going.provider,
        started=going.started,
        ended=ended,
        ledgers=collecting.ledgers(scenario, going.volumes, going.name, reading) if scenario.players else {},
        stored=stored,
        recordings=recordings,
        edges=edges,
        plans=_plans(going, reading),
        pull_requests=read("pull requests", going.deployment.pull_requests, (), "pull_requests"),
        commits=read("commits", going.deployment.commits, (), "commits"),
        input_before=going.input_before,
        input_after=input_after,
        broker=broker,
        pods=read("pods", going.pods.pods, (), "pods"),
        releases_before=going.releases_before,
        releases_after=read(
            "releases", lambda: specification_digests(going.deployment.releases()), {}, "releases_after"
        ),
        released=released,
        summaries=read("evidence in the catalogue", lambda: _summaries(going, released), {}, "summaries"),
        cpu_core_seconds=cpu,
        cores=cores,
        set_up_seconds=going.set_up_seconds,
        steps=tuple(going.actor.done),
        tasks=read("tasks", going.tasks.lives, (), "tasks"),
        history=read("main's history", lambda: going.deployment.history(going.main_before), (), "history"),
        gaps=gaps,
        cables=cables_of_run,
        warnings=tuple(going.warnings),
        missing=frozenset(reading.missing | ({STORY} if going.broke_off else set())),
    )


def _cables(going: Run, reading: collecting.Collecting) -> tuple[NetworkOfRun, ...]:
    """What the cables did, with their warnings."""
    networks: tuple[NetworkOfRun, ...] = reading.read("network", going.cables.finish, (), "cables")
    for text in going.cables.warnings:
        going.warn(text)
    return networks


def _input_after(going: Run, reading: collecting.Collecting) -> InputCounters | None:
    """The counters of the event detector's input; None when they cannot be read."""
    read = partial(collecting.input_counters, going.access, going.scenario)
    counters: InputCounters | None = reading.read("event detector's input", read, None, "input_after")
    return counters


def _stop_watches(going: Run, reading: collecting.Collecting) -> None:
    """End the watches: what comes later is of no run."""
    reading.read("watch of the pods", going.pods.stop, None, "pods")
    reading.read("watch of the tasks", going.tasks.stop, None, "tasks")


def _edges(going: Run, reading: collecting.Collecting) -> tuple[Edge, ...]:
    def source() -> tuple[Edge, ...]:
        return collecting.edges(going.access, going.scenario, reading)

    edges: tuple[Edge, ...] = reading.read("event detector's events", source, (), "edges")
    return edges


def _plans(going: Run, reading: collecting.Collecting) -> tuple[Plan, ...]:
    later = reading.read("manager's plans", lambda: collecting.plans(going.access, reading), (), "plans")
    return merge_plans(going.plans_before, later)


def _stored(going: Run, reading: collecting.Collecting, edges: Sequence[Edge]) -> StoredOfRun:
    events = [edge.id for edge in edges if edge.time >= going.started]

    def source() -> StoredOfRun:
        agents = {going.nodes[node.name]: node.agent for node in going.scenario.nodes}
        find = collecting.segment_finder(agents, going.volumes)
        return collecting.stored(going.access, going.scenario, find, events)

    nothing: StoredOfRun = ((), (), ())
    stored: StoredOfRun = reading.read("recordings", source, nothing, "recordings", "stored", "gaps")
    return stored


def _releases_of_the_run(going: Run) -> Iterator[tuple[str, Any]]:
    return going.deployment.releases_since(going.main_before)


def _summaries(going: Run, released: Sequence[ReleasedChart]) -> dict[str, str]:
    """Charts that the catalogue's evidence is about, verified with the keys that gate and manager trust."""
    keys = evidence.trusted_keys(going.access.configmap(PLATFORM, EVIDENCE_KEYS))
    going.catalogue.fetch()
    files = going.catalogue.files(EVIDENCE_FOLDER)
    for problem in evidence.problems(files, keys.verify, released):
        going.warn(problem)
    return evidence.summaries(files, keys.verify)


def show(going: Run, done: report.Report, reports: Path) -> None:
    """Prints timeline, table, files and the commands of inspection."""
    files = report.write(done, reports / going.scenario.name, page(done))
    print("\nThe run, by what it has measured:")
    print("\n".join([*timeline.lines(done.inputs, done.moments), *cables.lines(done.inputs.cables)]), flush=True)
    print()
    for row in done.table:
        print(f"{'ok  ' if row.passed else 'FAIL'} {row.name:<40} {row.expected:>8}  measured {value(row.measured)}")
    for text in done.document["warnings"]:
        print(f"warning: {text}")
    print(f"\n{'passed' if done.passed else 'FAILED'}: {files[0]}, {files[1]}\n")
